"""KITTI in every layout: points to the last digit, intrinsics, Eigen's lists, errors that name the file."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from layouts import (
    DRIVES,
    FOCAL,
    KITTI_SIZES,
    VAL_DRIVE,
    eigen_list,
    kitti_calibration,
    kitti_depth,
    kitti_frame,
    kitti_pictures,
    kitti_raw,
    kitti_scan,
    kitti_selection,
    picture,
)
from torch import Tensor, nn

from eldenet.config import build_protocol, build_split, compose
from eldenet.data.kitti import KITTIDepth, KITTIRaw, KITTISelection
from eldenet.data.kitti_calibration import entry, rectified_intrinsics, velodyne_to_image
from eldenet.data.kitti_layouts import frame_list
from eldenet.data.kitti_velodyne import project_scan, read_scan
from eldenet.data.loading import collate
from eldenet.evaluation import evaluate, sample_rows
from eldenet.geometry import back_project


def straight(path: Path) -> np.ndarray:
    """Metres as the devkit's readme says."""
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64) / 256


# --- the depth devkit ---


def test_devkit(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    data = KITTIDepth(root, split="all")
    assert data.names == [f"{drive}/image_02/0000000005" for drive in (*DRIVES, VAL_DRIVE)]
    assert (data.ground_truth, data.min_depth, data.max_depth) == ("improved", 1e-3, 80.0)
    for i, drive in enumerate((*DRIVES, VAL_DRIVE)):
        frame = data.load_frame(i)
        np.testing.assert_array_equal(frame.image, kitti_frame(drive).rgb)
        np.testing.assert_array_equal(frame.depth, (kitti_frame(drive).steps / 256).astype(np.float32))
        assert frame.depth.shape == KITTI_SIZES[drive[:10]]
        assert frame.intrinsics is not None
        fx = FOCAL[drive[:10]]
        np.testing.assert_array_equal(frame.intrinsics, [[fx, 0, 609.5593], [0, fx, 172.854], [0, 0, 1]])
    assert KITTIDepth(root, split="test").names == [f"{VAL_DRIVE}/image_02/0000000005"]
    train, val = KITTIDepth(root, split="train"), KITTIDepth(root, split="val")
    assert sorted(train.names + val.names) == KITTIDepth(root, split="trainval").names
    assert train.names
    assert val.names
    assert not {name[:26] for name in train.names} & {name[:26] for name in val.names}
    assert KITTIDepth(root, split="val").names == val.names


def test_every_root_of_the_zips(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    raw = tmp_path / "raw"
    expected = KITTIDepth(root, split="trainval").names
    nested = tmp_path / "nested/data_depth_annotated"
    shutil.copytree(root, nested)
    assert KITTIDepth(nested.parent, raw_root=raw, split="trainval").names == expected
    assert KITTIDepth(nested, raw_root=raw, split="test").names == KITTIDepth(root, split="test").names
    merged = tmp_path / "merged"
    for part in ("train", "val"):
        shutil.copytree(root / part, merged, dirs_exist_ok=True)
    assert len(KITTIDepth(merged, raw_root=raw, split="all")) == 4
    with pytest.raises(FileNotFoundError, match=r"no groundtruth maps for split='test'(.|\n)*Expected tree"):
        KITTIDepth(merged, raw_root=raw, split="test")
    shutil.copytree(root, tmp_path / "nested", dirs_exist_ok=True)
    with pytest.raises(ValueError, match="are the same frame: unpack it once"):
        KITTIDepth(nested.parent, raw_root=raw)


def test_jpg_and_ma_and_karamans_layout(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path / "a", kind="velodyne_raw")
    for drive in DRIVES:
        shutil.rmtree(tmp_path / "a/raw" / drive[:10] / drive)
        kitti_pictures(tmp_path / "a/raw", drive, (5,), ".jpg")
    data = KITTIDepth(root, depth="velodyne_raw", split="trainval")
    assert (len(data), data.ground_truth) == (3, "sparse")
    assert abs(data.load_frame(0).image.astype(int) - kitti_frame(DRIVES[0]).rgb).mean() < 10
    home = tmp_path / "ma"
    shutil.copytree(kitti_depth(tmp_path / "b"), home / "data_depth_annotated")
    for drive in (*DRIVES, VAL_DRIVE):
        part = "val" if drive == VAL_DRIVE else "train"
        source = tmp_path / "b/raw" / drive[:10]
        shutil.copytree(source / drive, home / "data_rgb" / part / drive)
        kitti_calibration(home, drive[:10])
    ma = KITTIDepth(home, split="all")
    assert ma.names == KITTIDepth(tmp_path / "b/depth", split="all").names
    np.testing.assert_array_equal(ma.load_frame(3).image, kitti_frame(VAL_DRIVE).rgb)


def test_missing_partners_are_named_or_left_out(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    (tmp_path / f"raw/2011_09_26/{DRIVES[0]}/image_02/data/0000000005.png").unlink()
    with pytest.raises(
        FileNotFoundError, match=rf"1 of 3 frames .*{DRIVES[0]}/image_02/0000000005 \(no pict"
    ):
        KITTIDepth(root, split="trainval")
    data = KITTIDepth(root, split="trainval", on_error="skip")
    (lost, reason) = next(iter(data.skipped.items()))
    assert (len(data), lost) == (2, f"{DRIVES[0]}/image_02/0000000005")
    assert reason == f"{lost}: no picture (data.raw_root says where the pictures are)"
    assert len(KITTIDepth(root, split="trainval", on_error="skip", frames=3)) == 2  # 3 were listed
    with pytest.raises(ValueError, match="3 frames where 4 are expected"):
        KITTIDepth(root, split="trainval", on_error="skip", frames=4)


def test_eight_bits_and_other_sizes_are_refused(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    path = root / f"train/{DRIVES[0]}/proj_depth/groundtruth/image_02/0000000005.png"
    data = KITTIDepth(root, split="all")
    picture(path, (kitti_frame(DRIVES[0]).steps // 256).astype(np.uint8))
    with pytest.raises(ValueError, match=r"0000000005\.png holds uint8, encoding 'kitti' wants uint16"):
        data[0]
    picture(path, kitti_frame(DRIVES[0]).steps // 256)
    with pytest.raises(ValueError, match=r"0000000005\.png: the largest number is 7\d"):
        data[0]
    picture(path, kitti_frame(DRIVES[2]).steps)
    with pytest.raises(ValueError, match="they are no pair"):
        data[0]
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(ValueError, match=r"0000000005\.png is cut"):
        data[0]


# --- calibration ---


def test_partial_calibration_and_missing_keys(tmp_path: Path) -> None:
    kitti_calibration(tmp_path, "2011_09_26", partial=True)
    folder = tmp_path / "2011_09_26"
    assert rectified_intrinsics(folder, 2)[0, 0] == FOCAL["2011_09_26"]
    with pytest.raises(
        ValueError, match=r"calib_cam_to_cam\.txt has no 'R_rect_00', only P_rect_02, P_rect_03"
    ):
        velodyne_to_image(folder, 2)
    with pytest.raises(ValueError, match="has no 'P_rect_01'"):
        rectified_intrinsics(folder, 1)
    (folder / "calib_cam_to_cam.txt").write_text("P_rect_02: 721 0 609\n")
    with pytest.raises(ValueError, match="P_rect_02 holds 3 numbers, 12 finite ones are needed"):
        rectified_intrinsics(folder, 2)
    (folder / "calib_cam_to_cam.txt").write_text("P_rect_02: 0 0 0 0 0 0 0 0 0 0 0 0\n")
    with pytest.raises(ValueError, match="no focal length"):
        rectified_intrinsics(folder, 2)
    (folder / "calib_cam_to_cam.txt").write_text("")
    with pytest.raises(ValueError, match="no line 'key: numbers'"):
        rectified_intrinsics(folder, 2)


def test_intrinsics_are_required_unless_told(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    (tmp_path / "raw/2011_09_28/calib_cam_to_cam.txt").unlink()
    with pytest.raises(
        FileNotFoundError, match=r"calib_cam_to_cam\.txt of 2011_09_28.*data\.calibration=optional"
    ):
        KITTIDepth(root, split="trainval")
    data = KITTIDepth(root, split="trainval", calibration="optional")
    assert data[2]["intrinsics"].abs().sum() == 0
    assert data[0]["intrinsics"][0, 0] == pytest.approx(721.5377)


# --- scans ---


def by_hand(points: np.ndarray, matrix: np.ndarray, size: tuple[int, int], *, eigen: bool) -> np.ndarray:
    """Point by point, in the order of the file."""
    depth = np.zeros(size)
    for x, y, z, _ in points.astype(np.float64):
        u, v, w = matrix @ (x, y, z, 1)
        if x < 0 or w <= 0:
            continue
        col, row = round(u / w) - eigen, round(v / w) - eigen
        metres = x if eigen else w
        if 0 <= row < size[0] and 0 <= col < size[1] and not 0 < depth[row, col] <= metres:
            depth[row, col] = metres
    return depth


@pytest.mark.parametrize("projection", ["camera", "eigen"])
def test_projection_by_hand(tmp_path: Path, projection: str) -> None:
    data = KITTIRaw(kitti_raw(tmp_path), split="all", projection=projection)
    assert data.names == [f"{drive}/image_02/0000000069" for drive in DRIVES]
    assert data.ground_truth == "sparse"
    matrix = velodyne_to_image(tmp_path / "2011_09_26", 2)
    expected = by_hand(kitti_scan(DRIVES[0]), matrix, (375, 1242), eigen=projection == "eigen")
    frame = data.load_frame(0)
    np.testing.assert_array_equal(frame.depth, expected.astype(np.float32))
    assert 0.005 < (frame.depth > 0).mean() < 0.1
    if projection == "camera":  # back in space, a point is where the scan has it, up to half a pixel
        assert frame.intrinsics is not None
        points = back_project(frame.depth, frame.intrinsics)[frame.depth > 0]
        assert np.isfinite(points).all()


def test_nearest_wins_whatever_the_order() -> None:
    matrix = np.array([[100.0, 0, 0, 0], [0, 100, 0, 0], [0, 0, 1, 0]]) @ np.array(
        [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]]
    )
    points = np.array([[20.0, -2, -2], [10, -1, -1], [30, -3, -3], [-5, 1, 1]])
    for order in ([0, 1, 2, 3], [2, 1, 0, 3], [1, 2, 0, 3]):
        depth = project_scan(points[order], matrix, (20, 20))
        assert depth[10, 10] == 10
        assert np.count_nonzero(depth) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is cut or is no scan"), (b"\0" * 17, "is cut or is no scan"), (b"\xff" * 32, "no points within")],
)
def test_damaged_scans_are_named(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "0000000069.bin"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"0000000069\.bin.*{message}"):
        read_scan(path)
    with pytest.raises(FileNotFoundError, match="0000000070"):
        read_scan(tmp_path / "0000000070.bin")


# --- the selection ---


def test_selection(tmp_path: Path) -> None:
    data = KITTISelection(kitti_selection(tmp_path), frames=2)
    assert data.names == [f"{VAL_DRIVE}/image_02/{n:010d}" for n in (5, 8)]
    frame = data.load_frame(1)
    assert frame.image.shape == (352, 1216, 3)
    np.testing.assert_array_equal(frame.depth * 256, kitti_frame(VAL_DRIVE).steps[23:, 13:1229])
    assert frame.intrinsics is not None
    assert frame.intrinsics[0, 2] == 596.5593
    assert (
        KITTISelection(tmp_path / "val_selection_cropped", frames=None, depth="velodyne_raw").ground_truth
        == "sparse"
    )
    with pytest.raises(ValueError, match="2 frames where 1000 are expected"):
        KITTISelection(tmp_path)
    (
        tmp_path
        / f"val_selection_cropped/groundtruth_depth/{VAL_DRIVE}_groundtruth_depth_0000000005_image_02.png"
    ).unlink()
    with pytest.raises(FileNotFoundError, match=r"1 of 2 frames .*0000000005 \(no depth\)"):
        KITTISelection(tmp_path, frames=None)
    assert KITTISelection(tmp_path, frames=None, on_error="skip").skipped.keys() == {data.names[0]}
    shutil.rmtree(tmp_path / "val_selection_cropped/intrinsics")
    with pytest.raises(FileNotFoundError, match=r"1 intrinsics are missing.*calibration=optional"):
        KITTISelection(tmp_path, frames=None, on_error="skip")
    without = KITTISelection(tmp_path, frames=None, on_error="skip", calibration="optional")
    assert without[0]["intrinsics"].sum() == 0
    picture(tmp_path / "val_selection_cropped/image/cat.png", frame.image)
    with pytest.raises(ValueError, match=r"cat\.png is no name of the selection"):
        KITTISelection(tmp_path, frames=None)


# --- lists ---


def test_eigens_lists(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "eldenet")
    root = kitti_depth(tmp_path, numbers=(5, 6))
    (root / f"val/{VAL_DRIVE}/proj_depth/groundtruth/image_02/0000000005.png").unlink()
    test = eigen_list(tmp_path / "test.txt", (DRIVES[1], VAL_DRIVE), none=(VAL_DRIVE,))
    data = KITTIDepth(root, split="test", list_file=test, frames=1)
    assert data.names == [f"{DRIVES[1]}/image_02/0000000005"]
    assert data.skipped == {}  # nothing is wrong with the data set
    assert f"1 frames, such as {VAL_DRIVE}/image_02/0000000005: 1 frames remain" in caplog.text
    with pytest.raises(ValueError, match=r"1 frames where 652 are expected \(1 without depth in the list\)"):
        KITTIDepth(root, split="test", list_file=test, frames=652)
    test.write_text(test.read_text().replace("None", "x.png"))
    with pytest.raises(FileNotFoundError, match=rf"1 of 2 .*{VAL_DRIVE}/image_02/0000000005 \(no depth\)"):
        KITTIDepth(root, split="test", list_file=test)
    train = KITTIDepth(root, split="trainval", exclude_list=test)
    assert {name[:26] for name in train.names} == {DRIVES[0], DRIVES[2]}
    both = [KITTIDepth(root, split=split, exclude_list=test) for split in ("train", "val")]
    assert sorted(len(part) for part in both) == [2, 2]
    raw = kitti_raw(tmp_path / "scans", DRIVES)
    lines = tmp_path / "monodepth2.txt"
    lines.write_text(f"2011_09_26/{DRIVES[1]} 0000000069 l\n2011_09_28/{DRIVES[2]} 69 l\n")
    scans = KITTIRaw(raw, split="test", list_file=lines, frames=2, projection="eigen")
    assert scans.names == [f"{drive}/image_02/0000000069" for drive in DRIVES[1:]]
    none = eigen_list(tmp_path / "bts.txt", DRIVES[:2], 69, none=DRIVES[:1])  # None says nothing about scans
    assert KITTIRaw(raw, split="test", list_file=none).names[0].startswith(DRIVES[0])


def test_lines_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "list.txt"
    slashed = f"/2011_09_26/{DRIVES[0]}/image_03/data/0000000007.jpg /x/y.png 721.5377\n\n"
    path.write_text(slashed)
    assert frame_list(path)[0].place == (DRIVES[0], 3, "0000000007")
    path.write_text(slashed + slashed)
    with pytest.raises(ValueError, match="2 times: every frame counts once"):
        frame_list(path)
    for wrong in ("kitchen/rgb_1.jpg kitchen/d.png 518", f"{DRIVES[0]}/image_02/data/x.png None", "a b c d"):
        path.write_text(slashed + wrong)
        with pytest.raises(ValueError, match=r"list\.txt, line 3: .* is neither"):
            frame_list(path)
    path.write_text("")
    with pytest.raises(ValueError, match="is empty"):
        frame_list(path)
    with pytest.raises(FileNotFoundError, match=r"absent\.txt"):
        frame_list(tmp_path / "absent.txt")


@pytest.mark.parametrize("dataset", [KITTIDepth, KITTIRaw, KITTISelection])
def test_missing_root_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dataset: Callable[..., Any]
) -> None:
    monkeypatch.delenv("ELDENET_DATA", raising=False)
    with pytest.raises(FileNotFoundError, match=r"data\.root.*ELDENET_DATA(.|\n)*Expected tree"):
        dataset()
    with pytest.raises(FileNotFoundError, match=r"holds no (.|\n)*Expected tree"):
        dataset(tmp_path)


def test_settings_that_do_not_exist(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    for wrong in ({"split": "testing"}, {"depth": "dense"}, {"on_error": "maybe"}, {"calibration": "no"}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))}=.*give one of"):
            KITTIDepth(root, **wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"cameras=\[1\]"):
        KITTIDepth(root, cameras=[1])
    with pytest.raises(ValueError, match="projection='fisheye'"):
        KITTIRaw(kitti_raw(tmp_path / "r"), projection="fisheye")


# --- samples, protocols, evaluation ---


def test_subset_is_seeded_and_named(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path, numbers=(5, 6, 7))
    whole = KITTIDepth(root, split="all")

    def draw(count: int, seed: int) -> KITTIDepth:
        data = KITTIDepth(root, split="all")
        data.draw_subset(count, seed)
        return data

    drawn = draw(5, seed=1)
    assert drawn.names == draw(5, seed=1).names
    assert drawn.names == sorted(set(drawn.names), key=whole.names.index)
    assert len(drawn) == 5
    hashes = {draw(5, seed).split_hash for seed in range(4)}
    assert len(hashes | {whole.split_hash}) == 5
    for i, name in enumerate(drawn.names):
        frame = drawn.load_frame(i)
        assert frame.name == name
        np.testing.assert_array_equal(frame.depth, whole.load_frame(whole.names.index(name)).depth)
    with pytest.raises(ValueError, match="subset=13: KITTIDepth found 12 frames"):
        draw(13, seed=0)


def test_small_depth_keeps_its_points(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    sample = KITTIDepth(root, split="all", input_size=(75, 414))[0]
    steps = kitti_frame(DRIVES[0]).steps
    blocks = np.where(steps == 0, 65535, steps).reshape(75, 5, 414, 3).min((1, 3))
    expected = np.where(blocks == 65535, 0, blocks) / 256
    np.testing.assert_array_equal(sample["depth"][0], expected.astype(np.float32))


def split_under(root: Path, protocol: str, split: str, *more: str) -> tuple[Any, Any]:
    overrides = ["data=kitti", f"data.root={root}", f"protocol={protocol}", *more]
    config = compose("train", [*overrides, "data.input_size=null", f"data.{split}.split=all"])
    rules = build_protocol(config)
    return rules, build_split(config, split, rules)


def test_kb_crop_by_pixel(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    rules, train = split_under(root, "kitti_eigen_garg_improved", "train")
    sample = train[0]
    rgb, steps = kitti_frame(DRIVES[0])
    np.testing.assert_array_equal(
        (sample["image"] * 255).round().numpy().transpose(1, 2, 0), rgb[23:, 13:1229]
    )
    known = np.where(steps[23:, 13:1229] / 256 <= 80, steps[23:, 13:1229] / 256, 0)
    np.testing.assert_array_equal(sample["depth"][0], np.where(known < 1, 0, known).astype(np.float32))
    torch.testing.assert_close(sample["intrinsics"][:2, 2], torch.tensor([596.5593, 149.854]))
    _, val = split_under(root, "kitti_eigen_garg_improved", "val")
    whole = val[0]
    assert whole["image"].shape == (3, 352, 1216)
    assert whole["depth"].shape == (1, 375, 1242)
    torch.testing.assert_close(whole["intrinsics"], sample["intrinsics"])
    assert rules.pasted_box(375, 1242) == (23, 375, 13, 1229)
    assert rules.pasted_box(370, 1224) == (18, 370, 4, 1220)
    _, second = split_under(root, "kitti_depth", "val")
    assert second[2]["image"].shape[-2:] == second[2]["depth"].shape[-2:] == (352, 1216)


def test_912x228_by_pixel(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path, kind="velodyne_raw")
    sparse = "data.depth=velodyne_raw"
    rules, crop = split_under(root, "kitti_s2d_912x228", "val", sparse, "data.max_depth=120")
    rgb, steps = kitti_frame(DRIVES[2])
    top, left = 130 + (240 - 228) // 2, 10 + (1200 - 912) // 2
    assert (top, left) == (136, 154)
    window = (slice(top, top + 228), slice(left, left + 912))
    image = (crop[2]["image"] * 255).round().numpy().transpose(1, 2, 0)
    np.testing.assert_array_equal(image, rgb[window])
    np.testing.assert_array_equal(crop[2]["depth"][0], (steps[window] / 256).astype(np.float32))
    assert crop[2]["intrinsics"][0, 2] == pytest.approx(609.5593 - left)
    assert (rules.clamp, rules.max_depth, rules.size) == (False, 120.0, (228, 912))
    rules, squeezed = split_under(root, "kitti_paper", "val", sparse)
    sample = squeezed[0]
    assert sample["image"].shape[-2:] == sample["depth"].shape[-2:] == (228, 912)
    fx, fy = sample["intrinsics"][0, 0].item(), sample["intrinsics"][1, 1].item()
    assert (fx, fy) == (pytest.approx(721.5377 * 912 / 1216), pytest.approx(721.5377 * 228 / 352))
    steps = kitti_frame(DRIVES[0]).steps[23:, 13:1229]
    expected = np.full((228, 912), np.inf)
    for row, col in np.argwhere(steps):
        at = int((row + 0.5) * 228 / 352), int((col + 0.5) * 912 / 1216)
        expected[at] = min(expected[at], steps[row, col] / 256)
    np.testing.assert_array_equal(
        sample["depth"][0], np.where(expected <= 80, expected, 0).astype(np.float32)
    )


class Ramp(nn.Module):
    """Depth that grows to the right, whatever it sees."""

    def __init__(self) -> None:
        super().__init__()
        self.start = nn.Parameter(torch.tensor(2.0))

    def forward(self, image: Tensor) -> Tensor:
        ramp = torch.linspace(0, 60, image.shape[-1]).expand(len(image), 1, image.shape[-2], -1)
        return ramp + self.start


def test_frames_of_two_sizes_in_one_evaluation(tmp_path: Path) -> None:
    """A batch ends where the date changes; batch size 1 says the same, and both what is written out here."""
    root = kitti_depth(tmp_path, numbers=(5, 6))
    rules, data = split_under(root, "kitti_eigen_garg_improved", "val")
    assert [data.size_group(i) for i in (0, 3, 4)] == ["2011_09_26", "2011_09_26", "2011_09_28"]
    with pytest.raises(ValueError, match=r"frames of different sizes.*\n?.*batch_size=1"):
        collate([data[3], data[4]])
    one, four = (evaluate(Ramp(), data, rules, batch_size=size) for size in (1, 4))
    assert [row[0] for row in four.rows] == data.names
    assert one.metrics == pytest.approx(four.metrics, nan_ok=True)
    errors = []
    for name in data.names:
        depth = kitti_frame(name[:26]).steps / 256
        height, width = depth.shape
        prediction = np.zeros_like(depth)
        left = (width - 1216) // 2
        prediction[height - 352 :, left : left + 1216] = np.linspace(0, 60, 1216) + 2
        inside = np.zeros_like(depth, bool)
        inside[
            int(0.40810811 * height) : int(0.99189189 * height),
            int(0.03594771 * width) : int(0.96405229 * width),
        ] = True
        counts = inside & (depth > 1e-3) & (depth < 80)
        errors.append(np.abs(prediction - depth)[counts].mean())
    assert four.metrics["mae"] == pytest.approx(np.mean(errors), rel=1e-5)
    assert four.metrics["images"] == len(data)
    assert sample_rows(Ramp(), data, rules).shape[2] == 3


# --- the real frames ----------------------------------------------------------------------------------------


@pytest.fixture
def real() -> Path:
    if not os.environ.get("ELDENET_DATA"):
        pytest.skip("ELDENET_DATA is not set: no real data to read")
    root = Path(os.environ["ELDENET_DATA"]) / "kitti"
    if not (root / "raw").is_dir():
        pytest.skip(f"{root} is not there")
    return root


def test_real_devkit_frames(real: Path) -> None:
    data = KITTIDepth(split="all")
    files = sorted((real / "depth").rglob("groundtruth/image_02/*.png"))
    assert len(data) == len(files) > 0
    for i, file in enumerate(files):
        frame = data.load_frame(i)
        np.testing.assert_array_equal(frame.depth.astype(np.float64), straight(file))
        assert 0.1 < (frame.depth > 0).mean() < 0.4
        picture_file = data.pictures[i]
        np.testing.assert_array_equal(frame.image, cv2.imread(str(picture_file))[..., ::-1])
        assert frame.intrinsics is not None
        np.testing.assert_allclose(frame.intrinsics[:2, 2], [609.5593, 172.854])


def test_real_derived_maps_with_raw_pictures(real: Path) -> None:
    """The derived maps lie as the merged devkit does."""
    data = KITTIDepth(real / "depth_derived", depth="velodyne_raw", split="all")
    assert len(data) == 20
    for i, file in enumerate(data.sources):
        np.testing.assert_array_equal(data.load_frame(i).depth.astype(np.float64), straight(file))


def test_real_scans_give_back_the_derived_maps(real: Path) -> None:
    data = KITTIRaw(split="all")
    assert len(data) > 0
    for i, name in enumerate(data.names):
        drive, camera, number = name.split("/")
        file = real / "depth_derived" / drive / "proj_depth/velodyne_raw" / camera / f"{number}.png"
        derived = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        # in double: in single precision a handful of points change sides of half a step of 1/256 m
        matrix = velodyne_to_image(real / "raw" / drive[:10], 2)
        depth = project_scan(read_scan(data.sources[i]), matrix, derived.shape)
        np.testing.assert_array_equal(np.round(depth * 256).astype(np.uint16), derived)
        frame = data.load_frame(i)
        np.testing.assert_array_equal(frame.depth, depth.astype(np.float32))
        np.testing.assert_array_equal(frame.depth > 0, derived > 0)


def test_real_object_scans_give_back_the_derived_maps(real: Path) -> None:
    """The 3D-object set names its matrices otherwise; the projection is the same."""
    done = 0
    for file in sorted((real / "depth_derived/object/training").glob("*.png")):
        scan = next((real / "object/training").glob(f"velodyne*/{file.stem}.bin"))
        calib = real / f"object/training/calib/{file.stem}.txt"
        rotation, rigid = np.eye(4), np.eye(4)
        rotation[:3, :3] = entry(calib, "R0_rect", (3, 3))
        rigid[:3] = entry(calib, "Tr_velo_to_cam", (3, 4))
        matrix = entry(calib, "P2", (3, 4)) @ rotation @ rigid
        derived = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        depth = project_scan(read_scan(scan), matrix, derived.shape)
        np.testing.assert_array_equal(np.round(depth * 256).astype(np.uint16), derived)
        done += 1
    assert done > 0


def test_real_selection(real: Path) -> None:
    options: dict[str, Any] = {"frames": None, "calibration": "optional"}
    for depth, count in (("velodyne_raw", 2), ("groundtruth", 1)):
        data = KITTISelection(depth=depth, on_error="skip", **options)
        assert len(data) == count
        for i, file in enumerate(data.sources):
            frame = data.load_frame(i)
            assert frame.image.shape == (352, 1216, 3)
            np.testing.assert_array_equal(frame.depth.astype(np.float64), straight(file))
    with pytest.raises(FileNotFoundError, match=r"0000000003 \(no depth\)"):
        KITTISelection(**options)


@pytest.mark.parametrize(
    ("date", "fx", "cx", "cy"),
    [("2011_09_26", 721.5377, 609.5593, 172.854), ("2011_10_03", 718.856, 607.1928, 185.2157)],
)
def test_real_calibration(real: Path, date: str, fx: float, cx: float, cy: float) -> None:
    matrix = rectified_intrinsics(real / "raw" / date, 2)
    np.testing.assert_array_equal(matrix, [[fx, 0, cx], [0, fx, cy], [0, 0, 1]])
    if date == "2011_10_03":
        with pytest.raises(FileNotFoundError, match=r"calib_velo_to_cam\.txt does not exist"):
            velodyne_to_image(real / "raw" / date, 2)

"""KITTI in every layout: frames, intrinsics, Eigen's lists, errors that name the file."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from support.layouts import (
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

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.data.kitti import KITTIDepth, KITTIRaw, KITTISelection
from eldenet.data.kitti_calibration import rectified_intrinsics, velodyne_to_image
from eldenet.data.kitti_files import frame_list
from eldenet.geometry import back_project
from eldenet.train import TrainSettings


def test_devkit_frames_have_depth_intrinsics_and_splits(tmp_path: Path) -> None:
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


def test_zips_may_be_unpacked_nested_or_merged(tmp_path: Path) -> None:
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
    with pytest.raises(ValueError, match="are the same frame: remove one"):
        KITTIDepth(nested.parent, raw_root=raw)


def test_jpg_pictures_and_ma_and_karamans_layout_are_read(tmp_path: Path) -> None:
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
        FileNotFoundError, match=rf"1 of 6 files .*{DRIVES[0]}/image_02/0000000005 \(no picture.*raw_root"
    ):
        KITTIDepth(root, split="trainval")
    data = KITTIDepth(root, split="trainval", on_error="skip")
    (lost, reason) = next(iter(data.skipped.items()))
    assert (len(data), lost) == (2, f"{DRIVES[0]}/image_02/0000000005")
    assert f"{lost} (no picture)" in reason
    assert len(KITTIDepth(root, split="trainval", on_error="skip", frames=3)) == 2  # 3 were listed
    with pytest.raises(ValueError, match="3 frames instead of 4"):
        KITTIDepth(root, split="trainval", on_error="skip", frames=4)


def test_intrinsics_are_required_unless_optional(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    (tmp_path / "raw/2011_09_28/calib_cam_to_cam.txt").unlink()
    with pytest.raises(
        FileNotFoundError, match=r"calib_cam_to_cam\.txt of 2011_09_28.*data\.calibration=optional"
    ):
        KITTIDepth(root, split="trainval")
    data = KITTIDepth(root, split="trainval", calibration="optional")
    assert data[2]["intrinsics"].abs().sum() == 0
    assert data[0]["intrinsics"][0, 0] == pytest.approx(721.5377)


def test_the_cropped_selection_has_its_own_intrinsics(tmp_path: Path) -> None:
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
    with pytest.raises(ValueError, match="2 frames instead of 1000"):
        KITTISelection(tmp_path)
    (
        tmp_path
        / f"val_selection_cropped/groundtruth_depth/{VAL_DRIVE}_groundtruth_depth_0000000005_image_02.png"
    ).unlink()
    with pytest.raises(FileNotFoundError, match=r"1 of 6 files .*0000000005 \(no depth\)"):
        KITTISelection(tmp_path, frames=None)
    assert KITTISelection(tmp_path, frames=None, on_error="skip").skipped.keys() == {data.names[0]}
    shutil.rmtree(tmp_path / "val_selection_cropped/intrinsics")
    with pytest.raises(ValueError, match=r"intrinsics/.*calibration=optional"):
        KITTISelection(tmp_path, frames=None, on_error="skip")
    without = KITTISelection(tmp_path, frames=None, on_error="skip", calibration="optional")
    assert without[0]["intrinsics"].sum() == 0
    picture(tmp_path / "val_selection_cropped/image/cat.png", frame.image)
    with pytest.raises(ValueError, match=r"cat\.png is not named as in the selection"):
        KITTISelection(tmp_path, frames=None)


def test_eigens_lists_are_read_counted_and_split(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "eldenet")
    root = kitti_depth(tmp_path, numbers=(5, 6))
    (root / f"val/{VAL_DRIVE}/proj_depth/groundtruth/image_02/0000000005.png").unlink()
    test = eigen_list(tmp_path / "test.txt", (DRIVES[1], VAL_DRIVE), none=(VAL_DRIVE,))
    data = KITTIDepth(root, split="test", list_file=test, frames=1)
    assert data.names == [f"{DRIVES[1]}/image_02/0000000005"]
    assert data.skipped == {}  # nothing is wrong with the data set
    assert f"1 frames, such as {VAL_DRIVE}/image_02/0000000005, have no depth" in caplog.text
    with pytest.raises(ValueError, match=r"1 frames instead of 652 \(1 without depth in the list\)"):
        KITTIDepth(root, split="test", list_file=test, frames=652)
    test.write_text(test.read_text().replace("None", "x.png"))
    with pytest.raises(FileNotFoundError, match=rf"1 of 4 .*{VAL_DRIVE}/image_02/0000000005 \(no depth\)"):
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


def test_wrong_lines_of_a_list_are_named(tmp_path: Path) -> None:
    path = tmp_path / "list.txt"
    slashed = f"/2011_09_26/{DRIVES[0]}/image_03/data/0000000007.jpg /x/y.png 721.5377\n\n"
    path.write_text(slashed)
    assert frame_list(path) == {(DRIVES[0], 3, "0000000007"): True}
    path.write_text(slashed + slashed)
    with pytest.raises(ValueError, match=r"list\.txt, line 3: .* again: remove all but one"):
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


def test_unknown_settings_are_refused(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    for wrong in ({"split": "testing"}, {"depth": "dense"}, {"on_error": "maybe"}, {"calibration": "no"}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))}=.*give one of"):
            KITTIDepth(root, **wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"cameras=\[1\]"):
        KITTIDepth(root, cameras=[1])
    with pytest.raises(ValueError, match="projection='fisheye'"):
        KITTIRaw(kitti_raw(tmp_path / "r"), projection="fisheye")


# --- calibration and scans ---


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
    with pytest.raises(ValueError, match="P_rect_02 has 3 numbers, but 12"):
        rectified_intrinsics(folder, 2)
    (folder / "calib_cam_to_cam.txt").write_text("P_rect_02: 0 0 0 0 0 0 0 0 0 0 0 0\n")
    with pytest.raises(ValueError, match="no focal length"):
        rectified_intrinsics(folder, 2)
    (folder / "calib_cam_to_cam.txt").write_text("")
    with pytest.raises(ValueError, match="no line 'key: numbers'"):
        rectified_intrinsics(folder, 2)


def by_hand(points: np.ndarray, matrix: np.ndarray, size: tuple[int, int], *, eigen: bool) -> np.ndarray:
    """Point by point, in the order of the file."""
    depth = np.zeros(size)
    for x, y, z, _ in points.astype(np.float64):
        u, v, w = matrix @ (x, y, z, 1)
        if x < 0 or w <= 0:
            continue
        col, row = round(u / w) - eigen, round(v / w) - eigen
        meters = x if eigen else w
        if 0 <= row < size[0] and 0 <= col < size[1] and not 0 < depth[row, col] <= meters:
            depth[row, col] = meters
    return depth


@pytest.mark.parametrize("projection", ["camera", "eigen"])
def test_projection_equals_point_by_point(tmp_path: Path, projection: str) -> None:
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


@pytest.mark.parametrize(
    ("name", "frames", "drives"), [("eigen_697", 697, 28), ("eigen_652", 652, 28), ("zhou", 39_810, 32)]
)
def test_lists_of_the_field_come_with_the_package(name: str, frames: int, drives: int) -> None:
    """Zhou's training frames share no drive with Eigen's test frames, whose 652 are part of the 697."""
    places = frame_list(name)
    assert (len(places), len({place.drive for place in places})) == (frames, drives)
    tested = frame_list("eigen_697")
    if name == "zhou":
        assert not {place.drive for place in places} & {place.drive for place in tested}
    else:
        assert set(places) <= set(tested)


def test_missing_drives_are_named_in_one_line(tmp_path: Path) -> None:
    """Two of 28 drives: how many frames are left is said, and taking them is one setting; with all, none."""
    here = [place for place in frame_list("eigen_697") if place.drive.endswith(("0002_sync", "0009_sync"))]
    drives = tuple(sorted({place.drive for place in here}))
    kitti_raw(tmp_path, drives)
    for place in here:
        drive = tmp_path / place.date / place.drive
        (drive / f"image_02/data/{place.number}.png").touch()
        (drive / f"velodyne_points/data/{place.number}.bin").touch()
    words = ["data=kitti_eigen_raw", f"data.root={tmp_path}"]
    config = compose(TrainSettings, words)
    with pytest.raises(FileNotFoundError) as error:
        instantiate(config.data["test"], "data.test")
    assert f"of {28 - len(drives)} of 28 drives (2011_09_26_drive_0013_sync, " in str(error.value)
    assert f"{len(here)} of 697 frames are left" in str(error.value)
    assert "\n" not in str(error.value)
    assert len(instantiate(config.data["test"], "data.test", on_error="skip")) == len(here)
    for place in frame_list("eigen_697"):
        kitti_calibration(tmp_path, place.date)
        for file in (f"image_02/data/{place.number}.png", f"velodyne_points/data/{place.number}.bin"):
            path = tmp_path / place.date / place.drive / file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    assert len(instantiate(config.data["test"], "data.test")) == 697

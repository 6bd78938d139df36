"""Recordings as phones, depth cameras and robots write them: what pairs, and the line of what does not."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pillow_heif
import pytest
from PIL import Image
from support import recordings
from support.recordings import CAMERA, COUNT, RECORDERS, SIZE

from eldenet.adapt import AdaptSettings
from eldenet.compose import compose
from eldenet.data.camera_files import camera_of, read_camera
from eldenet.data.folder import FolderDataset
from eldenet.data.frame_files import seconds_of
from eldenet.geometry import pinhole, resize_intrinsics

SIZES = [SIZE, (24, 32), (15, 20)]


def options_of(name: str) -> dict:
    return {
        key: value.strip("'") for key, _, value in (word.partition("=") for word in RECORDERS[name].settings)
    }


def open_recording(name: str, root: Path, **options: object) -> FolderDataset:
    return FolderDataset(root, **{"max_depth": 10.0, **options_of(name), **options})


def shown(data: FolderDataset) -> list[int]:
    """The numbers of all frames, after a check that picture and depth of each belong together."""
    numbers = []
    for index in range(len(data)):
        frame = data.load_frame(index)
        number = round(float(frame.image.mean()) / 20)
        known = frame.depth[frame.depth > 0]
        np.testing.assert_allclose(known, recordings.meters(number), rtol=1e-3)
        assert frame.depth.shape == frame.image.shape[:2] == SIZE
        numbers.append(number)
    return sorted(numbers)


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("name", RECORDERS)
def test_each_layout_is_read(name: str, size: tuple[int, int], tmp_path: Path) -> None:
    recorder = RECORDERS[name]
    recorder.write(tmp_path, size)
    data = open_recording(name, tmp_path)
    lost = {2} if name == "clock" else set()
    assert shown(data) == sorted(set(range(COUNT)) - lost)
    frame = data.load_frame(0)
    if recorder.has_camera:
        np.testing.assert_allclose(frame.intrinsics, pinhole(*CAMERA), rtol=1e-6)
    else:
        assert frame.intrinsics is None
    if "confidence" in options_of(name):  # the right half is low
        assert frame.depth[:, : SIZE[1] // 2 - 2].all()
        assert not frame.depth[:, SIZE[1] // 2 + 2 :].any()


@pytest.mark.parametrize("name", ["scanner_app", "polycam", "nerfstudio"])
def test_poses_are_kept_with_the_axes_of_opencv(name: str, tmp_path: Path) -> None:
    RECORDERS[name].write(tmp_path, SIZE)
    data = open_recording(name, tmp_path)
    pose = data.camera_of(data.names[0]).pose
    np.testing.assert_array_equal(pose, np.array(recordings.POSE) @ np.diag([1, -1, -1, 1]))


def test_whole_scenes_are_held_out(tmp_path: Path) -> None:
    for name, parts in (("suffixes", 3), ("scenes", 3), ("table", 2)):
        RECORDERS[name].write(tmp_path / name, SIZE)
        train, val = (open_recording(name, tmp_path / name, split=split) for split in ("train", "val"))
        of = [{data.frames[n].scene for n in data.names} for data in (train, val)]
        assert (len(of[0] & of[1]), len(of[1]), len(of[0])) == (0, 1, parts - 1)


def test_edges_between_surfaces_stay_edges(tmp_path: Path) -> None:
    """A wall at 1 m before one at 4 m, and a hole: no depth lies between, none is made up."""
    root = tmp_path
    recordings.picture(root / "images/a.png", 0)
    raw = np.full((12, 16), 1000, np.uint16)
    raw[:, 8:] = 4000
    raw[4:6, 2:4] = 0
    (root / "depths").mkdir()
    cv2.imwrite(str(root / "depths/a.png"), raw)
    depth = FolderDataset(root, max_depth=10.0).load_frame(0).depth
    np.testing.assert_array_equal(
        depth, cv2.resize(raw, SIZE[::-1], interpolation=cv2.INTER_NEAREST) / np.float32(1e3)
    )


def test_points_stay_points(tmp_path: Path) -> None:
    recordings.picture(tmp_path / "images/a.png", 0)
    raw = np.zeros((12, 16), np.uint16)
    raw[3, 5] = raw[9, 1] = 2000
    (tmp_path / "depths").mkdir()
    cv2.imwrite(str(tmp_path / "depths/a.png"), raw)
    depth = FolderDataset(tmp_path, max_depth=10.0, ground_truth="sparse").load_frame(0).depth
    assert np.argwhere(depth).tolist() == [[14, 22], [38, 6]]


@pytest.mark.parametrize("turn", [90, 270])
def test_a_turned_depth_map_needs_its_direction(turn: int, tmp_path: Path) -> None:
    recordings.picture(tmp_path / "images/a.png", 0)
    raw = np.full((24, 32), 2000, np.uint16)
    raw[:12, :16] = 1000  # upper left
    (tmp_path / "depths").mkdir()
    cv2.imwrite(str(tmp_path / "depths/a.png"), np.ascontiguousarray(np.rot90(raw, turn // 90)))
    with pytest.raises(
        ValueError, match=r"a\.png is turned by 90 degrees against .*data\.rotate_depth=90 .* or 270"
    ):
        FolderDataset(tmp_path, max_depth=10.0).load_frame(0)
    depth = FolderDataset(tmp_path, max_depth=10.0, rotate_depth=turn).load_frame(0).depth
    assert (depth[:20, :28] == 1).all()
    assert (depth[28:] == 2).all()


def test_a_picture_that_exif_turns_is_turned_to_upright_depth(tmp_path: Path) -> None:
    picture = np.zeros((*SIZE, 3), np.uint8)
    picture[: SIZE[0] // 2] = 200
    tag = Image.Exif()
    tag[0x112] = 6
    (tmp_path / "images").mkdir()
    Image.fromarray(np.ascontiguousarray(np.rot90(picture))).save(
        tmp_path / "images/a.jpg", exif=tag, quality=95
    )
    recordings.depth(tmp_path / "depths/a.png", 4, (24, 32))
    image = FolderDataset(tmp_path, max_depth=10.0).load_frame(0).image
    np.testing.assert_allclose(image, picture, atol=3)


@pytest.mark.parametrize("size", [SIZE, (24, 32)])
def test_intrinsics_of_the_depth_maps_are_those_of_the_pictures(
    size: tuple[int, int], tmp_path: Path
) -> None:
    recordings.picture(tmp_path / "images/a.png", 0)
    recordings.depth(tmp_path / "depths/a.png", 0, size)
    of_depth = resize_intrinsics(pinhole(*CAMERA), SIZE, size)
    values = of_depth[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
    stated = dict(zip(("fx", "fy", "cx", "cy"), values, strict=True)) | {"width": size[1], "height": size[0]}
    for given in (list(CAMERA), values, stated):
        data = FolderDataset(tmp_path, max_depth=10.0, intrinsics=given)
        np.testing.assert_allclose(data.load_frame(0).intrinsics, pinhole(*CAMERA), rtol=1e-6)


def test_intrinsics_that_may_be_of_either_size_are_refused(tmp_path: Path) -> None:
    recordings.picture(tmp_path / "images/a.png", 0)
    recordings.depth(tmp_path / "depths/a.png", 0, (42, 56))
    with pytest.raises(ValueError, match=r"may be that of both .*64x48.*56x42.*width: \.\.\., height"):
        FolderDataset(tmp_path, max_depth=10.0, intrinsics=[60, 60, 29.5, 22])
    with pytest.raises(ValueError, match="may be that of neither"):
        FolderDataset(tmp_path, max_depth=10.0, intrinsics=[60, 60, 10, 22])


def test_heic_pictures_are_read(tmp_path: Path) -> None:
    recordings.depth(tmp_path / "depths/a.png", 3, SIZE)
    (tmp_path / "images").mkdir()
    heif = pillow_heif.from_pillow(Image.new("RGB", SIZE[::-1], (60, 60, 60)))
    heif.save(tmp_path / "images/a.heic", quality=95)
    assert shown(FolderDataset(tmp_path, max_depth=10.0)) == [3]
    content = (tmp_path / "images/a.heic").read_bytes()
    (tmp_path / "images/a.heic").write_bytes(content[:-20])
    with pytest.raises(ValueError, match=r"a\.heic is truncated or damaged"):
        FolderDataset(tmp_path, max_depth=10.0).load_frame(0)


@pytest.mark.parametrize(
    ("name", "lost", "line"),
    [
        ("record3d", "depth/2.exr", r"1 files in .* have no partner: rgb/2\.jpg \(no depth in depth\)"),
        ("record3d", "rgb/2.jpg", r"1 files in .* have no partner: depth/2\.exr \(no picture in rgb\)"),
        (
            "stray_scanner",
            "confidence/000002.png",
            r"1 of 6 frames have no confidence in .*: 000002\. Add them",
        ),
        ("scanner_app", "frame_00003.json", r"1 of 6 frames have no intrinsics in .*: 00003\. Add them"),
        ("prefixes", "color_0001.png", r"depth_0001\.png \(no picture in color_\*\.png\)"),
        ("scenes", "scene0001_00/depth/4.png", r"scene0001_00/color/4\.jpg \(no depth in \*/depth\)"),
        ("in_order", "range/scan102.png", "6 and 5 files cannot be paired by order"),
        ("nerfstudio", "depths/depth_00001.png", r"1 of 12 files are missing: .*depth_00001\.png"),
        ("associations", "rgb/1305031102.175304.png", "1 of 12 files are missing"),
    ],
)
def test_a_missing_file_is_named(name: str, lost: str, line: str, tmp_path: Path) -> None:
    RECORDERS[name].write(tmp_path, SIZE)
    (tmp_path / lost).unlink()
    with pytest.raises((FileNotFoundError, ValueError), match=line):
        open_recording(name, tmp_path)
    if name != "in_order":
        assert len(open_recording(name, tmp_path, on_error="skip")) == COUNT - 1


def test_confidence_without_depth_is_named(tmp_path: Path) -> None:
    RECORDERS["stray_scanner"].write(tmp_path, SIZE)
    recordings.confidence(tmp_path / "confidence/000009.png", SIZE)
    with pytest.raises(
        FileNotFoundError, match=r"1 confidence maps in .* no depth map: confidence/000009\.png"
    ):
        open_recording("stray_scanner", tmp_path)
    recordings.confidence(tmp_path / "confidence/000000.png", (9, 9))
    (tmp_path / "confidence/000009.png").unlink()
    with pytest.raises(ValueError, match=r"depth/000000\.png is 48x64, .*000000\.png is 9x9"):
        open_recording("stray_scanner", tmp_path).load_frame(0)


def test_depth_of_another_aspect_is_refused(tmp_path: Path) -> None:
    RECORDERS["prefixes"].write(tmp_path, (24, 24))
    with pytest.raises(ValueError, match=r"color_0000\.png is 48x64, .*_0000\.png is 24x24 .*align it"):
        open_recording("prefixes", tmp_path).load_frame(0)


def test_times_too_far_apart_are_refused(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    RECORDERS["tum"].write(tmp_path, SIZE)
    with pytest.raises(
        FileNotFoundError, match=r"by time.*the nearest are 0\.0149 s apart, data\.tolerance=0\.001"
    ):
        open_recording("tum", tmp_path, tolerance=0.001)
    with pytest.raises(ValueError, match=r"associations\.txt, line 1: 0\.0149 s lie between"):
        open_recording("associations", tmp_path, tolerance=0.001)
    (tmp_path / "depth.txt").write_text("1305031102.160407 depth/1305031102.160407.png\n")
    with caplog.at_level("INFO", logger="eldenet"):
        assert shown(open_recording("tum", tmp_path)) == shown(open_recording("tum", tmp_path)) == [0]
    said = "1 pictures have a depth map within 0.02 s; 5 pictures and 0 depth maps have none"
    assert caplog.text.count(said) == 1  # not for each split


def test_each_file_is_paired_once_with_its_nearest(tmp_path: Path) -> None:
    """A depth map between two pictures goes to the nearer one."""
    for i, time in enumerate((100.00, 100.03, 100.06)):
        recordings.picture(tmp_path / f"rgb/{time:.2f}.png", i)
    recordings.depth(tmp_path / "depth/100.02.png", 1, SIZE)
    recordings.depth(tmp_path / "depth/100.07.png", 2, SIZE)
    data = FolderDataset(tmp_path, images="rgb", depths="depth", pair_by="time", max_depth=9.0)
    assert shown(data) == [1, 2]


def test_seconds_since_1970_sort_by_time_whatever_decimals_are_written(
    tmp_path: Path,
) -> None:
    """As ``f"{time.time()}.png"`` names files; the frames must also be cut into blocks of time."""
    for i in range(COUNT):
        recordings.picture(tmp_path / f"rgb/{1700000000 + 0.05 * i}.png", i)
        recordings.depth(tmp_path / f"depth/{1700000000.004 + 0.05 * i}.png", i, SIZE)
    data = FolderDataset(tmp_path, images="rgb", depths="depth", pair_by="order", max_depth=9.0)
    assert shown(data) == list(range(COUNT))


def test_names_that_do_not_match_get_the_settings_that_would(tmp_path: Path) -> None:
    RECORDERS["arkit_scenes"].write(tmp_path, SIZE)
    folders = {"images": "lowres_wide", "depths": "lowres_depth"}
    with pytest.raises(FileNotFoundError) as error:
        FolderDataset(tmp_path, **folders, max_depth=10.0)
    assert "data.pair_by=time finds 6 frames, data.pair_by=order finds 6 frames" in str(error.value)
    RECORDERS["in_order"].write(tmp_path, SIZE)
    with pytest.raises(ValueError, match="IMG_8 does not end with a time"):
        open_recording("in_order", tmp_path, pair_by="time")


def test_a_list_is_checked_line_by_line(tmp_path: Path) -> None:
    RECORDERS["table"].write(tmp_path, SIZE)
    table = tmp_path / "pairs.csv"
    good = table.read_text()
    table.write_text(good + "a/9.jpg,,1,2,3,4,x\n")
    with pytest.raises(ValueError, match=r"pairs\.csv, line 8: no image or no depth"):
        open_recording("table", tmp_path)
    table.write_text(good.replace("60.0", "wide", 1))
    with pytest.raises(ValueError, match=r"pairs\.csv, line 2"):
        open_recording("table", tmp_path)
    table.write_text(good.replace(",cy", ",other", 1))
    with pytest.raises(ValueError, match=r"pairs\.csv, line 2 .* row with fx, fy, cx, cy .*'cy'"):
        open_recording("table", tmp_path)
    table.write_text(good + "../a.jpg,b/1.png,60,60,31,24,x\n")
    with pytest.raises(ValueError, match=r"'\.\./a\.jpg' is outside"):
        open_recording("table", tmp_path)


def test_transforms_json_is_checked(tmp_path: Path) -> None:
    RECORDERS["nerfstudio"].write(tmp_path, SIZE)
    file = tmp_path / "transforms.json"
    stored = json.loads(file.read_text())
    for change, line in (
        ({"camera_model": "OPENCV_FISHEYE"}, "fisheye"),
        ({"integer_depth_scale": 0.0002}, re.escape("data.encoding={scale: 0.0002}")),
        ({"fl_x": "x"}, "states no intrinsics"),
        (
            {"frames": [{"file_path": "images/frame_00000.jpg"}]},
            "frame 0 has no file_path or no depth_file_path",
        ),
        ({"frames": 3}, "no list of frames"),
        ({"w": 48, "h": 64}, "describe pictures of 48x64, this one is 64x48"),
    ):
        file.write_text(json.dumps(stored | change))
        with pytest.raises(ValueError, match=line):
            open_recording("nerfstudio", tmp_path).load_frame(0)


@pytest.mark.parametrize(
    ("name", "time"),
    [
        ("1305031102.175304", 1305031102.175304),
        ("40753679_6789.123", 6789.123),
        ("1700000000123", 1700000000.123),
        ("1442008525605123", 1442008525.605123),
        ("1403636579763555584", 1403636579.763555584),
        ("frame_00012", None),
        ("kitchen", None),
    ],
)
def test_times_in_names(name: str, time: float | None) -> None:
    assert seconds_of(name) == (time if time is None else pytest.approx(time, abs=1e-6))


@pytest.mark.parametrize(
    ("file", "content", "size"),
    [
        ("k.txt", "60 0 31\n0 61 24\n0 0 1\n", None),
        ("k.txt", "60 0 31 0\n0 61 24 0\n0 0 1 0\n0 0 0 1\n", None),
        ("k.txt", "60 61 31 24", None),
        ("k.pincam", "64 48 60 61 31 24", SIZE),
        ("k.json", '{"fl_x": 60, "fl_y": 61, "cx": 31, "cy": 24, "w": 64, "h": 48}', SIZE),
        ("k.json", '{"K": [60, 0, 0, 0, 61, 0, 31, 24, 1], "w": 64, "h": 48}', SIZE),
        ("k.json", '{"intrinsics": [[60, 0, 31], [0, 61, 24], [0, 0, 1]]}', None),
        ("k.json", '{"intrinsics": {"fx": 60, "fy": 61, "cx": 31, "cy": 24}}', None),
        (
            "k.json",
            '{"intrinsics": {"fx": 60, "fy": 61, "cx": 31, "cy": 24, "width": 64, "height": 48}}',
            SIZE,
        ),
        (
            "k.yaml",
            "image_width: 64\nimage_height: 48\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
            "  data: [60, 0, 31, 0, 61, 24, 0, 0, 1]\n",
            SIZE,
        ),
    ],
)
def test_files_of_cameras(file: str, content: str, size: tuple[int, int] | None, tmp_path: Path) -> None:
    (tmp_path / file).write_text(content)
    camera = read_camera(tmp_path / file)
    np.testing.assert_array_equal(camera.matrix, pinhole(*CAMERA))
    assert camera.size == size


def test_a_calibration_that_opencv_wrote(tmp_path: Path) -> None:
    file = cv2.FileStorage(str(tmp_path / "k.yml"), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 64)
    file.write("image_height", 48)
    file.write("camera_matrix", pinhole(*CAMERA))
    file.write("distortion_coefficients", np.zeros(5))
    file.release()
    camera = read_camera(tmp_path / "k.yml")
    np.testing.assert_array_equal(camera.matrix, pinhole(*CAMERA))
    assert camera.size == SIZE


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("pose.txt", "0.8 0.6 0 1\n-0.6 0.8 0 2\n0 0.1 0.9 3\n0 0 0 1\n"),
        ("k.json", '{"fx": 60}'),
        ("k.json", "[1, 2]"),
        ("k.json", '{"fx": 60, "fy": 61, "cx": 31, "cy": 24, "w": [64], "h": 48}'),
        ("k.txt", "no camera"),
        ("k.txt", "0 61 31 24"),
        ("k.yaml", "camera_matrix: ["),
    ],
)
def test_what_is_no_camera_is_refused(file: str, content: str, tmp_path: Path) -> None:
    (tmp_path / file).write_text(content)
    with pytest.raises(ValueError, match=file):
        read_camera(tmp_path / file)


@pytest.mark.parametrize(
    ("record", "said"),
    [
        ({"distortion_coefficients": {"data": [-0.3, 0.1, 0.001, 0.0, 0.0]}}, "(k1=-0.3, k2=0.1)"),
        ({"distortion": [0.0, 0.0, 0.0, 0.0, 0.4]}, "(k3=0.4)"),
        ({"k1": 0.05, "p2": -0.03}, "(k1=0.05, p2=-0.03)"),  # Nerfstudio
        ({"distortion_coefficients": {"data": [0.0] * 5}}, ""),
        ({"k1": 0.001}, ""),
        ({}, ""),
    ],
)
def test_a_lens_that_bends_lines_is_said(record: dict, said: str, caplog: pytest.LogCaptureFixture) -> None:
    """Its pictures are taken as a pinhole's."""
    camera = camera_of(
        {"fx": 60, "fy": 60, "cx": 31.5, "cy": 23.5, "w": 64, "h": 48, **record}, "camera.json"
    )
    assert camera.matrix[0, 0] == 60
    assert [said in line for line in caplog.messages] == ([True] if said else [])


def test_adapt_takes_a_file_of_the_camera_where_it_tunes_on_depth() -> None:
    words = ["data.root=scan", "intrinsics=camera_matrix.csv"]
    assert compose(AdaptSettings, words).data["train"]["intrinsics"] == "camera_matrix.csv"
    with pytest.raises(ValueError, match=r"intrinsics=camera_matrix\.csv: give \[fx"):
        compose(AdaptSettings, [*words, "camera_height=0.5"])

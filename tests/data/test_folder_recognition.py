"""``eldenet check-data FOLDER``: what a folder seems to be, and the settings that read it."""

import shlex
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import layouts, recordings
from support.recordings import COUNT, RECORDERS, SIZE

from eldenet.check_data import CheckDataSettings, check_data, recognize_folder
from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.data.folder_recognition import recognize
from eldenet.data.inspection import inverse_doubts
from eldenet.data.known_layouts import KNOWN_LAYOUTS

KNOWN = {
    "nyu_mat": layouts.mat,
    "nyu_hdf5": layouts.hdf5,
    "nyu_densedepth": layouts.densedepth,
    "nyu_labelled": layouts.labeled,
    "nyu_sync": layouts.sync,
    "kitti_raw": layouts.kitti_raw,
    "kitti": layouts.kitti_depth,
    "kitti_selection": layouts.kitti_selection,
    "cityscapes": layouts.cityscapes,
    "cityscapes_mtan": layouts.cityscapes_mtan,
}


def frames_of(line: str) -> dict[str, tuple[float, float]]:
    """Median depth [m] and brightness of all frames that a printed line reads, by name."""
    data = compose(CheckDataSettings, shlex.split(line)).data
    frames = instantiate(data["train"], "data.train", split="all")
    loaded = map(frames.load_frame, range(len(frames)))
    return {f.name: (float(np.median(f.depth[f.depth > 0])), float(f.image.mean())) for f in loaded}


@pytest.mark.parametrize("size", [SIZE, (24, 32), (15, 20)], ids=str)
@pytest.mark.parametrize("name", RECORDERS)
def test_a_printed_line_reads_the_recording(name: str, size: tuple[int, int], tmp_path: Path) -> None:
    """One of them, with every frame right; the lines differ in the unit alone."""
    recorder = RECORDERS[name]
    recorder.write(tmp_path, size)
    (found,) = recognize(tmp_path)
    assert not [fact for fact in found.facts if "not read" in fact]
    assert (
        any(fact.startswith("lens: ") and "not found" not in fact for fact in found.facts)
        == recorder.has_camera
    )
    right = []
    for reading in found.readings:
        frames = frames_of(reading.line)
        assert len(frames) == COUNT - (name == "clock")
        right.append(
            all(abs(depth - recordings.meters(round(gray / 20))) < 0.01 for depth, gray in frames.values())
        )
    assert right.count(True) == 1
    settings = dict(word.partition("=")[::2] for word in found.readings[right.index(True)].settings)
    given = dict(word.partition("=")[::2] for word in recorder.settings)
    assert ("data.confidence" in settings) == ("confidence" in given)
    assert settings.get("data.pair_by") == given.get("pair_by")


@pytest.mark.parametrize("data", KNOWN)
def test_data_sets_are_known(data: str, tmp_path: Path) -> None:
    KNOWN[data](tmp_path)
    words = [reading.settings[0] for found in recognize(tmp_path) for reading in found.readings]
    assert f"data={data}" in words
    assert {word.removeprefix("data=").partition("_")[0] for word in words} == {data.partition("_")[0]}


def test_data_sets_one_folder_below_are_known(tmp_path: Path) -> None:
    layouts.kitti_raw(tmp_path / "raw")
    layouts.kitti_depth(tmp_path)
    lines = [reading.line for found in recognize(tmp_path) for reading in found.readings]
    assert f"data=kitti data.root={tmp_path}/depth" in lines
    assert f"data=kitti_raw data.root={tmp_path}/raw" in lines


def test_one_frame_is_a_recording(tmp_path: Path) -> None:
    recordings.picture(tmp_path / "images/a.png", 4)
    recordings.depth(tmp_path / "depths/a.png", 4, SIZE)
    recordings.picture(tmp_path / "preview.png", 4)
    (found,) = recognize(tmp_path)
    settings = found.readings[0].settings[2:]
    assert settings == ("data.images=images", "data.depths=depths", "data.input_size=[32,32]")


@pytest.mark.parametrize("names", [("{}.png", "{}_depth.png"), ("{}_color.png", "{}.png")])
def test_pictures_and_depth_lie_in_one_folder(names: tuple[str, str], tmp_path: Path) -> None:
    """The pattern of the one finds the files of the other, too."""
    for i in range(3):
        recordings.picture(tmp_path / names[0].format(i), i)
        recordings.depth(tmp_path / names[1].format(i), i, SIZE)
    (found,) = recognize(tmp_path)
    assert not [fact for fact in found.facts if "partner" in fact]
    for name, (depth, _) in frames_of(found.readings[0].line).items():
        assert depth == pytest.approx(recordings.meters(int(name)), abs=1e-3)


@pytest.mark.parametrize("tree", ["{part}/{kind}", "{kind}/{part}", "{part}/hall/{kind}"])
def test_folders_named_as_parts_are_one_recording(tree: str, tmp_path: Path) -> None:
    for part, count in (("train", 3), ("val", 2)):
        for i in range(count):
            recordings.picture(tmp_path / tree.format(part=part, kind="rgb") / f"{i}.png", i)
            recordings.depth(tmp_path / tree.format(part=part, kind="depth") / f"{i}.png", i, SIZE)
    (found,) = recognize(tmp_path)
    assert "parts, by the names of folders: train 3, val 2" in found.facts
    assert f"data.images={tree.format(part='*', kind='rgb')}" in found.readings[0].settings


def test_the_object_benchmark_is_for_predict(tmp_path: Path) -> None:
    for folder in ("image_2", "calib"):
        (tmp_path / "training" / folder).mkdir(parents=True)
    (found,) = recognize(tmp_path)
    assert found.readings[0].settings == (f"source={tmp_path}/training", "boxes=true")


def test_the_largest_number_of_16_bits_is_no_depth(tmp_path: Path) -> None:
    """7-Scenes writes it where depth is unknown."""
    for i in range(3):
        recordings.picture(tmp_path / f"{i}_color.png", i)
        raw = np.full(SIZE, 2**16 - 1, np.uint16)
        raw[:8] = 2000
        cv2.imwrite(str(tmp_path / f"{i}_depth.png"), raw)
    (found,) = recognize(tmp_path)
    assert found.readings[0].note == "half of all depth nearer than 2 m, as mm"
    assert f"pixels with depth: {8 / SIZE[0]:.0%}; of a LiDAR? Then add data.ground_truth=sparse" in str(
        found.facts
    )
    assert not any("max_depth" in word for word in found.readings[0].settings)


@pytest.mark.parametrize("turned", [True, False])
def test_sun_rgbd_is_a_unit_where_its_bits_allow(turned: bool, tmp_path: Path) -> None:
    for i in range(3):
        recordings.picture(tmp_path / f"{i}_color.png", i)
        raw = np.full(SIZE, 3501, np.uint16)
        cv2.imwrite(str(tmp_path / f"{i}_depth.png"), raw << 3 if turned else raw)
    (found,) = recognize(tmp_path)
    lines = [reading.line for reading in found.readings if "sunrgbd" in reading.note]
    assert len(lines) == turned
    assert [depth for line in lines for depth, _ in frames_of(line).values()] == pytest.approx(
        [3.501] * 3 * turned
    )


def test_every_tree_of_a_data_set_has_a_line_that_is_read(tmp_path: Path) -> None:
    for layout in KNOWN_LAYOUTS:
        if layout.settings[0].startswith("data="):
            compose(CheckDataSettings, [word.format(root=tmp_path) for word in layout.settings])


def test_turned_depth_has_two_readings(tmp_path: Path) -> None:
    for i in range(3):
        recordings.picture(tmp_path / f"rgb/{i}.png", i)
        recordings.depth(tmp_path / f"depth/{i}.png", 4, (32, 24))
    (found,) = recognize(tmp_path)
    assert "depth is turned by 90 degrees; which way, the contact sheet shows" in found.facts
    turns = [word for reading in found.readings for word in reading.settings if "rotate" in word]
    assert set(turns) == {"data.rotate_depth=90", "data.rotate_depth=270"}
    assert turns.count("data.rotate_depth=90") == turns.count("data.rotate_depth=270")


def test_two_ways_to_pair_are_both_named(tmp_path: Path) -> None:
    """By time the first picture has no depth; equal numbers of files allow an order, too."""
    for i in range(5):
        recordings.picture(tmp_path / f"rgb/{100 + i / 10:.3f}.png", i)
        recordings.depth(tmp_path / f"depth/{100 + (i + 1) / 10 + 0.004:.3f}.png", i, SIZE)
    by = [found.title.rpartition(" ")[2] for found in recognize(tmp_path)]
    assert by == ["time", "order"]


def test_what_is_missing_and_what_is_refused_is_said(tmp_path: Path) -> None:
    RECORDERS["open3d"].write(tmp_path, SIZE)
    (tmp_path / "depth/00002.png").unlink()
    (tmp_path / "color/00004.jpg").unlink()
    (tmp_path / "camera_intrinsic.json").rename(tmp_path / "left.json")
    recordings.text(tmp_path / "right.json", (tmp_path / "left.json").read_text())
    (found,) = recognize(tmp_path)
    facts = "\n".join(found.facts)
    assert "frames that lack a file: 2: add it, or data.on_error=skip to these settings" in facts
    assert "1 pictures have no partner, such as color/00002.jpg" in facts
    assert "1 depth maps have no partner, such as depth/00004.png" in facts
    assert "left.json (fx 60.0, cx 31.0), right.json (fx 60.0, cx 31.0); add one as data.intrinsics=" in facts
    assert not any("intrinsics" in word for reading in found.readings for word in reading.settings)


def test_a_list_with_a_wrong_line_is_explained(tmp_path: Path) -> None:
    RECORDERS["associations"].write(tmp_path, SIZE)
    file = tmp_path / "associations.txt"
    file.write_text(file.read_text().replace("1305031102.160407 depth", "1305031109.160407 depth"))
    by_list, by_time = recognize(tmp_path)
    assert not by_list.readings
    assert "line 1: 6.99 s lie between the picture and its depth" in by_list.facts[0]
    assert by_time.readings


@pytest.mark.parametrize(
    ("size", "input_size"),
    [
        ((360, 640), "[192,352]"),
        ((320, 480), "[256,384]"),
        ((100, 178), "[96,160]"),
        ((120, 160), "[96,128]"),
        ((480, 640), ""),
    ],
)
def test_far_depth_and_another_size_are_in_the_line(
    size: tuple[int, int], input_size: str, tmp_path: Path
) -> None:
    """Pictures of another aspect than the default input size have their own; small ones are not enlarged."""
    for i in range(3):
        for folder, picture in (
            ("a", np.zeros((*size, 3), np.uint8)),
            ("b", np.full(size, 20_000, np.uint16)),
        ):
            (tmp_path / folder).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / folder / f"{i}.png"), picture)
    (found,) = recognize(tmp_path)
    line = found.readings[0].line
    assert line.endswith(f" 'data.input_size={input_size}'" * bool(input_size) + " data.max_depth=20")
    assert ("input_size" in line) == bool(input_size)


def test_the_command_takes_a_folder_alone(tmp_path: Path, run_command) -> None:
    RECORDERS["stray_scanner"].write(tmp_path / "my scan", (24, 32))
    done = run_command("check_data", "my scan")
    assert done.returncode == 0
    line = next(line for line in done.stdout.splitlines() if "data=folder" in line and "encoding" not in line)
    assert run_command("check_data", *shlex.split(line), "output=out").returncode == 0
    (tmp_path / "empty").mkdir()
    done = run_command("check_data", "empty")
    assert done.returncode == 1
    assert "color_0001.png, depth_0001.png" in done.stdout
    assert "proj_depth" in done.stdout
    done = run_command("check_data", "nowhere")
    assert (done.returncode, done.stderr) == (
        1,
        "error: nowhere is not a folder: give the folder of your recordings\n",
    )


def test_one_plausible_unit_is_not_taken_for_granted(tmp_path: Path, capsys) -> None:
    """Centimeters are plausible as KITTI's 1/256 m, which is 2.56 times too near."""
    (tmp_path / "depth").mkdir()
    for number, warned in ((200, 1), (0, 0)):
        for i in range(3):
            recordings.picture(tmp_path / f"rgb/{i}.png", i)
            cv2.imwrite(str(tmp_path / f"depth/{i}.png"), np.full(SIZE, number, np.uint16))
        assert recognize_folder(tmp_path)
        said = capsys.readouterr().out
        assert said.count("half of all depth nearer than") == warned
        assert said.count("where a distance that you know disagrees") == warned


def test_scenes_behind_links_are_found_once(tmp_path: Path) -> None:
    for scene in ("a", "b"):
        recordings.picture(tmp_path / f"disk/{scene}/rgb/0.jpg", 0)
        recordings.depth(tmp_path / f"disk/{scene}/depth/0.png", 0, SIZE)
    root = tmp_path / "root"
    root.mkdir()
    for name, target in (
        ("kitchen", "disk/a"),
        ("office", "disk/b"),
        ("latest", "root/kitchen"),
        ("up", "."),
    ):
        (root / name).symlink_to(tmp_path / target)
    (found,) = recognize(root)
    assert found.facts[0] == "frames: 2"
    assert {"data.images=*/rgb", "data.depths=*/depth"} <= set(found.readings[0].settings)
    assert set(frames_of(found.readings[0].line)) == {"kitchen/0", "office/0"}


def test_notes_beside_pictures_change_nothing(tmp_path: Path) -> None:
    for i in range(3):
        recordings.picture(tmp_path / f"images/f{i}.png", i)
        recordings.depth(tmp_path / f"depths/f{i}.png", i, SIZE)
    recordings.text(tmp_path / "images/notes.txt", "dark")
    (found,) = recognize(tmp_path)
    assert found.title.endswith("paired by name")
    assert "data.images=images" in found.readings[0].settings


def test_pictures_of_16_bits_and_drawn_depth_are_explained(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "depths").mkdir()
    cv2.imwrite(str(tmp_path / "images/0.png"), np.ones((*SIZE, 3), np.uint16))
    cv2.imwrite(str(tmp_path / "depths/0.png"), np.ones((*SIZE, 3), np.uint8))
    (found,) = recognize(tmp_path)
    assert not found.readings
    assert "is it a color visualization?" in found.facts[0]
    assert "holds uint16, images must have 8 bits" in found.facts[1]


@pytest.mark.parametrize("inverse", [False, True])
def test_inverse_depth_is_asked_about(inverse: bool, tmp_path: Path, capsys) -> None:
    """Of a floor: 4 m away at the top, 1 m at the bottom."""
    depth = np.repeat(np.linspace(4, 1, SIZE[0], dtype=np.float32)[:, None], SIZE[1], 1)
    for i in range(6):
        recordings.picture(tmp_path / f"images/{i}.png", i)
        (tmp_path / "depths").mkdir(exist_ok=True)
        np.save(tmp_path / f"depths/{i}.npy", 1 / depth if inverse else depth)
    (found,) = recognize(tmp_path)
    check_data(
        compose(
            CheckDataSettings,
            ["data=folder", f"data.root={tmp_path}", "data.encoding=meters", f"output={tmp_path / 'out'}"],
        )
    )
    for said in (str(found.facts), capsys.readouterr().out):
        assert ("is it inverse depth or disparity?" in said) == inverse


def test_a_large_split_of_inverse_depth_is_asked_about_beside_good_ones() -> None:
    (line,) = inverse_doubts({"train": (5, 65), "val": (4, 2), "test": (30, 0)})
    assert line.startswith("test: in 30 of 30 frames the bottom is farther")
    assert not inverse_doubts({"train": (5, 65), "val": (6, 0)})


def test_a_few_neighboring_frames_are_not_asked_about(tmp_path: Path, capsys) -> None:
    """A block for validation may show a table before a near wall."""
    root = layouts.folder(tmp_path / "data", count=14)
    for i in range(14):
        rows = np.linspace(4000, 1000, SIZE[0]).astype(np.uint16)[:: -1 if i < 5 else 1, None]
        layouts.picture(root / f"depths/f{i:03d}.png", np.repeat(rows, SIZE[1], 1))
    names = [f"f{i:03d}" for i in range(5)]
    words = ["data=folder", f"data.root={root}", f"data.val_names={names}", f"output={tmp_path / 'out'}"]
    check_data(compose(CheckDataSettings, words))
    assert "disparity" not in capsys.readouterr().out


def test_another_unit_is_asked_about_where_several_known_ones_fit_too(tmp_path: Path) -> None:
    """Virtual KITTI's depth is in 16-bit centimeters, and could be 16-bit millimeters."""
    for i in range(3):
        recordings.picture(tmp_path / f"images/{i}.png", i)
        (tmp_path / "depths").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / f"depths/{i}.png"), np.full(SIZE, 3000, np.uint16))
    (found,) = recognize(tmp_path)
    assert len(found.readings) > 1
    assert "'data.encoding={scale: 0.01, dtype: uint16}' (centimeters)" in str(found.facts)


def test_pictures_in_color_come_before_masks(tmp_path: Path) -> None:
    color = np.zeros((*SIZE, 3), np.uint8)
    color[..., 2] = 200
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}_rgb.png"), color)
        cv2.imwrite(str(tmp_path / f"{i}_mask.png"), np.full(SIZE, 255, np.uint8))
        recordings.depth(tmp_path / f"{i}_depth.png", i, SIZE)
    ways = [found.readings[0].settings[2] for found in recognize(tmp_path)]
    assert ways == ["data.images=*_rgb.png", "data.images=*_mask.png"]


def test_nothing_is_written_beside_the_frames(tmp_path: Path) -> None:
    RECORDERS["prefixes"].write(tmp_path, SIZE)
    before = sorted(tmp_path.rglob("*"))
    assert recognize_folder(tmp_path)
    assert sorted(tmp_path.rglob("*")) == before

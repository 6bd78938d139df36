"""Rendered data sets: frames on disk that survive kills and damage, and are rendered only once."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from eldenet.data import rendered_scenes
from eldenet.data.arenas import Arenas
from eldenet.data.rooms import Rooms
from eldenet.data.scene_store import DEPTH_STEP, SceneStore, encode_depth, render_missing
from eldenet.data.streets import Streets
from eldenet.simulation.furnished_rooms.render import render_room
from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.textures import variants

SIZE = (32, 40)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rooms")


@pytest.fixture(scope="module")
def dataset(cache: Path) -> Rooms:
    return Rooms("train", 20, size=SIZE, root=cache, workers=0)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """The scenes that each data set asks to render."""
    found: list[list[int]] = []
    monkeypatch.setattr(
        rendered_scenes, "render_missing", lambda *arguments: found.append(list(arguments[3]))
    )
    return found


def test_samples_have_the_types_of_every_data_set(dataset: Rooms) -> None:
    sample = dataset[17]
    assert sample["name"] == "rooms/train/000002/1"
    shapes = {"image": (3, *SIZE), "depth": (1, *SIZE), "mask": (1, *SIZE), "intrinsics": (3, 3)}
    assert {key: tuple(sample[key].shape) for key in shapes} == shapes  # type: ignore[literal-required]
    assert (sample["image"].dtype, sample["mask"].dtype) == (torch.float32, torch.bool)
    assert 0 <= sample["image"].min() <= sample["image"].max() <= 1
    assert sample["mask"].float().mean() > 0.9
    known = sample["depth"][sample["mask"]]
    assert 0.1 <= known.min() <= known.max() <= 10
    assert (dataset.ground_truth, len(dataset)) == ("dense", 20)


def test_a_depth_camera_leaves_holes_and_the_picture_as_it_was(cache: Path, dataset: Rooms) -> None:
    measured = Rooms("train", 20, size=SIZE, root=cache, workers=0, depth_camera=True)
    exact, frame = dataset.load_frame(3), measured.load_frame(3)
    holes = frame.depth == 0
    assert 0.02 < holes.mean() < 0.4
    assert holes.all(axis=0).sum() == 1  # the dead column
    error = np.abs(frame.depth / exact.depth - 1)[~holes]
    assert 0 < np.median(error) < 0.05
    np.testing.assert_array_equal(frame.image, exact.image)
    np.testing.assert_array_equal(frame.depth, measured.load_frame(3).depth)
    assert not measured[3]["mask"][0][torch.from_numpy(holes)].any()
    assert measured.split_hash != dataset.split_hash


def test_a_depth_camera_measures_no_sky(cache: Path) -> None:
    frame = Streets("train", 1, size=SIZE, root=cache, workers=0, depth_camera=True).load_frame(0)
    sky = Streets("train", 1, size=SIZE, root=cache, workers=0).load_frame(0).depth == 0
    assert sky.any()
    assert not frame.depth[sky].any()
    assert np.isfinite(frame.depth).all()


def test_the_frames_that_results_were_scored_on_keep_their_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Rooms, "missing_scenes", lambda *_: [])
    monkeypatch.setattr(Rooms, "_open", lambda *_: None)
    hashes = {"train": (4096, "3bbc1b3fc2f5243a"), "test": (512, "cc0d255db05f8862")}
    for split, (frames, expected) in hashes.items():
        assert Rooms(split, frames, size=(96, 128)).split_hash == expected
    assert Rooms("test", 8, size=(96, 128)).folder.name == "rooms-v1-96x128-fd67c9271919"
    assert Rooms("test", 8, size=(96, 160)).folder.name == "rooms-v1-96x160"
    assert Rooms("test", 8, size=(96, 160), focal=[0.4, 2]).folder.name == "rooms-v1-96x160-focal-0.4-2"


def test_rooms_of_many_lenses_hand_over_each_focal_length(tmp_path: Path) -> None:
    rooms = Rooms("train", 16, size=SIZE, root=tmp_path, workers=2, focal=[0.4, 2.0])
    widths = [float(rooms[index]["intrinsics"][0, 0]) / SIZE[1] for index in range(16)]
    assert 0.4 <= min(widths) < 0.8 < 1.4 < max(widths) <= 2.0
    with pytest.raises(ValueError, match=r"focal=\[2.0, 0.4\]: give \[low, high\] in widths, from 0.2 to 5"):
        Rooms("train", 8, size=SIZE, root=tmp_path, focal=[2.0, 0.4])


@pytest.mark.slow
def test_near_rooms_show_what_is_close(tmp_path: Path) -> None:
    near = Rooms("train", 16, size=SIZE, root=tmp_path, workers=2, near=1)
    assert near.folder.name.startswith("rooms-near1-v1")
    medians = [float(np.median(near.load_frame(index).depth)) for index in range(16)]
    assert 0.25 < min(medians) < 0.6 < max(medians) < 1.5
    some = Rooms("train", 32, size=SIZE, root=tmp_path, workers=2, near=0.25)
    medians = [float(np.median(some.load_frame(index).depth)) for index in range(32)]
    assert 2 <= sum(median < 1.3 for median in medians) <= 16
    with pytest.raises(
        ValueError, match=r"near=0\.6, down=0\.6: give shares from 0 to 1, near and down together at most 1"
    ):
        Rooms("train", 8, size=SIZE, root=tmp_path, near=0.6, down=0.6)
    with pytest.raises(ValueError, match="near=1: streets has no such frames; rooms has"):
        Streets("train", 8, root=tmp_path, near=1)


def test_plain_rooms_have_the_same_depth_and_no_patterns(tmp_path: Path) -> None:
    rooms, plain = (render_room("train", 4, SIZE, detail=True, plain=share) for share in (0.0, 1.0))
    np.testing.assert_array_equal(rooms.depth, plain.depth)
    assert (rooms.image != plain.image).any(axis=-1).mean() > 0.5
    for seed in range(8):
        materials = Materials(Draw((seed,)), natural=True, plain=True)
        surfaces = [materials.floor, *materials.walls, *materials.woods, *materials.fabrics]
        assert {materials.palette.rows[number][9] for number in surfaces} <= set(variants("plain"))
    half = Rooms("train", 8, size=SIZE, root=tmp_path, workers=0, plain=0.5)
    assert half.folder.name.startswith("rooms-plain0.5-v1")
    with pytest.raises(
        ValueError, match="plain=2: give shares from 0 to 1, near and down together at most 1"
    ):
        Rooms("train", 8, size=SIZE, root=tmp_path, plain=2)


def test_rooms_that_look_down_show_the_floor(tmp_path: Path) -> None:
    views = render_room("train", 3, SIZE, focal=(0.7, 0.9), detail=True, down=1.0)
    below = np.median([depth[-1].mean() < depth[0].mean() for depth in views.depth])
    assert below == 1  # the lower border is nearer
    assert (views.rotation[:, 2, 2] < np.sin(-0.25)).all()  # the optical axis points down
    folder = Rooms("train", 8, size=SIZE, root=tmp_path, workers=0, down=0.5).folder
    assert folder.name.startswith("rooms-down0.5-v1")


def test_stored_depth_is_exact_to_a_tenth_of_a_millimeter(dataset: Rooms) -> None:
    views = render_room("train", 0, SIZE)
    near = views.depth[2] < 13.1
    frame = dataset.load_frame(2)
    np.testing.assert_allclose(frame.depth[near], views.depth[2][near], atol=DEPTH_STEP / 2 + 1e-6)
    np.testing.assert_array_equal(frame.image, views.image[2])
    np.testing.assert_array_equal(frame.intrinsics, views.intrinsics[2])
    assert encode_depth(np.array([0.0, -1.0, 20.0, 10.0])).tolist() == [0, 0, 0, 50000]


def test_only_missing_scenes_are_rendered(dataset: Rooms, cache: Path, asked: list[list[int]]) -> None:
    few = Rooms("train", 10, size=SIZE, root=cache)
    assert asked == []
    assert few.names == dataset.names[:10]
    Rooms("train", 40, size=SIZE, root=cache)
    Rooms("val", 10, size=SIZE, root=cache)
    assert asked == [[3, 4], [0, 1]]


def test_a_drawn_frame_is_the_one_of_its_name(dataset: Rooms, cache: Path) -> None:
    for span in ([0, 5], [5, 10]):
        drawn = Rooms("train", 20, size=SIZE, root=cache)
        drawn.draw_subset(span, seed=3)
        for index, name in enumerate(drawn.names):
            expected = dataset.load_frame(dataset.names.index(name))
            np.testing.assert_array_equal(drawn.load_frame(index).image, expected.image)
            assert drawn[index]["name"] == name
    rest = Rooms("train", 20, size=SIZE, root=cache)
    rest.leave_out({0: "dark"})
    np.testing.assert_array_equal(rest.load_frame(0).depth, dataset.load_frame(1).depth)


@pytest.mark.parametrize("damage", ["cut", "byte", "missing"])
def test_damaged_frames_are_rendered_again(dataset: Rooms, cache: Path, damage: str) -> None:
    file = dataset.folder / "train.frames"
    content = bytearray(file.read_bytes())
    start = 12 * dataset.store.frames.slot
    if damage == "missing":
        file.unlink()
    else:
        content[start + 5000] ^= 255
        file.write_bytes(content[: start + 9000] if damage == "cut" else content)
    again = Rooms("train", 20, size=SIZE, root=cache, workers=0)
    assert again.missing_scenes("train", 20) == []
    np.testing.assert_array_equal(again.load_frame(12).image, render_room("train", 1, SIZE).image[4])


def test_frames_that_may_only_be_read_are_read(dataset: Rooms, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = os.open

    def read_only(path: Path, flags: int, *mode: int) -> int:
        if flags & os.O_RDWR:
            raise PermissionError("read-only file system")
        return opened(path, flags, *mode)

    monkeypatch.setattr(os, "open", read_only)
    again = Rooms("train", 20, size=SIZE, root=dataset.folder.parent)
    np.testing.assert_array_equal(again.load_frame(5).image, dataset.load_frame(5).image)


def test_a_larger_data_set_grows_the_file_while_a_smaller_one_reads_it(tmp_path: Path) -> None:
    small = Rooms("val", 8, size=SIZE, root=tmp_path, workers=0)
    image = small.load_frame(3).image
    large = Rooms("val", 16, size=SIZE, root=tmp_path, workers=0)
    Rooms("val", 8, size=SIZE, root=tmp_path)
    np.testing.assert_array_equal(small.load_frame(3).image, image)
    assert large.load_frame(15).image.shape == (*SIZE, 3)


def test_render_processes_write_what_this_process_would(tmp_path: Path, dataset: Rooms) -> None:
    render_missing(tmp_path, Rooms.generator, "train", [0, 1], SIZE, workers=2)
    ours = SceneStore(tmp_path, "rooms", "train", 2, SIZE)
    for index in range(16):
        for mine, theirs in zip(ours.frame(index)[:3], dataset.load_frame(index)[:3], strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_a_failing_render_process_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RuntimeError, match="render process"):
        render_missing(tmp_path / "file", Rooms.generator, "train", [0], SIZE, workers=1)


@pytest.mark.parametrize(
    "bad",
    [
        {"split": "training"}, {"size": (8, 160)}, {"size": (128,)},
        {"max_depth": 20.0}, {"min_depth": 5.0, "max_depth": 1.0}, {"workers": -1},
    ],
)  # fmt: skip
def test_arguments_out_of_range_are_refused(bad: dict, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="give"):
        Rooms(root=tmp_path, **bad)


def test_every_version_and_size_has_a_folder_of_its_own() -> None:
    generators = (Rooms.generator, Arenas.generator, Arenas.generator._replace(version=2))
    assert len({generator.folder_name(size) for generator in generators for size in (SIZE, (36, 52))}) == 6


@pytest.mark.parametrize(
    ("module", "heavy"), [("rooms", ("mujoco", "cv2")), ("scene_store", ("torch", "mujoco", "cv2"))]
)
def test_reading_loads_no_renderer_and_a_render_process_no_torch(module: str, heavy: tuple[str, ...]) -> None:
    code = f"import sys, eldenet.data.{module}; assert not {set(heavy)} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])

"""Frames of arenas for depth networks: whose arenas, what camera, true depth, who is in the picture."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from eldenet.compose import compose
from eldenet.data.arenas import Arenas
from eldenet.data.scene_store import DEPTH_STEP
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.simulation import arena_view
from eldenet.simulation.arena_view import FIRST_ARENA, ArenaView, camera_pose, render_arena
from eldenet.simulation.arenas import Arena, generate_arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT
from eldenet.train import TrainSettings

SIZE = (36, 48)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("arenas")


@pytest.fixture(scope="module")
def dataset(root):
    return Arenas("train", 10, size=SIZE, root=root, workers=0)


def test_frames_are_of_the_training_stream_alone_and_of_no_arena_twice(monkeypatch):
    asked = []

    def note(split, density, index, *, pedestrians):
        asked.append((split, index))
        return generate_arena(split, 0, 0)

    monkeypatch.setattr(arena_view, "generate_arena", note)
    for split in FIRST_ARENA:
        for index in (0, 1, 999_999):
            render_arena(split, index, (16, 16), views=1)
    assert {split for split, _ in asked} == {"train"}
    assert len({index for _, index in asked}) == 9


@pytest.mark.parametrize(("split", "index", "message"), [
    ("train", 1_000_000, "index=1000000: give 0 to 999999"),  # validation's first one
    ("val", -1, "index=-1: give 0"),
    ("valid", 0, "split='valid': give one of train, val, test"),
])  # fmt: skip
def test_arenas_of_no_split_are_refused(split, index, message):
    with pytest.raises(ValueError, match=message):
        render_arena(split, index, (16, 16), views=1)


def test_a_frame_is_the_same_twice_and_seen_by_the_robot_s_camera():
    first, second = render_arena("val", 3, SIZE, views=2), render_arena("val", 3, SIZE, views=2)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)
    assert (first.position[:, 2] == ROBOT.camera_height).all()
    np.testing.assert_allclose(first.rotation[:, 2, 2], 0, atol=1e-12)  # level
    half = math.degrees(math.atan(SIZE[1] / 2 / first.intrinsics[0, 0, 0]))
    assert 2 * half == pytest.approx(69.4)
    assert not (first.image[0] == first.image[1]).all()


def test_light_goes_from_dim_to_bright_and_people_walk(monkeypatch):
    lights, movers = [], []

    class Dark(ArenaView):
        def __init__(self, arena, size, *, light=1.0, detail=False):
            if size != (9, 16):
                lights.append(light)
                movers.append(len(arena.pedestrians))
            super().__init__(arena, size, light=light, detail=detail)

    monkeypatch.setattr(arena_view, "ArenaView", Dark)
    for index in range(12):
        render_arena("train", index, (16, 16), views=1)
    assert 0.05 <= min(lights) < 0.3
    assert 1.0 < max(lights) <= 3.0
    assert 0 < sum(count > 0 for count in movers) < 12


def test_robots_stand_where_they_fit(dataset):
    for index in range(4):
        views = render_arena("train", index, (16, 16), views=4)
        assert (np.abs(views.position[:, :2]) < 10).all()
        assert (views.depth > 0).all()
        assert views.depth.max() < 40


def test_the_robots_camera_has_one_lens(root):
    with pytest.raises(ValueError, match=r"focal=\[0.4, 2.0\]: the camera of arenas has one lens"):
        Arenas("train", 10, size=SIZE, root=root, workers=0, focal=[0.4, 2.0])


def test_the_data_set_reads_what_was_rendered(dataset):
    views = render_arena("train", 1, SIZE)
    frame = dataset.load_frame(9)
    assert frame.name == "arenas/train/000001/1"
    np.testing.assert_array_equal(frame.image, views.image[1])
    near = views.depth[1] < 13
    np.testing.assert_allclose(frame.depth[near], views.depth[1][near], atol=DEPTH_STEP)
    sample = dataset[9]
    assert sample["depth"][sample["mask"]].max() <= 10


@pytest.mark.slow
def test_data_arenas_composes_builds_and_can_be_scored(root):
    small = ["data=arenas", f"data.root={root}", f"data.size={list(SIZE)}", f"data.input_size={list(SIZE)}"]
    config = compose(TrainSettings, [*small, "data.frames={train: 8, val: 8, test: 8}"])
    protocol = chosen_protocol(config.data, config.protocol)
    assert protocol.name == "arenas"
    splits = {name: open_split(config.data, name, protocol) for name in ("train", "val", "test")}
    assert len({name for split in splits.values() for name in split.names}) == 24
    sample = splits["test"][0]
    assert protocol.valid_mask(sample["depth"][None], sample["mask"][None]).float().mean() > 0.3


def test_the_view_knows_which_obstacle_each_pixel_shows():
    """Against a ray of MuJoCo's per pixel, in a model of that one obstacle alone."""
    path = ((2.0, 1.0), (2.0, -1.0))
    obstacles = (
        Obstacle("person", 3.0, 1.2, 0.0, (0.25, 0.25), 1.7),
        Obstacle("person", 2.0, 1.0, 0.0, (0.25, 0.25), 1.7, path, 0.5),
        Obstacle("vehicle", 4.0, -1.0, 0.4, (0.6, 0.35), 0.6),
        Obstacle("box", 2.5, 0.3, 0.2, (0.3, 0.3), 0.8),
    )
    arena = Arena("", 3, 0, obstacles, (0.0, 0.0, 0.0), ((5.0, 0.0),))
    view = ArenaView(arena, SIZE)
    photo = view.photo(arena.start, time=3.0)
    assert set(np.unique(photo.obstacle)) == {-1, 0, 1, 2, 3}
    center, rotation = camera_pose(arena.start)
    for number, obstacle in enumerate(obstacles):
        x, y = obstacle.position(3.0)
        alone = replace(obstacle, x=x, y=y, path=())
        other = ArenaView(Arena("", 1, 0, (alone,), arena.start, arena.waypoints), SIZE)
        geom = np.zeros(1, np.int32)
        depth = np.array(
            [
                mujoco.mj_ray(other.room.model, other.room.data, center, ray, None, 1, -1, geom) * ray[0]
                for ray in view.camera.rays(rotation)
            ]
        ).reshape(SIZE)
        mine = photo.obstacle == number
        np.testing.assert_allclose(photo.depth[mine], depth[mine], atol=1e-4)
        assert mine.sum() > 5


def test_a_camera_that_is_mounted_upside_down_sees_the_same_upside_down():
    arena = generate_arena("train", 20, 0)
    view = ArenaView(arena, SIZE)
    center, rotation = camera_pose(arena.start)
    turned = view.photo(arena.start, camera=(center, rotation @ np.diag([-1.0, -1.0, 1.0])))
    np.testing.assert_allclose(turned.depth[::-1, ::-1], view.photo(arena.start).depth, rtol=1e-4)

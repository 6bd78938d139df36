"""The built-in rooms: seeded text, exact depth, a cache that survives kills and damage."""

import hashlib
import json
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from eldenet.data import rendered
from eldenet.data.rooms import Rooms
from eldenet.data.shards import DEPTH_STEP, encode_depth, is_whole, open_shard, shard_folder, write_shard
from eldenet.data.statistics import depth_statistics
from eldenet.geometry import back_project, pinhole
from eldenet.simulation.furnished_rooms.render import render_room
from eldenet.simulation.furnished_rooms.rooms import SPLITS, generate_room
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.mjcf import Draw, number
from eldenet.simulation.rendering.textures import atlas, variants

SIZE = (32, 40)
INTRINSICS = pinhole(33.0, 35.0, 18.5, 15.0)
GOLDEN = "38220f7cc199810b1b2400f75ed11dd6220cf189aeeda4a0a7de4bf0076ce6cf"


def compiled(text: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


# --- the generator


def test_a_seed_names_one_text():
    first, second = generate_room("train", 0), generate_room("train", 0)
    assert first.text == second.text
    assert hashlib.sha256(first.text.encode()).hexdigest() == GOLDEN


def test_splits_and_rooms_differ():
    texts = {generate_room(split, index).text for split in ("train", "val", "test") for index in range(4)}
    assert len(texts) == 12
    assert tuple(SPLITS) == rendered.SPLITS


def test_every_room_compiles_and_is_furnished():
    for index in range(12):
        room = generate_room("val", index)
        model, _ = compiled(room.text)
        assert model.ngeom > 20
        assert model.numeric_data.size % 15 == 0
        assert 1.5 <= room.size[0] <= 12
        assert 2.0 < room.size[2] < 4.5


@pytest.mark.parametrize(("split", "index"), [("training", 0), ("train", -1)])
def test_bad_room(split, index):
    with pytest.raises(ValueError, match=r"split=|index="):
        generate_room(split, index)


def test_numbers_and_draws():
    assert number(-0.00001) == "0.0000"
    assert number(1.23456) == "1.2346"
    draw = Draw((1, 2))
    assert 0 <= draw.unit() < 1
    assert {draw.integer(1, 3) for _ in range(100)} == {1, 2, 3}
    with pytest.raises(ValueError, match="no texture family"):
        variants("lava")
    assert variants("foliage")[-1] == atlas().count - 1


# --- the camera


def test_depth_of_a_plane_is_along_the_axis():
    model, data = compiled(
        '<mujoco><worldbody><geom type="plane" size="0 0 1" pos="3 0 0" zaxis="-1 0 0"/></worldbody></mujoco>'
    )
    camera = RayCamera(SIZE, INTRINSICS)
    depth = camera.cast(model, data, np.array([0.5, 0.0, 1.0]), camera_rotation(0.0)).depth
    np.testing.assert_allclose(depth, 2.5, atol=1e-6)  # not the length of the ray, which grows off axis


def test_a_box_lands_on_its_pixels():
    model, data = compiled(
        '<mujoco><worldbody><body pos="2 0 0"><geom type="box" size=".5 .2 .1"/></body></worldbody></mujoco>'
    )
    camera = RayCamera((41, 61), pinhole(60.0, 60.0, 30.0, 20.0))
    depth = camera.cast(model, data, np.zeros(3), camera_rotation(0.0)).depth.reshape(41, 61)
    rows, cols = np.nonzero(depth)
    # front face at 1.5 m: half widths 60 * .2 / 1.5 = 8 and 60 * .1 / 1.5 = 4 pixels around (30, 20)
    assert (cols.min(), cols.max(), rows.min(), rows.max()) == (22, 38, 16, 24)
    np.testing.assert_allclose(depth[rows, cols], 1.5, atol=1e-6)


def test_floor_points_lie_on_the_floor():
    model, data = compiled('<mujoco><worldbody><geom type="plane" size="0 0 1"/></worldbody></mujoco>')
    position, rotation = np.array([0.3, -0.2, 1.4]), camera_rotation(0.7, pitch=-0.9, roll=0.2)
    depth = RayCamera(SIZE, INTRINSICS).cast(model, data, position, rotation).depth.reshape(SIZE)
    points = back_project(depth, INTRINSICS) @ rotation.T + position
    assert (depth > 0).all()
    np.testing.assert_allclose(points[..., 2], 0.0, atol=1e-5)


def test_rotation_is_a_rotation_and_looks_where_told():
    rotation = camera_rotation(np.pi / 2, pitch=0.3, roll=-0.1)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[:, 2], [0, np.cos(0.3), np.sin(0.3)], atol=1e-12)
    np.testing.assert_allclose(camera_rotation(0.0)[:, 0], [0, -1, 0], atol=1e-12)  # y points left of x


def test_culling_leaves_out_nothing_in_view_and_restores_the_model():
    for index in range(4):
        model, data = compiled(generate_room("train", index).text)
        before = model.geom_group.copy(), model.body_geomnum.copy(), model.body_bvhadr.copy()
        camera = RayCamera(SIZE, INTRINSICS)
        position, rotation = np.array([0.1, 0.2, 1.3]), camera_rotation(index * 1.3, -0.2, 0.05)
        hits = camera.cast(model, data, position, rotation)
        geom = np.zeros(1, np.int32)
        for pixel in range(0, SIZE[0] * SIZE[1], 7):
            ray = camera.rays(rotation)[pixel]
            distance = mujoco.mj_ray(model, data, position, ray, None, 1, -1, geom)
            assert hits.depth[pixel] == pytest.approx(max(0.0, distance * (rotation[:, 2] @ ray)), abs=1e-6)
        after = model.geom_group, model.body_geomnum, model.body_bvhadr
        assert all((a == b).all() for a, b in zip(after, before, strict=True))


def test_a_frame_is_the_same_twice_and_its_depth_that_of_the_room():
    first, second = render_room("train", 3, SIZE, views=2), render_room("train", 3, SIZE, views=2)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)
    assert first.image.std() > 10
    model, data = compiled(generate_room("train", 3).text)
    for view in range(2):
        camera = RayCamera(SIZE, first.intrinsics[view])
        depth = camera.cast(model, data, first.position[view], first.rotation[view]).depth
        np.testing.assert_allclose(depth, first.depth[view].ravel(), atol=1e-6)


# --- the data set


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("rooms")


@pytest.fixture(scope="module")
def dataset(cache):
    return Rooms("train", 70, size=SIZE, root=cache, workers=0)


def test_sample_types(dataset):
    sample = dataset[65]
    assert sample["name"] == "rooms/train/000008/1"
    assert sample["image"].shape == (3, *SIZE)
    assert sample["image"].dtype == torch.float32
    assert sample["depth"].shape == (1, *SIZE)
    assert sample["depth"].dtype == torch.float32
    assert sample["mask"].shape == (1, *SIZE)
    assert sample["mask"].dtype == torch.bool
    assert sample["intrinsics"].shape == (3, 3)
    assert sample["image"].min() >= 0
    assert sample["image"].max() <= 1
    assert sample["mask"].float().mean() > 0.9
    assert dataset.ground_truth == "dense"
    assert len(dataset) == 70
    known = sample["depth"][sample["mask"]]
    assert known.min() >= 0.1
    assert known.max() <= 10


def test_stored_depth_keeps_a_tenth_of_a_millimeter(dataset):
    views = render_room("train", 0, SIZE)
    near = views.depth[2] < 13.1
    np.testing.assert_allclose(dataset.load_frame(2).depth[near], views.depth[2][near], atol=DEPTH_STEP)
    np.testing.assert_array_equal(dataset.load_frame(2).image, views.image[2])
    assert encode_depth(np.array([0.0, -1.0, 20.0, 10.0])).tolist() == [0, 0, 0, 50000]


def test_fewer_and_more_frames_reuse_shards(dataset, cache, monkeypatch):
    asked = []
    monkeypatch.setattr(rendered, "render_missing", lambda *args: asked.append(list(args[3])))
    few = Rooms("train", 10, size=SIZE, root=cache)
    assert not asked
    assert few.names == dataset.names[:10]
    Rooms("train", 200, size=SIZE, root=cache)
    assert asked == [[2, 3]]
    Rooms("val", 10, size=SIZE, root=cache)
    assert asked[-1] == [0]


def test_a_drawn_frame_is_the_one_of_its_name(dataset, cache):
    draws = {}
    for span in ([0, 5], [5, 10]):
        drawn = Rooms("train", 70, size=SIZE, root=cache)
        drawn.draw_subset(span, seed=3)
        draws |= {drawn.names[i]: (drawn.load_frame(i).image, drawn[i]) for i in range(5)}
    assert len(draws) == 10
    for name, (image, sample) in draws.items():
        np.testing.assert_array_equal(image, dataset.load_frame(dataset.names.index(name)).image)
        assert sample["name"] == name
    rest = Rooms("train", 70, size=SIZE, root=cache)
    rest.leave_out({0: "dark"})
    np.testing.assert_array_equal(rest.load_frame(0).depth, dataset.load_frame(1).depth)


@pytest.mark.parametrize("damage", ["cut", "byte", "missing", "half"])
def test_damaged_shards_are_rendered_again(dataset, cache, damage):
    folder = shard_folder(dataset.folder, "train", 1)
    whole = np.array(open_shard(folder)[0])
    image = folder / "image.npy"
    if damage == "cut":
        image.write_bytes(image.read_bytes()[:-100])
    elif damage == "byte":
        content = bytearray(image.read_bytes())
        content[5000] ^= 255
        image.write_bytes(content)
    elif damage == "missing":
        image.unlink()
    else:
        (folder / "shard.json").write_text("{")
    assert not is_whole(folder)
    again = Rooms("train", 70, size=SIZE, root=cache, workers=0)
    assert is_whole(folder)
    np.testing.assert_array_equal(open_shard(folder)[0], whole)
    assert again.load_frame(69).image.shape == (*SIZE, 3)
    assert not [p for p in folder.parent.iterdir() if p.name.startswith(".")]


def test_a_render_process_continues_where_another_stopped(tmp_path, dataset):
    """The worker process renders what is missing and leaves whole shards alone."""
    done = shard_folder(tmp_path, "train", 0)
    write_shard(
        done,
        dict(
            zip(
                ("image", "depth", "intrinsics"),
                open_shard(shard_folder(dataset.folder, "train", 0)),
                strict=True,
            )
        ),
    )
    stamp = (done / "image.npy").stat().st_mtime_ns
    rendered.render_missing(tmp_path, Rooms.generator, "train", [0, 1], SIZE, workers=1)
    assert (done / "image.npy").stat().st_mtime_ns == stamp
    ours, theirs = shard_folder(tmp_path, "train", 1), shard_folder(dataset.folder, "train", 1)
    assert json.loads((ours / "shard.json").read_text()) == json.loads((theirs / "shard.json").read_text())


def test_a_failing_render_process_is_an_error(tmp_path):
    (tmp_path / "train").write_text("in the way")
    with pytest.raises(RuntimeError, match="render process"):
        rendered.render_missing(tmp_path, Rooms.generator, "train", [0], SIZE, workers=1)


def test_pickled_data_sets_open_their_own_maps(dataset):
    import pickle

    dataset.load_frame(0)
    copy = pickle.loads(pickle.dumps(dataset))
    assert not copy._open
    np.testing.assert_array_equal(copy.load_frame(5).image, dataset.load_frame(5).image)


@pytest.mark.parametrize(
    "bad",
    [
        {"split": "training"}, {"frames": 0}, {"frames": 2.5}, {"size": (8, 160)}, {"size": (128,)},
        {"max_depth": 20.0}, {"min_depth": 5.0, "max_depth": 1.0}, {"workers": -1},
    ],
)  # fmt: skip
def test_bad_arguments(bad, tmp_path):
    with pytest.raises(ValueError, match=r"give|splits"):
        Rooms(root=tmp_path, **bad)


def test_statistics(dataset):
    numbers = depth_statistics(dataset, frames=16)
    assert numbers.frames == 16
    assert 0.2 < numbers.p5 < numbers.median < numbers.p95 < 10
    assert 0.01 < numbers.gradient < 0.5
    assert numbers.known > 0.9
    with pytest.raises(ValueError, match="at least 1"):
        depth_statistics(dataset, frames=0)


def test_the_cache_can_be_named_by_the_environment(dataset, cache, monkeypatch):
    monkeypatch.setenv("ELDENET_CACHE", str(cache))
    assert Rooms("train", 3, size=SIZE).folder == dataset.folder


def test_reading_needs_no_mujoco():
    code = "import sys, eldenet.data.rooms; assert 'mujoco' not in sys.modules and 'cv2' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])

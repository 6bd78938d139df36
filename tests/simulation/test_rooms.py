"""The built-in rooms: the same text on every machine, exact depth."""

import hashlib

import mujoco
import numpy as np
import pytest

from eldenet.data.splits import SPLITS as DATA_SPLITS
from eldenet.geometry import back_project, pinhole
from eldenet.simulation.furnished_rooms.render import render_room
from eldenet.simulation.furnished_rooms.rooms import SPLITS, generate_room
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation

SIZE = (32, 40)
INTRINSICS = pinhole(33.0, 35.0, 18.5, 15.0)
GOLDEN = "fb13b62a54a614f2c6e01c3aba92f381edbab36cb1e32848d4d5423b2f95cb9f"


def compiled(text: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def test_the_text_of_a_room_never_changes():
    assert hashlib.sha256(generate_room("train", 0).text.encode()).hexdigest() == GOLDEN


def test_no_two_rooms_are_alike_in_or_across_splits():
    texts = {generate_room(split, index).text for split in ("train", "val", "test") for index in range(4)}
    assert len(texts) == 12
    assert tuple(SPLITS) == DATA_SPLITS


def test_every_room_compiles_and_is_furnished():
    for index in range(12):
        room = generate_room("val", index)
        model, _ = compiled(room.text)
        assert model.ngeom > 20
        assert model.numeric_data.size % 15 == 0
        assert 1.5 <= room.size[0] <= 12
        assert 2.0 < room.size[2] < 4.5


def test_a_box_covers_the_pixels_that_it_projects_to():
    model, data = compiled(
        '<mujoco><worldbody><body pos="2 0 0"><geom type="box" size=".5 .2 .1"/></body></worldbody></mujoco>'
    )
    camera = RayCamera((41, 61), pinhole(60.0, 60.0, 30.0, 20.0))
    depth = camera.cast(model, data, np.zeros(3), camera_rotation(0.0)).depth.reshape(41, 61)
    rows, cols = np.nonzero(depth)
    # front face at 1.5 m: half widths 60 * .2 / 1.5 = 8 and 60 * .1 / 1.5 = 4 pixels around (30, 20)
    assert (cols.min(), cols.max(), rows.min(), rows.max()) == (22, 38, 16, 24)
    np.testing.assert_allclose(depth[rows, cols], 1.5, atol=1e-6)


def test_back_projected_floor_points_lie_on_the_floor():
    model, data = compiled('<mujoco><worldbody><geom type="plane" size="0 0 1"/></worldbody></mujoco>')
    position, rotation = np.array([0.3, -0.2, 1.4]), camera_rotation(0.7, pitch=-0.9, roll=0.2)
    depth = RayCamera(SIZE, INTRINSICS).cast(model, data, position, rotation).depth.reshape(SIZE)
    points = back_project(depth, INTRINSICS) @ rotation.T + position
    assert (depth > 0).all()
    np.testing.assert_allclose(points[..., 2], 0.0, atol=1e-5)


def test_yaw_pitch_and_roll_give_a_rotation():
    rotation = camera_rotation(np.pi / 2, pitch=0.3, roll=-0.1)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[:, 2], [0, np.cos(0.3), np.sin(0.3)], atol=1e-12)
    np.testing.assert_allclose(camera_rotation(0.0)[:, 0], [0, -1, 0], atol=1e-12)  # y points left of x


def test_culling_hides_nothing_in_view_and_restores_the_model():
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


def test_the_depth_of_frames_is_exact():
    views = render_room("train", 3, SIZE, views=2)
    model, data = compiled(generate_room("train", 3).text)
    for view in range(2):
        camera = RayCamera(SIZE, views.intrinsics[view])
        depth = camera.cast(model, data, views.position[view], views.rotation[view]).depth
        np.testing.assert_allclose(depth, views.depth[view].ravel(), atol=1e-6)

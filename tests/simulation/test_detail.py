"""Renders with ``detail``: light that bounces, sun, shade where things touch, what stands there."""

import numpy as np
import pytest

from eldenet.data.arenas import Arenas
from eldenet.data.rooms import Rooms
from eldenet.data.streets import Streets
from eldenet.geometry import pinhole
from eldenet.simulation.arena_view import ArenaView, camera_pose
from eldenet.simulation.arenas import generate_arena
from eldenet.simulation.rendering.bounced_light import Sun, contact_shade
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.camera_noise import develop_photo
from eldenet.simulation.rendering.mjcf import Body, Draw, Palette
from eldenet.simulation.rendering.shading import CompiledRoom, Room
from eldenet.simulation.rendering.textures import variants

SIZE = (48, 64)
CAMERA = RayCamera(SIZE, pinhole(40.0, 40.0, 31.5, 23.5))
POSE = np.array([0.0, -1.5, 1.5]), camera_rotation(np.pi / 2, -0.6)  # looks along y at floor and far wall


def box_room(wall=(0.7, 0.7, 0.7), *, box=False, detail=True, suns=()):
    """A gray room of 4 x 4 x 2.5 m with one lamp; its left wall has a color of its own."""
    palette, plain, shell = Palette(), variants("plain")[0], Body()
    gray, left = (palette.add([color], plain, 1.0) for color in ((0.6, 0.6, 0.6), wall))
    sides = (
        (0, 0, 0, 0, 0, 1),
        (0, 0, 2.5, 0, 0, -1),
        (2, 0, 0, -1, 0, 0),
        (0, 2, 0, 0, -1, 0),
        (0, -2, 0, 0, 1, 0),
    )
    for x, y, z, *normal in sides:
        shell.plane((x, y, z), normal, gray)
    shell.plane((-2, 0, 0), (1, 0, 0), left)
    if box:
        shell.box((0.0, 0.8, 0.0), (0.6, 0.6, 0.6), gray)
    text = f"<mujoco>{palette.assets()}<worldbody>{''.join(shell.geoms)}</worldbody></mujoco>"
    lights = [(0.0, 0.0, 2.2, 1.0, 1.0, 1.0, 2.0)]
    return CompiledRoom(
        Room("room", (4.0, 4.0, 2.5), text, lights, ambient=0.1, suns=list(suns), detail=detail)
    )


def test_a_red_wall_reddens_the_floor():
    redness = {}
    for detail in (True, False):
        light, hits = box_room(wall=(0.8, 0.05, 0.05), detail=detail).photograph(CAMERA, *POSE)
        floor = hits.normal.reshape(3, *SIZE)[2] > 0.9
        redness[detail] = (light[..., 0] / light[..., 2])[floor]
    assert redness[True].min() > 1.0
    assert redness[True].mean() > 1.03
    np.testing.assert_allclose(redness[False], 1.0, atol=1e-4)


def test_it_is_darker_where_a_box_meets_the_floor():
    room = box_room(box=True)
    hits = CAMERA.cast(room.model, room.data, *POSE)
    shade = contact_shade(hits, SIZE)
    floor = (hits.normal[2] > 0.9) & (hits.point[2] < 0.01)
    front = floor & (np.abs(hits.point[0]) < 0.25)
    touching, away = front & (np.abs(hits.point[1] - 0.45) < 0.05), front & (hits.point[1] < 0)
    assert shade[touching].mean() < 0.9 * shade[away].mean()
    assert 0.2 <= shade.min() <= shade.max() <= 1.0


def test_the_sun_lights_what_it_sees_through_the_window_alone():
    down = np.array([0.0, 1.0, 1.0]) / np.sqrt(2)  # from the far wall, 45 degrees down
    sun = Sun((0.0, 1.99, 1.5), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), tuple(down), (0.4, 0.3), 3.0)
    (with_sun, hits), (without, _) = (box_room(suns=suns).photograph(CAMERA, *POSE) for suns in ([sun], []))
    gain = (with_sun - without).sum(axis=2).ravel()
    floor = (hits.normal[2] > 0.9) & (hits.point[2] < 0.01)
    patch = floor & (np.abs(hits.point[0]) < 0.35) & (np.abs(hits.point[1] - 0.5) < 0.2)
    assert gain[patch].mean() > 0.5
    assert np.abs(gain[floor & (np.abs(hits.point[0]) > 0.6)]).max() < 1e-6
    assert np.abs(gain[floor & (hits.point[1] < 0.0)]).max() < 1e-6


def test_a_photo_burns_out_and_keeps_its_noise_to_its_seed():
    linear = np.full((*SIZE, 3), 0.2, np.float32)
    linear[:, 40:] = 30.0
    first, again, other = (develop_photo(linear.copy(), Draw((1,)), (seed,)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first[:, 48:].mean() > 240 > first[:, :32].mean()


def test_a_detailed_arena_knows_its_obstacles_and_walks_its_people():
    arena = generate_arena("train", 40, 5, pedestrians=3)
    view, seen = ArenaView(arena, SIZE, detail=True), set()
    for time, heading in ((0.0, 0.0), (0.0, 1.5), (7.0, 3.0), (7.0, -1.5)):
        pose = (*arena.start[:2], heading)
        photo = view.photo(pose, time)
        center, rotation = camera_pose(pose)
        points = (
            view.camera.rays(rotation)
            * (photo.depth.ravel() / (view.camera.rays(rotation) @ rotation[:, 2]))[:, None]
        )
        x, y, _ = (points + center).T
        for number in np.unique(photo.obstacle[photo.obstacle >= 0]):
            mine, obstacle = photo.obstacle.ravel() == number, arena.obstacles[number]
            away = np.hypot(*(np.stack([x, y])[:, mine] - np.array(obstacle.position(time))[:, None]))
            assert away.max() < obstacle.radius + 0.7  # a person's stride, a plant's leaves
            seen.add(arena.obstacles[number].kind)
    assert {"person", "box"} & seen


@pytest.mark.parametrize("kind", [Rooms, Streets, Arenas])
def test_detail_has_a_folder_and_a_split_of_its_own(kind, tmp_path):
    plain, detailed = (
        kind("val", 8, size=(24, 32), root=tmp_path, workers=0, detail=on) for on in (False, True)
    )
    assert plain.folder != detailed.folder
    assert plain.split_hash != detailed.split_hash
    assert plain.names == detailed.names
    assert not np.array_equal(plain.load_frame(0).image, detailed.load_frame(0).image)

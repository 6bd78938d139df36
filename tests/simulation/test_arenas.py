"""Arenas: the same on every machine, passable, and one geometry for maps, contacts and rays."""

import math

import numpy as np
import pytest
from scipy.ndimage import label

from eldenet.navigation.planners.paths import inflated_cost, optimal_length, shortest_path
from eldenet.simulation.arena_mjcf import arena_mjcf
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import (
    GOAL_CLEARANCE,
    INFLATION,
    RESOLUTION,
    START_CLEARANCE,
    Arena,
    arenas_hash,
    clearance_map,
    generate_arena,
    triangle_course,
)
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT, arc

# The first five test arenas of every density: if one changes, it is another test set.
FROZEN = {
    5: "ad03ed89d278e610dfee55fd76bc9873f20fa2ce291a860497e4b9d5f4a0ffc3",
    20: "41f55481d11a14f1db86411a907d12454b65b588429b5124f4db81efef5b93c6",
    40: "787ea7fa5dbb8b0b9b790786d35ebedf9fe71418f8850e2661a8894201f4fe31",
    80: "54872e083deb022412eebb250b5517235bfe85b7e1cbedf119d75fa94aba4ef1",
}


def outline(obstacle: Obstacle, count: int = 400) -> np.ndarray:
    """Points on the footprint's edge: an independent reference."""
    turn = np.linspace(0, 2 * math.pi, count, endpoint=False)
    if obstacle.round:
        local = obstacle.half[0] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    else:
        corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1), (1, 1)]) * obstacle.half
        at = np.linspace(0, 4, count, endpoint=False)
        local = np.stack([np.interp(at, range(5), corners[:, k]) for k in (0, 1)], axis=1)
        c, s = math.cos(obstacle.yaw), math.sin(obstacle.yaw)
        local = local @ np.array([[c, s], [-s, c]])
    return local + np.array([obstacle.x, obstacle.y])


@pytest.mark.parametrize("density", [5, 20, 40, 80])
def test_the_test_arenas_are_frozen(density):
    arenas = [generate_arena("test", density, index) for index in range(5)]
    assert arenas_hash(arenas) == FROZEN[density]
    assert arenas_hash(arenas[:4]) != FROZEN[density]


def test_no_arena_is_in_two_splits():
    arenas = [generate_arena(split, 20, index) for split in ("train", "val", "test") for index in range(3)]
    assert len({arena_mjcf(arena) for arena in arenas}) == 9


@pytest.mark.parametrize("density", [5, 80])
def test_the_goal_is_far_from_obstacles_and_reachable(density):
    for index in range(3):
        arena = generate_arena("val", density, index)
        points = [outline(obstacle) for obstacle in arena.obstacles]
        for i, first in enumerate(arena.obstacles):
            assert np.abs(points[i]).max() < 10.0
            for second in arena.obstacles[:i]:
                assert math.hypot(first.x - second.x, first.y - second.y) > first.radius + second.radius
        start, goal = np.array(arena.start[:2]), np.array(arena.waypoints[0])
        assert np.hypot(*(start - goal)) >= 10.0
        away = [min(np.hypot(*(p - at).T).min() for p in points) for at in (start, goal)]
        assert away[0] > START_CLEARANCE - 0.02
        assert away[1] > GOAL_CLEARANCE - 0.02
        regions, _ = label(clearance_map(arena.obstacles) >= INFLATION)
        cells = [tuple(((at[::-1] + 10) / RESOLUTION).astype(int)) for at in (start, goal)]
        assert regions[cells[0]] == regions[cells[1]] > 0
        assert optimal_length(arena) >= np.hypot(*(start - goal)) - 2 * RESOLUTION


def test_clearance_is_the_distance_to_the_shapes():
    arena = generate_arena("val", 40, 1)
    clearance = clearance_map(arena.obstacles)
    edges = np.concatenate([outline(obstacle) for obstacle in arena.obstacles])
    rng = np.random.default_rng(0)
    compared = 0
    for row, column in rng.integers(0, 200, (300, 2)):
        at = np.array([(column + 0.5) * 0.1 - 10, (row + 0.5) * 0.1 - 10])
        expected = min(np.hypot(*(edges - at).T).min(), 10 - np.abs(at).max())
        if 0 < clearance[row, column] < 1.5:
            assert clearance[row, column] == pytest.approx(expected, abs=0.01)
            compared += 1
    assert compared > 100


def path_length(path: np.ndarray) -> float:
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def test_there_is_no_path_through_a_closed_fence():
    fence = [Obstacle("box", 0.0, y, 0.0, (0.2, 0.5), 1.0) for y in np.arange(-9.5, 10.0, 1.0)]
    assert shortest_path(inflated_cost(clearance_map(fence)), (-5.0, 0.0), (5.0, 0.0)) is None
    path = shortest_path(inflated_cost(clearance_map(fence[:-2])), (-5.0, 0.0), (5.0, 0.0))
    assert path_length(path) > 2 * math.hypot(5.0, 8.0)  # through the gap at the upper end


def test_the_shortest_path_goes_at_any_angle_and_as_near_to_corners_as_the_robot_can():
    empty = Arena("", 0, 0, (), (-6.0, -3.0, 0.0), ((5.0, 4.0),))
    assert optimal_length(empty) == pytest.approx(math.hypot(11.0, 7.0), abs=0.15)
    wall = Obstacle("box", 0.0, 0.0, 0.0, (0.05, 3.0), 1.0)
    around = Arena("", 1, 0, (wall,), (-4.0, 0.0, 0.0), ((4.0, 0.0),))
    beside = 3.0 + ROBOT.width / 2
    assert optimal_length(around) == pytest.approx(2 * math.hypot(4.0, beside), abs=0.2)
    for index in range(3):
        arena = generate_arena("val", 80, index)
        cost = inflated_cost(clearance_map(arena.obstacles))
        grid = path_length(shortest_path(cost, arena.start[:2], arena.waypoints[0]))
        assert math.dist(arena.start[:2], arena.waypoints[0]) - 0.2 < optimal_length(arena) < grid
    fence = tuple(Obstacle("box", 0.0, y, 0.0, (0.2, 0.5), 1.0) for y in np.arange(-9.5, 10.0, 1.0))
    assert math.isnan(optimal_length(Arena("", 20, 0, fence, (-4.0, 0.0, 0.0), ((4.0, 0.0),))))


def gap_to_obstacles(arena: Arena, pose: tuple[float, float, float]) -> float:
    """Gap [m] between the robot's footprint and outlines and walls, by points alone; negative: overlap."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (ROBOT.length / 2, ROBOT.width / 2)
    world = corners @ np.array([[c, s], [-s, c]]) + pose[:2]
    gap = 10.0 - np.abs(world).max()
    for obstacle in arena.obstacles:
        d = outline(obstacle, 600) - pose[:2]
        x = np.abs(c * d[:, 0] + s * d[:, 1]) - ROBOT.length / 2
        y = np.abs(c * d[:, 1] - s * d[:, 0]) - ROBOT.width / 2
        outside = np.hypot(np.maximum(x, 0), np.maximum(y, 0)) + np.minimum(np.maximum(x, y), 0)
        gap = min(gap, outside.min())
        middle = np.array([[c, s], [-s, c]]) @ (np.array([obstacle.x, obstacle.y]) - pose[:2])
        if abs(middle[0]) < ROBOT.length / 2 and abs(middle[1]) < ROBOT.width / 2:
            gap = min(gap, -0.1)  # the obstacle lies within the robot
    return gap


def test_contacts_are_where_the_shapes_meet():
    arena = generate_arena("val", 80, 2)
    world = ArenaWorld(arena)
    rng = np.random.default_rng(1)
    verdicts = []
    for _ in range(150):
        pose = (*rng.uniform(-9.8, 9.8, 2), rng.uniform(-math.pi, math.pi))
        gap = gap_to_obstacles(arena, pose)
        if abs(gap) < 0.01:
            continue
        world.place(pose)
        assert world.advance(0.0, 0.0, 0.1) == (gap < 0), (pose, gap)
        verdicts.append(gap < 0)
    assert 15 < sum(verdicts) < 135


def test_ranges_are_where_rays_meet_the_shapes():
    arena = generate_arena("val", 40, 3)
    world = ArenaWorld(arena)
    span = np.linspace(-10, 10, 8001)
    walls = [(span, 10.0), (span, -10.0), (10.0, span), (-10.0, span)]
    edges = [outline(obstacle, 4000) for obstacle in arena.obstacles]
    edges = np.concatenate([*edges, *(np.stack(np.broadcast_arrays(*wall), axis=1) for wall in walls)])
    x, y, yaw = arena.start
    eye = np.array([x + ROBOT.camera_ahead * math.cos(yaw), y + ROBOT.camera_ahead * math.sin(yaw)])
    away = np.hypot(*(edges - eye).T)
    bearing = np.arctan2(*(edges - eye).T[::-1]) - yaw
    bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
    agree = 0
    for angle, distance in zip(ROBOT.column_angles, world.ranges(), strict=True):
        expected = min(away[np.abs(bearing - angle) < 0.002].min(initial=10.0), 10.0)
        agree += abs(distance - expected) < 0.05
    assert agree >= ROBOT.columns - 2  # a ray may graze an edge


def test_ranges_are_clipped_to_near_and_far():
    box = Obstacle("box", 1.0, 0.0, 0.0, (0.3, 3.0), 1.0)
    arena = Arena("", 1, 0, (box,), (0.30, 0.0, 0.0), ((5.0, 0.0),))
    assert ArenaWorld(arena).ranges()[20] == pytest.approx(ROBOT.near)
    empty = Arena("", 0, 0, (), (-9.0, 0.0, 0.0), ((5.0, 0.0),))
    assert ArenaWorld(empty).ranges()[20] == ROBOT.far


def test_an_arc_equals_many_small_steps():
    pose = (1.0, 2.0, 0.5)
    x, y, yaw = pose
    for _ in range(10000):
        x, y, yaw = x + 0.7 * math.cos(yaw) * 1e-4, y + 0.7 * math.sin(yaw) * 1e-4, yaw - 0.9e-4
    assert arc(*pose, 0.7, -0.9, 1.0) == pytest.approx((x, y, yaw), abs=1e-3)
    assert arc(*pose, 1.0, 0.0, 1.0) == pytest.approx((1 + math.cos(0.5), 2 + math.sin(0.5), 0.5))


def test_on_wheels_the_robot_follows_commands_and_stays_upright():
    arena = Arena("", 0, 0, (), (-6.0, -6.0, 0.6), ((5.0, 0.0),))
    for speed, turn in ((1.0, 0.0), (0.5, 0.5), (0.35, -1.2), (0.0, 1.2)):
        worlds = ArenaWorld(arena, "wheels"), ArenaWorld(arena)
        for _ in range(20):
            for world in worlds:
                assert not world.advance(speed, turn, 0.1)
        wheels, kinematic = (world.pose for world in worlds)
        assert math.dist(wheels[:2], kinematic[:2]) < 0.2  # over 2 s
        assert abs(math.remainder(wheels[2] - kinematic[2], 2 * math.pi)) < 0.2
        _, i, j, _ = worlds[0].data.qpos[3:7]
        assert 1 - 2 * (i * i + j * j) > math.cos(math.radians(2))  # it does not tip
    # full brake from full speed
    world = ArenaWorld(arena, "wheels")
    for speed in (1.0,) * 10 + (0.0,) * 10:
        world.advance(speed, 0.0, 0.1)
    before = world.pose
    world.advance(0.0, 0.0, 0.2)
    assert math.dist(before[:2], world.pose[:2]) < 0.005


@pytest.mark.parametrize("physics", ["kinematic", "wheels"])
def test_driving_into_an_obstacle_is_a_collision(physics):
    box = Obstacle("box", 2.0, 0.0, 0.3, (0.3, 0.3), 1.0)
    arena = Arena("", 1, 0, (box,), (0.0, 0.0, 0.0), ((5.0, 0.0),))
    world = ArenaWorld(arena, physics)
    hit = next(step for step in range(50) if world.advance(0.5, 0.0, 0.1))
    # the box's corner before the robot lies at 2 - 0.3 (cos 0.3 + sin 0.3); the front is 0.30 m ahead
    assert world.pose[0] == pytest.approx(2 - 0.3 * (math.cos(0.3) + math.sin(0.3)) - 0.30, abs=0.06)
    assert hit > 20


def test_pedestrians_walk_their_path_and_can_be_hit():
    arena = generate_arena("val", 5, 0, pedestrians=3)
    assert len(arena.pedestrians) == 3
    assert generate_arena("val", 5, 0, pedestrians=3) == arena
    for pedestrian in arena.pedestrians:
        step = math.dist(pedestrian.position(3.0), pedestrian.position(3.1))
        assert step <= pedestrian.speed * 0.1 + 1e-9
        corners = pedestrian.path
        length = sum(math.dist(a, b) for a, b in zip(corners, (*corners[1:], corners[0]), strict=True))
        assert pedestrian.position(length / pedestrian.speed) == pytest.approx(
            pedestrian.position(0.0), abs=1e-6
        )
    person = Obstacle("person", 3.0, 0.0, 0.0, (0.25, 0.25), 1.7, ((3.0, 0.0), (-3.0, 0.0)), 0.5)
    world = ArenaWorld(Arena("", 0, 0, (person,), (0.0, 0.0, 0.0), ((5.0, 0.0),)))
    # the person walks into the standing robot: 3 m minus half a person and half a robot, at 0.5 m/s
    steps = next(step for step in range(100) if world.advance(0.0, 0.0, 0.1))
    assert steps * 0.1 == pytest.approx((3.0 - 0.25 - 0.30) / 0.5, abs=0.3)


@pytest.mark.parametrize(("arguments", "message"), [
    (("holiday", 5, 0), "split='holiday'"),
    (("test", 500, 0), "density=500"),
])  # fmt: skip
def test_arguments_out_of_range_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        generate_arena(*arguments)
    with pytest.raises(ValueError, match="physics='magic'"):
        ArenaWorld(triangle_course(), "magic")


@pytest.mark.parametrize("physics", ["kinematic", "wheels"])
@pytest.mark.parametrize("size", [0.5, 0.7, 1.0])
def test_a_small_robot_ends_where_its_footprint_ends(physics, size):
    """A pillar 2 cm behind it: nothing of the robot, wheels and caster included, reaches that far."""
    behind = Obstacle("cylinder", -(size * ROBOT.length / 2 + 0.02 + 0.3), 0.0, 0.0, (0.3, 0.3), 1.0)
    arena = Arena("train", 1, 0, (behind,), (0.0, 0.0, 0.0), ((8.0, 0.0),))
    world = ArenaWorld(arena, physics, size=size)
    assert not world.advance(0.0, 0.0, 0.1)

"""Episodes: way-points, pedestrians, seeds, contacts, the field of view, the goal, planning."""

import math

import numpy as np
import pytest

from eldenet.navigation.cameras import camera
from eldenet.navigation.episodes import Episodes, EpisodeSettings, Event
from eldenet.navigation.noisy_ranges import NoisyRanges, without_missed
from eldenet.navigation.planners.online_map import TIGHT, OnlineMap
from eldenet.navigation.planners.paths import shortest_path
from eldenet.navigation.policy import Navigator
from eldenet.navigation.ranges import depth_to_ranges
from eldenet.navigation.sensors import Drift, Ranges
from eldenet.navigation.tasks import TrainingArenas
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import INFLATION, RESOLUTION, Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT


def empty(start=(0.0, 0.0, 0.0), *waypoints) -> Arena:
    return Arena("", 0, 0, (), start, waypoints or ((8.0, 0.0),))


def test_a_touch_is_a_collision_even_with_the_wheels_in_the_air():
    pillar = Obstacle("cylinder", 1.0, 0.0, 0.0, (0.3, 0.3), 1.0)
    world = ArenaWorld(Arena("", 1, 0, (pillar,), (0.0, 0.0, 0.0), ((5.0, 0.0),)), "wheels")
    world.data.qpos[:3] = 0.405, 0.0, 0.05
    touched = world.advance(0.0, 0.0, 0.005)
    assert 0 < world.data.ncon <= 3  # none of them with the floor
    assert touched


def test_a_wall_that_fills_the_view_is_never_missed():
    world = ArenaWorld(empty((9.0, 0.0, 0.0)))
    instance = NoisyRanges(errors="packaged").begin(world, np.random.default_rng(0))
    assert world.ranges().max() < 1.1
    assert max(instance.scan().ranges.min() for _ in range(500)) < 2.0
    errors = NoisyRanges(errors="packaged").errors
    wall = np.full(ROBOT.columns, 0.6)
    for _ in range(200):
        assert (without_missed(wall, errors, np.random.default_rng()) == wall).all()


def test_one_robot_may_see_all_columns_while_another_does_not() -> None:
    """A camera that looks far down knows its outer columns only where something stands close by."""
    episodes = Episodes(3, camera(pitch=28.0), EpisodeSettings())
    for slot, start in enumerate([(9.0, 0.0, 0.0), (0.0, 0.0, 0.0), (9.0, 0.0, 0.0)]):
        episodes.start(slot, empty(start), (0, slot))
    senses = episodes.sense()
    assert senses.cautious.shape == senses.ranges.shape
    assert (senses.cautious[[0, 2]] == senses.ranges[[0, 2]]).all()
    assert (senses.ranges[[0, 2]] < 1.5).all()
    assert 0 < (senses.cautious[1] == 0).sum() < 10


def intrinsics_of(width: int, view: float) -> np.ndarray:
    """Of a camera with a horizontal field of view [rad]."""
    focal = width / 2 / math.tan(view / 2)
    return np.array([[focal, 0, (width - 1) / 2], [0, focal, 60.0], [0, 0, 1]])


def test_a_camera_with_too_small_a_view_is_refused():
    for degrees, width in ((40.0, 640), (69.4, 32)):
        intrinsics, depth = intrinsics_of(width, math.radians(degrees)), np.full((120, width), 9.0)
        with pytest.raises(ValueError, match=r"25\.0 degrees to each side, with at least 46 px for 69\.4"):
            Navigator.load().step(depth, (8.0, 0.0), (0.0, 0.0, 0.0), intrinsics=intrinsics)
    for width in (46, 640):
        intrinsics = intrinsics_of(width, ROBOT.field_of_view)
        assert (depth_to_ranges(np.full((120, width), 8.0), intrinsics) > 7).all()
    with pytest.raises(ValueError, match="32 px wide"):
        camera(size=(24, 32))


def test_an_intermediate_way_point_costs_no_time():
    through, plain = empty((0.0, 0.0, 0.0), (1.55, 0.0), (6.0, 0.0)), empty((0.0, 0.0, 0.0), (6.0, 0.0))
    ends = []
    for arena in (through, plain):
        episodes = Episodes(1, Ranges())
        episodes.start(0, arena, (0,))
        event = Event.NONE
        while event is Event.NONE:
            _, events = episodes.step(np.array([[1.0, 0.0]]))
            event = Event(int(events[0]))
            if event is Event.NONE:
                assert episodes.worlds[0].time == pytest.approx(episodes.seconds[0])
        ends.append((event, episodes.seconds[0], episodes.poses[0, 0]))
    assert ends[0] == ends[1]
    assert ends[0][0] is Event.GOAL


def test_training_episodes_start_away_from_pedestrians():
    arenas, rng = TrainingArenas((0, 20), pedestrians=10, repeats=4), np.random.default_rng(1)
    away = [
        math.dist((walker.x, walker.y), arena.start[:2])
        for arena in (arenas.draw(rng) for _ in range(40))
        for walker in arena.pedestrians
    ]
    assert len(away) > 100
    assert min(away) > 3.0


def test_each_seed_in_a_list_belongs_to_one_slot():
    pytest.importorskip("gymnasium")
    from eldenet.navigation.env import ArenaNavVectorEnv

    env = ArenaNavVectorEnv(2)
    one, other, third = (env.reset(seed=list(seeds))[0] for seeds in ((1, 2), (1, 3), (2, 1)))
    np.testing.assert_array_equal(one[0], other[0])
    np.testing.assert_array_equal(one, third[::-1])
    assert (one[1] != other[1]).any()
    assert (env.reset(seed=1)[0] == env.reset(seed=1)[0]).all()


def test_a_goal_by_odometry_drifts_with_the_odometry():
    drift = Drift(0.05, math.radians(3.0))
    sensed = {}
    for goal in ("known", "odometry"):
        episodes = Episodes(1, NoisyRanges(drift=drift), EpisodeSettings(goal=goal))
        episodes.start(0, empty((-8.0, 0.0, 0.0)), (3,))
        for _ in range(30):
            episodes.step(np.array([[1.0, 0.1]]))
        sensed[goal] = episodes.sense()
    np.testing.assert_array_equal(sensed["known"].odometry, sensed["odometry"].odometry)
    for goal, pose in (("known", episodes.poses[0]), ("odometry", sensed["odometry"].odometry[0])):
        distance, bearing = sensed[goal].goal[0]
        ahead = np.array([math.cos(pose[2] + bearing), math.sin(pose[2] + bearing)])
        assert pose[:2] + distance * ahead == pytest.approx([8.0, 0.0])
    assert np.abs(sensed["known"].goal - sensed["odometry"].goal).max() > 0.02
    with pytest.raises(ValueError, match="goal='gps': give one of known, fixes, odometry"):
        EpisodeSettings(goal="gps")
    for seconds in (0, -1.0, math.nan, math.inf):
        with pytest.raises(
            ValueError, match=f"time_limit={seconds}: give a finite number of seconds above 0"
        ):
            EpisodeSettings(time_limit=seconds)


@pytest.mark.parametrize("walls", [0, 40, 400])
def test_planning_in_a_window_equals_planning_on_the_full_map(walls):
    from scipy.ndimage import distance_transform_edt

    rng = np.random.default_rng(walls)
    known = OnlineMap()
    for _ in range(4):
        known.reset()
        middle, half = known.count // 2, 60
        rows, columns = rng.integers(middle - half, middle + half, (2, walls))
        known.evidence[rows, columns] = 4
        pose, goal = np.array([*rng.uniform(-5, 5, 2), 0.0]), tuple(rng.uniform(-8, 8, 2).tolist())
        taken = known.evidence > 0
        clearance = distance_transform_edt(~taken) * RESOLUTION if walls else np.full(taken.shape, np.inf)
        expected = None
        for inflation, weight in ((INFLATION, 1.0), (TIGHT, 6.0)):
            cost = np.where(clearance >= INFLATION, 1.0, np.where(clearance >= inflation, weight, np.inf))
            if expected is None:
                expected = shortest_path(cost, tuple(pose[:2]), goal, known.side)
        got = known.plan(pose, goal)
        assert (got is None) == (expected is None)
        if got is not None:
            assert got == pytest.approx(expected)
        near = known.walls_near(pose)
        every = (np.argwhere(taken)[:, ::-1] + 0.5) * RESOLUTION - known.side / 2
        assert near == pytest.approx(every[np.hypot(*(every - pose[:2]).T) < 3.0])

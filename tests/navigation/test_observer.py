"""Navigation: what the driver sees."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import trapezoid

from eldenet.navigation.collision_arcs import ArcTable, arc_table
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.observer import Observer, Senses
from eldenet.navigation.sensors import Drift, Odometry
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import generate_arena
from eldenet.simulation.robot import ROBOT

FAR = np.full((1, ROBOT.columns), ROBOT.far)


def senses(ranges=FAR, odometry=(0.0, 0.0, 0.0), goal=(8.0, 0.3)) -> Senses:
    return Senses(np.asarray(ranges, float), np.array([odometry]), np.array([goal]))


def test_observation_columns_are_as_documented():
    observer = Observer()
    ranges = FAR.copy()
    ranges[0, :8] = 2.5  # the rightmost sector
    seen = observer.observe(senses(ranges))[0]
    assert seen.shape == (39,)
    assert seen[:5] == pytest.approx([0.5, 1, 1, 1, 1])
    assert seen[5:8] == pytest.approx([8 / 20, math.sin(0.3), math.cos(0.3)])
    assert seen[8:10] == pytest.approx([0, 0])
    observer.commands(np.array([0]))
    seen = observer.observe(senses())[0]
    assert seen[8] == 1.0  # hard to the left
    assert seen[9] == pytest.approx(0.35)


@pytest.mark.parametrize(
    ("law", "expected"), [("paper", 0.5), ("turn", 0.5 * 0.75), ("prox", 0.5 * 0.75 * 0.5)]
)
def test_speed_laws_set_the_speed_of_an_action(law, expected):
    observer = Observer(speed=law)
    observer.observe(senses(np.full((1, ROBOT.columns), 0.9), goal=(1.5, 0.0)))
    assert observer.commands(np.array([1]))[0] == pytest.approx([expected, 0.5])


def test_memory_keeps_obstacles_that_left_the_view():
    observer = Observer(memory=60, seen_through=0)
    ranges = FAR.copy()
    ranges[0, 20] = 1.0
    for _ in range(2):  # every second frame is kept
        observer.observe(senses(ranges))
    angle = ROBOT.column_angles[20]
    point = np.array([ROBOT.camera_ahead + math.cos(angle), math.sin(angle)])
    for step in range(1, 40):  # drive past it and turn around: it stays in place
        pose = (0.02 * step, -0.5, 0.05 * step)
        seen = observer.observe(senses(odometry=pose))[0]
        dx, dy = point - pose[:2]
        bearing = math.remainder(math.atan2(dy, dx) - pose[2], 2 * math.pi)
        number = int((bearing + math.pi) / (2 * math.pi) * 24)
        assert seen[10 + number] == pytest.approx(math.hypot(dx, dy) / 3, abs=1e-5)
        assert (np.delete(seen[10:34], number) == 1).all()
    for _ in range(70):
        seen = observer.observe(senses(odometry=pose))[0]
    assert (seen[10:34] == 1).all()  # forgotten after 12 s
    observer.observe(senses(ranges))
    observer.reset(0)
    assert (observer.observe(senses())[0][10:34] == 1).all()


def test_points_are_forgotten_once_two_scans_in_a_row_see_through_them():
    """Compared with a slow loop over all points and scans."""
    rng = np.random.default_rng(4)
    poses = np.cumsum(rng.normal(0, 0.2, (20, 3)), axis=0)
    scans = np.clip(rng.gamma(2.0, 1.5, (20, ROBOT.columns)), ROBOT.near, ROBOT.far)
    observer = Observer(memory=60, seen_through=2)
    kept: list[list] = []  # points of every scan, with the number of scans that saw through them
    for number, (ranges, pose) in enumerate(zip(scans, poses, strict=True)):
        observer.observe(senses(ranges[None], tuple(pose)))
        camera = pose[:2] + ROBOT.camera_ahead * np.array([math.cos(pose[2]), math.sin(pose[2])])
        for frame in kept:
            for entry in frame:
                away = math.dist(entry[0], camera)
                bearing = math.remainder(math.atan2(*(entry[0] - camera)[::-1]) - pose[2], 2 * math.pi)
                if abs(bearing) < ROBOT.field_of_view / 2 and ROBOT.near < away < 5.0:
                    column = int((bearing / ROBOT.field_of_view + 0.5) * ROBOT.columns)
                    seen = ranges[max(column - 1, 0) : column + 2].min()
                    entry[1] = entry[1] + 1 if seen > away * 1.2 + 0.05 else 0
            frame[:] = [entry for entry in frame if entry[1] < 2]
        angles = np.array(ROBOT.column_angles) + pose[2]
        rays = zip(ranges, np.stack([np.cos(angles), np.sin(angles)], axis=1), strict=True)
        frame = [[camera + away * direction, 0] for away, direction in rays if away < ROBOT.far]
        kept = [*kept[: number // 2], frame]
        points = np.array([entry[0] for frame in kept for entry in frame])
        near = np.sort(np.hypot(*(points - pose[:2]).T))
        got = np.sort(observer.memory.near(pose[None])[3])
        assert got == pytest.approx(near[near < 3.0], abs=1e-4)


def test_arc_tables_agree_with_moving_the_footprint():
    table = ArcTable(((0.8, 0.5), (0.0, 1.2), (1.0, 0.0)), 1.8, 0.04)
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.2, 2.2, (400, 2)).astype(np.float32)
    cells = table.cells(points[:, 0], points[:, 1])
    for number, (speed, turn) in enumerate(table.commands):
        gaps = []
        for step in range(1, 19):
            # exact motion, by a thousand small steps
            t = np.linspace(0, step * 0.1, 1000)
            x = trapezoid(speed * np.cos(turn * t), t)
            y = trapezoid(speed * np.sin(turn * t), t)
            c, s = math.cos(turn * t[-1]), math.sin(turn * t[-1])
            local = (points - (x, y)) @ np.array([[c, -s], [s, c]])
            gaps.append(np.hypot(*np.maximum(np.abs(local) - (0.30, 0.25), 0).T))
        gaps = np.array(gaps)
        started = np.hypot(*np.maximum(np.abs(points) - (0.30, 0.25), 0).T)
        clear = started > 0.09  # of the footprint, its margin and half a cell
        got = table.gap[cells, number] / 100
        assert np.abs(got - np.minimum(gaps.min(axis=0), 2.55))[clear].max() < 0.05
        time = table.time[cells, number]
        surely, never = (gaps < 0.04 - 0.036).any(axis=0), (gaps > 0.04 + 0.036).all(axis=0)
        assert (time[surely & clear] < 18).all()
        assert (time[never & clear] == 18).all()
    edge = np.array([np.nextafter(np.float32(2.4), np.float32(0))])
    assert table.cells(edge, edge).max() < len(table.time)
    assert arc_table(((0.5, 0.5),), 1.0) is arc_table(((0.5, 0.5),), 1.0)


@pytest.mark.parametrize(("options", "message"), [
    ({"speed": "fast"}, "speed='fast'"),
    ({"turn_rates": (1.0,)}, "give one each"),
])  # fmt: skip
def test_options_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Observer(**options)


# --- ranges ---


def test_noise_has_the_given_deviations():
    arena = generate_arena("val", 40, 5)
    world = ArenaWorld(arena)
    instance = NoisyRanges(scale=0.1, smooth=0.05, column=0.03).begin(world, np.random.default_rng(0))
    true = world.ranges()
    inside = (true > 0.6) & (true < 7)
    error = np.log(np.array([instance.scan().ranges[inside] for _ in range(1500)]) / true[inside])
    # of a sum of independent errors; the interpolated one loses up to half of its variance between knots
    least, most = (math.sqrt(0.1**2 + part * 0.05**2 + 0.03**2) for part in (0.5, 1.0))
    assert least * 0.93 < error.std() < most * 1.07
    frames = error.mean(axis=1)
    assert np.corrcoef(frames[1:], frames[:-1])[0, 1] == pytest.approx(0.75, abs=0.1)


def test_only_a_share_of_the_episodes_has_errors():
    world = ArenaWorld(generate_arena("val", 40, 5))
    sensor = NoisyRanges(share=0.25)
    exact = [
        (sensor.begin(world, np.random.default_rng(seed)).scan().ranges == world.ranges()).all()
        for seed in range(200)
    ]
    assert 0.65 < np.mean(exact) < 0.85
    with pytest.raises(ValueError, match=r"share=1\.5"):
        NoisyRanges(share=1.5)


def test_odometry_drifts_with_the_given_deviations():
    poses = [(0.1 * k, 0.0, 0.0) for k in range(101)]  # ten meters straight ahead
    ends = []
    for seed in range(400):
        odometry = Odometry(Drift(0.02, math.radians(1)), np.random.default_rng(seed), poses[0])
        for before, after in pairwise(poses):
            odometry.move(before, after)
        ends.append(odometry.pose)
    ends = np.array(ends)
    assert np.degrees(ends[:, 2]).std() == pytest.approx(10.0, rel=0.15)
    assert ends[:, 0].std() > 0.15
    exact = Odometry(Drift(0.0, 0.0), np.random.default_rng(0), (1.0, 2.0, 0.5))
    exact.move((1.0, 2.0, 0.5), (1.3, 2.2, 0.9))
    assert exact.pose == pytest.approx((1.3, 2.2, 0.9))


def test_a_doubtful_near_reading_slows():
    """Ranges are the same; one says that things may be nearer."""
    speeds = []
    for nearest in (None, 0.9, 0.5):
        observer = Observer()
        ranges = np.full((1, ROBOT.columns), 1.2)
        cautious = None if nearest is None else np.full_like(ranges, nearest)
        observer.observe(senses(ranges)._replace(cautious=cautious))
        speeds.append(observer.commands(np.array([2]))[0, 0])
    assert speeds[0] > speeds[1] > speeds[2]


def test_a_doubtful_far_reading_does_not_free():
    """A remembered obstacle at 1 m stays where the view beyond it is in doubt, and goes where it is not."""
    remembered = {}
    for trusted in (True, False):
        observer = Observer(memory=60, seen_through=2)
        for _ in range(2):  # every second frame is kept
            observer.observe(senses(np.full((1, ROBOT.columns), 1.0)))
        cautious = np.full((1, ROBOT.columns), ROBOT.far if trusted else 0.9)
        for _ in range(4):
            observer.observe(senses()._replace(cautious=cautious))
        remembered[trusted] = len(observer.memory.near(np.zeros((1, 3)))[0])
    assert remembered[True] == 0
    assert remembered[False] > 20

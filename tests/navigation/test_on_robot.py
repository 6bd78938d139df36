"""Both drivers on a robot: from depth, with a delay, slowed down, and far from the start."""

import math

import numpy as np
import pytest

import eldenet
from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import run_episodes
from eldenet.navigation.latency import Predictive
from eldenet.navigation.planners.plan_and_steer import PlanAndSteer
from eldenet.navigation.policy import Navigator
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arena_view import render_arena
from eldenet.simulation.robot import ROBOT, arc

CAMERA = (460.0, 460.0, 320.0, 240.0)
DRIVERS = pytest.mark.parametrize("make", [Navigator.load, PlanAndSteer])


class BySteps:
    """Drives a simulated robot by :meth:`OnRobot.step`, with its own pose and goal only."""

    name = "steps"

    def __init__(self, driver, **options):
        self.driver, self.options = driver, options
        driver.range_filter = None  # as in the evaluation

    def reset(self, robot, world=None):
        self.driver.reset()

    def commands(self, senses, robots=None):
        return np.array(
            [self.driver.step(senses.ranges[0], senses.goal[0], senses.odometry[0], **self.options)]
        )


@DRIVERS
@pytest.mark.parametrize("latency", [0.0, 0.4])
def test_steps_drive_as_the_simulator_s_driver_does(make, latency):
    arenas, settings = frozen_arenas(40, 2, split="val"), EpisodeSettings("wheels")
    simulated = Predictive(make(), latency) if latency else make()
    rows = [
        run_episodes(
            arenas, lambda robots, driver=driver: driver, Ranges(latency=latency), settings, robots=1
        )
        for driver in (BySteps(make(), latency=latency), simulated)
    ]
    assert [row.outcome for row in rows[0]] == ["success", "success"]
    # the frame of steps starts at zero; with a delay, what rounding changes grows over the drive
    for by_steps, other in zip(*rows, strict=True):
        assert by_steps.seconds == pytest.approx(other.seconds, abs=2.0 if latency else 0.4)


@pytest.fixture(scope="module")
def indoor():
    return eldenet.DepthPredictor(eldenet.load("eldenet_indoor"), uncertainty=True)


@DRIVERS
def test_it_stands_behind_a_covered_lens_and_drives_by_an_ordinary_picture(make, indoor):
    driver = make()
    for gray in (0, 255, 128):
        depth, sigma, _ = indoor(np.full((480, 640, 3), gray, np.uint8), intrinsics=CAMERA)
        command = driver.step(depth, (5.0, 0.0), (0.0, 0.0, 0.0), sigma=sigma, intrinsics=CAMERA)
        assert command == (0.0, 0.0)
        assert driver.stop_reason == "100% of the view is unsure: a covered lens, darkness or a bare wall"
        assert len(driver.observer.memory.points(0)) == 0
    views = render_arena("test", 5, (240, 320), views=2)
    camera = views.intrinsics[1]
    depth, sigma, _ = indoor(views.image[1], intrinsics=camera)
    command = driver.step(depth, (5.0, 0.0), (0.0, 0.0, 0.0), sigma=sigma, intrinsics=camera)
    assert driver.stop_reason is None
    assert command[0] > 0.1


@DRIVERS
def test_sigma_is_how_near_things_may_be(make):
    """As an arena's camera says: the 80 % interval of Laplace's distribution, 1.138 sigma to each side."""
    seen = []
    for sigma in (None, 0.5, np.nan, -0.5):
        driver = make()
        driver.commands = lambda senses: seen.append(senses) or np.zeros((1, 2))
        depth = np.full((480, 640), 2.0)
        unsure = None if sigma is None else np.where(np.arange(640) < 320, sigma, 0.0) * np.ones((480, 1))
        driver.step(depth, (5.0, 0.0), (0.0, 0.0, 0.0), sigma=unsure, intrinsics=CAMERA)
    for senses, factor in zip(seen, (1.0, math.exp(-1.138 * 0.5 / 2), 0.0, 0.0), strict=True):
        np.testing.assert_allclose(senses.ranges[0], 2 / np.cos(ROBOT.column_angles), rtol=0.05)
        right, left = senses.cautious[0, 3:17], senses.cautious[0, 23:37]
        np.testing.assert_allclose(right, senses.ranges[0, 3:17], rtol=1e-3)
        near = np.maximum(factor * senses.ranges[0, 23:37], ROBOT.near)
        np.testing.assert_allclose(left, near, rtol=1e-3)


def test_sigma_is_a_map_like_the_depth():
    for depth, sigma in ((np.ones((48, 64)), np.ones((24, 32))), (np.ones(40), np.ones(40))):
        with pytest.raises(ValueError, match=r"sigma has shape .* depth .*: give both as \(H, W\) \[m\]"):
            Navigator.load().step(depth, (5.0, 0.0), (0.0, 0.0, 0.0), sigma=sigma)


@DRIVERS
def test_a_slower_robot_drives_the_same_arc_and_remembers_what_it_drove(make):
    free, slow = make(), make()
    seen = (np.full(ROBOT.columns, 6.0), (5.0, 0.3), (0.0, 0.0, 0.0))
    full, reduced = free.step(*seen), slow.step(*seen, max_speed=0.25)
    assert full[0] > 0.25
    assert reduced == pytest.approx((0.25, full[1] * 0.25 / full[0]))
    assert slow.observer.last[0] == pytest.approx(reduced)
    slow.commands = lambda senses: np.array([[-0.5, 0.5]])
    assert slow.step(*seen, max_speed=0.2) == pytest.approx((-0.2, 0.2))  # backwards too


@pytest.mark.parametrize(
    ("height", "pitch", "said"),
    [(0.4, 0.0, ""), (1.0, 0.3, ""), (1.0, 0.0, "1.9 m"), (0.4, -0.48, "nowhere")],
)
def test_a_camera_that_does_not_see_the_floor_near_the_robot_is_named(caplog, height, pitch, said):
    """480 rows of 54.6 degrees: what leaves them below counts as free."""
    camera = (465.0, 465.0, 319.5, 239.5)
    depth = np.full((480, 640), 9.0)
    Navigator.load().step(
        depth, (5.0, 0.0), (0.0, 0.0, 0.0), intrinsics=camera, camera_height=height, camera_pitch=pitch
    )
    warned = [line for line in caplog.messages if "shows the floor" in line]
    assert len(warned) == bool(said)
    assert all(said in line and "tilt it down" in line for line in warned)


@DRIVERS
def test_a_narrow_camera_drives_too_and_keeps_what_it_no_longer_sees(make):
    """60 degrees instead of 69.4: the outer columns are unknown, so nothing there is forgotten or free."""
    kept = []
    for degrees in (60.0, 69.4):
        driver, focal = make(), 320 / math.tan(math.radians(degrees / 2))
        camera, gone = (focal, focal, 320.0, 240.0), np.full((480, 640), 9.0)
        assert driver.step(gone, (5.0, 0.0), (0.0, 0.0, 0.0), intrinsics=camera)[0] > 0
        driver.reset()
        pillar, left = gone.copy(), round(320 - focal * math.tan(math.radians(25)))
        pillar[:, left - 20 : left + 20] = 2.0
        # turned by 7 degrees to the right, the pillar is at 32 degrees: out of the narrow view
        for yaw, seen in ((0.0, pillar), (0.0, pillar), *[(-0.12, gone)] * 4):
            driver.step(seen, (5.0, 0.0), (0.0, 0.0, yaw), intrinsics=camera)
        kept.append((np.hypot(*driver.observer.memory.points(0).T) < 3).sum())
    assert kept[0] > 0
    assert kept[1] == 0  # the wider camera saw that the pillar is gone


def test_a_planner_s_map_is_unknown_beside_a_narrow_view():
    driver = PlanAndSteer()
    focal = 320 / math.tan(math.radians(26))
    driver.step(
        np.full((480, 640), 9.0), (5.0, 0.0), (0.0, 0.0, 0.0), intrinsics=(focal, focal, 320.0, 240.0)
    )
    centers, evidence = driver._maps[0].near(np.zeros(3), 5.0)
    bearing = np.degrees(np.arctan2(centers[:, 1], centers[:, 0] - ROBOT.camera_ahead))
    away = np.hypot(*centers.T) > 1.0
    assert (evidence[away & (np.abs(bearing) < 22)] < 0).mean() > 0.7  # rays leave gaps
    assert (evidence[away & (np.abs(bearing) > 29)] == 0).all()


@pytest.mark.parametrize(
    "wrong", [{"latency": 2.0}, {"latency": math.nan}, {"max_speed": 0.0}, {"max_speed": math.inf}]
)
def test_a_setting_out_of_range_is_refused(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=f"^{name}="):
        Navigator.load().step(np.full(40, 6.0), (5.0, 0.0), (0.0, 0.0, 0.0), **wrong)


@pytest.mark.slow
def test_a_planner_starts_a_new_map_far_from_the_start_of_the_last_one():
    """100 m along a corridor 3 m wide; a map reaches 21 m."""
    driver = PlanAndSteer()
    x, y, yaw = 0.0, 0.0, 0.0
    for _ in range(700):
        beams = np.sin(np.array(ROBOT.column_angles) + yaw)
        walls = np.where(beams > 0, 1.5 - y, 1.5 + y) / np.maximum(np.abs(beams), 1e-6)
        bearing = math.remainder(math.atan2(-y, 120.0 - x) - yaw, math.tau)
        speed, turn = driver.step(
            np.minimum(walls, ROBOT.far), (math.hypot(120 - x, y), bearing), (x, y, yaw)
        )
        x, y, yaw = arc(x, y, yaw, speed, turn, ROBOT.period)
        if x > 100:
            break
    assert x > 100
    assert abs(y) < 1.2
    assert len(driver._trails[0]) <= 300


def test_a_bearing_in_degrees_is_refused_and_one_of_many_turns_is_not() -> None:
    ranges, turns = np.full(40, 6.0), 3 * math.tau
    with pytest.raises(ValueError, match=r"a bearing of 45 is more than a turn: degrees\? Give radians"):
        Navigator.load().step(ranges, (5.0, 45.0), (0.0, 0.0, 0.3))
    wrapped = Navigator.load().step(ranges, (5.0, 0.5), (0.0, 0.0, 0.3))
    assert Navigator.load().step(ranges, (5.0, 0.5 - turns), (0.0, 0.0, 0.3 + turns)) == pytest.approx(
        wrapped
    )


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"latency": 120}, "120 looks like milliseconds: give 0.12"),
        ({"camera_height": 40}, "40 looks like centimeters: give 0.4"),
        ({"intrinsics": (4.2, 4.2, 63.5, 47.5)}, "a focal length in mm"),
        ({"intrinsics": np.array([[100, 0, 0], [0, 100, 0], [63.5, 47.5, 1]])}, "give the transpose"),
    ],
)
def test_a_number_in_another_unit_stops_the_robot_with_a_line(wrong, said) -> None:
    given = {"intrinsics": (60.0, 60.0, 63.5, 47.5)} | wrong
    with pytest.raises(ValueError, match=said):
        Navigator.load().step(np.full((96, 128), 3.0), (5.0, 0.0), (0.0, 0.0, 0.0), **given)

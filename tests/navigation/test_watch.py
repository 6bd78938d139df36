"""What a driver must not drive by: each fault stops it and is named, and a sound drive goes on."""

import math

import numpy as np
import pytest

from eldenet.geometry import level_rotation, pinhole
from eldenet.navigation.episodes import Episodes, EpisodeSettings, Event
from eldenet.navigation.floor import Leveler
from eldenet.navigation.planners.plan_and_steer import PlanAndSteer
from eldenet.navigation.policy import Navigator
from eldenet.navigation.ranges import depth_to_ranges
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.watch import has_content
from eldenet.simulation.arena_view import render_arena
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT, arc

DRIVERS = pytest.mark.parametrize("make", [Navigator.load, PlanAndSteer])
FREE, GOAL, POSE = np.full(ROBOT.columns, 6.0), (5.0, 0.2), (1.0, 2.0, 0.3)
SIZE, CAMERA = (96, 128), pinhole(92.0, 92.0, 63.5, 47.5)


def hall(pitch: float = 0.0, roll: float = 0.0, height: float = 0.4) -> np.ndarray:
    """Depth ``(H, W)`` [m] of a floor and a wall 6 m ahead, seen by a tilted camera."""
    rows, columns = np.indices(SIZE)
    pixels = np.stack([columns, rows, np.ones(SIZE)], axis=-1) @ np.linalg.inv(CAMERA).T
    _, down, ahead = np.moveaxis(pixels @ level_rotation(pitch, roll).T, -1, 0)
    with np.errstate(divide="ignore"):
        return np.minimum(6.0 / ahead, np.where(down > 0, height / np.maximum(down, 1e-9), np.inf))


# --- input that cannot be true ------------------------------------------------------------------------------


@DRIVERS
@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"depth": np.full(40, -np.inf)}, r"reads too close \(-inf\)"),
        ({"depth": np.full(40, 1e-9)}, "below 0.05 m nearly everywhere: give meters"),
        ({"goal": (1e300, 0.0)}, r"goal is 1e\+300 m away: give 0 to 1e\+08"),
        ({"goal": (-3.0, 0.0)}, "goal is -3 m away"),
        ({"odometry": (1e300, 0.0, 0.0)}, r"odometry=\[1e\+300, 0.0, 0.0\]: give meters"),
    ],
)
def test_absurd_numbers_stop_it_in_one_line(make, wrong, reason):
    driver = make()
    given = {"depth": FREE, "goal": GOAL, "odometry": POSE}
    assert driver.step(**given | wrong) == (0.0, 0.0)
    assert "\n" not in driver.stop_reason
    with pytest.raises(ValueError, match=reason):
        raise ValueError(driver.stop_reason)
    assert driver.step(**given)[0] > 0
    assert driver.stop_reason is None


@pytest.mark.parametrize("wrong", [None, "far", [[1.0], [2.0, 3.0]], {"a": 1}, object()])
@pytest.mark.parametrize("name", ["depth", "goal", "odometry"])
def test_what_is_no_numbers_is_refused_in_one_line(name, wrong):
    given = {"depth": FREE, "goal": GOAL, "odometry": POSE} | {name: wrong}
    with pytest.raises(ValueError, match=f"^{name}=.{{0,200}}: give ") as error:
        Navigator.load().step(**given)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("wrong", ["fast", [1.0], None, {}, True])
@pytest.mark.parametrize("name", ["camera_height", "camera_pitch", "camera_roll", "latency", "max_speed"])
def test_a_setting_that_is_no_number_is_refused(name, wrong):
    with pytest.raises(ValueError, match=f"^{name}=.*: give a number"):
        Navigator.load().step(FREE, GOAL, POSE, **{name: wrong})


def test_a_picture_is_bytes_and_a_tilt_radians():
    for image in (np.zeros((4, 4, 3)), np.zeros((3, 4, 4), np.uint8), np.zeros((1, 4, 4, 3), np.uint8)):
        with pytest.raises(ValueError, match=r"^image has type .* and shape .*: give the camera's frame"):
            Navigator.load().step(FREE, GOAL, POSE, image=image)
    with pytest.raises(ValueError, match=r"^camera_pitch=5\.0: give radians"):
        Navigator.load().step(hall(), GOAL, POSE, intrinsics=CAMERA, camera_pitch=5.0)


# --- faults over time ---------------------------------------------------------------------------------------


class Drive:
    """A simulated robot that drives by ``step``; ``change`` may replace what it is given."""

    def __init__(self, driver, arena, seconds=20.0, **settings):
        self.driver = driver
        self.episodes = Episodes(1, Ranges(), EpisodeSettings(time_limit=seconds, **settings))
        self.episodes.start(0, arena, (0,))

    def run(self, change=lambda given, time: given):
        """Time of the first stop [s], or how the drive ended."""
        while True:
            senses, time = self.episodes.sense(), float(self.episodes.seconds[0])
            given = {"depth": senses.ranges[0], "goal": senses.goal[0], "odometry": senses.odometry[0]}
            command = self.driver.step(**change(given, time))
            if self.driver.stop_reason:
                return time
            event = Event(int(self.episodes.step(np.array([command]))[1][0]))
            if event is not Event.NONE:
                return event


PILLARS = tuple(
    Obstacle("cylinder", x, y, 0.0, (0.3, 0.3), 1.0) for x, y in ((-2.0, 1.0), (0.0, -1.2), (2.0, 0.8))
)
COURSE = Arena("", 3, 0, PILLARS, (-5.0, 0.0, 0.0), ((6.0, 0.0),))


def frozen(name, kept):
    """A fault: from 1.9 s on this input stays as it was; ``kept`` gets it."""

    def freeze(given, time):
        kept.setdefault(name, given[name].copy()) if time > 1.9 else None
        return given | kept

    return freeze


@DRIVERS
def test_a_sound_drive_ends_at_the_goal(make):
    assert Drive(make(), COURSE, 60.0).run() is Event.GOAL


@DRIVERS
def test_a_frozen_camera_stops_it_within_half_a_second(make):
    driver = make()
    assert Drive(driver, COURSE).run(frozen("depth", {})) <= 2.5
    assert driver.stop_reason == "the picture does not change while the wheels turn: a frozen camera"
    assert driver.step(FREE, GOAL, POSE)[0] > 0  # a new picture


def test_a_picture_that_repeats_counts_though_a_network_s_filter_changes_its_depth():
    driver, image = Navigator.load(), render_arena("test", 0, (48, 64), views=1).image[0]
    for number in range(3):
        driver.step(FREE + 0.01 * number, GOAL, (0.1 * number, 0.0, 0.0), image=image)
    assert "frozen camera" in driver.stop_reason


@DRIVERS
@pytest.mark.parametrize("picture", [False, True])
def test_wheels_that_slip_stop_it(make, picture):
    """The robot hangs: its view stays, but for noise, and its odometry follows the commands."""
    driver, rng, pose, seconds = make(), np.random.default_rng(0), (-5.0, 0.0, 0.0), 0.0
    ranges = Drive(driver, COURSE).episodes.sense().ranges[0]
    image = render_arena("test", 0, (48, 64), views=1).image[0].astype(float)
    while driver.stop_reason is None and seconds < 5:
        given = {"depth": ranges * rng.normal(1, 0.01, len(ranges)), "goal": GOAL, "odometry": pose}
        if picture:
            given["image"] = np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
        pose = arc(*pose, *driver.step(**given), ROBOT.period)
        seconds += ROBOT.period
    assert "the wheels slip, or the camera is frozen" in driver.stop_reason
    assert seconds <= 3.0
    assert driver.step(FREE, GOAL, pose)[0] > 0  # somebody freed it


@DRIVERS
def test_a_camera_that_knows_nothing_beyond_its_reach_does_not_stop_it(make):
    """A depth camera gives 0 there, so in a large hall all ranges end where its reach does."""
    driver, rng, pose = make(), np.random.default_rng(0), (0.0, 0.0, 0.0)
    floor = np.where(np.isfinite(hall()) & (hall() < 4.0), hall(), 0.0)
    for _ in range(15):
        depth = floor * rng.normal(1, 0.01, SIZE)
        pose = arc(*pose, *driver.step(depth, GOAL, pose, intrinsics=CAMERA), ROBOT.period)
        assert driver.stop_reason is None


@DRIVERS
def test_a_robot_that_stands_may_see_the_same_again(make):
    driver = make()
    for _ in range(4):
        driver.step(FREE, GOAL, POSE)
        assert driver.stop_reason is None


@DRIVERS
def test_odometry_that_stands_stops_a_robot_that_is_told_to_drive(make):
    kept, driver = {}, make()
    assert Drive(driver, COURSE).run(frozen("odometry", kept)) <= 3.2
    assert "odometry stands" in driver.stop_reason
    assert driver.step(FREE, GOAL, tuple(kept["odometry"])) == (0.0, 0.0)
    driver.reset()
    assert driver.step(FREE, GOAL, tuple(kept["odometry"]))[0] > 0


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (lambda x, y, heading: (x, y, heading), None),
        (lambda x, y, heading: (1000 * x, 1000 * y, heading), "moves 99. times as far .*: give meters"),
        (lambda x, y, heading: (y, x, heading), "moves .* off its heading: give x, y .m., heading .rad."),
        (
            lambda x, y, heading: (x, -y, -heading),
            "turns the other way .*: heading and turn rate are counter",
        ),
        (
            lambda x, y, heading: (0.01 * x, 0.01 * y, math.degrees(heading)),
            "turns 5. times .*: give radians",
        ),
    ],
)
def test_odometry_of_another_sign_order_or_unit_stops_it(wrong, reason):
    """The robot does what it is told: it turns to a goal beside it and drives there, and back."""
    driver, rng, pose = Navigator.load(), np.random.default_rng(0), (0.0, 0.0, 0.0)
    for number in range(60):
        left = math.remainder(
            math.atan2(6.0 - pose[1], -pose[0]) - pose[2] + math.pi * (number > 30), math.tau
        )
        given = rng.uniform(4, 6, ROBOT.columns)
        pose = arc(*pose, *driver.step(given, (6.0, left), wrong(*pose)), ROBOT.period)
    stopped = driver.stop_reason
    if reason is None:
        assert stopped is None
    else:
        with pytest.raises(ValueError, match=rf"^the odometry {reason}.*; reset\(\)"):
            raise ValueError(stopped)


def test_a_latency_delays_what_the_odometry_must_show():
    driver = Navigator.load()
    for number in range(8):
        driver.step(FREE + 0.01 * number, GOAL, POSE, latency=0.6)
        assert driver.stop_reason is None


@pytest.mark.parametrize(
    ("age", "latency", "stops"), [(0.3, 0.0, False), (0.5, 0.0, True), (0.5, 0.2, False), (-1, 0, True)]
)
def test_data_may_be_as_old_as_the_latency_allows(age, latency, stops):
    driver = Navigator.load()
    driver.watch.clock = lambda: 100.0
    driver.step(FREE, GOAL, POSE, stamp=100.0 - age, latency=latency)
    assert (driver.stop_reason is not None) == stops
    if stops:
        assert driver.stop_reason.startswith(
            f"data are {abs(age):.1f} s {'old' if age > 0 else 'in the future'}"
        )


# --- the camera ---------------------------------------------------------------------------------------------


def test_a_covered_lens_has_no_content_and_a_rendered_picture_has():
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[-1:1:240j, -1:1:320j]
    finger = 60 + 90 * np.exp(-(rows**2 + columns**2))
    for level in (0 * finger, 0 * finger + 255, finger):
        noisy = level[..., None] * (1, 0.6, 0.5) + rng.normal(0, 3, (240, 320, 3))
        assert not has_content(np.clip(noisy, 0, 255).astype(np.uint8))
    for index in range(5):
        assert all(has_content(image) for image in render_arena("test", index, (96, 128), views=4).image)


@DRIVERS
def test_it_stands_behind_a_covered_lens_whatever_a_network_says(make):
    driver = make()
    given = {"intrinsics": CAMERA, "image": np.full((96, 128, 3), 255, np.uint8)}
    for number in range(2):
        command = driver.step(hall() + 0.01 * number, GOAL, POSE, **given)
    assert command == (0.0, 0.0)
    assert driver.stop_reason == "the picture shows nothing: a covered lens, darkness or a bare wall"


@pytest.mark.parametrize(
    ("depth", "reason"),
    [
        (hall(pitch=0.1), r"camera's pitch is \+0.10 rad more"),
        (hall(pitch=-0.1), r"camera's pitch is -0.10 rad more"),
        (hall(roll=0.1), r"camera's roll is \+0.10 rad more"),
        (hall(height=0.25), r"0.25 m below the camera, not 0.4: .* factor of 0.6"),
        (hall() * 0.7, r"0.28 m below the camera"),
        (hall() * 10, r"4.0. m below the camera"),
        (hall() * 0.1, r"0.04 m below the camera"),
    ],
)
def test_the_floor_says_what_is_wrong_with_mount_or_scale(depth, reason):
    driver = Navigator.load()
    for number in range(5):
        driver.step(depth * (1 + 0.001 * number), GOAL, (0.01 * number, 0.0, 0.0), intrinsics=CAMERA)
    with pytest.raises(ValueError, match=reason):
        raise ValueError(driver.stop_reason)


@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.15), (0.1, -0.1)])
def test_a_known_tilt_changes_nothing(pitch, roll):
    driver, depth = Navigator.load(), hall(pitch, roll)
    for number in range(6):
        command = driver.step(
            depth * (1 + 0.001 * number),
            GOAL,
            (0.1 * number, 0.0, 0.0),
            intrinsics=CAMERA,
            camera_pitch=pitch,
            camera_roll=roll,
        )
        assert driver.stop_reason is None
        assert command[0] > 0
    level, tilted = depth_to_ranges(hall(), CAMERA), depth_to_ranges(depth, CAMERA, tilt=(pitch, roll))
    seen = ~np.isnan(tilted)
    assert seen.mean() > 0.8
    np.testing.assert_allclose(tilted[seen], level[seen], rtol=0.03)
    if pitch > 0.05:  # untold, the floor is a wall
        assert depth_to_ranges(depth, CAMERA).min() < 3


def test_a_robot_stands_where_a_leveled_camera_would_see_nothing_ahead():
    driver = Navigator.load()
    driver.watch = None
    driver.leveler = lambda *_: (0.2, 0.0, 1.0)
    assert driver.step(hall(0.4), GOAL, (0.0, 0.0, 0.0), intrinsics=CAMERA, camera_pitch=0.4) == (0.0, 0.0)
    assert "the camera is not as it was said: camera_pitch=0.6" in driver.stop_reason


@pytest.mark.parametrize(
    "depth", [hall(pitch=0.09), hall(roll=-0.09), hall() * 0.8, hall() * 1.2, hall(0.06, 0.06) * 1.1]
)
def test_a_leveler_corrects_tilt_and_scale_by_the_floor(depth):
    driver, seen = Navigator.load(), []
    driver.leveler = Leveler()
    steer = driver.commands
    driver.commands = lambda senses: seen.append(senses.ranges[0]) or steer(senses)
    for number in range(8):
        driver.step(depth * (1 + 0.001 * number), GOAL, (0.01 * number, 0.0, 0.0), intrinsics=CAMERA)
        assert driver.stop_reason is None
    expected = 6.0 / np.cos(ROBOT.column_angles)
    np.testing.assert_allclose(seen[-1][3:-3], expected[3:-3], rtol=0.05)
    driver.leveler.reset()
    for number in range(8):  # too much to be a mount's error
        driver.step(depth * (2 + 0.001 * number), GOAL, (0.1 + 0.01 * number, 0.0, 0.0), intrinsics=CAMERA)
    assert "floor" in driver.stop_reason


# --- the goal -----------------------------------------------------------------------------------------------


@DRIVERS
def test_it_stops_at_the_goal_and_drives_to_the_next(make):
    driver = make()
    assert driver.step(FREE, (0.45, 1.0), POSE) == (0.0, 0.0)
    assert driver.stop_reason == "goal reached"
    assert driver.step(FREE, GOAL, POSE)[0] > 0
    driver.watch.tolerance = 0.2
    assert driver.step(FREE, (0.45, 0.0), POSE)[0] > 0


@pytest.mark.parametrize(("evidence", "seconds"), [(8, 5.0), (2, 20.0), (0, math.inf)])
def test_a_planner_gives_up_a_goal_that_its_map_closes_in(evidence, seconds):
    """Soon where the map is sure, late where its readings may be wrong."""
    driver, stops = PlanAndSteer(), []
    ring = np.stack([f(np.linspace(0, math.tau, 200)) for f in (np.cos, np.sin)], axis=1) - (4.0, 0.0)
    for number in range(110):
        pose = (0.2 * math.sin(0.1 * number), 0.0, 0.0)
        driver.step(FREE + 0.001 * number, (4.0 + pose[0], math.pi), pose)  # behind it, where no ray passes
        stops += [ROBOT.period * number] if driver.stop_reason else []
        driver._maps[0].evidence[driver._maps[0].cells(ring)] = evidence
        assert driver.stop_reason in (
            None, "no way to the goal is left on the map of what was seen: an unreachable goal"
        )  # fmt: skip
    assert min(stops, default=math.inf) == pytest.approx(seconds, abs=1.1)


def test_a_driver_alone_gives_up_where_it_comes_no_nearer():
    driver, rng = Navigator.load(), np.random.default_rng(0)
    for number in range(400):
        leg, along = divmod(0.1 * number, 2.0)  # to and fro, the goal is beside it
        x, heading = (2.0 - along, math.pi) if leg % 2 else (along, 0.0)
        bearing = math.remainder(math.atan2(9.0, -x) - heading, math.tau)
        driver.step(rng.uniform(3, 6, ROBOT.columns), (math.hypot(9.0, x), bearing), (x, 0.0, heading))
        if driver.stop_reason:
            break
    assert driver.stop_reason == "30 m driven without coming nearer to the goal: unreachable, or a dead end"


def test_a_robot_that_cannot_leave_its_place_says_so():
    driver = Navigator.load()
    for number in range(151):
        driver.step(FREE + 0.001 * number, GOAL, (0.0, 0.0, 0.01 * (number % 2)))
    assert driver.stop_reason == (
        "the robot has not left its place for 30 s: nothing is free ahead; another goal, or reset() once "
        "that is over"
    )
    driver.reset()
    assert driver.step(FREE, GOAL, (0.0, 0.0, 0.0))[0] > 0


def test_without_a_watch_it_drives_on():
    driver = Navigator.load()
    driver.watch = None
    for number in range(3):
        command = driver.step(FREE, (0.3, 0.0), (0.1 * number, 0.0, 0.0), stamp=-1e9)
    assert command[0] > 0

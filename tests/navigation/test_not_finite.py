"""A robot never steers by what is not a number: it stops, says why, and drives on with good input."""

import math

import gymnasium
import numpy as np
import pytest
import torch

from eldenet.navigation.episodes import Episodes
from eldenet.navigation.localization import Localizer
from eldenet.navigation.observer import Observer, Senses
from eldenet.navigation.policy import Navigator
from eldenet.navigation.qnetwork import QNetwork
from eldenet.navigation.ranges import depth_to_ranges, footprints_to_ranges
from eldenet.navigation.sensors import EXACT, Ranges, SensorScan
from eldenet.simulation.arenas import generate_arena
from eldenet.simulation.robot import ROBOT

NAN, INF = math.nan, math.inf
DEPTH, GOAL, ODOMETRY = np.full((120, 160), 6.0), (5.0, 0.2), (1.0, 2.0, 0.3)
CAMERA = np.array([[110.0, 0, 80], [0, 110.0, 60], [0, 0, 1]])
BLIND = np.full((120, 160), NAN)


def changed(value: np.ndarray, *at: int, to: float) -> np.ndarray:
    value = np.array(value, dtype=float)
    value[at] = to
    return value


@pytest.mark.parametrize("wrong", [NAN, INF, -INF])
@pytest.mark.parametrize("place", range(9))
def test_the_robot_stops_by_what_is_not_finite_and_then_drives_as_if_nothing_had_been(
    wrong: float, place: int
) -> None:
    navigator, untouched = Navigator.load(), Navigator.load()

    def drive(which: Navigator) -> tuple[float, float]:
        return which.step(DEPTH, GOAL, ODOMETRY, intrinsics=CAMERA)

    given = {"depth": DEPTH, "goal": GOAL, "odometry": ODOMETRY, "intrinsics": CAMERA}
    name, at = [
        *(("odometry", (number,)) for number in range(3)),
        *(("goal", (number,)) for number in range(2)),
        *(("intrinsics", at) for at in ((0, 0), (0, 2), (1, 1), (1, 2))),
    ][place]
    bad = given | {name: changed(given[name], *at, to=wrong)}
    for _ in range(2):
        assert navigator.step(**bad) == (0.0, 0.0)
        assert navigator.stop_reason == f"{name} not finite"
    assert drive(navigator) == drive(untouched) != (0.0, 0.0)
    assert navigator.stop_reason is untouched.stop_reason is None
    assert drive(navigator) == drive(untouched)  # nothing of it was remembered


@pytest.mark.parametrize(
    ("depth", "intrinsics"), [(BLIND, CAMERA), (np.full(40, NAN), None), (np.zeros(5), None)]
)
def test_the_robot_stops_where_its_camera_is_blind(depth: np.ndarray, intrinsics: np.ndarray | None) -> None:
    navigator = Navigator.load()
    assert navigator.step(depth, GOAL, ODOMETRY, intrinsics=intrinsics) == (0.0, 0.0)
    assert navigator.stop_reason == "no value of depth is known"
    # single holes are near obstacles, not a reason to stop for ever; infinite is free
    assert navigator.step(changed(np.full(40, 8.0), 3, to=NAN), GOAL, ODOMETRY)[0] > 0
    assert navigator.step(np.full(40, INF), GOAL, ODOMETRY)[0] > 0
    assert navigator.stop_reason is None


def test_the_command_before_a_stop_is_forgotten() -> None:
    navigator = Navigator.load()
    assert navigator.step(np.full(40, 8.0), GOAL, ODOMETRY)[0] > 0
    navigator.step(np.full(40, 8.0), GOAL, (NAN, 0.0, 0.0))
    assert not navigator.observer.last.any()


def test_a_camera_height_can_be_given_with_the_depth() -> None:
    for height in (0.3, 0.4):
        by_ranges, by_depth = Navigator.load(), Navigator.load()
        ranges = depth_to_ranges(DEPTH, CAMERA, camera_height=height)
        expected = by_ranges.step(ranges, GOAL, ODOMETRY)
        shown = by_depth.step(DEPTH, GOAL, ODOMETRY, intrinsics=CAMERA, camera_height=height)
        assert shown == expected
    for height in (NAN, 0.0, -1.0, 40.0):  # 40: centimeters
        with pytest.raises(ValueError, match=f"camera_height={height:g}: give it in meters"):
            by_depth.step(DEPTH, GOAL, ODOMETRY, intrinsics=CAMERA, camera_height=height)
    # as ROS's CameraInfo of an uncalibrated one
    with pytest.raises(ValueError, match="fx and fy above 0"):
        by_depth.step(DEPTH, GOAL, ODOMETRY, intrinsics=np.zeros((3, 3)))


@pytest.mark.parametrize("members", [1, 3])
def test_a_policy_of_weights_that_are_not_finite_does_not_load(members: int, tmp_path) -> None:
    files = []
    for number in range(members):
        torch.manual_seed(number)
        files.append(tmp_path / f"{number}.safetensors")
        network = QNetwork(39, 5, (16,))
        with torch.no_grad():
            network.layers[0].weight[3, 4] = NAN if number == members - 1 else 0.0
        Navigator(network, {}).save(files[-1])
    with pytest.raises(
        ValueError, match=rf"{members - 1}\.safetensors are not finite \(layers\.0\.weight; 1 of"
    ):
        Navigator.load(files)


@pytest.mark.parametrize("wrong", [NAN, INF, 0.0])
def test_a_driver_of_numbers_that_are_not_finite_or_0_is_refused(wrong: float) -> None:
    """It would command nan m/s."""
    with pytest.raises(ValueError, match=f"slows_within={wrong}: give a finite distance above 0"):
        Navigator.load(slows_within=wrong)


def test_the_observer_and_the_localizer_refuse_it_and_keep_their_state() -> None:
    observer = Observer()
    ranges = np.full((1, ROBOT.columns), 5.0)
    good = Senses(ranges, np.zeros((1, 3)), np.array([GOAL]), ranges, np.zeros((1, 3)))
    expected = Observer().observe(good)
    for name in good._fields:
        bad = good._replace(**{name: changed(getattr(good, name), 0, 1, to=NAN)})
        with pytest.raises(ValueError, match=f"{name} not finite: stop the robot"):
            observer.observe(bad)
    np.testing.assert_array_equal(observer.observe(good), expected)
    localizer = Localizer((0.0, 0.0, 0.0), deviation=0.15)
    for act in (lambda: localizer.move((NAN, 0.0, 0.0)), lambda: localizer.fix(0.0, INF)):
        with pytest.raises(ValueError, match="is not finite and would spoil the estimate"):
            act()
    localizer.move((0.1, 0.0, 0.0))
    assert np.isfinite([*localizer.pose, *localizer.odometry]).all()
    with pytest.raises(ValueError, match="a box is not finite"):
        footprints_to_ranges(np.array([[2.0, NAN, 0.0, 0.5, 0.5]]))


class Broken:
    """A sensor whose second scan is not a number."""

    drift = EXACT
    latency = 0.0

    def begin(self, world, rng):
        self.scans = 0
        return self

    def scan(self) -> SensorScan:
        self.scans += 1
        return SensorScan(np.full(ROBOT.columns, NAN if self.scans > 1 else 5.0), np.zeros(40, np.intp))


def test_the_environment_ends_where_a_sensor_or_a_command_is_not_finite() -> None:
    name = "eldenet.navigation.registration:eldenet/ArenaNav-v0"
    for environment in (
        gymnasium.make(name, sensor=Broken()),
        gymnasium.make_vec(name, num_envs=1, sensor=Broken()),
    ):
        environment.reset(seed=0)
        action = 2 if environment.action_space.shape == () else np.array([2])
        with pytest.raises(ValueError, match="ranges not finite"):
            environment.step(action)
    episodes = Episodes(1, Ranges())
    episodes.start(0, generate_arena("train", 5, 0), (0,))
    before = episodes.poses.copy()
    with pytest.raises(ValueError, match="the driver commands nan m/s"):
        episodes.step(np.array([[NAN, 0.0]]))
    np.testing.assert_array_equal(episodes.poses, before)

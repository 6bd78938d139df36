"""The driver moves for fresh and finite data alone."""

import math

import numpy as np
import pytest
from eldenet_ros.driving import Pilot

from eldenet.geometry import pinhole
from eldenet.navigation.latency import ahead
from eldenet.navigation.policy import Navigator

CAMERA = pinhole(110.0, 110.0, 80.0, 60.0)
NAVIGATOR = Navigator.load()


def fed(**more) -> Pilot:
    pilot = Pilot(NAVIGATOR, camera_height=0.4, **more)
    feed(pilot, 100.0)
    assert pilot.aim(5.0, 0.0, "odom") == ""
    return pilot


def feed(pilot: Pilot, now: float, *, depth: float = 6.0, pose=(0.0, 0.0, 0.0), camera=CAMERA) -> None:
    pilot.see(np.full((120, 160), depth), camera, now)
    pilot.move(pose, "odom", now)


def stands(pilot: Pilot, now: float, reason: str) -> bool:
    command = pilot.decide(now)
    assert reason in command.reason
    assert (pilot.driver.observer.last == 0).all()  # the policy knows that it stands
    return (command.speed, command.turn) == (0.0, 0.0)


def test_it_drives_to_the_goal_and_stands_there() -> None:
    pilot = fed()
    assert pilot.decide(100.1).speed > 0
    feed(pilot, 100.2, pose=(4.6, 0.0, 0.0))
    assert stands(pilot, 100.3, "goal reached")
    assert stands(pilot, 100.3, "no goal")


@pytest.mark.parametrize("name", ["depth", "odometry"])
@pytest.mark.parametrize("age", [0.5, 3.0, 1e9, -0.5, -3.0, math.nan, math.inf, -math.inf])
def test_data_that_are_not_fresh_stop_it_and_fresh_ones_let_it_go_on(name, age) -> None:
    pilot = fed()
    assert pilot.decide(100.1).speed > 0
    pilot.stamps[name] = 100.1 - age
    assert stands(pilot, 100.1, name)
    feed(pilot, 100.2)
    assert pilot.decide(100.3).speed > 0


def test_a_camera_that_repeats_one_picture_stops_it() -> None:
    pilot = fed()
    for now in np.arange(100.1, 102.0, 0.2):
        pilot.see(np.full((120, 160), 6.0), CAMERA, 100.0)  # the same stamp again and again
        pilot.move((0.0, 0.0, 0.0), "odom", now)
        moves = pilot.decide(now).speed > 0
        assert moves == (now < 100.5)


@pytest.mark.parametrize("silent", [False, True])
def test_latency_is_predicted_by_what_it_executed_in_every_period(silent, monkeypatch) -> None:
    """Without a new picture the last command goes on; without data it stands."""
    asked = []

    def spy(pose, goal, sent, latency):
        asked.append(list(sent[-2:]))
        return ahead(pose, goal, sent, latency)

    monkeypatch.setattr("eldenet.navigation.on_robot.ahead", spy)
    pilot = fed(latency=0.4)
    executed, x = [], 0.0
    for period in range(12):
        now = 100.1 + 0.2 * period
        if period % 2 == 0:
            feed(pilot, now, depth=0.8 + 0.05 * period, pose=(x, 0.0, 0.0))
        if silent and period in (5, 6, 7):
            pilot.stamps["odometry"] = now - 3.0
        before = len(asked)
        command = pilot.decide(now)
        if len(asked) > before and len(executed) > 1:
            assert asked[-1] == executed[-2:]
        executed.append((command.speed, command.turn))
        x += 0.2 * command.speed
    assert len(asked) > 2
    assert len(set(executed)) > 2


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_never_moves_it(wrong) -> None:
    pilot = fed()
    for place in range(3):
        pose = [0.0, 0.0, 0.0]
        pose[place] = wrong
        feed(pilot, 100.0, pose=tuple(pose))
        assert stands(pilot, 100.1, "")
    for row, column in np.ndindex(3, 3):
        camera = CAMERA.copy()
        camera[row, column] = wrong
        feed(pilot, 100.0, camera=camera)
        assert stands(pilot, 100.1, "")
    feed(pilot, math.nan)
    assert stands(pilot, 100.1, "yet")
    feed(pilot, 100.0)
    assert stands(pilot, wrong, "")  # the clock
    assert pilot.decide(100.1).speed > 0
    assert "not finite" in pilot.aim(wrong, 0.0, "odom")
    assert stands(pilot, 100.1, "no goal")


@pytest.mark.parametrize("unknown", [math.nan, 0.0, -1.0])
def test_depth_of_which_nothing_is_known_stops_it(unknown) -> None:
    pilot = fed()
    feed(pilot, 100.0, depth=unknown)
    assert stands(pilot, 100.1, "no value of depth")


def test_a_driver_whose_command_is_not_finite_stops_it(monkeypatch) -> None:
    pilot = fed()
    for command in ((math.nan, 0.0), (0.5, math.inf)):
        monkeypatch.setattr(pilot.driver, "step", lambda *_, command=command, **__: command)
        assert stands(pilot, 100.1, "not finite")


def test_a_camera_that_sees_too_little_stops_it_and_says_why() -> None:
    pilot = fed()
    feed(pilot, 100.0, camera=pinhole(400.0, 400.0, 80.0, 60.0))
    assert stands(pilot, 100.1, "25.0 degrees to each side")


def test_a_goal_in_another_frame_or_before_odometry_is_rejected() -> None:
    assert "no odometry" in Pilot(NAVIGATOR, camera_height=0.4).aim(1.0, 1.0, "odom")
    pilot = fed()
    assert "'map'" in pilot.aim(1.0, 1.0, "map")
    assert stands(pilot, 100.1, "no goal")


def test_a_speed_limit_keeps_the_arc() -> None:
    fast, slow = fed(), fed(max_speed=0.2)
    fast.driver.reset()
    one = fast.decide(100.1)
    slow.driver.reset()
    other = slow.decide(100.1)
    assert one.speed > 0.3
    assert other.speed == pytest.approx(0.2)
    assert other.turn * one.speed == pytest.approx(one.turn * other.speed)


def test_depth_belongs_to_the_pose_at_its_own_time(monkeypatch) -> None:
    """A network takes time, and the robot turns meanwhile."""
    pilot, given = fed(), {}
    monkeypatch.setattr(
        pilot.driver, "step", lambda *at, **more: given.update(more, odometry=at[2]) or (0, 0)
    )
    for step in range(20):
        pilot.move((0.0, 0.0, 0.06 * step), "odom", 100.0 + 0.05 * step)
    pilot.see(np.full((120, 160), 6.0), CAMERA, 100.66)
    pilot.decide(101.0)
    assert given["odometry"] == pytest.approx((0.0, 0.0, 1.14))
    assert given["scanned_from"] == pytest.approx((0.0, 0.0, 0.78))


def test_a_goal_is_lost_with_its_frame() -> None:
    pilot = fed()
    pilot.move((100.0, 100.0, 0.0), "map", 100.1)
    assert stands(pilot, 100.1, "no goal")


@pytest.mark.parametrize("name", ["camera_height", "max_speed", "stale"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_settings_out_of_range_end_in_one_line(name, value) -> None:
    with pytest.raises(ValueError, match=f"{name}=.*above 0"):
        Pilot(NAVIGATOR, **{"camera_height": 0.4, name: value})


def test_the_driver_knows_the_latency(monkeypatch) -> None:
    pilot, given = fed(latency=0.3), {}
    monkeypatch.setattr(pilot.driver, "step", lambda *_, **more: given.update(more) or (0, 0))
    pilot.decide(100.1)
    assert given["latency"] == 0.3
    with pytest.raises(ValueError, match=r"latency=2\.0: give seconds from 0 to 1"):
        Pilot(NAVIGATOR, camera_height=0.4, latency=2.0)


def test_a_picture_counts_once(monkeypatch) -> None:
    """Two scans that agree decide more than one, so the same scan must not come twice."""
    pilot, steps = fed(), []
    monkeypatch.setattr(pilot.driver, "step", lambda *_, **__: steps.append(1) or (0.3, 0.1))
    for now in (100.1, 100.3):
        pilot.move((0.0, 0.0, 0.0), "odom", now)
        assert pilot.decide(now).speed == 0.3
    assert len(steps) == 1
    pilot.move((math.nan, 0.0, 0.0), "odom", 100.35)
    pilot.decide(100.35)
    assert len(steps) == 2  # a pose that is not finite never repeats a command


def test_a_new_goal_keeps_what_the_robot_remembers() -> None:
    pilot = fed()
    feed(pilot, 100.0, depth=1.5)
    pilot.decide(100.1)
    remembered = len(pilot.driver.observer.memory.points(0))
    assert remembered > 0
    pilot.aim(5.0, 0.1, "odom")
    assert len(pilot.driver.observer.memory.points(0)) == remembered


def test_poses_of_before_a_clock_began_anew_do_not_count() -> None:
    pilot = fed()
    for step in range(5):
        pilot.move((float(step), 0.0, 0.0), "odom", 200.0 + step)
    pilot.move((7.0, 0.0, 0.0), "odom", 1.0)
    assert pilot._pose_at(202.0) == (7.0, 0.0, 0.0)

"""A lidar drives both drivers: beams at any angles become their columns, all round."""

import math

import numpy as np
import pytest

from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import run_episodes
from eldenet.navigation.lidar import Scan, scan_to_ranges
from eldenet.navigation.planners.plan_and_steer import PlanAndSteer
from eldenet.navigation.policy import Navigator
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.robot import ALL_ROUND, ROBOT, front

DRIVERS = pytest.mark.parametrize("make", [Navigator.load, PlanAndSteer])
ANGLES = np.radians(np.linspace(-135, 135, 720))
COLUMNS = np.array(ALL_ROUND.column_angles)
GOAL, HERE = (5.0, 0.0), (0.0, 0.0, 0.0)
NAVIGATOR = Navigator.load()


def room(angles: np.ndarray, ahead: float, half: float = 4.0) -> np.ndarray:
    """Distances [m] from a lidar on the center line of a square room, the robot in the middle."""
    with np.errstate(divide="ignore"):
        to_x = (np.sign(np.cos(angles)) * half - ahead) / np.cos(angles)
        to_y = half / np.abs(np.sin(angles))
    return np.minimum(to_x, to_y)


@pytest.mark.parametrize("ahead", [ROBOT.camera_ahead, 0.0, -0.3])
def test_columns_are_seen_from_the_camera_s_place(ahead):
    ranges = scan_to_ranges(Scan(room(ANGLES, ahead), ANGLES, ahead))
    seen = np.abs(COLUMNS) < np.radians(130)
    # the nearest beam of a column 1.7 degrees wide; at a corner it is up to 2 % nearer than the middle one
    np.testing.assert_allclose(ranges[seen], room(COLUMNS[seen], ROBOT.camera_ahead), rtol=0.025)
    assert np.isnan(ranges[np.abs(COLUMNS) > np.radians(142)]).all()
    np.testing.assert_allclose(front(COLUMNS), ROBOT.column_angles)


def test_order_turns_and_repeated_beams_do_not_matter():
    ranges = room(ANGLES, 0.2)
    wanted = scan_to_ranges(Scan(ranges, ANGLES))
    order = np.random.default_rng(0).permutation(len(ANGLES))
    for angles in (ANGLES, ANGLES % math.tau):
        np.testing.assert_allclose(scan_to_ranges(Scan(ranges[order], angles[order])), wanted)
    turn = np.linspace(0, math.tau, 721)  # its last beam is its first
    assert np.isfinite(scan_to_ranges(Scan(np.full(721, 3.0), turn))).all()


def test_the_nearest_beam_of_a_column_counts_and_one_degree_apart_suffices():
    angles = np.radians(np.arange(-135.0, 136.0))
    ranges = np.full(len(angles), 6.0)
    ranges[[100, 40]] = 1.0  # of one beam each
    columns = scan_to_ranges(Scan(ranges, angles))
    assert np.isfinite(columns[np.abs(COLUMNS) < np.radians(134)]).all()
    assert (columns < 1.1).sum() == 2


def test_unknown_beams_are_near_in_front_and_unseen_beside():
    for unknown in (math.nan, 0.0, -1.0, -math.inf):
        ranges = np.full(720, math.inf)
        blind = (np.abs(ANGLES - 0.2) < 0.06) | (np.abs(ANGLES - 1.7) < 0.06)
        ranges[blind] = unknown
        ranges[(np.abs(ANGLES + 0.2) < 0.03)][::2] = unknown  # every second beam tells enough
        columns = scan_to_ranges(Scan(ranges, ANGLES))
        assert columns[np.abs(COLUMNS - 0.2).argmin()] == ROBOT.near
        assert np.isnan(columns[np.abs(COLUMNS - 1.7).argmin()])
        assert columns[np.abs(COLUMNS + 0.2).argmin()] == ROBOT.far


def test_the_robot_itself_is_no_obstacle():
    ranges = np.full(720, 5.0)
    mast = np.abs(ANGLES - 2.0) < 0.1
    ranges[mast] = 0.15
    assert np.isnan(scan_to_ranges(Scan(ranges, ANGLES))[np.abs(COLUMNS - 2.0).argmin()])


@pytest.mark.parametrize(("ahead", "away"), [(0.2, 0.08), (0.1, 0.05), (0.0, 0.15), (-0.2, 0.3)])
def test_what_a_mast_ahead_hides_reads_as_near(ahead, away):
    ranges = np.full(720, 5.0)
    ranges[np.abs(ANGLES) < np.radians(8)] = away  # behind the camera's place, but in one case
    columns = scan_to_ranges(Scan(ranges, ANGLES, ahead))
    assert (columns[np.abs(COLUMNS) < np.radians(6)] == ROBOT.near).all()


@DRIVERS
def test_it_remembers_what_lies_beside_it(make):
    driver = make()
    ranges = np.full(720, math.inf)
    ranges[np.abs(ANGLES - math.pi / 2) < 0.1] = 1.0
    for _ in range(2):
        driver.step(Scan(ranges, ANGLES), GOAL, HERE)
    assert driver.stop_reason is None
    x, y = driver.observer.memory.points(0).T
    assert len(x) > 3
    np.testing.assert_allclose(x, ROBOT.camera_ahead, atol=0.15)
    np.testing.assert_allclose(y, 1.0, atol=0.05)
    camera = np.full(ROBOT.columns, 6.0)
    assert driver.step(camera, GOAL, HERE)[0] > 0  # another sensor: what the lidar saw is forgotten
    assert driver.observer.memory.points(0)[:, 0].min() > 5


def test_a_planner_s_map_knows_the_side_that_no_camera_sees():
    driver = PlanAndSteer()
    driver.step(Scan(np.full(720, math.inf), ANGLES), GOAL, HERE)
    centers, evidence = driver._maps[0].near(np.zeros(3), 5.0)
    bearing = np.abs(np.degrees(np.arctan2(centers[:, 1], centers[:, 0] - ROBOT.camera_ahead)))
    away = np.hypot(*centers.T) > 1.0
    assert (evidence[away & (bearing < 128)] < 0).mean() > 0.7  # rays leave gaps
    assert (evidence[away & (bearing > 142)] == 0).all()


class ByScans:
    """Drives a simulated robot by :meth:`OnRobot.step` with a lidar's scans."""

    name = "scans"

    def __init__(self, driver):
        self.driver = driver

    def reset(self, robot, world=None):
        self.driver.reset()

    def commands(self, senses, robots=None):
        scan = Scan(senses.ranges[0], COLUMNS)
        return np.array([self.driver.step(scan, senses.goal[0], senses.odometry[0])])


@pytest.mark.slow
def test_it_drives_through_an_arena_by_a_lidar():
    arenas, settings = frozen_arenas(40, 2, split="val"), EpisodeSettings("wheels")
    for policy in (ByScans(PlanAndSteer()), PlanAndSteer()):
        rows = run_episodes(
            arenas, lambda robots, policy=policy: policy, Ranges(view=270), settings, robots=1
        )
        assert [row.outcome for row in rows] == ["success", "success"]


@pytest.mark.parametrize(
    ("ranges", "angles", "ahead", "words"),
    [
        (np.ones(720), ANGLES[1:], 0.2, r"ranges of shape \(720,\) and angles \(719,\): give both as \(N,\)"),
        (np.ones((2, 360)), ANGLES, 0.2, r"ranges of shape \(2, 360\)"),
        (np.ones(0), np.ones(0), 0.2, "give both"),
        (np.ones(720), np.degrees(ANGLES), 0.2, "from -135 to 135, more than a turn: degrees"),
        (np.ones(720), np.where(ANGLES > 2, np.nan, ANGLES), 0.2, "of a scan's 720 angles are not finite"),
        (np.full(720, 2500), ANGLES, 0.2, "give meters as floats"),
        (np.full(720, 2500.0), ANGLES, 0.2, "millimeters"),
        (np.ones(720), ANGLES, 12, "ahead=12: give -0.5 to 0.5"),
        (np.ones(720), ANGLES, math.nan, "ahead=nan"),
        (np.ones(720), ANGLES + 2.0, 0.2, "give one with a beam every 3.5 degrees, 25 to each side"),
        (np.ones(20), np.linspace(-1, 1, 20), 0.2, "a scan of 20 beams from -57 to 57 degrees"),
        ("ranges", ANGLES, 0.2, "ranges='ranges': give an array of numbers"),
        (np.ones(720), [None] * 720, 0.2, "give an array of numbers"),
    ],
)  # fmt: skip
def test_a_wrong_scan_is_refused_in_one_line(ranges, angles, ahead, words):
    with pytest.raises(ValueError, match=words) as error:
        NAVIGATOR.step(Scan(ranges, angles, ahead), GOAL, HERE)
    assert "\n" not in str(error.value)


@DRIVERS
def test_a_scan_that_knows_nothing_moves_no_robot(make):
    driver = make()
    for ranges in (np.full(720, np.nan), np.full(720, -np.inf), np.zeros(720), np.full(720, 1e-9)):
        assert driver.step(Scan(ranges, ANGLES), GOAL, HERE) == (0.0, 0.0)
        assert driver.stop_reason

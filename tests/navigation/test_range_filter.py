"""What the range filter promises: no single reading decides, and what is there stays."""

import math

import numpy as np
import pytest

from eldenet.compose import compose
from eldenet.navigate import NavigateSettings
from eldenet.navigation.cameras import camera, depth_camera
from eldenet.navigation.episodes import Episodes, EpisodeSettings
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.policy import Navigator
from eldenet.navigation.range_filter import WIDEST_GAP, RangeFilter, fill_gaps
from eldenet.navigation.sensors import BURST, EXACT, Ranges, SensorScan
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import generate_arena
from eldenet.simulation.robot import ROBOT

STILL = np.zeros(3)
NAN = math.nan


def wall(**readings: float) -> np.ndarray:
    """A wall at 6 m with other readings in some columns: ``wall(c7=0.3)``."""
    out = np.full(ROBOT.columns, 6.0)
    for name, value in readings.items():
        out[int(name[1:])] = value
    return out


def ahead(meters: float) -> np.ndarray:
    return np.array([meters, 0.0, 0.0])


@pytest.mark.parametrize("column", [*range(1, ROBOT.columns - 1)])
@pytest.mark.parametrize("value", [ROBOT.near, 0.7, ROBOT.far, NAN])
def test_a_single_reading_decides_nothing(column, value):
    for scans in (1, 3):
        steady = RangeFilter()
        for _ in range(scans):
            ranges, _ = steady(wall(**{f"c{column}": value}), STILL)
            assert (ranges == 6.0).all()


@pytest.mark.parametrize("column", [0, ROBOT.columns - 1])
def test_at_the_edge_of_the_view_two_scans_decide(column):
    steady = RangeFilter()
    steady(wall(), STILL)
    one = wall(**{f"c{column}": 0.5})
    assert (steady(one, STILL)[0] == 6.0).all()
    assert (steady(one, STILL)[0] == one).all()


@pytest.mark.parametrize(("away", "columns"), [(0.3, 3), (0.5, 3), (0.7, 2), (1.5, 2), (4.0, 2)])
def test_a_thing_of_five_centimeters_is_seen_at_once(away, columns):
    for first in range(ROBOT.columns - columns + 1):
        ranges = wall(**{f"c{number}": away for number in range(first, first + columns)})
        steady = RangeFilter()
        steady(wall(), STILL)
        out, _ = steady(ranges, STILL)
        assert (out[ranges == away] == away).all()
        assert (out[3:-3] == ranges[3:-3]).all()  # gaps of two columns at the edge of the view are filled


def test_a_far_thin_thing_counts_from_the_second_scan_though_the_robot_drives():
    steady = RangeFilter()
    steady(wall(), STILL)
    assert steady(wall(c20=2.0), ahead(0.2))[0][20] == 6.0
    assert steady(wall(c20=1.8), ahead(0.4))[0][20] == 1.8
    assert steady(wall(c20=1.8), ahead(0.6))[0][20] == 6.0  # that one came along with the robot


def test_what_two_neighbors_show_in_random_scenes_stays():
    rng = np.random.default_rng(0)
    for _ in range(200):
        ends = np.sort(rng.choice(np.arange(3, ROBOT.columns - 3, 3), 4, replace=False))
        scene = rng.uniform(ROBOT.near, ROBOT.far, 5)[
            np.searchsorted(ends, np.arange(ROBOT.columns), "right")
        ]
        np.testing.assert_array_equal(RangeFilter()(scene, STILL)[0], scene)


def test_narrow_gaps_are_filled_and_wide_ones_read_as_near():
    for width in range(1, ROBOT.columns):
        gap = np.where(np.arange(ROBOT.columns) < width, NAN, 4.0)
        assert set(fill_gaps(gap)[:width]) == {4.0 if width <= WIDEST_GAP else ROBOT.near}
    between = np.where(np.arange(ROBOT.columns) < 20, 2.0, 5.0)
    between[20] = NAN
    assert fill_gaps(between)[20] == 2.0  # the nearer one
    assert (fill_gaps(np.full(ROBOT.columns, NAN)) == ROBOT.near).all()


def test_a_column_that_stays_near_while_the_robot_drives_is_a_fault():
    steady = RangeFilter()
    for step in range(8):
        ranges, _ = steady(wall(c12=ROBOT.near) - 0.1 * step * (np.arange(40) != 12), ahead(0.1 * step))
        assert ranges[12] == pytest.approx(6.0 - 0.1 * step)
        assert steady.faults == ((12,) if step >= 5 else ())
    # beside a faulty column, two wrong readings are still two
    assert steady(wall(c11=0.6, c12=ROBOT.near), ahead(0.8))[0].min() == 6.0
    for _ in range(12):
        steady(wall(), ahead(0.8))
    assert steady.faults == ()


def test_a_wall_beside_the_robot_and_a_standing_robot_are_no_faults():
    along, standing = RangeFilter(), RangeFilter()
    for step in range(20):
        ranges = np.where(np.arange(ROBOT.columns) < 8, 0.6, 6.0)
        np.testing.assert_array_equal(along(ranges, ahead(0.2 * step))[0], ranges)
        standing(wall(c5=0.3), STILL)
    assert along.faults == standing.faults == ()


def test_true_ranges_of_arenas_pass_and_show_no_fault():
    changed = farther = total = 0
    for number in range(3):
        world, steady = ArenaWorld(generate_arena("val", 80, number)), RangeFilter()
        for _ in range(40):
            world.advance(0.5, 0.3, ROBOT.period)
            ranges = world.ranges()
            out, _ = steady(ranges, np.array(world.pose))
            changed += int((out != ranges).sum())
            total += len(ranges)
            farther += int((out > ranges).sum())
        assert steady.faults == ()
    assert changed < 0.05 * total
    assert farther < 0.01 * total


def test_how_near_things_may_be_is_filled_in_the_same_columns():
    doubtful = wall(c9=ROBOT.near) * 0.8
    ranges, cautious = RangeFilter()(wall(c9=ROBOT.near), STILL, doubtful)
    assert (ranges == 6.0).all()
    np.testing.assert_allclose(cautious, 4.8)


class Blinking:
    """A sensor with one unknown column."""

    drift = EXACT
    latency = 0.0

    def begin(self, world, rng):
        return self

    def scan(self) -> SensorScan:
        return SensorScan(wall(c30=NAN), np.zeros(ROBOT.columns, np.intp))


def test_any_driver_gets_filtered_ranges_by_a_setting_of_the_episode():
    for on in (False, True):
        episodes = Episodes(1, Blinking(), EpisodeSettings(range_filter=on))
        episodes.start(0, generate_arena("train", 5, 0), (0,))
        assert (episodes.sense().not_finite is None) == on


def test_by_default_the_command_filters_where_single_columns_may_be_wrong():
    settings = EpisodeSettings(range_filter=None)
    wrong = [Ranges(false_near=0.02), Ranges(false_far=0.02), Ranges(stuck=1), depth_camera()]
    right = [Ranges(), Ranges(factor=0.9, lost=0.1, latency=0.4), NoisyRanges(), camera(), Blinking()]
    assert all(map(settings.filters, wrong))
    assert not any(map(settings.filters, right))
    assert EpisodeSettings(range_filter=True).filters(Ranges())
    for mode in ("record", "evaluate"):
        assert compose(NavigateSettings, [f"mode={mode}"]).range_filter is None


def test_the_trained_driver_is_not_slowed_by_one_reading():
    clear, wrong, unfiltered = Navigator.load(), Navigator.load(), Navigator.load()
    unfiltered.range_filter = None
    for driver in (clear, wrong, unfiltered):
        driver.watch = None  # the same readings all the way: it would take the camera for frozen
    for scan in range(5):
        goal, odometry = (8.0, 0.0), (0.2 * scan, 0.0, 0.0)
        expected = clear.step(wall(), goal, odometry)
        assert wrong.step(wall(c20=ROBOT.near if scan % 2 else NAN), goal, odometry) == expected
        assert unfiltered.step(wall(c20=ROBOT.near), goal, odometry)[0] < 0.3 * expected[0]


def test_wrong_readings_come_in_the_asked_shares():
    world = ArenaWorld(generate_arena("val", 5, 0))
    true = world.ranges()
    instance = Ranges(false_near=0.1, false_far=0.2, stuck=1).begin(world, np.random.default_rng(0))
    scans = np.stack([instance.scan().ranges for _ in range(500)])
    near, free = (scans == ROBOT.near).mean(axis=0), (scans == ROBOT.far).mean(axis=0)
    stuck = near == 1
    assert stuck.sum() == 1
    assert near[~stuck].mean() == pytest.approx(0.1, abs=0.01)
    assert free[~stuck & (true < ROBOT.far)].mean() == pytest.approx(0.2, abs=0.01)
    assert (Ranges().begin(world, np.random.default_rng(0)).scan().ranges == true).all()


def test_a_factor_scales_what_is_in_range():
    world = ArenaWorld(generate_arena("val", 5, 0))
    true = world.ranges()
    for factor in (0.85, 1.15):
        ranges = Ranges(factor=factor).begin(world, np.random.default_rng(0)).scan().ranges
        scaled = np.clip(factor * true, ROBOT.near, ROBOT.far)
        assert ranges == pytest.approx(np.where(true < ROBOT.far, scaled, true))


def test_lost_scans_come_in_bursts_and_repeat_the_last_one():
    world = ArenaWorld(generate_arena("val", 5, 0))
    instance, lost = Ranges(lost=0.1).begin(world, np.random.default_rng(0)), []
    for number in range(4000):
        world.place((0.01 * (number % 100) - 8, 0.0, 0.0))
        before, ranges = instance.last, instance.scan().ranges
        lost.append(bool(instance.losing))
        assert (ranges == (before if lost[-1] else world.ranges())).all()
    bursts = np.diff(np.array(lost, int), prepend=0).clip(0).sum()
    assert np.mean(lost) == pytest.approx(0.1, abs=0.03)
    assert sum(lost) / bursts == pytest.approx(BURST, abs=1.5)


@pytest.mark.parametrize(
    "wrong",
    [{"false_near": -0.1}, {"false_far": NAN}, {"stuck": 41}, {"factor": 3}, {"view": 400}, {"lost": 0.9}],
)
def test_errors_out_of_range_are_refused(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=rf"sensor\.{name}=.*: give [0-9.]+ to [0-9.]+$"):
        Ranges(**wrong)

"""Plan where stuck: the driver alone while it gets somewhere, and out of traps by a plan."""

import numpy as np
import pytest

from eldenet.navigation.evaluation import run_episodes, summarize
from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.observer import Senses
from eldenet.navigation.planners.plan_when_stuck import OUT, REACH, STUCK_FOR, PlanWhenStuck
from eldenet.navigation.policy import Navigator
from eldenet.navigation.range_errors import RangeErrors
from eldenet.navigation.tasks import frozen_arenas
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT

PERIODS = round(STUCK_FOR / ROBOT.period)
DRIFT = {"distance": 0.02, "heading": 0.0175}


def wall(goal: float, x: float = 0.0) -> Senses:
    """What a robot senses that stands at ``x`` [m] before a wall, with the goal ahead."""
    return Senses(np.full((1, ROBOT.columns), 1.0), np.array([[x, 0.0, 0.0]]), np.array([[goal, 0.0]]))


@pytest.mark.slow
def test_while_it_gets_somewhere_it_is_the_driver_alone():
    arenas, sensor = frozen_arenas(40, 4, split="val"), NoisyRanges(errors="packaged", drift=DRIFT)
    alone = run_episodes(arenas, lambda robots: Navigator.load(slows_within=1.0, robots=robots), sensor)
    drivers = []
    make = lambda robots: drivers.append(PlanWhenStuck(robots=robots)) or drivers[-1]  # noqa: E731
    assert run_episodes(arenas, make, sensor) == alone
    assert not drivers[0].rescues.any()


@pytest.mark.slow
def test_it_leaves_traps_in_which_the_driver_alone_stays():
    """Things within 0.6 m read too far, and far ones too near and by chance, as a tuned network's."""
    errors = RangeErrors(
        edges=(0.3, 0.6, 2.0, 4.0, 10.0),
        bias=(0.5, 0.0, 0.0, -0.2),
        spread=(0.3, 0.15, 0.2, 0.3),
        miss=(0.03, 0.02, 0.02, 0.05),
        scale=0.3,
        smooth=0.9,
        column=0.5,
        memory=0.9,
    )
    walls = tuple(
        Obstacle("box", x, y, 0.0, half, 1.0)
        for x, y, half in ((2.0, 0.0, (0.1, 2.0)), (0.0, 2.0, (2.0, 0.1)), (0.0, -2.0, (2.0, 0.1)))
    )
    arenas = [Arena("", 3, k, walls, (-6.0, 0.3 * k - 0.5, 0.0), ((7.0, 0.0),)) for k in range(4)]
    sensor = NoisyRanges(errors=errors, drift=DRIFT)
    alone = run_episodes(arenas, lambda robots: Navigator.load(slows_within=1.0, robots=robots), sensor)
    rows = run_episodes(arenas, lambda robots: PlanWhenStuck(robots=robots), sensor)
    assert summarize(alone)["success"] == 0
    assert summarize(rows)["success"] >= 75


@pytest.mark.slow
def test_it_decides_the_same_alone_and_among_others():
    arenas, sensor = frozen_arenas(10, 3, split="val", kind="traps"), NoisyRanges()
    make = lambda robots: PlanWhenStuck(robots=robots)  # noqa: E731
    assert run_episodes(arenas, make, sensor, robots=3) == run_episodes(arenas, make, sensor, robots=1)


def test_it_is_stuck_without_progress_until_it_is_nearer_or_has_another_goal():
    for after, stuck in ((wall(5.0), True), (wall(5.0 - OUT - 0.1, OUT + 0.1), False), (wall(8.0), False)):
        driver, alone = PlanWhenStuck(), Navigator.load(slows_within=1.0)
        for _ in range(PERIODS):
            assert np.array_equal(driver.commands(wall(5.0)), alone.commands(wall(5.0)))
        assert driver.rescues[0] == 0
        driver.commands(wall(5.0))
        assert driver.rescues[0] == 1
        driver.commands(after)
        assert (driver._stuck[0] >= 0) == stuck


def test_a_reset_forgets_map_and_trap():
    driver, alone = PlanWhenStuck(), Navigator.load(slows_within=1.0)
    for _ in range(PERIODS + 5):
        driver.commands(wall(5.0))
    driver.reset()
    assert driver.rescues[0] == 0
    assert not driver._maps[0].evidence.any()
    for _ in range(PERIODS):
        assert np.array_equal(driver.commands(wall(5.0)), alone.commands(wall(5.0)))


def test_its_map_has_only_what_is_near():
    driver = PlanWhenStuck()
    for ranges, drawn in ((REACH + 0.5, False), (REACH - 0.5, True)):
        driver.reset()
        driver.commands(wall(8.0)._replace(ranges=np.full((1, ROBOT.columns), ranges)))
        assert (driver._maps[0].evidence > 0).any() == drawn
        assert (driver._maps[0].evidence < 0).any()


def test_on_a_robot_it_drives_as_the_driver_alone_while_it_gets_somewhere():
    driver, alone = PlanWhenStuck(), Navigator.load(slows_within=1.0)
    rng = np.random.default_rng(0)
    for number in range(20):
        given = (rng.uniform(1, 9, ROBOT.columns), (8.0 - 0.1 * number, 0.1), (0.1 * number, 0.0, 0.0))
        assert driver.step(*given) == alone.step(*given)
    assert not driver.no_way

"""experiments/table5_success/failures.py: arenas with a known cause."""

import csv

import numpy as np
import pytest
from support.scripts import load_scripts

from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import run_episodes
from eldenet.navigation.planners.straight import Straight
from eldenet.navigation.sensors import Ranges
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT

(failures,) = load_scripts("table5_success", "failures")
trace, draw_worst, touched_spot = failures.trace, failures.draw_worst, failures.touched_spot


def straight(robots: int) -> Straight:
    return Straight(robots=robots)


def blind(speed: float):
    """Return a maker of drivers that keep a speed [m/s], ahead or back."""

    class Blind(Straight):
        def commands(self, senses, robots=None):
            return np.tile([speed, 0.0], (len(senses.goal), 1))

    return lambda robots: Blind(robots=robots)


def arena(*obstacles: Obstacle, start=(0.0, 0.0, 0.0), goal=(6.0, 0.0)) -> Arena:
    return Arena("", len(obstacles), 0, obstacles, start, (goal,))


AHEAD = Obstacle("box", 3.0, 0.0, 0.0, (0.3, 0.3), 1.0)
BEHIND = Obstacle("cylinder", -2.0, 0.0, 0.0, (0.3, 0.3), 1.0)
WALKER = Obstacle("person", 3.0, 3.0, 0.0, (0.25, 0.25), 1.7, ((3.0, 3.0), (3.0, -3.0)), 0.9)
TUNNEL = (
    Obstacle("box", 2.2, 0.0, 0.0, (0.2, 0.9), 1.0),
    Obstacle("box", 1.2, 0.63, 0.0, (0.7, 0.3), 1.0),
    Obstacle("box", 1.2, -0.63, 0.0, (0.7, 0.3), 1.0),
)


@pytest.mark.parametrize(
    ("world", "make", "kind", "touched", "bearing"),
    [
        (arena(AHEAD), straight, "in view", "box", 0),
        (arena(BEHIND), blind(-0.5), "unseen", "cylinder", 180),
        (arena(WALKER), straight, "walker", "person", None),
        (arena(*TUNNEL), blind(0.15), "boxed in", "box", None),
        (arena(start=(8.0, 0.0, 3.1415927), goal=(-11.0, 0.0)), straight, "in view", "wall", 0),
    ],
)
def test_the_cause_of_a_collision_is_found(world, make, kind, touched, bearing):
    rows = run_episodes([world], make, Ranges(), EpisodeSettings(time_limit=20.0))
    assert rows[0].outcome == "collision"
    (failure,) = trace([world], rows, make, Ranges(), EpisodeSettings(time_limit=20.0))
    assert (failure.kind, failure.touched) == (kind, touched)
    if bearing is not None:
        assert abs(abs(failure.bearing) - bearing) <= 20
    assert failure.seconds == pytest.approx(rows[0].seconds)
    assert failure.picture.shape == (480 + 28, 480, 3)  # a title above


def test_time_outs_are_failures_and_successes_are_not():
    worlds = [arena(goal=(3.0, 0.0)), arena(goal=(9.0, 0.0))]
    rows = run_episodes(worlds, straight, Ranges(), EpisodeSettings(time_limit=8.0))
    assert [row.outcome for row in rows] == ["success", "timeout"]
    (failure,) = trace(worlds, rows, straight, Ranges(), EpisodeSettings(time_limit=8.0))
    assert (failure.kind, failure.touched) == ("timeout", "")
    assert failure.remaining == pytest.approx(9.0 - 7.3, abs=0.8)
    with pytest.raises(ValueError, match="of the first run"):
        trace(worlds, rows, straight, Ranges(), EpisodeSettings(time_limit=60.0))


def test_a_large_robot_touches_with_its_own_edge():
    arena = Arena("train", 0, 0, (), (0.0, 0.0, 0.0), ((8.0, 0.0),))
    for size in (1.0, 1.3):
        touched, spot = touched_spot(arena, np.array([9.6, 0.0, 0.0]), 0.0, size)
        assert touched == "wall"
        assert spot[0] == pytest.approx(9.6 + size * ROBOT.length / 2, abs=0.02)


def test_the_script_writes_a_table_and_a_picture(tmp_path):
    import cv2

    failures.main(["policy=straight", "density=60", "episodes=4", "split=val", "physics=kinematic",
                   f"output={tmp_path}"])  # fmt: skip
    with (tmp_path / "failures_60.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows
    assert {row["kind"] for row in rows} <= {"in view", "unseen", "left the view", "boxed in"}
    rows, rest = divmod(cv2.imread(str(tmp_path / "failures_60.png")).shape[0], 28 + 480 + 10)
    assert (rows, rest) == (1, 28)  # the legend below

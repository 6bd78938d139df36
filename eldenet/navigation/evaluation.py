"""Cross frozen arenas with a policy and count: success, collision, time-out, time, path."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np

from eldenet.navigation.episodes import GOAL_RADIUS, Crossings, Event
from eldenet.navigation.observer import Senses
from eldenet.navigation.planners.astar import optimal_length
from eldenet.navigation.sensors import Sensor
from eldenet.navigation.statistics import spl, wilson_interval
from eldenet.simulation.arenas import Arena


class Policy(Protocol):
    """Whatever drives: learnt or planned, one robot or many."""

    name: str

    def reset(self, robot: int, world: Any = None) -> None:
        """Start a crossing; ``world`` is the simulator's, for planners that are given the map."""

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``; only the rows of ``robots`` count."""


@dataclass(frozen=True)
class Crossing:
    """One row of the per-world table.

    Attributes:
        world: the arena's name.
        density: its number of standing obstacles.
        outcome: "success", "collision" or "timeout".
        seconds: until then [s].
        travelled: way driven [m].
        shortest: shortest way on the inflated grid, up to the goal's radius [m].
    """

    world: str
    density: int
    outcome: str
    seconds: float
    travelled: float
    shortest: float


OUTCOMES = {Event.GOAL: "success", Event.COLLISION: "collision", Event.TIMEOUT: "timeout"}


def cross(
    arenas: Sequence[Arena],
    make_policy: Callable[[int], Policy],
    sensor: Sensor,
    *,
    physics: str = "kinematic",
    robots: int = 32,
    seed: int = 0,
    time_limit: float = 60.0,
    goal: str = "known",
    advance: Callable[[int], None] = lambda count: None,
) -> list[Crossing]:
    """Cross every arena once; rows come in the order of the arenas.

    The sensor's errors in arena ``k`` come from ``(seed, k)``, so an outcome does not depend on the others.

    Args:
        arenas: worlds with start and goal.
        make_policy: number of robots -> policy.
        sensor: what the robots see with.
        physics: "kinematic" or "wheels".
        robots: under way at once.
        seed: of the sensor's errors.
        time_limit: of a crossing [s].
        goal: "known" or "odometry"; see :class:`~eldenet.navigation.episodes.Crossings`.
        advance: told how many crossings have ended, for a progress bar.
    """
    robots = min(robots, len(arenas))
    crossings = Crossings(robots, sensor, physics=physics, time_limit=time_limit, goal=goal)
    policy = make_policy(robots)
    rows: dict[int, Crossing] = {}
    at = np.arange(robots)  # the arena of every slot
    waiting = iter(range(robots, len(arenas)))
    for slot in range(robots):
        crossings.start(slot, arenas[slot], (seed, slot))
        policy.reset(slot, crossings.worlds[slot])
    active = np.arange(robots)
    crossings.sense()
    while len(active):
        commands = policy.commands(crossings.senses(), active)
        _, events = crossings.step(commands, active.tolist())
        still = []
        for slot in active.tolist():
            event = Event(int(events[slot]))
            if event is not Event.NONE:
                arena = arenas[at[slot]]
                rows[int(at[slot])] = Crossing(
                    arena.name,
                    arena.density,
                    OUTCOMES[event],
                    round(float(crossings.seconds[slot]), 3),
                    round(float(crossings.travelled[slot]), 3),
                    round(optimal_length(arena) - GOAL_RADIUS, 3),
                )
                advance(1)
                following = next(waiting, None)
                if following is None:
                    continue
                at[slot] = following
                crossings.start(slot, arenas[following], (seed, following))
                policy.reset(slot, crossings.worlds[slot])
            still.append(slot)
        active = np.array(still, dtype=np.intp)
        crossings.look(still)
    return [rows[number] for number in range(len(arenas))]


def summarize(rows: Sequence[Crossing]) -> dict[str, Any]:
    """Shares [%] with their Wilson intervals, time over successes [s], SPL."""
    outcomes = np.array([row.outcome for row in rows])
    success = outcomes == "success"
    low, high = wilson_interval(int(success.sum()), len(rows))
    seconds = np.array([row.seconds for row in rows])
    travelled, shortest = (
        np.array([getattr(row, name) for row in rows]) for name in ("travelled", "shortest")
    )
    return {
        "worlds": len(rows),
        "success": 100 * float(success.mean()),
        "success_low": 100 * low,
        "success_high": 100 * high,
        "collision": 100 * float((outcomes == "collision").mean()),
        "timeout": 100 * float((outcomes == "timeout").mean()),
        "seconds": float(seconds[success].mean()) if success.any() else float("nan"),
        "spl": spl(success, travelled, shortest),
    }


def solved_by_all(tables: Sequence[Sequence[Crossing]]) -> np.ndarray:
    """Which worlds every method solved ``(worlds,)`` bool.

    Raises:
        ValueError: the tables are not of the same worlds.
    """
    names = [[row.world for row in table] for table in tables]
    if any(other != names[0] for other in names[1:]):
        raise ValueError("the tables are of different worlds: times can be compared on the same worlds only")
    return np.all([[row.outcome == "success" for row in table] for table in tables], axis=0)


def as_rows(rows: Sequence[Crossing]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows for :func:`eldenet.results.run_record.write_rows`."""
    content = [asdict(row) for row in rows]
    return list(content[0]), [list(row.values()) for row in content]

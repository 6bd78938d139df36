"""Run a driver through a fixed set of arenas and summarize: success, collision, time-out, time, path."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from eldenet.navigation.episodes import GOAL_RADIUS, Episodes, EpisodeSettings, Event
from eldenet.navigation.observer import Senses
from eldenet.navigation.planners.paths import optimal_length
from eldenet.navigation.sensors import Sensor
from eldenet.simulation.arenas import Arena


class Policy(Protocol):
    """A driver, learned or planned, for one robot or many."""

    name: str

    def reset(self, robot: int, world: Any = None) -> None:
        """Start an episode; ``world`` is the simulator's, for planners that know the map."""

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``; only the rows of ``robots`` count."""


@dataclass(frozen=True)
class Episode:
    """Result of one episode: a row of the table of an evaluation.

    Attributes:
        world: name of the arena.
        density: its number of standing obstacles, without walls.
        outcome: "success", "collision" or "timeout".
        seconds: duration [s].
        travelled: length of the driven path [m].
        shortest: length of the shortest any-angle path of a disc as wide as the robot, up to the goal's
            radius [m].
    """

    world: str
    density: int
    outcome: str
    seconds: float
    travelled: float
    shortest: float


OUTCOMES = {Event.GOAL: "success", Event.COLLISION: "collision", Event.TIMEOUT: "timeout"}


def run_episodes(
    arenas: Sequence[Arena],
    make_policy: Callable[[int], Policy],
    sensor: Sensor,
    settings: EpisodeSettings = EpisodeSettings(),  # noqa: B008 - immutable
    *,
    robots: int = 32,
    advance: Callable[[int], None] = lambda count: None,
) -> list[Episode]:
    """Run one episode in every arena; the results are in the order of the arenas.

    Args:
        arenas: their places in this order are part of the seeds.
        make_policy: number of robots -> policy.
        sensor: of every robot.
        settings: of the episodes. No outcome depends on the other arenas.
        robots: episodes that run at once.
        advance: called with the number of episodes that have ended, for a progress bar.
    """
    robots = min(robots, len(arenas))
    episodes = Episodes(robots, sensor, settings)
    policy = make_policy(robots)
    rows: dict[int, Episode] = {}
    arena_of = np.arange(robots)  # each slot
    waiting = iter(range(robots, len(arenas)))

    def start(slot: int, number: int) -> None:
        arena_of[slot] = number
        episodes.start(slot, arenas[number], (settings.seed, number))
        policy.reset(slot, episodes.worlds[slot])

    for slot in range(robots):
        start(slot, slot)
    active = np.arange(robots)
    episodes.scan(range(robots))
    while len(active):
        commands = policy.commands(episodes.senses(), active)
        _, events = episodes.step(commands, active.tolist())
        still = []
        for slot in active.tolist():
            event = Event(int(events[slot]))
            if event is not Event.NONE:
                arena = arenas[arena_of[slot]]
                rows[int(arena_of[slot])] = Episode(
                    arena.name,
                    arena.density,
                    OUTCOMES[event],
                    round(float(episodes.seconds[slot]), 3),
                    round(float(episodes.travelled[slot]), 3),
                    to_goal(arena),
                )
                advance(1)
                following = next(waiting, None)
                if following is None:
                    continue
                start(slot, following)
            still.append(slot)
        active = np.array(still, dtype=np.intp)
        episodes.scan(still)
    return [rows[number] for number in range(len(arenas))]


def to_goal(arena: Arena) -> float:
    """Return the length of the shortest path that reaches the goal's radius [m]."""
    return round(optimal_length(arena) - GOAL_RADIUS, 3)


def summarize(rows: Sequence[Episode]) -> dict[str, Any]:
    """Rates [%], that of success with Wilson's 95 % interval, mean time of the successes [s], SPL."""
    from scipy.stats import binomtest

    outcomes = np.array([row.outcome for row in rows])
    success = outcomes == "success"
    low, high = binomtest(int(success.sum()), len(rows)).proportion_ci(method="wilson")
    seconds, travelled, shortest = (
        np.array([getattr(row, name) for row in rows]) for name in ("seconds", "travelled", "shortest")
    )
    return {
        "worlds": len(rows),
        "success": 100 * float(success.mean()),
        "success_low": 100 * float(low),
        "success_high": 100 * float(high),
        "collision": 100 * float((outcomes == "collision").mean()),
        "timeout": 100 * float((outcomes == "timeout").mean()),
        "seconds": float(seconds[success].mean()) if success.any() else float("nan"),
        "spl": spl(success, travelled, shortest),
    }


def as_rows(rows: Sequence[Any], without: Sequence[str] = ()) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of a list of dataclasses, for :func:`eldenet.system.files.write_rows`."""
    names = [name for name in vars(rows[0]) if name not in without]
    return names, [[getattr(row, name) for name in names] for row in rows]


def spl(success: np.ndarray, length: np.ndarray, shortest: np.ndarray) -> float:
    """Success weighted by path length: Anderson et al., "On evaluation of embodied navigation agents", 2018.

    Args:
        success: ``(N,)`` bool.
        length: ``(N,)`` of the driven path [m].
        shortest: ``(N,)`` length of the shortest path [m].
    """
    return float(np.mean(np.asarray(success) * shortest / np.maximum(length, shortest)))

"""Compare methods, and sensors, on the same worlds."""

import numpy as np
from episodes import mcnemar

from eldenet.evaluation.bootstrap import mean_interval
from eldenet.navigation.evaluation import Episode

# (physics, sensor, method, course) -> episodes of every training
Tables = dict[tuple[str, str, str, str], list[list[Episode]]]
#: What a sensor costs is counted against the same method with true ranges, and against these methods too.
ALSO_AGAINST = {"dqn_mixed": ("dqn",)}
OURS = ("dqn_ensemble", "dqn")  # the first one in a table is compared with all other methods


def courses_of(tables: Tables) -> list[str]:
    """Return the courses of all tables, in order of appearance."""
    return list(dict.fromkeys(key[3] for key in tables))


def solved(trainings: list[list[Episode]]) -> np.ndarray:
    """Return whether each episode succeeded ``(trainings, worlds)`` bool."""
    return np.array([[episode.outcome == "success" for episode in rows] for rows in trainings])


def paired(tables: Tables, physics: str, sensor: str) -> list[str]:
    """Return table lines: our method's first training against every other method's on the same worlds."""
    methods = dict.fromkeys(key[2] for key in tables if key[:2] == (physics, sensor))
    default = next((name for name in OURS if name in methods), None)
    lines = []
    for method in methods:
        for course in courses_of(tables):
            ours, theirs = (tables.get((physics, sensor, str(name), course)) for name in (default, method))
            if method == default or not ours or not theirs:
                continue
            only_ours, only_theirs, p = mcnemar(solved(ours)[0], solved(theirs)[0])
            lines.append(f"| {method} | {course} | {only_ours} | {only_theirs} | {p:.2g} |")
    head = [
        f"| {default} against | arenas | only {default} | only the other | McNemar p |",
        "|---|---:|---:|---:|---:|",
    ]
    return [*head, *lines] if lines else []


def loss(tables: Tables, physics: str, sensor: str) -> list[str]:
    """Return table lines: success lost with this sensor, compared with true ranges on the same worlds.

    In percentage points, as mean over trainings, with the paired 95 % bootstrap interval over worlds and the
    exact McNemar test of the first trainings.
    """
    lines = []
    for method in dict.fromkeys(key[2] for key in tables if key[:2] == (physics, sensor)):
        for reference in (method, *ALSO_AGAINST.get(method, ())):
            for course in courses_of(tables):
                seen = tables.get((physics, sensor, method, course))
                true = tables.get((physics, "ranges", reference, course))
                if sensor != "ranges" and seen and true:
                    lines.append(
                        f"| {method} | {reference} | {course} | {_lost(solved(true), solved(seen))} |"
                    )
    head = [
        "| method | against `ranges` of | arenas | success lost [points] | only `ranges` | only this "
        "| McNemar p |",
        "|---|---|---:|---:|---:|---:|---:|",
    ]
    return [*head, *lines] if lines else []


def _lost(true: np.ndarray, seen: np.ndarray) -> str:
    """Return the last cells of a line of :func:`loss`."""
    lost = 100.0 * (true.mean(axis=0) - seen.mean(axis=0))  # of every world
    low, high = mean_interval(lost)
    only_true, only_seen, p = mcnemar(true[0], seen[0])
    return f"{lost.mean():.1f} [{low:.1f}, {high:.1f}] | {only_true} | {only_seen} | {p:.2g}"

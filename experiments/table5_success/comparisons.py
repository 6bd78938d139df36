"""Methods and sensors against each other on the same worlds."""

import numpy as np

from eldenet.evaluation.bootstrap import bootstrap_interval
from eldenet.navigation.evaluation import Episode, mcnemar

# physics, sensor, method, course -> episodes of every training
Tables = dict[tuple[str, str, str, str], list[list[Episode]]]
#: A sensor's loss is against true ranges: of the method itself, and of the default for one trained for it.
ALSO_AGAINST = {"dqn_mixed": ("dqn",)}
OURS = ("dqn_ensemble", "dqn")  # the first of them that a table has is compared with all others


def courses_of(tables: Tables) -> list[str]:
    """In the order in which they came."""
    return list(dict.fromkeys(key[3] for key in tables))


def solved(trainings: list[list[Episode]]) -> np.ndarray:
    """``(trainings, worlds)`` bool."""
    return np.array([[episode.outcome == "success" for episode in rows] for rows in trainings])


def paired(tables: Tables, physics: str, sensor: str) -> list[str]:
    """The default's first training against every other method on the same worlds."""
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
    """Success that this sensor costs against true ranges on the same worlds.

    Points, mean over trainings, with their paired 95 % bootstrap interval over worlds; and the first
    trainings' exact McNemar test.
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
    """Cells of a row of :func:`loss`."""
    lost = 100.0 * (true.mean(axis=0) - seen.mean(axis=0))  # of every world
    low, high = bootstrap_interval(lambda drawn: float(lost[drawn].mean()), len(lost))
    only_true, only_seen, p = mcnemar(true[0], seen[0])
    return f"{lost.mean():.1f} [{low:.1f}, {high:.1f}] | {only_true} | {only_seen} | {p:.2g}"

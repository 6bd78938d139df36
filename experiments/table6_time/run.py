"""Table 6: how long an episode takes, on the worlds that every method solved.

python experiments/table6_time/run.py            has the options of table5_success/run.py, and reads its rows

A method that often fails does so on long paths, so the mean time over its own successes flatters it. The
first figure therefore counts only the worlds that all methods of the table solved; the ratio counts those
that both the method and A* with the full map solved.
"""

import math
import sys
from argparse import Namespace
from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "table5_success"))

import numpy as np  # noqa: E402
from command import (  # noqa: E402
    COURSES,
    all_rows,
    arguments,
    refuse_to_drop,
    results_name,
    without_nan,
    write_table,
)
from episodes import solved_by_all  # noqa: E402
from inputs import fed_by  # noqa: E402
from rows import measure  # noqa: E402

from eldenet.evaluation.bootstrap import bootstrap_interval  # noqa: E402
from eldenet.navigation.evaluation import Episode  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402

# (physics, sensor, course) -> method -> episodes of every training
Tables = Mapping[tuple[str, str, str], Mapping[str, list[list[Episode]]]]

REFERENCE = "astar_dwa"
# straight and weak learned methods solve so few worlds at 80 that nothing would be left to compare
METHODS = (
    *("dqn_ensemble", "dqn", "dqn_as_trained"),
    *("astar_online_dqn", "astar_dwa", "astar_online_dwa", "dwa"),
)


def main() -> None:
    args = arguments(METHODS, [course for course in COURSES if not course[1]])
    rows = list(all_rows(args))
    asked = [(r.physics, r.sensor, r.method, r.course) for r in rows]
    refuse_to_drop(HERE / "tables.csv", results_name(args), asked)
    tables: dict = defaultdict(lambda: defaultdict(list))
    for row in rows:
        tables[row.physics, row.sensor, row.course][row.method].append(measure(row, args))
    write_results(tables, args)


def write_results(tables: Tables, args: Namespace) -> None:
    name = results_name(args)
    where, courses = environment(), list(dict.fromkeys(key[2] for key in tables))
    lines = [
        "# Time of crossing an arena (Table 6)",
        "",
        f"The worlds and rows of table5_success, {args.worlds} test arenas per column. Mean time [s] on "
        "the worlds that all methods of the table, and all their trainings, solved (how many: last row); "
        f"after it the ratio to {REFERENCE} over the worlds that both solved, mean over trainings, with its "
        "paired 95 % bootstrap interval over worlds.",
        "",
    ]
    cells = []
    for physics, sensor in dict.fromkeys(key[:2] for key in tables):
        methods = list(tables[physics, sensor, courses[0]])
        lines += [f"## {sensor}, {physics}, goal {args.goal}", "", fed_by(sensor, args), ""]
        lines += ["| method | " + " | ".join(courses) + " |", "|---|" + "---:|" * len(courses)]
        common = {
            d: solved_by_all([seed for seeds in tables[physics, sensor, d].values() for seed in seeds])
            for d in courses
        }
        for method in methods:
            shown = []
            for course in courses:
                rows = tables[physics, sensor, course]
                seconds, mask = times(rows[method]).mean(axis=0), common[course]
                mean = float(seconds[mask].mean()) if mask.any() else math.nan
                ratio, low, high, both = ratio_to_reference(rows, method)
                shown.append(cell(mean, ratio, low, high))
                values = [mean, int(mask.sum()), ratio, low, high, both]
                cells.append(without_nan([physics, sensor, method, course, *values]))
            lines.append(f"| {method} | " + " | ".join(shown) + " |")
        counts = " | ".join(str(int(common[course].sum())) for course in courses)
        lines += [f"| worlds that all solved | {counts} |", ""]
    lines += [
        f"mujoco {where['versions']['mujoco']}, {where['date']}, "
        f"commit {(where['git'] or {}).get('commit')}.",
        f"Made by `python experiments/table6_time/{where['command']}`.",
    ]
    (HERE / f"{name}.md").write_text("\n".join(lines) + "\n")
    names = ["physics", "sensor", "method", "course", "seconds", "worlds"]
    names += ["ratio", "ratio_low", "ratio_high", "worlds_both"]
    write_table(HERE / "tables.csv", name, names, cells)
    print("\n".join(lines))


def times(trainings: list[list[Episode]]) -> np.ndarray:
    """Return the time of each episode ``(trainings, worlds)`` [s]."""
    return np.array([[crossing.seconds for crossing in rows] for rows in trainings])


def cell(mean: float, ratio: float, low: float, high: float) -> str:
    """Return a cell of the table; "-" for a missing time."""
    shown = "-" if math.isnan(mean) else f"{mean:.1f}"
    return shown if math.isnan(ratio) else f"{shown}, {ratio:.2f} [{low:.2f}, {high:.2f}]"


def ratio_to_reference(
    rows: Mapping[str, list[list[Episode]]], method: str
) -> tuple[float, float, float, int]:
    """Return the mean time over the reference's on the worlds that both solved, as mean over trainings.

    Returns:
        The ratio, its paired 95 % bootstrap interval over worlds, and the least number of worlds that a
        training and the reference both solved. NaN if a training shares none.
    """
    if REFERENCE not in rows:
        return math.nan, math.nan, math.nan, 0
    reference = times(rows[REFERENCE])[0]
    both = np.array([solved_by_all([training, rows[REFERENCE][0]]) for training in rows[method]])
    ours = times(rows[method])

    def ratio(worlds: np.ndarray) -> float:
        mask = both[:, worlds]
        if not mask.any(axis=1).all():
            return math.nan
        return float(np.mean((ours[:, worlds] * mask).sum(axis=1) / (reference[worlds] * mask).sum(axis=1)))

    low, high = bootstrap_interval(ratio, len(reference))
    return ratio(np.arange(len(reference))), low, high, int(both.sum(axis=1).min())


if __name__ == "__main__":
    main()

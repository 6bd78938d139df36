"""Table 6: how long a crossing takes, on the worlds that every method solved.

python experiments/table6_time/run.py            takes the same options as table5_success/run.py, and its rows

A method that fails often fails on the long ways; its mean time over its own successes flatters it. So the
first figure counts the worlds alone that all methods of the table solved, and the ratio those that A* with
the full map and the method both solved.
"""

import sys
from collections import defaultdict
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "table5_success"))

import numpy as np  # noqa: E402
from panels import draw_panels  # noqa: E402
from rows import all_rows, arguments, measure  # noqa: E402

from eldenet.navigation.evaluation import Crossing, solved_by_all  # noqa: E402
from eldenet.record import environment, write_rows  # noqa: E402

REFERENCE = "astar_dwa"
BLIND = ("straight",)  # solves so few that it would leave nothing to compare


def main() -> None:
    given = arguments()
    tables: dict[tuple[str, str, str], dict[str, list[Crossing]]] = defaultdict(dict)
    for row in all_rows(given):
        if row.method not in BLIND and row.seed in (None, 0):
            tables[row.physics, row.sensor, row.course][row.method] = measure(row, given)
    where, courses = environment(), list(dict.fromkeys(key[2] for key in tables))
    lines = [
        "# Time of crossing an arena (Table 6)",
        "",
        f"The worlds and rows of table5_success, {given.worlds} test arenas per column, first training of "
        "learnt methods. Mean time [s] on the worlds that all methods of the table solved (how many: last "
        "row); "
        f"in brackets the ratio to {REFERENCE} over the worlds that both solved.",
        "",
    ]
    cells = []
    for physics, sensor in dict.fromkeys(key[:2] for key in tables):
        methods = list(tables[physics, sensor, courses[0]])
        lines += [f"## {sensor}, {physics}", "", "| method | " + " | ".join(courses) + " |"]
        lines.append("|---|" + "---:|" * len(courses))
        common = {d: solved_by_all(list(tables[physics, sensor, d].values())) for d in courses}
        for method in methods:
            shown = []
            for course in courses:
                rows = tables[physics, sensor, course]
                seconds = np.array([crossing.seconds for crossing in rows[method]])
                mean = float(seconds[common[course]].mean()) if common[course].any() else float("nan")
                ratio, both = ratio_to_reference(rows, method)
                shown.append(f"{mean:.1f} ({ratio:.2f})")
                cells.append([physics, sensor, method, course, mean, int(common[course].sum()), ratio, both])
            lines.append(f"| {method} | " + " | ".join(shown) + " |")
        counts = " | ".join(str(int(common[course].sum())) for course in courses)
        lines += [f"| worlds that all solved | {counts} |", ""]
    lines += [
        f"mujoco {where['versions']['mujoco']}, {where['date']}, "
        f"commit {(where['git'] or {}).get('commit')}.",
        f"Made by `python experiments/table6_time/{where['command']}`.",
    ]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    names = ["physics", "sensor", "method", "course", "seconds", "worlds", "ratio", "worlds_both"]
    write_rows(HERE / "results.csv", names, cells)
    plot(cells)
    print("\n".join(lines))


def ratio_to_reference(rows: dict[str, list[Crossing]], method: str) -> tuple[float, int]:
    """Mean time over the reference's, on the worlds that both solved, and how many those are."""
    if REFERENCE not in rows:
        return float("nan"), 0
    both = solved_by_all([rows[method], rows[REFERENCE]])
    if not both.any():
        return float("nan"), 0
    ours, theirs = (np.array([c.seconds for c in rows[name]])[both].mean() for name in (method, REFERENCE))
    return float(ours / theirs), int(both.sum())


def plot(cells: list[list]) -> None:
    """Time against density, one panel per physics and sensor."""

    def draw(axis, panel) -> None:
        mine = [row for row in cells if (row[0], row[1]) == panel and row[3].isdigit()]
        for method in dict.fromkeys(row[2] for row in mine):
            points = [(int(row[3]), row[4]) for row in mine if row[2] == method]
            axis.plot(*zip(*points, strict=True), marker="o", label=method)

    panels = list(dict.fromkeys((row[0], row[1]) for row in cells))
    draw_panels(panels, draw, "time on worlds all solved [s]", HERE / "results.png")


if __name__ == "__main__":
    main()

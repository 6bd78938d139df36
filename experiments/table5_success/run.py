"""Table 5: how often a robot crosses arenas of 5, 20, 40 and 80 obstacles, and 20 with 10 walkers.

python experiments/table5_success/run.py                                      500 worlds, 3 trainings
python experiments/table5_success/run.py --worlds 100 --packaged --methods dqn,,astar_dwa,,dwa

Trains what is not trained yet, crosses the frozen test arenas, keeps every row, writes results.md,
results.csv and results.png. A killed command goes on where it stopped.
"""

from collections import defaultdict
from pathlib import Path

import numpy as np
from panels import draw_panels
from rows import LEARNT, all_rows, arguments, measure

from eldenet.navigation.evaluation import Crossing, summarise
from eldenet.navigation.statistics import mcnemar
from eldenet.record import environment, write_rows
from eldenet.robot import ROBOT

HERE = Path(__file__).parent
Tables = dict[tuple[str, str, str, str], list[list[Crossing]]]  # physics, sensor, method, course -> per seed


def main() -> None:
    given = arguments()
    tables: Tables = defaultdict(list)
    for row in all_rows(given):
        tables[row.physics, row.sensor, row.method, row.course].append(measure(row, given))
        write_results(tables, given.worlds)


def courses_of(tables: Tables) -> list[str]:
    """In the order in which they came."""
    return list(dict.fromkeys(key[3] for key in tables))


def write_results(tables: Tables, worlds: int) -> None:
    where = environment()
    lines = [
        "# Success of crossing an arena (Table 5)",
        "",
        f"{worlds} frozen test arenas per column (20 x 20 m, start to goal 10 m or more, any heading; "
        "20+10 are 20 obstacles and 10 people who walk), "
        f"time limit 60 s, goal within 0.5 m, robot {ROBOT.length} x {ROBOT.width} m, camera 69.4 degrees. "
        "Success [%] with its 95 % Wilson interval over worlds (mean over trainings), "
        "then collision / time-out [%], SPL.",
        "",
    ]
    cells, courses = [], courses_of(tables)
    for physics, sensor in dict.fromkeys((key[0], key[1]) for key in tables):
        lines += [
            f"## {sensor}, {physics}",
            "",
            "| method | trainings | " + " | ".join(courses) + " |",
        ]
        lines.append("|---|---:|" + "---:|" * len(courses))
        for method in dict.fromkeys(key[2] for key in tables if key[:2] == (physics, sensor)):
            shown = []
            for course in courses:
                seeds = tables.get((physics, sensor, method, course), [])
                shown.append(cell(seeds))
                for number, crossings in enumerate(seeds):
                    cells.append([physics, sensor, method, number, course, *summarise(crossings).values()])
            trainings = len(tables[physics, sensor, method, courses[0]]) if method in LEARNT else "-"
            lines.append(f"| {method} | {trainings} | " + " | ".join(shown) + " |")
        lines += ["", *paired(tables, physics, sensor), "", *loss(tables, physics, sensor), ""]
    lines += [
        f"{where['hardware']['processor']}, torch {where['versions']['torch']}, "
        f"mujoco {where['versions']['mujoco']}, "
        f"{where['date']}, commit {(where['git'] or {}).get('commit')}.",
        f"Made by `python experiments/table5_success/{where['command']}`.",
    ]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    names = ["physics", "sensor", "method", "training", "course", *summarise(next(iter(tables.values()))[0])]
    write_rows(HERE / "results.csv", names, cells)
    plot(tables)


def cell(seeds: list[list[Crossing]]) -> str:
    if not seeds:
        return "-"
    parts = [summarise(crossings) for crossings in seeds]
    mean = {name: float(np.mean([part[name] for part in parts])) for name in parts[0]}
    spread = f" +- {np.std([part['success'] for part in parts], ddof=1):.1f}" if len(parts) > 1 else ""
    return (
        f"{mean['success']:.1f}{spread} [{mean['success_low']:.1f}, {mean['success_high']:.1f}], "
        f"{mean['collision']:.1f} / {mean['timeout']:.1f}, {mean['spl']:.3f}"
    )


def paired(tables: Tables, physics: str, sensor: str) -> list[str]:
    """dqn's first training against every other method on the same worlds."""
    lines = []
    for method in dict.fromkeys(key[2] for key in tables if key[:2] == (physics, sensor)):
        for course in courses_of(tables):
            ours, theirs = (tables.get((physics, sensor, name, course)) for name in ("dqn", method))
            if method == "dqn" or not ours or not theirs:
                continue
            solved = [[crossing.outcome == "success" for crossing in rows[0]] for rows in (ours, theirs)]
            only_ours, only_theirs, p = mcnemar(*solved)
            lines.append(f"| {method} | {course} | {only_ours} | {only_theirs} | {p:.2g} |")
    head = [
        "| dqn against | arenas | only dqn | only the other | McNemar p |",
        "|---|---:|---:|---:|---:|",
    ]
    return [*head, *lines] if lines else []


def loss(tables: Tables, physics: str, sensor: str) -> list[str]:
    """Success that this sensor costs against true ranges, in points, mean over trainings."""
    lines = []
    for method in dict.fromkeys(key[2] for key in tables if key[:2] == (physics, sensor)):
        for course in courses_of(tables):
            ours, theirs = (tables.get((physics, name, method, course)) for name in (sensor, "ranges"))
            if sensor == "ranges" or not ours or not theirs or len(ours) != len(theirs):
                continue
            points = [
                summarise(true)["success"] - summarise(seen)["success"]
                for seen, true in zip(ours, theirs, strict=True)
            ]
            lines.append(f"| {method} | {course} | {np.mean(points):.1f} |")
    return ["| method | arenas | success lost against `ranges` |", "|---|---:|---:|", *lines] if lines else []


def plot(tables: Tables) -> None:
    """Success against density, one panel per physics and sensor."""
    shares = ("success", "success_low", "success_high")

    def draw(axis, panel) -> None:
        for method in dict.fromkeys(key[2] for key in tables if key[:2] == panel):
            points = [
                course
                for course in courses_of(tables)
                if course.isdigit() and tables.get((*panel, method, course))
            ]
            parts = [
                [summarise(crossings) for crossings in tables[(*panel, method, course)]] for course in points
            ]
            mean = np.array([[np.mean([p[name] for p in part]) for part in parts] for name in shares])
            at, reach = [int(course) for course in points], np.abs(mean[1:] - mean[0])
            axis.errorbar(at, mean[0], yerr=reach, marker="o", capsize=3, label=method)
        axis.set_ylim(0, 102)

    panels = list(dict.fromkeys((key[0], key[1]) for key in tables))
    draw_panels(panels, draw, "success [%]", HERE / "results.png")


if __name__ == "__main__":
    main()

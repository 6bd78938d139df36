"""Table 5: how often a robot crosses arenas of 5, 20, 40 and 80 obstacles, and of 20 with 10 walkers.

python experiments/table5_success/run.py                                      500 worlds, 3 trainings
python experiments/table5_success/run.py --worlds 100 --methods dqn_ensemble,,astar_dwa,,dwa

Trains missing methods, crosses the frozen test arenas, stores every row, and writes results-500.md and rows
of tables.csv at the end. A killed command resumes where it stopped.
"""

from argparse import Namespace
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from command import all_rows, arguments, refuse_to_drop, results_name, without_nan, write_table
from comparisons import Tables, courses_of, loss, paired
from inputs import fed_by
from methods import LEARNED
from rows import NOTES, Row, measure, read_notes

from eldenet.navigation.evaluation import Episode, summarize
from eldenet.results.run_record import environment
from eldenet.simulation.robot import ROBOT

HERE = Path(__file__).parent


def main() -> None:
    args = arguments()
    rows = list(all_rows(args))
    asked = [(r.physics, r.sensor, r.method, str(r.seed or 0), r.course) for r in rows]
    refuse_to_drop(HERE / "tables.csv", results_name(args), asked)
    tables: Tables = defaultdict(list)
    for row in rows:
        tables[row.physics, row.sensor, row.method, row.course].append(measure(row, args))
    write_results(tables, args, rows)


def write_results(tables: Tables, args: Namespace, rows: Sequence[Row]) -> None:
    name = results_name(args)
    lines = [
        "# Success of crossing an arena (Table 5)",
        "",
        f"{args.worlds} frozen test arenas per column (20 x 20 m, start to goal 10 m or more, any heading; "
        "20+10 are 20 obstacles and 10 people who walk), "
        f"time limit 60 s, goal within 0.5 m, robot {ROBOT.length} x {ROBOT.width} m, camera 69.4 degrees. "
        "Success [%] with its 95 % Wilson interval over worlds (mean over trainings), "
        "then collision / time-out [%], SPL.",
        "",
    ]
    cells, courses = [], courses_of(tables)
    for physics, sensor in dict.fromkeys((key[0], key[1]) for key in tables):
        lines += [
            f"## {sensor}, {physics}, goal {args.goal}",
            "",
            fed_by(sensor, args),
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
                    values = [physics, sensor, method, number, course, *summarize(crossings).values()]
                    cells.append(without_nan(values))
            trainings = len(tables[physics, sensor, method, courses[0]]) if method in LEARNED else "-"
            lines.append(f"| {method} | {trainings} | " + " | ".join(shown) + " |")
        lines += ["", *paired(tables, physics, sensor), "", *loss(tables, physics, sensor), ""]
    lines += made_with(args, rows)
    lines.append(f"Made by `python experiments/table5_success/{environment()['command']}`.")
    (HERE / f"{name}.md").write_text("\n".join(lines) + "\n")
    names = ["physics", "sensor", "method", "training", "course", *summarize(next(iter(tables.values()))[0])]
    write_table(HERE / "tables.csv", name, names, cells)


def made_with(args: Namespace, rows: Sequence[Row]) -> list[str]:
    """Return lines on what made the rows: this environment, or, of rows as they are stored, their notes."""
    if not args.stored:
        where = environment()
        return [f"{_place(where)}, {where['date']}."]
    notes, lines = read_notes(args.rows / NOTES), []
    for row in rows:
        note = notes[row.name]
        depth = note["key"].get("depth")
        by = f", depth SHA-256 {depth[:12]}" if depth else ""
        lines.append(f"- {row.sensor}, {row.course}: {_place(note['environment'])}, {note['date'][:10]}{by}")
    return ["Rows as they were stored, with SPL anew:", "", *lines, ""]


def _place(where: Mapping[str, Any]) -> str:
    commit = (where["git"] or {}).get("commit")
    return (
        f"{where['hardware']['processor']}, torch {where['versions']['torch']}, "
        f"mujoco {where['versions']['mujoco']}, commit {commit}"
    )


def cell(seeds: list[list[Episode]]) -> str:
    if not seeds:
        return "-"
    parts = [summarize(crossings) for crossings in seeds]
    mean = {name: float(np.mean([part[name] for part in parts])) for name in parts[0]}
    spread = f" +- {np.std([part['success'] for part in parts], ddof=1):.1f}" if len(parts) > 1 else ""
    return (
        f"{mean['success']:.1f}{spread} [{mean['success_low']:.1f}, {mean['success_high']:.1f}], "
        f"{mean['collision']:.1f} / {mean['timeout']:.1f}, {mean['spl']:.3f}"
    )


if __name__ == "__main__":
    main()

"""Table 5: how often a robot crosses arenas of 5, 20, 40 and 80 obstacles.

python experiments/table5_success/run.py                                      500 worlds, 3 trainings
python experiments/table5_success/run.py --worlds 100 --packaged --methods dqn,,astar_dwa,,dwa

Trains what is not trained yet, crosses the frozen test arenas, keeps every row, writes results.md,
results.csv and results.png. A killed command goes on where it stopped.
"""

from collections import defaultdict
from pathlib import Path

import numpy as np
from rows import DENSITIES, LEARNT, all_rows, arguments, measure

from eldenet.navigation.evaluation import Crossing, summarise
from eldenet.navigation.statistics import mcnemar
from eldenet.record import environment, write_rows
from eldenet.robot import ROBOT

HERE = Path(__file__).parent
Tables = dict[tuple[str, str, str, int], list[list[Crossing]]]  # physics, sensor, method, density -> per seed


def main() -> None:
    given = arguments()
    tables: Tables = defaultdict(list)
    for row in all_rows(given):
        tables[row.physics, row.sensor, row.method, row.density].append(measure(row, given))
        write_results(tables, given.worlds)


def write_results(tables: Tables, worlds: int) -> None:
    where = environment()
    lines = [
        "# Success of crossing an arena (Table 5)",
        "",
        f"{worlds} frozen test arenas per density (20 x 20 m, start to goal 10 m or more, any heading), "
        f"time limit 60 s, goal within 0.5 m, robot {ROBOT.length} x {ROBOT.width} m, camera 69.4 degrees. "
        "Success [%] with its 95 % Wilson interval over worlds (mean over trainings), "
        "then collision / time-out [%], SPL.",
        "",
    ]
    cells = []
    for physics, sensor in dict.fromkeys((key[0], key[1]) for key in tables):
        lines += [
            f"## {sensor}, {physics}",
            "",
            "| method | trainings | " + " | ".join(map(str, DENSITIES)) + " |",
        ]
        lines.append("|---|---:|" + "---:|" * len(DENSITIES))
        for method in dict.fromkeys(key[2] for key in tables if key[:2] == (physics, sensor)):
            shown = []
            for density in DENSITIES:
                seeds = tables.get((physics, sensor, method, density), [])
                shown.append(cell(seeds))
                for number, crossings in enumerate(seeds):
                    cells.append([physics, sensor, method, number, density, *summarise(crossings).values()])
            trainings = len(tables[physics, sensor, method, DENSITIES[0]]) if method in LEARNT else "-"
            lines.append(f"| {method} | {trainings} | " + " | ".join(shown) + " |")
        lines += ["", *paired(tables, physics, sensor), ""]
    lines += [
        f"{where['hardware']['processor']}, torch {where['versions']['torch']}, "
        f"mujoco {where['versions']['mujoco']}, "
        f"{where['date']}, commit {(where['git'] or {}).get('commit')}.",
        f"Made by `python experiments/table5_success/{where['command']}`.",
    ]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    names = ["physics", "sensor", "method", "training", "density", *summarise(next(iter(tables.values()))[0])]
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
        for density in DENSITIES:
            ours, theirs = (tables.get((physics, sensor, name, density)) for name in ("dqn", method))
            if method == "dqn" or not ours or not theirs:
                continue
            solved = [[crossing.outcome == "success" for crossing in rows[0]] for rows in (ours, theirs)]
            only_ours, only_theirs, p = mcnemar(*solved)
            lines.append(f"| {method} | {density} | {only_ours} | {only_theirs} | {p:.2g} |")
    head = [
        "| dqn against | obstacles | only dqn | only the other | McNemar p |",
        "|---|---:|---:|---:|---:|",
    ]
    return [*head, *lines] if lines else []


def plot(tables: Tables) -> None:
    """Success against density, one panel per physics and sensor."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels = list(dict.fromkeys((key[0], key[1]) for key in tables))
    figure, axes = plt.subplots(1, len(panels), figsize=(4.6 * len(panels), 3.6), sharey=True, squeeze=False)
    for axis, (physics, sensor) in zip(axes[0], panels, strict=True):
        for method in dict.fromkeys(key[2] for key in tables if key[:2] == (physics, sensor)):
            points = [d for d in DENSITIES if tables.get((physics, sensor, method, d))]
            parts = [[summarise(c) for c in tables[physics, sensor, method, d]] for d in points]
            mean = np.array(
                [
                    [np.mean([p[n] for p in part]) for part in parts]
                    for n in ("success", "success_low", "success_high")
                ]
            )
            axis.errorbar(
                points, mean[0], yerr=np.abs(mean[1:] - mean[0]), marker="o", capsize=3, label=method
            )
        axis.set(title=f"{sensor}, {physics}", xlabel="obstacles on 400 m2", ylim=(0, 102))
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("success [%]")
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(HERE / "results.png", dpi=130)
    plt.close(figure)


if __name__ == "__main__":
    main()

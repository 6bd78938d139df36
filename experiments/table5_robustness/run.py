"""Measure what wrong readings cost, with the range filter and without.

python experiments/table5_robustness/run.py     reads the stored rows and measures those that are missing

All rows cross the same test arenas with 80 obstacles, and draw their wrong readings from the same seeds.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import torch  # noqa: E402

from eldenet.navigation.episodes import EpisodeSettings  # noqa: E402
from eldenet.navigation.evaluation import Episode, run_episodes, summarize  # noqa: E402
from eldenet.navigation.range_filter import FILTER_VERSION  # noqa: E402
from eldenet.navigation.sensors import Ranges  # noqa: E402
from eldenet.navigation.tasks import frozen_arenas  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "table5_success"))
from episodes import mcnemar, read_episodes, write_episodes  # noqa: E402

sys.path.insert(0, str(HERE))

from conditions import METHODS, VERSIONS  # noqa: E402

DENSITY = 80
FAULTS: Mapping[str, Mapping[str, float]] = {
    "clean": {},
    "2 % false near": {"false_near": 0.02},
    "2 % false far": {"false_far": 0.02},
    "2 % of each": {"false_near": 0.02, "false_far": 0.02},
    "5 % false near": {"false_near": 0.05},
    "5 % of each": {"false_near": 0.05, "false_far": 0.05},
    "one stuck column": {"stuck": 1},
}
DEFAULT_METHODS = ("dqn_ensemble", "astar_online_dqn", "astar_online_dwa")
LABELS = ("method", "faults", "filter", "version")

# (method, faults, whether there is the filter) -> episodes by arena
Rows = dict[tuple[str, str, bool], list[Episode]]


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=40, help="test arenas")
    parser.add_argument("--methods", default=";".join(DEFAULT_METHODS), help="separated by semicolons")
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument(
        "--filter", default="both", choices=("both", "with"), help="rows without it too, or not"
    )
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    stored = read(folder / "results.csv.xz")
    arenas = frozen_arenas(DENSITY, args.worlds)
    for faults in args.faults.split(","):
        for method in args.methods.split(";"):
            for filtered in (False, True) if args.filter == "both" else (True,):
                rows = stored.setdefault((method, faults, filtered), [])
                if len(rows) >= args.worlds:
                    continue
                settings = EpisodeSettings("wheels", range_filter=filtered)
                rows[:] = run_episodes(arenas, METHODS[method], Ranges(**FAULTS[faults]), settings)  # type: ignore[arg-type]
                write(folder, stored)
                solved = sum(row.outcome == "success" for row in rows)
                print(f"{method}, {faults}, filter {filtered}: {solved} of {len(rows)}", flush=True)
    write(folder, stored)


def version(method: str, filtered: bool) -> str:
    """Version of what an episode depends on."""
    return f"{VERSIONS[method]}.{FILTER_VERSION}" if filtered else VERSIONS[method]


def read(file: Path) -> Rows:
    """Return the stored rows whose version is today's."""
    return {
        (method, faults, filtered == "True"): episodes
        for (method, faults, filtered, made_with), episodes in read_episodes(file, LABELS).items()
        if made_with == version(method, filtered == "True")
    }


def write(folder: Path, rows: Rows) -> None:
    """Write every episode to ``results.csv.xz`` and the table to ``results.md``."""
    order = {
        (method, faults, filtered): number
        for number, (method, faults, filtered) in enumerate(
            (m, f, on) for m in METHODS for f in FAULTS for on in (False, True)
        )
    }
    made = {key: rows[key] for key in sorted(rows, key=order.__getitem__) if rows[key]}
    labeled = {(*key, version(key[0], key[2])): episodes for key, episodes in made.items()}
    write_episodes(folder / "results.csv.xz", LABELS, labeled)
    where = environment()
    text = [
        "# Wrong readings at 80 obstacles",
        "",
        f"Success [%] with Wilson's 95 % interval on the first test arenas; true ranges, wheels, goal known. "
        f"{where['date']}. The last column counts the arenas that only one of both solved, and McNemar's "
        "p-value.",
    ]
    for method in dict.fromkeys(key[0] for key in made if key[2]):
        text += ["", f"## {method}", "", "| readings | arenas | without filter | with filter |"]
        text[-1] += " time-outs | collisions | time of successes [s] | only without : only with |"
        text += ["|---|---:|---:|---:|---:|---:|---:|---:|"]
        for faults in FAULTS:
            without, having = (made.get((method, faults, on)) for on in (False, True))
            if having:
                text.append(line_of(faults, without, having))
    text += ["", "Arenas, time-outs, collisions [%] and time: without / with the filter, or with it alone."]
    text += ["", "Made by `python experiments/table5_robustness/run.py`."]
    (folder / "results.md").write_text("\n".join(text) + "\n")


def line_of(faults: str, without: Sequence[Episode] | None, having: Sequence[Episode]) -> str:
    """Return a line of the table: a dash where there are no rows without the filter."""
    both = [rows for rows in (without, having) if rows]
    tables = [summarize(rows) for rows in both]
    rates = [f"{t['success']:.1f} ({t['success_low']:.0f} to {t['success_high']:.0f})" for t in tables]
    cells = [" / ".join(str(len(rows)) for rows in both), *(["-"] if without is None else []), *rates]
    for name in ("timeout", "collision", "seconds"):
        cells.append(" / ".join(f"{t[name]:.1f}" for t in tables))
    if without is None:
        return f"| {faults} | {' | '.join(cells)} | - |"
    count = min(len(without), len(having))
    first, second = ([row.outcome == "success" for row in rows[:count]] for rows in (without, having))
    only_without, only_with, p = mcnemar(first, second)
    return f"| {faults} | {' | '.join(cells)} | {only_without} : {only_with} (p = {p:.2g}) |"


if __name__ == "__main__":
    main(sys.argv[1:])

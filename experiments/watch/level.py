"""What an unknown tilt or scale costs a driver, and what a leveler gives back.

python experiments/watch/level.py --drives 40    reads stored drives and measures those that are missing
python experiments/watch/level.py --sensor network --drivers alone

The arenas and the sensors are those of run.py; the watch is off.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import run  # noqa: E402
from scipy.stats import binomtest  # noqa: E402

from eldenet.system.files import read_table, write_rows  # noqa: E402

COLUMNS = ("sensor", "driver", "fault", "leveled", "world", "outcome")


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=20)
    parser.add_argument("--sensor", default="depth camera", choices=("depth camera", "network"))
    parser.add_argument("--drivers", default="plan")
    parser.add_argument("--faults", default=";".join(run.UNLEVEL), help="separated by semicolons")
    args = parser.parse_args(arguments)
    run.torch.set_num_threads(1)
    file = folder / "level.csv"
    rows = {}
    if file.is_file():
        for row in read_table(file, COLUMNS):
            *key, rows[tuple(key)] = (row[name] for name in COLUMNS)
    for driver in args.drivers.split(","):
        for world in range(args.drives):
            for fault in args.faults.split(";"):
                for leveled in (False, True):
                    key = (args.sensor, driver, fault, str(leveled), str(world))
                    if key not in rows:
                        rows[key] = run.drive(args.sensor, driver, fault, world, leveled).outcome
            write_rows(file, COLUMNS, sorted((*key, outcome) for key, outcome in rows.items()))
    text = [
        "# Unknown tilt and scale",
        "",
        "Drives that reach the goal [%] with Wilson's 95 % interval, of how many; the watch is off.",
        "",
        "| sensor | driver | fault | without a leveler | with one |",
        "|---|---|---|---:|---:|",
    ]
    for sensor, driver in sorted({key[:2] for key in rows}):
        for fault in run.UNLEVEL:
            cells = []
            for leveled in ("False", "True"):
                named = (sensor, driver, fault, leveled)
                cells.append(_rate([outcome for key, outcome in rows.items() if key[:4] == named]))
            text.append(f"| {sensor} | {driver} | {fault} | {' | '.join(cells)} |")
    text += ["", "Made by `python experiments/watch/level.py`."]
    (folder / "level.md").write_text("\n".join(text) + "\n")


def _rate(outcomes: Sequence[str]) -> str:
    if not outcomes:
        return "-"
    goals = outcomes.count("goal")
    low, high = binomtest(goals, len(outcomes)).proportion_ci(method="wilson")
    return f"{100 * goals / len(outcomes):.1f} ({100 * low:.0f} to {100 * high:.0f}; {len(outcomes)})"


if __name__ == "__main__":
    main(sys.argv[1:])

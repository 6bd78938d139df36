"""What an unknown tilt or scale costs a driver with a depth camera, and what a leveler gives back.

python experiments/watch/level.py --drives 20    reads stored drives and measures those that are missing

The arenas and the camera are those of run.py; the watch is off.
"""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import run  # noqa: E402

from eldenet.system.files import read_table, write_rows  # noqa: E402

FAULTS = ("none", "pitch 5 degrees", "roll 5 degrees", "depth x 0.75", "depth x 1.35")
COLUMNS = ("driver", "fault", "leveled", "world", "outcome")


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=20)
    parser.add_argument("--drivers", default="plan,alone")
    args = parser.parse_args(arguments)
    run.torch.set_num_threads(1)
    file = folder / "level.csv"
    rows = (
        [tuple(row[name] for name in COLUMNS) for row in read_table(file, COLUMNS)] if file.is_file() else []
    )
    for driver in args.drivers.split(","):
        for world in range(args.drives):
            for fault in FAULTS:
                for leveled in (False, True):
                    key = (driver, fault, str(leveled), str(world))
                    if all(row[:4] != key for row in rows):
                        outcome = run.drive("depth camera", driver, fault, world, leveled).outcome
                        rows.append((*key, outcome))
            write_rows(file, COLUMNS, sorted(rows))
    text = [
        "# Unknown tilt and scale",
        "",
        "Drives of a depth camera that reach the goal; the watch is off.",
        "",
    ]
    text += ["| driver | fault | without a leveler | with one |", "|---|---|---:|---:|"]
    for driver in sorted({row[0] for row in rows}):
        for fault in FAULTS:
            cells = []
            for leveled in ("False", "True"):
                ends = [row[4] for row in rows if row[:3] == (driver, fault, leveled)]
                cells.append(f"{ends.count('goal')} of {len(ends)}")
            text.append(f"| {driver} | {fault} | {' | '.join(cells)} |")
    text += ["", "Made by `python experiments/watch/level.py`."]
    (folder / "level.md").write_text("\n".join(text) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])

"""Choose SORT's settings on training drives, as those of our tracker were.

python experiments/tracking/tune_sort.py     writes sort_settings.csv, the best HOTA first
"""

import argparse
import sys
from itertools import product
from pathlib import Path

from drives import drive
from run import FIRST, by_sort, score, together

from eldenet.system.files import write_rows

HERE = Path(__file__).parent
GRID = {
    "least_overlap": (0.01, 0.02, 0.05, 0.1, 0.2, 0.3),
    "speed_noise": (0.1, 1.0, 10.0, 100.0),
    "measured_noise": (0.1, 1.0, 10.0),
}


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--drives", type=int, default=8)
    options.add_argument("--frames", type=int, default=50, help="of a drive")
    args = options.parse_args()
    choices = [dict(zip(GRID, values, strict=True)) for values in product(*GRID.values())]
    scored: list[list[tuple[dict, dict]]] = [[] for _ in choices]
    for number in range(args.drives):
        frames = list(drive("train", FIRST["train"] + number, args.frames))
        for settings, mine in zip(choices, scored, strict=True):
            mine.append(score(frames, by_sort(frames, **settings)))
        print(f"{number + 1} of {args.drives} drives", flush=True)
    rows = [
        [*settings.values(), *together(mine), args.drives]
        for settings, mine in zip(choices, scored, strict=True)
    ]
    rows.sort(key=lambda row: (-float(row[len(GRID) + 2]), row[len(GRID)]))
    columns = (*GRID, "switches", "MOTA", "HOTA", "AssA", "fragments", "drives", "command")
    command = " ".join(["python experiments/tracking/tune_sort.py", *sys.argv[1:]])
    write_rows(HERE / "sort_settings.csv", columns, [[*row, command] for row in rows])


if __name__ == "__main__":
    main()

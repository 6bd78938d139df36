"""One table of all conditions and faults: the packaged driver as table 5 has it, and what helps.

python experiments/table5_robustness/table.py             measures rows that are missing, writes table.md
python experiments/table5_robustness/table.py --stored    measures nothing
"""

import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import conditions  # noqa: E402
import run as faults  # noqa: E402

from eldenet.navigation.evaluation import Episode, summarize  # noqa: E402

ALONE = ("dqn_ensemble", "varied_dqn", "astar_online_dwa")
METHODS = ("dqn_ensemble", "astar_online_dqn", "astar_online_dwa")
HEAD = (
    "what differs from 80 obstacles and true ranges",
    "packaged driver alone",
    "`varied_dqn` alone",
    "`astar_online_dwa` alone",
    "packaged driver",
    "`astar_online_dqn`",
    "`astar_online_dwa`",
)


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=40, help="test arenas of rows that are missing")
    parser.add_argument("--stored", action="store_true", help="measure nothing")
    args = parser.parse_args(arguments)
    if not args.stored:
        conditions.main(["--worlds", str(args.worlds)], folder)
        faults.main(["--worlds", str(args.worlds)], folder)
    write(folder, conditions.read(folder / "conditions.csv.xz"), faults.read(folder / "results.csv.xz"))


def write(folder: Path, rows: conditions.Rows, faulty: faults.Rows) -> None:
    """Write ``table.md``."""
    lines = [line for name in conditions.CONDITIONS if (line := condition_line(name, rows))]
    lines += [fault_line(name, faulty) for name in list(faults.FAULTS)[1:]]
    text = [
        "# What an arena, a delay or a fault costs",
        "",
        "Success [%] with Wilson's 95 % interval, and the number of arenas. Drivers of the last three "
        "columns know the latency, get filtered ranges where single columns are wrong, and corrected "
        "ranges where all are too short or too long; the first three do not. "
        "`varied_dqn` was trained with other sizes, speeds, latencies and a drifting odometry.",
        "",
        f"| {' | '.join(HEAD)} |",
        f"|---|{'---:|' * (len(HEAD) - 1)}",
        *lines,
        "",
        "Made by `python experiments/table5_robustness/table.py --stored` of `conditions.csv.xz` and "
        "`results.csv.xz`.",
    ]
    (folder / "table.md").write_text("\n".join(text) + "\n")


def condition_line(name: str, rows: conditions.Rows) -> str | None:
    """Return a line of the table; None without rows, and for a remedy: its rows stand in another line."""
    if name in conditions.REMEDIES.values():
        return None
    helped = conditions.REMEDIES.get(name, name)
    corrected = "range_scale" in conditions.CONDITIONS[name].robot  # what the correction may break
    alone = [None if corrected else rows.get((method, name)) for method in ALONE]
    episodes = [*alone, *(rows.get((method, helped)) for method in METHODS)]
    return line(name, episodes) if any(episodes) else None


def fault_line(name: str, rows: faults.Rows) -> str:
    """Return a line of the table: without the range filter, then with it."""
    alone = [rows.get((method, name, False)) for method in ALONE]
    return line(name, [*alone, *(rows.get((method, name, True)) for method in METHODS)])


def line(name: str, episodes: Sequence[Sequence[Episode] | None]) -> str:
    return f"| {' | '.join([name, *map(cell, episodes)])} |"


def cell(episodes: Sequence[Episode] | None) -> str:
    if not episodes:
        return "-"
    s: Mapping[str, float] = summarize(episodes)
    return f"{s['success']:.1f} ({s['success_low']:.0f} to {s['success_high']:.0f}; {len(episodes)})"


if __name__ == "__main__":
    main(sys.argv[1:])

"""Drive by a camera with and without the sigma of its depth network, in the same arenas.

python experiments/uncertainty/arenas.py runs/arenas_sigma --density 80 --worlds 300

Network, depth and driver are the same in both rows. Writes every episode to ``arenas.csv`` and prints the
table; stored rows are not driven again.
"""

import argparse
import sys
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.evaluation.bootstrap import mean_interval  # noqa: E402
from eldenet.navigation.cameras import Camera  # noqa: E402
from eldenet.navigation.episodes import EpisodeSettings  # noqa: E402
from eldenet.navigation.evaluation import run_episodes  # noqa: E402
from eldenet.navigation.policy import Navigator  # noqa: E402
from eldenet.navigation.provenance import EPISODE_VERSION  # noqa: E402
from eldenet.navigation.tasks import frozen_arenas  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.system.files import read_table, write_rows  # noqa: E402

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "table5_success"))
from episodes import mcnemar  # noqa: E402

COLUMNS = ("version", "density", "sigma", "number", "world", "outcome", "seconds")
PART = 20  # arenas driven before what is there is written

# (density, "with" or "without") -> (world, outcome, seconds) by arena
Rows = dict[tuple[int, str], list[tuple[str, str, float]]]


def read(table: Path) -> Rows:
    """Return the stored episodes of today's simulation."""
    rows: Rows = {}
    for line in read_table(table, COLUMNS) if table.is_file() else ():
        if line["version"] == str(EPISODE_VERSION):
            episode = (line["world"], line["outcome"], float(line["seconds"]))
            rows.setdefault((int(line["density"]), line["sigma"]), []).append(episode)
    return rows


def write(table: Path, rows: Rows) -> None:
    lines = [
        [EPISODE_VERSION, *key, number, *episode]
        for key, episodes in sorted(rows.items())
        for number, episode in enumerate(episodes)
    ]
    write_rows(table, COLUMNS, lines)


def table_of(rows: Rows) -> list[str]:
    """Success, collisions and time of both, and their paired difference."""
    lines = [
        "| obstacles | arenas | sigma | success [%] | collision [%] | out of time [%] | seconds |",
        "|---:|---:|---|---:|---:|---:|---:|",
    ]
    notes = []
    for density in sorted({density for density, _ in rows}):
        pair = [rows.get((density, sigma), []) for sigma in ("without", "with")]
        count = min(map(len, pair))
        if not count:
            continue
        for sigma, episodes in zip(("without", "with"), pair, strict=True):
            outcomes = np.array([outcome for _, outcome, _ in episodes[:count]])
            shares = [100 * float((outcomes == name).mean()) for name in ("success", "collision", "timeout")]
            seconds = [time for _, outcome, time in episodes[:count] if outcome == "success"]
            cells = " | ".join(f"{share:.1f}" for share in shares)
            lines.append(f"| {density} | {count} | {sigma} | {cells} | {np.mean(seconds):.1f} |")
        plain, own = (
            np.array([outcome == "collision" for _, outcome, _ in episodes[:count]]) for episodes in pair
        )
        low, high = mean_interval(100.0 * (own.astype(float) - plain))
        change, p = 100 * (own.mean() - plain.mean()), mcnemar(list(~own), list(~plain))[2]
        notes.append(
            f"- {density} obstacles: collisions {change:+.1f} points with sigma [{low:+.1f}, {high:+.1f}], "
            f"McNemar p = {p:.2g}"
        )
    return [*lines, "", *notes]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("weights", nargs="?", help="that know their sigma; without: the table of arenas.csv")
    options.add_argument("--density", type=int, nargs="+", default=[80])
    options.add_argument("--worlds", type=int, default=300)
    options.add_argument("--output", type=Path, default=HERE)
    args = options.parse_args()
    args.output.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    rows = read(args.output / "arenas.csv")
    if args.weights:
        model = eldenet.load(args.weights)
        for density in args.density:
            arenas = frozen_arenas(density, args.worlds)
            for first in range(0, args.worlds, PART):
                for sigma in ("without", "with"):
                    stored = rows.setdefault((density, sigma), [])
                    if len(stored) > first:
                        continue
                    predictor = eldenet.DepthPredictor(model, steady=False, uncertainty=sigma == "with")
                    driven = run_episodes(
                        arenas[first : first + PART],
                        lambda robots: Navigator.load(slows_within=1.0, robots=robots),
                        Camera(predictor),
                        EpisodeSettings("wheels"),
                    )
                    stored += [(episode.world, episode.outcome, episode.seconds) for episode in driven]
                write(args.output / "arenas.csv", rows)
    where = environment()
    lines = [
        "# Driving by a camera with and without sigma",
        "",
        "The packaged driver on wheels in frozen test arenas, rendered camera, known goal; the same",
        "network's depth in both rows. In brackets: 95 % interval over arenas. "
        f"{where['hardware']['processor']}, torch {where['versions']['torch']}, {where['date']}. "
        "Made by `python experiments/uncertainty/arenas.py`.",
        "",
        *table_of(rows),
    ]
    print("\n".join(lines))


if __name__ == "__main__":
    main()

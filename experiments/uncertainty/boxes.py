"""Score the distance intervals of 3D boxes, which come from the sigma of the depth network.

python experiments/uncertainty/boxes.py runs/streets_sigma

Objects of rendered streets that no training sees, with 2D boxes of an ideal detector. Writes ``boxes.csv``
(every object) and prints the table.
"""

import argparse
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
from scipy.stats import spearmanr  # noqa: E402

import eldenet  # noqa: E402
from eldenet.evaluation.bootstrap import bootstrap_interval  # noqa: E402
from eldenet.perception.lifter import DISTANCE_LEVEL, BoxLifter  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.simulation.street_views import render_street  # noqa: E402
from eldenet.system.files import read_table, write_rows  # noqa: E402

HERE = Path(__file__).parent
COLUMNS = ("street", "object", "distance", "with_sigma", "low", "high", "without_sigma", "no_depth")
LEAST_VISIBLE, LEAST_HEIGHT = 0.3, 18  # share; [px] of the 2D box, as in table 4
CAMERA_HEIGHT = 1.65  # nominal [m]


def objects_of(predictor: eldenet.DepthPredictor, index: int) -> list[list[float]]:
    """Measure the visible objects of test street ``index``: a row of ``COLUMNS`` each."""
    view = render_street("test", index)
    estimate = predictor(view.image)
    refine = BoxLifter(camera_height=CAMERA_HEIGHT)
    blind = BoxLifter("no_depth", camera_height=CAMERA_HEIGHT)
    lifted = refine(estimate, view.detections, view.camera)
    found = [
        lifted,
        refine(np.asarray(estimate.depth), view.detections, view.camera),
        blind(np.asarray(estimate.depth), view.detections, view.camera),
    ]
    truth, own, plain, none = (
        np.hypot(boxes.center[:, 0], boxes.center[:, 2]) for boxes in (view.boxes, *found)
    )
    tall = view.detections.xyxy[:, 3] - view.detections.xyxy[:, 1]
    kept = np.flatnonzero((view.visible >= LEAST_VISIBLE) & ~view.truncated & (tall >= LEAST_HEIGHT))
    low, high = lifted.quality["distance_low"], lifted.quality["distance_high"]
    return [[index, k, truth[k], own[k], low[k], high[k], plain[k], none[k]] for k in kept]


def summary(rows: np.ndarray) -> list[str]:
    """Coverage, rank correlation and errors, with intervals over streets."""
    streets = np.unique(rows[:, 0])
    groups = [np.flatnonzero(rows[:, 0] == street) for street in streets]
    _, _, truth, own, low, high, plain, blind = rows.T
    inside, wrong = (low <= truth) & (truth <= high), np.abs(own - truth)
    relative = wrong / truth

    def shown(statistic, digits: int = 3) -> str:
        value = statistic(np.arange(len(rows)))
        ends = bootstrap_interval(
            lambda drawn: float(statistic(np.concatenate([groups[g] for g in drawn]))), len(groups)
        )
        return f"{value:.{digits}f} [{ends[0]:.{digits}f}, {ends[1]:.{digits}f}]"

    width = high - low
    figures = {
        f"share of objects inside their {DISTANCE_LEVEL:.0%} interval": lambda k: inside[k].mean(),
        "rank correlation of the interval's width and the error": lambda k: spearmanr(width[k], wrong[k])[0],
        "the same, both relative to the distance": lambda k: spearmanr((width / own)[k], relative[k])[0],
        "median relative error of the distance, with sigma": lambda k: np.median(relative[k]),
        "without sigma": lambda k: np.median((np.abs(plain - truth) / truth)[k]),
        "without depth": lambda k: np.median((np.abs(blind - truth) / truth)[k]),
    }
    return [f"| {name} | {shown(statistic)} |" for name, statistic in figures.items()]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("weights", nargs="?", help="that know their sigma; without: the table of boxes.csv")
    options.add_argument("--streets", type=int, default=200)
    options.add_argument("--output", type=Path, default=HERE)
    args = options.parse_args()
    table = args.output / "boxes.csv"
    if args.weights:
        predictor = eldenet.DepthPredictor(eldenet.load(args.weights), uncertainty=True, steady=False)
        rows = []
        for index in range(args.streets):
            rows += objects_of(predictor, index)
        args.output.mkdir(parents=True, exist_ok=True)
        write_rows(table, COLUMNS, [[f"{value:.6g}" for value in row] for row in rows])
    rows = np.array([[float(row[name]) for name in COLUMNS] for row in read_table(table, COLUMNS)])
    where = environment()
    lines = [
        "# Distance intervals of 3D boxes",
        "",
        f"{len(rows)} objects of {len(np.unique(rows[:, 0]))} test streets, ideal 2D boxes, `refine`.",
        "In brackets: 95 % interval over streets.",
        "",
        "| figure | value |",
        "|---|---:|",
        *summary(rows),
        "",
        f"{where['hardware']['processor']}, torch {where['versions']['torch']}, {where['date']}. Made by "
        "`python experiments/uncertainty/boxes.py runs/streets_sigma`.",
    ]
    print("\n".join(lines))


if __name__ == "__main__":
    main()

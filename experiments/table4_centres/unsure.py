"""What the points of slim and small things are worth to the fit where their depth is unsure.

python experiments/table4_centres/unsure.py --sim-model runs/streets-depth --hall-model eldenet_indoor

Beyond an error of ``box_methods.UNSURE`` the points of people, cyclists, boxes and pillars are worth less.
How much less is chosen on training scenes, with 2D boxes shaken as in ``defaults.py``; then test scenes are
scored, as in ``run.py``. Writes ``unsure.md``.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from cases import HEIGHTS, SMALL, Case, render, simulated
from defaults import FIRST_SCENE, shaken

import eldenet
from eldenet.deploy.predictor import DepthPredictor, for_camera
from eldenet.perception import box_methods
from eldenet.perception.lifter import BoxLifter
from eldenet.perception.matching_metrics import Pairs, bootstrap, compare

HERE = Path(__file__).parent
CHOSEN = box_methods.UNSURE_WORTH["upright"]
BEFORE = box_methods.UNSURE_WORTH["vehicle"]  # what points were always worth
GRID = (BEFORE, 1.0, 0.3, 0.1)
TITLES = (
    "scenes", "objects", "points are worth", "center accuracy [%]", "BEV > 0.25 [%]",
    "BEV > 0.5 [%]", "accuracy - no_depth", "BEV > 0.25 - no_depth", "accuracy - before",
    "BEV > 0.25 - before",
)  # fmt: skip


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--sim-model", help="folder of a network trained on rendered streets")
    options.add_argument("--hall-model", help="a network for rendered halls")
    options.add_argument("--train", type=int, default=30, help="training scenes of each kind")
    options.add_argument("--test", type=int, default=20, help="test scenes of each kind")
    args = options.parse_args()
    torch.set_num_threads(1)
    rows = []
    models = {"crossing": args.sim_model, "hall": args.hall_model}
    for kind, model in models.items():
        if model is None:
            continue
        network = eldenet.load(model)
        predictor = DepthPredictor(network, steady=False, uncertainty=network.distribution is not None)
        for split, first, count, grid in (
            ("train", FIRST_SCENE, args.train, GRID),
            ("test", 0, args.test, (BEFORE, CHOSEN)),
        ):
            views = render(split, first, count, kind)
            exact = simulated(views, lambda view: view.depth)
            if split == "train":
                exact = [shaken(case) for case in exact]
            found = [for_camera(predictor, view.camera.intrinsics)(view.image) for view in views]
            cases = [replace(case, depth=depth) for case, depth in zip(exact, found, strict=True)]
            rows += compared(f"{kind}, {split}", cases, HEIGHTS[kind], grid)
            write(rows, args)


def compared(title: str, cases: list[Case], height: float, grid: tuple[float, ...]) -> list[list]:
    """Return the rows of ``no_depth`` and of each choice, small things and others apart."""
    blind = lifted(cases, "no_depth", height)
    results = {choice: lifted(cases, "refine", height, choice) for choice in grid}
    small = np.isin(np.concatenate([np.array(case.truth.classes)[case.rows] for case in cases]), SMALL)
    rows = []
    for name, chosen in (("people, cyclists", small), ("others", ~small)):
        if not chosen.any():
            continue
        objects = f"{name} ({chosen.sum()})"
        without = blind.select(chosen)
        rows.append([title, objects, "`no_depth`", *shares(without), "", "", "", ""])
        for choice, pairs in results.items():
            part = pairs.select(chosen)
            gaps = gap(part, without) + (
                gap(part, results[BEFORE].select(chosen)) if choice != BEFORE else ["", ""]
            )
            rows.append([title, objects, f"{choice:g}", *shares(part), *gaps])
    return rows


def lifted(cases: list[Case], method: str, height: float, worth: float = CHOSEN) -> Pairs:
    box_methods.UNSURE_WORTH |= {"upright": worth, "box": worth}
    lifter = BoxLifter(method, camera_height=height)
    found = [lifter(case.depth, case.detections, case.camera) for case in cases]
    return Pairs.join([compare(c.truth, f, c.rows, c.columns) for c, f in zip(cases, found, strict=True)])


def shares(pairs: Pairs) -> list[str]:
    figures = pairs.accuracy, pairs.bev >= 0.25, pairs.bev >= 0.5
    return [f"{100 * np.mean(values):.1f}" for values in figures]


def gap(first: Pairs, second: Pairs) -> list[str]:
    """Return the differences of center accuracy and of BEV > 0.25 in points, with 95 % over frames."""
    cells = []
    for values in (first.accuracy - second.accuracy, (first.bev >= 0.25) * 1.0 - (second.bev >= 0.25)):
        low, high = bootstrap(values, first.frame)
        cells.append(f"{100 * values.mean():+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]")
    return cells


def write(rows: list[list], args: argparse.Namespace) -> None:
    words = " ".join(Path(word).name if "/" in word else word for word in sys.argv[1:])
    text = [
        f"| {' | '.join(TITLES)} |", "|---|---|" + "---:|" * (len(TITLES) - 2),
        *(f"| {' | '.join(map(str, row))} |" for row in rows), "",
        f"Chosen: {CHOSEN:g} where the depth error is above {box_methods.UNSURE:g}. The points of vehicles, "
        f"and all whose depth is sure, are worth {BEFORE:g} independent measurements, as all were before.",
        "",
        "Rendered scenes; objects as in results.md; the camera's height is known. Brackets: 95 % of 2000 "
        "resamples of whole frames, on the same objects.", "",
        f"Made by `python experiments/table4_centres/unsure.py {words}`.",
    ]  # fmt: skip
    (HERE / "unsure.md").write_text("\n".join(text) + "\n")
    print("\n".join(text), flush=True)


if __name__ == "__main__":
    main()

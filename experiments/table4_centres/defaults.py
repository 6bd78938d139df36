"""How the defaults of the depth error were chosen: boxes on rendered training scenes over a grid of errors.

python experiments/table4_centres/defaults.py --sim-model runs/streets-depth

Streets and crossings alternate; 2D boxes are shaken as a detector's are. Vehicles, and people with cyclists,
are counted apart. Writes ``defaults.md``. No real frame is used.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from cases import HEIGHTS, SMALL, Case, render, simulated

import eldenet
from eldenet.boxes import Boxes3D
from eldenet.deploy.predictor import DepthPredictor
from eldenet.perception.lifter import DOUBTFUL_COST, NETWORK_SIGMA, SENSOR_SIGMA, BoxLifter
from eldenet.perception.matching_metrics import Pairs, compare
from eldenet.simulation.street_views import StreetView

HERE = Path(__file__).parent
FIRST_SCENE = 40000  # beyond the scenes that networks are trained on
LIDAR_ERRORS = (0.005, 0.01, 0.02, 0.04, 0.08)
GRID = {
    "LiDAR": tuple((error, error) for error in LIDAR_ERRORS),
    "network": ((0.08, 0.08), (0.06, 0.27), (0.06, 0.5), (0.12, 0.5), (0.15, 0.5), (0.2, 0.5), (0.5, 0.5)),
}
WRONG = 0.2  # of the distance: a center farther off is wrong
COSTS = (3.0, 4.0, 6.0, 8.0, 12.0)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--scenes", type=int, default=40)
    options.add_argument("--sim-model", help="folder of a network trained on rendered streets")
    args = options.parse_args()
    torch.set_num_threads(1)
    half = args.scenes // 2
    views = [v for kind in ("street", "crossing") for v in render("train", FIRST_SCENE, half, kind)]
    sources: dict[str, Callable[[StreetView], np.ndarray]] = {"LiDAR": scanned}
    if args.sim_model:
        network = DepthPredictor(eldenet.load(args.sim_model), steady=False)
        sources["network"] = lambda view: network(view.image)
    rows, flags = [], []
    for source, depth_of in sources.items():
        cases = [shaken(case) for case in simulated(views, depth_of)]
        for sigma in GRID[source]:
            row, pairs, cost = measure(cases, "refine", sigma)
            rows.append([source, "refine", *sigma, *row])
            if sigma == (SENSOR_SIGMA if source == "LiDAR" else NETWORK_SIGMA):
                flags += [[source, *line] for line in doubtful(pairs, cost)]
        rows.append([source, "lshape", *sigma, *measure(cases, "lshape", sigma)[0]])
        rows.append([source, "no_depth", "", "", *measure(cases, "no_depth", sigma)[0]])
        write(rows, flags, args.scenes)


def scanned(view: StreetView) -> np.ndarray:
    """The depth that a LiDAR of 64 beams would leave: one row of three, every second column, 2 cm of noise.

    A few points belong to what stands beside: the LiDAR does not stand where the camera does.
    """
    rng = np.random.default_rng(int(view.image.sum()))
    depth = np.zeros_like(view.depth)
    rows, columns = np.mgrid[1 : depth.shape[0] : 3, 1 : depth.shape[1] : 2]
    aside = np.clip(columns + rng.integers(-2, 3, rows.shape), 0, depth.shape[1] - 1)
    exact = view.depth[rows, np.where(rng.random(rows.shape) < 0.2, aside, columns)]
    noisy = exact + rng.normal(0, 0.02, rows.shape)
    depth[rows, columns] = np.where((exact > 0) & (exact < 80) & (rng.random(rows.shape) < 0.85), noisy, 0)
    return depth


def shaken(case: Case) -> Case:
    """The case with 2D boxes whose edges are off by a pixel and 2 % of the side, as a detector's are."""
    rng = np.random.default_rng(len(case.detections) + int(case.name))
    xyxy = case.detections.xyxy
    side = np.tile(xyxy[:, 2:] - xyxy[:, :2], 2)
    moved = xyxy + np.clip(rng.normal(0, 1, xyxy.shape), -2, 2) * (0.7 + 0.02 * side)
    size = case.depth.shape
    low = np.clip(moved, -0.5, np.array([size[1], size[0]] * 2) - 0.5)
    return replace(case, detections=replace(case.detections, xyxy=low))


def measure(cases: list[Case], method: str, sigma: tuple[float, float]) -> tuple[list, Pairs, np.ndarray]:
    """Return figures of vehicles and of small objects, all pairs, and the cost of each."""
    lifter = BoxLifter(method, camera_height=HEIGHTS["street"], depth_sigma=sigma[0], small_sigma=sigma[1])
    found: list[Boxes3D] = [lifter(case.depth, case.detections, case.camera) for case in cases]
    parts = [compare(c.truth, f, c.rows, c.columns) for c, f in zip(cases, found, strict=True)]
    names = np.concatenate([np.array(c.truth.classes)[c.rows] for c in cases])
    cost = np.concatenate([f.quality["cost"][c.columns] for c, f in zip(cases, found, strict=True)])
    flagged = np.concatenate([f.quality["doubtful"][c.columns] for c, f in zip(cases, found, strict=True)])
    pairs = Pairs.join(parts)
    figures: list = []
    for chosen in (~np.isin(names, SMALL), np.isin(names, SMALL)):
        part = pairs.select(chosen)
        shares = part.accuracy.mean(), (part.bev >= 0.25).mean(), (part.iou >= 0.5).mean()
        figures += [len(part), *(f"{100 * share:.1f}" for share in shares)]
    return [*figures, f"{100 * flagged.mean():.1f}"], pairs, cost


def doubtful(pairs: Pairs, cost: np.ndarray) -> list[list[str]]:
    """Return per limit of the cost: the share of boxes beyond it, and of wrong ones there and below."""
    wrong = pairs.error > WRONG * pairs.distance
    lines = []
    for limit in COSTS:
        beyond = cost > limit
        part = [
            f"{100 * wrong[side].mean():.1f} of {side.sum()}" if side.any() else "-"
            for side in (beyond, ~beyond)
        ]
        lines.append([f"{limit:g}", f"{100 * beyond.mean():.1f}", *part])
    return lines


def write(rows: list[list], flags: list[list], scenes: int) -> None:
    command = "python experiments/table4_centres/defaults.py " + " ".join(
        Path(word).name if "/" in word else word for word in sys.argv[1:]
    )
    titles = ("depth", "method", "depth_sigma", "small_sigma", "vehicles", "center accuracy [%]",
              "BEV > 0.25 [%]", "3D > 0.5 [%]", "people, cyclists", "center accuracy [%]", "BEV > 0.25 [%]",
              "3D > 0.5 [%]",
              "doubtful [%]")  # fmt: skip
    text = [
        f"| {' | '.join(titles)} |", "|---|---|" + "---:|" * (len(titles) - 2),
        *(f"| {' | '.join(map(str, row))} |" for row in rows), "",
        f"Chosen: LiDAR {SENSOR_SIGMA}, a network without sigma {NETWORK_SIGMA}. A box is doubtful "
        f"beyond a cost of {DOUBTFUL_COST:g}:", "",
        "| depth | cost | boxes beyond [%] | wrong beyond [%] | wrong below [%] |",
        "|---|---:|---:|---:|---:|",
        *(f"| {' | '.join(line)} |" for line in flags), "",
        f"{scenes} rendered training scenes, streets and crossings, at 256 x 832; objects as in results.md, "
        f"2D boxes shaken by 0.7 px and 2 % of their side; wrong: off by more than {WRONG:.0%} of the "
        "distance.",
        f"Made by `{command.strip()}`.",
    ]  # fmt: skip
    (HERE / "defaults.md").write_text("\n".join(text) + "\n")
    print("\n".join(text))


if __name__ == "__main__":
    main()

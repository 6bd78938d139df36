"""Why centers in halls come too near: boxes from exact depth, a network's, and one whose scale is right.

python experiments/table4_centres/halls.py --model eldenet_indoor

Prints the table of README.md.
"""

import argparse
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import torch
from cases import HEIGHTS, Case, render, simulated

import eldenet
from eldenet.deploy.predictor import DepthPredictor
from eldenet.perception.ground import fit_ground
from eldenet.perception.lifter import SENSOR_SIGMA, BoxLifter
from eldenet.perception.matching_metrics import Pairs, bootstrap, compare
from eldenet.simulation.street_views import StreetView
from eldenet.uncertainty import DepthEstimate

HEIGHT = HEIGHTS["hall"]
DEPTHS = (0.0, 3.0, 5.0, 8.0, np.inf)  # [m]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--model", default="eldenet_indoor")
    options.add_argument("--halls", type=int, default=20)
    args = options.parse_args()
    torch.set_num_threads(1)
    views = render("test", 0, args.halls, "hall")
    model = eldenet.load(args.model)
    network = DepthPredictor(model, steady=False, uncertainty=model.distribution is not None)
    found = [network(view.image, intrinsics=view.camera.intrinsics) for view in views]
    factors = [
        np.median((view.depth / one.depth)[view.depth > 0]) for view, one in zip(views, found, strict=True)
    ]
    scaled = [
        DepthEstimate(one.depth * by, one.sigma * by, one.distribution)
        for one, by in zip(found, factors, strict=True)
    ]
    cases = simulated(views, lambda view: view.depth)
    exact = {"depth_sigma": SENSOR_SIGMA[0]}
    rows = [
        ["exact", "refine", "known", *measure(cases, camera_height=HEIGHT, **exact)],
        ["exact", "refine", "unknown", *measure(cases, **exact)],
    ]
    for title, depths in ((args.model, found), (f"{args.model}, scale of each frame right", scaled)):
        given = [replace(case, depth=depth) for case, depth in zip(cases, depths, strict=True)]
        rows.append([title, "refine", "known", *measure(given, camera_height=HEIGHT)])
        rows.append([title, "refine", "unknown", *measure(given)])
    rows.append(["none", "no_depth", "known", *measure(cases, method="no_depth", camera_height=HEIGHT)])
    show(rows, depth_ratios(views, found), args.halls)


def measure(cases: list[Case], **options) -> list[str]:
    """Return the objects, their median distance relative to the true one, and the center accuracy."""
    lifter, parts, distance = BoxLifter(**options), [], []
    for case in cases:
        boxes = lifter(case.depth, case.detections, case.camera)
        parts.append(compare(case.truth, boxes, case.rows, case.columns))
        near, true = boxes.center[case.columns], case.truth.center[case.rows]
        distance.append(np.linalg.norm(near, axis=1) / np.linalg.norm(true, axis=1))
    pairs = Pairs.join(parts)
    low, high = bootstrap(pairs.accuracy, pairs.frame)
    return [
        f"{len(pairs)}", f"{100 * (np.median(np.concatenate(distance)) - 1):+.1f}",
        f"{100 * pairs.accuracy.mean():.1f} [{100 * low:.1f}, {100 * high:.1f}]",
    ]  # fmt: skip


def depth_ratios(views: list[StreetView], found: list[DepthEstimate]) -> list[str]:
    """Return lines: the network's depth over the true one, on objects by distance, and of the floor."""
    true, ratio, floor = [], [], []
    for view, one in zip(views, found, strict=True):
        for number in range(len(view.boxes)):
            seen = view.instance == number
            true.append(np.median(view.depth[seen]))
            ratio.append(np.median(one.depth[seen]) / true[-1])
        plane = fit_ground(one.depth, view.camera)
        if plane is not None:
            floor.append(plane.offset / view.height)
    distance, share = np.array(true), np.array(ratio)
    parts = [
        f"{low:.0f}-{high:.0f} m: {np.median(share[chosen]):.2f} of {chosen.sum()}"
        for low, high in pairwise(DEPTHS)
        if (chosen := (distance >= low) & (distance < high)).any()
    ]
    low, middle, high = np.quantile(floor, (0.1, 0.5, 0.9))
    return [
        f"The network's depth over the true one, medians of objects by their distance: {'; '.join(parts)}; "
        f"all: {np.median(share):.2f}.",
        f"The camera's height above the floor that it shows, over the true one: median {middle:.2f}, 80 % "
        f"within {low:.2f} and {high:.2f} ({len(floor)} of {len(views)} halls show a floor).",
    ]


def show(rows: list[list[str]], lines: list[str], halls: int) -> None:
    titles = "depth", "method", "camera height", "objects", "distance [%]", "center accuracy [%]"
    text = [
        f"| {' | '.join(titles)} |", "|---|---|---|---:|---:|---:|",
        *(f"| {' | '.join(row)} |" for row in rows), "",
        *(f"- {line}" for line in lines), "",
        f"{halls} rendered test halls, objects as in results.md. Distance: median error, below 0: too near. "
        "Brackets: 95 % of 2000 resamples of whole frames. The network knows the camera's focal length and "
        "gives its sigma.",
        "",
        f"Made by `{' '.join(['python experiments/table4_centres/halls.py', *sys.argv[1:]])}`.",
    ]  # fmt: skip
    print("\n".join(text))


if __name__ == "__main__":
    main()

"""Rows and lines of table 4."""

import sys
from pathlib import Path

import numpy as np
from cases import Setting

from eldenet.boxes import Boxes3D
from eldenet.perception.kitti_ap import DIFFICULTIES, LOOSE, average_precision
from eldenet.perception.kitti_object import KittiLabels, to_labels
from eldenet.perception.lifter import DOUBTFUL_COST, METHODS, SENSOR_SIGMA
from eldenet.perception.matching_metrics import Pairs, bootstrap, by_distance, summary
from eldenet.results.run_record import environment

COLUMNS = (
    "depth", "2D boxes", "group", "method", "objects", "frames", "accuracy", "median_m", "bev_25", "bev_50",
    "3d_50", "yaw_deg", "ap_bev", "ap_3d", "ap_objects", "doubtful", "protocol", "resolution",
    "runtime", "threads", "device", "processor", "versions", "date", "command",
)  # fmt: skip
TITLES = (
    "depth, 2D boxes, objects", "method", "objects", "center accuracy [%]", "median [m]", "BEV > 0.25 [%]",
    "BEV > 0.5 [%]", "3D > 0.5 [%]", "yaw [deg]", "AP BEV / 3D (objects)", "doubtful",
)  # fmt: skip
#: KITTI's classes of each group. AP is a mean over those that have objects.
KINDS = {
    "all": ("Car", "Pedestrian", "Cyclist"),
    "people, cyclists": ("Pedestrian", "Cyclist"),
    "vehicles": ("Car",),
}
METHOD_NAMES = (*METHODS, "refine, height unknown")
RUNTIME = "boxes: numpy; depth networks: torch; detectors: ONNX Runtime"


def table_rows(
    setting: Setting, group: str, pairs: dict[str, Pairs], found: dict[str, list[Boxes3D]]
) -> list[list[str]]:
    """Return a row for each method, up to ``doubtful``; brackets hold 95 % of 2000 resamples of frames."""
    rows = []
    for method, part in pairs.items():
        if not len(part):
            continue
        figures = summary(part)
        cells = [f"{figures['pairs']:.0f}", f"{len(np.unique(part.frame))}"]
        for values in (part.accuracy, None, part.bev >= 0.25, part.bev >= 0.5, part.iou >= 0.5):
            if values is None:
                cells.append(f"{figures['median_error']:.2f}")
                continue
            low, high = bootstrap(np.asarray(values, float), part.frame)
            cells.append(f"{100 * np.mean(values):.1f} [{100 * low:.1f}, {100 * high:.1f}]")
        cells.append(f"{figures['median_yaw']:.1f}")
        flags = [b.doubtful[c.pairs_of(group)[1]] for b, c in zip(found[method], setting.cases, strict=True)]
        doubtful = f"{int(np.concatenate(flags).sum())} of {len(part)}"
        shown = precision(setting, group, found[method])
        rows.append([setting.depth, setting.boxes, group, method, *cells, *shown, doubtful])
    return rows


def precision(setting: Setting, group: str, found: list[Boxes3D]) -> list[str]:
    """Return KITTI's AP (R40, moderate, its loose overlaps) in BEV and 3D, and the objects that it counts."""
    truths = [case.labels for case in setting.cases]
    results = [
        to_labels(boxes, case.detections.xyxy) for boxes, case in zip(found, setting.cases, strict=True)
    ]
    counts = {kind: count(truths, kind) for kind in KINDS[group]}
    present = [kind for kind, number in counts.items() if number]
    cells = []
    for metric in ("bev", "3d"):
        values = [
            average_precision(truths, results, kind=kind, metric=metric, min_overlap=LOOSE[kind])["R40"]
            for kind in present
        ]
        cells.append(f"{np.mean(values):.1f}" if values else "-")
    return [*cells, f"{sum(counts.values())}"]


def count(truths: list[KittiLabels], kind: str) -> int:
    """Return the number of objects of a class that the moderate AP counts."""
    rules, number = DIFFICULTIES["moderate"], 0
    for labels in truths:
        tall = labels.xyxy[:, 3] - labels.xyxy[:, 1] > rules.height
        seen = (labels.occluded <= rules.occluded) & (labels.truncated <= rules.truncated)
        number += int((tall & seen & (np.array(labels.types, object) == kind)).sum())
    return number


def where(setting: Setting) -> list[str]:
    """Return the columns from ``protocol`` on: how the figures were made."""
    machine = environment()
    versions = {**machine["versions"], "python": machine["python"]}
    names = ("python", "numpy", "torch", "opencv-python-headless", "mujoco")
    held = ", ".join(f"{name} {versions[name]}" for name in names if versions.get(name))
    return [
        setting.protocol, setting.resolution, RUNTIME, "1", "cpu", machine["hardware"]["processor"], held,
        machine["date"][:10], command(),
    ]  # fmt: skip


def command() -> str:
    """Return the command of this run, without the machine's folders."""
    words = " ".join(Path(word).name if "/" in word else word for word in sys.argv[1:])
    return f"python experiments/table4_centres/run.py {words}"


def differences(setting: Setting, group: str, pairs: dict[str, Pairs]) -> list[str]:
    """Return lines with the differences of ``refine`` to the other methods, on the same objects."""
    lines = []
    if not len(pairs["refine"]):
        return lines
    for other in ("paper", "no_depth", "lshape"):
        parts = []
        for title, pick in (
            ("accuracy", lambda p: p.accuracy),
            ("BEV > 0.25", lambda p: (p.bev >= 0.25) * 1.0),
            ("BEV > 0.5", lambda p: (p.bev >= 0.5) * 1.0),
        ):
            gap = pick(pairs["refine"]) - pick(pairs[other])
            low, high = bootstrap(gap, pairs["refine"].frame)
            parts.append(f"{title} {100 * gap.mean():+.1f} [{100 * low:+.1f}, {100 * high:+.1f}]")
        title = f"{setting.depth}, {setting.boxes}, {group} ({len(gap)})"
        lines.append(f"- {title}: refine - {other}: {', '.join(parts)} points")
    return lines


def accuracy_by_distance(setting: Setting, group: str, pairs: dict[str, Pairs]) -> list[str]:
    """Return lines with center accuracy by distance, with and without depth."""
    lines = []
    for method in ("refine", "no_depth"):
        parts = [
            f"{low:.0f}-{high:.0f} m: {100 * figures['accuracy']:.1f} % of {figures['pairs']:.0f}"
            for low, high, figures in by_distance(pairs[method])
            if figures["pairs"]
        ]
        if parts:
            lines.append(f"- {setting.depth}, {setting.boxes}, {group}, {method}: {'; '.join(parts)}")
    return lines


def protocol_notes(frames: int, notes: list[str], example: Setting) -> list[str]:
    """Return lines that describe the protocol and the machine."""
    machine = dict(zip(COLUMNS[COLUMNS.index("protocol") :], where(example), strict=True))
    simulation = (
        f"Simulation: {frames} test scenes each, streets and crossings at 256 x 832, halls at 240 x 320; "
        "objects seen to 30 % or more, not cut by the border, 18 pixels high or more; tight boxes around "
        "what is seen."
    )
    return [
        "Center accuracy: mean of 1 - |c - c*| / |c*| over objects that the 2D boxes hold (IoU 0.5, one to "
        "one). BEV and 3D: share of those whose boxes overlap by more. Yaw: median error modulo 180 degrees. "
        "Brackets: 95 % of 2000 resamples of whole frames.",
        "",
        "AP: KITTI's (R40, moderate), the mean over the classes (all: Car, Pedestrian, Cyclist), at its "
        "looser overlaps (Car 0.5, others 0.25). Every object counts, whether or not a 2D box holds it. "
        "Below 40 objects of a class, some of the 40 recalls cannot be reached: AP stays low whatever the "
        "boxes. "
        "Simulated 2D boxes all have the score 1. Doubtful: flagged, for the cost of the fit is beyond "
        f"{DOUBTFUL_COST:g}.",
        "",
        "Depth errors are the lifter's defaults (defaults.md). The simulator's exact depth is dense, so "
        f"there depth_sigma={SENSOR_SIGMA[0]} is given. `refine, height unknown` is not told the camera's "
        "height; the other methods are told the nominal one.",
        "",
        *([simulation, ""] if frames else []),
        'KITTI: training frames at hand with a scan, or all with a network; objects not beyond "hard". '
        "Label boxes are projections of the 3D boxes, so they leak the answer. `no_depth` knows the class "
        "sizes and the nominal camera height.",
        "",
        *(f"- {note}." for note in notes),
        "- Milliseconds are processor time, the least of five calls, medians over up to ten pictures.",
        f"- {machine['runtime']}; {machine['threads']} thread, {machine['device']}, {machine['processor']}; "
        f"{machine['versions']}; {machine['date']}.",
        f"- Made by `{command()}`.",
    ]

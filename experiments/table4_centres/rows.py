"""Rows and lines of table 4."""

import sys
from pathlib import Path

import numpy as np
from cases import Setting

from eldenet.perception.matching_metrics import Pairs, bootstrap, by_distance, summary
from eldenet.results.run_record import environment

COLUMNS = (
    "depth", "2D boxes", "method", "objects", "frames", "accuracy", "median_m", "bev_25", "bev_50", "3d_50",
    "yaw_deg", "protocol", "resolution", "runtime", "threads", "device", "processor", "versions", "date",
    "command",
)  # fmt: skip
TITLES = (
    "depth, 2D boxes", "method", "objects", "center accuracy [%]", "median [m]", "BEV > 0.25 [%]",
    "BEV > 0.5 [%]", "3D > 0.5 [%]", "yaw [deg]",
)  # fmt: skip
RUNTIME = "boxes: numpy; depth networks: torch; YOLOX: ONNX Runtime"


def table_rows(setting: Setting, pairs: dict[str, Pairs]) -> list[list[str]]:
    """Return a row for each method, up to ``yaw_deg``; brackets hold 95 % of 2000 resamples of frames."""
    rows = []
    for method, part in pairs.items():
        figures = summary(part)
        cells = [f"{figures['pairs']:.0f}", f"{len(np.unique(part.frame))}"]
        for values in (part.accuracy, None, part.bev >= 0.25, part.bev >= 0.5, part.iou >= 0.5):
            if values is None:
                cells.append(f"{figures['median_error']:.2f}")
                continue
            low, high = bootstrap(np.asarray(values, float), part.frame)
            cells.append(f"{100 * np.mean(values):.1f} [{100 * low:.1f}, {100 * high:.1f}]")
        rows.append([setting.depth, setting.boxes, method, *cells, f"{figures['median_yaw']:.1f}"])
    return rows


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


def differences(setting: Setting, pairs: dict[str, Pairs]) -> list[str]:
    """Return lines with the differences of ``refine`` to the other methods, on the same objects."""
    lines = []
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
        lines.append(f"- {setting.depth}, {setting.boxes}: refine - {other}: {', '.join(parts)} points")
    return lines


def accuracy_by_distance(setting: Setting, pairs: dict[str, Pairs]) -> list[str]:
    """Return lines with center accuracy by distance, with and without depth."""
    lines = []
    for method in ("refine", "no_depth"):
        parts = [
            f"{low:.0f}-{high:.0f} m: {100 * figures['accuracy']:.1f} % of {figures['pairs']:.0f}"
            for low, high, figures in by_distance(pairs[method])
            if figures["pairs"]
        ]
        lines.append(f"- {setting.depth}, {setting.boxes}, {method}: {'; '.join(parts)}")
    return lines


def protocol_notes(frames: int, notes: list[str], example: Setting) -> list[str]:
    """Return lines that describe the protocol and the machine."""
    machine = dict(zip(COLUMNS[11:], where(example), strict=True))
    return [
        "Center accuracy: mean of 1 - |c - c*| / |c*| over objects that the 2D boxes hold (IoU 0.5, one to "
        "one). BEV and 3D: share of those whose boxes overlap by more. Yaw: median error modulo 180 degrees. "
        "Brackets: 95 % of 2000 resamples of whole frames.",
        "",
        f"Simulation: {frames} test scenes each, streets at 256 x 832, halls at 240 x 320; objects seen to "
        "30 % or more, not cut by the border, 18 pixels high or more; tight boxes around what is seen.",
        "",
        'KITTI: training frames at hand with a scan, or all with a network; Car and Van, not beyond "hard". '
        "Label boxes are projections of the 3D boxes, so they leak the answer. `no_depth` knows the class "
        "sizes and the nominal camera height.",
        "",
        *(f"- {note}." for note in notes),
        "- Milliseconds are processor time, the least of five calls, medians over up to ten pictures.",
        f"- {machine['runtime']}; {machine['threads']} thread, {machine['device']}, {machine['processor']}; "
        f"{machine['versions']}; {machine['date']}.",
        f"- Made by `{command()}`.",
    ]

"""Tracking on rendered drives: identity switches, MOTA and HOTA at several errors of the depth.

pip install -e '.[tracking]'
python experiments/tracking/run.py

The same detections go to SORT (2D boxes alone) as published and as tuned, to our tracker without 2D boxes
(distances from above alone) and with them, all with the same ``min_hits`` and ``max_age``. TrackEval scores
the 2D boxes, IoU 0.5.
Settings were chosen on ``--split train``, SORT's by ``tune_sort.py``.
"""

import argparse
import contextlib
import io
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drives import SECONDS, SIZE, Frame, camera, drive, measured
from sort import TUNED, Sort

from eldenet.boxes import Boxes3D
from eldenet.perception.iou import iou_2d
from eldenet.perception.lifter import SENSOR_SIGMA, BoxLifter
from eldenet.perception.tracking import BoxTracker
from eldenet.results.plots import save_figure
from eldenet.system.files import read_table, write_rows, write_text

with contextlib.redirect_stdout(io.StringIO()):  # it names the parts that need more packages
    from trackeval.metrics import CLEAR, HOTA

HERE = Path(__file__).parent
ERRORS = (0.0, 0.03, 0.06, 0.12)
TRACKERS = ("SORT", "SORT, tuned", "distance alone", "distance and 2D box")
MIN_HITS, MAX_AGE = 2, 5
FIRST = {"train": 50000, "test": 0}
COLUMNS = (
    "depth_error", "tracker", "switches", "MOTA", "HOTA", "AssA", "fragments", "objects", "boxes", "drives",
    "frames", "split", "command",
)  # fmt: skip

Numbered = list[np.ndarray]  # per frame: (N,) number of each detection's track, 0 for none


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--drives", type=int, default=16)
    options.add_argument("--frames", type=int, default=50, help="of a drive")
    options.add_argument("--split", choices=("train", "test"), default="test")
    options.add_argument("--output", type=Path, default=HERE / "results", help="without an ending")
    args = options.parse_args()
    parts: dict[tuple[float, str], list[tuple[dict, dict]]] = {}
    for number in range(args.drives):
        frames = list(drive(args.split, FIRST[args.split] + number, args.frames))
        flat = {
            "SORT": score(frames, by_sort(frames)),
            "SORT, tuned": score(frames, by_sort(frames, **TUNED)),
        }
        for error in ERRORS:
            lifted = lift(frames, error)
            for name, scored in flat.items():
                parts.setdefault((error, name), []).append(scored)
            for name in TRACKERS[2:]:
                numbered = by_boxes(frames, lifted, flat=name != TRACKERS[2])
                parts.setdefault((error, name), []).append(score(frames, numbered))
        write(parts, args)
        print(f"{number + 1} of {args.drives} drives", flush=True)
    draw(args.output.with_suffix(".csv"), args.output.with_suffix(".png"))


def by_sort(frames: list[Frame], **settings: float) -> Numbered:
    tracker = Sort(MIN_HITS, MAX_AGE, **settings)
    return [tracker(frame.detections.xyxy, frame.detections.label) for frame in frames]


def lift(frames: list[Frame], error: float) -> list[Boxes3D]:
    """Return the 3D boxes of each frame, each with the row of its detection."""
    sigma = max(error, SENSOR_SIGMA[0])
    lifter, lens = BoxLifter(camera_height=1.65, depth_sigma=sigma), camera()
    lifted = [lifter(measured(frame, error), frame.detections, lens) for frame in frames]
    return [replace(b, quality={**b.quality, "row": np.arange(len(b), dtype=float)}) for b in lifted]


def by_boxes(frames: list[Frame], lifted: list[Boxes3D], *, flat: bool) -> Numbered:
    tracker = BoxTracker(min_hits=MIN_HITS, max_age=MAX_AGE)
    numbered = []
    for frame, boxes in zip(frames, lifted, strict=True):
        out = tracker(boxes, SECONDS, frame.detections.xyxy if flat else None)
        numbers = np.zeros(len(boxes), int)
        if len(out):
            numbers[out.quality["row"].astype(int)] = out.track_id
        numbered.append(numbers)
    return numbered


def score(frames: list[Frame], numbered: Numbered) -> tuple[dict, dict]:
    """Return TrackEval's CLEAR and HOTA figures of one drive."""
    truth, found, similar = [], [], []
    true_ids = {int(n): i for i, n in enumerate(np.unique(np.concatenate([f.numbers for f in frames])))}
    ids = np.unique(np.concatenate(numbered))
    found_ids = {int(n): i for i, n in enumerate(ids[ids > 0])}
    for frame, numbers in zip(frames, numbered, strict=True):
        shown = numbers > 0
        truth.append(np.array([true_ids[int(n)] for n in frame.numbers], int))
        found.append(np.array([found_ids[int(n)] for n in numbers[shown]], int))
        similar.append(iou_2d(frame.xyxy, frame.detections.xyxy[shown]))
    data = {
        "num_timesteps": len(frames), "gt_ids": truth, "tracker_ids": found, "similarity_scores": similar,
        "num_gt_ids": len(true_ids), "num_tracker_ids": len(found_ids),
        "num_gt_dets": sum(map(len, truth)), "num_tracker_dets": sum(map(len, found)),
    }  # fmt: skip
    with contextlib.redirect_stdout(io.StringIO()):
        clear, hota = CLEAR({"PRINT_CONFIG": False}), HOTA()
        return {
            **clear.eval_sequence(data),
            "ids": len(true_ids),
            "boxes": data["num_gt_dets"],
        }, hota.eval_sequence(data)


def together(scored: list[tuple[dict, dict]]) -> tuple[int, str, str, str, int]:
    """Return switches, MOTA, HOTA, AssA [%] and fragments over drives."""
    clear, hota = (
        metric.combine_sequences(dict(enumerate(parts)))
        for metric, parts in (
            (CLEAR({"PRINT_CONFIG": False}), [part for part, _ in scored]),
            (HOTA(), [part for _, part in scored]),
        )
    )
    mota, hota_mean, assa = (100 * np.mean(x) for x in (clear["MOTA"], hota["HOTA"], hota["AssA"]))
    return int(clear["IDSW"]), f"{mota:.1f}", f"{hota_mean:.1f}", f"{assa:.1f}", int(clear["Frag"])


def write(parts: dict[tuple[float, str], list[tuple[dict, dict]]], args: argparse.Namespace) -> None:
    """Write the figures over the drives so far."""
    command = " ".join(["python experiments/tracking/run.py", *sys.argv[1:]])
    rows = []
    for (error, name), scored in parts.items():
        figures = together(scored)
        rows.append([
            error, name, *figures, sum(part["ids"] for part, _ in scored),
            sum(part["boxes"] for part, _ in scored), len(scored), args.frames, args.split, command,
        ])  # fmt: skip
    rows.sort(key=lambda row: (row[0], TRACKERS.index(row[1])))
    write_rows(args.output.with_suffix(".csv"), COLUMNS, rows)
    titles = "depth error", "tracker", "identity switches", "MOTA [%]", "HOTA [%]", "AssA [%]", "fragments"
    first = rows[0]
    text = [
        f"| {' | '.join(titles)} |", "|---:|---|" + "---:|" * 5,
        *(f"| {row[0]:.0%} | {' | '.join(map(str, row[1:7]))} |" for row in rows), "",
        f"{first[9]} rendered {args.split} drives of {args.frames} frames at {1 / SECONDS:.0f} per second, "
        f"{SIZE[0]} x {SIZE[1]}: {first[7]} objects, {first[8]} boxes of them. TrackEval, 2D IoU 0.5.", "",
        f"Made by `{command}`.",
    ]  # fmt: skip
    write_text(args.output.with_suffix(".md"), "\n".join(text) + "\n")


def draw(table: Path, picture: Path) -> None:
    """Plot switches and HOTA over the error of the depth."""
    lines = read_table(table, COLUMNS)
    figure, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
    for axis, column, title in ((axes[0], "switches", "identity switches"), (axes[1], "HOTA", "HOTA [%]")):
        for name in TRACKERS:
            mine = [line for line in lines if line["tracker"] == name]
            part = [(100 * float(line["depth_error"]), float(line[column])) for line in mine]
            axis.plot(*zip(*part, strict=True), marker="o", label=name)
        axis.set(xlabel="error of objects' depth [%]", ylabel=title)
    axes[0].set_ylim(bottom=0)
    axes[0].legend()
    save_figure(figure, picture)


if __name__ == "__main__":
    main()

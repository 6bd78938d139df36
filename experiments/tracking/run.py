"""Tracking on rendered drives: identity switches, MOTA and HOTA at several errors of the depth.

pip install -e '.[tracking]'
python experiments/tracking/run.py --drives 20

The same detections go to SORT (2D boxes alone) as published and as tuned, to our tracker without 2D boxes
(distances from above alone) and with them, all with the same ``min_hits`` and ``max_age``. TrackEval scores
the 2D boxes, IoU 0.5.
Intervals draw whole drives; differences are to SORT as tuned, on the same drives.
Settings were chosen on ``--split train``, SORT's by ``tune_sort.py``.
"""

import argparse
import contextlib
import io
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drives import SECONDS, SIZE, Frame, camera, drive, measured
from sort import TUNED, Sort

from eldenet.boxes import Boxes3D
from eldenet.evaluation.bootstrap import bootstrap_interval
from eldenet.perception.iou import iou_2d
from eldenet.perception.lifter import SENSOR_SIGMA, BoxLifter
from eldenet.perception.tracking import BoxTracker
from eldenet.results.plots import save_figure
from eldenet.system.files import read_table, write_rows, write_text

with contextlib.redirect_stdout(io.StringIO()):  # it names the parts that need more packages
    from trackeval.metrics import CLEAR, HOTA

HERE = Path(__file__).parent
ERRORS = (0.0, 0.03, 0.06, 0.12)
RIVAL = "SORT, tuned"
TRACKERS = ("SORT", RIVAL, "distance alone", "distance and 2D box")
MIN_HITS, MAX_AGE = 2, 5
FIRST = {"train": 50000, "test": 0}
COLUMNS = (
    "depth_error", "tracker", "switches", "MOTA", "HOTA", "AssA", "fragments", "HOTA_interval",
    "switches_gap", "HOTA_gap", "objects", "boxes", "drives", "frames", "split", "command",
)  # fmt: skip

Scored = tuple[dict, dict]  # TrackEval's CLEAR and HOTA figures of one drive
Numbered = list[np.ndarray]  # per frame: (N,) number of each detection's track, 0 for none


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--drives", type=int, default=16)
    options.add_argument("--frames", type=int, default=50, help="of a drive")
    options.add_argument("--split", choices=("train", "test"), default="test")
    options.add_argument("--output", type=Path, default=HERE / "results", help="without an ending")
    args = options.parse_args()
    parts: dict[tuple[float, str], list[Scored]] = {}
    for number in range(args.drives):
        frames = list(drive(args.split, FIRST[args.split] + number, args.frames))
        flat = {
            "SORT": score(frames, by_sort(frames)),
            RIVAL: score(frames, by_sort(frames, **TUNED)),
        }
        for error in ERRORS:
            lifted = lift(frames, error)
            for name, scored in flat.items():
                parts.setdefault((error, name), []).append(scored)
            for name in TRACKERS[2:]:
                numbered = by_boxes(frames, lifted, flat=name != TRACKERS[2])
                parts.setdefault((error, name), []).append(score(frames, numbered))
        print(f"{number + 1} of {args.drives} drives", flush=True)
    write(parts, args)
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


def score(frames: list[Frame], numbered: Numbered) -> Scored:
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


def together(scored: list[Scored]) -> tuple[int, str, str, str, int]:
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


def switches(scored: list[Scored]) -> float:
    return float(sum(clear["IDSW"] for clear, _ in scored))


def hota(scored: list[Scored]) -> float:
    return float(100 * np.mean(HOTA().combine_sequences(dict(enumerate(part for _, part in scored)))["HOTA"]))


def over_drives(figure: Callable[[list[Scored]], float], *sides: list[Scored]) -> tuple[float, float, float]:
    """Return a figure, or its difference between two sides on the same drives, with its 95 % interval."""

    def value(drawn: np.ndarray) -> float:
        first, *others = (figure([side[one] for one in drawn]) for side in sides)
        return first - sum(others)

    count = len(sides[0])
    return value(np.arange(count)), *bootstrap_interval(value, count)


def write(parts: dict[tuple[float, str], list[Scored]], args: argparse.Namespace) -> None:
    """Write the figures over all drives."""
    command = " ".join(["python experiments/tracking/run.py", *sys.argv[1:]])
    rows, lines = [], []
    for (error, name), scored in sorted(
        parts.items(), key=lambda one: (one[0][0], TRACKERS.index(one[0][1]))
    ):
        figures = together(scored)
        _, low, high = over_drives(hota, scored)
        span, gaps = f"[{low:.1f}, {high:.1f}]", ["", ""]
        if name != RIVAL:
            rival = parts[error, RIVAL]
            gaps = ["{:+.0f} [{:+.0f}, {:+.0f}]".format(*over_drives(switches, scored, rival)),
                    "{:+.1f} [{:+.1f}, {:+.1f}]".format(*over_drives(hota, scored, rival))]  # fmt: skip
        rows.append([
            error, name, *figures, span, *gaps, sum(part["ids"] for part, _ in scored),
            sum(part["boxes"] for part, _ in scored), len(scored), args.frames, args.split, command,
        ])  # fmt: skip
        cells = [name, *figures[:2], f"{figures[2]} {span}", *figures[3:], *gaps]
        lines.append(f"| {error:.0%} | {' | '.join(map(str, cells))} |")
    write_rows(args.output.with_suffix(".csv"), COLUMNS, rows)
    titles = (
        "depth error", "tracker", "identity switches", "MOTA [%]", "HOTA [%]", "AssA [%]", "fragments",
        f"switches - {RIVAL}", f"HOTA - {RIVAL}",
    )  # fmt: skip
    first = dict(zip(COLUMNS, rows[0], strict=True))
    text = [
        f"| {' | '.join(titles)} |", "|---:|---|" + "---:|" * (len(titles) - 2), *lines, "",
        f"{first['drives']} rendered {args.split} drives of {args.frames} frames at {1 / SECONDS:.0f} per "
        f"second, {SIZE[0]} x {SIZE[1]}: {first['objects']} objects, {first['boxes']} boxes of them. "
        "TrackEval, 2D IoU 0.5. Differences are on the same drives. Brackets: 95 % of 2000 resamples of "
        "whole drives.", "",
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

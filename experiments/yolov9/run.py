"""Average precision of detectors on KITTI's labeled frames and on rendered test streets.

python experiments/yolov9/run.py runs/yolov9_streets.onnx yolox_nano_coco_256x832.onnx

Nothing is tuned on these frames; KITTI's were scored once. Needs ELDENET_DATA.
"""

import argparse
import hashlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.perception.detectors import merge_cyclists
from eldenet.perception.iou import iou_2d
from eldenet.perception.kitti_object import KittiObjects
from eldenet.perception.onnx_detector import OnnxDetector
from eldenet.results.run_record import environment
from eldenet.simulation.street_views import render_street
from eldenet.system.files import write_rows

HERE = Path(__file__).parent
SIZE = (256, 832)  # of rendered frames [px]
OVERLAP = 0.5
THRESHOLD = 0.3  # of detections that table 4 takes
KITTI_HEIGHT, RENDERED_HEIGHT = 25, 18  # least heights of objects that count, as in table 4 [px]
LEAST_VISIBLE = 0.25  # share of a rendered object
LEAST_SCORE = 0.01  # of those that count for average precision
#: Names of one group count as one class: detectors and labels divide vehicles differently.
GROUPS = {
    "vehicles": ("car", "van", "truck", "bus"),
    "people": ("person", "pedestrian"),
    "cyclists": ("cyclist",),
}
IGNORED = {"people": ("person_sitting",)}  # neither found nor missed
COLUMNS = ("frames", "detector", "sha256", "objects", "count", "ap50", "low", "high", "found", "false")


class Frame(NamedTuple):
    """One image and its labeled objects.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        xyxy: ``(N, 4)`` [px].
        names: ``(N,)`` of the classes, in small letters; "dontcare" for areas without labels.
        counts: ``(N,)`` bool; the others are neither found nor missed.
        least: height from which objects count, and detections that match none [px].
    """

    image: np.ndarray
    xyxy: np.ndarray
    names: np.ndarray
    counts: np.ndarray
    least: float


class Matches(NamedTuple):
    """The detections of one group in one frame, by falling score, without the ignored ones.

    Attributes:
        score: ``(D,)``.
        right: ``(D,)`` bool.
        objects: number of those to find.
    """

    score: np.ndarray
    right: np.ndarray
    objects: int


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("detectors", nargs="+", type=Path, help=".onnx files")
    parser.add_argument("--streets", type=int, default=25, help="rendered test scenes of each kind")
    args = parser.parse_args(arguments)
    frames = {"KITTI": list(kitti())}
    if args.streets:
        frames["rendered"] = list(rendered(args.streets))
    rows = []
    for path in args.detectors:
        detector = OnnxDetector(path, threshold=LEAST_SCORE)
        code = hashlib.sha256(path.read_bytes()).hexdigest()[:8]
        for title, labeled in frames.items():
            found = [merge_cyclists(detector(frame.image)) for frame in labeled]
            for group in GROUPS:
                parts = [match(*pair, group) for pair in zip(labeled, found, strict=True)]
                rows.append([f"{title} ({len(parts)})", path.stem, code, group, *figures(parts)])
                print(*rows[-1], flush=True)
    write(folder, rows)


def kitti() -> Iterator[Frame]:
    """Yield KITTI's frames; objects up to its "hard" count, as in table 4."""
    data = KittiObjects()
    for name in data.names:
        labels = data.labels(name)
        tall = labels.xyxy[:, 3] - labels.xyxy[:, 1]
        counts = (tall > KITTI_HEIGHT) & (labels.occluded <= 2) & (labels.truncated <= 0.5)
        names = np.array([kind.lower() for kind in labels.types], object)
        yield Frame(data.image(name), labels.xyxy, names, counts, KITTI_HEIGHT)


def rendered(count: int) -> Iterator[Frame]:
    """Yield rendered streets and crossings; objects that are seen to 25 % or more count."""
    for kind in ("street", "crossing"):
        for index in range(count):
            view = render_street("test", index, SIZE, kind)
            xyxy = view.detections.xyxy
            counts = (xyxy[:, 3] - xyxy[:, 1] >= RENDERED_HEIGHT) & (view.visible >= LEAST_VISIBLE)
            yield Frame(view.image, xyxy, np.array(view.detections.classes, object), counts, RENDERED_HEIGHT)


def match(frame: Frame, found: Detections2D, group: str) -> Matches:
    """Match detections of a group by falling score, each to the free object that it overlaps most.

    Those on objects that do not count, too small ones, and those mostly in areas without labels are left out.
    """
    found = found.select(np.isin(found.classes, GROUPS[group]))
    found = found.select(np.argsort(-found.score, kind="stable"))
    wanted = np.isin(frame.names, GROUPS[group])
    others = (wanted & ~frame.counts) | np.isin(frame.names, IGNORED.get(group, ()))
    overlap, ignored = (iou_2d(found.xyxy, frame.xyxy[rows]) for rows in (wanted & frame.counts, others))
    unknown = iou_2d(found.xyxy, frame.xyxy[frame.names == "dontcare"], of_first=True)
    elsewhere = np.maximum(ignored.max(1, initial=0.0), unknown.max(1, initial=0.0)) >= OVERLAP
    elsewhere |= found.xyxy[:, 3] - found.xyxy[:, 1] < frame.least
    free = np.ones(overlap.shape[1], bool)
    score, right = [], []
    for row in range(len(found)):
        fits = np.where(free, overlap[row], 0.0)
        hit = fits.max(initial=0.0) >= OVERLAP
        if hit:
            free[int(fits.argmax())] = False
        elif elsewhere[row]:
            continue
        score.append(found.score[row])
        right.append(hit)
    return Matches(np.array(score), np.array(right, bool), len(free))


def figures(parts: Sequence[Matches]) -> list[str]:
    """Return objects, AP50 with 95 % of 2000 resamples of frames, and what is found at ``THRESHOLD``."""
    draw = np.random.default_rng(0)
    drawn = [[parts[k] for k in draw.integers(len(parts), size=len(parts))] for _ in range(2000)]
    low, high = np.nanpercentile([average_precision(some) for some in drawn], [2.5, 97.5])
    right = sum(int(part.right[part.score >= THRESHOLD].sum()) for part in parts)
    wrong = sum(int((~part.right[part.score >= THRESHOLD]).sum()) for part in parts)
    objects = sum(part.objects for part in parts)
    return [f"{objects}", *(f"{value:.1f}" for value in (average_precision(parts), low, high)), f"{right}",
            f"{wrong}"]  # fmt: skip


def average_precision(parts: Sequence[Matches]) -> float:
    """Area under precision over recall [%], precision made to fall; NaN without objects."""
    objects = sum(part.objects for part in parts)
    if not objects:
        return float("nan")
    order = np.argsort(-np.concatenate([part.score for part in parts]), kind="stable")
    right = np.concatenate([part.right for part in parts])[order]
    if not len(right):
        return 0.0
    precision = np.cumsum(right) / np.arange(1, len(right) + 1)
    precision = np.maximum.accumulate(precision[::-1])[::-1]
    return 100 * float(precision[right].sum() / objects)


def write(folder: Path, rows: Sequence[Sequence[str]]) -> None:
    """Write ``figures.csv`` and the table to ``results.md``."""
    write_rows(folder / "figures.csv", COLUMNS, rows)
    lines = [
        f"| {frames} | `{name}` | {group} | {count} | {ap} [{low}, {high}] | {found} | {false} |"
        for frames, name, _, group, count, ap, low, high, found, false in rows
    ]
    text = [
        "# 2D boxes: average precision of detectors",
        "",
        "| frames (count) | detector | objects | count | AP50 [%] | found | false |",
        "|---|---|---|---:|---:|---:|---:|",
        *lines,
        "",
        "AP50: area under precision over recall (all points) at IoU 0.5, from a score of "
        f"{LEAST_SCORE}; brackets: 95 % of 2000 resamples of whole frames. Found, false: right and wrong "
        f"detections from a score of {THRESHOLD}, which table 4 takes. Vehicles: car, van, truck, bus as one "
        'class. KITTI: objects up to "hard"; smaller ones and detections, sitting people and DontCare areas '
        "are neither found nor "
        f"missed. Rendered: test streets and crossings, objects of {RENDERED_HEIGHT} px or more, seen to "
        f"{100 * LEAST_VISIBLE:.0f} % or more.",
        "",
        f"{environment()['date'][:10]}. `figures.csv` has the first digits of "
        "each file's SHA-256. Made by `python experiments/yolov9/run.py "
        "runs/yolov9_streets.onnx yolox_nano_coco_256x832.onnx`.",
    ]
    (folder / "results.md").write_text("\n".join(text) + "\n")


if __name__ == "__main__":
    main()

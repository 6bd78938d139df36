"""Centre accuracy and match rates of the four methods: simulated streets and halls, KITTI's object frames.

python experiments/table4_centres/run.py --frames 60 --sim-model runs/streets-depth/model \
    --detector yolox_nano_coco_256x832.onnx --kitti-model meter_kitti --kitti-sigma 0.12

Everything was tuned on simulated training scenes; this script uses test scenes, and KITTI's frames only
report. KITTI's rows need ELDENET_DATA (docs/boxes.md) and a detector; its pictures stay in the run folder.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import eldenet
from eldenet.boxes import Boxes3D, Detections2D
from eldenet.geometry import PinholeCamera
from eldenet.perception.detectors import ROAD_NAMES, merge_cyclists
from eldenet.perception.drawing import draw_bev, draw_boxes, picture_beside_bev
from eldenet.perception.kitti_object import KittiObjects
from eldenet.perception.lifter import LARGE, METHODS, SMALL, BoxLifter
from eldenet.perception.onnx_detector import OnnxDetector
from eldenet.perception.scores import Pairs, bootstrap, by_distance, compare, pair_up, summary
from eldenet.pictures import write_picture
from eldenet.predictor import DepthPredictor
from eldenet.record import environment, write_rows
from eldenet.simulation.street_views import StreetView, render_street

HERE = Path(__file__).parent
SIZES = {"street": (256, 832), "hall": (240, 320)}
HEIGHTS = {"street": 1.65, "hall": 1.0}  # of the camera above the ground [m], as a user would know it
LEAST_HEIGHT = {"street": 17, "hall": 17}  # [px]: KITTI's 25 at its own size
EXACT_SIGMA = 0.02  # of exact and LiDAR depth
COLUMNS = (
    "depth",
    "2D boxes",
    "method",
    "objects",
    "accuracy",
    "median_m",
    "bev_25",
    "bev_50",
    "3d_50",
    "yaw_deg",
)
TITLES = (
    "depth, 2D boxes", "method", "objects", "centre accuracy [%]", "median [m]", "BEV > 0.25 [%]",
    "BEV > 0.5 [%]", "3D > 0.5 [%]", "yaw [deg]",
)  # fmt: skip


@dataclass
class Case:
    """One frame with all that a method needs, and the truth."""

    name: str
    image: np.ndarray
    depth: np.ndarray
    detections: Detections2D
    camera: PinholeCamera
    truth: Boxes3D
    rows: np.ndarray  # pairs: truth[rows] was found as detections[columns]
    columns: np.ndarray


def simulated(views: list[StreetView], kind: str, depth_of: Callable[[StreetView], np.ndarray]) -> list[Case]:
    """Objects of which three tenths or more are seen, whole in the picture, and not tiny."""
    cases = []
    for number, view in enumerate(views):
        tall = view.detections.xyxy[:, 3] - view.detections.xyxy[:, 1]
        kept = np.nonzero((view.visible >= 0.3) & ~view.truncated & (tall >= LEAST_HEIGHT[kind]))[0]
        depth = depth_of(view)
        cases.append(
            Case(f"{number}", view.image, depth, view.detections, view.camera, view.boxes, kept, kept)
        )
    return cases


def real(kitti: KittiObjects, detector: OnnxDetector | None, depth_of: Callable) -> Iterator[Case]:
    """Cars and vans not beyond KITTI's "hard"; detections of the detector, or the labels' own."""
    for name in kitti.names:
        image = kitti.image(name)
        depth = depth_of(name, image)
        if depth is None:
            continue
        labels = kitti.labels(name)
        labels = labels.select(np.array([kind != "DontCare" for kind in labels.types]))
        found = labels.detections if detector is None else merge_cyclists(detector(image))
        rows, columns = pair_up(labels.xyxy, found.xyxy)
        tall = labels.xyxy[:, 3] - labels.xyxy[:, 1]
        counts = (tall > 25) & (labels.occluded <= 2) & (labels.truncated <= 0.5)
        counts &= np.isin(np.array(labels.types), ("Car", "Van"))
        kept = counts[rows] if len(rows) else np.zeros(0, bool)
        yield Case(name, image, depth, found, kitti.camera(name), labels.boxes, rows[kept], columns[kept])


def run_methods(
    cases: list[Case], height: float, sigma: tuple[float, float]
) -> tuple[dict[str, Pairs], dict[str, list[Boxes3D]], float]:
    """Pairs and boxes of each method, and the processor time of ``refine`` per object [ms]."""
    pairs, boxes, spent, objects = {}, {}, 0.0, 0
    for method in METHODS:
        lifter = BoxLifter(method, camera_height=height, depth_sigma=sigma[0], small_sigma=sigma[1])
        lifted = []
        for case in cases:
            start = time.process_time()
            lifted.append(lifter(case.depth, case.detections, case.camera))
            if method == "refine":
                spent, objects = spent + time.process_time() - start, objects + len(case.detections)
        parts = [
            compare(case.truth, found, case.rows, case.columns)
            for case, found in zip(cases, lifted, strict=True)
        ]
        pairs[method], boxes[method] = Pairs.join(parts), lifted
    return pairs, boxes, 1000 * spent / max(objects, 1)


def table_rows(depth: str, boxes: str, pairs: dict[str, Pairs]) -> list[list[str]]:
    """One row a method; brackets hold 95 % of 2000 resamples of frames."""
    rows = []
    for method, part in pairs.items():
        figures = summary(part)
        cells = [f"{figures['truths' if not len(part) else 'pairs']:.0f}"]
        for values in (part.accuracy, None, part.bev >= 0.25, part.bev >= 0.5, part.iou >= 0.5):
            if values is None:
                cells.append(f"{figures['median_error']:.2f}")
                continue
            low, high = bootstrap(np.asarray(values, float), part.frame)
            cells.append(f"{100 * np.mean(values):.1f} [{100 * low:.1f}, {100 * high:.1f}]")
        rows.append([depth, boxes, method, *cells, f"{figures['median_yaw']:.1f}"])
    return rows


def differences(name: str, pairs: dict[str, Pairs]) -> list[str]:
    """Lines "refine minus another", on the same objects."""
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
        lines.append(f"- {name}: refine - {other}: {', '.join(parts)} points")
    return lines


def relative_error(views: list[StreetView], predictor: DepthPredictor) -> tuple[float, float]:
    """Relative depth errors of large and of small objects: ``depth_sigma`` and ``small_sigma``.

    A power law through the medians of the smaller and the larger half.
    """
    errors, sides = [], []
    for view in views:
        predicted = predictor(view.image)
        for number in range(len(view.boxes)):
            mine = (view.instance == number) & (view.depth > 0)
            if mine.sum() >= 100:
                errors.append(abs(np.log(np.median(predicted[mine]) / np.median(view.depth[mine]))))
                box = view.detections.xyxy[number]
                sides.append(np.log(min(box[2] - box[0], box[3] - box[1]) + 1))
    larger = np.array(sides) > np.median(sides)
    halves = [
        (np.median(np.array(sides)[half]), np.median(np.array(errors)[half])) for half in (~larger, larger)
    ]
    (small, wrong), (large, right) = halves
    slope = min(0.0, np.log(right / wrong) / (large - small))
    sigma = [1.4826 * wrong * np.exp(slope * (np.log(side) - small)) for side in (LARGE, SMALL)]
    return float(np.clip(sigma[0], EXACT_SIGMA, 0.5)), float(np.clip(sigma[1], EXACT_SIGMA, 0.5))


def draw(folder: Path, cases: list[Case], boxes: list[Boxes3D]) -> None:
    """Pictures of a setting: boxes in the photo, and from above with the truth in grey."""
    for case, found in zip(cases, boxes, strict=True):
        drawn = draw_boxes(case.image, found, case.camera)
        tall = max(300, case.image.shape[0])
        panel = draw_bev(found, case.camera, case.image.shape[1], size=(tall, tall), truth=case.truth)
        write_picture(folder / f"{case.name}.png", picture_beside_bev(drawn, panel))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--frames", type=int, default=60, help="test scenes of each kind")
    options.add_argument("--sim-model", help="folder of a network trained on rendered streets")
    options.add_argument("--hall-model", help="folder of a network trained on rendered halls")
    options.add_argument("--kitti-model", help="folder of a network for KITTI's pictures")
    options.add_argument("--kitti-sigma", type=float, default=0.12, help="its relative error on objects")
    options.add_argument("--detector", help="an .onnx file, for KITTI")
    options.add_argument("--run-folder", type=Path, default=Path("runs/table4_centres"))
    options.add_argument("--output", type=Path, default=HERE / "results", help="without an ending")
    chosen = options.parse_args()
    settings: list[tuple[str, str, list[Case], float, tuple[float, float]]] = []
    notes = []
    for kind in SIZES:
        views = [render_street("test", index, SIZES[kind], kind) for index in range(chosen.frames)]
        settings.append(
            (
                f"{kind}: exact",
                "simulator",
                simulated(views, kind, lambda v: v.depth),
                HEIGHTS[kind],
                (EXACT_SIGMA, EXACT_SIGMA),
            )
        )
        model = chosen.sim_model if kind == "street" else chosen.hall_model
        if model:
            predictor = DepthPredictor(eldenet.load(model))
            training = [render_street("train", 10000 + index, SIZES[kind], kind) for index in range(40)]
            sigma = relative_error(training, predictor)
            notes.append(
                f"{kind}: depth_sigma and small_sigma of {Path(model).name} measured on 40 training scenes: "
                f"{sigma[0]:.3f} and {sigma[1]:.3f}"
            )
            cases = simulated(views, kind, lambda v, p=predictor: p(v.image))
            settings.append((f"{kind}: ELDE-Net", "simulator", cases, HEIGHTS[kind], sigma))
    try:
        kitti = KittiObjects()
    except FileNotFoundError as error:
        print(f"KITTI is left out: {error}")
        kitti = None
    if kitti is not None:
        depths: dict[str, tuple[Callable, float]] = {
            "KITTI: LiDAR": (lambda name, image: kitti.lidar_depth(name, image.shape[:2]), EXACT_SIGMA)
        }
        if chosen.kitti_model:
            network = DepthPredictor(eldenet.load(chosen.kitti_model))
            depths[f"KITTI: {Path(chosen.kitti_model).name}"] = (
                lambda name, image: network(image),
                chosen.kitti_sigma,
            )
        detectors: dict[str, OnnxDetector | None] = {}
        if chosen.detector:
            detectors[Path(chosen.detector).stem] = OnnxDetector(chosen.detector, keep=ROAD_NAMES)
        detectors["labels (leak)"] = None
        for depth, (depth_of, sigma) in depths.items():
            for boxes, detector in detectors.items():
                settings.append((depth, boxes, list(real(kitti, detector, depth_of)), 1.65, (sigma, sigma)))
    rows, gaps, spans, times = [], [], [], []
    for depth, boxes, cases, height, sigma in settings:
        pairs, lifted, milliseconds = run_methods(cases, height, sigma)
        times.append(milliseconds)
        rows += table_rows(depth, boxes, pairs)
        gaps += differences(f"{depth}, {boxes}", pairs)
        for method in ("refine", "no_depth"):
            parts = [
                f"{low:.0f}-{high:.0f} m: {100 * figures['accuracy']:.1f} % of {figures['pairs']:.0f}"
                for low, high, figures in by_distance(pairs[method])
                if figures["pairs"]
            ]
            spans.append(f"- {depth}, {boxes}, {method}: {'; '.join(parts)}")
        draw(
            chosen.run_folder / f"{depth} {boxes}".replace(":", "").replace(" ", "_"),
            cases[:12],
            lifted["refine"][:12],
        )
    text = [
        f"| {' | '.join(TITLES)} |", "|---|---|" + "---:|" * (len(TITLES) - 2),
        *(f"| {row[0]}, {row[1]} | {' | '.join(row[2:])} |" for row in rows),
        "", "Differences on the same objects:", "", *gaps, "", "Centre accuracy by distance:", "", *spans, "",
        *notes_of(chosen.frames, notes, times),
    ]  # fmt: skip
    chosen.output.parent.mkdir(parents=True, exist_ok=True)
    chosen.output.with_suffix(".md").write_text("\n".join(text) + "\n")
    write_rows(chosen.output.with_suffix(".csv"), COLUMNS, rows)
    print("\n".join(text))


def notes_of(frames: int, notes: list[str], times: list[float]) -> list[str]:
    """The protocol, in words."""
    words = " ".join(Path(word).name if "/" in word else word for word in sys.argv[1:])
    return [
        "Centre accuracy: mean of 1 - |c - c*| / |c*| over objects that the 2D boxes hold (IoU 0.5, one to "
        "one). BEV and 3D: share of those whose boxes overlap by more. Yaw: median error modulo 180 degrees. "
        "Brackets: 95 % of 2000 resamples of whole frames.",
        "",
        f"Simulation: {frames} test scenes each, streets at 256 x 832, halls at 240 x 320; objects seen to "
        "30 % or more, not cut by the border, 17 pixels high or more; tight boxes around what is seen.",
        "",
        'KITTI: training frames at hand with a scan, or all with a network; Car and Van, not beyond "hard". '
        "Label boxes are projections of the 3D boxes, so they leak the answer. `no_depth` knows the class "
        "sizes and the nominal camera height.",
        "",
        *(f"- {note}." for note in notes),
        f"- `refine`: {np.median(times):.1f} ms of processor time per object (median over settings, ground "
        f"included), 1 thread, {environment()['hardware']['processor']}, numpy {np.__version__}.",
        f"- Made by `python experiments/table4_centres/run.py {words}`.",
    ]


if __name__ == "__main__":
    main()

"""Table 4: center accuracy, match rates and KITTI's AP of four methods, in simulation and on KITTI.

python experiments/table4_centres/run.py --sim-model runs/streets-depth --hall-model eldenet_indoor \
    --detector yolox_nano_coco_256x832.onnx --kitti-model meter_kitti

All methods and defaults were tuned on simulated training scenes. This script uses test scenes and KITTI's
frames, which are only reported. KITTI's rows need ELDENET_DATA (docs/boxes.md) and a detector; its pictures
are written to the run folder.
"""

import argparse
from pathlib import Path

import torch
from cases import HEIGHTS, SIZES, Case, Setting, real, render, simulated
from rows import (
    COLUMNS,
    METHOD_NAMES,
    TITLES,
    accuracy_by_distance,
    differences,
    protocol_notes,
    table_rows,
    where,
)
from speed import lifting, stages

import eldenet
from eldenet.boxes import Boxes3D
from eldenet.deploy.predictor import DepthPredictor, for_camera
from eldenet.perception.detectors import ROAD_NAMES
from eldenet.perception.drawing import draw_bev, draw_boxes, picture_beside_bev
from eldenet.perception.kitti_object import KittiObjects
from eldenet.perception.lifter import SENSOR_SIGMA, BoxLifter
from eldenet.perception.matching_metrics import Pairs, compare
from eldenet.perception.onnx_detector import OnnxDetector
from eldenet.system.files import write_rows
from eldenet.visualization import write_picture

HERE = Path(__file__).parent
SEEN = "simulated test scenes, objects seen to 30 % or more, whole, 18 px high or more"
REAL = 'KITTI object training frames at hand, objects not beyond "hard", 2D IoU 0.5'


def main() -> None:
    args = arguments()
    torch.set_num_threads(1)
    settings, notes = [], []
    for kind in SIZES if args.frames else ():
        more, said = in_simulation(args, kind)
        settings, notes = settings + more, notes + said
    more, said = on_kitti(args)
    settings, notes = settings + more, notes + said
    rows, gaps, spans = [], [], []
    for setting in settings:
        found = run_methods(setting)
        for group in setting.groups:
            pairs = pair(setting, group, found)
            rows += [[*row, *where(setting)] for row in table_rows(setting, group, pairs, found)]
            gaps += differences(setting, group, pairs)
            spans += accuracy_by_distance(setting, group, pairs)
        folder = f"{setting.depth} {setting.boxes}".replace(":", "").replace(" ", "_")
        draw(args.run_folder / folder, setting.cases[:12], found["refine"][:12])
    cells = [
        [", ".join(row[:3]), *row[3:5], *row[6:12], f"{row[12]} / {row[13]} ({row[14]})", row[15]]
        for row in rows
    ]
    text = [
        f"| {' | '.join(TITLES)} |", "|---|---|" + "---:|" * (len(TITLES) - 2),
        *(f"| {' | '.join(row)} |" for row in cells),
        "", "Differences on the same objects:", "", *gaps, "", "Center accuracy by distance:", "", *spans, "",
        *protocol_notes(args.frames, notes, settings[0]),
    ]  # fmt: skip
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.with_suffix(".md").write_text("\n".join(text) + "\n")
    write_rows(args.output.with_name(f"{args.output.name}_rows.csv"), COLUMNS, rows)
    print("\n".join(text))


def arguments() -> argparse.Namespace:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--frames", type=int, default=50, help="test scenes of each kind; 0: KITTI alone")
    options.add_argument("--sim-model", help="folder of a network trained on rendered streets")
    options.add_argument("--hall-model", help="folder of a network trained on rendered halls")
    options.add_argument("--kitti-model", help="folder of a network for KITTI's pictures")
    options.add_argument("--detector", help="an .onnx file, for KITTI")
    options.add_argument("--run-folder", type=Path, default=Path("runs/table4_centres"))
    options.add_argument("--output", type=Path, default=HERE / "results", help="without an ending")
    return options.parse_args()


def in_simulation(args: argparse.Namespace, kind: str) -> tuple[list[Setting], list[str]]:
    """Return settings with exact depth and with a network's."""
    views = render("test", 0, args.frames, kind)
    size = f"{SIZES[kind][0]} x {SIZES[kind][1]}"
    groups = ("vehicles", "people, cyclists") if kind == "crossing" else ("all",)
    exact = Setting(
        f"{kind}: exact", "simulator", simulated(views, lambda view: view.depth), HEIGHTS[kind], SENSOR_SIGMA,
        groups, size, SEEN,
    )  # fmt: skip
    notes = lifting(exact)
    model = args.hall_model if kind == "hall" else args.sim_model
    if not model:
        return [exact], notes
    network = predictor_of(model)
    cases = simulated(views, lambda view: for_camera(network, view.camera.intrinsics)(view.image))
    learned = Setting(
        f"{kind}: ELDE-Net", "simulator", cases, HEIGHTS[kind], (None, None), groups,
        f"{size}, {seen_by(network)}", SEEN,
    )  # fmt: skip
    if args.detector:
        notes += stages(learned, network, traffic_detector(args.detector))
    return [exact, learned], [f"{kind}: the network is {Path(model).name}", *notes]


def on_kitti(args: argparse.Namespace) -> tuple[list[Setting], list[str]]:
    """Return settings with LiDAR's depth and a network's, with boxes of a detector and of the labels."""
    try:
        kitti = KittiObjects()
    except FileNotFoundError as error:
        print(f"KITTI is left out: {error}")
        return [], []
    network = predictor_of(args.kitti_model) if args.kitti_model else None
    detector = traffic_detector(args.detector) if args.detector else None
    depths = {"KITTI: LiDAR": lambda name, image: kitti.lidar_depth(name, image.shape[:2])}
    notes = []
    if network is not None:
        depths[f"KITTI: {Path(args.kitti_model).name}"] = lambda name, image: network(image)
    boxes = {"labels (leak)": None}
    if detector is not None:
        boxes = {Path(args.detector).stem: detector} | boxes
    settings = []
    for depth, depth_of in depths.items():
        size = "about 375 x 1242" + ("" if "LiDAR" in depth else f", {seen_by(network)}")
        for name, finder in boxes.items():
            cases = list(real(kitti, finder, depth_of))
            groups = ("vehicles", "people, cyclists")
            settings.append(Setting(depth, name, cases, HEIGHTS["street"], (None, None), groups, size, REAL))
    if network is not None and detector is not None:
        notes += stages(settings[-2], network, detector)
    return settings, notes


def predictor_of(model: str) -> DepthPredictor:
    """Return a network as ``predict`` uses it for boxes: with its sigma, if it has one."""
    network = eldenet.load(model)
    return DepthPredictor(network, steady=False, uncertainty=network.distribution is not None)


def traffic_detector(path: Path | str) -> OnnxDetector:
    """Return a detector of what is in traffic, with COCO's names or its own."""
    detector = OnnxDetector(path)
    detector.keep = [name for name in (*ROAD_NAMES, "van", "cyclist") if name in detector.names]
    return detector


def seen_by(network: DepthPredictor) -> str:
    height, width = network.input_size
    return f"network {height} x {width}"


def run_methods(setting: Setting) -> dict[str, list[Boxes3D]]:
    """Return the boxes of each method in every frame."""
    found = {}
    for method in METHOD_NAMES:
        name, _, unknown = method.partition(", ")
        lifter = BoxLifter(
            name, camera_height=None if unknown else setting.height, depth_sigma=setting.sigma[0],
            small_sigma=setting.sigma[1],
        )  # fmt: skip
        found[method] = [lifter(case.depth, case.detections, case.camera) for case in setting.cases]
    return found


def pair(setting: Setting, group: str, found: dict[str, list[Boxes3D]]) -> dict[str, Pairs]:
    """Return the matched pairs of each method."""
    pairs = {}
    for method, lifted in found.items():
        parts = [
            compare(case.truth, boxes, *case.pairs_of(group))
            for case, boxes in zip(setting.cases, lifted, strict=True)
        ]
        pairs[method] = Pairs.join(parts)
    return pairs


def draw(folder: Path, cases: list[Case], boxes: list[Boxes3D]) -> None:
    """Write pictures of a setting: boxes in the photo, and from above with the truth in gray."""
    for case, found in zip(cases, boxes, strict=True):
        drawn = draw_boxes(case.image, found, case.camera)
        tall = max(300, case.image.shape[0])
        panel = draw_bev(found, case.camera, case.image.shape[1], size=(tall, tall), truth=case.truth)
        write_picture(folder / f"{case.name}.png", picture_beside_bev(drawn, panel))


if __name__ == "__main__":
    main()

"""Table 4: center accuracy and match rates of four methods on simulated streets and halls, and on KITTI.

python experiments/table4_centres/run.py --sim-model runs/streets-depth --hall-model runs/halls-depth \
    --detector yolox_nano_coco_256x832.onnx --kitti-model meter_kitti --kitti-sigma 0.12

All methods were tuned on simulated training scenes. This script uses test scenes and KITTI's frames, which
are only reported. KITTI's rows need ELDENET_DATA (docs/boxes.md) and a detector; its pictures are written to
the run folder.
"""

import argparse
from pathlib import Path

import torch
from cases import EXACT_SIGMA, HEIGHTS, SIZES, Case, Setting, real, relative_error, render, simulated
from rows import COLUMNS, TITLES, accuracy_by_distance, differences, protocol_notes, table_rows, where
from speed import lifting, stages

import eldenet
from eldenet.boxes import Boxes3D
from eldenet.deploy.predictor import DepthPredictor
from eldenet.perception.detectors import ROAD_NAMES
from eldenet.perception.drawing import draw_bev, draw_boxes, picture_beside_bev
from eldenet.perception.kitti_object import KittiObjects
from eldenet.perception.lifter import METHODS, BoxLifter
from eldenet.perception.matching_metrics import Pairs, compare
from eldenet.perception.onnx_detector import OnnxDetector
from eldenet.system.files import write_rows
from eldenet.visualization import write_picture

HERE = Path(__file__).parent
SIGMA_SCENES = 40  # training scenes on which a network's errors on objects are measured
LARGEST_SIGMA = 0.5  # a depth with a larger error is useless
FIRST_SIGMA_SCENE = 10000  # beyond the scenes that networks are trained on
SEEN = "simulated test scenes, objects seen to 30 % or more, whole, 18 px high or more"
CARS = 'KITTI object training frames at hand, Car and Van not beyond "hard", 2D IoU 0.5'


def main() -> None:
    args = arguments()
    torch.set_num_threads(1)
    settings, notes = [], []
    for kind in SIZES:
        more, said = in_simulation(args, kind)
        settings, notes = settings + more, notes + said
    more, said = on_kitti(args, growth(settings))
    settings, notes = settings + more, notes + said
    rows, gaps, spans = [], [], []
    for setting in settings:
        pairs, refined = run_methods(setting)
        rows += [[*row, *where(setting)] for row in table_rows(setting, pairs)]
        gaps += differences(setting, pairs)
        spans += accuracy_by_distance(setting, pairs)
        folder = f"{setting.depth} {setting.boxes}".replace(":", "").replace(" ", "_")
        draw(args.run_folder / folder, setting.cases[:12], refined[:12])
    cells = [[f"{row[0]}, {row[1]}", row[2], row[3], *row[5:11]] for row in rows]
    text = [
        f"| {' | '.join(TITLES)} |", "|---|---|" + "---:|" * (len(TITLES) - 2),
        *(f"| {' | '.join(row)} |" for row in cells),
        "", "Differences on the same objects:", "", *gaps, "", "Center accuracy by distance:", "", *spans, "",
        *protocol_notes(args.frames, notes, settings[0]),
    ]  # fmt: skip
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.with_suffix(".md").write_text("\n".join(text) + "\n")
    write_rows(args.output.with_suffix(".csv"), COLUMNS, rows)
    print("\n".join(text))


def arguments() -> argparse.Namespace:
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--frames", type=int, default=50, help="test scenes of each kind")
    options.add_argument("--sim-model", help="folder of a network trained on rendered streets")
    options.add_argument("--hall-model", help="folder of a network trained on rendered halls")
    options.add_argument("--kitti-model", help="folder of a network for KITTI's pictures")
    options.add_argument("--kitti-sigma", type=float, default=0.12, help="its relative error on objects")
    options.add_argument("--detector", help="an .onnx file, for KITTI")
    options.add_argument("--run-folder", type=Path, default=Path("runs/table4_centres"))
    options.add_argument("--output", type=Path, default=HERE / "results", help="without an ending")
    return options.parse_args()


def in_simulation(args: argparse.Namespace, kind: str) -> tuple[list[Setting], list[str]]:
    """Return settings with exact depth and with a network's, whose errors are measured on training scenes."""
    views = render("test", 0, args.frames, kind)
    size = f"{SIZES[kind][0]} x {SIZES[kind][1]}"
    exact = Setting(
        f"{kind}: exact", "simulator", simulated(views, lambda view: view.depth), HEIGHTS[kind],
        (EXACT_SIGMA, EXACT_SIGMA), size, SEEN,
    )  # fmt: skip
    notes = lifting(exact)
    model = args.sim_model if kind == "street" else args.hall_model
    if not model:
        return [exact], notes
    network = DepthPredictor(eldenet.load(model))
    training = render("train", FIRST_SIGMA_SCENE, SIGMA_SCENES, kind)
    sigma = relative_error(training, network)
    cases = simulated(views, lambda view: network(view.image))
    learned = Setting(
        f"{kind}: ELDE-Net", "simulator", cases, HEIGHTS[kind], sigma, f"{size}, {seen_by(network)}", SEEN
    )
    measured = (
        f"{kind}: depth_sigma and small_sigma of {Path(model).name} measured on {SIGMA_SCENES} training "
        f"scenes: {sigma[0]:.3f} and {sigma[1]:.3f}"
    )
    if args.detector:
        notes += stages(learned, network, OnnxDetector(args.detector, keep=ROAD_NAMES))
    return [exact, learned], [measured, *notes]


def growth(settings: list[Setting]) -> float:
    """Return how many times worse a network's depth is for small than for large objects, on rendered streets.

    Nothing is fitted to real frames, so the same factor is taken for KITTI's network.
    """
    sigmas = [setting.sigma for setting in settings if setting.depth == "street: ELDE-Net"]
    return sigmas[0][1] / sigmas[0][0] if sigmas else 1.0


def on_kitti(args: argparse.Namespace, grows: float) -> tuple[list[Setting], list[str]]:
    """Return settings with LiDAR's depth and a network's, with boxes of a detector and of the labels."""
    try:
        kitti = KittiObjects()
    except FileNotFoundError as error:
        print(f"KITTI is left out: {error}")
        return [], []
    network = DepthPredictor(eldenet.load(args.kitti_model)) if args.kitti_model else None
    detector = OnnxDetector(args.detector, keep=ROAD_NAMES) if args.detector else None
    exact = EXACT_SIGMA, EXACT_SIGMA
    depths = {"KITTI: LiDAR": (lambda name, image: kitti.lidar_depth(name, image.shape[:2]), exact)}
    notes = []
    if network is not None:
        sigma = args.kitti_sigma, min(args.kitti_sigma * grows, LARGEST_SIGMA)
        name = Path(args.kitti_model).name
        depths[f"KITTI: {name}"] = (lambda name, image: network(image), sigma)
        notes = [
            f"KITTI: depth_sigma {sigma[0]:.2f} of {name} is the error of whole pictures; that small objects "
            f"fare worse, as on rendered streets, makes small_sigma {sigma[1]:.2f}"
        ]
    boxes = {"labels (leak)": None}
    if detector is not None:
        boxes = {Path(args.detector).stem: detector} | boxes
    settings = []
    for depth, (depth_of, sigma) in depths.items():
        size = "about 375 x 1242" + ("" if "LiDAR" in depth else f", {seen_by(network)}")
        for name, finder in boxes.items():
            cases = list(real(kitti, finder, depth_of))
            settings.append(Setting(depth, name, cases, HEIGHTS["street"], sigma, size, CARS))
    if network is not None and detector is not None:
        notes += stages(settings[-2], network, detector)
    return settings, notes


def seen_by(network: DepthPredictor) -> str:
    height, width = network.input_size
    return f"network {height} x {width}"


def run_methods(setting: Setting) -> tuple[dict[str, Pairs], list[Boxes3D]]:
    """Return the matched pairs of each method, and the boxes of ``refine``."""
    pairs, refined = {}, []
    for method in METHODS:
        lifter = BoxLifter(
            method, camera_height=setting.height, depth_sigma=setting.sigma[0], small_sigma=setting.sigma[1]
        )
        lifted = [lifter(case.depth, case.detections, case.camera) for case in setting.cases]
        parts = [
            compare(case.truth, found, case.rows, case.columns)
            for case, found in zip(setting.cases, lifted, strict=True)
        ]
        pairs[method] = Pairs.join(parts)
        if method == "refine":
            refined = lifted
    return pairs, refined


def draw(folder: Path, cases: list[Case], boxes: list[Boxes3D]) -> None:
    """Write pictures of a setting: boxes in the photo, and from above with the truth in gray."""
    for case, found in zip(cases, boxes, strict=True):
        drawn = draw_boxes(case.image, found, case.camera)
        tall = max(300, case.image.shape[0])
        panel = draw_bev(found, case.camera, case.image.shape[1], size=(tall, tall), truth=case.truth)
        write_picture(folder / f"{case.name}.png", picture_beside_bev(drawn, panel))


if __name__ == "__main__":
    main()

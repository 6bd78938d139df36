"""Train YOLOv9 on rendered scenes, export it, and score the exported file on held-out scenes.

python experiments/detector/train.py                                      about half an hour of one core
python experiments/detector/train.py --train 90 --test 30 --epochs 3      a trial run: two minutes
python experiments/detector/train.py --kinds arena --train 1000 --size 96 128 --epochs 20     of a robot

Needs libreyolo (MIT): pip install libreyolo onnx onnxruntime. Nothing is downloaded.
"""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import rich.progress  # noqa: E402
from detection_data import read_split, scene_versions, write_dataset  # noqa: E402
from libreyolo_detector import LibreYoloDetector, YoloTraining  # noqa: E402
from object_views import names_of  # noqa: E402

from eldenet.boxes import Detections2D  # noqa: E402
from eldenet.perception.drawing import draw_detections  # noqa: E402
from eldenet.perception.onnx_detector import OnnxDetector  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.system.files import write_json  # noqa: E402
from eldenet.system.resources import choose_resources  # noqa: E402
from eldenet.visualization import stack_rows, write_picture  # noqa: E402

MIN_SCORE = 0.01  # of detections that count for average precision
SHOWN_SCORE = 0.3  # of detections in detections.png
EXAMPLES = 9
EXPORT = "detector.onnx"
Example = tuple[np.ndarray, Detections2D, Detections2D]  # image, truth, detections


def options(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Parse the command line; None: that of this process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("--output", type=Path, default=Path("runs/detector"), help="folder for the results")
    add("--data", type=Path, help="folder for the rendered images, which are reused; default: <output>/data")
    add(
        "--kinds",
        nargs="+",
        default=["street", "hall", "room"],
        help="kinds of scenes, which alternate: street, crossing (with cyclists), hall, room, arena",
    )
    add(
        "--focal", nargs=2, type=float, help="range of focal lengths [widths]; default: the lens of each kind"
    )
    add("--train", type=int, default=900, help="training images")
    add("--test", type=int, default=150, help="held-out images, of other scenes")
    add(
        "--size",
        nargs=2,
        type=int,
        default=[192, 320],
        help="height and width of the images and of the network's input [px], multiples of 32",
    )
    add("--model", default="t", help="t, s, m or c")
    add("--weights", type=Path, help="train/weights/last.pt of an earlier run to start from; default: random")
    add("--epochs", type=int, default=12)
    add("--batch", type=int, default=8, help="images per update")
    add("--learning-rate", type=float, default=0.002, help="of AdamW, decaying linearly")
    add("--mosaic", type=float, default=0.0, help="share of training images that combine four images")
    add(
        "--auxiliary",
        type=float,
        default=0.0,
        help="weight of YOLOv9's auxiliary branch; its authors use 0.25 (a third slower)",
    )
    add("--nms", type=float, default=0.6, help="IoU above which the worse of two boxes of a class is dropped")
    add("--threads", type=int, help="default: all cores")
    add("--device", default="auto")
    add("--seed", type=int, default=0)
    add("--resume", action="store_true", help="continue from the last epoch in --output")
    return parser.parse_args(words)


def train(args: argparse.Namespace) -> dict[str, Any]:
    """Render, train, export and score; return the content of ``run.json``.

    Raises:
        ValueError: the folder holds another training already.
    """
    folder: Path = args.output
    if (folder / "train").exists() and not args.resume:
        raise ValueError(f"--output {folder} already holds a training: give another folder, or --resume")
    resources = choose_resources(
        device=args.device, precision="fp32", threads="auto" if args.threads is None else args.threads
    )
    size = (args.size[0], args.size[1])
    detector = LibreYoloDetector(
        args.weights,
        names=names_of(args.kinds),
        size=args.model,
        input_size=size,
        nms=args.nms,
        seed=args.seed,
    )
    training = YoloTraining(
        epochs=args.epochs, batch=args.batch, learning_rate=args.learning_rate, mosaic=args.mosaic,
        auxiliary=args.auxiliary, workers=resources.workers, device=resources.device, seed=args.seed,
    )  # fmt: skip
    counts = {"train": args.train, "test": args.test}
    name = f"yolov9-{detector.model.size}"
    start = time.perf_counter()
    with rich.progress.Progress() as progress:
        task = progress.add_task("rendering", total=sum(counts.values()))
        data = write_dataset(
            args.data or folder / "data", counts, size, kinds=args.kinds, focal=args.focal,
            advance=lambda count: progress.advance(task, count),
        )  # fmt: skip
    rendered = time.perf_counter()
    print(f"{name}, {args.epochs} epochs of {args.train} pictures on {resources.device}")
    # a run that was killed before its first checkpoint starts again
    resume = args.resume and (folder / "train/weights/last.pt").is_file()
    checkpoint = detector.train(data, folder / "train", training, resume=resume)
    trained = time.perf_counter()
    file = detector.export(folder / EXPORT)
    metrics, examples, milliseconds = score_file(file, data.parent, args.test, detector.nms)
    record = {
        "model": name,
        "metrics": metrics,
        "pictures": counts,
        "seconds": {"rendering": rendered - start, "training": trained - rendered},
        "checkpoint": str(checkpoint.relative_to(folder.resolve())),
        "file": {"name": EXPORT, "bytes": file.stat().st_size, "median_ms": milliseconds, "threads": 1},
        "resources": vars(resources),
        "config": {
            key: str(value) if isinstance(value, Path) else value for key, value in vars(args).items()
        },
        "frames": scene_versions(args.kinds),
        **environment(),
    }
    write_json(folder / "run.json", record)
    write_picture(folder / "detections.png", draw_examples(examples, SHOWN_SCORE))
    print_results(record)
    return record


def score_file(
    file: Path, data: Path, count: int, nms: float
) -> tuple[dict[str, dict[str, float]], list[Example], float]:
    """Average precision of an exported file on the test split, some examples, and the median time [ms]."""
    # average precision counts every class separately
    detector = OnnxDetector(file, threshold=MIN_SCORE, nms=nms, between_classes=1.0)
    examples, spent = [], []
    for image, truth in read_split(data, "test", count):
        start = time.perf_counter()
        found = detector(image)
        spent.append(time.perf_counter() - start)
        examples.append((image, truth, found))
    metrics = average_precisions([truth for _, truth, _ in examples], [found for *_, found in examples])
    return metrics, examples[:EXAMPLES], 1000 * float(np.median(spent))


def average_precisions(
    truths: Sequence[Detections2D], found: Sequence[Detections2D]
) -> dict[str, dict[str, float]]:
    """COCO's average precision [%] by class and their mean ("all"): ``AP50``, ``AP50-95``, ``objects``."""
    import torch
    from torchmetrics.detection import MeanAveragePrecision

    def tensors(detections: Detections2D) -> dict[str, torch.Tensor]:
        return {
            "boxes": torch.as_tensor(detections.xyxy, dtype=torch.float32).reshape(-1, 4),
            "labels": torch.as_tensor(detections.label),
            "scores": torch.as_tensor(detections.score, dtype=torch.float32),
        }

    names = truths[0].names
    labels = np.concatenate([truth.label for truth in truths])
    values = {name: {"objects": float((labels == number).sum())} for number, name in enumerate(names)}
    values["all"] = {"objects": float(len(labels))}
    for title, thresholds in (("AP50", [0.5]), ("AP50-95", None)):  # None: 0.5, 0.55 ... 0.95
        metric = MeanAveragePrecision(iou_thresholds=thresholds, class_metrics=True)
        metric.warn_on_many_detections = False
        metric.update([tensors(guess) for guess in found], [tensors(truth) for truth in truths])
        result = metric.compute()
        for name in names:
            values[name][title] = float("nan")
        pairs = zip(result["classes"].reshape(-1), result["map_per_class"].reshape(-1), strict=True)
        for number, value in pairs:
            if value >= 0:  # -1: the class has no object
                values[names[int(number)]][title] = 100 * float(value)
        values["all"][title] = 100 * float(result["map"])
    return values


def draw_examples(examples: Sequence[Example], threshold: float) -> np.ndarray:
    """Draw image pairs: the truth on the left, detections of ``threshold`` or more on the right."""
    rows = []
    for image, truth, found in examples:
        sure = found.select(found.score >= threshold)
        rows.append(np.concatenate([draw_detections(image, truth), draw_detections(image, sure)], axis=1))
    return stack_rows(rows, ("truth", f"found, score {threshold} or more"))


def print_results(record: dict[str, Any]) -> None:
    """Print average precisions by class, seconds, and where the file is."""
    print(f"{record['pictures']['test']} held-out pictures, the exported file under ONNX Runtime:")
    print(f"{'class':12} {'objects':>8} {'AP50 [%]':>9} {'AP50-95 [%]':>12}")
    for name, values in record["metrics"].items():
        if values["objects"]:
            print(f"{name:12} {values['objects']:8.0f} {values['AP50']:9.1f} {values['AP50-95']:12.1f}")
    seconds, file = record["seconds"], record["file"]
    print(f"rendering {seconds['rendering']:.0f} s, training {seconds['training']:.0f} s")
    print(f"{file['name']}: {file['bytes'] / 1e6:.1f} MB, {file['median_ms']:.1f} ms per picture on 1 thread")


if __name__ == "__main__":
    train(options())

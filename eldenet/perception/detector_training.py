"""Train a detector on rendered scenes, export it, and score the exported file."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.perception.detection_data import read_split, scene_versions, write_dataset
from eldenet.perception.libreyolo_detector import LibreYoloDetector, YoloTraining
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import RUN_FILE, environment
from eldenet.system.files import write_json
from eldenet.system.locks import sole_writer

if TYPE_CHECKING:
    from eldenet.system.resources import Resources

MIN_SCORE = 0.01  # of detections that count for average precision
EXAMPLES = 9
EXPORT = "detector.onnx"
Example = tuple[np.ndarray, Detections2D, Detections2D]  # image, truth, detections


@dataclass(frozen=True)
class DetectorTrainingSetup:
    """A training of ``python -m eldenet.train_detector``.

    Attributes:
        folder: of the run.
        detector: before the training.
        training: epochs, batch size ...
        data: folder of the rendered images; images that it holds already are used.
        kinds: of scenes.
        focal: range of fx [widths]; None: the lens of each kind.
        counts: images of the splits "train" and "test".
        resources: threads and device.
        resume: continue from the last epoch in ``folder``.
        settings: the config, for ``run.json``.
    """

    folder: Path
    detector: LibreYoloDetector
    training: YoloTraining
    data: Path
    kinds: Sequence[str]
    focal: tuple[float, float] | None
    counts: dict[str, int]
    resources: "Resources"
    resume: bool
    settings: dict[str, Any]


def train_detector(setup: DetectorTrainingSetup) -> dict[str, Any]:
    """Render, train, export and score; return the content of ``run.json``.

    Raises:
        FolderInUse: another process trains in this folder.
    """
    with sole_writer(setup.folder):
        return _train_detector(setup)


def _train_detector(setup: DetectorTrainingSetup) -> dict[str, Any]:
    folder, detector, counts = setup.folder, setup.detector, setup.counts
    log = RunLog(folder)
    name = f"yolov9-{detector.model.size}"
    start = time.perf_counter()
    with log.bar("rendering", sum(counts.values())) as bar:
        data = write_dataset(
            setup.data,
            counts,
            detector.input_size,
            kinds=setup.kinds,
            focal=setup.focal,
            advance=bar.advance,
        )
    rendered = time.perf_counter()
    log.say(
        f"{name}, {setup.training.epochs} epochs of {counts['train']} pictures on {setup.resources.device}, "
        f"{setup.resources.threads} threads"
    )
    # a run that was killed before its first checkpoint starts again
    resume = setup.resume and (folder / "train/weights/last.pt").is_file()
    checkpoint = detector.train(data, folder / "train", setup.training, resume=resume)
    trained = time.perf_counter()
    file = detector.export(folder / EXPORT)
    metrics, examples, milliseconds = score_file(file, data.parent, counts["test"], detector.nms)
    record = {
        "model": name,
        "metrics": metrics,
        "pictures": counts,
        "seconds": {"rendering": rendered - start, "training": trained - rendered},
        "checkpoint": str(checkpoint.relative_to(folder.resolve())),
        "file": {"name": EXPORT, "bytes": file.stat().st_size, "median_ms": milliseconds, "threads": 1},
        "resources": vars(setup.resources),
        "config": setup.settings,
        "frames": scene_versions(setup.kinds),
        **environment(),
    }
    write_json(folder / RUN_FILE, record)
    log.picture("detections", 0, draw_examples(examples, detector.threshold))
    _log_results(log, record, file)
    log.close()
    return record


def score_file(
    file: Path, data: Path, count: int, nms: float
) -> tuple[dict[str, dict[str, float]], list[Example], float]:
    """Average precision of an exported file on the test split, some examples, and the median time [ms]."""
    from eldenet.perception.onnx_detector import OnnxDetector

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
    from eldenet.perception.drawing import draw_detections
    from eldenet.visualization import stack_rows

    rows = []
    for image, truth, found in examples:
        sure = found.select(found.score >= threshold)
        rows.append(np.concatenate([draw_detections(image, truth), draw_detections(image, sure)], axis=1))
    return stack_rows(rows, ("truth", f"found, score {threshold} or more"))


def _log_results(log: RunLog, record: dict[str, Any], file: Path) -> None:
    rows = [
        [name, f"{values['objects']:.0f}", *(f"{values[title]:.1f}" for title in ("AP50", "AP50-95"))]
        for name, values in record["metrics"].items()
        if values["objects"]
    ]
    title = f"{record['pictures']['test']} held-out pictures, the exported file under ONNX Runtime"
    log.table(title, ["class", "objects", "AP50 [%]", "AP50-95 [%]"], rows)
    seconds, size = record["seconds"], record["file"]["bytes"] / 1e6
    log.say(
        f"rendering {seconds['rendering']:.0f} s, training {seconds['training']:.0f} s; "
        f"{record['file']['median_ms']:.1f} ms per picture on 1 thread; {file} ({size:.1f} MB)"
    )

"""``python -m eldenet.train_detector``: rendered scenes -> YOLOv9 -> an ONNX file and what it finds."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.boxes import Detections2D
    from eldenet.results.run_log import RunLog

Shown = list[tuple[np.ndarray, "Detections2D", "Detections2D"]]  # picture, truth, found

LEAST_SCORE = 0.01  # of detections that average precision counts
PICTURES = 9
EXPORT = "detector.onnx"


@entry_point("train_detector")
def main(config: "DictConfig", folder: Path) -> None:
    """Render, train, export, score the exported file on held-out scenes."""
    train_detector(config, folder)


def train_detector(config: "DictConfig", folder: Path) -> dict[str, Any]:
    """The whole run of ``config`` in ``folder``; returns what ``run.json`` holds.

    Raises:
        ValueError: libreyolo is missing, or the folder holds another run already.
    """
    from eldenet.perception.detection_data import write_dataset
    from eldenet.results.run_log import RunLog
    from eldenet.results.run_record import RUN_FILE, environment
    from eldenet.simulation.street_views import NAMES, STREETS_VERSION
    from eldenet.system.files import write_json
    from eldenet.system.resources import choose_resources

    if (folder / "train").exists() and not config.resume:
        raise ValueError(f"run_dir={folder} holds a training already: give another run_dir, or resume=true")
    resources = choose_resources(**cfg.plain(config.runtime))
    names = cfg.plain(config.detector.names) or list(NAMES)
    detector = cfg.instantiate(config.detector, names=names)
    folder.mkdir(parents=True, exist_ok=True)
    log = RunLog(folder)
    counts = {split: int(config.data[split]) for split in ("train", "test")}
    clock = [time.perf_counter()]
    with log.bar("rendering", sum(counts.values())) as bar:
        data = write_dataset(
            Path(config.data.root), counts, detector.input_size,
            kinds=cfg.listed(config.data.kinds), advance=bar.advance,
        )  # fmt: skip
    clock.append(time.perf_counter())
    log.say(
        f"YOLOv9-{config.detector.size}, {config.training.epochs} epochs of {counts['train']} pictures on "
        f"{resources.device}, {resources.threads} threads"
    )
    # a run that was killed before its first checkpoint starts afresh
    resume = bool(config.resume) and (folder / "train/weights/last.pt").is_file()
    checkpoint = detector.train(
        data, folder / "train", **cfg.plain(config.training), workers=resources.workers,
        device=resources.device, seed=int(config.seed), resume=resume,
    )  # fmt: skip
    clock.append(time.perf_counter())
    file = detector.export(folder / EXPORT)
    scores, shown, milliseconds = score_file(config, file, data.parent, counts["test"])
    record = {
        "model": f"yolov9-{config.detector.size}",
        "metrics": scores,
        "pictures": counts,
        "seconds": dict(zip(("rendering", "training"), np.diff(clock).tolist(), strict=True)),
        "checkpoint": str(checkpoint.relative_to(folder.resolve())),
        "file": {"name": EXPORT, "bytes": file.stat().st_size, "median_ms": milliseconds, "threads": 1},
        "resources": vars(resources),
        "config": cfg.plain(config),
        "frames": f"streets-v{STREETS_VERSION}",
        **environment(),
    }
    write_json(folder / RUN_FILE, record)
    log.picture("detections", 0, drawn(shown, float(config.detector.threshold)))
    closing_table(log, record, file)
    log.close()
    return record


def score_file(
    config: "DictConfig", file: Path, data: Path, count: int
) -> tuple[dict[str, dict[str, float]], Shown, float]:
    """Average precision of the exported file, some pictures with truth and finds, median time [ms]."""
    from eldenet.perception.detection_data import read_split
    from eldenet.perception.onnx_detector import OnnxDetector

    detector = OnnxDetector(  # average precision counts every class for itself
        file, threshold=LEAST_SCORE, nms=float(config.detector.nms), between_classes=1.0
    )
    shown, spent = [], []
    for image, truth in read_split(data, "test", count):
        start = time.perf_counter()
        found = detector(image)
        spent.append(time.perf_counter() - start)
        shown.append((image, truth, found))
    scores = average_precisions([truth for _, truth, _ in shown], [found for *_, found in shown])
    return scores, shown[:PICTURES], 1000 * float(np.median(spent))


def average_precisions(
    truths: Sequence["Detections2D"], found: Sequence["Detections2D"]
) -> dict[str, dict[str, float]]:
    """COCO's average precision [%] by class and their mean ("all"): ``AP50``, ``AP50-95``, ``objects``."""
    import torch
    from torchmetrics.detection import MeanAveragePrecision

    metrics = {"AP50": [0.5], "AP50-95": None}  # IoU thresholds; None: 0.5, 0.55 ... 0.95
    names = truths[0].names
    values: dict[str, dict[str, float]] = {}
    for title, thresholds in metrics.items():
        metric = MeanAveragePrecision(iou_thresholds=thresholds, class_metrics=True)
        metric.warn_on_many_detections = False
        for truth, guess in zip(truths, found, strict=True):
            score = torch.as_tensor(guess.score, dtype=torch.float32)
            metric.update([_tensors(guess) | {"scores": score}], [_tensors(truth)])
        result = metric.compute()
        per_class = dict(
            zip(
                np.atleast_1d(result["classes"].numpy()).tolist(),
                np.atleast_1d(result["map_per_class"].numpy()).tolist(),
                strict=True,
            )
        )
        for number, name in enumerate(names):
            value = per_class.get(number, np.nan)  # -1 where a class has no object
            values.setdefault(name, {})[title] = 100 * value if value >= 0 else float("nan")
        values.setdefault("all", {})[title] = 100 * float(result["map"])
    labels = np.concatenate([truth.label for truth in truths])
    for number, name in enumerate(names):
        values[name]["objects"] = float((labels == number).sum())
    values["all"]["objects"] = float(len(labels))
    return values


def _tensors(detections: "Detections2D") -> dict[str, Any]:
    import torch

    return {
        "boxes": torch.as_tensor(detections.xyxy, dtype=torch.float32).reshape(-1, 4),
        "labels": torch.as_tensor(detections.label),
    }


def drawn(shown: Shown, threshold: float) -> np.ndarray:
    """Pairs of pictures, truth on the left and finds on the right."""
    from eldenet.perception.drawing import draw_detections
    from eldenet.visualization import stack_rows

    rows = []
    for image, truth, found in shown:
        sure = found.select(found.score >= threshold)
        rows.append(np.concatenate([draw_detections(image, truth), draw_detections(image, sure)], axis=1))
    return stack_rows(rows, ("truth", f"found, score {threshold} or more"))


def closing_table(log: "RunLog", record: dict[str, Any], file: Path) -> None:
    """Average precision by class, what it cost, and where the file is."""
    rows = [
        [name, f"{values['objects']:.0f}", *(f"{values[title]:.1f}" for title in ("AP50", "AP50-95"))]
        for name, values in record["metrics"].items()
        if values["objects"]
    ]
    log.table(
        f"{record['pictures']['test']} held-out pictures, the exported file under ONNX Runtime",
        ["class", "objects", "AP50 [%]", "AP50-95 [%]"],
        rows,
    )
    seconds, size = record["seconds"], record["file"]["bytes"] / 1e6
    log.say(
        f"rendering {seconds['rendering']:.0f} s, training {seconds['training']:.0f} s; "
        f"{record['file']['median_ms']:.1f} ms a picture on 1 thread; {file} ({size:.1f} MB)"
    )


if __name__ == "__main__":
    main()

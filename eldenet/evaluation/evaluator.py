"""Score a model on a data set under a protocol."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.utils.data import DataLoader

from eldenet.data.base import DepthDataset
from eldenet.data.loaders import collate, evaluation_loader
from eldenet.evaluation.cost import device_of
from eldenet.evaluation.metric_names import METRICS
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.geometry import grid_margins
from eldenet.model import eval_mode

if TYPE_CHECKING:
    from eldenet.evaluation.uncertainty_metrics import UncertaintyScores

PER_IMAGE_HEADER = ("name", *METRICS)
PICTURED = 4  # frames in a picture of samples


@dataclass(frozen=True)
class Evaluation:
    """Metrics of a data set and of each of its images."""

    metrics: dict[str, float]  # by name, with images and pixels
    rows: list[tuple[Any, ...]]  # (name, *metrics) per image, in the data set's order
    # errors by semantic class, see DepthMetrics.by_class; empty without labels
    classes: dict[str, dict[str, float]] = field(default_factory=dict)
    # measures of the network's sigma, whose means are in metrics too; None: it predicts none
    uncertainty: "UncertaintyScores | None" = None


@torch.inference_mode()
def predict_depth(
    model: nn.Module,
    image: Tensor,
    focal: Tensor | None = None,
    *,
    flip: str = "none",
    pad: bool = False,
) -> Tensor:
    """Depth ``(B, 1, h, w)`` [m] of ``image (B, 3, h, w)``.

    Args:
        focal: fx ``(B,)`` [px of ``image``], 0 where unknown; for models with ``canonical_px``, and for
            files of one lens (``fov``), which refuse another.
        flip: "mean" averages with the prediction of the mirror image; "none" does not.
        pad: repeat the rows and columns at the edges until both sides are multiples of
            :data:`~eldenet.geometry.GRID`, as ``predict`` does with frames of another shape than the
            training's.
    """
    return _maps(model, image, focal, flip, pad)[0]


@torch.inference_mode()
def predict_spread(
    model: nn.Module,
    image: Tensor,
    focal: Tensor | None = None,
    *,
    flip: str = "none",
    pad: bool = False,
) -> tuple[Tensor, Tensor]:
    """Depth as by :func:`predict_depth`, and the standard deviation of ln depth; ``(B, 1, h, w)`` each."""
    depth, spread = _maps(model, image, focal, flip, pad, with_spread=True)
    return depth, spread


def is_padded(dataset: DepthDataset, image: Tensor) -> bool:
    """Whether images ``(B, 3, h, w)`` of ``dataset`` are padded: where ``predict`` would pad them."""
    return dataset.stretch is not None and tuple(image.shape[-2:]) != dataset.input_size


def _maps(
    model: nn.Module, image: Tensor, focal: Tensor | None, flip: str, pad: bool, **options: bool
) -> list[Tensor]:
    """What ``model`` answers, one map or several."""
    height, width = image.shape[-2:]
    top = left = 0
    if pad:
        top, bottom, left, right = grid_margins((height, width))
        image = F.pad(image, (left, right, top, bottom), mode="replicate")

    def run(picture: Tensor) -> list[Tensor]:
        found = model(picture, *_focal_argument(model, focal), **options)
        return [found] if isinstance(found, Tensor) else list(found)

    maps = run(image)
    if flip == "mean":
        maps = [0.5 * (one + other.flip(-1)) for one, other in zip(maps, run(image.flip(-1)), strict=True)]
    return [each[..., top : top + height, left : left + width] for each in maps]


def _focal_argument(model: nn.Module, focal: Tensor | None) -> tuple[Tensor, ...]:
    """What ``model`` is given after the image: the focal lengths, or nothing if it takes none."""
    takes = any(getattr(model, name, None) is not None for name in ("canonical_px", "fov"))
    return (focal,) if focal is not None and takes else ()


def evaluate(
    model: nn.Module,
    dataset: DepthDataset,
    protocol: EvalProtocol,
    *,
    device: str | torch.device = "cpu",
    batch_size: int = 32,
    workers: int = 0,
    advance: Callable[[int], object] | None = None,
) -> Evaluation:
    """Score ``model`` on every frame of ``dataset`` exactly once, in fp32.

    On CUDA, call :func:`eldenet.system.resources.full_fp32` first, as the commands do, to turn TF32 off.

    Args:
        model: image ``(B, 3, h, w)`` -> depth ``(B, 1, h, w)`` [m]; its mode is kept. One with
            ``canonical_px`` or ``fov`` also takes the focal lengths ``(B,)`` [px]. If it has a
            ``distribution``, ``model(..., with_spread=True)`` also gives the standard deviation of ln depth,
            which is scored.
        dataset: built for evaluation (depth in its own resolution).
        protocol: the rules.
        device: where the model is.
        batch_size: images at a time, fewer where their size changes; it does not change the result.
        workers: processes that load data.
        advance: called with the number of images of each batch, for a progress bar.

    Raises:
        ValueError: the data set's ground truth is not of the protocol's kind or size, no pixel of it counts,
            or a prediction is NaN.
    """
    loader = evaluation_loader(dataset, batch_size, workers=workers)
    return evaluate_batches(model, loader, protocol, device=device, advance=advance)


def evaluate_batches(
    model: nn.Module,
    loader: DataLoader,
    protocol: EvalProtocol,
    *,
    device: str | torch.device = "cpu",
    processes: int = 1,
    advance: Callable[[int], object] | None = None,
) -> Evaluation:
    """Score the frames of an :func:`~eldenet.data.loaders.evaluation_loader` as :func:`evaluate` does.

    Each of several ``processes`` has a loader of its share of the frames; all get the whole result.

    Raises:
        ValueError: as :func:`evaluate`.
    """
    from eldenet.evaluation.metrics import DepthMetrics  # torchmetrics takes seconds to load
    from eldenet.evaluation.uncertainty_metrics import UncertaintyMeter

    dataset: Any = loader.dataset
    protocol.check_ground_truth(dataset.ground_truth)
    metrics = DepthMetrics(protocol, sync=processes > 1, classes=dataset.class_names).to(device)
    distribution = getattr(model, "distribution", None)
    meter = None if distribution is None else UncertaintyMeter(distribution)
    rows: list[tuple[Any, ...]] = []
    with eval_mode(model):
        for batch in chain.from_iterable(loader):
            image = batch["image"].to(device, memory_format=torch.channels_last)
            focal = batch["intrinsics"][:, 0, 0].to(device)
            depth, mask = batch["depth"].to(device), batch["mask"].to(device)
            pad = is_padded(dataset, image)
            if meter is None:
                prediction = predict_depth(model, image, focal, flip=protocol.flip, pad=pad)
            else:
                prediction, spread = predict_spread(model, image, focal, flip=protocol.flip, pad=pad)
                valid = protocol.valid_mask(depth, mask)
                aligned = protocol.align(prediction.float(), depth, valid)
                spread = protocol.align_spread(spread.float(), prediction.float(), depth, valid)
                # the spread of ln depth is that of the logarithm of its inverse too
                compared = protocol.to_metric_space(aligned, depth)
                meter.update(batch["name"], *compared, spread, valid)
            labels = batch["labels"].to(device) if "labels" in batch else None
            metrics.update(prediction, depth, mask, labels)
            values = metrics.rows.cpu().tolist()
            rows += [(name, *row) for name, row in zip(batch["name"], values, strict=True)]
            if advance is not None:
                advance(len(image))
    if processes > 1:
        rows = _gather_rows(rows)
        if meter is not None:
            meter.images = _gather_rows(meter.images)
    found = metrics.compute()
    if not found["pixels"]:
        raise ValueError(
            f"no pixel of {len(dataset)} frames has a known depth that protocol {protocol.name} counts "
            f"({protocol.min_depth:g} to {protocol.max_depth:g} m): nothing can be scored"
        )
    scores = None if meter is None else meter.compute()
    return Evaluation(found | (scores.metrics if scores else {}), rows, metrics.by_class(), scores)


def _gather_rows(rows: list[Any]) -> list[Any]:
    """Rows of all processes in the data set's order: frame ``i`` went to process ``i % processes``."""
    from accelerate.utils import gather_object

    shares = gather_object([rows])
    longest = max(len(share) for share in shares)
    return [share[i] for i in range(longest) for share in shares if i < len(share)]


def picture_of_samples(model: nn.Module, dataset: DepthDataset, protocol: EvalProtocol) -> np.ndarray:
    """Picture ``(H, W, 3)`` uint8 with a row for each of a few fixed frames.

    A row shows the image, the ground truth, the prediction as it is scored, and the relative error.
    """
    from eldenet.visualization import PANELS, depth_row, stack_rows

    device = device_of(model)
    pictures = []
    with eval_mode(model):
        for index in range(0, len(dataset), max(1, len(dataset) // PICTURED))[:PICTURED]:
            batch: dict[str, Any] = collate([dataset[index]])
            focal = batch["intrinsics"][:, 0, 0].to(device)
            image = batch["image"].to(device)
            pad = is_padded(dataset, image)
            prediction = predict_depth(model, image, focal, flip=protocol.flip, pad=pad).cpu()
            valid = protocol.valid_mask(batch["depth"], batch["mask"])
            prediction = protocol.align(prediction, batch["depth"], valid)
            shown = protocol.resize_to_gt(batch["image"], batch["depth"].shape[-2:])
            pictures.append(depth_row(shown[0], batch["depth"][0], batch["mask"][0], prediction[0]))
    return stack_rows(pictures, PANELS, scales=2)

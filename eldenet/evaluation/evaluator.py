"""Score a model on a data set under a protocol."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from eldenet.data.base import DepthDataset
from eldenet.data.loaders import collate, evaluation_loader
from eldenet.evaluation.cost import device_of
from eldenet.evaluation.metrics import METRICS, DepthMetrics
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.model import eval_mode

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Evaluation:
    """Metrics of a data set, and of each of its images.

    Attributes:
        metrics: by name, with ``images`` and ``pixels``.
        rows: ``(name, *metrics)`` per image, in the data set's order.
        classes: of the data set's semantic labels, see :meth:`~.metrics.DepthMetrics.by_class`;
            empty where it has none.
    """

    metrics: dict[str, float]
    rows: list[tuple[Any, ...]]
    classes: dict[str, dict[str, float]] = field(default_factory=dict)


@torch.inference_mode()
def predict_depth(model: nn.Module, image: Tensor, *, flip: str = "none") -> Tensor:
    """Depth ``(B, 1, h, w)`` [m] of ``image (B, 3, h, w)``; "mean" averages with the mirror image's."""
    prediction = model(image)
    if flip == "mean":
        prediction = 0.5 * (prediction + model(image.flip(-1)).flip(-1))
    return prediction


def evaluate(
    model: nn.Module,
    dataset: DepthDataset,
    protocol: EvalProtocol,
    *,
    device: str | torch.device = "cpu",
    batch_size: int = 32,
    workers: int = 0,
    rank: int = 0,
    processes: int = 1,
    advance: Progress | None = None,
) -> Evaluation:
    """Score ``model`` on every frame of ``dataset`` exactly once, in fp32.

    On CUDA call :func:`eldenet.system.resources.full_fp32` before, as the commands do: torch takes TF32 else.

    Args:
        model: image ``(B, 3, h, w)`` -> depth ``(B, 1, h, w)`` [m]; its mode is kept.
        dataset: built for evaluation (depth in its own resolution).
        protocol: the rules.
        device: where the model is.
        batch_size: images at a time, fewer where their size changes; has no influence on the result.
        workers: processes that load data.
        rank: of this process, if several share the work.
        processes: that share the work; sums are added up over them.
        advance: called with the number of images done, for a progress bar.

    Raises:
        ValueError: the data set's ground truth is not of the protocol's kind or size, or a prediction is NaN.
    """
    protocol.check_ground_truth(dataset.ground_truth)
    loader: DataLoader = evaluation_loader(
        dataset, batch_size, workers=workers, rank=rank, processes=processes
    )
    metrics = DepthMetrics(protocol, sync=processes > 1, classes=dataset.class_names).to(device)
    rows: list[tuple[Any, ...]] = []
    with eval_mode(model):
        for batch in chain.from_iterable(loader):
            image = batch["image"].to(device, memory_format=torch.channels_last)
            prediction = predict_depth(model, image, flip=protocol.flip)
            labels = batch["labels"].to(device) if "labels" in batch else None
            metrics.update(prediction, batch["depth"].to(device), batch["mask"].to(device), labels)
            values = metrics.rows.cpu().tolist()
            rows += [(name, *row) for name, row in zip(batch["name"], values, strict=True)]
            if advance is not None:
                advance(len(image))
    if processes > 1:
        rows = _gather_rows(rows)
    return Evaluation(metrics.compute(), rows, metrics.by_class())


def _gather_rows(rows: list[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Rows of all processes, back in the data set's order (they were dealt out one by one)."""
    from accelerate.utils import gather_object

    shares = gather_object([rows])
    longest = max(len(share) for share in shares)
    return [share[i] for i in range(longest) for share in shares if i < len(share)]


def sample_rows(model: nn.Module, dataset: DepthDataset, protocol: EvalProtocol, rows: int = 4) -> np.ndarray:
    """Picture ``(H, W, 3)`` uint8 of fixed frames: image, ground truth, prediction, relative error."""
    from eldenet.visualization import PANELS, depth_row, stack_rows

    device = device_of(model)
    pictures = []
    with eval_mode(model):
        for index in range(0, len(dataset), max(1, len(dataset) // rows))[:rows]:
            batch: dict[str, Any] = collate([dataset[index]])
            prediction = predict_depth(model, batch["image"].to(device)).cpu()
            counts = protocol.scored(batch["depth"], batch["mask"])
            prediction = protocol.prepare(prediction, batch["depth"], counts)
            image = protocol.placed(batch["image"], batch["depth"].shape[-2:])
            pictures.append(depth_row(image[0], batch["depth"][0], batch["mask"][0], prediction[0]))
    return stack_rows(pictures, PANELS)


class ConstantPredictor(nn.Module):
    """Predicts the training set's mean depth map whatever it sees: what any network has to beat.

    Args:
        mean_depth: ``(1, 1, H, W)`` [m].
    """

    mean_depth: Tensor

    def __init__(self, mean_depth: Tensor) -> None:
        super().__init__()
        self.register_buffer("mean_depth", mean_depth)

    def forward(self, image: Tensor) -> Tensor:
        """``(B, 3, h, w)`` -> ``(B, 1, H, W)`` [m]."""
        return self.mean_depth.expand(len(image), -1, -1, -1)


def fit_constant_predictor(dataset: DepthDataset, *, frames: int = 512) -> ConstantPredictor:
    """Mean over known depth, pixel by pixel, of up to ``frames`` training frames spread over the set.

    Args:
        dataset: must not augment.
        frames: at most.

    Raises:
        ValueError: the depth maps are of several sizes.
    """
    step = -(-len(dataset) // frames)
    total = count = None
    for index in range(0, len(dataset), step):
        sample = dataset[index]
        depth, known = sample["depth"].double(), sample["mask"]
        if total is not None and total.shape != depth.shape:
            raise ValueError(
                f"the depth of {sample['name']} is {tuple(depth.shape[-2:])}, that of {dataset.names[0]} "
                f"{tuple(total.shape[-2:])} (height, width): a mean depth map needs one size, set "
                "data.input_size"
            )
        total = depth * known if total is None else total + depth * known
        count = known.long() if count is None else count + known
    assert total is not None
    assert count is not None
    overall = total.sum() / count.sum().clamp(min=1)
    mean = torch.where(count > 0, total / count.clamp(min=1), overall)
    return ConstantPredictor(mean.float()[None])


PER_IMAGE_HEADER = ("name", *METRICS)

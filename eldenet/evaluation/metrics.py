"""Depth metrics under a protocol: sums per image and per class, and the metrics of them."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torchmetrics import Metric

from eldenet.evaluation.metric_names import CLASS_METRICS, METRICS
from eldenet.evaluation.protocol import EvalProtocol


def error_sums(prediction: Tensor, depth: Tensor, valid: Tensor, *, ssim_range: float) -> Tensor:
    """Sums over the valid pixels of each image ``(B, 12)`` float64; unlike means, sums add up over batches.

    Columns: pixels; e^2; |e|; |e|/depth; delta 1.25, 1.25^2, 1.25^3; |log10 ratio|; ln ratio; (ln ratio)^2;
    SSIM; pixels that SSIM counts (no unknown one in the window).
    """
    from eldenet.losses.ssim import eroded, ssim_map

    safe, safe_depth = _filled(prediction, valid), _filled(depth, valid)
    structure = ssim_map(safe, safe_depth, window=11, value_range=ssim_range)
    full_window = eroded(valid, 11)
    columns = [(values, valid) for values in _pixel_errors(safe, safe_depth)]
    columns += [(structure, full_window), (torch.ones_like(structure), full_window)]
    # single precision per pixel, double for the sums: hundreds of millions of pixels add up
    return torch.stack(
        [(values * where).flatten(1).sum(1, dtype=torch.float64) for values, where in columns], dim=1
    )


def class_sums(prediction: Tensor, depth: Tensor, valid: Tensor, labels: Tensor, classes: int) -> Tensor:
    """The sums of :func:`error_sums` over each class's valid pixels ``(classes, 12)``; SSIM's two are 0.

    ``labels`` is ``(B, 1, H, W)``; pixels of a label that is not a class (255) are left out.
    """
    valid = valid & (labels < classes)
    of_class = labels[valid].long()
    columns = [
        torch.bincount(of_class, weights=values[valid].double(), minlength=classes)
        for values in _pixel_errors(_filled(prediction, valid), _filled(depth, valid))
    ]
    return torch.stack([*columns, *2 * [torch.zeros_like(columns[0])]], dim=1)


def _filled(values: Tensor, valid: Tensor) -> Tensor:
    """fp32 ``(B, 1, H, W)`` with 1 where nothing is known, so that no NaN arises."""
    return values.float().masked_fill(~valid, 1.0)


def _pixel_errors(prediction: Tensor, depth: Tensor) -> list[Tensor]:
    """The first ten columns of :func:`error_sums`, pixel by pixel: ``(B, 1, H, W)`` each."""
    error = (prediction - depth).abs()
    # without a clamp a prediction may be 0 or negative: no delta counts it, and its logarithm is undefined
    ratio = torch.maximum(prediction / depth, depth / prediction).masked_fill(prediction <= 0, math.inf)
    log_ratio = (prediction / depth).log()
    return [
        torch.ones_like(error),
        error.square(),
        error,
        error / depth,
        *(ratio < 1.25**power for power in (1, 2, 3)),
        log_ratio.abs() / math.log(10),
        log_ratio,
        log_ratio.square(),
    ]


def metrics_of(sums: Tensor) -> Tensor:
    """Metrics ``(..., 10)`` in the order of ``METRICS`` from sums ``(..., 12)``; NaN where nothing counts.

    Convention: SILog is ``100 * sqrt(var(ln ratio))`` as in BTS; log10 is a mean absolute difference;
    delta counts ratios strictly below the threshold; AbsRel divides by the ground truth.
    """
    pixels = sums[..., 0]
    mse, mae, abs_rel, d1, d2, d3, log10, mean_log, mean_log_square = (
        sums[..., column] / pixels for column in range(1, 10)
    )
    silog = 100 * (mean_log_square - mean_log.square()).clamp(min=0).sqrt()
    ssim = sums[..., 10] / sums[..., 11]
    return torch.stack([mse, mse.sqrt(), mae, abs_rel, d1, d2, d3, log10, silog, ssim], dim=-1)


class DepthMetrics(Metric):
    """Metrics of a whole data set under one protocol. The states are sums, so batches and processes add up.

    Args:
        protocol: the rules.
        sync: ``compute`` adds up the sums of all processes; each of them must call it.
        classes: names of the semantic classes by their number in ``labels``, for :meth:`by_class`.
    """

    full_state_update = False
    pooled: Tensor
    image_sums: Tensor
    image_counts: Tensor
    class_sums: Tensor

    def __init__(self, protocol: EvalProtocol, *, sync: bool = True, classes: Sequence[str] = ()) -> None:
        super().__init__(sync_on_compute=sync)
        self.protocol, self.classes = protocol, tuple(classes)
        self.set_dtype(torch.float64)
        zeros = torch.zeros(len(METRICS), dtype=torch.float64)
        self.add_state("pooled", torch.zeros(12, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("image_sums", zeros, dist_reduce_fx="sum")
        self.add_state("image_counts", zeros.clone(), dist_reduce_fx="sum")
        by_class = torch.zeros(len(self.classes), 12, dtype=torch.float64)
        self.add_state("class_sums", by_class, dist_reduce_fx="sum")
        self.rows = torch.empty(0)

    def update(self, prediction: Tensor, depth: Tensor, mask: Tensor, labels: Tensor | None = None) -> None:
        """Add a batch: ``prediction (B, 1, h, w)`` [m], ``depth (B, 1, H, W)`` [m], ``mask`` bool.

        ``labels (B, 1, H, W)`` are for :meth:`by_class`. Afterwards ``rows`` holds the metrics of each image
        of this batch ``(B, 10)``.

        Raises:
            ValueError: a valid pixel's prediction is not finite, or a size is not the protocol's.
        """
        valid = self.protocol.valid_mask(depth, mask)
        prediction = self.protocol.align(prediction.float(), depth, valid)
        prediction, depth = self.protocol.to_metric_space(prediction, depth)
        sums = error_sums(prediction, depth, valid, ssim_range=self.protocol.value_range)
        self.rows = metrics_of(sums)
        # an image without a valid pixel is left out; a NaN of an image that has some is not
        defined = sums[:, :1].expand_as(self.rows) > 0
        defined = torch.cat([defined[:, :-1], sums[:, 11:] > 0], dim=1)
        self.pooled += sums.sum(0)
        self.image_sums += self.rows.where(defined, 0.0).sum(0)
        self.image_counts += defined.sum(0)
        if labels is not None and self.classes:
            self.class_sums += class_sums(prediction, depth, valid, labels, len(self.classes))

    def by_class(self) -> dict[str, dict[str, float]]:
        """Class -> ``abs_rel``, ``rmse``, ``delta1`` and ``pixels``, for classes that have valid pixels.

        Convention: all pixels of a class are pooled, whatever the protocol's average: an image may hold only
        a few of them.
        """
        with self.sync_context(should_sync=self.sync_on_compute):
            sums = self.class_sums.clone()
        errors = {}
        for name, row in zip(self.classes, sums, strict=True):
            if row[0] > 0:
                values = dict(zip(METRICS, metrics_of(row).tolist(), strict=True))
                errors[name] = {m: values[m] for m in CLASS_METRICS} | {"pixels": int(row[0])}
        return errors

    def compute(self) -> dict[str, float]:
        """Metrics by name, with the number of scored ``images`` and ``pixels``."""
        values = (
            metrics_of(self.pooled)
            if self.protocol.average == "pixel"
            else self.image_sums / self.image_counts
        )
        result = dict(zip(METRICS, values.tolist(), strict=True))
        return result | {"images": int(self.image_counts[0]), "pixels": int(self.pooled[0])}

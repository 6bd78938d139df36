"""Depth metrics: a number never travels without the rules that made it."""

import math

import torch
from torch import Tensor
from torchmetrics import Metric

from eldenet.protocol import EvalProtocol

__all__ = ["LOWER_IS_BETTER", "METRICS", "UNITS", "DepthMetrics", "EvalProtocol", "error_sums", "metrics_of"]

METRICS = ("mse", "rmse", "mae", "abs_rel", "delta1", "delta2", "delta3", "log10", "silog", "ssim")
LOWER_IS_BETTER = frozenset(("mse", "rmse", "mae", "abs_rel", "log10", "silog"))
UNITS = {"mse": "m^2", "rmse": "m", "mae": "m"}  # the others are pure numbers


def error_sums(prediction: Tensor, depth: Tensor, counts: Tensor, *, ssim_range: float) -> Tensor:
    """Sums over the scored pixels of each image ``(B, 12)`` float64; sums add up, means do not.

    Columns: pixels; e^2; |e|; |e|/depth; delta 1.25, 1.25^2, 1.25^3; |log10 ratio|; ln ratio; (ln ratio)^2;
    SSIM; pixels that SSIM counts (no unknown one in the window).
    """
    from eldenet.losses.ssim import eroded, ssim_map

    safe_depth = depth.float().masked_fill(~counts, 1.0)
    safe = prediction.float().masked_fill(~counts, 1.0)
    error = (safe - safe_depth).abs()
    # without a clamp a prediction may be 0 or negative: no delta counts it, and its logarithm is undefined
    ratio = torch.maximum(safe / safe_depth, safe_depth / safe).masked_fill(safe <= 0, math.inf)
    log_ratio = (safe / safe_depth).log()
    structure = ssim_map(safe, safe_depth, window=11, value_range=ssim_range)
    full_window = eroded(counts, 11)
    columns = [
        (torch.ones_like(error), counts),
        (error.square(), counts),
        (error, counts),
        (error / safe_depth, counts),
        *((ratio < 1.25**power, counts) for power in (1, 2, 3)),
        (log_ratio.abs() / math.log(10), counts),
        (log_ratio, counts),
        (log_ratio.square(), counts),
        (structure, full_window),
        (torch.ones_like(error), full_window),
    ]
    # single precision per pixel, double for the sums: hundreds of millions of pixels add up
    return torch.stack(
        [(values * where).flatten(1).sum(1, dtype=torch.float64) for values, where in columns], dim=1
    )


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
    """Metrics of a whole data set under one protocol; states are sums, so processes and batches add up.

    Args:
        protocol: the rules.
        sync: ``compute`` adds up the sums of all processes, where several run; then each must call it.
    """

    full_state_update = False
    pooled: Tensor
    image_sums: Tensor
    image_counts: Tensor

    def __init__(self, protocol: EvalProtocol, *, sync: bool = True) -> None:
        super().__init__(sync_on_compute=sync)
        self.protocol = protocol
        self.set_dtype(torch.float64)
        zeros = torch.zeros(len(METRICS), dtype=torch.float64)
        self.add_state("pooled", torch.zeros(12, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("image_sums", zeros, dist_reduce_fx="sum")
        self.add_state("image_counts", zeros.clone(), dist_reduce_fx="sum")
        self.rows = torch.empty(0)

    def update(self, prediction: Tensor, depth: Tensor, mask: Tensor) -> None:
        """Add a batch: ``prediction (B, 1, h, w)`` [m], ``depth (B, 1, H, W)`` [m], ``mask`` bool.

        ``rows`` then holds the metrics of each image of this batch ``(B, 10)``.

        Raises:
            ValueError: a prediction that counts is not finite, or a size is not the protocol's.
        """
        counts = self.protocol.scored(depth, mask)
        prediction = self.protocol.prepare(prediction.float(), depth, counts)
        prediction, depth = self.protocol.compared(prediction, depth)
        sums = error_sums(prediction, depth, counts, ssim_range=self.protocol.largest)
        self.rows = metrics_of(sums)
        # an image without a pixel to score is left out; a NaN of one that has some is not
        defined = sums[:, :1].expand_as(self.rows) > 0
        defined = torch.cat([defined[:, :-1], sums[:, 11:] > 0], dim=1)
        self.pooled += sums.sum(0)
        self.image_sums += self.rows.where(defined, 0.0).sum(0)
        self.image_counts += defined.sum(0)

    def compute(self) -> dict[str, float]:
        """Metrics by name, with ``images`` and ``pixels`` that were scored."""
        values = (
            metrics_of(self.pooled)
            if self.protocol.average == "pixel"
            else self.image_sums / self.image_counts
        )
        result = dict(zip(METRICS, values.tolist(), strict=True))
        return result | {"images": int(self.image_counts[0]), "pixels": int(self.pooled[0])}

"""Evaluation protocols and depth metrics: a number never travels without the rules that made it."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torchmetrics import Metric

METRICS = ("mse", "rmse", "mae", "abs_rel", "delta1", "delta2", "delta3", "log10", "silog", "ssim")
LOWER_IS_BETTER = frozenset(("mse", "rmse", "mae", "abs_rel", "log10", "silog"))
UNITS = {"mse": "m^2", "rmse": "m", "mae": "m"}  # the others are pure numbers

_CHOICES = {
    "ground_truth": ("raw", "inpainted", "sparse", "dense"),
    "interpolation": ("bilinear", "nearest"),
    "average": ("image", "pixel"),
    "scale": ("metric", "median"),
    "flip": ("none", "mean"),
}


@dataclass(frozen=True)
class EvalProtocol:
    """The rules under which depth is scored. Two numbers compare only under the same rules.

    Attributes:
        name: what a table calls it.
        min_depth: ground truth at or below is not scored [m].
        max_depth: ground truth at or above is not scored [m] (both strict, as in BTS and monodepth2).
        ground_truth: "raw" sensor depth with holes, "inpainted", "sparse" (LiDAR) or "dense" (rendered).
        resize: of the whole frame, image and ground truth alike, before anything else: a factor or
            ``(height, width)`` [px]; None: none.
        frame_crop: centre crop of the frame after ``resize``, ``(height, width)`` [px]; None: none.
        crop: box that is scored, ``(top, bottom, left, right)`` [px of the ground truth], ends excluded.
        size: the ground truth's ``(height, width)`` [px] that ``crop`` speaks of; another size is an error.
        interpolation: how a prediction is brought to the ground truth's size (bilinear: corners not aligned).
        clamp: clamp the prediction into ``[min_depth, max_depth]`` before scoring.
        average: "image": a metric per image, then the mean over images; "pixel": all pixels pooled.
        scale: "metric": as predicted; "median": each prediction times median(truth) / median(prediction).
        flip: "mean": predictions of the image and of its mirror image are averaged before scoring.
        inverse_scale: score ``inverse_scale / depth`` (pure numbers) instead of depth [m]; None: score depth.
    """

    name: str
    min_depth: float = 1e-3
    max_depth: float = 10.0
    ground_truth: str = "raw"
    resize: float | Sequence[int] | None = None
    frame_crop: Sequence[int] | None = None
    crop: Sequence[int] | None = None
    size: Sequence[int] | None = None
    interpolation: str = "bilinear"
    clamp: bool = True
    average: str = "image"
    scale: str = "metric"
    flip: str = "none"
    inverse_scale: float | None = None

    def __post_init__(self) -> None:
        for field, allowed in _CHOICES.items():
            if getattr(self, field) not in allowed:
                raise ValueError(
                    f"protocol {self.name}: {field}={getattr(self, field)!r}, choose one of {allowed}"
                )
        if not 0 < self.min_depth < self.max_depth:
            raise ValueError(f"protocol {self.name}: 0 < min_depth < max_depth is needed [m]")
        if self.inverse_scale is not None and not self.inverse_scale > 0:
            raise ValueError(
                f"protocol {self.name}: inverse_scale={self.inverse_scale}, give metres above 0, or null"
            )
        if self.crop is not None and self.size is None:
            raise ValueError(f"protocol {self.name}: crop={self.crop} needs size, whose pixels it speaks of")
        for field in ("crop", "size", "frame_crop"):  # YAML's lists: one form, so that protocols compare
            value = getattr(self, field)
            if value is not None:
                object.__setattr__(self, field, tuple(int(number) for number in value))
        if isinstance(self.resize, Sequence):
            object.__setattr__(self, "resize", tuple(int(number) for number in self.resize))
        if self.crop is not None and self.size is not None:
            inside = len(self.crop) == 4 and (
                0 <= self.crop[0] < self.crop[1] <= self.size[0]
                and 0 <= self.crop[2] < self.crop[3] <= self.size[1]
            )
            if not inside:
                raise ValueError(
                    f"protocol {self.name}: crop={self.crop} must be (top, bottom, left, right) within "
                    f"size={self.size}"
                )

    def as_dict(self) -> dict[str, Any]:
        """Every rule by name, as ``run.json`` stores it."""
        return asdict(self)

    def scored(self, depth: Tensor, mask: Tensor) -> Tensor:
        """Bool mask ``(B, 1, H, W)`` of the pixels that count: known, within range, inside the crop.

        Raises:
            ValueError: the ground truth has another size than the crop was written for.
        """
        if self.size is not None and tuple(depth.shape[-2:]) != tuple(self.size):
            raise ValueError(
                f"protocol {self.name} is defined on ground truth of {tuple(self.size)} pixels, this one has "
                f"{tuple(depth.shape[-2:])}: choose another protocol or another data set"
            )
        counts = mask & (depth > self.min_depth) & (depth < self.max_depth)
        if self.crop is not None:
            top, bottom, left, right = self.crop
            inside = torch.zeros_like(counts)
            inside[..., top:bottom, left:right] = True
            counts &= inside
        return counts

    def prepare(self, prediction: Tensor, depth: Tensor, counts: Tensor) -> Tensor:
        """Bring a raw prediction ``(B, 1, h, w)`` [m] to what is scored: size, scale, clamp.

        Raises:
            ValueError: a prediction that counts is not finite, or there is not one per ground truth.
        """
        if prediction.ndim != 4 or prediction.shape[:2] != depth.shape[:2]:
            raise ValueError(
                f"prediction {tuple(prediction.shape)} does not match ground truth {tuple(depth.shape)}: "
                "(B, 1, h, w) and (B, 1, H, W) are needed"
            )
        if prediction.shape[-2:] != depth.shape[-2:]:
            options: dict[str, Any] = {"align_corners": False} if self.interpolation == "bilinear" else {}
            prediction = F.interpolate(prediction, size=depth.shape[-2:], mode=self.interpolation, **options)
        if self.scale == "median":
            prediction = prediction * _median_ratio(prediction, depth, counts)
        if not torch.isfinite(prediction[counts]).all():  # before the clamp, which would hide infinity
            raise ValueError("the prediction is not finite: NaN or infinity where depth is known")
        return prediction.clamp(self.min_depth, self.max_depth) if self.clamp else prediction

    @property
    def largest(self) -> float:
        """The largest number that is compared: the farthest depth [m], or the inverse of the nearest."""
        return self.max_depth if self.inverse_scale is None else self.inverse_scale / self.min_depth

    def compared(self, prediction: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
        """What is compared: depth [m] as it is, or its inverse; unknown depth (0) becomes infinite there."""
        if self.inverse_scale is None:
            return prediction, depth
        return self.inverse_scale / prediction.clamp(min=self.min_depth), self.inverse_scale / depth


def _median_ratio(prediction: Tensor, depth: Tensor, counts: Tensor) -> Tensor:
    ratios = [
        _median(depth[i][counts[i]]) / _median(prediction[i][counts[i]])
        if counts[i].any()
        else depth.new_ones(())
        for i in range(len(depth))
    ]
    return torch.stack(ratios).view(-1, 1, 1, 1)


def _median(values: Tensor) -> Tensor:
    """Median as NumPy takes it: of an even number the mean of the middle two; torch takes the lower."""
    ordered = values.sort().values
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2


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

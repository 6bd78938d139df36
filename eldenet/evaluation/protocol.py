"""Evaluation protocols: the rules under which depth is scored, from the camera's frame to the averages."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldenet.geometry import crop_corner

if TYPE_CHECKING:
    from torch import Tensor

# torch's "nearest" would shift the map by up to half a pixel
_MODES: dict[str, dict[str, Any]] = {
    "bilinear": {"mode": "bilinear", "align_corners": False},
    "bilinear_corners": {"mode": "bilinear", "align_corners": True},
    "nearest": {"mode": "nearest-exact"},
}
_CHOICES = {
    "ground_truth": ("raw", "inpainted", "sparse", "improved", "dense"),
    "frame_anchor": ("center", "bottom"),
    "interpolation": tuple(_MODES),
    "average": ("image", "pixel"),
    "scale": ("metric", "median", "affine_depth", "affine_disparity"),
    "flip": ("none", "mean"),
}
LARGEST_DEPTH = 1000.0  # [m] that a camera's ground truth can have; more is in another unit
_PIXELS = {"crop": 4, "size": 2, "frame_box": 4, "frame_crop": 2, "frame_size": 2}  # field -> its numbers


@dataclass(frozen=True)
class EvalProtocol:
    """The rules under which depth is scored. Two numbers compare only under the same rules.

    Attributes:
        name: what a table calls it.
        min_depth: ground truth at or below is not scored [m].
        max_depth: ground truth at or above is not scored [m] (both strict, as in BTS and monodepth2).
        ground_truth: "raw" sensor depth with holes, "inpainted", "sparse" (one LiDAR scan), "improved"
            (KITTI's eleven scans, cleaned) or "dense" (rendered).
        frame_box: part of the frame, image and ground truth alike, that is cropped first,
            ``(top, bottom, left, right)`` [px of the frame], ends excluded; None: all.
        resize: of the frame after ``frame_box``, image and ground truth alike: a factor or
            ``(height, width)`` [px]; None: none.
        frame_crop: crop of the frame after ``resize``, ``(height, width)`` [px]; None: none.
        frame_anchor: where ``frame_crop`` lies: "center", or "bottom" (lowest rows, centered: BTS's KB crop).
        frame_size: ``(height, width)`` of a last resize of the frame, after ``frame_crop`` [px]; None: none.
        paste: ``frame_crop`` is for the image alone: the ground truth stays whole, the prediction is put back
            into its place, and pixels that the network did not see are not scored.
        crop: box that is scored, ``(top, bottom, left, right)`` [px of the ground truth], ends excluded, such
            as NYU's Eigen crop; None: all, or ``crop_fractions``.
        crop_fractions: the box that is scored, as fractions of the ground truth's own height and width,
            rounded down to whole pixels, for frames of several sizes, such as KITTI's Garg and Eigen crops.
        size: the ground truth's ``(height, width)`` [px] that ``crop`` refers to; another size is an error.
        interpolation: how a prediction is resized to the ground truth's size: "bilinear" (corners not
            aligned), "bilinear_corners" (corners aligned) or "nearest" (to the pixels' centers).
        clamp: clamp the prediction into ``[min_depth, max_depth]`` before scoring.
        average: "image": a metric per image, then the mean over images; "pixel": all pixels pooled.
        scale: "metric": as predicted. All others align each prediction to its own ground truth, over the
            valid pixels: "median" by the factor median(truth) / median(prediction); "affine_depth" by the
            factor and shift of the least squared error in depth; "affine_disparity" by those in 1 / depth.
        flip: "mean": predictions of the image and of its mirror image are averaged before scoring.
        inverse_scale: score ``inverse_scale / depth`` (pure numbers) instead of depth [m]; None: score depth.
    """

    name: str
    min_depth: float = 1e-3
    max_depth: float = 10.0
    ground_truth: str = "raw"
    frame_box: Sequence[int] | None = None
    resize: float | Sequence[int] | None = None
    frame_crop: Sequence[int] | None = None
    frame_anchor: str = "center"
    frame_size: Sequence[int] | None = None
    paste: bool = False
    crop: Sequence[int] | None = None
    crop_fractions: Sequence[float] | None = None
    size: Sequence[int] | None = None
    interpolation: str = "bilinear"
    clamp: bool = True
    average: str = "image"
    scale: str = "metric"
    flip: str = "none"
    inverse_scale: float | None = None

    def __post_init__(self) -> None:
        for problem in self._problems():
            raise ValueError(f"protocol {self.name}: {problem}")
        # lists of YAML become tuples, so that protocols compare
        for field in _PIXELS:
            self._set(field, int, getattr(self, field))
        self._set("resize", int, self.resize if isinstance(self.resize, Sequence) else None)
        self._set("crop_fractions", float, self.crop_fractions)

    def _problems(self) -> Iterator[str]:
        """What makes no sense in these rules."""
        for field, allowed in _CHOICES.items():
            if getattr(self, field) not in allowed:
                yield f"{field}={getattr(self, field)!r}, choose one of {allowed}"
        if not 0 < self.min_depth < self.max_depth:
            yield f"min_depth={self.min_depth:g}, max_depth={self.max_depth:g}: 0 < min < max is needed [m]"
        if self.inverse_scale is None and LARGEST_DEPTH < self.max_depth < math.inf:
            yield f"max_depth={self.max_depth:g}: give meters; {self.max_depth / 1000:g}, if it is in mm"
        if self.inverse_scale is not None and not self.inverse_scale > 0:
            yield f"inverse_scale={self.inverse_scale}, give meters above 0, or null"
        for field, count in _PIXELS.items():
            value = getattr(self, field)
            if value is not None and len(value) != count:
                yield f"{field}={tuple(value)}, give {count} numbers [px]"
        if self.crop is not None and self.crop_fractions is not None:
            yield f"crop={self.crop}, crop_fractions={self.crop_fractions}: give one of them, the other null"
        if self.crop is not None and self.size is None:
            yield f"crop={self.crop} needs size, the ground truth's (height, width)"
        for field, limits, where in (
            ("frame_box", (math.inf, math.inf), "[px]"),
            ("crop", self.size, f"within size={self.size}"),
            ("crop_fractions", (1, 1), "between 0 and 1"),
        ):
            box = getattr(self, field)
            if box is not None and limits is not None and not _is_box(box, limits):
                yield f"{field}={box} must be (top, bottom, left, right) {where}"
        if self.paste and (self.frame_crop is None or self.frame_box or self.resize or self.frame_size):
            yield (
                "paste=True pastes predictions of frame_crop into the whole ground truth: give frame_crop, "
                "and no frame_box, resize or frame_size"
            )

    def _set(self, field: str, kind: type, value: Sequence[float] | None) -> None:
        if value is not None:
            object.__setattr__(self, field, tuple(kind(number) for number in value))

    def check_ground_truth(self, kind: str) -> None:
        """Raise ValueError unless a data set's ground truth is of the kind that this protocol scores."""
        if kind != self.ground_truth:
            raise ValueError(
                f"protocol {self.name} scores {self.ground_truth} ground truth, this data set has {kind} "
                "ground truth: choose another protocol (configs/protocol)"
            )

    @property
    def changes_frames(self) -> bool:
        """Whether frames are cropped or resized before anything else."""
        rules = (self.frame_box, self.resize, self.frame_crop, self.frame_size)
        return any(rule is not None for rule in rules)

    @property
    def value_range(self) -> float:
        """The largest value that is compared: the largest depth [m], or the inverse of the smallest."""
        return self.max_depth if self.inverse_scale is None else self.inverse_scale / self.min_depth

    def as_dict(self) -> dict[str, Any]:
        """Every rule by name, as ``run.json`` stores it."""
        return asdict(self)

    def valid_mask(self, depth: "Tensor", mask: "Tensor") -> "Tensor":
        """Bool mask ``(B, 1, H, W)`` of the pixels that are scored: known, within range, inside the crop.

        Raises:
            ValueError: the ground truth does not have the size that the protocol is defined on.
        """
        height, width = depth.shape[-2:]
        if self.size is not None and (height, width) != tuple(self.size):
            raise ValueError(
                f"protocol {self.name} is defined on ground truth of {self.size} pixels, this one has "
                f"{(height, width)}: choose another protocol or another data set"
            )
        valid = mask & (depth > self.min_depth) & (depth < self.max_depth)
        for box in (self.crop_box(height, width), self.pasted_box(height, width)):
            if box is not None:
                top, bottom, left, right = box
                inside = valid.new_zeros(valid.shape)
                inside[..., top:bottom, left:right] = True
                valid &= inside
        return valid

    def crop_box(self, height: int, width: int) -> tuple[int, ...] | None:
        """Box ``(top, bottom, left, right)`` [px] that is scored of ground truth of this size; None: all.

        Convention: fractions are rounded down to whole pixels, as in Eigen's, monodepth's and BTS's code.
        """
        if self.crop_fractions is None:
            return None if self.crop is None else tuple(self.crop)
        top, bottom, left, right = self.crop_fractions
        return int(top * height), int(bottom * height), int(left * width), int(right * width)

    def pasted_box(self, height: int, width: int) -> tuple[int, int, int, int] | None:
        """Box ``(top, bottom, left, right)`` [px] of the ground truth that predictions are pasted into.

        Raises:
            ValueError: the crop does not fit.
        """
        if not self.paste or self.frame_crop is None:
            return None
        rows, cols = self.frame_crop
        if rows > height or cols > width:
            raise ValueError(
                f"protocol {self.name}: frame_crop={self.frame_crop} does not fit into ground truth of "
                f"{height}x{width}"
            )
        top, left = crop_corner((height, width), (rows, cols), self.frame_anchor)
        return top, top + rows, left, left + cols

    def resize_to_gt(self, values: "Tensor", size: Sequence[int]) -> "Tensor":
        """Resize an image or prediction ``(B, C, h, w)`` to the ground truth's ``(height, width)`` [px].

        With ``paste`` it returns to the place that the image was cropped from, with 0 around it.
        """
        import torch.nn.functional as F

        box = self.pasted_box(size[0], size[1])
        top, bottom, left, right = box or (0, size[0], 0, size[1])
        if values.shape[-2:] != (bottom - top, right - left):
            values = F.interpolate(values, (bottom - top, right - left), **_MODES[self.interpolation])
        return values if box is None else F.pad(values, (left, size[1] - right, top, size[0] - bottom))

    def align(self, prediction: "Tensor", depth: "Tensor", valid: "Tensor") -> "Tensor":
        """Resize, scale and clamp a raw prediction ``(B, 1, h, w)`` [m] to the ground truth.

        Raises:
            ValueError: a valid pixel's prediction is not finite, or there is not one per ground truth.
        """
        if prediction.ndim != 4 or prediction.shape[:2] != depth.shape[:2]:
            raise ValueError(
                f"prediction {tuple(prediction.shape)} does not match ground truth {tuple(depth.shape)}: "
                "(B, 1, h, w) and (B, 1, H, W) are needed"
            )
        prediction = self.resize_to_gt(prediction, depth.shape[-2:])
        if self.scale == "median":
            prediction = prediction * _median_ratio(prediction, depth, valid)
        elif self.scale == "affine_depth":
            prediction = _fitted(prediction, depth, valid)
        elif self.scale == "affine_disparity":
            # as MiDaS's evaluation: a disparity at or below 1 / max_depth is the farthest depth
            disparity = _fitted(1 / prediction.clamp(min=self.min_depth), 1 / depth, valid)
            prediction = 1 / disparity.clamp(min=1 / self.max_depth)
        if not prediction[valid].isfinite().all():  # before the clamp, which would hide infinity
            raise ValueError(
                "the prediction is not finite: it is NaN or infinite where depth is known, probably because "
                "the weights grew too large: train again with a lower optimizer.lr or trainer.max_grad_norm=1"
            )
        return prediction.clamp(self.min_depth, self.max_depth) if self.clamp else prediction

    def align_spread(
        self, spread: "Tensor", prediction: "Tensor", depth: "Tensor", valid: "Tensor"
    ) -> "Tensor":
        """Resize and scale the standard deviation of ln depth of a raw ``prediction``, as :meth:`align`.

        A factor multiplies sigma and depth alike, so their ratio stays. A shift moves depth alone. Where a
        fit's factor is near 0, sigma is too.
        """
        spread = self.resize_to_gt(spread, depth.shape[-2:])
        if self.scale not in ("affine_depth", "affine_disparity"):
            return spread
        aligned = self.align(prediction, depth, valid)
        prediction = self.resize_to_gt(prediction, depth.shape[-2:])
        if self.scale == "affine_disparity":
            prediction, aligned, depth = 1 / prediction.clamp(min=self.min_depth), 1 / aligned, 1 / depth
        factor = _fit(prediction, depth, valid)[0].to(spread.dtype)
        # factor 0: a constant prediction, which the truth's mean replaces; its sigma stays
        return spread * (factor * prediction / aligned).abs().where(factor != 0, 1.0)

    def to_metric_space(self, prediction: "Tensor", depth: "Tensor") -> tuple["Tensor", "Tensor"]:
        """Convert maps ``(B, 1, H, W)`` to what the metrics compare: depth [m], or its inverse."""
        if self.inverse_scale is None:
            return prediction, depth
        return self.inverse_scale / prediction.clamp(min=self.min_depth), self.inverse_scale / depth


def _is_box(box: Sequence[float], limits: Sequence[float]) -> bool:
    return len(box) == 4 and 0 <= box[0] < box[1] <= limits[0] and 0 <= box[2] < box[3] <= limits[1]


def _median_ratio(prediction: "Tensor", depth: "Tensor", valid: "Tensor") -> "Tensor":
    """Median of the truth over that of the prediction, per image ``(B, 1, 1, 1)``."""
    import torch

    ratios = [
        _median(truth[known]) / _median(guess[known]) if known.any() else truth.new_ones(())
        for guess, truth, known in zip(prediction, depth, valid, strict=True)
    ]
    return torch.stack(ratios).view(-1, 1, 1, 1)


def _fitted(prediction: "Tensor", truth: "Tensor", valid: "Tensor") -> "Tensor":
    """Return factor x prediction + shift ``(B, 1, H, W)`` of each image's least squared error."""
    factor, shift = _fit(prediction, truth, valid)
    return (factor * prediction + shift).to(prediction.dtype)


def _fit(prediction: "Tensor", truth: "Tensor", valid: "Tensor") -> tuple["Tensor", "Tensor"]:
    """Factor and shift of each image's least squared error, ``(B, 1, 1, 1)`` float64 each."""
    import torch

    factors, shifts = [], []
    for image, target, known in zip(prediction, truth, valid, strict=True):
        factor, shift = image.new_ones((), dtype=torch.float64), image.new_zeros((), dtype=torch.float64)
        if known.any():
            x, y = image[known].double(), target[known].double()
            squares = (x - x.mean()).square().sum()
            # a constant prediction gets the factor 0, and becomes the truth's mean
            factor = ((x - x.mean()) * (y - y.mean())).sum() / squares if squares > 0 else squares
            shift = y.mean() - factor * x.mean()
        factors.append(factor)
        shifts.append(shift)
    return torch.stack(factors).view(-1, 1, 1, 1), torch.stack(shifts).view(-1, 1, 1, 1)


def _median(values: "Tensor") -> "Tensor":
    """Median of ``(N,)`` as in NumPy: of an even number the mean of the middle two; torch takes the lower."""
    ordered = values.sort().values
    return (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]) / 2

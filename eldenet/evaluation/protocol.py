"""Evaluation protocols: the rules under which depth is scored, from the camera's frame to the averages."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from eldenet.geometry import crop_corner

# torch's "nearest" would shift the map by up to half a pixel
_MODES: dict[str, dict[str, Any]] = {
    "bilinear": {"mode": "bilinear", "align_corners": False},
    "nearest": {"mode": "nearest-exact"},
}
_CHOICES = {
    "ground_truth": ("raw", "inpainted", "sparse", "improved", "dense"),
    "frame_anchor": ("center", "bottom"),
    "interpolation": tuple(_MODES),
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
        ground_truth: "raw" sensor depth with holes, "inpainted", "sparse" (one LiDAR scan), "improved"
            (KITTI's eleven scans, cleaned) or "dense" (rendered).
        frame_box: part of the frame, image and ground truth alike, that is cut out before anything else,
            ``(top, bottom, left, right)`` [px of the frame], ends excluded; None: all.
        resize: of the frame after ``frame_box``, image and ground truth alike: a factor or
            ``(height, width)`` [px]; None: none.
        frame_crop: crop of the frame after ``resize``, ``(height, width)`` [px]; None: none.
        frame_anchor: where ``frame_crop`` lies: "center", or "bottom" (lowest rows, centered: BTS's KB crop).
        frame_size: ``(height, width)`` of a last resize of the frame, after ``frame_crop`` [px]; None: none.
        paste: ``frame_crop`` is for the image alone: the ground truth stays whole, the prediction is put back
            into its place, and what the network did not see is not scored.
        crop: box that is scored, ``(top, bottom, left, right)`` [px of the ground truth], ends excluded.
        crop_fractions: the same box as fractions of the ground truth's own height and width, cut off to whole
            pixels, for frames of several sizes.
        size: the ground truth's ``(height, width)`` [px] that ``crop`` speaks of; another size is an error.
        interpolation: how a prediction is brought to the ground truth's size: "bilinear" (corners not
            aligned) or "nearest" (to the pixels' centers).
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
        for field, allowed in _CHOICES.items():
            if getattr(self, field) not in allowed:
                raise ValueError(
                    f"protocol {self.name}: {field}={getattr(self, field)!r}, choose one of {allowed}"
                )
        if not 0 < self.min_depth < self.max_depth:
            raise ValueError(f"protocol {self.name}: 0 < min_depth < max_depth is needed [m]")
        if self.inverse_scale is not None and not self.inverse_scale > 0:
            raise ValueError(
                f"protocol {self.name}: inverse_scale={self.inverse_scale}, give meters above 0, or null"
            )
        if self.crop is not None and self.size is None:
            raise ValueError(f"protocol {self.name}: crop={self.crop} needs size, whose pixels it speaks of")
        # YAML's lists: one form, so that protocols compare
        sides = {"crop": 4, "size": 2, "frame_box": 4, "frame_crop": 2, "frame_size": 2}
        for field, count in sides.items():
            value = getattr(self, field)
            if value is not None:
                if len(value) != count:
                    raise ValueError(
                        f"protocol {self.name}: {field}={tuple(value)}, give {count} numbers [px]"
                    )
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
        if self.crop_fractions is not None:
            self._check_fractions(self.crop_fractions)
        if self.frame_box is not None:
            box = self.frame_box
            if not (len(box) == 4 and 0 <= box[0] < box[1] and 0 <= box[2] < box[3]):
                raise ValueError(
                    f"protocol {self.name}: frame_box={box} must be (top, bottom, left, right) [px]"
                )
        if self.paste and (self.frame_crop is None or self.frame_box or self.resize or self.frame_size):
            raise ValueError(
                f"protocol {self.name}: paste=True puts predictions of frame_crop back into the whole ground "
                "truth: give frame_crop, and no frame_box, resize or frame_size"
            )

    def _check_fractions(self, fractions: Sequence[float]) -> None:
        top, bottom, left, right = fractions if len(fractions) == 4 else (1.0, 0.0, 1.0, 0.0)
        if self.crop is not None or not (0 <= top < bottom <= 1 and 0 <= left < right <= 1):
            raise ValueError(
                f"protocol {self.name}: crop_fractions={tuple(fractions)} must be (top, bottom, left, right) "
                "between 0 and 1, and takes the place of crop"
            )
        object.__setattr__(self, "crop_fractions", tuple(float(share) for share in fractions))

    def check_ground_truth(self, kind: str) -> None:
        """Raise ValueError if a data set's ground truth is not of the kind that is scored."""
        if kind != self.ground_truth:
            raise ValueError(
                f"protocol {self.name} scores {self.ground_truth} ground truth, this data set has {kind} "
                "ground truth: choose a protocol that fits (configs/protocol)"
            )

    @property
    def changes_frames(self) -> bool:
        """Whether frames are cropped or resized before anything else."""
        return any(
            rule is not None for rule in (self.frame_box, self.resize, self.frame_crop, self.frame_size)
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
        height, width = depth.shape[-2:]
        for box in (self.crop_box(height, width), self.pasted_box(height, width)):
            if box is not None:
                top, bottom, left, right = box
                inside = torch.zeros_like(counts)
                inside[..., top:bottom, left:right] = True
                counts &= inside
        return counts

    def crop_box(self, height: int, width: int) -> tuple[int, ...] | None:
        """The box ``(top, bottom, left, right)`` [px] that is scored of ground truth of this size; None: all.

        Convention: fractions are cut off to whole pixels, as in Eigen's, monodepth's and BTS's code.
        """
        if self.crop_fractions is None:
            return None if self.crop is None else tuple(self.crop)
        top, bottom, left, right = self.crop_fractions
        return int(top * height), int(bottom * height), int(left * width), int(right * width)

    def pasted_box(self, height: int, width: int) -> tuple[int, int, int, int] | None:
        """Where in ground truth of this size the predictions belong, ``(top, bottom, left, right)`` [px].

        Raises:
            ValueError: the crop does not fit.
        """
        if not self.paste or self.frame_crop is None:
            return None
        rows, cols = self.frame_crop
        if rows > height or cols > width:
            raise ValueError(
                f"protocol {self.name}: frame_crop={tuple(self.frame_crop)} does not fit into ground "
                f"truth of {height}x{width}"
            )
        top, left = crop_corner((height, width), (rows, cols), self.frame_anchor)
        return top, top + rows, left, left + cols

    def placed(self, values: Tensor, size: Sequence[int]) -> Tensor:
        """Bring a picture or prediction ``(B, C, h, w)`` to the ground truth's ``(height, width)`` [px].

        Where ``paste`` is set it goes back to where the image was cut out, 0 around it.
        """
        box = self.pasted_box(size[0], size[1])
        top, bottom, left, right = box or (0, size[0], 0, size[1])
        if values.shape[-2:] != (bottom - top, right - left):
            values = F.interpolate(values, (bottom - top, right - left), **_MODES[self.interpolation])
        return values if box is None else F.pad(values, (left, size[1] - right, top, size[0] - bottom))

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
        prediction = self.placed(prediction, depth.shape[-2:])
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

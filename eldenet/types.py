"""The types that all packages share; no project imports here."""

from typing import TYPE_CHECKING, NamedTuple, NotRequired, TypedDict

import numpy as np

if TYPE_CHECKING:  # a process that only renders frames loads no torch
    from torch import Tensor


class FeatureInfo(NamedTuple):
    """Channels and stride of a backbone's feature map; decoders find their skips by ``stride``."""

    channels: int
    stride: int


class Frame(NamedTuple):
    """One frame as an adapter reads it from disk, before augmentation.

    Attributes:
        image: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` float32 [m], 0 = unknown.
        intrinsics: ``(3, 3)`` float64 [px of this image]; None if the data set has none.
        name: unique within the data set, the same on all machines.
        labels: semantic class of each pixel of ``depth``, ``(H, W)`` uint8, 255 = none; None if not read.
    """

    image: np.ndarray
    depth: np.ndarray
    intrinsics: np.ndarray | None
    name: str
    labels: np.ndarray | None = None


class DepthSample(TypedDict):
    """One training or evaluation sample; a batch has the same keys with a leading axis ``B``.

    Keys:
        image: ``(3, H, W)`` float RGB in [0, 1].
        depth: ``(1, H, W)`` float [m], 0 = unknown. In evaluation it has the resolution of the ground truth,
            which may differ from the image's.
        mask: ``(1, H, W)`` bool, True where the depth is known and within the data set's range.
        intrinsics: ``(3, 3)`` float [px of this image, after resize and crop]; zeros if unknown.
        name: the frame's name.
        labels: ``(1, H, W)`` uint8 semantic class of each pixel of ``depth``, 255 = none; only if the data
            set reads them.
        relative: bool scalar, True where depth is known up to a factor only; only in a mix.
    """

    image: "Tensor"
    depth: "Tensor"
    mask: "Tensor"
    intrinsics: "Tensor"
    name: str
    labels: NotRequired["Tensor"]
    relative: NotRequired["Tensor"]

"""What an evaluation protocol does to a camera's frame before anything else."""

from collections.abc import Sequence

import numpy as np

from eldenet.data.base import SPARSE
from eldenet.data.resize_crop import ResizeCrop
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.geometry import pinhole, resize_intrinsics
from eldenet.types import Frame


def frame_geometry(protocol: EvalProtocol, *, keep_depth: bool = False) -> ResizeCrop:
    """Return the transform that boxes, resizes and crops a frame as ``protocol`` says.

    Args:
        protocol: the rules.
        keep_depth: leave depth whole, see :class:`~eldenet.data.resize_crop.ResizeCrop`.
    """
    return ResizeCrop(
        box=protocol.frame_box,
        resize=protocol.resize,
        crop=protocol.frame_crop,
        anchor=protocol.frame_anchor,
        size=protocol.frame_size,
        sparse=protocol.ground_truth in SPARSE,
        keep_depth=keep_depth,
    )


def whole_frame_size(
    protocol: EvalProtocol, frame_size: tuple[int, int], input_size: Sequence[int] | None
) -> tuple[int, int]:
    """Return the ``(height, width)`` [px] of a whole frame at the scale at which a network sees its part.

    Args:
        protocol: cuts the part out of the frame.
        frame_size: ``(height, width)`` of the whole frame [px].
        input_size: ``(height, width)`` to which the part is resized for the network [px]; None: it is not.

    Example: KITTI's 375 x 1242, of which the lowest 352 x 1216 are seen at 176 x 608: 188 x 621.
    """
    blank = np.zeros((*frame_size, 3), np.uint8), np.zeros(frame_size, np.float32)
    part = frame_geometry(protocol)(Frame(*blank, pinhole(1, 1, 0, 0), "a training frame"))
    scale = part.intrinsics  # focal lengths were 1
    assert scale is not None
    if input_size is not None:
        height, width = input_size
        scale = resize_intrinsics(scale, part.depth.shape, (int(height), int(width)))
    return round(frame_size[0] * scale[1, 1]), round(frame_size[1] * scale[0, 0])

"""Cut and resize a camera frame as a protocol says: image, depth, labels and intrinsics together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eldenet.data.base import cut_frame, resize_frame
from eldenet.geometry import crop_corner
from eldenet.types import Frame


@dataclass(frozen=True, kw_only=True)
class ResizeCrop:
    """Cut out a box, resize (bilinear), crop and resize again: what a protocol does to a frame.

    Example: FastDepth scores 640x480 frames at ``resize=250 / 480, crop=(228, 304), size=(224, 224)``.

    Convention: see :func:`~eldenet.geometry.crop_corner` for where a crop starts.
    """

    box: Sequence[int] | None = None  # (top, bottom, left, right) of the part to keep [px], ends excluded
    # factor, which rounds the size down as sparse-to-dense does, or (height, width) [px]
    resize: float | Sequence[int] | None = None
    crop: Sequence[int] | None = None  # (height, width) of the part to keep [px]
    anchor: str = "center"  # of the crop: "center", or "bottom" for the lowest rows, centered horizontally
    size: Sequence[int] | None = None  # (height, width) of a last resize, after the crop [px]
    sparse: bool = False  # depth is single points: a resize keeps each one, the nearest if several meet
    # box and crop cut the image alone: its prediction is pasted into the whole frame
    keep_depth: bool = False

    def __call__(self, frame: Frame, generator: np.random.Generator | None = None) -> Frame:
        """Transform one frame; nothing here is random.

        Raises:
            ValueError: image and depth differ in size, or the box or crop does not fit into the frame.
        """
        check_same_size(frame)
        if self.box is not None:
            frame = self._window(frame, *self.box)
        height, width = frame.depth.shape
        if isinstance(self.resize, Sequence):
            frame = self._resized(frame, self.resize)
        elif self.resize is not None:
            frame = self._resized(frame, (_scaled(height, self.resize), _scaled(width, self.resize)))
        if self.crop is not None:
            rows, cols = self.crop
            height, width = frame.depth.shape
            if rows > height or cols > width:
                raise ValueError(
                    f"crop={[rows, cols]} does not fit into {frame.name}, which is {height}x{width} here"
                )
            top, left = crop_corner((height, width), (rows, cols), self.anchor)
            frame = self._window(frame, top, top + rows, left, left + cols)
        return frame if self.size is None else self._resized(frame, self.size)

    def _resized(self, frame: Frame, size: Sequence[int]) -> Frame:
        return resize_frame(frame, (size[0], size[1]), sparse=self.sparse, area=False)

    def _window(self, frame: Frame, top: int, bottom: int, left: int, right: int) -> Frame:
        height, width = frame.depth.shape
        if not (0 <= top < bottom <= height and 0 <= left < right <= width):
            raise ValueError(
                f"box={[top, bottom, left, right]} does not fit into {frame.name}, which is {height}x{width} "
                "here"
            )
        cut = cut_frame(frame, top, bottom, left, right)
        return cut._replace(depth=frame.depth, labels=frame.labels) if self.keep_depth else cut


def _scaled(length: int, factor: float) -> int:
    return int(length * factor + 1e-6)  # 480 * (250 / 480) must not round down to 249


def check_same_size(frame: Frame) -> None:
    """Raise ``ValueError`` if image and depth differ in size."""
    if frame.image.shape[:2] != frame.depth.shape:
        raise ValueError(
            f"{frame.name}: image {frame.image.shape[:2]} and depth {frame.depth.shape} differ in size: "
            "resize one of them first"
        )

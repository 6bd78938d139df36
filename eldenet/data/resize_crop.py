"""Cut out, resize and crop a camera frame: image, depth and intrinsics together."""

from collections.abc import Sequence

import numpy as np

from eldenet.geometry import crop_corner, crop_intrinsics, resize_intrinsics, resize_sparse
from eldenet.types import Frame


class ResizeCrop:
    """Cut out a box, resize, crop and resize again, image and depth alike: what a protocol does to a frame.

    Example: sparse-to-dense scores 640x480 frames at ``resize=0.5, crop=(228, 304)``, all nearest;
    FastDepth at ``resize=250 / 480``, the same crop, and ``size=(224, 224)``.

    Convention: see :func:`~eldenet.geometry.crop_corner` for where a crop starts.

    Args:
        box: ``(top, bottom, left, right)`` of the part to keep [px], ends excluded; None for all.
        resize: factor, or ``(height, width)`` [px], or None for none. A factor rounds the size down, as
            sparse-to-dense does.
        crop: ``(height, width)`` of the part to keep [px], or None for all.
        anchor: of the crop: "center", or "bottom" for the lowest rows, centered horizontally.
        interpolation: of the image: "nearest", "bilinear" or "area". Depth is always "nearest".
        size: ``(height, width)`` of a last resize, after the crop [px], or None for none.
        sparse: depth consists of single points: a resize keeps each one, the nearest if several meet.
        keep_depth: leave depth whole, as the prediction will be pasted back into the frame.

    Raises:
        ValueError: an argument is out of its range.
    """

    def __init__(
        self,
        *,
        box: Sequence[int] | None = None,
        resize: float | Sequence[int] | None = None,
        crop: Sequence[int] | None = None,
        anchor: str = "center",
        interpolation: str = "bilinear",
        size: Sequence[int] | None = None,
        sparse: bool = False,
        keep_depth: bool = False,
    ) -> None:
        if anchor not in ("center", "bottom"):
            raise ValueError(f"anchor={anchor!r}: give 'center' or 'bottom'")
        if keep_depth and (box is not None or resize is not None or size is not None):
            raise ValueError(
                "keep_depth=True allows a crop alone, no box, resize or size: the image must keep its scale"
            )
        if box is not None and len(box) != 4:
            raise ValueError(f"box={list(box)}: give [top, bottom, left, right] in pixels")
        if interpolation not in ("nearest", "bilinear", "area"):
            raise ValueError(f"interpolation={interpolation!r}: give 'nearest', 'bilinear' or 'area'")
        if isinstance(resize, int | float) and not resize > 0:
            raise ValueError(f"resize={resize}: give a factor above 0 or [height, width]")
        self.resize = resize if resize is None or isinstance(resize, int | float) else _pair(resize)
        self.crop = None if crop is None else _pair(crop)
        self.size = None if size is None else _pair(size)
        self.box = None if box is None else tuple(int(edge) for edge in box)
        self.anchor, self.interpolation = anchor, interpolation
        self.sparse, self.keep_depth = sparse, keep_depth

    def __call__(self, frame: Frame, generator: np.random.Generator | None = None) -> Frame:
        """Transform one frame; nothing here is random.

        Raises:
            ValueError: image and depth differ in size, or the box or crop does not fit into the frame.
        """
        check_same_size(frame)
        if self.box is not None:
            frame = self._window(frame, *self.box)
        height, width = frame.depth.shape
        if isinstance(self.resize, tuple):
            frame = self._resized(frame, self.resize)
        elif self.resize is not None:
            frame = self._resized(frame, (_scaled(height, self.resize), _scaled(width, self.resize)))
        if self.crop is not None:
            frame = self._cropped(frame, self.crop)
        return frame if self.size is None else self._resized(frame, self.size)

    def _resized(self, frame: Frame, size: tuple[int, int]) -> Frame:
        import cv2

        image, depth, intrinsics, name, labels = frame
        if depth.shape == size:
            return frame
        how = {
            "nearest": cv2.INTER_NEAREST_EXACT,
            "bilinear": cv2.INTER_LINEAR,
            "area": cv2.INTER_AREA,
        }[self.interpolation]
        if intrinsics is not None:
            intrinsics = resize_intrinsics(intrinsics, (depth.shape[0], depth.shape[1]), size)
        image = cv2.resize(image, size[::-1], interpolation=how)
        if self.sparse:
            depth = resize_sparse(depth, size)
        else:
            depth = cv2.resize(depth, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        if labels is not None:
            labels = cv2.resize(labels, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        return Frame(image, depth, intrinsics, name, labels)

    def _cropped(self, frame: Frame, crop: tuple[int, int]) -> Frame:
        (height, width), (rows, cols) = frame.depth.shape, crop
        if rows > height or cols > width:
            raise ValueError(
                f"crop={list(crop)} does not fit into {frame.name}, which is {height}x{width} here"
            )
        top, left = crop_corner((height, width), crop, self.anchor)
        return self._window(frame, top, top + rows, left, left + cols)

    def _window(self, frame: Frame, top: int, bottom: int, left: int, right: int) -> Frame:
        image, depth, intrinsics, name, labels = frame
        height, width = depth.shape
        if not (0 <= top < bottom <= height and 0 <= left < right <= width):
            raise ValueError(
                f"box={[top, bottom, left, right]} does not fit into {name}, which is {height}x{width} here"
            )
        if intrinsics is not None:
            intrinsics = crop_intrinsics(intrinsics, top, left)
        window = (slice(top, bottom), slice(left, right))
        if not self.keep_depth:
            depth, labels = depth[window], None if labels is None else labels[window]
        return Frame(image[window], depth, intrinsics, name, labels)


def _scaled(length: int, factor: float) -> int:
    return int(length * factor + 1e-6)  # 480 * (250 / 480) must not round down to 249


def _pair(size: Sequence[int]) -> tuple[int, int]:
    if len(size) != 2 or min(size) < 1:
        raise ValueError(f"a size is [height, width] in pixels, got {list(size)}")
    return int(size[0]), int(size[1])


def check_same_size(frame: Frame) -> None:
    """Raise ``ValueError`` if image and depth differ in size."""
    if frame.image.shape[:2] != frame.depth.shape:
        raise ValueError(
            f"{frame.name}: image {frame.image.shape[:2]} and depth {frame.depth.shape} differ in size: "
            "resize one of them first"
        )

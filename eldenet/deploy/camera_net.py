"""A network that takes a camera's frames: resizing and normalization are part of the graph."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class CameraNet(nn.Module):
    """Frames in, meters at the camera's size out, in one graph.

    Frames are resized as by :func:`eldenet.geometry.resize_image` (area where they shrink, else bilinear),
    but not rounded to whole gray levels. Depth is resized bilinearly, as by
    :class:`~eldenet.deploy.predictor.DepthPredictor`.

    Args:
        model: image -> meters, or a tuple of such maps.
        camera_size: ``(height, width)`` of the frames [px].
        input_size: ``(height, width)`` that the network sees [px].

    Raises:
        ValueError: one side would shrink and the other grow.
    """

    rows: Tensor
    cols: Tensor

    def __init__(self, model: nn.Module, camera_size: tuple[int, int], input_size: tuple[int, int]) -> None:
        super().__init__()
        pairs = list(zip(camera_size, input_size, strict=True))
        self.shrinks = any(seen < given for given, seen in pairs)
        if self.shrinks and any(seen > given for given, seen in pairs):
            raise ValueError(
                f"camera={list(camera_size)} would shrink one way and grow the other to size="
                f"{list(input_size)}: give sizes that are both smaller or both larger"
            )
        self.model, self.camera_size, self.input_size = model, camera_size, input_size
        whole = [given // seen for given, seen in pairs if given % seen == 0]
        self.blocks = (whole[0], whole[1]) if len(whole) == 2 else None
        rows, cols = (area_weights(given, seen) if self.shrinks else torch.eye(1) for given, seen in pairs)
        self.register_buffer("rows", rows)
        self.register_buffer("cols", cols.T.contiguous())

    def forward(self, frame: Tensor) -> Tensor | tuple[Tensor, ...]:
        """``frame (B, H, W, 3)`` uint8 RGB -> depth ``(B, 1, H, W)`` [m], or the maps of the model."""
        image = frame.permute(0, 3, 1, 2).float()
        if self.camera_size != self.input_size:
            image = self.resized(image)
        maps = self.model(image / 255.0)
        if isinstance(maps, tuple):
            return tuple(self.enlarged(each) for each in maps)
        return self.enlarged(maps)

    def enlarged(self, depth: Tensor) -> Tensor:
        """A map of the model at the camera's size."""
        if self.camera_size == self.input_size:
            return depth
        return F.interpolate(depth, size=self.camera_size, mode="bilinear", align_corners=False)

    def resized(self, image: Tensor) -> Tensor:
        """``image (B, 3, H, W)`` at ``input_size``: averaged over areas, or bilinear where it grows."""
        if not self.shrinks:
            return F.interpolate(image, size=self.input_size, mode="bilinear", align_corners=False)
        if self.blocks is not None:
            return F.avg_pool2d(image, self.blocks)
        return (self.rows @ image) @ self.cols


def area_weights(given: int, wanted: int) -> Tensor:
    """Return ``(wanted, given)``: the share of each given pixel in each wanted one; rows add up to 1."""
    edges = torch.arange(wanted + 1, dtype=torch.float64) * given / wanted
    pixels = torch.arange(given, dtype=torch.float64)
    covered = torch.minimum(edges[1:, None], pixels + 1) - torch.maximum(edges[:-1, None], pixels)
    return (covered.clamp_min(0) * wanted / given).float()

"""A trained network behind one call: camera frame in, metres out."""

import numpy as np
import torch
import torch.nn.functional as F

from eldenet.data.base import resize_frame
from eldenet.model import DepthNet
from eldenet.types import Frame

MAX_SIDE = 640
DEEPEST_MILLIMETRES = 65535


class DepthPredictor:
    """Depth of camera frames of any size, one at a time.

    ``predictor = DepthPredictor(eldenet.load("runs/my-run")); depth = predictor(frame)``

    The frame is resized to what the network was trained at, as in training and evaluation, and the depth is
    brought back to the frame's own size (bilinear), so that the frame's own intrinsics hold for it. A resize
    does not change depth. Metres are metres for cameras with about the training camera's field of view.

    Args:
        model: put into eval mode, and moved to ``device``.
        input_size: ``(height, width)`` that the network sees [px]; None: the size the model was trained at
            (``model.info["input_size"]``), or else the frame's own, its longer side at most ``max_side``.
        max_side: see ``input_size`` [px].
        device: where to compute.

    Raises:
        ValueError: a size is none.
    """

    def __init__(
        self,
        model: DepthNet,
        input_size: tuple[int, int] | None = None,
        *,
        max_side: int = MAX_SIDE,
        device: str | torch.device = "cpu",
    ) -> None:
        if input_size is None:
            input_size = model.info.get("input_size")
        if input_size is not None and (len(input_size) != 2 or min(input_size) < 1):
            raise ValueError(f"input_size={input_size}: give [height, width] in pixels, or null")
        if max_side < 1:
            raise ValueError(f"max_side={max_side}: give a number of pixels above 0")
        self.model = model.to(device).eval()
        self.input_size = None if input_size is None else (int(input_size[0]), int(input_size[1]))
        self.max_side = max_side
        self.device = torch.device(device)

    def size_for(self, height: int, width: int) -> tuple[int, int]:
        """``(height, width)`` at which the network sees a frame of ``height`` x ``width`` [px]."""
        if self.input_size is not None:
            return self.input_size
        scale = min(1.0, self.max_side / max(height, width))
        return max(1, round(height * scale)), max(1, round(width * scale))

    @torch.inference_mode()
    def __call__(self, frame: np.ndarray) -> np.ndarray:
        """``frame (H, W, 3)`` uint8 RGB -> depth ``(H, W)`` float32 [m].

        Raises:
            ValueError: the frame is not of that shape and type, or the network's depth is not finite.
        """
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8 or 0 in frame.shape:
            raise ValueError(f"frame is {frame.shape} {frame.dtype}, (H, W, 3) uint8 RGB is needed")
        height, width = frame.shape[:2]
        nothing = np.empty((0, 0), np.float32)
        seen = resize_frame(
            Frame(frame, nothing, None, ""), self.size_for(height, width), resize_depth=False
        ).image
        image = torch.from_numpy(np.ascontiguousarray(seen.transpose(2, 0, 1))).to(self.device)
        depth = self.model(image.float().div_(255.0)[None])
        if depth.shape[-2:] != (height, width):
            depth = F.interpolate(depth, size=(height, width), mode="bilinear", align_corners=False)
        if not torch.isfinite(depth).all():
            raise ValueError("the network's depth is not finite: its weights are damaged or diverged")
        return depth[0, 0].float().cpu().numpy()


def to_millimetres(depth: np.ndarray) -> np.ndarray:
    """Depth ``(H, W)`` [m] -> uint16 [mm]; 0 (unknown) for what is unknown, and beyond 65.535 m.

    :func:`eldenet.data.io.read_depth` with encoding "mm" reads it back.
    """
    millimetres = np.rint(np.nan_to_num(depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0) * 1000)
    fits = (millimetres > 0) & (millimetres <= DEEPEST_MILLIMETRES)
    return np.where(fits, millimetres, 0).astype(np.uint16)

"""A trained network behind one call: camera frame in, meters out. An exported file needs no torch."""

import threading
from typing import TYPE_CHECKING

import numpy as np

from eldenet.deploy.runtimes.base import Runtime
from eldenet.deploy.steady import SteadyFilter
from eldenet.geometry import resize_image
from eldenet.system.resources import full_fp32

if TYPE_CHECKING:
    import torch

    from eldenet.model import DepthNet

MAX_SIDE = 640
DEEPEST_MILLIMETERS = 65535


class DepthPredictor:
    """Depth of camera frames of any size, one at a time.

    ``predictor = DepthPredictor(eldenet.load("runs/my-run")); depth = predictor(frame)``

    Frames are resized to the scale of the training, and depth is resized back to the frame's own size
    (bilinear), so the frame's own intrinsics hold for it. Resizing does not change depth. A network that was
    trained on crops sees whole frames at the scale of those crops. Depth is metric for cameras with about the
    field of view of the training camera. Several threads may call one predictor.

    In a loop over a video, depth is steady: each frame is mixed with the frames before it, see
    :class:`~eldenet.deploy.steady.SteadyFilter`. A picture of another scene is predicted alone. Each thread
    has a video of its own. ``steady=False`` predicts every frame alone.

    Args:
        model: put into eval mode and moved to ``device``; or a network under another runtime
            (:func:`eldenet.deploy.runtimes.load`).
        input_size: ``(height, width)`` that the network sees [px]; None: the model's size for whole frames
            (:func:`eldenet.model.size_of_frames`), else the frame's own, limited by ``max_side``.
        max_side: longest side of frames without ``input_size`` [px].
        device: of a model; None: the CPU. A runtime has its own.
        steady: whether the frames are those of a video, whose depth must not flicker.

    Raises:
        ValueError: a size is invalid or not the one that a file was exported for, or a runtime gets a device.
    """

    def __init__(
        self,
        model: "DepthNet | Runtime",
        input_size: tuple[int, int] | None = None,
        *,
        max_side: int = MAX_SIDE,
        device: "str | torch.device | None" = None,
        steady: bool = True,
    ) -> None:
        if input_size is None and isinstance(model, Runtime):
            input_size = model.info.get("input_size")
        elif input_size is None:
            from eldenet.model import size_of_frames

            input_size = size_of_frames(model.info)
        if input_size is not None and (len(input_size) != 2 or min(input_size) < 1):
            raise ValueError(f"input_size={input_size}: give [height, width] in pixels, or null")
        if max_side < 1:
            raise ValueError(f"max_side={max_side}: give a number of pixels above 0")
        self.input_size = None if input_size is None else (int(input_size[0]), int(input_size[1]))
        self.max_side = max_side
        self.steady = steady
        self._filters = threading.local()
        if isinstance(model, Runtime):
            if device is not None:
                raise ValueError(
                    f"device={device} is for a model; this network runs under {model.runtime} on "
                    f"{model.device}: give device to eldenet.runtimes.load"
                )
            if model.fixed_size and self.input_size != model.fixed_size:
                raise ValueError(
                    f"input_size={list(self.input_size or ())}, but this file sees {list(model.fixed_size)} "
                    "only: export a file for that size"
                )
            self.model: DepthNet | Runtime = model
        else:
            import torch

            self.device = torch.device(device or "cpu")
            self.model = model.to(self.device).eval()
            if self.device.type == "cuda":
                full_fp32()  # as under other runtimes

    def size_for(self, height: int, width: int) -> tuple[int, int]:
        """``(height, width)`` [px] at which the network sees a frame of ``height`` x ``width``."""
        if self.input_size is not None:
            return self.input_size
        scale = min(1.0, self.max_side / max(height, width))
        return max(1, round(height * scale)), max(1, round(width * scale))

    def __call__(self, frame: np.ndarray) -> np.ndarray:
        """``frame (H, W, 3)`` uint8 RGB -> depth ``(H, W)`` float32 [m].

        Raises:
            ValueError: the frame has another shape or type, or the network's depth is not finite.
        """
        if frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8 or 0 in frame.shape:
            raise ValueError(f"frame is {frame.shape} {frame.dtype}, (H, W, 3) uint8 RGB is needed")
        size = (frame.shape[0], frame.shape[1])
        camera_size = self.model.camera_size if isinstance(self.model, Runtime) else None
        picture = resize_image(frame, camera_size or self.size_for(*size))
        depth = self._depth(picture)
        if not np.isfinite(depth).all():
            raise ValueError("the network's depth is not finite: its weights are damaged or diverged")
        if self.steady:
            depth = self._filter(picture, depth)
        return depth if depth.shape == size else enlarged(depth, size)

    def _depth(self, picture: np.ndarray) -> np.ndarray:
        """Depth at the network's own size."""
        if isinstance(self.model, Runtime):
            return self.model(picture[None] if self.model.camera_size else as_image(picture))[0, 0]
        import torch

        image = torch.from_numpy(as_image(picture))
        with torch.inference_mode():
            return self.model(image.to(self.device))[0, 0].float().cpu().numpy()

    @property
    def _filter(self) -> SteadyFilter:
        """The filter of this thread's video."""
        if not hasattr(self._filters, "steady"):
            self._filters.steady = SteadyFilter()
        steady: SteadyFilter = self._filters.steady
        return steady


def as_image(frame: np.ndarray) -> np.ndarray:
    """``frame (H, W, 3)`` uint8 -> ``(1, 3, H, W)`` float32 in [0, 1]."""
    return np.ascontiguousarray(frame.transpose(2, 0, 1))[None].astype(np.float32) / np.float32(255.0)


def enlarged(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Depth ``(h, w)`` at another size: bilinear, with half-pixel centers (``align_corners=False``)."""
    import cv2

    return cv2.resize(depth, size[::-1], interpolation=cv2.INTER_LINEAR)


def to_millimeters(depth: np.ndarray) -> np.ndarray:
    """Depth ``(H, W)`` [m] -> uint16 [mm]; 0 (unknown) where it is unknown or beyond 65.535 m.

    :func:`eldenet.data.io.read_depth` with encoding "mm" reads it back.
    """
    millimeters = np.rint(np.nan_to_num(depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0) * 1000)
    fits = (millimeters > 0) & (millimeters <= DEEPEST_MILLIMETERS)
    return np.where(fits, millimeters, 0).astype(np.uint16)

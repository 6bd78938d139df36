"""A trained network in one call: camera frame in, meters out. An exported file needs no torch."""

import functools
import logging
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.deploy.runtimes.base import Runtime, check_depth, check_known_lens
from eldenet.deploy.sharpen import sharpen
from eldenet.deploy.steady import SteadyFilter
from eldenet.geometry import BORDER_COLOR, fit_into, focal_length, grid_margins, resize_image, size_of_aspect
from eldenet.system.resources import check_torch_device, full_fp32
from eldenet.uncertainty import NO_SIGMA, DepthEstimate

if TYPE_CHECKING:
    import torch

    from eldenet.model import DepthNet

MAX_SIDE = 640  # of frames for a network without a training size [px]
LEAST_SIDE = 8  # of a frame [px]: smaller ones show nothing
NO_FOCAL = (
    "this network ignores focal lengths: the camera does not change the depth, whose meters are right for "
    "the lens of its training only (to change that, train with canonical_focal)"
)


class DepthPredictor:
    """Depth of camera frames of any size, one at a time.

    ``predictor = DepthPredictor(eldenet.load("runs/my-run")); depth = predictor(frame)``

    Frames are resized to the scale of the training, keeping their aspect ratio, and depth is resized back to
    the frame's own size (bilinear), so the frame's intrinsics apply to it. A frame whose aspect differs from
    the training's gets as many pixels in its own aspect; for a file of fixed size it gets a border. A network
    that was trained on crops sees whole frames at the scale of those crops.

    Depth is in meters for the camera given with each frame. Without one, the network's canonical camera is
    assumed, with the same field of view at any ``input_size``. A network without ``canonical_px`` ignores
    focal lengths: its meters are right for about the field of view of its training camera. Several threads
    may call one predictor.

    In a loop over a video, depth does not flicker: each frame is mixed with the frames before it, see
    :class:`~eldenet.deploy.steady.SteadyFilter`. A picture of another scene or camera is predicted on its
    own. Each thread has its own video. ``steady=False`` predicts every frame on its own.

    Args:
        model: a network, of which a copy runs, made for inference (:func:`eldenet.deploy.fold.fold`); or one
            under another runtime (:func:`eldenet.deploy.runtimes.load`).
        input_size: ``(height, width)`` that the network sees [px]; None: the model's size for whole frames
            (:func:`eldenet.model.size_of_frames`), else the frame's own, limited by ``max_side``.
        max_side: longest side of frames without ``input_size`` [px].
        device: for a model; None: the CPU. A runtime has its own device.
        steady: whether the frames come from a video, whose depth must not flicker.
        sharp: move the edges of the depth to the picture's (:mod:`eldenet.deploy.sharpen`). This takes longer
            than the network, so it is for single pictures.
        uncertainty: return a :class:`~eldenet.uncertainty.DepthEstimate`: depth, sigma and intervals.

    Raises:
        ValueError: ``uncertainty`` of a network without sigma, a size is invalid or not the one that a
            file was exported for, a runtime gets a device, or torch does not see the device.
    """

    def __init__(
        self,
        model: "DepthNet | Runtime",
        input_size: tuple[int, int] | None = None,
        *,
        max_side: int = MAX_SIDE,
        device: "str | torch.device | None" = None,
        steady: bool = True,
        sharp: bool = False,
        uncertainty: bool = False,
    ) -> None:
        if isinstance(model, str | Path):
            raise ValueError(
                f"model={str(model)!r} is a name, not a network: give eldenet.load(name), or "
                "eldenet.runtimes.load(file) for an exported file; pass pictures to the predictor itself"
            )
        if uncertainty and model.distribution is None:
            raise ValueError(f"uncertainty=True: {NO_SIGMA}")
        self.uncertainty = uncertainty
        if isinstance(model, Runtime):
            trained, usual = model.trained_size, model.info.get("input_size")
        else:
            from eldenet.model import size_of_frames

            trained = usual = size_of_frames(model.info)
        self._trained_size = None if trained is None else (int(trained[0]), int(trained[1]))
        input_size = usual if input_size is None else input_size
        if input_size is not None and (np.shape(input_size) != (2,) or min(input_size) < 1):
            raise ValueError(f"input_size={input_size}: give [height, width] in pixels, or null")
        self.input_size = None if input_size is None else (int(input_size[0]), int(input_size[1]))
        self.max_side = max_side
        self.steady, self.sharp = steady, sharp
        self._filters = threading.local()
        self.stretch = float(model.info.get("stretch") or 1.0)
        self._said = False  # that the network ignores cameras
        if isinstance(model, Runtime):
            if device is not None:
                raise ValueError(
                    f"device={device} is for models, but this network runs under {model.runtime} on "
                    f"{model.device}: give device to eldenet.runtimes.load"
                )
            if model.fixed_size and self.input_size != model.fixed_size:
                raise ValueError(
                    f"input_size={list(self.input_size or ())}, but this file only takes "
                    f"{list(model.fixed_size)}: export a file for that size"
                )
            self.model: DepthNet | Runtime = model
        else:
            import torch

            from eldenet.deploy.fold import fold

            self.device = torch.device("cpu" if device is None else device)
            if self.device.type == "cuda":
                check_torch_device("cuda")
                full_fp32()  # as under other runtimes
            self.model = fold(model).to(self.device).to(memory_format=torch.channels_last)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or another process needs: everything but the videos of the threads here."""
        return {name: value for name, value in vars(self).items() if name != "_filters"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start without a video."""
        vars(self).update(state, _filters=threading.local())

    @property
    def canonical_px(self) -> float | None:
        """Focal length of the network's canonical camera [px]; None: it ignores focal lengths."""
        return self.model.canonical_px

    @property
    def known_fov(self) -> float | None:
        """Horizontal field of view of the one camera that the file is for [degrees]; None: any."""
        return getattr(self.model, "fov", None)

    @property
    def max_depth(self) -> float | None:
        """Largest depth that it can predict [m], for its canonical camera if it has one; None: any."""
        return self.model.max_depth if isinstance(self.model, Runtime) else self.model.head.max_depth

    def size_for(self, height: int, width: int) -> tuple[int, int]:
        """``(height, width)`` [px] at which the network sees a frame of ``height`` x ``width``."""
        if self.input_size is not None:
            if isinstance(self.model, Runtime) and self.model.fixed_size is not None:
                return self.input_size
            return size_of_aspect(self.input_size, (height, width * self.stretch))
        scale = min(1.0, self.max_side / max(height, width))
        return max(1, round(height * scale)), max(1, round(width * scale))

    def __call__(
        self,
        frame: np.ndarray,
        *,
        intrinsics: "Sequence[float] | np.ndarray | None" = None,
        focal: float | None = None,
        fov: float | None = None,
    ) -> Any:
        """``frame (H, W, 3)`` uint8 RGB -> depth ``(H, W)`` float32 [m], and sigma if ``uncertainty``.

        Args:
            intrinsics: ``(fx, fy, cx, cy)`` or ``(3, 3)`` of the frame [px]; only fx is used.
            focal: fx of the frame instead [px].
            fov: horizontal field of view instead [degrees]. Without any of them: the canonical camera.

        Raises:
            ValueError: the frame has another shape or type or is smaller than 8 px, its camera is given twice
                or is that of no lens (:func:`eldenet.geometry.check_intrinsics`), the file is for another
                lens or wider frames, or what the network answers is no depth.
        """
        check_frame(frame)
        size = (frame.shape[0], frame.shape[1])
        if min(size) < LEAST_SIDE:
            raise ValueError(
                f"frame is {size[0]} x {size[1]} px: give a picture of {LEAST_SIDE} px or more to each side"
            )
        focal = focal_length(intrinsics, fov, size, focal)
        if focal is not None and self.known_fov is not None:
            check_known_lens(self.known_fov, focal, size[1])
        elif focal is not None and self.canonical_px is None and not self._said:
            self._said = True
            logging.getLogger("eldenet").warning(NO_FOCAL)
        picture, (depth, *sigma) = self._maps(frame, focal)
        check_depth(depth)
        spread = [each / depth for each in sigma]  # what follows changes depth, and sigma in proportion
        if self.steady:
            depth = self._filter_of((size, focal))(picture, depth)
        if self.sharp:
            depth = sharpen(depth, frame)
        depth, *spread = (each if each.shape == size else enlarged(each, size) for each in (depth, *spread))
        return DepthEstimate(depth, depth * spread[0], self.model.distribution) if spread else depth

    def _maps(self, frame: np.ndarray, focal: float | None) -> tuple[np.ndarray, list[np.ndarray]]:
        """The frame as the network sees it, without border or padding, and its depth and sigma [m] there.

        ``(h, w, 3)`` uint8 RGB, and a map ``(h, w)`` or two; sigma only if ``uncertainty``.
        """
        height, width = frame.shape[:2]
        camera = self.model.camera_size if isinstance(self.model, Runtime) else None
        size = camera or self.size_for(height, width)
        top, bottom, left, right = fit_into(size, (height, width if camera else width * self.stretch))
        if self.known_fov is not None and right - left < size[1]:
            raise ValueError(
                f"frame is {height} x {width} px (height, width), narrower than {size[0]} x {size[1]}, "
                f"across which the file's fov={self.known_fov:g} reaches: give frames of that shape, or "
                "export a file for these"
            )
        picture = image = resize_image(frame, (bottom - top, right - left))
        if image.shape[:2] != size:
            filled = np.full((*size, 3), BORDER_COLOR, image.dtype)
            filled[top:bottom, left:right] = image
            image = filled
        if camera is None and size != self.input_size:
            above, _, before, _ = grid_margins(size)
            top, bottom, left, right = top + above, bottom + above, left + before, right + before
            image = padded(image)
        lens = None if focal is None else focal * (right - left) / width
        if isinstance(self.model, Runtime):
            given = image[None] if camera else as_image(image)
            estimate: Any = self.model.predict(given, lens) if self.uncertainty else [self.model(given, lens)]
            maps = [each[0, 0] for each in estimate[: 1 + self.uncertainty]]
        else:
            import torch

            with torch.inference_mode():
                tensor = torch.from_numpy(as_image(image)).to(self.device)
                found: Any = (
                    self.model.predict(tensor, lens) if self.uncertainty else [self.model(tensor, lens)]
                )
                maps = [each[0, 0].float().cpu().numpy() for each in found[: 1 + self.uncertainty]]
        maps = [each[top:bottom, left:right] for each in maps]
        if lens is None and self.canonical_px is not None and self._trained_size is not None:
            # the canonical camera's pixels are those of the training, with as many across a frame as there
            usual = size_of_aspect(self._trained_size, (height, width * self.stretch))[1]
            network_width = self.input_size[1] if camera and self.input_size else size[1]
            ratio = np.float32((right - left) / size[1] * network_width / usual)
            maps = [each * ratio for each in maps]
        return picture, maps

    def _filter_of(self, camera: tuple[tuple[int, int], float | None]) -> SteadyFilter:
        """The filter of this thread's video; another camera (frame size and fx) starts a new video."""
        if getattr(self._filters, "camera", None) != camera:
            self._filters.camera, self._filters.steady = camera, SteadyFilter()
        steady: SteadyFilter = self._filters.steady
        return steady


def check_frame(frame: np.ndarray) -> None:
    """Raise ValueError unless ``frame`` is ``(H, W, 3)`` uint8."""
    is_array = isinstance(frame, np.ndarray)
    if not is_array or frame.shape[2:] != (3,) or frame.dtype != np.uint8 or not frame.size:
        given = f"{frame.shape} {frame.dtype}" if is_array else type(frame).__name__
        raise ValueError(f"frame is {given}: give the picture, (H, W, 3) uint8 RGB")


def for_camera(
    predictor: Callable[[np.ndarray], np.ndarray], intrinsics: np.ndarray
) -> Callable[[np.ndarray], np.ndarray]:
    """Return ``predictor`` for frames of one camera if it knows lenses; otherwise unchanged."""
    if isinstance(predictor, DepthPredictor) and (predictor.canonical_px or predictor.known_fov):
        return functools.partial(predictor, intrinsics=intrinsics)
    return predictor


def as_image(frame: np.ndarray) -> np.ndarray:
    """``frame (H, W, 3)`` uint8 -> ``(1, 3, H, W)`` float32 in [0, 1]."""
    return np.ascontiguousarray(frame.transpose(2, 0, 1))[None].astype(np.float32) / np.float32(255.0)


def padded(image: np.ndarray) -> np.ndarray:
    """Repeat the rows and columns at the edges of ``(H, W, 3)`` until both sides are multiples of ``GRID``.

    Networks round odd sizes up, which makes the depth of the last rows wrong.
    """
    import cv2

    return np.asarray(cv2.copyMakeBorder(image, *grid_margins(image.shape[:2]), cv2.BORDER_REPLICATE))


def enlarged(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Depth ``(h, w)`` at another size: bilinear, with half-pixel centers (``align_corners=False``)."""
    import cv2

    return cv2.resize(depth, size[::-1], interpolation=cv2.INTER_LINEAR)

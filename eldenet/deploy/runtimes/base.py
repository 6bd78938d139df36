"""The base class of all runtimes: images in, meters out."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from eldenet.geometry import check_one_per_image, focal_of_fov
from eldenet.system.checks import check_largest, check_size, one_of
from eldenet.system.errors import reading
from eldenet.system.files import parse_json
from eldenet.system.onnx_files import EXPORT_AGAIN
from eldenet.uncertainty import DepthEstimate

if TYPE_CHECKING:
    from torch import Tensor

    Focal = float | np.ndarray | Tensor | None

FOCAL = "focal"  # name of the second input of files whose network sees rays
PRECISIONS = ("fp32", "bf16", "fp16", "int8")
SAME_LENS = 0.02  # relative difference of focal lengths


class Runtime:
    """A network ready to run: ``(B, 3, H, W)`` float RGB in [0, 1] -> ``(B, 1, H, W)`` [m].

    If it has ``canonical_px``, meters depend on the focal length, which a call may be given. One with a
    ``distribution`` also predicts its sigma, see :meth:`predict`.

    A file exported with ``camera=[h,w]`` takes the camera's frames, ``(B, H, W, 3)`` uint8 RGB, instead.
    Several threads may call one runtime: each gets the depth of its own images.

    Args:
        source: of the metadata, for errors: the file.
        shape: of the input, as the file states it; a side of any length is no int.

    Attributes:
        runtime: "torch", "torch_channels_last", "torch_compile", "onnxruntime" or "openvino".
        precision: "fp32", "bf16", "fp16" or "int8".
        threads: on a CPU.
        device: "cpu" or the accelerator's name.
        metadata: of the file (:func:`eldenet.deploy.metadata.describe`).
        info: like ``DepthNet.info``: the size that the network sees [px], its stretch, and the model's name.
        shape: of the input; None for a side of any length.
        fixed_batch: the only number of images that it takes at once; None: any.
        fixed_size: the only ``(height, width)`` that the network can see [px]; None: any, and
            ``info["input_size"]`` is the one that it was exported for.
        camera_size: ``(height, width)`` of the frames that it takes [px]; None: it takes images.
        takes_frames: whether it takes frames.
        whole_frame_size: ``(height, width)`` [px] of a whole frame at the training's scale; None: it did not
            crop.
        trained_size: ``(height, width)`` [px] of a whole frame at the training's scale, also of a training
            that did not crop; None: not stated.
        canonical_px: focal length of the canonical camera [px]; None: it ignores focal lengths, and meters
            are those of the training's lens.
        fov: horizontal field of view [degrees] of the one camera that the file was exported for; None: any.
        sees_rays: whether the network itself takes the focal length; others only have their depth scaled.
        max_depth: largest depth that the network can predict [m]; None: not stated.
        distribution: of the error in ln depth, "laplace" or "gaussian"; None: it predicts no sigma.
        params: number of weights, or None.
        gmacs: billions of multiply-adds for one image, or None.
        reopen: opens its file again; a copy or another process (pickle) does that. None: there is no file.

    Raises:
        ValueError: the metadata is damaged.
    """

    runtime = ""
    reopen: Callable[[], "Runtime"] | None = None

    def __init__(
        self,
        precision: str,
        threads: int,
        device: str,
        metadata: Mapping[str, str],
        source: object = "metadata",
        shape: Sequence[Any] = (None, 3, None, None),
        sees_rays: bool = False,
    ) -> None:
        self.precision, self.threads, self.device, self.sees_rays = precision, threads, device, sees_rays
        self.metadata = dict(metadata)
        self.shape = tuple(side if isinstance(side, int) else None for side in shape)
        self.fixed_batch = self.shape[0]
        with reading(source, "exported network", EXPORT_AGAIN):
            self.camera_size, self.whole_frame_size, self.trained_size, self.fixed_size = map(
                self._size, ("camera_size", "whole_frame_size", "trained_size", "input_size")
            )
            focal, width = map(self._number, ("canonical_focal", "canonical_width"))
            self.canonical_px = None if focal is None or width is None else focal * width
            self.max_depth, self.params, self.gmacs, stretch, self.fov = map(
                self._number, ("max_depth", "params", "gmacs", "stretch", "fov")
            )
            self.distribution: str | None = self._value("distribution")
        self.takes_frames = self.camera_size is not None
        info = {"input_size": self.fixed_size, "stretch": stretch, "model_name": self.metadata.get("model")}
        self.info: dict[str, Any] = {key: value for key, value in info.items() if value is not None}
        if self.shape[2:] == (None, None):
            self.fixed_size = None

    def __reduce__(self) -> Any:
        """Return how another process, or a copy, opens the same file."""
        if self.reopen is None:
            raise TypeError("this network has no file: write one with eldenet export, and load that")
        return self.reopen, ()

    def _value(self, name: str) -> Any:
        return parse_json(self.metadata.get(name, "null"), name)

    def _size(self, name: str) -> tuple[int, int] | None:
        return check_size(name, self._value(name))

    def _number(self, name: str) -> float | None:
        value = self._value(name)
        if value is not None and not (type(value) in (int, float) and 0 < value < math.inf):
            raise ValueError(f"{name} is {value!r}, but must be null or a number above 0")
        return value

    def run(self, images: np.ndarray, focal: np.ndarray | None = None) -> np.ndarray:
        """Run arrays that :meth:`__call__` has checked."""
        return self.run_maps(images, focal)[0]

    def run_maps(self, images: np.ndarray, focal: np.ndarray | None = None) -> list[np.ndarray]:
        """Depth of checked arrays, and sigma if the network predicts it.

        ``focal (B,)`` is for a network that sees rays, which answers in meters; others in canonical ones.
        """
        raise NotImplementedError

    def prepared(self, images: np.ndarray) -> Any:
        """Images as :meth:`run_prepared` takes them, on this runtime's device and in its layout."""
        return images

    def run_prepared(self, images: Any) -> Any:
        """Run the result of :meth:`prepared`, for timing."""
        return self.run(images)

    def synchronize(self) -> None:
        """Wait for the device."""

    @overload
    def __call__(self, images: np.ndarray, focal: "Focal" = None) -> np.ndarray: ...
    @overload
    def __call__(self, images: "Tensor", focal: "Focal" = None) -> "Tensor": ...
    def __call__(self, images: "np.ndarray | Tensor", focal: "Focal" = None) -> "np.ndarray | Tensor":
        """Return meters as an array for an array, and as a tensor on its device for a tensor.

        Args:
            images: float32 RGB in [0, 1], or uint8 frames.
            focal: fx [px of ``images``], a number or ``(B,)``; 0, NaN and None: the canonical camera's.

        Raises:
            ValueError: this network takes images of another shape, type or range, another number of focal
                lengths, or another lens, or does not answer with depth.
        """
        (depth,) = self._meters(images, focal, self.run)
        if isinstance(images, np.ndarray):
            return depth
        import torch

        return torch.from_numpy(depth).to(images.device)

    def predict(self, images: np.ndarray, focal: "Focal" = None) -> DepthEstimate:
        """Depth and sigma ``(B, 1, H, W)`` [m]; sigma is None if the network predicts none.

        Arguments and errors are those of a call.
        """
        depth, *sigma = self._meters(images, focal, self.run_maps)
        return DepthEstimate(depth, sigma[0] if sigma else None, self.distribution)

    def _meters(self, images: Any, focal: Any, run: Callable[..., Any]) -> list[np.ndarray]:
        """What ``run`` (:meth:`run` or :meth:`run_maps`) answers, as a list of maps in meters."""
        checked = self._checked(images)
        lens = None
        if focal is not None and self.fov is not None:
            width = checked.shape[2 if self.takes_frames else 3]
            for fx in np.asarray(focal, np.float32).reshape(-1).tolist():
                if fx > 0:
                    check_known_lens(self.fov, fx, width)
        if focal is not None and self.canonical_px is not None:
            check_one_per_image(focal, len(checked))
            given = np.asarray(focal, np.float32).reshape(-1)
            lens = np.broadcast_to(np.where(given > 0, given, 0), len(checked)).astype(np.float32)
        found = run(checked, lens) if self.sees_rays else run(checked)
        maps = found if isinstance(found, list) else [found]
        check_depth(maps[0])
        if lens is None or self.sees_rays:
            return maps
        # a file that takes frames reduces them: its network sees fewer pixels
        seen = self.fixed_size[1] / self.camera_size[1] if self.camera_size and self.fixed_size else 1.0
        ratio = lens * np.float32(seen / self.canonical_px)  # type: ignore[operator]
        ratio = np.where(ratio > 0, ratio, np.float32(1)).reshape(-1, 1, 1, 1)
        return [each * ratio for each in maps]

    def _checked(self, images: "np.ndarray | Tensor") -> np.ndarray:
        given = images if isinstance(images, np.ndarray) else images.detach().cpu().numpy()
        wanted = np.uint8 if self.takes_frames else np.float32
        fits = [side in (None, has) for side, has in zip(self.shape, given.shape, strict=False)]
        if given.dtype != wanted or given.ndim != len(self.shape) or not all(fits):
            sides = ", ".join("any" if side is None else str(side) for side in self.shape)
            kind = "uint8 RGB frames" if self.takes_frames else "float32 RGB images in [0, 1]"
            raise ValueError(
                f"images are {given.shape} {given.dtype}; this network takes {kind} of shape ({sides}): give "
                "such, or export another file"
            )
        if given.size and not self.takes_frames:
            check_largest(given.max())
        return np.ascontiguousarray(given)


def check_depth(depth: np.ndarray) -> None:
    """Refuse what no network answers that predicts depth ``(B, 1, H, W)`` or ``(H, W)`` [m].

    Raises:
        ValueError: several channels, whole numbers, or depth that is not finite or not above 0.
    """
    if (
        (depth.ndim == 4 and depth.shape[1] != 1)
        or depth.ndim not in (2, 4)
        or depth.dtype.kind != "f"
        or not depth.size
    ):
        raise ValueError(
            f"the network answers with {depth.shape} {depth.dtype}, which is no depth: export one that maps "
            "images to one float map (B, 1, H, W) of meters"
        )
    if not np.isfinite(depth).all():
        raise ValueError("the network's depth is not finite: its weights are damaged or diverged")
    if not (depth > 0).all():
        raise ValueError(
            f"the network's depth is {depth.min():.3g} to {depth.max():.3g} m, but must be above 0: is it a "
            "disparity, or a map before its last layer? Export one that answers in meters"
        )


def check_known_lens(fov: float, focal: float, width: int) -> None:
    """Refuse fx [px] of pictures of a ``width`` that is not that of the file's ``fov`` [degrees].

    Raises:
        ValueError: they differ by more than 2 %.
    """
    if abs(focal / focal_of_fov(fov, width) - 1) > SAME_LENS:
        given = math.degrees(2 * math.atan(width / 2 / focal))
        raise ValueError(
            f"pictures {width} px wide with fx {focal:.0f} px have fov={given:.0f}, but this file was "
            f"exported for fov={fov:g}: give pictures of that camera, or export a file for this one"
        )


def check_inputs(path: str | Path, shape: Sequence[Any], others: Sequence[str]) -> None:
    """Raise ValueError unless a file takes images or frames and at most focal lengths beside them.

    Args:
        shape: of its first input; a side of any length is no int.
        others: names of its other inputs.
    """
    if len(shape) != 4:
        sides = ", ".join(str(side) if isinstance(side, int) else "any" for side in shape)
        raise ValueError(
            f"{path} takes input of shape ({sides}): give a file that takes images (B, 3, H, W) or frames "
            "(B, H, W, 3)"
        )
    if list(others) not in ([], [FOCAL]):
        raise ValueError(
            f"{path} takes {', '.join(others)} beside its images: give a file that takes images, and at most "
            f"{FOCAL} beside them"
        )


def unknown_focal(images: np.ndarray) -> np.ndarray:
    """What a network that sees rays is given for images of unknown lenses: ``(B,)`` zeros."""
    return np.zeros(len(images), np.float32)


def check_precision(precision: str, allowed: tuple[str, ...], runtime: str, advice: str) -> None:
    """Raise ValueError unless a precision is among those ``allowed``, which ``runtime`` supports here."""
    one_of("precision", precision, PRECISIONS)
    if precision not in allowed:
        raise ValueError(f"{runtime} does not support {precision} here, only {', '.join(allowed)}: {advice}")

"""What every runtime is: images in, meters out, and a record of how."""

import json
from collections.abc import Mapping
from typing import Any, overload

import numpy as np
import torch
from torch import Tensor

PRECISIONS = ("fp32", "bf16", "fp16", "int8")


class Runtime:
    """A network ready to run: ``(B, 3, H, W)`` float RGB in [0, 1] -> ``(B, 1, H, W)`` [m].

    A file exported with ``camera=[h,w]`` takes the camera's frames, ``(B, H, W, 3)`` uint8 RGB, instead.

    Attributes:
        runtime: "torch", "torch_channels_last", "torch_compile", "onnxruntime" or "openvino".
        precision: "fp32", "bf16", "fp16" or "int8".
        threads: on a CPU.
        device: "cpu" or the accelerator's name.
        metadata: what the file says of itself (:func:`eldenet.deploy.files.describe`).
        takes_frames: whether it takes uint8 frames.
    """

    runtime = ""

    def __init__(self, precision: str, threads: int, device: str, metadata: Mapping[str, str]) -> None:
        self.precision, self.threads, self.device = precision, threads, device
        self.metadata = dict(metadata)
        self.takes_frames = self._sizes("camera_size") is not None

    def _sizes(self, key: str) -> tuple[int, int] | None:
        value = json.loads(self.metadata.get(key, "null"))
        return None if value is None else (int(value[0]), int(value[1]))

    @property
    def info(self) -> dict[str, Any]:
        """As ``DepthNet.info``: the size that the network sees [px], and the model's name."""
        known = {"input_size": self._sizes("input_size"), "model_name": self.metadata.get("model")}
        return {key: value for key, value in known.items() if value is not None}

    @property
    def camera_size(self) -> tuple[int, int] | None:
        """``(height, width)`` of the frames it takes [px], or None."""
        return self._sizes("camera_size")

    @property
    def whole_frame_size(self) -> tuple[int, int] | None:
        """``(height, width)`` [px] of a whole frame at the scale of a training that cropped, else None."""
        return self._sizes("whole_frame_size")

    @property
    def fixed_size(self) -> tuple[int, int] | None:
        """``(height, width)`` that the network sees [px] where it can see no other, else None."""
        return self._sizes("input_size")

    @property
    def fixed_batch(self) -> int | None:
        """Images that it takes at once where it can take no other number, else None."""
        return None

    def run(self, images: np.ndarray) -> np.ndarray:
        """Arrays in, arrays out; what :meth:`__call__` checks and wraps."""
        raise NotImplementedError

    def prepared(self, images: np.ndarray) -> Any:
        """The input as this runtime likes it best, for timing: on its device, in its layout."""
        return images

    def run_prepared(self, images: Any) -> Any:
        """Run what :meth:`prepared` gave; for timing."""
        return self.run(images)

    def synchronise(self) -> None:
        """Wait for the device."""

    @overload
    def __call__(self, images: np.ndarray) -> np.ndarray: ...
    @overload
    def __call__(self, images: Tensor) -> Tensor: ...
    def __call__(self, images: np.ndarray | Tensor) -> np.ndarray | Tensor:
        """Images -> meters, of the kind (array or tensor, on its device) that was given.

        Raises:
            ValueError: images of another shape or type than this network takes.
        """
        given = images.detach().cpu().numpy() if isinstance(images, Tensor) else images
        wanted, channels = (np.uint8, 3) if self.takes_frames else (np.float32, 1)
        if given.ndim != 4 or given.shape[channels] != 3 or given.dtype != wanted:
            raise ValueError(
                f"images are {given.shape} {given.dtype}; this network takes "
                + ("(B, H, W, 3) uint8 RGB frames" if self.takes_frames else "(B, 3, H, W) float32 in [0, 1]")
            )
        depth = self.run(np.ascontiguousarray(given))
        return torch.from_numpy(depth).to(images.device) if isinstance(images, Tensor) else depth


def refuse(precision: str, allowed: tuple[str, ...], runtime: str, advice: str) -> None:
    """Raise ValueError for a precision that a runtime does not have."""
    if precision not in PRECISIONS:
        raise ValueError(f"precision={precision!r}: choose {', '.join(PRECISIONS)}")
    if precision not in allowed:
        raise ValueError(f"{runtime} here has no {precision}, only {', '.join(allowed)}: {advice}")

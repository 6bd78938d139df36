"""A third-party depth network in an ONNX file, used as a teacher for pictures without depth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, from_numpy

from eldenet.system.checks import one_of
from eldenet.system.digests import file_digest

NEAREST_INVERSE, FARTHEST_INVERSE = 1.1, 0.1  # [1/m] that a map of disparities is stretched to


class OnnxTeacher:
    """An ``.onnx`` file that maps images ``(1, 3, H, W)`` to one map, with its own preprocessing.

    Args:
        input_size: ``(height, width)`` of the images it takes [px].
        mean: subtracted from RGB in [0, 1], per channel.
        std: then divides, per channel.
        output: "depth", or "disparity" of any scale and shift (MiDaS, Depth Anything), which is stretched to
            0.1 to 1.1 per meter: use it with ``relative: true`` and a loss in ``space: inverse``.
        scale: meters per unit of depth.

    Raises:
        ValueError: an unknown output, or ONNX Runtime cannot load the file.
        FileNotFoundError: there is no such file.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        input_size: Sequence[int],
        mean: Sequence[float] = (0.0, 0.0, 0.0),
        std: Sequence[float] = (1.0, 1.0, 1.0),
        output: str = "depth",
        scale: float = 1.0,
    ) -> None:
        from eldenet.deploy.runtimes.onnx import OnnxRuntime

        one_of("output", output, ("depth", "disparity"))
        self.path, self.output, self.scale = Path(path).expanduser(), output, scale
        self.input_size = (int(input_size[0]), int(input_size[1]))
        self.mean, self.std = (np.array(v, np.float32).reshape(1, 3, 1, 1) for v in (mean, std))
        self._digest = file_digest(self.path)[:16]
        self._runtime = OnnxRuntime(self.path)

    def __call__(self, image: Tensor) -> Tensor:
        """Images ``(B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m], at the map's own size."""
        images = (image.numpy() - self.mean) / self.std
        maps = np.stack([self._map(one)[None] for one in images])
        if self.output == "depth":
            return from_numpy(maps * np.float32(self.scale))
        low, high = maps.min((2, 3), keepdims=True), maps.max((2, 3), keepdims=True)
        share = (maps - low) / np.maximum(high - low, 1e-6)
        return from_numpy(1 / (FARTHEST_INVERSE + (NEAREST_INVERSE - FARTHEST_INVERSE) * share))

    def _map(self, image: np.ndarray) -> np.ndarray:
        answer = np.asarray(self._runtime.run(image[None]))
        is_map = answer.dtype.kind == "f" and answer.size == np.prod(answer.shape[-2:])
        found = answer.astype(np.float32)
        if not is_map or not np.isfinite(found).all() or (self.output == "depth" and not (found > 0).any()):
            raise ValueError(
                f"{self.path} answers with {answer.shape} {answer.dtype}, {answer.min():g} to "
                f"{answer.max():g}: give a network that maps an image to one finite float map; depth is "
                "above 0, a disparity needs output=disparity"
            )
        return found.reshape(answer.shape[-2:])

    @property
    def signature(self) -> dict[str, Any]:
        """Hash of the file, and the preprocessing."""
        settings = {name: getattr(self, name) for name in ("input_size", "output", "scale")}
        settings |= {"mean": self.mean.flatten().tolist(), "std": self.std.flatten().tolist()}
        return {"source": self.path.name, "weights": self._digest, **settings}

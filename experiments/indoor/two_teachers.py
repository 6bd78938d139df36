"""METER-XXS and FastDepth together as the teacher of photographs (``pip install ai-edge-litert``).

``PYTHONPATH=experiments/indoor python -m eldenet.train +experiment=indoor_lite ...`` uses it.
"""

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from eldenet.zoo import build_teacher

SIDE = 224  # of FastDepth's input [px]; the whole picture is stretched to it
LEAST = 0.3  # [m]: its steps are 7 cm, so that nearer depth and 0 say nothing


class TwoTeachers:
    """The geometric mean of a network's depth and of FastDepth's, which is moved to the network's median.

    Args:
        fastdepth: FastDepth's ``.tflite`` file, uint8 in and out.
        **network: of :func:`eldenet.zoo.build_teacher`: METER-XXS, whose meters hold.
    """

    def __init__(self, fastdepth: str | Path, **network: Any) -> None:
        from ai_edge_litert.interpreter import Interpreter

        self.network = build_teacher(**network)
        self.input_size = self.network.input_size
        self._digest = hashlib.sha256(Path(fastdepth).read_bytes()).hexdigest()[:16]
        self._interpreter = Interpreter(str(fastdepth), num_threads=1)
        self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._output = self._interpreter.get_output_details()[0]

    def __call__(self, image: Tensor) -> Tensor:
        """Images ``(B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m]."""
        first = interpolate(self.network(image), image.shape[-2:], mode="bilinear", align_corners=False)
        square = interpolate(image, (SIDE, SIDE), mode="bilinear", align_corners=False, antialias=True)
        pictures = (square.permute(0, 2, 3, 1) * 255).round().to(torch.uint8).numpy()
        maps = torch.from_numpy(np.stack([self._fastdepth(picture) for picture in pictures]))[:, None]
        second = interpolate(maps, image.shape[-2:], mode="bilinear", align_corners=False)
        medians = [depth.flatten(1).median(1).values.view(-1, 1, 1, 1) for depth in (first, second)]
        return (first * second * medians[0] / medians[1]).sqrt()

    def _fastdepth(self, picture: np.ndarray) -> np.ndarray:
        self._interpreter.set_tensor(self._input, picture[None])
        self._interpreter.invoke()
        scale, zero = self._output["quantization"]
        depth = (self._interpreter.get_tensor(self._output["index"]).astype(np.float32) - zero) * scale
        return np.maximum(depth.reshape(SIDE, SIDE), LEAST)

    @property
    def signature(self) -> dict[str, Any]:
        """What the network is, and the hash of FastDepth's file."""
        return {"network": self.network.signature, "fastdepth": self._digest, "mean": "geometric"}

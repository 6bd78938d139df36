"""Several networks together as the teacher of photographs: the geometric mean of their depth.

``PYTHONPATH=experiments/indoor python -m eldenet.train ...
data.sources.photographs.data.teacher._target_=mean_teacher.MeanTeacher`` uses it.
"""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from eldenet.zoo import build_teacher


class MeanTeacher:
    """The geometric mean of the depth of several networks, all with one canonical camera.

    Args:
        source: run folder, saved model or Hub id of the first one.
        others: those of the others.
        **settings: of :func:`eldenet.zoo.build_teacher`, for each of them; ``input_size="model"``: each sees
            pictures as in its own training.
    """

    def __init__(self, source: str, others: Sequence[str], **settings: Any) -> None:
        self.networks = [build_teacher(source=one, **settings) for one in (source, *others)]
        self.input_size = self.networks[0].input_size

    def __call__(self, image: Tensor) -> Tensor:
        """Images ``(B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m]."""
        logs = [
            interpolate(network(image).log(), image.shape[-2:], mode="bilinear", align_corners=False)
            for network in self.networks
        ]
        return torch.stack(logs).mean(0).exp()

    @property
    def signature(self) -> dict[str, Any]:
        """What the networks are."""
        return {"networks": [network.signature for network in self.networks], "mean": "geometric"}

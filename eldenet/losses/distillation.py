"""Knowledge distillation: a trained network's depth, and its features, as what the student learns.

Outputs: the teacher's map is the target (Hinton et al. 2015; for depth Hu et al. 2021, "Boosting Light-Weight
Depth Estimation via Knowledge Distillation"). Features: FitNets' hint (Romero et al. 2015, eq. 3), relative.
"""

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.losses.base import Autocast, Loss, WeightedTerm

Features = dict[int, Tensor]
"""Feature ``(B, C, h, w)`` by its stride."""


class Teacher:
    """A frozen network. No module, so that whoever holds it has neither its parameters nor its state.

    Once attached it runs in the student's precision, and always in its images' layout: a large teacher is
    most of a step's work.

    Args:
        network: image ``(B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m]; frozen in place.
        source: where it came from, for the record.
        input_size: ``(height, width)`` that it sees [px]; None: the student's.
    """

    def __init__(
        self, network: nn.Module, *, source: str = "", input_size: Sequence[int] | None = None
    ) -> None:
        self.network = network.eval().requires_grad_(False)
        self.source = source
        self.input_size = None if input_size is None else (int(input_size[0]), int(input_size[1]))
        self.autocast: Autocast = nullcontext

    @torch.no_grad()
    def __call__(self, image: Tensor) -> Tensor:
        """Depth ``(B, 1, H, W)`` [m] of ``image (B, 3, H, W)``, in the image's own size."""
        layout = torch.channels_last if _is_channels_last(image) else torch.contiguous_format
        self.network.to(image.device).to(memory_format=layout)
        size = image.shape[-2:]
        if self.input_size is not None and self.input_size != tuple(size):
            shrink = self.input_size < tuple(size)  # in height; in width where that stays
            image = F.interpolate(
                image, size=self.input_size, mode="bilinear", align_corners=False, antialias=shrink
            )
        with self.autocast():
            depth = self.network(image).float()
        if depth.shape[-2:] != size:
            depth = F.interpolate(depth, size=size, mode="bilinear", align_corners=False)
        return depth

    def describe(self, student_size: Sequence[int] | None) -> str:
        """At which size it sees the images, and at which its training did, in words.

        ``student_size`` is the student's ``(height, width)`` [px]; None: that of its pictures.
        """
        seen, trained = self.input_size or student_size, getattr(self.network, "info", {}).get("input_size")
        sees = "the student's pictures as they are" if seen is None else f"{seen[0]} x {seen[1]} pixels"
        known = "at a size that it does not state" if trained is None else f"at {trained[0]} x {trained[1]}"
        return f"teacher {self.source}: sees {sees}, was trained {known}"

    @property
    def identity(self) -> dict[str, Any]:
        """What tells this teacher from another: its weights' hash above all."""
        digest = hashlib.sha256()
        for name, value in sorted(self.network.state_dict().items()):
            digest.update(name.encode())
            digest.update(value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy().tobytes())
        return {"source": self.source, "weights": digest.hexdigest()[:16], "input_size": self.input_size}


class DistilledTerm(WeightedTerm):
    """``weight * loss`` against the teacher's depth of the same, augmented images; no label is needed.

    A pixel counts where the teacher says something finite and above 0, whatever the ground truth knows. So
    unlabelled images (a mask that is False everywhere) count here and nowhere else.

    Args:
        loss: of the student's and the teacher's map.
        teacher: frozen.
        weight: 0 or more.
        space: as in :class:`WeightedTerm`.
        feature_weight: of the feature term that is added; 0: outputs only.
        feature_strides: of the backbones' features that are compared, each through a 1x1 projection that is
            trained with the student where the channels differ. Both networks need a backbone then
            (``network.backbone`` with ``feature_info``).

    Raises:
        ValueError: a weight below 0, or features asked for that a network does not have.
    """

    def __init__(
        self,
        loss: Loss,
        teacher: Teacher,
        weight: float = 1.0,
        space: str = "meters",
        feature_weight: float = 0.0,
        feature_strides: Sequence[int] = (8, 16, 32),
    ) -> None:
        super().__init__(loss, weight, space)
        if feature_weight < 0:
            raise ValueError(f"feature_weight={feature_weight}: a loss weight is 0 or more")
        if feature_weight > 0 and not feature_strides:
            raise ValueError("feature_weight is above 0 but feature_strides is empty: name strides, or set 0")
        self.teacher, self.feature_weight = teacher, feature_weight
        self.feature_strides = tuple(int(stride) for stride in feature_strides)
        self.projections = nn.ModuleDict()
        self._seen: dict[str, Features] = {}

    @property
    def identity(self) -> Mapping[str, Any]:
        """The teacher's."""
        return self.teacher.identity

    def attach(self, student: nn.Module, autocast: Autocast = nullcontext) -> None:
        """Listen to the features of both networks, and make the projections between them."""
        self.teacher.autocast = autocast
        if self.feature_weight == 0 or self._seen:
            return
        channels = {}
        for name, network in (("student", student), ("teacher", self.teacher.network)):
            channels[name] = self._listen(name, network)
        for stride in self.feature_strides:
            wide, wanted = channels["student"][stride], channels["teacher"][stride]
            same = wide == wanted
            self.projections[str(stride)] = nn.Identity() if same else nn.Conv2d(wide, wanted, 1)

    def _listen(self, name: str, network: nn.Module) -> dict[int, int]:
        """Keep the features of every forward pass; returns their channels by stride."""
        backbone = getattr(getattr(network, "network", None), "backbone", None)
        if backbone is None:
            raise ValueError(
                f"feature_weight is above 0, but the {name} has no network.backbone whose features could be "
                "compared: set feature_weight=0"
            )
        strides = [info.stride for info in backbone.feature_info]
        missing = sorted(set(self.feature_strides) - set(strides))
        if missing:
            raise ValueError(f"feature_strides={missing}: the {name}'s backbone has features of {strides}")

        def keep(_part: nn.Module, _inputs: Any, features: Sequence[Tensor]) -> None:
            self._seen[name] = dict(zip(strides, features, strict=True))

        self._seen[name] = {}
        backbone.register_forward_hook(keep)
        return {info.stride: info.channels for info in backbone.feature_info}

    def forward(
        self, prediction: Tensor, target: Tensor, mask: Tensor, image: Tensor | None = None
    ) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool, ``image (B, 3, H, W)`` -> scalar, not weighted."""
        if image is None:
            raise ValueError("a distilled term needs the images: call the loss with image=...")
        depth = self.teacher(image)
        value = super().forward(prediction, depth, torch.isfinite(depth) & (depth > 0))
        return value if self.feature_weight == 0 else value + self.feature_weight * self._feature_loss()

    def _feature_loss(self) -> Tensor:
        """Squared difference of projected student and teacher features, relative to the teacher's square."""
        losses = []
        for stride in self.feature_strides:
            wanted = self._seen["teacher"][stride].float()
            found = self.projections[str(stride)](self._seen["student"][stride].float())
            if wanted.shape[-2:] != found.shape[-2:]:
                wanted = F.interpolate(wanted, size=found.shape[-2:], mode="bilinear", align_corners=False)
            # image by image, so that a batch counts as its images do, however processes share it
            square, error = (value.square().mean(dim=(1, 2, 3)) for value in (wanted, found - wanted))
            losses.append((error / square.clamp(min=1e-12)).mean())
        return torch.stack(losses).mean()


def _is_channels_last(image: Tensor) -> bool:
    return image.is_contiguous(memory_format=torch.channels_last)

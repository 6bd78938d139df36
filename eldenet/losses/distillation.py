"""Knowledge distillation: the student learns a trained network's depth and, optionally, its features.

Outputs: the teacher's map is the target (Hinton et al. 2015; for depth Hu et al. 2021, "Boosting Light-Weight
Depth Estimation via Knowledge Distillation"). Features: FitNets' hint (Romero et al. 2015, eq. 3), relative.
"""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.losses.base import Autocast, Loss, LossInputs, WeightedTerm
from eldenet.system.digests import digest_of, weights_of


class Teacher:
    """A frozen network. It is not a module, so its owner's parameters and state do not include it.

    It runs in the images' memory layout and, once a :class:`DistilledTerm` is set up, in the student's
    precision: a large teacher is most of a step's work.

    Args:
        network: image ``(B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m]; frozen in place. One
            with ``canonical_px`` also takes the focal length.
        source: where it came from, for the run's record.
        input_size: ``(height, width)`` of the images it sees [px]; None: the student's.
    """

    def __init__(
        self, network: nn.Module, *, source: str = "", input_size: Sequence[int] | None = None
    ) -> None:
        self.network = network.eval().requires_grad_(False)
        self.source = source
        self.input_size = None if input_size is None else (int(input_size[0]), int(input_size[1]))
        self.autocast: Autocast = nullcontext
        self._canonical_width: int | None = getattr(network, "config", {}).get("canonical_width")
        self._device_and_layout: tuple[torch.device, torch.memory_format] | None = None

    @torch.no_grad()
    def __call__(self, image: Tensor, focal: Tensor | None = None) -> Tensor:
        """Return the depth ``(B, 1, H, W)`` [m] of ``image (B, 3, H, W)``, at the image's size.

        ``focal (B,)`` is fx [px of ``image``]. Where it is unknown (None, 0, NaN), a network with a canonical
        camera takes the images for whole pictures of that camera, at whatever size it sees them.
        """
        channels_last = image.is_contiguous(memory_format=torch.channels_last)
        layout = torch.channels_last if channels_last else torch.contiguous_format
        if self._device_and_layout != (image.device, layout):
            self.network.to(image.device).to(memory_format=layout)
            self._device_and_layout = image.device, layout
        size = tuple(image.shape[-2:])
        if self.input_size is not None and self.input_size != size:
            shrinks = self.input_size < size  # in height; in width if the height stays
            image = F.interpolate(
                image, size=self.input_size, mode="bilinear", align_corners=False, antialias=shrinks
            )
            focal = None if focal is None else focal * (self.input_size[1] / size[1])
        takes_focal = getattr(self.network, "canonical_px", None) is not None
        with self.autocast():
            depth = (self.network(image, focal) if takes_focal else self.network(image)).float()
        if self._canonical_width:  # whose pixels the canonical focal length is in
            known = depth.new_zeros(()) if focal is None else focal.view(-1, 1, 1, 1)
            depth = depth.where(known > 0, depth * (image.shape[-1] / self._canonical_width))
        if depth.shape[-2:] != size:
            depth = F.interpolate(depth, size=size, mode="bilinear", align_corners=False)
        return depth

    def describe(self, student_size: Sequence[int] | None) -> str:
        """Return a sentence with the image size that the teacher sees here and the one it was trained at.

        ``student_size`` is the student's ``(height, width)`` [px]; None: that of its pictures.
        """
        seen, trained = self.input_size or student_size, getattr(self.network, "info", {}).get("input_size")
        sees = "the student's images at their own size" if seen is None else f"{seen[0]} x {seen[1]} pixels"
        known = "at an unknown size" if trained is None else f"at {trained[0]} x {trained[1]}"
        return f"teacher {self.source}: sees {sees}, was trained {known}"

    @property
    def signature(self) -> dict[str, Any]:
        """Facts that distinguish this teacher from others, above all a hash of its weights."""
        digest = digest_of(*weights_of(self.network.state_dict()))
        return {"source": self.source, "weights": digest[:16], "input_size": self.input_size}


class DistilledTerm(WeightedTerm):
    """``weight * loss`` between the student's and the teacher's depth of the same, augmented images.

    A pixel counts where the teacher's depth is finite and above 0, whether or not its ground truth is known.
    So unlabeled images (a mask that is False everywhere) count in this term alone.

    Args:
        loss: compares the student's map with the teacher's.
        weight: 0 or more.
        space: as in :class:`WeightedTerm`.
        feature_weight: weight of an additional term that compares backbone features; 0: outputs only.
        feature_strides: strides of the features to compare. Where channels differ, a 1x1 projection is
            trained with the student. Both networks need a ``network.backbone`` with ``feature_info``.
    """

    needs_depth = False

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
        self.teacher, self.feature_weight = teacher, feature_weight
        self.feature_strides = tuple(int(stride) for stride in feature_strides)
        self.projections = nn.ModuleDict()
        self._features: dict[str, dict[int, Tensor]] = {}  # of the last images, by network and stride

    @property
    def signature(self) -> Mapping[str, Any]:
        """The teacher's signature."""
        return self.teacher.signature

    def setup(self, student: nn.Module, autocast: Autocast = nullcontext) -> None:
        """Hook into the features of both networks and create the projections between them.

        Raises:
            ValueError: features are compared, and a network does not have them.
        """
        self.teacher.autocast = autocast
        if self.feature_weight == 0 or self._features:
            return
        channels = self._keep_features("student", student)
        wanted = self._keep_features("teacher", self.teacher.network)
        for stride in self.feature_strides:
            same = channels[stride] == wanted[stride]
            projection = nn.Identity() if same else nn.Conv2d(channels[stride], wanted[stride], 1)
            self.projections[str(stride)] = projection

    def _keep_features(self, name: str, network: nn.Module) -> dict[int, int]:
        """Keep the features of every forward pass; return their channels by stride."""
        backbone = getattr(getattr(network, "network", None), "backbone", None)
        if backbone is None:
            raise ValueError(
                f"feature_weight={self.feature_weight}: the {name} has no network.backbone to compare "
                "features of; set feature_weight=0"
            )
        strides = [info.stride for info in backbone.feature_info]
        missing = sorted(set(self.feature_strides) - set(strides))
        if missing:
            raise ValueError(f"feature_strides={missing}: the {name}'s backbone has features of {strides}")

        def keep(_part: nn.Module, _inputs: Any, features: Sequence[Tensor]) -> None:
            self._features[name] = dict(zip(strides, features, strict=True))

        self._features[name] = {}
        backbone.register_forward_hook(keep)
        return {info.stride: info.channels for info in backbone.feature_info}

    def forward(self, inputs: LossInputs) -> Tensor:
        """Return the term without its weight, a scalar; it needs ``image``."""
        assert inputs.image is not None  # the trainer always gives it
        depth = self.teacher(inputs.image, inputs.focal)
        if inputs.ratio is not None:
            depth = depth / inputs.ratio
        value = super().forward(inputs._replace(target=depth, mask=torch.isfinite(depth) & (depth > 0)))
        return value if self.feature_weight == 0 else value + self.feature_weight * self._feature_loss()

    def _feature_loss(self) -> Tensor:
        """Mean square of projected student minus teacher features over the teacher's mean square; scalar."""
        losses = []
        for stride in self.feature_strides:
            wanted = self._features["teacher"][stride].float()
            found = self.projections[str(stride)](self._features["student"][stride].float())
            if wanted.shape[-2:] != found.shape[-2:]:
                wanted = F.interpolate(wanted, size=found.shape[-2:], mode="bilinear", align_corners=False)
            # image by image, so that the result does not depend on how processes share the batch
            square, error = (value.square().mean(dim=(1, 2, 3)) for value in (wanted, found - wanted))
            losses.append((error / square.clamp(min=1e-12)).mean())
        return torch.stack(losses).mean()

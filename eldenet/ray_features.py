"""What a network knows of its lens: the rays of the pixels scale and shift its deep features."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from eldenet.configurable import Configurable
from eldenet.types import FeatureInfo


class RayFeatures(Configurable, nn.Module):
    """Scales and shifts the deep features by what two 1x1 convolutions make of their rays.

    The rays are as in CAM-Convs (Facil et al. 2019), the scale and shift as in FiLM (Perez et al. 2018). The
    principal point counts as the picture's center. For an unknown lens the features stay as they are; before
    the training, for every lens.

    Args:
        feature_info: channels and strides of the features; :class:`~eldenet.model.EncoderDecoder` gives it.
        hidden: channels between the two convolutions.
        least_stride: features of a smaller stride stay as they are, which saves time.
        typical_focal: a usual focal length [px of the network's image], at which the input ln(fx) is 0.
        unknown: share of the training's pictures whose lens it is not told.
    """

    supplied_arguments = ("feature_info",)

    def __init__(
        self,
        feature_info: Sequence[FeatureInfo],
        hidden: int = 16,
        least_stride: int = 16,
        typical_focal: float = 160.0,
        unknown: float = 0.15,
    ) -> None:
        super().__init__()
        self.typical_focal, self.unknown = typical_focal, unknown
        self.convs = nn.ModuleDict()  # by the feature's index
        for index, info in enumerate(feature_info):
            if info.stride >= least_stride:
                last = nn.Conv2d(hidden, 2 * info.channels, 1, bias=False)
                nn.init.zeros_(last.weight)
                self.convs[str(index)] = nn.ModuleList([nn.Conv2d(4, hidden, 1), nn.Hardswish(), last])

    def forward(self, features: Sequence[Tensor], size: tuple[int, int], focal: Tensor) -> list[Tensor]:
        """Features of images of ``size`` (H, W) whose ``focal (B,)`` is fx [px]; 0 and NaN: unknown."""
        known = focal > 0
        focal = focal.where(known, focal.new_full((), self.typical_focal)).view(-1, 1, 1, 1)
        if self.training:
            known = known & (torch.rand(known.shape, device=known.device) >= self.unknown)
        found = list(features)
        for index, convs in self.convs.items():
            feature, (first, activation, last) = features[int(index)], convs.children()
            hidden = activation(first(self._rays(feature, size, focal).to(feature.dtype)))
            # nothing for an unknown lens
            gain, shift = last(hidden * known.to(feature.dtype).view(-1, 1, 1, 1)).chunk(2, 1)
            found[int(index)] = feature * (1 + gain) + shift
        return found

    def _rays(self, feature: Tensor, size: tuple[int, int], focal: Tensor) -> Tensor:
        """Of each cell ``(B, 4, h, w)``: tangents right and down, ln of the lens, tangent off the axis."""
        batch, _, height, width = feature.shape  # not len(): an export at any size would keep its example's
        y, x = (
            (torch.arange(cells, device=feature.device) + 0.5) * (side / cells) - side / 2
            for cells, side in zip((height, width), size, strict=True)
        )
        right, down = x.view(1, 1, 1, -1) / focal, y.view(1, 1, -1, 1) / focal
        parts = right, down, (focal / self.typical_focal).log(), (right**2 + down**2).sqrt()
        return torch.cat([part.expand(batch, 1, height, width) for part in parts], 1)

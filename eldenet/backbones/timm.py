"""Any convolutional network of timm as a backbone."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from eldenet.backbones.base import Backbone
from eldenet.backbones.weights import Weights, downloading, read_weights
from eldenet.system.extras import require
from eldenet.types import FeatureInfo


class TimmBackbone(Backbone):
    """A network of the timm library, with every stage that timm offers as a feature.

    Needs the extra ``pip install -e '.[timm]'``. Channels and strides are those that timm declares for
    ``features_only=True``; most networks start at stride 2, some at 1 or 4. Networks with a single stride
    (plain vision transformers) cannot feed a decoder and are refused here; those with a fixed input size
    are refused by timm when they run.

    Convention: the network decides how odd sizes are rounded; most round up, some (EdgeNeXt, VGG) down.

    Args:
        name: such as ``"mobilenetv4_conv_small"``; ``timm.list_models("*mobile*")`` finds more.
        pretrained: ``True`` for timm's default weights of that name, or a local file with timm's names.

    Raises:
        ImportError: timm is not installed.
        ValueError: timm has no such network, its features do not fit a decoder, or the file does not fit it.
        ConnectionError: the weights cannot be downloaded.
    """

    def __init__(self, name: str, *, pretrained: bool | str = False) -> None:
        super().__init__()
        require("TimmBackbone", "timm")
        import timm

        weights = read_weights(pretrained) if isinstance(pretrained, str) else None
        overlay = {"file": str(Path(pretrained).expanduser())} if isinstance(pretrained, str) else None
        with downloading(f"timm's weights of {name}"):
            try:
                self.body = timm.create_model(
                    name, pretrained=bool(pretrained), features_only=True, pretrained_cfg_overlay=overlay
                )
            except RuntimeError as error:  # an unknown name, or shapes that differ
                raise ValueError(f"timm cannot make {name} with pretrained={pretrained}: {error}") from error
        if weights is not None:
            self._check_all_loaded(weights, f"{pretrained} into {name}")

        info: Any = self.body.feature_info
        channels, strides = info.channels(), info.reduction()
        self.feature_info = tuple(map(FeatureInfo, channels, strides))
        # networks such as Swin put channels last
        self.channels_last = str(getattr(self.body, "output_fmt", "NCHW")).endswith("NHWC")

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Return the features of ``(B, 3, H, W)``, finest first."""
        features = self.body(image)
        if self.channels_last:
            features = [feature.permute(0, 3, 1, 2).contiguous() for feature in features]
        return tuple(features)

    def _check_all_loaded(self, weights: Weights, what: str) -> None:
        # timm skips a parameter that the file lacks, and the network would pass for a trained one
        missing = [
            name
            for name, parameter in self.body.named_parameters()
            if not any(torch.equal(parameter, tensor.to(parameter.dtype)) for tensor in weights.values())
        ]
        if missing:
            raise ValueError(
                f"loading {what} left {len(missing)} parameters untouched, the first is {missing[0]}: "
                "give a file with timm's names for this network"
            )

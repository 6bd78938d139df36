"""PP-LCNet weights under timm's names."""

from pathlib import Path

from torch import nn

from eldenet.backbones.weights import download_from_hub, load_weights, read_weights, rename_timm

PUBLISHED = {0.5: "lcnet_050.ra2_in1k", 0.75: "lcnet_075.ra2_in1k", 1.0: "lcnet_100.ra2_in1k"}

# timm's stage -> ours and its first block there: timm divides the paper's blocks5 into two stages.
_TIMM_STAGES = {
    0: ("blocks2", 0),
    1: ("blocks3", 0),
    2: ("blocks4", 0),
    3: ("blocks5", 0),
    4: ("blocks5", 2),
    5: ("blocks6", 0),
}


def load_pplcnet_weights(module: nn.Module, pretrained: bool | str, scale: float) -> None:
    """Load weights into a :class:`~eldenet.backbones.pplcnet.PPLCNet`, without those of a classifier's head.

    Args:
        pretrained: ``True`` for timm's ImageNet weights of this scale, their name, or a local file:
            safetensors or a state dict, with our names or timm's.

    Raises:
        ValueError: no such weights, or they do not fit.
        ConnectionError: they cannot be downloaded.
    """
    if pretrained is True:
        if scale not in PUBLISHED:
            raise ValueError(
                f"pretrained=true: timm publishes no weights of PP-LCNet x{scale}; choose a scale of "
                f"{', '.join(map(str, PUBLISHED))}, or give a local file"
            )
        pretrained = PUBLISHED[scale]
    source = str(pretrained)
    path = Path(source).expanduser()
    if source in PUBLISHED.values():
        path = download_from_hub(f"timm/{source}")
    elif not path.is_file():
        raise ValueError(
            f"no weights {source!r} for PP-LCNet: give true, one of {', '.join(PUBLISHED.values())}, "
            "or an existing file"
        )
    load_weights(module, rename_timm(read_weights(path), _TIMM_STAGES), source)

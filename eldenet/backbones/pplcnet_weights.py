"""PP-LCNet weights of other code bases under this one's names: timm's state dicts and Paddle's ONNX files."""

import re
from pathlib import Path
from typing import Any

import torch
from torch import nn

from eldenet.backbones.weights import Weights, download_from_hub, load_weights, read_weights

PUBLISHED = {0.5: "lcnet_050.ra2_in1k", 0.75: "lcnet_075.ra2_in1k", 1.0: "lcnet_100.ra2_in1k"}

# timm numbers the stages differently: its blocks.3 and blocks.4 are together what the paper calls blocks5.
_TIMM_BLOCKS = {
    "blocks.0.0": "blocks2.0",
    "blocks.1.0": "blocks3.0",
    "blocks.1.1": "blocks3.1",
    "blocks.2.0": "blocks4.0",
    "blocks.2.1": "blocks4.1",
    "blocks.3.0": "blocks5.0",
    "blocks.3.1": "blocks5.1",
    "blocks.4.0": "blocks5.2",
    "blocks.4.1": "blocks5.3",
    "blocks.4.2": "blocks5.4",
    "blocks.4.3": "blocks5.5",
    "blocks.5.0": "blocks6.0",
    "blocks.5.1": "blocks6.1",
}
_TIMM_LAYERS = {
    "conv_dw": "depthwise.conv",
    "bn1": "depthwise.norm",
    "se.conv_reduce": "squeeze_excite.reduce",
    "se.conv_expand": "squeeze_excite.expand",
    "conv_pw": "pointwise.conv",
    "bn2": "pointwise.norm",
}
_TIMM_OUTSIDE = {
    "conv_stem": "stem.conv",
    "bn1": "stem.norm",
    "conv_head": "last_conv",
    "classifier": "fc",
}
_HEAD = ("last_conv.", "fc.")


def load_pplcnet_weights(module: nn.Module, pretrained: bool | str, scale: float) -> None:
    """Load weights into a :class:`~eldenet.backbones.pplcnet.PPLCNet`; a classifier's head is left out.

    Args:
        module: the backbone.
        pretrained: ``True`` for timm's ImageNet weights of this scale, one of their names, or a local file:
            safetensors or state dict with this class's names or timm's, or an ONNX file as Paddle exports it.
        scale: of the backbone.

    Raises:
        ValueError: no such weights, or they do not fit.
        RuntimeError: they cannot be downloaded.
    """
    if pretrained is True:
        if scale not in PUBLISHED:
            raise ValueError(
                f"no published weights for PP-LCNet x{scale}: timm has them for "
                f"{', '.join(map(str, PUBLISHED))}. Choose one of these, or a local file"
            )
        pretrained = PUBLISHED[scale]
    source = str(pretrained)
    path = Path(source).expanduser()
    if source in PUBLISHED.values():
        if PUBLISHED.get(scale) != source:
            raise ValueError(f"the weights {source} are not for scale {scale}; published are {PUBLISHED}")
        path = download_from_hub(f"timm/{source}")
    elif not path.is_file():
        raise ValueError(
            f"no weights {source!r} for PP-LCNet: give true, one of {', '.join(PUBLISHED.values())}, "
            "or an existing file"
        )
    if path.suffix == ".onnx":
        weights = from_onnx(path, module)
    else:
        weights = read_weights(path)
        if "conv_stem.weight" in weights:
            weights = from_timm(weights)
    encoder = {name: tensor for name, tensor in weights.items() if not name.startswith(_HEAD)}
    load_weights(module, encoder, source)


def from_timm(weights: Weights) -> Weights:
    """Rename the state dict of one of timm's ``lcnet`` networks, with or without its classifier.

    Returns:
        The same tensors under the names of ``PPLCNet``; the classifier's as ``last_conv.*`` and ``fc.*``.

    Raises:
        ValueError: a name is not of such a network.
    """
    return {_rename_timm(name): tensor for name, tensor in weights.items()}


def _rename_timm(name: str) -> str:
    layer, _, tensor = name.rpartition(".")
    # features_only networks hold the stages side by side: blocks_0 instead of blocks.0
    block, inside = re.sub(r"^blocks_", "blocks.", layer)[:10], layer[11:]
    if block in _TIMM_BLOCKS and inside in _TIMM_LAYERS:
        return f"{_TIMM_BLOCKS[block]}.{_TIMM_LAYERS[inside]}.{tensor}"
    if layer in _TIMM_OUTSIDE:
        return f"{_TIMM_OUTSIDE[layer]}.{tensor}"
    raise ValueError(f"{name!r} is not a weight of timm's lcnet networks")


def from_onnx(path: str | Path, module: nn.Module) -> Weights:
    """Read a PP-LCNet's weights from the initializers of an ONNX file, such as PaddleOCR's classifiers.

    Such a file has numbered names, so the convolutions are taken in the order in which the graph runs them,
    which is also the order in which ``module`` defines its own. What follows the last of these (the head)
    is left out. Where an exporter has folded a batch normalization into its convolution, the layer's own
    becomes the identity plus the folded bias: equal numbers in evaluation, but nothing that fine-tuning
    should start from.

    Raises:
        ImportError: the package ``onnx`` is missing.
        ValueError: the graph is not of this kind.
    """
    try:
        import onnx
        from onnx import numpy_helper
    except ImportError as error:
        raise ImportError(
            "reading weights from an ONNX file needs the package onnx: pip install onnx"
        ) from error

    graph = onnx.load(str(path)).graph
    tensors = {item.name: torch.from_numpy(numpy_helper.to_array(item).copy()) for item in graph.initializer}
    found = _onnx_convolutions(graph, tensors)
    convolutions = {name: layer for name, layer in module.named_modules() if isinstance(layer, nn.Conv2d)}
    if len(found) < len(convolutions):
        raise ValueError(f"{path} has {len(found)} convolutions where PP-LCNet has {len(convolutions)}")

    weights: Weights = {}
    for (name, layer), (weight, bias, norm) in zip(convolutions.items(), found, strict=False):
        weights[f"{name}.weight"] = weight
        if layer.bias is not None:
            weights[f"{name}.bias"] = torch.zeros(len(weight)) if bias is None else bias
            continue
        norm_name = f"{name.removesuffix('conv')}norm"
        own = module.get_submodule(norm_name)
        assert isinstance(own, nn.BatchNorm2d)
        if norm is None:
            one = torch.ones(len(weight))
            norm = (one, 0 * one if bias is None else bias, 0 * one, one, 0.0)
        scale, shift, mean, variance, epsilon = norm
        weights[f"{norm_name}.weight"] = scale
        weights[f"{norm_name}.bias"] = shift
        weights[f"{norm_name}.running_mean"] = mean
        weights[f"{norm_name}.running_var"] = variance + (epsilon - own.eps)
        weights[f"{norm_name}.num_batches_tracked"] = torch.tensor(0)
    return weights


def _onnx_convolutions(graph: Any, tensors: Weights) -> list[tuple[Any, Any, Any]]:
    """List each convolution's weight, bias or None, and (scale, shift, mean, variance, epsilon) or None."""
    found: list[tuple[Any, Any, Any]] = []
    for node in graph.node:
        constants = [tensors[name] for name in node.input if name in tensors]
        if node.op_type == "Conv":
            if not constants:
                raise ValueError(f"the weight of {node.name!r} is not stored as an initializer")
            found.append((constants[0], constants[1] if len(constants) > 1 else None, None))
        elif node.op_type == "BatchNormalization" and found:
            epsilon = next((item.f for item in node.attribute if item.name == "epsilon"), 1e-5)
            weight, bias, _ = found[-1]
            if bias is not None:
                raise ValueError(
                    f"{node.name!r} follows a convolution with a bias, which PP-LCNet's have not"
                )
            found[-1] = (weight, None, (*constants, epsilon))
        elif node.op_type == "Add" and found and len(constants) == 1 and constants[0].ndim == 4:
            found[-1] = (found[-1][0], constants[0].flatten(), found[-1][2])  # Paddle's form of a bias
    return found

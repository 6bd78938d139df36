"""PP-LCNet weights from other code bases: timm's state dicts and Paddle's ONNX files."""

from pathlib import Path
from typing import Any

import torch
from torch import nn

from eldenet.backbones.weights import Weights, download_from_hub, load_weights, read_weights, rename_timm
from eldenet.system.onnx_files import read_graph

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
        module: the backbone.
        pretrained: ``True`` for timm's ImageNet weights of this scale, their name, or a local file:
            safetensors or a state dict with our names or timm's, or an ONNX file that Paddle exported.
        scale: of the backbone.

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
    if path.suffix == ".onnx":
        weights = from_onnx(path, module)
    else:
        weights = rename_timm(read_weights(path), _TIMM_STAGES)
    load_weights(module, weights, source)


def from_onnx(path: str | Path, module: nn.Module) -> Weights:
    """Read a PP-LCNet's weights from the initializers of an ONNX file, such as PaddleOCR's classifiers.

    Names in such a file are numbers, so convolutions are matched by order: that in which the graph runs
    them is that in which ``module`` defines them. Further ones (the classifier's head) are ignored. Where
    the exporter folded a batch normalization into its convolution, our normalization becomes the identity
    plus the folded bias: equal in evaluation, but not suited to fine-tuning.

    Raises:
        ValueError: the graph is not that of a PP-LCNet.
    """
    graph = read_graph(path, "fetch it again").graph
    from onnx import numpy_helper

    tensors = {item.name: torch.from_numpy(numpy_helper.to_array(item).copy()) for item in graph.initializer}
    found = _onnx_convolutions(graph, tensors)
    convolutions = {name: layer for name, layer in module.named_modules() if isinstance(layer, nn.Conv2d)}
    if len(found) < len(convolutions):
        raise ValueError(f"{path} has {len(found)} convolutions, PP-LCNet has {len(convolutions)}")

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
    """Return each convolution's weight, bias or None, and (scale, shift, mean, variance, epsilon) or None."""
    found: list[tuple[Any, Any, Any]] = []
    for node in graph.node:
        constants = [tensors[name] for name in node.input if name in tensors]
        if node.op_type == "Conv":
            found.append((constants[0], constants[1] if len(constants) > 1 else None, None))
        elif node.op_type == "BatchNormalization" and found:
            epsilon = next((item.f for item in node.attribute if item.name == "epsilon"), 1e-5)
            weight, bias, _ = found[-1]
            assert bias is None  # PP-LCNet's convolutions have none
            found[-1] = (weight, None, (*constants, epsilon))
        elif node.op_type == "Add" and found and len(constants) == 1 and constants[0].ndim == 4:
            found[-1] = (found[-1][0], constants[0].flatten(), found[-1][2])  # how Paddle stores a bias
    return found

"""PP-LCNet's weights in an ONNX file of Paddle's, such as PaddleOCR's classifiers."""

from pathlib import Path

import torch
from torch import Tensor, nn


def paddle_weights(path: Path, module: nn.Module) -> dict[str, Tensor]:
    """Read weights for ``module`` by order: the graph runs its convolutions as it defines them."""
    import onnx

    graph = onnx.load(str(path)).graph
    tensors = {
        item.name: torch.from_numpy(onnx.numpy_helper.to_array(item).copy()) for item in graph.initializer
    }
    names = iter([name for name, layer in module.named_modules() if isinstance(layer, nn.Conv2d)])
    weights: dict[str, Tensor] = {}
    for node in graph.node:
        constants = [tensors[name] for name in node.input if name in tensors]
        if node.op_type == "Conv":
            name = next(names, None)
            if name is None:  # the classifier begins
                break
            weights[f"{name}.weight"] = constants[0]
        elif node.op_type == "BatchNormalization":
            norm = f"{name.removesuffix('conv')}norm"
            kinds = ("weight", "bias", "running_mean", "running_var")
            weights |= dict(zip([f"{norm}.{kind}" for kind in kinds], constants, strict=True))
        elif node.op_type == "Add" and constants and constants[0].ndim == 4:  # how Paddle stores a bias
            weights[f"{name}.bias"] = constants[0].flatten()
    return weights

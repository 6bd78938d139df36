"""Where weights come from (a local file, torchvision, the Hugging Face hub) and how they get in."""

import pickle
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

Weights = dict[str, Tensor]


def read_weights(path: str | Path) -> Weights:
    """Read a state dict from a local file of safetensors or ``torch.save``, without running any code of it.

    Raises:
        ValueError: there is no such file, or it holds something other than a state dict of tensors.
    """
    path = Path(path).expanduser()
    if not path.is_file():
        raise ValueError(f"no weights at {path}: give the path of a .safetensors file or of a state dict")
    if path.suffix == ".safetensors":
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        try:
            return load_file(path)
        except SafetensorError as error:
            raise ValueError(f"{path} is not a whole safetensors file: {error}") from error
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, EOFError, RuntimeError) as error:
        raise ValueError(
            f"{path} is not a state dict of tensors alone; nothing else is loaded, as a pickle can run code. "
            f"Save one from where the model runs: torch.save(model.state_dict(), path). {error}"
        ) from error
    if isinstance(content, Mapping) and isinstance(content.get("state_dict"), Mapping):
        content = content["state_dict"]  # the usual wrapping of a training checkpoint
    if not (isinstance(content, Mapping) and all(isinstance(value, Tensor) for value in content.values())):
        raise ValueError(f"{path} holds no state dict: expected names with tensors")
    return dict(content)


def load_weights(module: nn.Module, weights: Weights, source: str | Path) -> None:
    """Load ``weights`` into ``module``, all of them and nothing missing.

    Raises:
        ValueError: names or shapes differ; says which, and from which ``source``.
    """
    try:
        module.load_state_dict(weights)
    except RuntimeError as error:
        raise ValueError(f"the weights of {source} do not fit: {error}") from error


def download_from_hub(repository: str, filename: str = "model.safetensors") -> Path:
    """Fetch one file of a Hugging Face repository, or find it in the local cache.

    Raises:
        RuntimeError: it is not in the cache and cannot be reached.
    """
    from huggingface_hub import hf_hub_download

    try:
        return Path(hf_hub_download(repository, filename))
    except Exception as error:  # the kinds differ between versions of the hub's client and its HTTP library
        raise RuntimeError(
            f"could not fetch {filename} from https://huggingface.co/{repository} ({error}). Fetch it where "
            "there is a network and give its path instead: pretrained: /path/to/file"
        ) from error


def load_torchvision_weights(
    module: nn.Module, name: str, pretrained: bool | str, *, by_order: bool = False
) -> None:
    """Load torchvision's weights, or a local file of them, into a backbone that keeps torchvision's names.

    Args:
        module: the backbone; the file's classifier (``fc.*``, ``classifier.*``) is left out.
        name: torchvision's name of the network, such as ``"resnet18"``.
        pretrained: ``True`` for its first ImageNet weights (those that the literature's baselines start
            from), the name of others (``"IMAGENET1K_V2"``), or a local file.
        by_order: where a file's names differ from torchvision's, take its tensors in their order. Only for
            networks of which such files are known to be around; refused unless number and shapes agree, one
            by one.

    Raises:
        ValueError: no such weights, or they do not fit.
        RuntimeError: they cannot be downloaded.
    """
    from torchvision.models import get_model_weights

    published = {weights.name: weights for weights in get_model_weights(name)}
    # VGG's IMAGENET1K_FEATURES expects another mean and standard deviation than DepthNet's normalization.
    published.pop("IMAGENET1K_FEATURES", None)
    choice = "IMAGENET1K_V1" if pretrained is True else str(pretrained)
    if choice in published:
        source = published[choice].url
        try:
            weights = dict(published[choice].get_state_dict(progress=False, check_hash=True))
        except OSError as error:
            raise RuntimeError(
                f"could not fetch {source} ({error}). Fetch it where there is a network and give its path "
                f"instead (pretrained: /path/to/{Path(source).name}), or put it into "
                f"{torch.hub.get_dir()}/checkpoints"
            ) from error
    elif Path(choice).expanduser().is_file():
        source = choice
        weights = read_weights(choice)
    else:
        raise ValueError(
            f"no weights {choice!r} for {name}: give true, one of {', '.join(published)}, or an existing file"
        )
    weights = {key: value for key, value in weights.items() if not key.startswith(("fc.", "classifier."))}
    if by_order and weights.keys() != module.state_dict().keys():
        weights = _rename_by_order(weights, module.state_dict(), source)
    load_weights(module, weights, source)


def _rename_by_order(weights: Weights, expected: Weights, source: str) -> Weights:
    if len(weights) != len(expected):
        raise ValueError(
            f"{source} has other names and {len(weights)} tensors where {len(expected)} are needed"
        )
    pairs = zip(weights.items(), expected.items(), strict=True)
    for (name, tensor), (expected_name, expected_tensor) in pairs:
        if tensor.shape != expected_tensor.shape:
            raise ValueError(
                f"{source} has other names, and its tensors do not fit by order either: {name} "
                f"{tuple(tensor.shape)} would become {expected_name} {tuple(expected_tensor.shape)}"
            )
    return dict(zip(expected, weights.values(), strict=True))

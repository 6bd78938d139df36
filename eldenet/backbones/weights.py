"""Read weights from a local file, torchvision or the Hugging Face Hub, and load them into a network."""

import pickle
import queue
import re
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from eldenet.system.errors import reading

Weights = dict[str, Tensor]
STALLED = 60.0  # without a byte from the Hub [s]

#: Of RGB in [0, 1]; pictures for ImageNet weights are normalized by them, unless the weights say otherwise.
IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

# timm's names inside a depthwise separable block -> ours.
_TIMM_LAYERS = {
    "conv_dw": "depthwise.conv",
    "bn1": "depthwise.norm",
    "se.conv_reduce": "squeeze_excite.reduce",
    "se.conv_expand": "squeeze_excite.expand",
    "conv_pw": "pointwise.conv",
    "bn2": "pointwise.norm",
}


def read_weights(path: str | Path) -> Weights:
    """Read a state dict from a safetensors file or one of ``torch.save``, without running code from it.

    Raises:
        ValueError: no such file, one that holds no state dict of tensors, or weights that are not finite.
    """
    weights = _read_weights(path)
    refuse_not_finite(weights, path)
    return weights


def refuse_not_finite(weights: Weights, source: str | Path) -> None:
    """Raise ValueError if a weight is NaN or infinite: everything that the network says would be wrong."""
    wrong = [name for name, tensor in weights.items() if not torch.isfinite(tensor).all()]
    if wrong:
        raise ValueError(
            f"the weights of {source} are not finite ({wrong[0]}; {len(wrong)} of {len(weights)} tensors): "
            "the training diverged, or the file is damaged"
        )


def _read_weights(path: str | Path) -> Weights:
    path = Path(path).expanduser()
    if not path.is_file():
        raise ValueError(f"no weights at {path}: give the path of a .safetensors file or of a state dict")
    if path.suffix == ".safetensors":
        from safetensors.torch import load_file

        with reading(path, "safetensors file"):
            return load_file(path)
    content = read_torch(path)
    if isinstance(content, Mapping) and isinstance(content.get("state_dict"), Mapping):
        content = content["state_dict"]  # as training checkpoints usually store it
    if not (
        isinstance(content, Mapping)
        and all(isinstance(name, str) and isinstance(value, Tensor) for name, value in content.items())
    ):
        raise ValueError(f"{path} holds no state dict: give a mapping of names to tensors")
    return dict(content)


def read_torch(path: Path) -> Any:
    """Read what ``torch.save`` wrote, onto the CPU, without running code; checksums are checked first.

    Raises:
        ValueError: the file is damaged, or holds more than tensors and plain values.
    """
    with reading(path, "file of torch.save"):
        if zipfile.is_zipfile(path):  # torch itself does not look at the checksums
            with zipfile.ZipFile(path) as archive:
                if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                    raise ValueError("its entries are compressed, which torch.save never does")
                damaged = archive.testzip()
                pickled = b"".join(archive.read(name) for name in archive.namelist() if name.endswith(".pkl"))
            if damaged is not None:
                raise ValueError(f"wrong checksum of {damaged}")
        else:
            pickled = path.read_bytes()
        if b"bytearray\n" in pickled:  # which torch lets a pickle make, of any size
            raise ValueError("it holds a bytearray, which no state dict has")
        try:
            content = torch.load(path, map_location="cpu", weights_only=True)
        except pickle.UnpicklingError as error:
            raise ValueError(
                f"it holds more than a state dict of tensors, and a pickle can run code: save one with "
                f"torch.save(model.state_dict(), path). {error}"
            ) from error
        _check_sizes(content, path.stat().st_size)
    return content


def _check_sizes(content: Any, most: int) -> None:
    """Raise ValueError for a tensor that states more numbers than it has, or is sparse, quantized or meta.

    ``most`` is the size of the file [bytes]. A file of 1 kB may state a tensor of many GB, which the first
    operation on it would make.
    """
    waiting, seen, stored = [content], set(), {}
    while waiting:
        part = waiting.pop()
        if id(part) in seen:
            continue
        seen.add(id(part))
        if isinstance(part, Mapping):
            waiting += [*part.keys(), *part.values()]
        elif isinstance(part, list | tuple | set):
            waiting += part
        elif isinstance(part, Tensor):
            shape = list(part.shape)
            if part.layout != torch.strided or part.is_quantized or part.device.type != "cpu":
                raise ValueError(f"it holds a sparse, quantized or meta tensor {shape}: save plain ones")
            storage = part.untyped_storage()
            stored[storage.data_ptr()] = storage.nbytes()
            if part.numel() * part.element_size() > storage.nbytes() or sum(stored.values()) > most:
                raise ValueError(f"it states a tensor {shape} that is larger than its numbers")


def load_weights(module: nn.Module, weights: Weights, source: str | Path) -> None:
    """Load ``weights`` into ``module``; every tensor must have a place and every place a tensor.

    Raises:
        ValueError: names or shapes differ; the message names them and ``source``.
    """
    try:
        module.load_state_dict(weights)
    except RuntimeError as error:
        raise ValueError(f"the weights of {source} do not fit: {error}") from error


def rename_timm(weights: Weights, stages: Mapping[int, tuple[str, int]]) -> Weights:
    """Return a timm state dict of depthwise separable blocks under our names, without its classifier.

    A file that does not start with timm's stem is returned unchanged.

    Args:
        weights: of a whole network of timm's, or of its ``features_only`` form.
        stages: timm's number of a stage -> our stage, and the number of its first block there.
    """
    if "conv_stem.weight" not in weights:
        return weights
    found = {}
    for name, tensor in weights.items():
        block = re.fullmatch(r"blocks[._](\d+)\.(\d+)\.([\w.]+)\.(\w+)", name)
        if block and int(block[1]) in stages and block[3] in _TIMM_LAYERS:
            stage, first = stages[int(block[1])]
            found[f"{stage}.{first + int(block[2])}.{_TIMM_LAYERS[block[3]]}.{block[4]}"] = tensor
        elif not name.startswith(("classifier.", "conv_head.")):
            found[name.replace("conv_stem.", "stem.conv.").replace("bn1.", "stem.norm.")] = tensor
    return found


def download_from_hub(repository: str) -> Path:
    """Return the local path of a Hugging Face repository's weights, downloaded if they are not in the cache.

    Raises:
        ConnectionError: they are not in the cache and cannot be downloaded.
    """
    from huggingface_hub import hf_hub_download

    filename = "model.safetensors"
    # the kinds of errors depend on the versions of the Hub's client and its HTTP library
    with downloading(f"{filename} from https://huggingface.co/{repository}", Exception):
        return Path(until_stalled(lambda: hf_hub_download(repository, filename), repository))


def until_stalled(download: Callable[[], str], repository: str) -> str:
    """Return what ``download`` returns; it may take any time, as long as something arrives.

    Raises:
        TimeoutError: nothing arrived from the Hub for :data:`STALLED` seconds, whatever its client's limits.
    """
    from huggingface_hub import constants

    folders = [Path(constants.HF_HUB_CACHE) / f"models--{repository.replace('/', '--')}"]
    folders.append(Path(constants.HF_XET_CACHE))
    answer: queue.SimpleQueue[str | BaseException] = queue.SimpleQueue()

    def fetch() -> None:
        try:
            answer.put(download())
        except BaseException as error:  # raised where the answer is awaited
            answer.put(error)

    threading.Thread(target=fetch, daemon=True).start()
    size, moved = -1, time.monotonic()
    while time.monotonic() - moved < STALLED:
        with suppress(queue.Empty):
            found = answer.get(timeout=min(1.0, STALLED))
            if isinstance(found, BaseException):
                raise found
            return found
        now = _bytes_in(folders)
        if now != size:
            size, moved = now, time.monotonic()
    raise TimeoutError(f"nothing arrived for {STALLED:g} s")


def _bytes_in(folders: Sequence[Path]) -> int:
    """Bytes of all files in these folders, which may change meanwhile."""
    total = 0
    for file in (file for folder in folders for file in folder.rglob("*")):
        with suppress(OSError):
            total += file.stat().st_size
    return total


@contextmanager
def downloading(what: str, errors: type[Exception] = OSError) -> Iterator[None]:
    """Say how to do without a network where ``what`` cannot be downloaded.

    Raises:
        ConnectionError: in place of ``errors``.
    """
    try:
        yield
    except errors as error:
        raise ConnectionError(
            f"could not download {what} ({error}). Download it on a machine with internet access and give "
            "its path: model.backbone.pretrained=/path/to/file"
        ) from error


def load_torchvision_weights(
    module: nn.Module, name: str, pretrained: bool | str, *, by_order: bool = False
) -> None:
    """Load torchvision's weights, or a local file of them, into a backbone with torchvision's names.

    Args:
        module: the backbone; weights of a classifier (``fc.*``, ``classifier.*``) are ignored.
        name: torchvision's name of the network, such as ``"resnet18"``.
        pretrained: ``True`` for ``IMAGENET1K_V1``, from which the baselines in the literature start; the
            name of others (``"IMAGENET1K_V2"``); or a local file.
        by_order: match the tensors of a file with other names than torchvision's by their order, if their
            number and every shape agree. For networks that are shared in such files.

    Raises:
        ValueError: no such weights, or they do not fit.
        ConnectionError: they cannot be downloaded.
    """
    from torchvision.models import get_model_weights

    published = {weights.name: weights for weights in get_model_weights(name)}
    # VGG's IMAGENET1K_FEATURES expect a mean and standard deviation that DepthNet does not use
    published.pop("IMAGENET1K_FEATURES", None)
    choice = "IMAGENET1K_V1" if pretrained is True else str(pretrained)
    if choice in published:
        source = published[choice].url
        with downloading(source):
            weights = dict(published[choice].get_state_dict(progress=False, check_hash=True))
    elif Path(choice).expanduser().is_file():
        source = choice
        weights = read_weights(choice)
    else:
        raise ValueError(
            f"no weights {choice!r} for {name}: give true, one of {', '.join(published)}, or an existing file"
        )
    weights = {key: value for key, value in weights.items() if not key.startswith(("fc.", "classifier."))}
    if by_order and weights.keys() != module.state_dict().keys():
        weights = rename_by_order(weights, module.state_dict(), source)
    load_weights(module, weights, source)


def rename_by_order(weights: Weights, expected: Weights, source: str) -> Weights:
    """Return weights under the names of ``expected``, matched by order.

    Raises:
        ValueError: the numbers or the shapes of the tensors differ; the message names ``source``.
    """
    found, wanted = ([tuple(tensor.shape) for tensor in one.values()] for one in (weights, expected))
    if found != wanted:
        place = next((i for i, (a, b) in enumerate(zip(found, wanted, strict=False)) if a != b), None)
        what = "" if place is None else f"; {list(weights)[place]} would become {list(expected)[place]}"
        raise ValueError(
            f"the names in {source} differ from this network's, and its {len(found)} tensors do not fit its "
            f"{len(wanted)} in order{what}"
        )
    return dict(zip(expected, weights.values(), strict=True))

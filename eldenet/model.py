"""DepthNet: normalize -> network -> head. Written to and read from ``config.json`` + safetensors."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.backbones.base import Backbone
from eldenet.configurable import Configurable, build
from eldenet.decoders.base import Decoder
from eldenet.heads import Head
from eldenet.types import FeatureInfo

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
CONFIG_NAME, WEIGHTS_NAME = "config.json", "model.safetensors"


class EncoderDecoder(Configurable, nn.Module):
    """A backbone and a decoder that fits it: one kind of network.

    Args:
        backbone: image ``(B, 3, H, W)``, normalized -> features, finest first.
        decoder: a decoder class with its options but without ``feature_info``, which the backbone supplies
            (``functools.partial``, or ``_partial_: true`` in YAML).
    """

    def __init__(
        self, backbone: Backbone, decoder: Callable[[Sequence[FeatureInfo]], Decoder] | type[Decoder]
    ) -> None:
        super().__init__()
        self.backbone = backbone
        self.decoder = decoder(backbone.feature_info)
        self.config["decoder"] = self.decoder.config

    def forward(self, image: Tensor) -> Tensor:
        """Normalized image ``(B, 3, H, W)`` -> raw map ``(B, 1, h, w)``."""
        raw = self.decoder(self.backbone(image))
        rows, cols = (-(-side // self.decoder.stride) for side in image.shape[-2:])
        # a map finer than the finest feature may reach beyond an image of odd size, which no decoder sees
        return raw if raw.shape[-2:] == (rows, cols) else raw[..., :rows, :cols]


class DepthNet(Configurable, nn.Module):
    """A depth network that takes camera images and returns meters.

    Args:
        network: normalized image ``(B, 3, H, W)`` -> raw map ``(B, 1, h, w)`` of any size.
        head: raw map -> meters, with the range.
        refine: optional ``(depth, image) -> depth`` on the finished map.
        mean: per-channel mean of the normalization, RGB in [0, 1].
        std: per-channel standard deviation.

    Attributes:
        info: what ``save_pretrained`` was told about these weights (training data, protocol, ...). Of these,
            :func:`size_of_frames` reads ``input_size`` and ``whole_frame_size``, ``(height, width)`` [px].
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self,
        network: nn.Module,
        head: Head,
        *,
        refine: nn.Module | None = None,
        mean: Sequence[float] = IMAGENET_MEAN,
        std: Sequence[float] = IMAGENET_STD,
    ) -> None:
        super().__init__()
        self.network, self.head, self.refine = network, head, refine
        self.info: dict[str, Any] = {}
        self.register_buffer("mean", torch.tensor(mean).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(std).view(1, 3, 1, 1), persistent=False)

    @classmethod
    def from_parts(
        cls,
        backbone: Backbone,
        decoder: Callable[[Sequence[FeatureInfo]], Decoder],
        head: Head,
        refine: nn.Module | None = None,
        **normalization: Sequence[float],
    ) -> Self:
        """``DepthNet(EncoderDecoder(backbone, decoder), head)``: flat, as the model YAMLs write it."""
        return cls(EncoderDecoder(backbone, decoder), head, refine=refine, **normalization)

    def forward(self, image: Tensor) -> Tensor:
        """``image (B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m], for any H and W.

        Raises:
            ValueError: the image has another shape, or holds no floats.
        """
        if image.ndim != 4 or image.shape[1] != 3:
            raise ValueError(f"image has shape {tuple(image.shape)}, (B, 3, H, W) is needed")
        if not image.is_floating_point():
            raise ValueError(f"image is {image.dtype}: floats in [0, 1] are needed, divide bytes by 255")
        raw = self.network((image - self.mean) / self.std).float()
        if raw.shape[-2:] != image.shape[-2:]:
            raw = F.interpolate(raw, size=image.shape[-2:], mode="bilinear", align_corners=False)
        depth = self.head.to_meters(raw)
        return depth if self.refine is None else self.refine(depth, image)

    def save_pretrained(self, folder: str | Path, *, info: dict[str, Any] | None = None) -> Path:
        """Write ``config.json`` and ``model.safetensors`` into ``folder``.

        Args:
            folder: made if need be.
            info: facts worth keeping beside the weights (training data, protocol, metrics): JSON values. They
                go beside those the model came with, in place of those of the same name.

        Raises:
            ValueError: a part of the network is not :class:`Configurable`, so nobody could rebuild it.
        """
        from safetensors.torch import save_file

        from eldenet import __version__

        try:
            text = json.dumps(
                {
                    "eldenet_version": __version__,
                    "model": self.config,
                    "info": merged(self.info, info or {}),
                },
                indent=2,
            )
        except TypeError as error:
            raise ValueError(
                f"this model can't be written down: {error}. Its parts must subclass Configurable and take "
                "plain values, and so must info hold"
            ) from error
        state = {name: value.detach().cpu().contiguous() for name, value in self.state_dict().items()}
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = folder / f".{WEIGHTS_NAME}.part"  # a kill leaves the old weights or the new, never half
        save_file(state, unfinished, metadata={"format": "pt"})
        (folder / CONFIG_NAME).write_text(text + "\n")
        unfinished.chmod((folder / CONFIG_NAME).stat().st_mode)  # safetensors keeps others out
        unfinished.replace(folder / WEIGHTS_NAME)
        return folder

    @classmethod
    def from_pretrained(
        cls,
        source: str | Path,
        *,
        trusted_modules: Sequence[str] = (),
        revision: str | None = None,
    ) -> Self:
        """Rebuild a model from a folder that :meth:`save_pretrained` wrote, a run folder, or a Hub id.

        Of a run folder it is the best epoch, which a training saves in ``model/``.

        Nothing in that folder is executed: the config may name our own model parts only, or classes under
        ``trusted_modules``, and weights are safetensors.

        Raises:
            FileNotFoundError: neither a folder with both files nor a reachable Hub id.
            ValueError: the config is damaged or names something outside the trusted modules, or the weights
                are damaged or do not fit.
        """
        from safetensors import SafetensorError
        from safetensors.torch import load_file

        folder = _local_folder(source, revision)
        try:
            config = json.loads((folder / CONFIG_NAME).read_text())
        except ValueError as error:  # no JSON, or no text at all
            raise ValueError(f"{folder / CONFIG_NAME} can't be read as JSON: {error}") from error
        if not isinstance(config, dict) or "model" not in config:
            raise ValueError(f"{folder / CONFIG_NAME} has no entry 'model': not an eldenet model folder")
        model = build(config["model"], trusted_modules)
        if not isinstance(model, cls):
            raise ValueError(
                f"{folder / CONFIG_NAME} describes a {type(model).__name__}, not a {cls.__name__}"
            )
        try:
            model.load_state_dict(load_file(folder / WEIGHTS_NAME))
        except SafetensorError as error:
            raise ValueError(f"{folder / WEIGHTS_NAME} is not a whole safetensors file: {error}") from error
        except RuntimeError as error:
            raise ValueError(f"{folder / WEIGHTS_NAME} does not fit its own config: {error}") from error
        info = config.get("info")
        model.info = info if isinstance(info, dict) else {}
        return model.eval()

    def push_to_hub(
        self, repo_id: str, *, private: bool = False, token: str | None = None, **save_options: Any
    ) -> str:
        """Upload ``config.json`` and the weights to the Hugging Face Hub; returns the commit's address.

        Args:
            repo_id: "owner/name"; made if need be.
            private: whether a repository that is made is.
            token: with the right to write; None: the one that ``hf auth login`` keeps.
            **save_options: of :meth:`save_pretrained`.
        """
        import tempfile

        from huggingface_hub import HfApi

        api = HfApi(token=token)
        api.create_repo(repo_id, private=private, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            self.save_pretrained(folder, **save_options)
            return str(api.upload_folder(repo_id=repo_id, folder_path=folder))


def size_of_frames(info: Mapping[str, Any]) -> tuple[int, int] | None:
    """``(height, width)`` [px] at which weights want to see a camera's whole frame; None: not stated.

    That is the size they were trained at (``input_size``). Those that a protocol showed a part of the frame
    at that size state what the frame measures at the same scale (``whole_frame_size``), and that counts.
    """
    return info.get("whole_frame_size") or info.get("input_size")


def merged(own: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """``own`` facts about weights and ``given`` ones; an ``input_size`` that is given has no older frame."""
    lost = {"whole_frame_size"} if "input_size" in given else set()
    return {name: value for name, value in own.items() if name not in lost} | dict(given)


def _local_folder(source: str | Path, revision: str | None) -> Path:
    folder = Path(source)
    if folder.is_dir():
        of_run = folder / "model"
        return _complete(of_run if (of_run / CONFIG_NAME).is_file() else folder, folder)
    if folder.is_absolute() or str(source).count("/") != 1:
        raise FileNotFoundError(f"{source} is neither a folder here nor a Hub id of the form 'owner/name'")
    from huggingface_hub import snapshot_download

    try:
        folder = Path(
            snapshot_download(str(source), revision=revision, allow_patterns=[CONFIG_NAME, WEIGHTS_NAME])
        )
    except Exception as error:  # the Hub client raises many kinds, offline ones among them
        raise FileNotFoundError(
            f"{source} is no folder here, and the Hub could not give it: {type(error).__name__}: {error}"
        ) from error
    return _complete(folder, source)


def _complete(folder: Path, source: str | Path) -> Path:
    missing = [name for name in (CONFIG_NAME, WEIGHTS_NAME) if not (folder / name).is_file()]
    if missing:
        raise FileNotFoundError(f"{source} has no {' and no '.join(missing)}: not an eldenet model folder")
    return folder


@contextmanager
def eval_mode(model: nn.Module) -> Iterator[None]:
    """Eval mode for ``model``; afterwards every part is back in its own (a frozen part stays frozen)."""
    modes = {part: part.training for part in model.modules()}
    model.eval()
    try:
        yield
    finally:
        for part, training in modes.items():
            part.training = training

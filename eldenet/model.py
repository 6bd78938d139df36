"""DepthNet: normalize -> network -> head. Saved as ``config.json`` + safetensors."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.weights import IMAGENET_MEAN, IMAGENET_STD, load_weights, read_weights, until_stalled
from eldenet.configurable import Configurable, build
from eldenet.decoders.base import Decoder
from eldenet.geometry import check_one_per_image, in_meters
from eldenet.heads import Head, add_channels
from eldenet.ray_features import RayFeatures
from eldenet.system.checks import check_largest, check_size
from eldenet.system.digests import check_digests, with_digests
from eldenet.system.files import read_json, write_bytes, write_text
from eldenet.system.terminal import print_note
from eldenet.types import FeatureInfo
from eldenet.uncertainty import DepthEstimate
from eldenet.weights.model_card import MARK, model_card, summary

CONFIG_NAME, WEIGHTS_NAME, CARD_NAME = "config.json", "model.safetensors", "README.md"
SIZES = ("input_size", "whole_frame_size")  # entries of info that are (height, width) [px]


class EncoderDecoder(Configurable, nn.Module):
    """A network of a backbone and a decoder.

    Args:
        backbone: image ``(B, 3, H, W)``, normalized -> features, finest first.
        decoder: a decoder, or its class or a ``functools.partial`` of it (``_partial_: true`` in YAML), which
            gets ``feature_info`` from the backbone.
        rays: optional; tells the features the lens. Given in the same three ways as the decoder.
    """

    def __init__(
        self,
        backbone: Backbone,
        decoder: Decoder | Callable[[Sequence[FeatureInfo]], Decoder] | type[Decoder],
        rays: RayFeatures | Callable[[Sequence[FeatureInfo]], RayFeatures] | None = None,
    ) -> None:
        super().__init__()
        self.backbone = backbone
        self.decoder = decoder if isinstance(decoder, Decoder) else decoder(backbone.feature_info)
        self.config["decoder"] = self.decoder.config
        self.rays = rays if rays is None or isinstance(rays, RayFeatures) else rays(backbone.feature_info)
        if self.rays is not None:
            self.config["rays"] = self.rays.config

    def forward(self, image: Tensor, focal: Tensor | None = None) -> Tensor:
        """Normalized image ``(B, 3, H, W)``, fx ``(B,)`` [px], used by rays -> raw map ``(B, 1, h, w)``."""
        features = self.backbone(image)
        if self.rays is not None and focal is not None:
            features = self.rays(features, image.shape[-2:], focal)
        raw = self.decoder(features)
        rows, cols = (-(-side // self.decoder.stride) for side in image.shape[-2:])
        # a map finer than the finest feature can be larger than an odd-sized image: cut it. Do not decide by
        # the shapes alone: an export at any size would freeze the example's answer
        finer = self.decoder.stride < min(info.stride for info in self.backbone.feature_info)
        return raw[..., :rows, :cols] if finer or raw.shape[-2:] != (rows, cols) else raw


class DepthNet(Configurable, nn.Module):
    """A depth network: camera images in, meters out.

    With ``canonical_focal`` the network predicts depth as if a camera of that focal length had taken the
    image (Metric3D, Yin et al. 2023, section 3.2), and meters = canonical depth x focal / canonical focal.
    Its meters are then right for any lens; without it, only for the lens of the training.

    Args:
        network: normalized image ``(B, 3, H, W)`` -> raw map ``(B, 1, h, w)`` of any size. Where the head
            needs more channels, the network's last convolution gets them (see
            :func:`~eldenet.heads.add_channels`). One with ``rays`` also takes fx ``(B,)`` [px].
        head: raw map -> meters (with ``canonical_focal``: canonical meters) within a range.
        refine: optional ``(depth, image) -> depth``, applied to the head's depth.
        canonical_focal: focal length of the canonical camera, in widths of the training's images; None: the
            network ignores focal lengths.
        canonical_width: width of the training's images [px]; given together with ``canonical_focal``.
        mean: mean per channel of RGB in [0, 1], for the normalization.
        std: standard deviation per channel.

    Attributes:
        info: facts about the weights (training data, protocol, ...), saved with them. :func:`size_of_frames`
            reads ``input_size`` and ``whole_frame_size``, both ``(height, width)`` [px]. Where the training
            squeezed frames, ``stretch`` is how many times wider it showed things than they are.
        canonical_px: focal length of the canonical camera [px]; None without ``canonical_focal``.
        sees_rays: whether the network is told the focal length; others only have their depth scaled by it.

    Raises:
        ValueError: ``canonical_focal`` or ``canonical_width`` is not above 0, or only one of them is given,
            or neither for a network with ``rays``.
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
        canonical_focal: float | None = None,
        canonical_width: int | None = None,
    ) -> None:
        super().__init__()
        self.canonical_px = _canonical_px(canonical_focal, canonical_width)
        if head.channels > 1:
            add_channels(network, head.channels - 1)
        self.sees_rays = getattr(network, "rays", None) is not None
        if self.sees_rays and self.canonical_px is None:
            raise ValueError("a network with rays needs canonical_focal: give it, such as 0.8")
        self.network, self.head, self.refine = network, head, refine
        self.info: dict[str, Any] = {}
        self._range_checked = False
        self.register_buffer("mean", torch.tensor(mean).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(std).view(1, 3, 1, 1), persistent=False)

    @classmethod
    def from_parts(
        cls,
        backbone: Backbone,
        decoder: Callable[[Sequence[FeatureInfo]], Decoder],
        head: Head,
        refine: nn.Module | None = None,
        rays: Callable[[Sequence[FeatureInfo]], RayFeatures] | None = None,
        **options: Any,
    ) -> Self:
        """Return ``DepthNet(EncoderDecoder(...), head)``, for the flat YAML files of models."""
        return cls(EncoderDecoder(backbone, decoder, rays), head, refine=refine, **options)

    @property
    def distribution(self) -> str | None:
        """Distribution of the error in ln depth, "laplace" or "gaussian"; None: it predicts no sigma."""
        return self.head.distribution

    def forward(self, image: Tensor, focal: float | Tensor | None = None, with_spread: bool = False) -> Any:
        """``image (B, 3, H, W)`` RGB in [0, 1] -> depth ``(B, 1, H, W)`` [m], for any H and W.

        Args:
            focal: fx [px of ``image``], a number or ``(B,)``; 0, NaN and None stand for the canonical camera.
                Ignored without ``canonical_focal``.
            with_spread: return depth and the standard deviation of ln depth ``(B, 1, H, W)``.

        Raises:
            ValueError: an image of another shape, one that is not floating point or reaches 255 (only the
                first call checks), ``focal`` of another number of images, or ``with_spread`` for a network
                that predicts no sigma.
        """
        if image.ndim != 4 or image.shape[1] != 3:
            raise ValueError(f"image has shape {tuple(image.shape)}: give (B, 3, H, W)")
        if not image.is_floating_point():
            raise ValueError(f"image is {image.dtype}: give floats in [0, 1] (bytes divided by 255)")
        exporting = torch.compiler.is_compiling() or torch.jit.is_tracing()
        if not self._range_checked and not exporting:
            self._range_checked = True  # once: a look at the values makes the CPU wait for a GPU
            if image.numel() and image.device.type != "meta":
                check_largest(float(image.detach().max()))
        normalized = (image - self.mean) / self.std
        if self.sees_rays and focal is not None:
            lens = torch.as_tensor(focal, dtype=torch.float32, device=image.device)
            if not exporting:
                check_one_per_image(lens, len(image))
                lens = lens.reshape(-1).expand(len(image))
            raw = self.network(normalized, lens).float()
        else:
            raw = self.network(normalized).float()
        if raw.shape[-2:] != image.shape[-2:]:
            raw = F.interpolate(raw, size=image.shape[-2:], mode="bilinear", align_corners=False)
        depth = self.head.to_meters(raw)
        if self.refine is not None:
            depth = self.refine(depth, image)
        depth = in_meters(depth, focal, self.canonical_px)
        return (depth, self.head.to_spread(raw)) if with_spread else depth

    def predict(self, image: Tensor, focal: float | Tensor | None = None) -> DepthEstimate:
        """Depth as from :meth:`forward`, and its standard deviation [m]; None if the head predicts none.

        ``estimate.interval(0.9)`` contains the true depth for nine in ten pixels.
        """
        if self.distribution is None:
            return DepthEstimate(self(image, focal))
        depth, spread = self(image, focal, with_spread=True)
        return DepthEstimate(depth, depth * spread, self.distribution)

    def rescale(self, factor: float) -> None:
        """Make all depth ``factor > 0`` times as large from now on; the head's range changes with it."""
        self.head = self.head.rescaled(factor)
        self.config["head"] = self.head.config

    def save_pretrained(
        self, folder: str | Path, *, info: dict[str, Any] | None = None, half: bool = False
    ) -> Path:
        """Write ``config.json``, ``model.safetensors`` and a card, ``README.md``, into ``folder``.

        The config has digests of itself and of the weights. The card has the Hub's metadata and the metrics
        that ``info`` states (``info["test"]``, with their protocol); your own ``README.md`` is kept.

        Args:
            folder: created if it does not exist.
            info: facts about the weights (training data, protocol, metrics) as JSON values; added to
                :attr:`info`, replacing entries of the same name.
            half: store the parameters as fp16, in half the bytes; BatchNorm's statistics stay fp32. The
                network that is loaded again computes in fp32.

        Raises:
            ValueError: a part of the network is not :class:`Configurable`, ``info`` holds other values,
                NaN or a wrong size, or fp16 cannot hold a parameter.
        """
        from safetensors.torch import save

        from eldenet import __version__

        named = [(name, getattr(self, name)) for name in ("network", "head", "refine") if name in self.config]
        parts = {name: part.config if isinstance(part, Configurable) else part for name, part in named}
        try:
            config: dict[str, Any] = {
                "eldenet_version": __version__,
                # of the parts that it has now: model.head = LogHead() may have replaced one
                "model": self.config | parts,
                "info": merge_info(self.info, info or {}),
            }
            json.dumps(config, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"cannot save this model: {error}. Its parts must subclass Configurable, and their arguments "
                "and info must be plain values"
            ) from error
        for name in SIZES:
            check_size(f"{name} of info", config["info"].get(name))
        parameters = {name for name, _ in self.named_parameters(remove_duplicate=False)} if half else set()
        state = {
            # a copy: safetensors refuses parameters that two parts share
            name: (value.half() if name in parameters else value).detach().cpu().clone().contiguous()
            for name, value in self.state_dict().items()
        }
        lost = [name for name in sorted(parameters) if not state[name].isfinite().all()]
        if lost:
            raise ValueError(
                f"half=True: {lost[0]} has values beyond 65504, the largest of fp16; give half=False"
            )
        folder = Path(folder)
        weights = save(state, metadata={"format": "pt"})
        write_bytes(folder / WEIGHTS_NAME, weights)
        write_text(folder / CONFIG_NAME, json.dumps(with_digests(config, weights), indent=2) + "\n")
        card = folder / CARD_NAME
        if not card.is_file() or MARK in card.read_text(errors="replace"):  # the user's own one stays
            write_text(card, model_card(config["info"], config["model"]))
        return folder

    @classmethod
    def from_pretrained(
        cls,
        source: str | Path,
        *,
        trusted_modules: Sequence[str] = (),
        revision: str | None = None,
    ) -> Self:
        """Read a model from a folder written by :meth:`save_pretrained`, a run folder, or a Hub id.

        From a run folder it reads the best epoch, which training saves in ``model/``.

        No code in the folder is executed: the config may only name our own model parts and classes in
        ``trusted_modules``, and the weights are safetensors.

        Raises:
            FileNotFoundError: neither a folder with both files nor a reachable Hub id.
            ValueError: ``source`` is a file, the config is damaged or names something untrusted, or the
                weights are damaged (they do not match the config's digest) or do not fit.
        """
        folder = _folder_or_download(source, revision)
        config = _read_config(folder)
        model = build(config["model"], trusted_modules)
        if not isinstance(model, cls):
            raise ValueError(
                f"{folder / CONFIG_NAME} describes a {type(model).__name__}, not a {cls.__name__}"
            )
        path = folder / WEIGHTS_NAME
        load_weights(model, read_weights(path), path)
        model.info = config["info"]
        return model.eval()

    def push_to_hub(
        self, repo_id: str, *, private: bool = False, token: str | None = None, **save_options: Any
    ) -> str:
        """Upload ``config.json``, the weights and their card to the Hub; return the URL of the commit.

        Args:
            repo_id: "owner/name"; created if it does not exist.
            private: make a new repository private.
            token: a token with write access; None: the one stored by ``hf auth login``.
            **save_options: options of :meth:`save_pretrained`.
        """
        import tempfile

        from huggingface_hub import HfApi

        api = HfApi(token=token)
        api.create_repo(repo_id, private=private, exist_ok=True)
        with tempfile.TemporaryDirectory() as folder:
            self.save_pretrained(folder, **save_options)
            return str(api.upload_folder(repo_id=repo_id, folder_path=folder))


def _canonical_px(focal: float | None, width: int | None) -> float | None:
    """Return the canonical focal length [px] of ``focal`` widths and ``width`` [px]; None: there is none."""
    if focal is None and width is None:
        return None
    if focal is None or width is None or not (focal > 0 and width > 0):
        raise ValueError(
            f"canonical_focal={focal}, canonical_width={width}: give both above 0 (in widths, and the width "
            "of the training's images in pixels), or neither"
        )
    return float(focal) * float(width)


def size_of_frames(info: Mapping[str, Any]) -> tuple[int, int] | None:
    """Return the ``(height, width)`` [px] that weights expect of a whole camera frame; None: unknown.

    This is the size they were trained at (``input_size``). If their training cropped frames to that size, it
    is the size of the whole frame at the same scale (``whole_frame_size``).
    """
    return info.get("whole_frame_size") or info.get("input_size")


def merge_info(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``old`` facts about weights updated by ``new`` ones.

    A new ``input_size`` also removes the old ``whole_frame_size``.
    """
    outdated = "whole_frame_size" if "input_size" in new else None
    return {name: value for name, value in old.items() if name != outdated} | dict(new)


def _folder_or_download(source: str | Path, revision: str | None) -> Path:
    """Return the folder that holds ``source``: a local one, or the downloaded files of a Hub id."""
    folder = Path(source)
    if folder.is_dir():
        in_run = folder / "model"
        folder = in_run if (in_run / CONFIG_NAME).is_file() else folder
        _check_complete(folder, source)
        return folder
    if folder.is_file():
        raise ValueError(
            f"{source} is a file: give a run folder or a saved model; exported files are for eldenet predict "
            "and eldenet.deploy.runtimes.load"
        )
    if folder.is_absolute() or str(source).count("/") != 1 or folder.parent.is_dir():
        raise FileNotFoundError(f"{source} is neither a local folder nor a Hub id of the form 'owner/name'")
    from huggingface_hub import snapshot_download

    try:
        files = [CONFIG_NAME, WEIGHTS_NAME]
        folder = Path(
            until_stalled(
                lambda: snapshot_download(str(source), revision=revision, allow_patterns=files), str(source)
            )
        )
    except Exception as error:  # the Hub client raises many kinds
        reason = str(error) if isinstance(error, TimeoutError) else type(error).__name__
        raise FileNotFoundError(
            f"there is no folder {source}, and the Hub does not give it ({reason}): give a run "
            "folder, a model folder, a Hub id or packaged weights (eldenet.list_weights())"
        ) from error
    _check_complete(folder, source)
    info = _read_config(folder)["info"]
    print_note(f"{source}: {summary(info)}; https://huggingface.co/{source}")
    return folder


def _read_config(folder: Path) -> dict[str, Any]:
    """Return ``config.json``, once it and the weights match its digests and its facts have the right types.

    Raises:
        ValueError: one of them is damaged.
    """
    path = folder / CONFIG_NAME
    config = read_json(path)
    if not isinstance(config, dict) or "model" not in config:
        raise ValueError(f"{folder} is not an eldenet model folder: {CONFIG_NAME} has no entry 'model'")
    check_digests(config, path, folder / WEIGHTS_NAME)
    if not isinstance(config.get("info"), dict):
        config["info"] = {}
    for name in SIZES:
        check_size(f"{path}: {name} of info", config["info"].get(name))
    return config


def _check_complete(folder: Path, source: str | Path) -> None:
    """Raise FileNotFoundError unless ``folder``, where ``source`` lies, holds the config and the weights."""
    missing = [name for name in (CONFIG_NAME, WEIGHTS_NAME) if not (folder / name).is_file()]
    runs = sorted(Path(source).glob(f"*/model/{CONFIG_NAME}"))  # as in the folder of a sweep
    if missing and runs:
        run = runs[0].parent.parent
        raise FileNotFoundError(f"{source} holds {len(runs)} runs: give one of them, such as {run}")
    if missing:
        raise FileNotFoundError(f"{source} is not an eldenet model folder: it has no {' or '.join(missing)}")


@contextmanager
def eval_mode(model: nn.Module) -> Iterator[None]:
    """Put ``model`` into eval mode, and every part back into its own mode afterwards."""
    modes = {part: part.training for part in model.modules()}
    model.eval()
    try:
        yield
    finally:
        for part, training in modes.items():
            part.training = training

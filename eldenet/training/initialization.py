"""The network that a training starts from: seeded weights, or those of another training."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

import eldenet
from eldenet.configurable import instantiate
from eldenet.data.base import DepthDataset
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import whole_frame_size
from eldenet.geometry import same_aspect
from eldenet.losses.base import WeightedSum
from eldenet.model import DepthNet
from eldenet.results.fingerprints import differences
from eldenet.results.run_log import RunLog
from eldenet.system.resources import seed_everything
from eldenet.training.normalization import keep_normalization
from eldenet.weights import find_checkpoint

LEAST_SHARE = 0.1  # of the network's values that weights must fill to count as a start


def initial_model(
    network: Mapping[str, Any],
    seed: int,
    weights: str | None,
    trusted_modules: Sequence[str] = (),
    normalization: Mapping[str, Any] | None = None,
    log: RunLog | None = None,
) -> DepthNet:
    """Return the network with weights drawn from ``seed``, or taken over from ``weights``.

    Args:
        weights: where others come from, as :func:`eldenet.load` takes it; None: nowhere.
        trusted_modules: modules whose classes those weights may name.
        normalization: ``mean`` and ``std`` of the network's images, where they are not its own.
        log: receives a message about everything that is taken over.

    Raises:
        ValueError: the weights are those of another network, or of none.
    """
    own = bool({"mean", "std"} & network.keys())
    if normalization and own:
        raise ValueError("both normalization and model.mean or model.std are given: use one of them")
    seed_everything(seed)
    model: DepthNet = instantiate(network, "model", **(normalization or {}))
    if weights is not None:
        for line in _take_over(model, weights, trusted_modules, chosen=bool(normalization) or own):
            if log is not None:
                log.say(line)
    return model


def canonical_camera(focal: float | None, input_size: Sequence[int] | None) -> dict[str, Any]:
    """Return ``canonical_focal`` and ``canonical_width`` of the network to train; nothing without them.

    Raises:
        ValueError: the input's width is unknown.
    """
    if focal is None:
        return {}
    if input_size is None:
        raise ValueError(
            "canonical_focal is in widths of the input, but data.input_size=null leaves the width open: give "
            "data.input_size=[height,width], or canonical_focal=null"
        )
    return {"canonical_focal": focal, "canonical_width": input_size[1]}


def check_loss(loss: WeightedSum, model: DepthNet, teacher: str | None) -> None:
    """Raise ValueError if the loss does not train what the network predicts, or ignores the teacher."""
    if teacher is not None and not loss.signature:
        raise ValueError(
            f"teacher={teacher}: no term of this loss learns from a teacher; use loss=ssim_l1_distill, "
            "or remove teacher="
        )
    if loss.needs_spread == (model.distribution is not None):
        return
    raise ValueError(
        "model/head=uncertain learns its sigma from a likelihood: use loss=ssim_nll, or another head"
        if model.distribution is not None
        else "this loss trains a sigma, but the head predicts none: use model/head=uncertain, or another loss"
    )


def check_sources(loss: WeightedSum, data: Mapping[str, Any]) -> None:
    """Raise ValueError if the loss learns nothing from a source of a mix whose depth is relative."""
    terms = [term for term in loss.terms.values() if term.weight]
    if any(term.applies_to == "relative" or not term.needs_depth for term in terms):
        return
    for name, source in data.get("sources", {}).items():
        if source.get("relative") and source.get("weight", 1.0):
            raise ValueError(
                f"data.sources.{name}.relative=true: no term of this loss learns from relative depth; use "
                f"loss=ssim_l1_relative, or data.sources.{name}.relative=false for depth in meters"
            )


def check_range(model: DepthNet, data: Mapping[str, Any]) -> None:
    """Raise ValueError if the network cannot reach all depth that counts as known in frames of ``data``.

    One with a canonical camera is not checked: its reach depends on each frame's lens.
    """
    head = model.head
    near, far = data.get("min_depth") or head.min_depth, data.get("max_depth") or head.max_depth
    if model.canonical_px is None and not head.min_depth <= near <= far <= head.max_depth:
        raise ValueError(
            f"model.head reaches {head.min_depth:g} to {head.max_depth:g} m, but depth from {near:g} to "
            f"{far:g} m counts as known: leave min_depth and max_depth of model.head out, or give the same "
            "data.min_depth and data.max_depth"
        )


def _take_over(model: DepthNet, weights: str, trusted_modules: Sequence[str], *, chosen: bool) -> list[str]:
    """Copy all weights that fit into ``model``; ``chosen``: the user asked for its normalization.

    Returns:
        What a person should know about it.
    """
    find_checkpoint(weights, "weights", trained=True)
    start = eldenet.load(weights, trusted_modules=trusted_modules)
    own = model.state_dict()
    fitting = {
        name: value
        for name, value in start.state_dict().items()
        if name in own and own[name].shape == value.shape
    }
    if model.head.channels > start.head.channels:
        fitting |= _beside_new_channels(own, start.state_dict(), start.head.channels)
    share = sum(value.numel() for value in fitting.values()) / sum(value.numel() for value in own.values())
    if share < LEAST_SHARE:
        named = f" ({start.info['model_name']})" if "model_name" in start.info else ""
        raise ValueError(
            f"weights={weights}: they fit only {100 * share:.0f} % of this network: choose the one they "
            f"belong to{named}, leave weights out, or tune them with eldenet adapt"
        )
    model.load_state_dict(fitting, strict=False)
    copied = f"weights: {len(fitting)} of {len(own)} tensors copied from {weights}"
    if missing := sorted(own.keys() - fitting.keys()):
        copied += f"; not copied: {', '.join(missing[:3])}" + ", ..." * (len(missing) > 3)
    lines = [copied, keep_normalization(model, start, chosen=chosen)]
    if found := differences(model.config, start.config, ignored=frozenset({"mean", "std"})):
        lines.append(f"weights: from a network with other settings; here {', '.join(found)}")
    return [line for line in lines if line]


def _beside_new_channels(
    own: Mapping[str, Tensor], start: Mapping[str, Tensor], channels: int
) -> dict[str, Tensor]:
    """Tensors that have more channels than in ``start``: its ``channels``, followed by the own new ones."""
    return {
        name: torch.cat([value, own[name][channels:]])
        for name, value in start.items()
        if name in own
        and value.shape[:1] == (channels,)
        and own[name].shape[1:] == value.shape[1:]
        and len(own[name]) > channels
    }


def trained_sizes(
    input_size: Sequence[int] | None, protocol: EvalProtocol, train_set: DepthDataset
) -> dict[str, Any]:
    """Return ``(height, width)`` [px] of the network's input and, where a protocol crops, of the whole frame.

    The latter is that of the first frame. Where frames are squeezed into the input, ``stretch`` says by how
    much.
    """
    seen = None if input_size is None else list(input_size)
    sizes: dict[str, Any] = {"input_size": seen}
    height, width = train_set.load_frame(0).depth.shape
    whole = list(whole_frame_size(protocol, (height, width), seen))
    if protocol.changes_frames and whole != seen:
        sizes["whole_frame_size"] = whole
    if not same_aspect((whole[0], whole[1]), (height, width)):
        sizes["stretch"] = whole[1] * height / (whole[0] * width)
    return sizes

"""The network that a training starts from: seeded weights, or those of another training."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch

import eldenet
from eldenet.results.fingerprints import differences
from eldenet.system.resources import seed_everything
from eldenet.training.normalization import keep_normalization
from eldenet.weights import find_checkpoint

if TYPE_CHECKING:
    from torch import Tensor

    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog
    from eldenet.training.setup import TrainingSetup

LEAST_SHARE = 0.1  # of the network's values that weights must fill to count as a start


def initial_model(setup: "TrainingSetup", log: "RunLog", **normalization: Any) -> "DepthNet":
    """The network with weights drawn from ``setup.seed``, or taken over from ``setup.weights``.

    Args:
        setup: of the training.
        log: receives a message about everything that is taken over.
        normalization: ``mean`` and ``std`` of the network's images, where they are not its own.

    Raises:
        ValueError: the weights are those of another network, or of none.
    """
    if normalization and setup.own_normalization:
        raise ValueError("both normalization and model.mean or model.std are given: use one of them")
    seed_everything(setup.seed)
    model = setup.make_model(**normalization)
    if setup.weights is not None:
        _take_over(setup, model, log, chosen=bool(normalization) or setup.own_normalization)
    return model


def _take_over(setup: "TrainingSetup", model: "DepthNet", log: "RunLog", *, chosen: bool) -> None:
    """Copy all weights that fit into ``model``; ``chosen``: the user asked for its normalization."""
    weights = str(setup.weights)
    find_checkpoint(weights, "weights", trained=True)
    start = eldenet.load(weights, trusted_modules=setup.trusted_modules)
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
        raise ValueError(
            f"weights={weights}: they fit only {100 * share:.0f} % of this network: choose the one they "
            "belong to, or leave weights out"
        )
    model.load_state_dict(fitting, strict=False)
    copied = f"weights: {len(fitting)} of {len(own)} tensors copied from {weights}"
    if missing := sorted(own.keys() - fitting.keys()):
        copied += f"; not copied: {', '.join(missing[:3])}" + ", ..." * (len(missing) > 3)
    log.say(copied)
    if line := keep_normalization(model, start, chosen=chosen):
        log.say(line)
    if found := differences(model.config, start.config, ignored=frozenset({"mean", "std"})):
        log.say(f"weights: from a network with other settings; here {', '.join(found)}")


def _beside_new_channels(
    own: Mapping[str, "Tensor"], start: Mapping[str, "Tensor"], channels: int
) -> "dict[str, Tensor]":
    """Tensors that have more channels than in ``start``: its ``channels`` first, then the own ones."""
    return {
        name: torch.cat([value, own[name][channels:]])
        for name, value in start.items()
        if name in own
        and value.shape[:1] == (channels,)
        and own[name].shape[1:] == value.shape[1:]
        and len(own[name]) > channels
    }

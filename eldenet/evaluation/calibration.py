"""One temperature for a network's sigma, from frames that it was neither trained nor is scored on."""

import math
from itertools import chain

import torch

from eldenet.data.base import DepthDataset
from eldenet.data.loaders import evaluation_loader
from eldenet.evaluation.cost import device_of
from eldenet.evaluation.evaluator import is_padded, predict_spread
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.heads import UncertainHead
from eldenet.model import DepthNet, eval_mode
from eldenet.uncertainty import NO_SIGMA


@torch.inference_mode()
def fit_temperature(
    model: DepthNet, dataset: DepthDataset, protocol: EvalProtocol, *, batch_size: int = 16
) -> float:
    """Fit the factor of every sigma by likelihood, store it in the head, and return it.

    Guo et al., "On Calibration of Modern Neural Networks" (ICML 2017), here of a scale: the most likely one
    is the mean of ``|error| / scale`` of a Laplace distribution, and the root of the mean square of a normal
    one. Every image counts the same.

    Args:
        model: with :class:`~eldenet.heads.UncertainHead`.
        dataset: built for evaluation; scenes of neither training nor test.
        protocol: which pixels count.
        batch_size: images at a time.

    Raises:
        ValueError: the network predicts no sigma, or no depth is known.
    """
    head = model.head
    if not isinstance(head, UncertainHead):
        raise ValueError(NO_SIGMA)
    power = 1 if head.distribution == "laplace" else 2
    means = []
    device = device_of(model)
    with eval_mode(model):
        for batch in chain.from_iterable(evaluation_loader(dataset, batch_size)):
            focal = batch["intrinsics"][:, 0, 0].to(device)
            image = batch["image"].to(device)
            pad = is_padded(dataset, image)
            depth, spread = predict_spread(model, image, focal, flip=protocol.flip, pad=pad)
            truth = batch["depth"].to(device)
            valid = protocol.valid_mask(truth, batch["mask"].to(device))
            spread = protocol.align_spread(spread, depth, truth, valid)
            depth = protocol.align(depth, truth, valid)
            ratio = ((truth.clamp(min=1e-9) / depth).log().abs() / spread) ** power
            means += [
                float(one[known].double().mean())
                for one, known in zip(ratio, valid, strict=True)
                if known.any()
            ]
    if not means:
        raise ValueError(
            f"no pixel of {len(dataset)} frames has a known depth that protocol {protocol.name} counts: give "
            "other frames to calibrate on"
        )
    mean = sum(means) / len(means)
    factor = math.sqrt(2) * mean if power == 1 else math.sqrt(mean)
    head.temperature.mul_(factor)
    return float(head.temperature)

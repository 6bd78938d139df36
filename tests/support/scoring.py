"""What the tests of metrics and protocols share."""

from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from torch import Tensor

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.evaluation.metrics import DepthMetrics
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import chosen_protocol
from eldenet.results.run_log import RunLog
from eldenet.results.score import score
from eldenet.train import TrainSettings
from support.networks import small_net
from support.training import ONE_THREAD


def from_yaml(name: str) -> EvalProtocol:
    return instantiate(compose(TrainSettings, [f"protocol={name}"]).protocol)


def batch(seed: int, images: int = 3, size: tuple[int, int] = (14, 18), known: float = 0.7):
    """Prediction, depth [m] and mask ``(B, 1, H, W)``; ``known`` is the share of the mask that is True."""
    generator = torch.Generator().manual_seed(seed)
    shape = (images, 1, *size)
    depth = 0.2 + 11 * torch.rand(shape, generator=generator)
    prediction = depth * (0.6 + 0.8 * torch.rand(shape, generator=generator))
    return prediction, depth, torch.rand(shape, generator=generator) < known


def scores(protocol: EvalProtocol, *batches: tuple[Tensor, Tensor, Tensor]) -> dict[str, float]:
    metrics = DepthMetrics(protocol)
    for one in batches:
        metrics.update(*one)
    return metrics.compute()


def assert_same(ours: dict[str, float], expected: dict[str, float], rel: float = 1e-5) -> None:
    assert ours == {
        name: pytest.approx(value, rel=rel, abs=1e-9, nan_ok=True) for name, value in expected.items()
    }


def score_small(s, folder: Path, split: str) -> dict:
    """``run.json`` of an untrained small network on a split, by the settings of a training."""
    protocol = chosen_protocol(s.data, s.protocol)
    model = small_net()
    model.info = {"model_name": "small", "seed": 0}
    settings = asdict(s) | {"output": str(folder), "split": split}
    return score(model, settings, protocol, ONE_THREAD, RunLog(folder))

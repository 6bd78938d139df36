"""What the tests of metrics and protocols share."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from eldenet.config import build_training, compose, instantiate
from eldenet.evaluation.metrics import DepthMetrics
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.results.run_log import RunLog
from eldenet.results.score import ScoreSetup, score_and_record
from support.networks import small_net
from support.training import ONE_THREAD


def from_yaml(name: str) -> EvalProtocol:
    return instantiate(compose("train", [f"protocol={name}"]).protocol)


def batch(seed: int, images: int = 3, size: tuple[int, int] = (14, 18), known: float = 0.7):
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


def score_small(config, folder: Path, split: str) -> dict:
    """``run.json`` of an untrained small network on a split of a composed ``train`` config."""
    setup = build_training(config, folder)
    scoring = ScoreSetup(
        folder=folder,
        name="small",
        data=setup.data,
        seed=0,
        protocol=setup.protocol,
        make_split=setup.make_split,
        resources=ONE_THREAD,
        settings=setup.settings,
        split=split,
        training_frames=setup.settings["data"]["train"].get("frames"),
    )
    return score_and_record(scoring, small_net(), RunLog(folder))

"""Whole evaluations: every frame once and in order, whatever the batches, sizes and processes."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from support.networks import small_net
from support.scoring import assert_same
from support.synthetic import SyntheticDepth
from support.training import PROTOCOL
from torch import Tensor, nn

from eldenet.data.loaders import collate, evaluation_loader
from eldenet.deploy.predictor import DepthPredictor
from eldenet.evaluation.constant_baseline import ConstantPredictor
from eldenet.evaluation.evaluator import evaluate, picture_of_samples, predict_depth
from eldenet.evaluation.metric_names import METRICS
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.types import Frame

FOUR_METERS = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))
SIZES = ((32, 48), (32, 48), (24, 32), (32, 48), (24, 32), (24, 32), (40, 40))


class Mixed(SyntheticDepth):
    def load_frame(self, index: int) -> Frame:
        self.size = SIZES[index]
        return super().load_frame(index)


class Leaning(nn.Module):
    """Depth grows to the right, so the prediction of the mirror image differs."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(()))

    def forward(self, image: Tensor) -> Tensor:
        ramp = torch.linspace(1, 9, image.shape[-1]).expand(len(image), 1, image.shape[-2], -1)
        return ramp * self.scale + image.mean(dim=1, keepdim=True)


def test_the_lens_stays_in_the_center_of_what_a_network_sees() -> None:
    """``predict`` and ``evaluate`` extend both sides of pictures whose sides are no multiples of 16."""

    def from_center(image: Tensor, _: object = None) -> Tensor:
        rows, columns = (torch.arange(side) - (side - 1) / 2 for side in image.shape[-2:])
        return 1 + rows[:, None].abs() + columns.abs().expand(len(image), 1, 1, -1)

    model = small_net()
    model.forward = from_center
    predicted = torch.from_numpy(DepthPredictor(model)(np.zeros((24, 40, 3), np.uint8)))
    assert len(predicted) == 24
    for depth in (predicted, predict_depth(model, torch.zeros(1, 3, 24, 40), pad=True)[0, 0]):
        torch.testing.assert_close(depth, depth.flip(0))
        torch.testing.assert_close(depth, depth.flip(1))


def test_the_picture_shows_the_prediction_that_is_scored() -> None:
    """The mean of a ramp and its mirror image is the same everywhere, as ``FOUR_METERS``."""
    leaning = small_net()
    leaning.forward = lambda image: torch.linspace(1, 7, 48).expand(len(image), 1, 32, -1)
    protocol = EvalProtocol("p", ground_truth="dense", flip="mean")
    shown, wanted = (
        picture_of_samples(model, SyntheticDepth(1), protocol) for model in (leaning, FOUR_METERS)
    )
    np.testing.assert_array_equal(shown, wanted)


def test_each_frame_is_scored_once_at_the_size_of_the_ground_truth() -> None:
    dataset = SyntheticDepth(5, input_size=(16, 24), resize_depth=False)
    protocol = EvalProtocol("p", ground_truth="dense", size=(32, 48))
    model = Leaning().train()
    result, again = (evaluate(model, dataset, protocol, batch_size=size) for size in (2, 5))
    assert_same(result.metrics, again.metrics, rel=1e-6)
    assert [row[0] for row in result.rows] == dataset.names
    assert (result.metrics["images"], result.metrics["pixels"]) == (5, 5 * 32 * 48)
    mean_of_rows = np.mean([row[1:] for row in result.rows], axis=0)
    assert mean_of_rows.tolist() == pytest.approx([result.metrics[name] for name in METRICS])
    assert model.training


def test_another_kind_of_ground_truth_is_refused() -> None:
    with pytest.raises(ValueError, match="scores raw ground truth, this data set has dense"):
        evaluate(Leaning(), SyntheticDepth(2), EvalProtocol("p"))


def test_batches_of_several_sizes_score_as_single_frames() -> None:
    data = Mixed(7)
    one, four = (evaluate(FOUR_METERS, data, PROTOCOL, batch_size=size) for size in (1, 4))
    assert [row[0] for row in four.rows] == data.names
    assert four.metrics == pytest.approx(one.metrics)
    with pytest.raises(ValueError, match=r"different sizes in one training batch.*set data\.input_size"):
        collate([data[0], data[2]])


def test_processes_share_the_frames_without_overlap() -> None:
    data = Mixed(7)
    for rank in range(2):
        loader = evaluation_loader(data, 3, rank=rank, processes=2)
        batches = [(list(batch["name"]), batch["image"].shape[-2:]) for runs in loader for batch in runs]
        assert [name for names, _ in batches for name in names] == data.names[rank::2]
        assert all(SIZES[data.names.index(name)] == tuple(size) for names, size in batches for name in names)


SCRIPT = """
import json, sys, torch
from accelerate import PartialState
from support.synthetic import SyntheticDepth
from support.training import PROTOCOL
from eldenet.evaluation.constant_baseline import ConstantPredictor
from eldenet.data.loaders import evaluation_loader
from eldenet.evaluation.evaluator import evaluate_batches

state = PartialState(cpu=True)
torch.set_num_threads(1)
loader = evaluation_loader(SyntheticDepth(7), 2, rank=state.process_index, processes=state.num_processes)
model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))
result = evaluate_batches(model, loader, PROTOCOL, processes=state.num_processes)
if state.is_main_process:
    json.dump([result.metrics, result.rows], open(sys.argv[1], "w"))
state.wait_for_everyone()
state.destroy_process_group()
"""


def test_two_processes_score_as_one(tmp_path: Path, command_server) -> None:
    script, output = tmp_path / "two.py", tmp_path / "two.json"
    script.write_text(SCRIPT)
    for rank in command_server.run_ranks(str(script), [str(output)], tmp_path):
        assert rank.returncode == 0, rank.stderr
    metrics, rows = json.loads(output.read_text())
    one = evaluate(FOUR_METERS, SyntheticDepth(7), PROTOCOL, batch_size=2)
    assert metrics == pytest.approx(one.metrics, rel=1e-12)
    assert [row[0] for row in rows] == [row[0] for row in one.rows]

"""Evaluation counts every image once, however many processes share it; the constant predictor."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from support.synthetic import SyntheticDepth
from support.training import PROTOCOL

from eldenet.evaluation.evaluator import ConstantPredictor, evaluate, fit_constant_predictor


def test_constant_predictor_is_the_mean_of_known_depth():
    class Halves(SyntheticDepth):
        def load_frame(self, index):
            frame = super().load_frame(index)
            depth = frame.depth * 0 + (2.0 if index == 0 else 4.0)
            depth[:, :10] = 0 if index == 1 else 1.0
            return frame._replace(depth=depth)

    mean = fit_constant_predictor(Halves(2)).mean_depth
    assert mean.shape == (1, 1, 32, 48)
    assert mean[0, 0, 0, 0] == 1.0  # unknown in the second frame
    assert mean[0, 0, 0, 20] == 3.0


def test_evaluation_shards_count_every_image_once():
    model, data = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0)), SyntheticDepth(7)
    whole = evaluate(model, data, PROTOCOL, batch_size=3)
    names = [row[0] for row in whole.rows]
    assert names == data.names
    from eldenet.data.loaders import evaluation_loader

    shares = [
        [name for batch in loader for name in batch[0]["name"]]
        for loader in (evaluation_loader(data, 2, rank=rank, processes=3) for rank in range(3))
    ]
    assert sorted(name for share in shares for name in share) == sorted(data.names)


def test_two_processes_score_as_one(tmp_path):
    script = tmp_path / "two.py"
    script.write_text(
        "import json, sys, torch\n"
        f"sys.path.insert(0, {str(Path(__file__).parents[1])!r})\n"
        "from support.synthetic import SyntheticDepth\n"
        "from eldenet.evaluation.evaluator import ConstantPredictor, evaluate\n"
        "from eldenet.evaluation.protocol import EvalProtocol\n"
        "from accelerate import PartialState\n"
        "state = PartialState(cpu=True)\n"
        "torch.set_num_threads(1)\n"
        "model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))\n"
        "result = evaluate(model, SyntheticDepth(7), EvalProtocol('synthetic', min_depth=0.1, "
        "ground_truth='dense'), batch_size=2, rank=state.process_index, processes=state.num_processes)\n"
        "if state.is_main_process:\n"
        "    json.dump([result.metrics, result.rows], open(sys.argv[1], 'w'))\n"
        "state.wait_for_everyone()\n"
        "state.destroy_process_group()\n"
    )
    subprocess.run(
        [
            *(sys.executable, "-m", "torch.distributed.run", "--nproc_per_node=2", "--master_port=0"),
            *("--standalone", str(script), str(tmp_path / "two.json")),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    metrics, rows = json.loads((tmp_path / "two.json").read_text())
    model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))
    one = evaluate(model, SyntheticDepth(7), PROTOCOL, batch_size=2)
    assert metrics == pytest.approx(one.metrics, rel=1e-12)
    assert [row[0] for row in rows] == [row[0] for row in one.rows]

"""Frames of several sizes in one data set: scored size by size, in order, whatever shares a batch."""

from pathlib import Path

import numpy as np
import pytest
import torch
from support import layouts
from support.scoring import score_small
from support.synthetic import SyntheticDepth
from support.training import PROTOCOL

from eldenet.config import compose
from eldenet.data.folder import FolderDataset
from eldenet.data.loaders import collate, evaluation_loader
from eldenet.evaluation.evaluator import ConstantPredictor, evaluate, fit_constant_predictor
from eldenet.types import Frame

SIZES = ((32, 48), (32, 48), (24, 32), (32, 48), (24, 32), (24, 32), (40, 40))


class Mixed(SyntheticDepth):
    def load_frame(self, index: int) -> Frame:
        self.size = SIZES[index]
        return super().load_frame(index)


def mixed_folder(root: Path, count: int = 10) -> Path:
    """Every third pair is larger than the others."""
    layouts.folder(root, count=count)
    large = layouts.content((60, 80))
    for i in range(1, count, 3):
        layouts.picture(root / f"images/f{i:03d}.png", large.rgb)
        layouts.picture(root / f"depths/f{i:03d}.png", large.millimeters)
    return root


def test_batches_of_several_sizes_score_as_single_frames():
    model, data = ConstantPredictor(torch.full((1, 1, 8, 8), 4.0)), Mixed(7)
    one, four = (evaluate(model, data, PROTOCOL, batch_size=size) for size in (1, 4))
    assert [row[0] for row in four.rows] == data.names
    assert four.metrics == pytest.approx(one.metrics)
    shares = [
        [(list(batch["name"]), batch["image"].shape[-2:]) for runs in loader for batch in runs]
        for loader in (evaluation_loader(data, 3, rank=rank, processes=2) for rank in range(2))
    ]
    assert [name for names, _ in shares[0] for name in names] == data.names[::2]
    assert [name for names, _ in shares[1] for name in names] == data.names[1::2]
    assert all(SIZES[data.names.index(n)] == tuple(size) for s in shares for names, size in s for n in names)
    with pytest.raises(ValueError, match=r"different sizes.*a training.*set data\.input_size"):
        collate([data[0], data[2]])


def test_a_mean_depth_map_needs_one_size():
    with pytest.raises(ValueError, match=r"synthetic/2 is \(24, 32\), that of synthetic/0 \(32, 48\)"):
        fit_constant_predictor(Mixed(7))
    assert fit_constant_predictor(Mixed(7, input_size=(16, 16))).mean_depth.shape[-2:] == (16, 16)


@pytest.mark.parametrize("input_size", ["[32,40]", "null"])
def test_a_mixed_folder_is_scored_to_the_end(input_size, tmp_path, capsys):
    root = mixed_folder(tmp_path / "set")
    words = ["data=folder", f"data.root={root}", f"data.input_size={input_size}"]
    words += ["model_name=small", f"run_dir={tmp_path}"]
    config = compose("train", words)
    record = score_small(config, tmp_path, "train")
    assert record["metrics"]["images"] == 9
    assert (record["constant_predictor"] is None) == (input_size == "null")
    assert ("no constant predictor beside the result: the depth of" in capsys.readouterr().out) == (
        input_size == "null"
    )
    assert (tmp_path / "run.json").is_file()


def test_intrinsics_are_of_one_size(tmp_path):
    root, options = mixed_folder(tmp_path), {"max_depth": 10.0, "intrinsics": [60, 60, 32, 24]}
    data = FolderDataset(root, **options)
    assert data[0]["intrinsics"][0, 0] == 60
    with pytest.raises(ValueError, match=r"f001\.png is \(60, 80\), .*f000\.png is \(48, 64\).*intrinsics"):
        data[1]
    # a split that holds the other size alone is told the same
    with pytest.raises(ValueError, match=r"f000\.png is \(48, 64\)"):
        FolderDataset(root, split="val", val_names=["f001"], **options)[0]
    skipping = FolderDataset(root, on_error="skip", **options)
    skipping.leave_out_unreadable()
    assert len(skipping) == 7
    assert np.isfinite(FolderDataset(root, max_depth=10.0)[1]["depth"]).all()

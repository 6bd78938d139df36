"""KITTI frames as samples and under their protocols: crops by pixel, subsets, sizes that differ."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.layouts import (
    DRIVES,
    kitti_depth,
    kitti_frame,
)
from torch import Tensor, nn

from eldenet.compose import compose
from eldenet.data.kitti import KITTIDepth
from eldenet.data.loaders import collate_runs
from eldenet.evaluation.evaluator import evaluate, picture_of_samples
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.train import TrainSettings


def test_subset_is_seeded_and_named(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path, numbers=(5, 6, 7))
    whole = KITTIDepth(root, split="all")

    def draw(count: int, seed: int) -> KITTIDepth:
        data = KITTIDepth(root, split="all")
        data.draw_subset(count, seed)
        return data

    drawn = draw(5, seed=1)
    assert drawn.names == draw(5, seed=1).names
    assert drawn.names == sorted(set(drawn.names), key=whole.names.index)
    assert len(drawn) == 5
    hashes = {draw(5, seed).split_hash for seed in range(4)}
    assert len(hashes | {whole.split_hash}) == 5
    for i, name in enumerate(drawn.names):
        frame = drawn.load_frame(i)
        assert frame.name == name
        np.testing.assert_array_equal(frame.depth, whole.load_frame(whole.names.index(name)).depth)
    with pytest.raises(ValueError, match="subset=13: KITTIDepth found 12 frames"):
        draw(13, seed=0)


def test_small_depth_keeps_its_points(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    sample = KITTIDepth(root, split="all", input_size=(75, 414))[0]
    steps = kitti_frame(DRIVES[0]).steps
    blocks = np.where(steps == 0, 65535, steps).reshape(75, 5, 414, 3).min((1, 3))
    expected = np.where(blocks == 65535, 0, blocks) / 256
    np.testing.assert_array_equal(sample["depth"][0], expected.astype(np.float32))


def split_under(root: Path, protocol: str, split: str, *more: str) -> tuple[Any, Any]:
    overrides = ["data=kitti", f"data.root={root}", f"protocol={protocol}", *more]
    config = compose(TrainSettings, [*overrides, "data.input_size=null", f"data.{split}.split=all"])
    rules = chosen_protocol(config.data, config.protocol)
    return rules, open_split(config.data, split, rules)


def test_kb_crop_by_pixel(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    rules, train = split_under(root, "kitti_eigen_garg_improved", "train")
    sample = train[0]
    rgb, steps = kitti_frame(DRIVES[0])
    np.testing.assert_array_equal(
        (sample["image"] * 255).round().numpy().transpose(1, 2, 0), rgb[23:, 13:1229]
    )
    known = np.where(steps[23:, 13:1229] / 256 <= 80, steps[23:, 13:1229] / 256, 0)
    np.testing.assert_array_equal(sample["depth"][0], np.where(known < 1, 0, known).astype(np.float32))
    torch.testing.assert_close(sample["intrinsics"][:2, 2], torch.tensor([596.5593, 149.854]))
    _, val = split_under(root, "kitti_eigen_garg_improved", "val")
    whole = val[0]
    assert whole["image"].shape == (3, 352, 1216)
    assert whole["depth"].shape == (1, 375, 1242)
    torch.testing.assert_close(whole["intrinsics"], sample["intrinsics"])
    assert rules.pasted_box(375, 1242) == (23, 375, 13, 1229)
    assert rules.pasted_box(370, 1224) == (18, 370, 4, 1220)
    _, second = split_under(root, "kitti_depth", "val")
    assert second[2]["image"].shape[-2:] == second[2]["depth"].shape[-2:] == (352, 1216)


@pytest.mark.slow
def test_every_split_is_scored_in_the_whole_frame(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path)
    words = ["data=kitti", f"data.root={root}", "protocol=kitti_eigen_garg_improved"]
    words += [f"data.{split}.split=all" for split in ("train", "val")]
    config = compose(TrainSettings, [*words, "data.input_size=null"])
    rules = chosen_protocol(config.data, config.protocol)
    train, val = (open_split(config.data, split, rules, score=True) for split in ("train", "val"))
    assert train[0]["depth"].shape == val[0]["depth"].shape == (1, 375, 1242)
    one, other = (evaluate(Ramp(), data, rules, batch_size=4) for data in (train, val))
    assert one.metrics == pytest.approx(other.metrics, nan_ok=True)


def test_912x228_by_pixel(tmp_path: Path) -> None:
    root = kitti_depth(tmp_path, kind="velodyne_raw")
    sparse = "data.depth=velodyne_raw"
    rules, crop = split_under(root, "kitti_s2d_912x228", "val", sparse, "data.max_depth=120")
    rgb, steps = kitti_frame(DRIVES[2])
    top, left = 130 + (240 - 228) // 2, 10 + (1200 - 912) // 2
    assert (top, left) == (136, 154)
    window = (slice(top, top + 228), slice(left, left + 912))
    image = (crop[2]["image"] * 255).round().numpy().transpose(1, 2, 0)
    np.testing.assert_array_equal(image, rgb[window])
    np.testing.assert_array_equal(crop[2]["depth"][0], (steps[window] / 256).astype(np.float32))
    assert crop[2]["intrinsics"][0, 2] == pytest.approx(609.5593 - left)
    assert (rules.clamp, rules.max_depth, rules.size) == (False, 120.0, (228, 912))
    rules, squeezed = split_under(root, "kitti_paper", "val", sparse)
    sample = squeezed[0]
    assert sample["image"].shape[-2:] == sample["depth"].shape[-2:] == (228, 912)
    fx, fy = sample["intrinsics"][0, 0].item(), sample["intrinsics"][1, 1].item()
    assert (fx, fy) == (pytest.approx(721.5377 * 912 / 1216), pytest.approx(721.5377 * 228 / 352))
    steps = kitti_frame(DRIVES[0]).steps[23:, 13:1229]
    expected = np.full((228, 912), np.inf)
    for row, col in np.argwhere(steps):
        at = int((row + 0.5) * 228 / 352), int((col + 0.5) * 912 / 1216)
        expected[at] = min(expected[at], steps[row, col] / 256)
    np.testing.assert_array_equal(
        sample["depth"][0], np.where(expected <= 80, expected, 0).astype(np.float32)
    )


class Ramp(nn.Module):
    """Depth that grows to the right, whatever it sees."""

    def __init__(self) -> None:
        super().__init__()
        self.start = nn.Parameter(torch.tensor(2.0))

    def forward(self, image: Tensor) -> Tensor:
        ramp = torch.linspace(0, 60, image.shape[-1]).expand(len(image), 1, image.shape[-2], -1)
        return ramp + self.start


@pytest.mark.slow
def test_frames_of_two_sizes_in_one_evaluation(tmp_path: Path) -> None:
    """Batches of two dates; batch size 1 says the same, and both what is written out here."""
    root = kitti_depth(tmp_path, numbers=(5, 6))
    rules, data = split_under(root, "kitti_eigen_garg_improved", "val")
    assert [data.size_group(i) for i in (0, 3, 4)] == ["2011_09_26", "2011_09_26", "2011_09_28"]
    assert [len(batch["name"]) for batch in collate_runs([data[i] for i in (2, 3, 4)])] == [2, 1]
    one, four = (evaluate(Ramp(), data, rules, batch_size=size) for size in (1, 4))
    assert [row[0] for row in four.rows] == data.names
    assert one.metrics == pytest.approx(four.metrics, nan_ok=True)
    errors = []
    for name in data.names:
        depth = kitti_frame(name[:26]).steps / 256
        height, width = depth.shape
        prediction = np.zeros_like(depth)
        left = (width - 1216) // 2
        prediction[height - 352 :, left : left + 1216] = np.linspace(0, 60, 1216) + 2
        inside = np.zeros_like(depth, bool)
        inside[
            int(0.40810811 * height) : int(0.99189189 * height),
            int(0.03594771 * width) : int(0.96405229 * width),
        ] = True
        counts = inside & (depth > 1e-3) & (depth < 80)
        errors.append(np.abs(prediction - depth)[counts].mean())
    assert four.metrics["mae"] == pytest.approx(np.mean(errors), rel=1e-5)
    assert four.metrics["images"] == len(data)
    assert picture_of_samples(Ramp(), data, rules).shape[2] == 3

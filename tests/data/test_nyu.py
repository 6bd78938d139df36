"""NYU Depth V2 in every layout: meters, intrinsics, names, the split, and errors that name the file."""

from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from support.layouts import SMALL, densedepth, hdf5, labeled, mat, mat_split, sync

from eldenet.data.nyu import (
    NYUDenseDepth,
    NYULabelled,
    NYUSync,
    nyu_intrinsics,
)
from eldenet.data.nyu_hdf5 import NYUHDF5, NYUMat
from eldenet.data.nyu_scenes import DEV_FRAMES, VAL_FRAMES, labeled_part

RGB, METERS, MILLIMETERS, EIGHT = SMALL
SIZE = METERS.shape


def check_picture(image: np.ndarray) -> None:
    assert image.dtype == np.uint8
    assert image.shape == RGB.shape
    np.testing.assert_allclose(image[10, 8], (200, 30, 30), atol=4)
    np.testing.assert_allclose(image[10, 56], (30, 200, 90), atol=4)


def test_densedepth_reads_8_bit_training_and_16_bit_test_depth(tmp_path: Path) -> None:
    train = NYUDenseDepth(densedepth(tmp_path), split="trainval")
    assert train.names == ["kitchen_0001_out/1", "office_0002_out/1"]
    assert train.ground_truth == "inpainted"
    assert (train.min_depth, train.max_depth) == (1e-3, 10.0)
    frame = train.load_frame(0)
    check_picture(frame.image)
    np.testing.assert_array_equal(frame.depth, (EIGHT / 255 * 10).astype(np.float32))
    test = NYUDenseDepth(tmp_path, split="test")
    assert test.names == ["00000_colors"]
    assert NYUDenseDepth(tmp_path).names == ["office_0002_out/1"]
    assert NYUDenseDepth(tmp_path, split="val").names == ["kitchen_0001_out/1"]
    np.testing.assert_array_equal(test.load_frame(0).depth, (MILLIMETERS / 1000).astype(np.float32))
    other = NYUDenseDepth(tmp_path, split="val", encoding="nyu8_labelled").load_frame(0)
    np.testing.assert_allclose(other.depth, (EIGHT + 0.5) * 9.99547 / 255, rtol=1e-6)


def test_sample_after_resize(tmp_path: Path) -> None:
    data = NYUDenseDepth(densedepth(tmp_path), split="test", input_size=(24, 32), resize_depth=False)
    sample = data[0]
    assert sample["image"].shape == (3, 24, 32)
    assert sample["depth"].shape == sample["mask"].shape == (1, *SIZE)
    np.testing.assert_array_equal(sample["mask"][0], MILLIMETERS > 0)
    scale = 24 / 480
    expected = [[518.8579 * scale, 0, 326.0824 * scale - 0.5], [0, 519.4696 * scale, 254.2362 * scale - 0.5]]
    np.testing.assert_allclose(sample["intrinsics"][:2], expected, rtol=1e-6)
    np.testing.assert_allclose(nyu_intrinsics()[:2], [[518.8579, 0, 325.5824], [0, 519.4696, 253.7362]])
    assert NYUDenseDepth(tmp_path, max_depth=5.0)[0]["depth"].max() <= 5.0


def test_labelled_frames_are_split_by_number(tmp_path: Path) -> None:
    labeled(tmp_path)
    assert NYULabelled(tmp_path, split="train").names == ["labeled_out/0003", "labeled_out/0030"]
    assert NYULabelled(tmp_path, split="val").names == ["labeled_out/0022", "labeled_out/0023"]
    assert len(NYULabelled(tmp_path, split="all")) == 4
    depth = NYULabelled(tmp_path).load_frame(0).depth
    np.testing.assert_array_equal(depth, ((EIGHT + 0.5) * 9.99547 / 255).astype(np.float32))
    (tmp_path / "data/nyu2_train.csv").write_text("kitchen_0001_out/x.jpg,kitchen_0001_out/x.png\n")
    with pytest.raises(ValueError, match=r"kitchen_0001_out/x\.jpg.*number"):
        NYULabelled(tmp_path)


def test_sync_reads_raw_depth_and_bts_lists(tmp_path: Path, monkeypatch) -> None:
    data = NYUSync(sync(tmp_path))
    assert data.names == ["kitchen_0001/rgb_00000", "office_0002/rgb_00041"]
    assert data.ground_truth == "raw"
    frame = data.load_frame(1)
    check_picture(frame.image)
    np.testing.assert_array_equal(frame.depth, (MILLIMETERS / 1000).astype(np.float32))
    for split, scene in (("train", "office_0002/rgb_00041"), ("val", "kitchen_0001/rgb_00000")):
        assert NYUSync(tmp_path, split=split).names == [scene]
    assert NYUSync(tmp_path, split="test").names == data.names
    lines = tmp_path / "list.txt"
    lines.write_text("/office_0002/rgb_00041.jpg /office_0002/sync_depth_00041.png 518.8579\n")
    monkeypatch.setenv("HOME", str(tmp_path))
    listed = NYUSync(tmp_path, list_file="~/list.txt")
    assert listed.names == ["office_0002/rgb_00041"]
    np.testing.assert_array_equal(listed.load_frame(0).depth, frame.depth)
    lines.write_text("office_0002/rgb_00041.jpg\n")
    with pytest.raises(ValueError, match=r"list\.txt, line 1"):
        NYUSync(tmp_path, list_file=lines)


def test_hdf5_reads_both_parts_and_splits_scenes(tmp_path: Path) -> None:
    data = NYUHDF5(hdf5(tmp_path), split="trainval")
    assert data.names == ["train/kitchen_0001/00001", "train/office_0002/00001"]
    assert data.ground_truth == "inpainted"
    frame = data.load_frame(1)
    np.testing.assert_array_equal(frame.image, RGB)
    np.testing.assert_array_equal(frame.depth, METERS)
    assert NYUHDF5(tmp_path, split="test").names == ["val/official/00002"]
    assert NYUHDF5(tmp_path, split="train").names == ["train/office_0002/00001"]
    assert NYUHDF5(tmp_path, split="val").names == ["train/kitchen_0001/00001"]
    with h5py.File(tmp_path / "val/official/00002.h5", "w") as file:
        file["image"] = RGB
    with pytest.raises(ValueError, match=r"00002\.h5 has no 'rgb', only image"):
        NYUHDF5(tmp_path, split="test")[0]


def test_mat_reads_both_ground_truths_and_the_official_split(tmp_path: Path) -> None:
    mat(tmp_path)
    assert NYUMat(tmp_path, split="test").names == ["0001", "0004"]
    assert NYUMat(tmp_path, split="trainval").names == ["0002", "0003"]
    frame = NYUMat(tmp_path, split="all").load_frame(1)
    np.testing.assert_array_equal(frame.image, RGB + 1)
    np.testing.assert_array_equal(frame.depth, METERS + 1)
    raw = NYUMat(tmp_path, split="all", ground_truth="raw")
    assert raw.ground_truth == "raw"
    np.testing.assert_array_equal(raw[0]["mask"][0], MILLIMETERS > 0)
    assert NYUMat(tmp_path, split="train").names == ["0002", "0003"]


def test_mat_own_split_is_by_frame_number(tmp_path: Path) -> None:
    mat(tmp_path, count=30)
    mat_split(tmp_path, train=(3, 22, 23, 28), test=(1,))
    assert NYUMat(tmp_path, split="train").names == ["0003", "0028"]
    assert NYUMat(tmp_path, split="val").names == ["0022", "0023"]
    mat_split(tmp_path, train=(6, 25, 26, 31), test=(3, 22))
    with pytest.raises(ValueError, match="has 30 frames, not 31 as 'trainval' needs"):
        NYUMat(tmp_path, split="trainval")


def test_mat_without_the_ground_truth(tmp_path: Path) -> None:
    mat(tmp_path)
    with h5py.File(tmp_path / "nyu_depth_v2_labeled.mat", "a") as file:
        del file["rawDepths"]
    with pytest.raises(ValueError, match=r"no 'rawDepths', only depths, images"):
        NYUMat(tmp_path, split="all", ground_truth="raw")


def test_val_and_dev_frames_are_in_order_and_apart() -> None:
    blocks = sorted([*VAL_FRAMES, *DEV_FRAMES])
    assert [*VAL_FRAMES] == sorted(VAL_FRAMES)
    assert [*DEV_FRAMES] == sorted(DEV_FRAMES)
    # another frame at least stands between two blocks of different parts, or they would share a scene
    assert all(end + 1 < start for (_, end), (start, _) in pairwise(blocks))
    assert labeled_part(22) == "val"
    assert labeled_part(27) == "val"
    assert labeled_part(21) != "val"
    assert labeled_part(28) != "val"

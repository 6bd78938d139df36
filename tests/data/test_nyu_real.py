"""Real frames of NYU Depth V2, if they are there: their depth, and a split that shares no scene."""

from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
from support.layouts import real_folder

from eldenet.data.nyu import (
    NYULabelled,
    NYUSync,
)
from eldenet.data.nyu_hdf5 import NYUMat
from eldenet.data.nyu_scenes import VAL_FRAMES


@pytest.fixture
def real() -> Path:
    return real_folder("nyu_depth_v2", "labeled/data/nyu2_train.csv")


def test_real_labelled_frames(real: Path) -> None:
    everything = NYULabelled(split="all")
    train, val = NYULabelled(split="train"), NYULabelled(split="val")
    assert (len(everything), len(train), len(val)) == (795, 665, 130)
    assert not set(train.names) & set(val.names)
    fit, dev = NYULabelled(split="fit"), NYULabelled(split="dev")
    assert (len(fit), len(dev)) == (553, 112)
    assert sorted([*fit.names, *dev.names]) == sorted(train.names)
    for index in range(0, 795, 53):
        frame = everything.load_frame(index)
        raw = cv2.imread(str(real / "labeled/data/nyu2_train" / f"{frame.name}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(frame.depth, ((raw + 0.5) * 9.99547 / 255).astype(np.float32))
        assert frame.image.shape == (480, 640, 3)
        assert (frame.depth >= 0.7).all()
        np.testing.assert_allclose(frame.intrinsics[0, 2], 325.5824)


def test_real_sync_frames(real: Path) -> None:
    data = NYUSync()
    assert len(data) == 2
    for index in range(2):
        sample = data[index]
        number = data.names[index][-5:]
        path = real / f"sync/basement_0001a/sync_depth_{number}.png"
        raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(data.load_frame(index).depth, (raw / 1000).astype(np.float32))
        assert 0.6 < sample["mask"].float().mean() < 0.8


def test_real_mat(real: Path) -> None:
    file = "nyu_depth_v2_labeled_REPACKED_6.mat"
    if not (real / "labeled" / file).exists():
        pytest.skip(f"{file} is not there")
    data = NYUMat(split="all", file=file)
    assert len(data) == 6
    with h5py.File(real / "labeled" / file) as raw:
        for index in range(6):
            frame = data.load_frame(index)
            np.testing.assert_array_equal(frame.depth, raw["depths"][index].T)
            np.testing.assert_array_equal(frame.image, raw["images"][index].transpose(2, 1, 0))


def test_real_split_takes_whole_runs(real: Path) -> None:
    """A frame of the official test split lies on either side of each block: that is where scenes change."""
    numbers = [int(name[-4:]) for name in NYULabelled(split="all").names]
    assert numbers == sorted(numbers)
    for first, last in VAL_FRAMES:
        assert {first, last} <= set(numbers)
        assert not {first - 1, last + 1} & set(numbers)
        assert set(range(first, last + 1)) <= set(numbers)

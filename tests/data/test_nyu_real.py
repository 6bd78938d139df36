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
from eldenet.data.nyu_scenes import VAL_FRAMES, labeled_part


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


def sift(path: Path) -> tuple[np.ndarray, np.ndarray]:
    gray = cv2.imread(str(path), cv2.IMREAD_REDUCED_GRAYSCALE_2)[8:232, 8:312]
    points, found = cv2.SIFT_create(200, contrastThreshold=0.02).detectAndCompute(gray, None)
    return np.array([p.pt for p in points], np.float32).reshape(-1, 2), found


def inliers(one: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]) -> int:
    if min(len(one[0]), len(other[0])) < 10:
        return 0
    pairs = cv2.BFMatcher().knnMatch(one[1], other[1], k=2)
    good = [m for m, n in pairs if m.distance < 0.8 * n.distance]
    if len(good) < 8:
        return 0
    points = np.float32([one[0][m.queryIdx] for m in good]), np.float32([other[0][m.trainIdx] for m in good])
    cv2.setRNGSeed(0)
    matrix, mask = cv2.findFundamentalMat(*points, cv2.FM_RANSAC, 1.5, 0.99)
    return 0 if matrix is None else int(np.count_nonzero(mask))  # without a matrix the mask is not written


def test_real_split_shares_no_view(real: Path) -> None:
    """No two frames on the two sides of a border show the same things; neighbors within a block do."""
    data = NYULabelled(split="all")
    paths = {int(name[-4:]): real / "labeled/data/nyu2_train" / f"{name}.jpg" for name in data.names}
    numbers = sorted(paths)
    across, within = [], []
    for first, last in VAL_FRAMES:
        a, b = numbers.index(first), numbers.index(last)
        views = {n: sift(paths[n]) for n in numbers[max(a - 2, 0) : a + 2] + numbers[b - 1 : b + 3]}
        across += [
            inliers(views[x], views[y])
            for x in views
            for y in views
            if labeled_part(x) != "val" and labeled_part(y) == "val"
        ]
        within.append(inliers(views[first], views[numbers[a + 1]]))
    assert max(across) <= 15
    assert sum(n > 15 for n in within) >= 5


def test_real_split_has_no_near_duplicates(real: Path) -> None:
    """Thumbnails of all pairs across the split: different rooms reach 0.8 at most, a repeated frame 1."""

    def thumbnails(data: NYULabelled) -> np.ndarray:
        small = []
        for name in data.names:
            path = str(real / "labeled/data/nyu2_train" / f"{name}.jpg")
            picture = cv2.imread(path, cv2.IMREAD_REDUCED_COLOR_8)[2:-2, 2:-2]
            tiny = cv2.resize(picture, (20, 15), interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
            small.append((tiny - tiny.mean()) / (tiny.std() * np.sqrt(tiny.size)))
        return np.array(small)

    across = thumbnails(NYULabelled(split="val")) @ thumbnails(NYULabelled(split="train")).T
    assert across.shape == (130, 665)
    assert across.max() < 0.88

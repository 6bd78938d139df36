"""Sharpening: depth that steps where its picture does."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import eldenet
from eldenet.data.rooms import Rooms
from eldenet.deploy.predictor import DepthPredictor
from eldenet.deploy.sharpen import sharpen


def test_sharpening_makes_a_ramp_a_step_at_the_pictures_edge() -> None:
    truth = np.full((96, 128), 1.0, np.float32)
    truth[:, 64:] = 3.0
    image = np.repeat((80 * truth[..., None]).astype(np.uint8), 3, axis=2)
    ramp = gaussian_filter(truth, (0, 4), mode="nearest")
    out = sharpen(ramp, image)
    assert np.abs(out - truth).mean() < 0.4 * np.abs(ramp - truth).mean()
    assert (out[:, 60] < 2).all()
    assert (out[:, 67] > 2).all()
    flat = np.full((96, 128), 2.5, np.float32)
    np.testing.assert_array_equal(sharpen(flat, image), flat)


@pytest.mark.parametrize(
    ("size", "works_at"),
    [((480, 640), (240, 320)), ((900, 300), (720, 240)), ((3, 5), (3, 5)), ((500, 8000), (60, 960))],
)
def test_sharpening_takes_pictures_of_any_shape(size: tuple[int, int], works_at: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (*size, 3), np.uint8)
    depth = rng.uniform(1, 5, (24, 32)).astype(np.float32)
    out = sharpen(depth, image)
    assert out.shape == works_at
    assert 1 <= out.min() <= out.max() <= 5


@pytest.mark.slow
def test_a_sharp_predictor_is_closer_to_the_truth_at_edges(tmp_path: Path) -> None:
    frames = Rooms("val", 8, size=(192, 256), root=tmp_path, workers=0)
    model = eldenet.load("eldenet_rooms")
    errors = []
    for sharp in (False, True):
        predictor = DepthPredictor(model, steady=False, sharp=sharp)
        found = []
        for index in range(8):
            frame = frames.load_frame(index)
            depth = predictor(frame.image)
            assert depth.shape == frame.depth.shape
            step = np.abs(np.diff(np.log(frame.depth), axis=1, prepend=0)) > 0.1
            step[:, 0] = False
            near = gaussian_filter(step.astype(float), 2) > 0.05
            found.append(np.abs(np.log(depth / frame.depth))[near].mean())
        errors.append(np.mean(found))
    assert errors[1] < errors[0]

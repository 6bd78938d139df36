"""The filter of a video's depth: steady where a scene stays, unchanged where it does not."""

import cv2
import numpy as np
import pytest

import eldenet
from eldenet.deploy.steady import SteadyFilter
from eldenet.simulation.furnished_rooms.render import render_room

SIZE = (96, 128)


@pytest.fixture
def scene() -> np.ndarray:
    noise = np.random.default_rng(0).integers(0, 256, (12, 16, 3), dtype=np.uint8)
    return cv2.resize(noise, SIZE[::-1], interpolation=cv2.INTER_CUBIC)


def flickering(frames: int) -> np.ndarray:
    """Depth maps of a still scene, each with an error of its own in scale."""
    scales = np.random.default_rng(1).normal(0, 0.1, (frames, 1, 1))
    return (2.0 * np.exp(scales) * np.ones((1, *SIZE))).astype(np.float32)


def change(depth: np.ndarray) -> float:
    return float(np.abs(np.diff(np.log(depth), axis=0)).mean())


def test_a_still_scene_flickers_less_than_half_as_much(scene):
    steady, raw = SteadyFilter(), flickering(30)
    filtered = np.stack([steady(scene, depth) for depth in raw])
    assert change(filtered) < 0.5 * change(raw)
    assert np.abs(np.log(filtered / 2)).mean() < np.abs(np.log(raw / 2)).mean()


def test_a_steady_approach_does_not_lag(scene):
    steady = SteadyFilter()
    raw = np.exp(-0.02 * np.arange(60))[:, None, None] * np.full((1, *SIZE), 4.0)
    filtered = np.stack([steady(scene, depth) for depth in raw.astype(np.float32)])
    assert np.abs(np.log(filtered[30:] / raw[30:])).max() < 0.02  # one frame's change


def test_depth_moves_with_the_pixels(scene):
    """A near stripe that moves with its texture is neither smeared nor left behind."""
    steady = SteadyFilter()
    for shift in range(12):
        image = np.roll(scene, 2 * shift, axis=1)
        depth = np.full(SIZE, 4.0, np.float32)
        depth[:, 30 + 2 * shift : 50 + 2 * shift] = 1.0
        filtered = steady(image, depth)
    inside = filtered[8:-8, 30 + 22 + 5 : 50 + 22 - 5]
    assert np.median(inside) == pytest.approx(1.0, rel=0.02)


def test_another_scene_comes_back_unchanged():
    steady = SteadyFilter()
    for room, depth in enumerate(flickering(5)):
        assert steady(render_room("val", room, SIZE, views=1).image[0], depth) is depth


@pytest.mark.parametrize("change", [lambda depth: 2 * depth, lambda depth: depth[:48] * 1.1])
def test_a_jump_in_scale_and_another_size_start_anew(scene, change):
    steady, depth = SteadyFilter(), flickering(1)[0]
    steady(scene, depth)
    np.testing.assert_array_equal(steady(scene, change(depth)), change(depth))


def test_the_predictor_is_steady_in_a_loop_unless_told_otherwise(scene):
    model = eldenet.load("eldenet_rooms")
    generator = np.random.default_rng(3)
    frames = [
        np.clip(scene + generator.normal(0, 6, scene.shape), 0, 255).astype(np.uint8) for _ in range(12)
    ]
    alone = eldenet.DepthPredictor(model, steady=False)
    steady = eldenet.DepthPredictor(model)
    raw, filtered = (np.stack([predict(frame) for frame in frames]) for predict in (alone, steady))
    np.testing.assert_array_equal(raw[0], filtered[0])
    assert change(filtered) < 0.6 * change(raw)
    np.testing.assert_array_equal(alone(frames[0]), raw[0])

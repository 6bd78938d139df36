"""A simulated stereo depth camera: what its right eye does not see is unknown; noise grows with distance."""

import numpy as np
import pytest

from eldenet.simulation.depth_camera import StereoArtifacts, occluded

EXACT = StereoArtifacts(noise=0, mixed=0, dead_columns=0)


def measure(artifacts, depth, focal=100.0, seed=0):
    rng = np.random.default_rng(seed)
    return artifacts.apply(depth, focal, artifacts.draw_dead(depth.shape[1], rng), rng)


def a_post(width=80, back=4.0, front=1.0):
    depth = np.full((6, width), back)
    depth[:, 30:50] = front
    return depth


def test_the_shadow_of_an_object_is_as_wide_as_its_disparity_exceeds_that_of_the_wall():
    # 100 px x 0.05 m: 5 px of disparity at 1 m, 1.25 px at 4 m
    unknown = measure(EXACT, a_post()) == 0
    assert unknown[:, 27:30].all()
    assert unknown.sum() == 6 * 3


def test_pixels_that_both_see_land_in_order_in_the_right_picture():
    rng = np.random.default_rng(1)
    disparity = 5 / rng.uniform(0.5, 6, (20, 90))
    hidden = occluded(disparity)
    assert 0.05 < hidden.mean() < 0.9
    at = np.arange(90) - disparity
    for row, unseen in zip(at, hidden, strict=True):
        assert (np.diff(row[~unseen]) > 0).all()


def test_a_wall_ahead_is_measured_exactly_without_noise():
    np.testing.assert_allclose(measure(EXACT, np.full((4, 40), 2.5)), 2.5, rtol=1e-6)


def test_noise_grows_with_the_square_of_the_distance():
    near, far = (measure(EXACT._replace(noise=1e-4), np.full((60, 400), z)) for z in (1.0, 3.0))
    assert (far.std() / near.std()) == pytest.approx(9, rel=0.05)


def test_dead_columns_and_what_is_too_near_are_unknown():
    depth = np.full((5, 64), 2.0)
    depth[:, :8] = 0.2
    found = measure(EXACT._replace(dead_columns=2), depth)
    assert (found[:, :8] == 0).all()
    assert (found[:, 8:] == 0).all(axis=0).sum() in (0, 1, 2)
    assert ((found == 0).all(axis=0) | (found > 0).all(axis=0)).all()


def test_pixels_at_edges_lie_between_front_and_back():
    found = measure(EXACT._replace(mixed=1.0), a_post())
    edge = found[:, 50]
    assert ((edge > 1.0) & (edge < 4.0)).all()
    assert (found[:, 31:50] == 1.0).all()

"""Geometry against explicit projections and kornia."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from kornia.geometry.depth import depth_to_3d

from eldenet.geometry import back_project, crop_intrinsics, intrinsic_matrix, pinhole, resize_intrinsics

K = pinhole(518.9, 519.5, 325.6, 253.7)


def project(point: np.ndarray, k: np.ndarray) -> tuple[float, float]:
    x, y, z = point
    return k[0, 0] * x / z + k[0, 2], k[1, 1] * y / z + k[1, 2]


points = st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.2, 10)).map(np.array)
sides = st.integers(3, 900)


@given(point=points, height=sides, width=sides)
def test_resize_moves_every_point_like_the_pixels(point: np.ndarray, height: int, width: int) -> None:
    u, v = project(point, K)
    # relative to the image, from its border half a pixel before the first center, nothing moves
    expected = (u + 0.5) / 640 * width - 0.5, (v + 0.5) / 480 * height - 0.5
    assert project(point, resize_intrinsics(K, (480, 640), (height, width))) == pytest.approx(expected)


@given(point=points, top=st.integers(0, 400), left=st.integers(0, 600))
def test_crop_moves_every_point_by_the_corner(point: np.ndarray, top: int, left: int) -> None:
    u, v = project(point, K)
    assert project(point, crop_intrinsics(K, top, left)) == pytest.approx((u - left, v - top))


def test_resize_agrees_with_opencvs_pixels() -> None:
    """An image of its own ray coordinates stays correct under cv2.resize."""
    rows, cols = np.indices((40, 60), dtype=np.float64)
    rays = np.stack([(cols - 31.3) / 50, (rows - 18.2) / 55], axis=-1)
    small = cv2.resize(rays, (20, 10), interpolation=cv2.INTER_LINEAR)
    moved = resize_intrinsics(pinhole(50, 55, 31.3, 18.2), (40, 60), (10, 20))
    np.testing.assert_allclose(back_project(np.ones((10, 20)), moved)[..., :2], small, atol=1e-12)


def test_back_projection_equals_kornia() -> None:
    depth = np.random.default_rng(0).uniform(0.5, 9, (12, 17))
    intrinsics = pinhole(20.0, 22.0, 7.7, 6.1)
    theirs = depth_to_3d(torch.from_numpy(depth)[None, None], torch.from_numpy(intrinsics)[None])
    np.testing.assert_allclose(back_project(depth, intrinsics), theirs[0].permute(1, 2, 0).numpy())


@pytest.mark.parametrize(
    "given",
    [
        [20, 22, 7, 6.5],
        (20.0, 22.0, 7.0, 6.5),
        np.array([20, 22, 7, 6.5]),
        [[20, 0, 7], [0, 22, 6.5], [0, 0, 1]],
    ],
)
def test_intrinsics_are_four_numbers_or_a_matrix(given) -> None:
    matrix = intrinsic_matrix(given)
    assert matrix.dtype == np.float64
    np.testing.assert_array_equal(matrix, pinhole(20, 22, 7, 6.5))


@pytest.mark.parametrize(
    ("wrong", "shown"),
    [
        ((20, 22, 7), "[20, 22, 7]"),
        ([[20, 0, 7], [0, 22]], "[[20, 0, 7], [0, 22]]"),
        (np.eye(2), "[[1.0, 0.0], [0.0, 1.0]]"),
        ("lens", "lens"),
        (None, "None"),
        ((20, 0, 7, 6), "[20, 0, 7, 6]"),
        ((-20, 22, 7, 6), "[-20, 22, 7, 6]"),
        ((20, 22, np.nan, 6), "[20, 22, nan, 6]"),
        (np.zeros((3, 3)), str(np.zeros((3, 3)).tolist())),  # of an uncalibrated camera in ROS
    ],
)
def test_what_is_no_camera_is_refused_in_one_line(wrong, shown: str) -> None:
    with pytest.raises(ValueError, match=r"^intrinsics=") as error:
        intrinsic_matrix(wrong)
    assert str(error.value) == (
        f"intrinsics={shown}: give [fx, fy, cx, cy] of a calibrated camera in pixels, fx and fy above 0, "
        "or the (3, 3) matrix"
    )


def test_unchecked_intrinsics_keep_their_numbers() -> None:
    """The driver stops the robot itself where they are not finite."""
    assert np.isnan(intrinsic_matrix((np.nan, 22, 7, 6), check=False)[0, 0])
    with pytest.raises(ValueError, match=r"give \[fx, fy, cx, cy\]"):
        intrinsic_matrix((np.nan, 22), check=False)

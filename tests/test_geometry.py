"""Geometry against explicit projections and kornia."""

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from kornia.geometry.depth import depth_to_3d

from eldenet.geometry import (
    back_project,
    check_intrinsics,
    crop_intrinsics,
    focal_of_fov,
    intrinsic_matrix,
    pinhole,
    resize_intrinsics,
)

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


def judged(intrinsics, size=(480, 640)) -> None:
    check_intrinsics(intrinsic_matrix(intrinsics), size)


@pytest.mark.parametrize(
    ("wrong", "unit"),
    [
        ((26, 26, 320, 240), "171 degrees in a picture 640 px wide: a focal length in mm"),
        ((0.0042, 0.0042, 320, 240), "a focal length in meters"),
        ((0.81, 0.81, 320, 240), "a focal length divided by the width"),
        ((0.81, 1.08, 0.5, 0.5), "divided by the picture's size.* 518.4, 518.4, 320, 240"),
        ((1e300, 1e300, 320, 240), "3.* degrees"),
        ((26, 26, 18, 12), "in mm of the sensor"),
        ((1036, 1036, 640, 480), "outside the picture.* about 1281 x 961"),
        ((518, 150, 320, 240), "fx is 3.5 times fy: give fx, fy, cx, cy in this order"),
        ((True, 518, 320, 240), r"\[True, 518, 320, 240\]: give"),
        ([[518, 0, 0], [0, 518, 0], [320, 240, 1]], "give the transpose"),
        ((K / 640).tolist(), "the last row is not 0 0 1"),
        ([[518, 30, 320], [0, 518, 240], [0, 0, 1]], "without skew"),
        (np.eye(3), "180 degrees"),
    ],
)
def test_intrinsics_in_another_unit_are_refused_with_the_likely_one(wrong, unit) -> None:
    with pytest.raises(ValueError, match=unit) as error:
        judged(wrong)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("camera", "size"),
    [
        ((518.9, 519.5, 325.6, 253.7), (480, 640)),  # NYU
        ((721.5, 721.5, 609.6, 172.9), (375, 1242)),  # KITTI
        ((721.5, 721.5, 596.6, 149.9), (352, 1216)),  # its crop
        ((2262.5, 2265.3, 1096.98, 513.14), (1024, 2048)),  # Cityscapes
        ((1036, 1036, 319.5, 239.5), (480, 640)),  # a crop of 2x
        ((1454, 1454, 2015, 1511), (3024, 4032)),  # a phone's wide lens, 108 degrees
        ((7300, 7300, 319.5, 239.5), (480, 640)),  # 5 degrees
        ((86, 86, 319.5, 239.5), (480, 640)),  # 150 degrees
        ([[518, 0.5, 320], [0, 518, 240], [0, 0, 1]], (480, 640)),
    ],
)
def test_lenses_that_exist_pass_without_a_word(camera, size, caplog) -> None:
    judged(camera, size)
    assert not caplog.records


@pytest.mark.parametrize(("factor", "right"), [(0.5, "320 x 240"), (0.45, "288 x 216"), (1.6, "1024 x 768")])
def test_intrinsics_of_another_size_name_the_size_that_they_are_right_for(factor, right, caplog) -> None:
    other = resize_intrinsics(pinhole(520, 520, 319.5, 239.5), (480, 640), (480 * factor, 640 * factor))
    for _ in range(2):
        check_intrinsics(other, (480, 640))
    assert [f"right at about {right}" in record.getMessage() for record in caplog.records] == [True]


@pytest.mark.parametrize(("size", "warned"), [((480, 640), 1), ((640, 640), 0), ((600, 640), 0), ((4, 4), 0)])
def test_intrinsics_of_the_turned_picture_are_warned_of(size, warned, caplog) -> None:
    middle = ((size[1] - 1) / 2, (size[0] - 1) / 2)
    check_intrinsics(pinhole(size[1], size[1], *middle), size)
    assert not caplog.records
    check_intrinsics(pinhole(size[1], size[1], *reversed(middle)), size)
    assert len(caplog.records) == warned


def test_one_variable_lets_any_lens_through(monkeypatch: pytest.MonkeyPatch, caplog) -> None:
    monkeypatch.setenv("ELDENET_ANY_LENS", "1")
    for camera in ((26, 26, 320, 240), (518, 150, 100, 240), (40_000, 40_000, 320, 240)):
        judged(camera)
    assert focal_of_fov(170, 640) == pytest.approx(28, abs=0.1)
    assert not caplog.records
    for wrong in ((1e300, 1e300, 320, 240), [[518, 0, 0], [0, 518, 0], [320, 240, 1]]):
        with pytest.raises(ValueError, match=r"degrees|transpose"):
            judged(wrong)

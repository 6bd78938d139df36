"""The ground: fitted to depth, known from calibration, and the bird's-eye view it gives."""

import numpy as np
import pytest
from support.blocks import CAMERA, block

from eldenet.geometry import PinholeCamera, pinhole
from eldenet.perception.ground import GroundHomography, GroundPlane, fit_ground


def test_the_ground_is_found_beside_walls_and_objects(views):
    for view in views:
        plane = fit_ground(view.depth, view.camera)
        assert plane is not None
        assert plane.offset == pytest.approx(view.height, abs=0.05)
        assert plane.normal[1] > 0.999


@pytest.mark.parametrize("turn", [np.pi, np.pi / 2])
def test_the_ground_is_found_in_every_viewing_direction(turn):
    depth, _ = block((30.0, 0.85, 70.0))
    c, s = np.cos(turn), np.sin(turn)
    camera = PinholeCamera(CAMERA.intrinsics, np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))
    plane = fit_ground(depth, camera)
    assert plane is not None
    assert plane.offset == pytest.approx(1.6, abs=0.02)


def test_walls_and_unknown_depth_show_no_ground():
    wall = np.full((100, 100), 3.0)
    assert fit_ground(wall, PinholeCamera(pinhole(90, 90, 50, 50))) is None
    assert fit_ground(np.zeros((100, 100)), CAMERA) is None
    with pytest.raises(ValueError, match="no ground"):
        GroundHomography.from_depth(wall, PinholeCamera(pinhole(90, 90, 50, 50)))


def test_the_plane_homography_is_back_projection_with_the_planes_depth():
    normal = np.array([0.03, 1.0, -0.05])
    plane = GroundPlane(normal / np.linalg.norm(normal), 1.6)
    camera = PinholeCamera(CAMERA.intrinsics, np.eye(3), np.array([0.06, 0.01, -0.02]))
    ground = GroundHomography(camera, plane)
    columns, rows = np.meshgrid(np.arange(0.0, 640, 40), np.arange(140.0, 240, 20))
    points = camera.back_project(columns, rows, ground.depth(columns, rows))
    np.testing.assert_allclose(plane.height_above(points), 0, atol=1e-12)
    np.testing.assert_allclose(ground.to_ground(columns, rows), points[..., [0, 2]], atol=1e-9)


def test_from_calibration_and_from_depth_agree():
    depth, _ = block((30.0, 0.85, 70.0))
    fitted = GroundHomography.from_depth(depth, CAMERA)
    known = GroundHomography.from_camera(CAMERA, 1.6)
    columns, rows = np.array([100.0, 320, 500]), np.array([150.0, 180, 220])
    np.testing.assert_allclose(
        fitted.to_ground(columns, rows), known.to_ground(columns, rows), rtol=1e-3, atol=1e-3
    )
    assert np.isnan(known.to_ground(np.array([320.0]), np.array([50.0]))).all()


def test_the_birds_eye_view_shows_a_mark_at_its_place():
    image = np.zeros((240, 640, 3), np.uint8)
    spot = CAMERA.project(np.array([[1.0, 1.6, 10.0]]))[0]
    column, row = np.rint(spot).astype(int)
    image[row - 1 : row + 2, column - 2 : column + 3] = 255
    above = GroundHomography.from_camera(CAMERA, 1.6).warp(image, across=(-5, 5), ahead=(5, 15), cell=0.05)
    assert above.shape == (200, 200, 3)
    rows, columns = np.nonzero(above[..., 0] > 100)
    assert columns.mean() * 0.05 - 5 == pytest.approx(1.0, abs=0.1)
    assert 15 - rows.mean() * 0.05 == pytest.approx(10.0, abs=0.35)


def test_the_ground_behind_the_camera_is_black():
    image = np.full((240, 640, 3), 200, np.uint8)
    known = GroundHomography.from_camera(CAMERA, 1.6)
    above = known.warp(image, across=(-5, 5), ahead=(-15, 15), cell=0.1)
    assert (above[:100] == 200).any()
    assert not above[150:].any()

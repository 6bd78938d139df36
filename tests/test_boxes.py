"""Boxes, the level camera, and the overlap of boxes against shapely."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import Polygon

from eldenet.boxes import Boxes3D, Detections2D, clipped_edges, corners_of
from eldenet.geometry import PinholeCamera, back_project, extent_of, from_corner, pinhole, to_corner
from eldenet.perception.iou import box_ious, footprints, iou_2d, rotated_intersections

CAMERA = PinholeCamera(pinhole(480.0, 470.0, 415.0, 120.0))


def rotation(pitch: float, roll: float) -> np.ndarray:
    c, s, k, t = np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.array([[k, -t, 0], [t, k, 0], [0, 0, 1]])


def cubes(*centers: tuple[float, float, float], yaw: float = 0.0) -> Boxes3D:
    """Cubes of 2 m."""
    count = len(centers)
    center, size = np.array(centers, float), np.full((count, 3), 2.0)
    return Boxes3D(center, size, np.full(count, yaw), np.ones(count), np.zeros(count, int), ("car",))


def random_boxes(count: int, seed: int = 0) -> Boxes3D:
    rng = np.random.default_rng(seed)
    center = rng.uniform([-6, 0, 4], [6, 2, 16], (count, 3))
    size, yaw = rng.uniform(0.5, 4.5, (count, 3)), rng.uniform(-np.pi, np.pi, count)
    return Boxes3D(center, size, yaw, np.ones(count), np.zeros(count, np.int64), ("car",))


# --- corners, centers, faces ---


def test_the_center_is_the_mean_of_the_eight_vertices_and_the_faces_of_four():
    boxes = random_boxes(20)
    np.testing.assert_allclose(boxes.corners.mean(1), boxes.center, atol=1e-12)
    np.testing.assert_allclose(boxes.corners[:, :4].mean(1), boxes.bottom_center, atol=1e-12)
    np.testing.assert_allclose(boxes.corners[:, 4:].mean(1), boxes.top_center, atol=1e-12)


def test_corners_follow_kittis_rotation_matrix():
    """The benchmark's own reading: R_y(ry) applied to (+-l/2, 0 or -h, +-w/2), from the bottom center."""
    boxes = random_boxes(5)
    for index in range(5):
        length, width, height = boxes.size[index]
        c, s = np.cos(boxes.yaw[index]), np.sin(boxes.yaw[index])
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        x = np.array([1, 1, -1, -1, 1, 1, -1, -1]) * length / 2
        y = np.array([0, 0, 0, 0, -1, -1, -1, -1]) * height
        z = np.array([1, -1, -1, 1, 1, -1, -1, 1]) * width / 2
        expected = (turn @ np.stack([x, y, z])).T + boxes.bottom_center[index]
        np.testing.assert_allclose(boxes.corners[index], expected, atol=1e-12)


def test_nearest_is_the_distance_to_the_footprint():
    boxes = random_boxes(50, seed=1)
    for nearest, corners in zip(boxes.nearest, footprints(boxes.bev), strict=True):
        from shapely.geometry import Point

        assert nearest == pytest.approx(Polygon(corners).distance(Point(0, 0)), abs=1e-9)


def test_boxes_can_be_selected_and_indexed():
    boxes = random_boxes(4)
    one = boxes[2]
    np.testing.assert_array_equal(one.center, boxes.center[2])
    assert (one.name, one.distance) == ("car", pytest.approx(np.hypot(*boxes.center[2, [0, 2]])))
    assert len(boxes.select(np.array([True, False, True, False]))) == 2
    assert len(Boxes3D.empty(("car",)).corners) == 0


# --- the camera ---


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
@settings(max_examples=20, deadline=None)
def test_projection_undoes_back_projection(pitch, roll):
    camera = PinholeCamera(CAMERA.intrinsics, rotation(pitch, roll), np.array([0.06, -0.1, 0.2]))
    rng = np.random.default_rng(0)
    columns, rows, depth = rng.uniform(0, 800, 30), rng.uniform(0, 250, 30), rng.uniform(1, 60, 30)
    points = camera.back_project(columns, rows, depth)
    np.testing.assert_allclose(camera.project(points), np.stack([columns, rows], -1), atol=1e-6)
    np.testing.assert_allclose(camera.to_camera(points)[:, 2], depth, atol=1e-9)


def test_back_projection_agrees_with_the_depth_maps():
    depth = np.random.default_rng(0).uniform(1, 9, (6, 8))
    rows, columns = np.indices(depth.shape)
    np.testing.assert_allclose(
        CAMERA.back_project(columns, rows, depth), back_project(depth, CAMERA.intrinsics), atol=1e-12
    )


def test_a_projection_matrix_with_an_offset():
    """KITTI's P2: the fourth column matters."""
    matrix = np.array([[721.5, 0, 609.6, 44.86], [0, 721.5, 172.9, 0.2164], [0, 0, 1, 0.00275]])
    point = np.array([2.0, 1.0, 15.0])
    expected = matrix @ np.append(point, 1)
    pixel = PinholeCamera.from_projection(matrix).project(point[None])[0]
    np.testing.assert_allclose(pixel, expected[:2] / expected[2], atol=1e-9)


def test_wrong_camera_matrices_are_refused():
    with pytest.raises(ValueError, match=r"give \(3, 3\)"):
        PinholeCamera(np.eye(4))
    with pytest.raises(ValueError, match="fx and fy above 0"):
        PinholeCamera(np.zeros((3, 3)))


def test_boxes_project_into_the_image_even_from_behind():
    boxes = cubes((0, 1, 5), (0, 1, 0.5), (0, 1, -9))
    xyxy = boxes.project(CAMERA, (256, 832))
    pixels = CAMERA.project(boxes.corners[0])
    np.testing.assert_allclose(xyxy[0], [*pixels.min(0), *np.minimum(pixels.max(0), [831, 255])])
    assert np.isfinite(xyxy[1]).all()  # partly behind: cut at the near plane
    assert np.isnan(xyxy[2]).all()  # behind


def test_boxes_beside_the_view_have_no_projection():
    beside = cubes((-30, 1, 8), (30, 1, 8), (0, -30, 8), (0, 30, 8))
    assert np.isnan(beside.project(CAMERA, (256, 832))).all()


def test_edges_are_cut_at_the_near_plane():
    corners = corners_of(np.array([[0, 0, 0.5]]), np.full((1, 3), 2.0), np.zeros(1))[0]
    edges = clipped_edges(corners)
    assert 4 < len(edges) < 12
    assert edges[..., 2].min() == pytest.approx(0.1)
    assert len(clipped_edges(corners - [0, 0, 9])) == 0


# --- detections ---


def test_a_box_around_pixels_reaches_from_border_to_border():
    """Columns 2 to 5 of row 1; counted from the corner, from column 2 to 6."""
    rows, columns = np.array([1, 1]), np.array([5, 2])
    box = extent_of(rows, columns)
    np.testing.assert_array_equal(box, [1.5, 0.5, 5.5, 1.5])
    np.testing.assert_array_equal(to_corner(box), [2, 1, 6, 2])
    np.testing.assert_array_equal(from_corner(to_corner(box)), box)


@pytest.mark.parametrize(
    ("xyxy", "label", "message"),
    [
        (np.zeros((2, 4)), np.zeros(1, int), "give"),
        (np.zeros((1, 4)), np.array([3]), "class names"),
        (np.zeros((1, 4)), np.array([-1]), "labels -1 to -1.*from 0"),
        (np.full((1, 4), np.nan), np.zeros(1, int), "finite"),
        (np.array([[300.0, 200, 250, 100]]), np.zeros(1, int), "left <= right"),
    ],
)
def test_wrong_detections_are_refused(xyxy, label, message):
    with pytest.raises(ValueError, match=message):
        Detections2D(xyxy, np.ones(1), label, ("car",))


def test_detections_can_be_selected_and_named():
    found = Detections2D(
        np.arange(8.0).reshape(2, 4), np.array([0.5, 0.9]), np.array([1, 0]), ("car", "person"),
        track_id=np.array([7, 8]),
    )  # fmt: skip
    assert found.classes == ["person", "car"]
    assert found.select(found.score > 0.6).track_id.tolist() == [8]
    assert len(Detections2D.empty(("car",))) == 0


# --- overlap ---


def test_rotated_overlap_equals_shapely():
    first, second = random_boxes(60, seed=2), random_boxes(60, seed=3)
    areas = rotated_intersections(first.bev, second.bev)
    polygons = [[Polygon(corners) for corners in footprints(boxes.bev)] for boxes in (first, second)]
    expected = np.array([[a.intersection(b).area for b in polygons[1]] for a in polygons[0]])
    assert (expected > 0).sum() > 200
    np.testing.assert_allclose(areas, expected, atol=1e-9)


def test_overlap_of_equal_turned_and_distant_boxes():
    box = random_boxes(1)
    bev, iou = box_ious(box, box)
    assert (bev[0, 0], iou[0, 0]) == (pytest.approx(1), pytest.approx(1))
    cube = cubes((0, 0, 0))
    assert box_ious(cube, cubes((0, 0, 0), yaw=np.pi / 2))[0][0, 0] == pytest.approx(1)
    shared = 8 * (np.sqrt(2) - 1)  # the regular octagon of width 2
    turned = cubes((0, 0, 0), yaw=np.pi / 4)
    assert box_ious(cube, turned)[0][0, 0] == pytest.approx(shared / (8 - shared))
    bev, iou = box_ious(cube, cubes((0, -5, 0)))
    assert (bev[0, 0], iou[0, 0]) == (pytest.approx(1), 0)


def test_a_box_without_size_overlaps_nothing():
    footprint, point = np.array([[0.0, 0.0, 2.0, 2.0, 0.3]]), np.array([[0.1, 0.1, 0.0, 0.0, 0.0]])
    assert rotated_intersections(footprint, point) == rotated_intersections(point, footprint) == 0


def test_2d_iou_equals_torchvision():
    import torch
    from torchvision.ops import box_iou

    rng = np.random.default_rng(0)
    first, second = (np.sort(rng.uniform(0, 9, (12, 2, 2)), 1).reshape(12, 4) for _ in range(2))
    expected = box_iou(torch.from_numpy(first), torch.from_numpy(second)).numpy()
    np.testing.assert_allclose(iou_2d(first, second), expected, atol=1e-12)

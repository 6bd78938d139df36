"""Lifting with missing, cut, hidden, unknown or wrong inputs."""

from dataclasses import replace

import numpy as np
import pytest
from support.blocks import CAMERA, block, detection

from eldenet.boxes import Detections2D
from eldenet.perception.foreground import trusted_edges
from eldenet.perception.ground import flat_ground
from eldenet.perception.lifter import METHODS, BoxLifter


def two_cars(x: float):
    """Depth with a car and one behind it at ``x``; their boxes; the visible pixels of the second."""
    near, box_near = block((0.3, 0.85, 9.0), yaw=1.5)
    far, box_far = block((x, 0.85, 17.0), yaw=1.5)
    depth = np.where((near > 0) & ((near < far) | (far == 0)), near, far)
    return depth, box_near, box_far, (depth == far) & (far < 25) & (far > 14)


def test_a_hidden_car_is_not_mistaken_for_the_one_in_front():
    depth, box_near, box_far, _ = two_cars(1.6)
    found = detection(np.concatenate([box_near, box_far]))
    boxes = BoxLifter(depth_sigma=0.02)(depth, found, CAMERA)
    assert boxes.center[1, 2] == pytest.approx(17, abs=1.0)
    blind = BoxLifter("lshape", depth_sigma=0.02, occlusion_mask=False)(depth, found, CAMERA)
    assert abs(boxes.center[1, 2] - 17) <= abs(blind.center[1, 2] - 17)
    assert boxes.quality["occluded"][1] > 0.1 > boxes.quality["occluded"][0]


def test_an_edge_at_a_nearer_box_is_not_trusted():
    """A pillar behind a car: its box ends where the roof begins, and the boxes share no pixel."""
    boxes = np.array([[300.0, 60, 312, 149], [250, 150, 380, 210]])
    found = Detections2D(boxes, np.ones(2), np.array([1, 0]), ("car", "pillar"))
    trusted, hidden = trusted_edges(found, (240, 640))
    np.testing.assert_array_equal(trusted, [[True, True, True, False], [True] * 4])
    assert hidden[0] == 0
    apart = replace(found, xyxy=boxes + np.array([[0, 0, 0, -10.0], [0, 0, 0, 0]]))
    assert trusted_edges(apart, (240, 640))[0].all()
    projected = replace(found, box_style="projected")
    assert trusted_edges(projected, (240, 640))[0].all()


@pytest.mark.parametrize("size", [(8.5, 2.5, 3.1), (5.2, 1.9, 1.9)])
def test_a_truck_is_fitted_as_a_lorry_or_a_pick_up(size):
    depth, xyxy = block((-2.0, 1.6 - size[2] / 2, 18.0), size=size, yaw=1.3)
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy, "truck"), CAMERA)
    np.testing.assert_allclose(boxes.size[0], size, rtol=0.2)
    assert len(boxes) == 1


@pytest.mark.parametrize("cut", ["left", "right", "bottom"])
def test_a_car_cut_by_the_image_border_keeps_its_size_and_place(cut):
    center = {"left": (-4.6, 0.85, 7.0), "right": (4.6, 0.85, 7.0), "bottom": (0.4, 0.85, 4.2)}[cut]
    depth, xyxy = block(center, yaw=1.4)
    assert {"left": xyxy[0, 0] <= 1, "right": xyxy[0, 2] >= 638, "bottom": xyxy[0, 3] >= 238}[cut]
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy), CAMERA)
    assert boxes.quality["truncated"][0] == 1
    assert np.linalg.norm(boxes.center[0] - center) < 1.0
    assert np.linalg.norm(boxes.size[0] - [3.9, 1.6, 1.5]) < 1.2


@pytest.mark.parametrize("method", METHODS)
def test_boxes_without_known_depth_come_from_class_sizes(method):
    _, xyxy = block((-2.0, 0.85, 12.0))
    depth = np.zeros((240, 640))
    with pytest.warns(UserWarning, match="no pixel of the depth is known"):
        boxes = BoxLifter(method, camera_height=1.6)(depth, detection(xyxy), CAMERA)
    assert np.isfinite(boxes.corners).all()
    assert boxes.center[0, 2] == pytest.approx(12, rel=0.2)
    assert boxes.quality["points"][0] == 0
    assert boxes.quality["fallback"][0] == (method != "no_depth")


@pytest.mark.parametrize("method", METHODS)
def test_zero_nan_negative_and_infinite_depth_are_all_unknown(method):
    depth, xyxy = block((-2.0, 0.85, 12.0))
    results = []
    for fill in (0.0, np.nan, -3.0, np.inf):
        holed = depth.copy()
        holed[::3] = fill
        results.append(BoxLifter(method, camera_height=1.6)(holed, detection(xyxy), CAMERA))
    for other in results[1:]:
        np.testing.assert_allclose(other.corners, results[0].corners)


def known_at(depth, xyxy, count: int, seed: int = 0):
    """The same depth map, but only ``count`` pixels of the box are known in it."""
    rng = np.random.default_rng(seed)
    left, top, right, bottom = np.round(xyxy[0]).astype(int)
    rows, columns = np.nonzero(np.abs(depth[top:bottom, left:right] - 40) < 4)
    chosen = rng.permutation(len(rows))[:count]
    sparse = depth.copy()
    sparse[top - 1 : bottom + 1, left - 1 : right + 1] = 0
    sparse[rows[chosen] + top, columns[chosen] + left] = depth[rows[chosen] + top, columns[chosen] + left]
    return sparse


@pytest.mark.parametrize("count", [1, 2, 6, 20, 39])
def test_depth_of_few_pixels_is_weighed_like_that_of_many(count):
    """A car 40 m away, its own depth 12 % too far: height and size pull it back, few points or many."""
    depth, xyxy = block((-2.0, 0.85, 40.0))
    found = []
    for known in (count, 10**6):
        sparse = known_at(depth, xyxy, known)
        wrong = np.where(np.abs(sparse - 40) < 4, sparse * 1.12, sparse)
        lifter = BoxLifter(depth_sigma=0.12, ground=flat_ground(1.6))
        found.append(lifter(wrong, detection(xyxy), CAMERA))
    few, many = found
    assert 0 < few.quality["points"][0] <= count < 40 < many.quality["points"][0]
    assert abs(many.center[0, 2] - 40) < 1.6  # a third of the error
    assert abs(few.center[0, 2] - 40) < 1.6


def test_a_few_background_pixels_do_not_move_the_box_away():
    """Three pixels, all of a wall at four times the distance: the size in the image contradicts them."""
    center = (-2.0, 0.85, 15.0)
    depth, xyxy = block(center)
    left, top, right, bottom = np.round(xyxy[0]).astype(int)
    depth[top - 1 : bottom + 1, left - 1 : right + 1] = 0
    depth[top + 8 : top + 11, (left + right) // 2] = 60.0
    boxes = BoxLifter(depth_sigma=0.02, ground=flat_ground(1.6))(depth, detection(xyxy), CAMERA)
    assert boxes.quality["points"][0] == 3
    assert boxes.center[0, 2] == pytest.approx(15, abs=2.0)


@pytest.mark.parametrize("method", METHODS)
def test_no_boxes_many_boxes_and_tiny_boxes_are_lifted(method):
    depth, _ = block((-2.0, 0.85, 12.0))
    lifter = BoxLifter(method)
    none = lifter(depth, Detections2D.empty(("car",)), CAMERA)
    assert len(none) == 0
    assert none.corners.shape == (0, 8, 3)
    rng = np.random.default_rng(0)
    corner = rng.uniform(0, [600, 200], (500, 2))
    many = detection(np.concatenate([corner, corner + rng.uniform(0, 40, (500, 2))], 1))
    boxes = lifter(depth, many, CAMERA)
    assert len(boxes) == 500
    assert np.isfinite(boxes.corners).all()
    assert (boxes.size > 0).all()


def test_an_unknown_class_keeps_the_extents_of_its_points():
    depth, xyxy = block((-2.0, 0.85, 12.0), size=(2.0, 2.0, 1.4), yaw=0.7)
    boxes = BoxLifter()(depth, detection(xyxy, "gizmo"), CAMERA)
    assert boxes.quality["fallback"][0] == 1
    assert 1.2 < boxes.size[0, 0] < 2.3
    assert 1.0 < boxes.size[0, 2] < 1.8
    assert np.linalg.norm(boxes.center[0] - (-2.0, 0.85, 12.0)) < 0.9


def test_a_hanging_object_is_not_stretched_to_the_ground():
    depth, xyxy = block((-2.0, -1.0, 12.0), size=(0.5, 0.5, 1.0), height=1.6)
    boxes = BoxLifter(camera_height=1.6)(depth, detection(xyxy, "traffic light"), CAMERA)
    assert boxes.size[0, 2] == pytest.approx(1.0, abs=0.2)
    assert boxes.center[0, 1] == pytest.approx(-1.0, abs=0.2)


def test_masks_are_used_instead_of_boxes():
    depth, _, box_far, visible = two_cars(1.2)
    hidden = replace(detection(box_far), mask=visible[None])
    boxes = BoxLifter(depth_sigma=0.02)(depth, hidden, CAMERA)
    assert boxes.center[0, 2] == pytest.approx(17, abs=1.2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "method"),
        ({"ground": 3}, "ground"),
        ({"camera_height": 0}, "camera_height"),
        ({"depth_sigma": 0}, "depth_sigma"),
        ({"small_sigma": 1.5}, "small_sigma"),
    ],
)
def test_settings_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        BoxLifter(**options)


def test_depth_boxes_and_masks_of_different_images_are_refused():
    depth, xyxy = block((-2.0, 0.85, 12.0))
    masked = replace(detection(xyxy), mask=np.ones((1, 120, 320), bool))
    for wrong, found, message in (
        (np.ones((60, 160)), detection(xyxy), "boxes reach .* of one image"),
        (np.ones((1, 60, 160)), detection(xyxy), "shape"),
        (depth, masked, "masks"),
    ):
        with pytest.raises(ValueError, match=message):
            BoxLifter()(wrong, found, CAMERA)


def test_depth_in_millimeters_warns():
    depth, xyxy = block((-2.0, 0.85, 12.0))
    with pytest.warns(UserWarning, match="millimeters"):
        BoxLifter()(depth * 1000, detection(xyxy), CAMERA)

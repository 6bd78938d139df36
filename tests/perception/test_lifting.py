"""From 2D boxes and depth to 3D boxes, in scenes with known boxes."""

from dataclasses import replace

import numpy as np
import pytest
from support.blocks import CAMERA, block, clear, detection

from eldenet.boxes import wrap_half
from eldenet.geometry import PinholeCamera, pinhole
from eldenet.perception.ground import flat_ground
from eldenet.perception.lifter import METHODS, BoxLifter
from eldenet.perception.matching_metrics import compare
from eldenet.perception.priors import PRIORS


def test_refine_finds_most_boxes_and_beats_the_other_methods(views):
    pairs = {}
    for method in METHODS:
        lifter = BoxLifter(method, depth_sigma=0.02, camera_height=1.65)
        parts = []
        for view in views:
            boxes = lifter(view.depth, view.detections, view.camera)
            numbers = clear(view)
            parts.append(compare(view.boxes, boxes, numbers, numbers))
        pairs[method] = type(parts[0]).join(parts)
    assert len(pairs["refine"]) > 20
    accuracy = {method: part.accuracy.mean() for method, part in pairs.items()}
    assert accuracy["refine"] > 0.97
    assert (pairs["refine"].iou > 0.5).mean() > 0.8
    assert accuracy["refine"] > accuracy["paper"]
    assert accuracy["refine"] > accuracy["no_depth"] > 0.7


@pytest.mark.parametrize("yaw", [-1.2, -0.4, 0.0, 0.3, 0.8, 1.5])
@pytest.mark.parametrize("center", [(-3.0, 0.85, 9.0), (1.5, 0.85, 14.0)])
def test_the_box_of_a_block_is_found_exactly(center, yaw):
    depth, xyxy = block(center, yaw=yaw)
    priors = PRIORS | {"car": replace(PRIORS["car"], shape="box")}
    boxes = BoxLifter("refine", depth_sigma=0.01, priors=priors)(depth, detection(xyxy), CAMERA)
    assert np.linalg.norm(boxes.center[0] - center) < 0.15
    assert abs(wrap_half(boxes.yaw[0] - yaw)) < np.radians(3)
    assert boxes.quality["depth_scale"][0] == pytest.approx(1, abs=0.01)


def test_refine_corrects_a_wrong_depth_scale():
    center = (-2.0, 0.85, 12.0)
    depth, xyxy = block(center)
    priors = PRIORS | {"car": replace(PRIORS["car"], shape="box")}
    wrong = {
        method: BoxLifter(method, depth_sigma=0.1, priors=priors, ground=flat_ground(1.6))(
            depth * 1.1, detection(xyxy), CAMERA
        )
        for method in ("refine", "lshape")
    }
    error = {name: np.linalg.norm(boxes.center[0] - center) for name, boxes in wrong.items()}
    assert error["refine"] < 0.6 * error["lshape"]
    assert wrong["refine"].quality["depth_scale"][0] < 0.96


def test_the_depth_of_small_objects_weighs_less_with_small_sigma():
    """30 pixels wide, its own depth a fifth too far: with ``small_sigma`` ground and size win."""
    center = (-2.0, 0.85, 45.0)
    depth, xyxy = block(center)
    near = (slice(int(xyxy[0, 1]), int(xyxy[0, 3]) + 1), slice(int(xyxy[0, 0]), int(xyxy[0, 2]) + 1))
    depth[near] = np.where(np.abs(depth[near] - 45) < 4, depth[near] * 1.2, depth[near])
    options = {"depth_sigma": 0.02, "ground": flat_ground(1.6)}
    trusting, careful = (
        BoxLifter(small_sigma=small, **options)(depth, detection(xyxy), CAMERA) for small in (None, 0.4)
    )
    assert abs(careful.center[0, 2] - 45) < 0.6 * abs(trusting.center[0, 2] - 45)


def test_the_camera_height_corrects_a_depth_map_of_wrong_scale():
    """Ground and object are both 15 % too far: only the known height shows it."""
    center = (-2.0, 0.85, 12.0)
    depth, xyxy = block(center)
    errors = []
    for height in (None, 1.6):
        boxes = BoxLifter(depth_sigma=0.1, camera_height=height)(depth * 1.15, detection(xyxy), CAMERA)
        errors.append(np.linalg.norm(boxes.center[0] - center))
    assert errors[1] < 0.95 * errors[0]  # equal if the height were not used


def test_a_mirrored_image_gives_mirrored_boxes():
    center = (-2.0, 0.85, 12.0)
    depth, xyxy = block(center)
    mirrored = xyxy.copy()
    mirrored[:, [0, 2]] = 639 - xyxy[:, [2, 0]]
    flipped = pinhole(400.0, 400.0, 639 - 320.0, 100.0)
    lifter = BoxLifter(depth_sigma=0.02)
    plain = lifter(depth, detection(xyxy), CAMERA)
    other = lifter(depth[:, ::-1].copy(), detection(mirrored), PinholeCamera(flipped))
    np.testing.assert_allclose(other.center[0] * [-1, 1, 1], plain.center[0], atol=0.08)
    assert abs(wrap_half(other.yaw[0] + plain.yaw[0])) < np.radians(3)


def test_a_tilted_camera_in_a_level_frame_gives_the_same_box():
    center, pitch = (-2.0, 0.85, 12.0), 0.12
    c, s = np.cos(pitch), np.sin(pitch)
    camera = PinholeCamera(CAMERA.intrinsics, np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T)
    depth, xyxy = block(center, camera=camera)
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy), camera)
    assert np.linalg.norm(boxes.center[0] - center) < 0.25


def test_the_paper_method_is_the_mean_of_the_extents():
    """Equations 1 to 3 by hand."""
    depth = np.zeros((60, 80))
    depth[20:40, 30:50] = 5.0
    camera = PinholeCamera(pinhole(100, 100, 40, 30))
    boxes = BoxLifter("paper", ground=None)(depth, detection(np.array([[30, 20, 49, 39.0]])), camera)
    x, y = (np.array([30, 49]) - 40) / 100 * 5, (np.array([20, 39]) - 30) / 100 * 5
    np.testing.assert_allclose(boxes.center[0], [x.mean(), y.mean(), 5.0], atol=0.06)
    np.testing.assert_allclose(boxes.size[0, [0, 2]], [np.ptp(x), np.ptp(y)], atol=0.06)
    assert boxes.yaw[0] == 0

"""The whole pipeline from an image to a scene, and the files it writes."""

from dataclasses import replace

import numpy as np
import pytest
from support.networks import canonical_predictor
from support.standing_boxes import CAMERA, boxes

from eldenet.geometry import PinholeCamera, pinhole
from eldenet.perception.detectors import FixedDetections
from eldenet.perception.kitti_object import read_labels
from eldenet.perception.lifter import BoxLifter
from eldenet.perception.scene import STAGES, Perception
from eldenet.perception.tracking import BoxTracker
from eldenet.simulation.street_views import render_street


@pytest.fixture(scope="module")
def view():
    return render_street("val", 3, (128, 416))


def perceive(view, detections, *, lifter=BoxLifter(), camera=None, depth=None):  # noqa: B008 - immutable
    depth = view.depth if depth is None else depth
    camera = view.camera if camera is None else camera
    perception = Perception(lambda image: depth, FixedDetections([detections]), lifter, camera)
    return perception(view.image)


def test_an_image_becomes_a_scene(view, tmp_path):
    scene = perceive(view, view.detections, lifter=BoxLifter(depth_sigma=0.02))
    assert set(scene.seconds) == set(STAGES)
    assert len(scene.boxes) == len(scene.detections) == len(view.boxes)
    picture = scene.picture()
    assert picture.dtype == np.uint8
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
    scene.write_kitti(tmp_path / "a.txt")
    read = read_labels(tmp_path / "a.txt")
    np.testing.assert_allclose(read.boxes.center, scene.boxes.center, atol=1e-3)
    np.testing.assert_allclose(read.xyxy, view.detections.xyxy, atol=1e-3)


def test_a_matrix_is_a_camera(view):
    scene = perceive(view, view.detections)
    of_matrix = perceive(view, view.detections, camera=view.camera.intrinsics)
    np.testing.assert_array_equal(of_matrix.boxes.center, scene.boxes.center)
    with pytest.raises(ValueError, match=r"give \[fx, fy, cx, cy\]"):
        perceive(view, view.detections, camera=np.eye(4))


def test_without_a_depth_model_the_depth_must_be_given(view):
    perception = Perception(None, FixedDetections([view.detections]), BoxLifter(), view.camera)
    with pytest.raises(ValueError, match="no depth_model: give depth="):
        perception(view.image)


def test_the_depth_model_is_told_the_camera(view):
    predictor = canonical_predictor(128, 416)
    perception = Perception(predictor, FixedDetections([view.detections]), BoxLifter(), view.camera)
    expected = predictor(view.image, intrinsics=view.camera.intrinsics)
    np.testing.assert_array_equal(perception(view.image).depth, expected)
    assert not np.allclose(expected, predictor(view.image))


def test_depth_image_and_camera_must_fit_together(view):
    with pytest.raises(ValueError, match="same size"):
        perceive(view, view.detections, depth=view.depth[:50])
    camera = PinholeCamera(pinhole(100.0, 100.0, view.image.shape[1] + 5.0, 20.0))
    with pytest.raises(ValueError, match="lies outside the picture"):
        perceive(view, view.detections, camera=camera)


def test_detections_convert_to_supervision(view):
    pytest.importorskip("supervision", reason="pip install -e '.[viz]'")
    given = view.detections.to_supervision()
    np.testing.assert_allclose(given.xyxy, view.detections.xyxy + 0.5)
    assert list(given.data["class_name"]) == view.detections.classes


def test_a_scene_is_sent_to_rerun(view, tmp_path):
    rerun = pytest.importorskip("rerun", reason="pip install -e '.[viz]'")
    scene = perceive(view, view.detections)
    rerun.init("test")
    rerun.save(tmp_path / "scene.rrd")
    scene.log_to_rerun()
    rerun.disconnect()
    assert (tmp_path / "scene.rrd").stat().st_size > view.image.nbytes // 4


def test_2d_boxes_are_the_detectors_and_with_a_tracker_projections(view, tmp_path):
    numbered = replace(view.detections, track_id=np.arange(len(view.detections)))
    scene = perceive(view, numbered)
    np.testing.assert_array_equal(scene.xyxy, view.detections.xyxy)
    # one track in view, one beside it, one behind
    tracked = BoxTracker()(boxes([[0.0, 0.8, 10.0], [60.0, 0.8, 10.0], [0.0, 0.8, -10.0]]), 0.1)
    scene = replace(scene, boxes=tracked, camera=CAMERA)
    assert np.isnan(scene.xyxy).all(1).tolist() == [False, True, True]
    scene.write_kitti(tmp_path / "a.txt")
    read = read_labels(tmp_path / "a.txt")
    assert read.types == ("Car",)
    assert (read.xyxy[:, 2:] - read.xyxy[:, :2] > 30).all()

"""The whole chain from a picture to a scene, and what is written of it."""

from dataclasses import replace

import numpy as np
import pytest
from support.standing_boxes import CAMERA, boxes

from eldenet.boxes import Detections2D
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


def test_a_picture_becomes_a_scene(view, tmp_path):
    perception = Perception(
        lambda frame: view.depth, FixedDetections([view.detections]), BoxLifter(depth_sigma=0.02), view.camera
    )
    scene = perception(view.image)
    assert set(scene.seconds) == set(STAGES)
    assert len(scene.boxes) == len(scene.detections) == len(view.boxes)
    picture = scene.picture()
    assert picture.dtype == np.uint8
    assert picture.shape[0] % 2 == picture.shape[1] % 2 == 0
    scene.write_kitti(tmp_path / "a.txt")
    read = read_labels(tmp_path / "a.txt")
    np.testing.assert_allclose(read.boxes.center, scene.boxes.center, atol=1e-3)
    np.testing.assert_allclose(read.xyxy, view.detections.xyxy, atol=1e-3)


def test_depth_of_another_size_and_no_picture_are_refused(view):
    perception = Perception(
        lambda frame: view.depth[:50], FixedDetections([view.detections] * 2), BoxLifter(), view.camera
    )
    with pytest.raises(ValueError, match="one size"):
        perception(view.image)
    with pytest.raises(ValueError, match="frame is"):
        perception(view.image[..., 0])


def test_intrinsics_of_another_picture_are_refused(view):
    camera = PinholeCamera(pinhole(100.0, 100.0, view.image.shape[1] + 5.0, 20.0))
    perception = Perception(lambda frame: view.depth, FixedDetections([view.detections]), BoxLifter(), camera)
    with pytest.raises(ValueError, match="lies outside the picture"):
        perception(view.image)


def test_a_scene_without_objects(view):
    empty = FixedDetections([Detections2D.empty(("car",))])
    scene = Perception(lambda frame: view.depth, empty, BoxLifter(), view.camera)(view.image)
    assert len(scene.boxes) == 0
    assert scene.picture().any()


def test_detections_for_supervision(view):
    pytest.importorskip("supervision", reason="pip install 'eldenet[viz]'")
    given = view.detections.to_supervision()
    np.testing.assert_allclose(given.xyxy, view.detections.xyxy + 0.5)
    assert list(given.data["class_name"]) == view.detections.classes


def test_a_scene_for_rerun(view, tmp_path):
    rerun = pytest.importorskip("rerun", reason="pip install 'eldenet[viz]'")
    scene = Perception(
        lambda frame: view.depth, FixedDetections([view.detections]), BoxLifter(), view.camera
    )(view.image)
    rerun.init("test")
    rerun.save(tmp_path / "scene.rrd")
    scene.log_to_rerun()
    rerun.disconnect()
    assert (tmp_path / "scene.rrd").stat().st_size > view.image.nbytes // 4


def test_results_keep_a_detectors_boxes_unless_a_tracker_moved_them(view, tmp_path):
    numbered = replace(view.detections, track_id=np.arange(len(view.detections)))
    scene = Perception(lambda frame: view.depth, FixedDetections([numbered]), BoxLifter(), view.camera)(
        view.image
    )
    np.testing.assert_array_equal(scene.xyxy, view.detections.xyxy)
    # one track in view, one beside it, one behind
    tracked = BoxTracker()(boxes([[0.0, 0.8, 10.0], [60.0, 0.8, 10.0], [0.0, 0.8, -10.0]]), 0.1)
    scene = replace(scene, boxes=tracked, camera=CAMERA)
    assert np.isnan(scene.xyxy).all(1).tolist() == [False, True, True]
    scene.write_kitti(tmp_path / "a.txt")
    read = read_labels(tmp_path / "a.txt")
    assert read.types == ("Car",)
    assert (read.xyxy[:, 2:] - read.xyxy[:, :2] > 30).all()


def test_kittis_classes_have_one_number_in_every_file(tmp_path):
    lines = {kind: f"{kind} 0 0 0 1 1 9 9 1.5 1.6 4 0 1 9 0" for kind in ("Car", "Pedestrian", "Rickshaw")}
    numbers = []
    for kinds in (("Car", "Pedestrian"), ("Pedestrian", "Rickshaw", "Car")):
        path = tmp_path / "-".join(kinds)
        path.write_text("\n".join(lines[kind] for kind in kinds))
        found = read_labels(path)
        assert found.boxes.classes == found.detections.classes == list(kinds)
        numbers.append(dict(zip(kinds, found.boxes.label.tolist(), strict=True)))
    assert numbers[0]["Car"] == numbers[1]["Car"]
    assert numbers[0]["Pedestrian"] == numbers[1]["Pedestrian"]

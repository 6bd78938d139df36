"""The whole chain, its pictures, tracks over time, and ``eldenet.predict boxes=true``."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from test_detectors import FILES, save

import eldenet
from eldenet.boxes import Boxes3D, Detections2D
from eldenet.config import compose
from eldenet.geometry import PinholeCamera, pinhole
from eldenet.perception.detectors import FixedDetections
from eldenet.perception.drawing import colour_of, draw_bev, draw_boxes, draw_detections
from eldenet.perception.kitti_object import read_labels
from eldenet.perception.lifter import BoxLifter
from eldenet.perception.scene import STAGES, Perception, Scene
from eldenet.perception.tracking import BoxTracker
from eldenet.predict import predict
from eldenet.predict_boxes import Timed
from eldenet.simulation.street_views import render_street

CAMERA = PinholeCamera(pinhole(300.0, 300.0, 160.0, 60.0))
BLANK = np.full((120, 320, 3), 40, np.uint8)


def boxes(center: np.ndarray, yaw: float = 0.0, label: int = 0) -> Boxes3D:
    center = np.atleast_2d(np.asarray(center, float))
    count = len(center)
    size, ones = np.tile([4.0, 1.6, 1.5], (count, 1)), np.ones(count)
    return Boxes3D(center, size, yaw * ones, ones, np.full(count, label), ("car", "person"))


@pytest.fixture(scope="module")
def view():
    return render_street("val", 3, (128, 416))


# --- the chain ---


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


def test_times_of_a_camera_that_runs_for_days_are_not_all_kept(monkeypatch):
    monkeypatch.setattr("eldenet.predict_boxes.REMEMBERED", 3)
    timed = Timed(lambda frame: frame)
    for _ in range(5):
        timed(BLANK)
    assert len(timed.seconds) == 3


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


# --- pictures ---


def test_edges_are_drawn_where_the_corners_project():
    one = boxes([0.5, 0.8, 10.0], yaw=0.3)
    drawn = draw_boxes(BLANK, one, CAMERA, labels=False)
    changed = (drawn != BLANK).any(-1)
    corners = CAMERA.project(one.corners[0])
    rows, columns = np.nonzero(changed)
    assert columns.min() == pytest.approx(corners[:, 0].min(), abs=2)
    assert rows.max() == pytest.approx(corners[:, 1].max(), abs=2)
    for column, row in np.rint(corners).astype(int):
        assert changed[row - 1 : row + 2, column - 1 : column + 2].any()
    assert not (BLANK != 40).any()  # the picture given is left alone


@pytest.mark.parametrize("z", [0.5, -0.5, -20.0])
def test_boxes_beside_and_behind_the_camera_do_no_harm(z):
    drawn = draw_boxes(BLANK, boxes([0.8, 0.5, z]), CAMERA)
    assert (drawn != BLANK).any() == (z > -2)


def test_the_front_face_is_shaded_where_it_is_known():
    one = boxes([0.0, 0.8, 10.0], yaw=np.pi / 2)  # its front looks at the camera
    plain, shaded = (draw_boxes(BLANK, one, CAMERA, front=front, labels=False) for front in (False, True))
    assert (shaded != plain).any(-1).sum() > 200
    two = boxes([[-2.0, 0.8, 10.0], [2.0, 0.8, 10.0]], yaw=np.pi / 2)
    one_known = draw_boxes(BLANK, two, CAMERA, front=np.array([False, True]), labels=False)
    changed = (one_known != draw_boxes(BLANK, two, CAMERA, labels=False)).any(-1)
    assert changed[:, 160:].any()
    assert not changed[:, :160].any()


def test_the_view_from_above_shows_a_box_at_its_place():
    one = boxes([3.0, 0.8, 20.0])
    panel = draw_bev(one, CAMERA, 320, size=(412, 300), reach=40.0)
    colour = np.array([int(0.75 * part) for part in colour_of("car")])
    rows, columns = np.nonzero(np.abs(panel.astype(int) - colour).max(-1) < 8)
    assert (columns.mean() - 150) / 10 == pytest.approx(3.0, abs=0.15)
    assert (412 - 6 - rows.mean()) / 10 == pytest.approx(20.0, abs=0.15)
    assert draw_bev(Boxes3D.empty(("car",)), CAMERA, 320).any()


@pytest.mark.parametrize("center", [[30.0, 0.8, 20.0], [-30.0, 0.8, 20.0], [0.0, 0.8, 70.0]])
def test_every_box_is_in_the_view_from_above(center):
    panel = draw_bev(boxes(center), CAMERA, 320, size=(400, 300))
    colour = np.array([int(0.75 * part) for part in colour_of("car")])
    rows, columns = np.nonzero(np.abs(panel.astype(int) - colour).max(-1) < 8)
    assert 0 < rows.min() <= rows.max() < 399
    assert 0 < columns.min() <= columns.max() < 299


def test_detections_are_drawn():
    found = Detections2D(np.array([[20.0, 30, 60, 80]]), np.ones(1), np.zeros(1, int), ("car",))
    assert (draw_detections(BLANK, found)[30:80, 20] == colour_of("car")).all()


def test_a_drawn_box_ends_with_the_last_pixels_that_it_holds():
    height, width = BLANK.shape[:2]
    whole = np.array([[-0.5, -0.5, width - 0.5, height - 0.5]])
    drawn = draw_detections(BLANK, Detections2D(whole, np.ones(1), np.zeros(1, int), ("car",)))
    assert (drawn[-1] == colour_of("car")).all()
    assert (drawn[:, -1] == colour_of("car")).all()
    few = Detections2D(np.array([[49.5, 51.5, 53.5, 55.5]]), np.ones(1), np.zeros(1, int), ("car",))
    drawn = draw_detections(BLANK, few)
    assert (drawn[52:56, 53] == colour_of("car")).all()
    assert not (drawn[52:56, 54] == colour_of("car")).all(-1).any()
    assert not (drawn[56, 50:54] == colour_of("car")).all(-1).any()


# --- tracks ---


def test_two_cars_keep_their_numbers_and_get_their_speeds():
    rng = np.random.default_rng(0)
    tracker = BoxTracker(still_camera=True)
    start, speed = np.array([[-4.0, 0.8, 15], [4.0, 0.8, 30]]), np.array([[0, 0, 3.0], [0, 0, -6.0]])
    for frame in range(25):
        order = rng.permutation(2)
        center = (start + speed * frame * 0.1 + rng.normal(0, 0.1, (2, 3)))[order]
        found = tracker(boxes(center, yaw=np.pi / 2 * rng.choice([-1, 1])), 0.1)
    by_number = {int(number): row for row, number in enumerate(found.track_id)}
    assert set(by_number) == {1, 2}
    first = by_number[1] if found.center[by_number[1], 0] < 0 else by_number[2]
    second = 1 - first
    assert found.velocity[first, 2] == pytest.approx(3.0, abs=0.5)
    assert found.velocity[second, 2] == pytest.approx(-6.0, abs=0.5)
    heading = np.stack([np.cos(found.yaw), -np.sin(found.yaw)], 1)  # x, z of the fronts
    assert heading[first, 1] > 0.95
    assert heading[second, 1] < -0.95


@pytest.mark.parametrize("still_camera", [False, True])
def test_a_parked_car_is_not_turned_round_by_a_camera_that_drives(still_camera):
    """It faces away from the camera (yaw -pi/2) and comes closer by 10 m/s."""
    tracker = BoxTracker(still_camera=still_camera)
    for frame in range(10):
        found = tracker(boxes([3.0, 0.8, 30.0 - frame], yaw=-np.pi / 2), 0.1)
    assert found.velocity[0, 2] == pytest.approx(-10, abs=0.3)
    assert np.cos(found.yaw[0] + np.pi / 2) == pytest.approx(-1 if still_camera else 1)
    assert found.quality["heading"][0] == still_camera


def test_a_filter_is_calmer_than_its_measurements():
    rng = np.random.default_rng(1)
    tracker, raw, smooth = BoxTracker(), [], []
    for frame in range(60):
        truth = np.array([2.0, 0.8, 10 + 0.2 * frame])
        center = truth + rng.normal(0, 0.4, 3)
        found = tracker(boxes(center), 0.1)
        raw.append(np.linalg.norm(center - truth))
        smooth.append(np.linalg.norm(found.center[0] - truth))
    assert np.mean(smooth[20:]) < 0.8 * np.mean(raw[20:])


def test_births_deaths_gaps_and_classes():
    tracker = BoxTracker(births=3, deaths=3)
    here = [0.0, 0.8, 10.0]
    for _ in range(3):
        tracker(Boxes3D.empty(("car", "person")), 0.1)
    shown = [len(tracker(boxes(here), 0.1)) for _ in range(4)]
    assert shown == [0, 0, 1, 1]
    number = tracker(boxes(here), 0.1).track_id[0]
    tracker(Boxes3D.empty(("car", "person")), 0.1)
    assert tracker(boxes(here), 0.1).track_id[0] == number  # it survives a gap
    assert len(tracker(boxes(here, label=1), 0.1)) == 0  # a person is no car
    for _ in range(3):
        tracker(Boxes3D.empty(("car", "person")), 0.1)
    assert not tracker.tracks
    with pytest.raises(ValueError, match="seconds"):
        tracker(boxes(here), 0.0)
    with pytest.raises(ValueError, match="gate"):
        BoxTracker(gate=0)


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


def test_a_track_keeps_its_class_when_frames_number_theirs_differently():
    tracker = BoxTracker(births=1, report_unseen=True)
    for frame in range(6):
        # a person and a car beside it are seen in turn, each as class 0 of its frame
        name, x = ("car", 0.0) if frame % 2 else ("person", 0.5)
        out = tracker(replace(boxes([x, 0.8, 10.0]), names=(name,)), 0.1)
        if frame:
            assert dict(zip(out.track_id.tolist(), out.classes, strict=True)) == {1: "person", 2: "car"}


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


# --- the command ---


@pytest.fixture(scope="module")
def model_folder(tmp_path_factory) -> Path:
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("trained") / "model"
    eldenet.load("eldenet_s").save_pretrained(folder, info={"input_size": [32, 64]})
    return folder


@pytest.fixture
def detector(tmp_path) -> Path:
    return save(tmp_path / "detector.onnx", *FILES["yolov8"])


def run(model_folder: Path, source: Path, output: Path, *overrides: str):
    quoted = [f"checkpoint='{model_folder}'", f"source='{source}'", f"output='{output}'", "boxes=true"]
    return predict(compose("predict", [*quoted, "runtime.threads=1", "runtime.workers=0", *overrides]))


CAMERA_OPTION = "intrinsics=[200,200,128,64]"


def test_predict_draws_boxes_and_writes_kittis_format(model_folder, detector, tmp_path, capsys):
    source = tmp_path / "photo.png"
    cv2.imwrite(str(source), np.full((128, 256, 3), 90, np.uint8))
    option = f"perception.detector.path='{detector}'"
    run(model_folder, source, tmp_path / "out", CAMERA_OPTION, option)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"photo_boxes.png", "photo_boxes.txt", "photo_depth.png", "photo_colour.png"}
    assert read_labels(tmp_path / "out/photo_boxes.txt").types == ("dog", "cow")
    said = capsys.readouterr().out
    assert re.search(r"boxes: median depth [\d.]+ ms, detect [\d.]+ ms, lift [\d.]+ ms per picture", said)
    with pytest.raises(ValueError, match="there already"):
        run(model_folder, source, tmp_path / "out", CAMERA_OPTION, option, "formats=[colour]")


def test_predict_takes_a_folder_with_pictures_of_nothing(model_folder, detector, tmp_path):
    for name in ("a", "b"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((128, 256, 3), 90, np.uint8))
    option = f"perception.detector.path='{detector}'"
    run(model_folder, tmp_path, tmp_path / "out", CAMERA_OPTION, option, "perception.detector.threshold=0.99")
    for name in ("a", "b"):
        assert (tmp_path / f"out/{name}_boxes.txt").read_text() == ""
        assert (tmp_path / f"out/{name}_boxes.png").is_file()


def test_one_camera_is_of_one_size_for_boxes_too(model_folder, detector, tmp_path):
    for name, height in (("a", 128), ("b", 120)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((height, 256, 3), 90, np.uint8))
    option = f"perception.detector.path='{detector}'"
    with pytest.raises(ValueError, match=r"b is 120 x 256, the pictures before it 128 x 256"):
        run(model_folder, tmp_path, tmp_path / "out", CAMERA_OPTION, option, "formats=[depth]")
    assert not (tmp_path / "out/b_boxes.txt").exists()


def test_predict_follows_boxes_through_a_video(model_folder, detector, tmp_path):
    source = tmp_path / "walk.mp4"
    writer = cv2.VideoWriter(str(source), cv2.VideoWriter.fourcc(*"mp4v"), 10, (256, 128))
    for shade in range(4):
        writer.write(np.full((128, 256, 3), 60 + shade, np.uint8))
    writer.release()
    run(model_folder, source, tmp_path / "out", CAMERA_OPTION, f"perception.detector.path='{detector}'")
    capture = cv2.VideoCapture(str(tmp_path / "out/walk_boxes.mp4"))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 4
    assert len(list((tmp_path / "out/walk").glob("*_boxes.txt"))) == 4
    for name in ("walk_boxes.mp4", "walk_depth.mp4"):
        (tmp_path / "out" / name).rename(tmp_path / name)
    with pytest.raises(ValueError, match=r"there already .*out/walk\)"):  # the text files
        run(model_folder, source, tmp_path / "out", CAMERA_OPTION, f"perception.detector.path='{detector}'")


def test_speeds_of_a_live_camera_follow_from_the_times_of_its_frames(tmp_path, monkeypatch):
    """One metre per second, of 30 frames a second every sixth: the rest were dropped."""
    from types import SimpleNamespace

    from eldenet import predict_boxes
    from eldenet.predictions import Results

    frames = [7 + 0.2 * step for step in range(15)]
    tracker, seen = BoxTracker(), []

    def perceive(photo, *, depth, seconds):
        seen.append(tracker(boxes([0.0, 0.8, 10 + frames[len(seen)] - frames[0]]), seconds))
        depth, none = np.ones(BLANK.shape[:2], np.float32), Detections2D.empty(("car",))
        return Scene(BLANK, depth, none, seen[-1], CAMERA, {})

    monkeypatch.setattr(predict_boxes, "build_perception", lambda *args, **more: perceive)
    results = Results(tmp_path, ())
    config = SimpleNamespace(boxes=True)
    with predict_boxes.box_results(config, results, ["cam"], None, is_video=True) as results.also:
        results.frames_per_second = 15.0  # that the camera says once it is open
        for number, time in enumerate(frames):
            results.write(f"cam/{number}", BLANK, np.ones((120, 320)), (), time=time)
    assert seen[-1].velocity[0, 2] == pytest.approx(1.0, abs=0.05)
    film = cv2.VideoCapture(str(tmp_path / "cam_boxes.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == 15.0
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 14 * 3 + 1  # as long as it was filmed


def test_predict_says_what_boxes_need(model_folder, detector, tmp_path):
    source = tmp_path / "photo.png"
    cv2.imwrite(str(source), np.full((128, 256, 3), 90, np.uint8))
    with pytest.raises(ValueError, match="intrinsics"):
        run(model_folder, source, tmp_path / "out", f"perception.detector.path='{detector}'")
    with pytest.raises(ValueError, match=r"perception\.detector\.path"):
        run(model_folder, source, tmp_path / "out", CAMERA_OPTION)
    (tmp_path / "odd.onnx").write_text("no network")
    with pytest.raises(ValueError, match="no ONNX file"):
        run(
            model_folder, source, tmp_path / "out", CAMERA_OPTION,
            f"perception.detector.path='{tmp_path / 'odd.onnx'}'",
        )  # fmt: skip
    with pytest.raises(ValueError, match="method"):
        run(
            model_folder, source, tmp_path / "out", CAMERA_OPTION, f"perception.detector.path='{detector}'",
            "perception.lifter.method=magic",
        )  # fmt: skip


@pytest.mark.parametrize("part", ["detector", "lifter", "tracker"])
def test_the_config_shows_every_option(part):
    import inspect

    from hydra.utils import get_object

    node = compose("predict", ["checkpoint=x", "source=y"]).perception[part]
    options = set(inspect.signature(get_object(node["_target_"])).parameters)
    assert options - {"priors"} == {name for name in node if name != "_target_"}

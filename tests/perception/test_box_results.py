"""``eldenet.predict boxes=true`` on images, videos and live cameras, and what it needs."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from support.detector_files import FILES, save
from support.standing_boxes import BLANK, CAMERA, boxes

from eldenet.boxes import Detections2D
from eldenet.compose import compose
from eldenet.perception.box_results import box_results
from eldenet.perception.kitti_object import read_labels
from eldenet.perception.scene import Scene
from eldenet.perception.tracking import BoxTracker
from eldenet.predict import PredictSettings, predict

INTRINSICS = "intrinsics=[200,200,128,64]"


@pytest.fixture
def run(model_folder, tmp_path):
    """Predict ``source`` with a detector that always finds a dog and a cow; results go to ``out``."""
    detector = save(tmp_path / "detector.onnx", *FILES["yolov8"])

    def predict_boxes(source: Path, *overrides: str):
        options = [
            f"checkpoint='{model_folder}'", f"source='{source}'", f"output='{tmp_path}/out'", "boxes=true",
            f"perception.detector.path='{detector}'", "runtime.threads=1", "runtime.workers=0", INTRINSICS,
        ]  # fmt: skip
        return predict(compose(PredictSettings, [*options, *overrides]))

    return predict_boxes


def write_image(path: Path) -> Path:
    path.parent.mkdir(exist_ok=True)
    cv2.imwrite(str(path), np.full((128, 256, 3), 90, np.uint8))
    return path


def test_predict_draws_boxes_and_writes_kittis_format(run, tmp_path, capsys):
    source = write_image(tmp_path / "photo.png")
    run(source)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"photo_boxes.png", "photo_boxes.txt", "photo_depth.png", "photo_color.png"}
    assert read_labels(tmp_path / "out/photo_boxes.txt").types == ("dog", "cow")
    assert "median" not in capsys.readouterr().out  # one picture's times are those of a start
    with pytest.raises(ValueError, match="already exist"):
        run(source, "formats=[color]")


def test_depth_that_contradicts_known_sizes_is_said_and_boxes_are_recorded(run, tmp_path, capsys):
    chunk = pytest.importorskip("rerun.chunk", reason="pip install -e '.[viewer]'")
    source = write_image(tmp_path / "photo.png")
    buses = ("perception.detector.names=[bus,bus,bus]", "intrinsics=[900,900,128,64]")
    run(source, *buses)
    assert "known size" not in capsys.readouterr().out  # two are too few
    for name in ("a", "b"):
        write_image(tmp_path / f"photos/{name}.png")
    run(tmp_path / "photos", *buses, "viewer=rerun")
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(r"note: 4 objects of known size are at 0\.\d+ times .*weights are for rooms", said)
    entities = [part.entity_path for part in chunk.RrdReader(tmp_path / "out/predict.rrd").stream()]
    assert "/world/boxes" in entities
    run(tmp_path / "photos", *buses, "overwrite=true", "perception.lifter.method=no_depth",
        "perception.lifter.camera_height=1.5")  # fmt: skip
    assert "known size" not in capsys.readouterr().out


def test_images_without_objects_get_empty_files(run, tmp_path):
    for name in ("a", "b"):
        write_image(tmp_path / f"{name}.png")
    run(tmp_path, "perception.detector.threshold=0.99")
    for name in ("a", "b"):
        assert (tmp_path / f"out/{name}_boxes.txt").read_text() == ""
        assert (tmp_path / f"out/{name}_boxes.png").is_file()


def test_predict_follows_boxes_through_a_video(run, tmp_path, capsys):
    source = tmp_path / "walk.mp4"
    writer = cv2.VideoWriter(str(source), cv2.VideoWriter.fourcc(*"mp4v"), 10, (256, 128))
    for shade in range(4):
        writer.write(np.full((128, 256, 3), 60 + shade, np.uint8))
    writer.release()
    run(source)
    times = r"depth [\d.]+ ms, detect [\d.]+ ms, lift [\d.]+ ms, track [\d.]+ ms per picture"
    assert re.search(f"boxes: median {times}", capsys.readouterr().out)
    capture = cv2.VideoCapture(str(tmp_path / "out/walk_boxes.mp4"))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == 4
    assert len(list((tmp_path / "out/walk").glob("*_boxes.txt"))) == 4
    for name in ("walk_boxes.mp4", "walk_depth.mp4"):
        (tmp_path / "out" / name).rename(tmp_path / name)
    with pytest.raises(ValueError, match=r"already exist.*out/walk\b"):  # the text files
        run(source)


def test_speeds_follow_from_the_times_of_frames_that_a_live_camera_dropped(tmp_path):
    """One meter per second; of 30 frames per second every sixth arrives."""
    from eldenet.deploy.outputs import Results

    frames = [7 + 0.2 * step for step in range(15)]
    tracker, seen = BoxTracker(), []

    def perceive(image, *, depth, seconds, camera=None):
        seen.append(tracker(boxes([0.0, 0.8, 10 + frames[len(seen)] - frames[0]]), seconds))
        depth, none = np.ones(BLANK.shape[:2], np.float32), Detections2D.empty(("car",))
        return Scene(BLANK, depth, none, seen[-1], CAMERA, {})

    results = Results(tmp_path, ())
    with box_results(perceive, results, ["cam"], None, is_video=True) as results.also:
        results.frames_per_second = 15.0  # known once the camera is open
        for number, time in enumerate(frames):
            results.write(f"cam/{number}", BLANK, np.ones((120, 320)), (), time=time)
    assert seen[-1].velocity[0, 2] == pytest.approx(1.0, abs=0.05)
    film = cv2.VideoCapture(str(tmp_path / "cam_boxes.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == 15.0
    assert film.get(cv2.CAP_PROP_FRAME_COUNT) == 14 * 3 + 1  # as long as the recording


ASSUMED = "points and boxes assume fy = fx and the principal point in the picture's center"


@pytest.mark.parametrize("given", ["focal=200", f"fov={2 * np.degrees(np.arctan(128 / 200))}", "exif"])
def test_without_intrinsics_the_principal_point_is_the_center(given, run, tmp_path, capsys):
    source = tmp_path / "photo.jpg"
    exif = Image.Exif()
    if given == "exif":
        exif[0x8769] = {0xA405: round(200 * 43.27 / np.hypot(128, 256))}
    Image.fromarray(np.full((128, 256, 3), 90, np.uint8)).save(source, exif=exif)
    fx = 30 * np.hypot(128, 256) / 43.27 if given == "exif" else 200
    run(source, f"intrinsics=[{fx},{fx},127.5,63.5]")
    assert ASSUMED not in capsys.readouterr().out
    expected = (tmp_path / "out/photo_boxes.txt").read_text()
    run(source, "intrinsics=null", *[given] * (given != "exif"), "overwrite=true")
    assert (tmp_path / "out/photo_boxes.txt").read_text() == expected
    assert expected.count("dog") == 1
    assert ASSUMED in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "intrinsics=null",
            r"photo\.png: boxes need the lens, .*: give fov=degrees, focal=pixels or intrinsics=",
        ),
        ("perception.detector.path=null", r"perception\.detector\.path"),
        ("perception.detector.path='{folder}/odd.onnx'", "not a valid ONNX file"),
        ("perception.lifter.method=magic", "method"),
    ],
)
def test_missing_and_wrong_settings_are_refused(run, override, message, tmp_path):
    (tmp_path / "odd.onnx").write_text("no network")
    with pytest.raises(ValueError, match=message):
        run(write_image(tmp_path / "photo.png"), override.format(folder=tmp_path))


def test_a_kitti_folder_brings_its_own_cameras(run, tmp_path, capsys):
    """Two pictures of other sizes, each with its calibration; boxes lie where that camera sees them.

    Labels beside them are scored: no car is found.
    """
    folder = tmp_path / "training"
    for name, focal, width in (("000000", 200, 256), ("000001", 300, 320)):
        for part in ("image_2", "calib"):
            (folder / part).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / f"image_2/{name}.png"), np.full((128, width, 3), 90, np.uint8))
        (folder / f"calib/{name}.txt").write_text(f"P2: {focal} 0 128 40 0 {focal} 64 0 0 0 1 0\n")
    (folder / "label_2").mkdir()
    car = "Car 0 0 0 10 10 90 90 1.5 1.6 4.0 0 1.6 9 0\n"
    (folder / "label_2/000000.txt").write_text(car)
    run(folder, "intrinsics=null")
    shown = capsys.readouterr().out
    assert "KITTI's AP (R40) by the labels in label_2 [%]" in shown
    assert re.search(r"Car, 3d over 0\.7( +0\.0 of 0\.0){3}", shown)
    assert "the most that KITTI's AP can be" in shown
    assert re.search(r"Cyclist, bev over 0\.5 +- +- +-", shown)
    for name, focal in (("000000", 200), ("000001", 300)):
        labels = read_labels(tmp_path / f"out/image_2/{name}_boxes.txt")
        column = focal * (labels.location[:, 0] + 40 / focal) / labels.location[:, 2] + 128
        assert len(labels) == 2
        np.testing.assert_allclose(column, labels.xyxy[:, ::2].mean(1), atol=0.2 * 256)
    (folder / "calib/000001.txt").unlink()
    with pytest.raises(ValueError, match=r"calib/000001\.txt"):
        run(folder, "intrinsics=null", "overwrite=true")

"""``eldenet.predict boxes=true``: pictures, videos, live cameras, and what it needs."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.detector_files import FILES, save
from support.standing_boxes import BLANK, CAMERA, boxes

from eldenet.boxes import Detections2D
from eldenet.config import build_prediction, compose
from eldenet.deploy.prediction import predict
from eldenet.perception.kitti_object import read_labels
from eldenet.perception.scene import Scene
from eldenet.perception.tracking import BoxTracker


@pytest.fixture
def detector(tmp_path) -> Path:
    return save(tmp_path / "detector.onnx", *FILES["yolov8"])


def run(model_folder: Path, source: Path, output: Path, *overrides: str):
    quoted = [f"checkpoint='{model_folder}'", f"source='{source}'", f"output='{output}'", "boxes=true"]
    return predict(
        build_prediction(compose("predict", [*quoted, "runtime.threads=1", "runtime.workers=0", *overrides]))
    )


CAMERA_OPTION = "intrinsics=[200,200,128,64]"


def test_predict_draws_boxes_and_writes_kittis_format(model_folder, detector, tmp_path, capsys):
    source = tmp_path / "photo.png"
    cv2.imwrite(str(source), np.full((128, 256, 3), 90, np.uint8))
    option = f"perception.detector.path='{detector}'"
    run(model_folder, source, tmp_path / "out", CAMERA_OPTION, option)
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written >= {"photo_boxes.png", "photo_boxes.txt", "photo_depth.png", "photo_color.png"}
    assert read_labels(tmp_path / "out/photo_boxes.txt").types == ("dog", "cow")
    said = capsys.readouterr().out
    assert re.search(r"boxes: median depth [\d.]+ ms, detect [\d.]+ ms, lift [\d.]+ ms per picture", said)
    with pytest.raises(ValueError, match="there already"):
        run(model_folder, source, tmp_path / "out", CAMERA_OPTION, option, "formats=[color]")


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
    with pytest.raises(ValueError, match=r"there already, such as .*out/walk:"):  # the text files
        run(model_folder, source, tmp_path / "out", CAMERA_OPTION, f"perception.detector.path='{detector}'")


def test_speeds_of_a_live_camera_follow_from_the_times_of_its_frames(tmp_path):
    """One meter per second, of 30 frames a second every sixth: the rest were dropped."""
    from eldenet.deploy.outputs import Results
    from eldenet.perception import predict_boxes

    frames = [7 + 0.2 * step for step in range(15)]
    tracker, seen = BoxTracker(), []

    def perceive(photo, *, depth, seconds):
        seen.append(tracker(boxes([0.0, 0.8, 10 + frames[len(seen)] - frames[0]]), seconds))
        depth, none = np.ones(BLANK.shape[:2], np.float32), Detections2D.empty(("car",))
        return Scene(BLANK, depth, none, seen[-1], CAMERA, {})

    results = Results(tmp_path, ())
    with predict_boxes.box_results(perceive, results, ["cam"], None, is_video=True) as results.also:
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

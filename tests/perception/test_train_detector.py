"""Rendered pictures with boxes, their files, and a YOLOv9 trained on them (with libreyolo, slow)."""

import json
import sys

import numpy as np
import pytest

from eldenet.boxes import Detections2D
from eldenet.config import build_train_detector, compose
from eldenet.geometry import to_corner
from eldenet.perception.detection_data import read_split, write_dataset
from eldenet.perception.libreyolo_detector import LibreYoloDetector
from eldenet.simulation.furnished_rooms.rooms import generate_room
from eldenet.simulation.object_views import KINDS, NAMES, render_objects
from eldenet.perception.detector_training import average_precisions, train_detector

SIZE = (96, 160)
NEEDED = "pip install 'eldenet[yolo]'"


# --- pictures ---


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_have_boxes_inside_and_are_the_same_every_time(kind):
    views = [render_objects("train", index, SIZE, kind) for index in range(3)]
    assert sum(len(view.detections) for view in views) > 3
    for view in views:
        corners = to_corner(view.detections.xyxy)
        low, high = corners[:, :2], corners[:, 2:]
        assert (low >= 0).all()
        assert (high <= (SIZE[1], SIZE[0])).all()
        assert (high - low >= 6).all()
    again = render_objects("train", 1, SIZE, kind)
    np.testing.assert_array_equal(again.image, views[1].image)
    np.testing.assert_array_equal(again.detections.xyxy, views[1].detections.xyxy)
    other = render_objects("test", 1, SIZE, kind)
    assert not np.array_equal(other.image, views[1].image)


def test_rooms_hold_furniture_and_their_bodies_are_counted_right():
    import mujoco

    for index in range(4):
        room = generate_room("train", index)
        model = mujoco.MjModel.from_xml_string(room.text)
        assert room.pieces
        assert max(room.pieces) < model.nbody
        for number, maker in room.pieces.items():
            geoms = np.nonzero(model.geom_bodyid == number)[0]
            assert len(geoms) > 0
            if maker == "person":  # taller than wide: the number names the right body
                assert model.geom_pos[geoms, 2].max() > 1.0
    found = [render_objects("train", index, SIZE, "room").detections.classes for index in range(4)]
    assert {name for classes in found for name in classes} <= {"furniture", "person"}


def test_unknown_kinds_are_refused():
    with pytest.raises(ValueError, match="kind="):
        render_objects("train", 0, SIZE, "moon")


# --- files ---


def test_the_data_set_is_what_was_rendered_and_goes_on_where_it_stopped(tmp_path):
    yaml = write_dataset(tmp_path, {"train": 2, "test": 3}, SIZE, kinds=("hall", "street"))
    text = yaml.read_text()
    assert "train: images/train" in text
    assert f"  {len(NAMES) - 1}: furniture" in text
    pairs = read_split(tmp_path, "test", 3)
    for number, (image, boxes) in enumerate(pairs):
        view = render_objects("test", number // 2, SIZE, ("hall", "street")[number % 2])
        np.testing.assert_array_equal(image, view.image)
        np.testing.assert_allclose(boxes.xyxy, view.detections.xyxy, atol=1e-3)
        assert boxes.classes == view.detections.classes
        # YOLO counts from the picture's corner: a box's first pixel is a whole number there
        text = (tmp_path / f"labels/test/{number:06d}.txt").read_text().split()
        x, wide = (np.array(text[column::5], float) * SIZE[1] for column in (1, 3))
        np.testing.assert_allclose(x - wide / 2, view.detections.xyxy[:, 0] + 0.5, atol=1e-3)
    line = (tmp_path / "labels/test/000000.txt").read_text().splitlines()[0].split()
    assert len(line) == 5
    assert all(0 <= float(word) <= 1 for word in line[1:])
    kept = tmp_path / "images/test/000001.png"
    before = kept.stat().st_mtime_ns
    (tmp_path / "images/test/000002.png").unlink()
    write_dataset(tmp_path, {"train": 2, "test": 3}, SIZE, kinds=("hall", "street"))
    assert kept.stat().st_mtime_ns == before
    assert (tmp_path / "images/test/000002.png").is_file()
    with pytest.raises(ValueError, match="other settings"):
        write_dataset(tmp_path, {"train": 2}, (64, 96), kinds=("hall", "street"))


@pytest.mark.parametrize(
    ("counts", "kinds"), [({"train": 0}, ("hall",)), ({"train": 1}, ("moon",)), ({}, ())]
)
def test_data_sets_of_nothing_are_refused(counts, kinds, tmp_path):
    with pytest.raises(ValueError, match=r"give|needs"):
        write_dataset(tmp_path, counts, SIZE, kinds=kinds)


# --- scores ---


def found(boxes: list[list[float]], scores: list[float], labels: list[int]) -> Detections2D:
    return Detections2D(
        np.array(boxes, float).reshape(-1, 4), np.array(scores), np.array(labels, int), ("a", "b", "c")
    )


def test_average_precision_by_hand():
    """Class a: a find, a mistake, a find: precision 1 up to recall 1/2, then 2/3; COCO's 101 points."""
    pytest.importorskip("pycocotools", reason=NEEDED)
    truth = found([[0, 0, 50, 50], [100, 0, 150, 50], [0, 100, 80, 180]], [1, 1, 1], [0, 0, 1])
    guess = found(
        [[0, 0, 50, 50], [300, 300, 350, 350], [100, 0, 150, 50], [0, 100, 80, 165]],
        [0.9, 0.8, 0.7, 0.9], [0, 0, 0, 1],
    )  # fmt: skip
    values = average_precisions([truth], [guess])
    assert values["a"]["AP50"] == pytest.approx(100 * (51 + 50 * 2 / 3) / 101, abs=0.01)
    assert values["b"]["AP50"] == pytest.approx(100)
    assert values["b"]["AP50-95"] == pytest.approx(70)  # IoU 65 / 80 = 0.8125: 0.5 to 0.8 of ten
    assert np.isnan(values["c"]["AP50"])
    assert values["all"]["AP50"] == pytest.approx((values["a"]["AP50"] + 100) / 2, abs=0.01)
    assert (values["a"]["objects"], values["all"]["objects"]) == (2, 3)


# --- the detector ---


def test_what_is_missing_is_said(monkeypatch, tmp_path):
    with pytest.raises(ValueError, match="multiples of 32"):
        LibreYoloDetector(names=NAMES, input_size=(100, 160))
    with pytest.raises(ValueError, match="size="):
        LibreYoloDetector(names=NAMES, size="xxl")
    with pytest.raises(ValueError, match="names"):
        LibreYoloDetector()
    with pytest.raises(FileNotFoundError, match=r"none\.pt"):
        LibreYoloDetector(tmp_path / "none.pt")
    monkeypatch.setitem(sys.modules, "libreyolo", None)
    with pytest.raises(ValueError, match=r"eldenet\[yolo\]"):
        LibreYoloDetector(names=NAMES)


def test_a_run_folder_holds_one_training(tmp_path):
    (tmp_path / "run/train").mkdir(parents=True)
    with pytest.raises(ValueError, match="resume=true"):
        train_detector(
            build_train_detector(
                compose("train_detector", [f"run_dir='{tmp_path / 'run'}'"]), tmp_path / "run"
            )
        )


def test_the_config_shows_every_option():
    import inspect

    node = compose("train_detector", [])
    options = set(inspect.signature(LibreYoloDetector).parameters)
    assert options == {name for name in node.detector if name != "_target_"}
    options = set(inspect.signature(LibreYoloDetector.train).parameters)
    supplied = {"self", "data", "folder", "workers", "device", "seed", "resume"}
    assert options - supplied == set(node.training)


def test_random_weights_are_seeded_and_the_file_finds_the_same(tmp_path):
    pytest.importorskip("libreyolo", reason=NEEDED)
    from eldenet.perception.onnx_detector import OnnxDetector

    detector = LibreYoloDetector(
        names=NAMES, input_size=SIZE, threshold=0.0, nms=1.0, between_classes=1.0, seed=3
    )
    frame = np.random.default_rng(0).integers(0, 255, (120, 200, 3)).astype(np.uint8)
    mine = detector(frame)
    other = LibreYoloDetector(
        names=NAMES, input_size=SIZE, threshold=0.0, nms=1.0, between_classes=1.0, seed=3
    )(frame)
    np.testing.assert_array_equal(mine.xyxy, other.xyxy)
    file = OnnxDetector(detector.export(tmp_path / "d.onnx"), threshold=0.0, nms=1.0, between_classes=1.0)
    assert (file.layout_name, file.letterbox, file.names) == ("yolov9", "topleft", NAMES)
    theirs = file(frame)
    assert len(theirs) == len(mine) > 100
    (tmp_path / "data.yaml").write_text("names: [cat]\n")
    with pytest.raises(ValueError, match="classes"):
        detector.train(tmp_path / "data.yaml", tmp_path / "run", epochs=1)
    (tmp_path / "data.yaml").write_text("download: https://example.org/a.zip\n")
    with pytest.raises(ValueError, match="download"):
        detector.train(tmp_path / "data.yaml", tmp_path / "run", epochs=1)
    for boxes in (mine, theirs):  # equal scores have no order
        boxes.xyxy[:] = boxes.xyxy[np.lexsort(boxes.xyxy.T.round(2))]
    np.testing.assert_allclose(theirs.xyxy, mine.xyxy, atol=0.02)


@pytest.mark.slow
def test_a_detector_learns_and_its_file_finds_the_same(tmp_path):
    pytest.importorskip("libreyolo", reason=NEEDED)
    from eldenet.perception.onnx_detector import OnnxDetector

    folder = tmp_path / "run"
    options = [
        f"run_dir='{folder}'", "data.kinds=[hall]", "data.train=24", "data.test=4",
        "detector.input_size=[96,160]",
        "training.batch=4", "runtime.threads=1", "runtime.workers=0", "runtime.device=cpu",
    ]  # fmt: skip
    (folder / "train").mkdir(parents=True)  # as a run leaves it that was killed before its first checkpoint
    first = compose("train_detector", [*options, "training.epochs=4", "resume=true"])
    record = train_detector(build_train_detector(first, folder))
    assert json.loads((folder / "run.json").read_text())["metrics"]["all"]["objects"] > 5
    assert (folder / "detections.png").is_file()
    rows = (folder / "train/results.csv").read_text().splitlines()
    loss = [float(row.split(",")[2]) for row in rows[1:]]
    assert len(loss) == 4
    assert loss[-1] < 0.9 * loss[0]
    assert record["file"]["bytes"] > 1e6
    with pytest.raises(ValueError, match="resume=true"):
        train_detector(
            build_train_detector(compose("train_detector", [*options, "training.epochs=5"]), folder)
        )
    train_detector(
        build_train_detector(
            compose("train_detector", [*options, "training.epochs=5", "resume=true"]), folder
        )
    )
    assert len((folder / "train/results.csv").read_text().splitlines()) == 6
    trained = LibreYoloDetector(folder / "train/weights/last.pt", input_size=SIZE, threshold=0.01)
    image, _ = read_split(folder / "data", "test", 1)[0]
    mine, theirs = trained(image), OnnxDetector(folder / "detector.onnx", threshold=0.01)(image)
    np.testing.assert_allclose(theirs.score[:5], mine.score[:5], atol=1e-3)
    np.testing.assert_allclose(theirs.xyxy[:5], mine.xyxy[:5], atol=0.1)

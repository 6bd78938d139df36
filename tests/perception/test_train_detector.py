"""experiments/detector: data sets of rendered images, and a YOLOv9 trained on them (with libreyolo, slow)."""

import json

import numpy as np
import pytest
from support.scripts import load_scripts

from eldenet.boxes import Detections2D
from eldenet.geometry import to_corner
from eldenet.simulation.furnished_rooms.rooms import generate_room
from eldenet.simulation.rendering.shading import CompiledRoom

train, detection_data, libreyolo_detector, object_views = load_scripts(
    "detector", "train", "detection_data", "libreyolo_detector", "object_views"
)
names_of, render_objects, OBJECTS = object_views.names_of, object_views.render_objects, object_views.OBJECTS
read_split, write_dataset = detection_data.read_split, detection_data.write_dataset
LibreYoloDetector = libreyolo_detector.LibreYoloDetector
SIZE = (96, 160)
NAMES = names_of(("street", "hall"))
NEEDED = "pip install libreyolo onnx onnxruntime"


def options(folder, *words):
    return train.options(["--output", str(folder), *words])


# --- rendered scenes ---


@pytest.mark.parametrize("kind", OBJECTS)
def test_boxes_of_rendered_objects_lie_inside_the_image(kind):
    views = [render_objects("train", index, SIZE, kind) for index in range(3)]
    assert {name for view in views for name in view.detections.classes} <= set(OBJECTS[kind])
    assert sum(len(view.detections) for view in views) > 3
    for view in views:
        corners = to_corner(view.detections.xyxy)
        low, high = corners[:, :2], corners[:, 2:]
        assert (low >= 0).all()
        assert (high <= (SIZE[1], SIZE[0])).all()
        assert (high - low >= 6).all()


def test_the_pieces_of_a_room_have_the_indices_of_their_bodies():
    for index in range(4):
        room = generate_room("train", index)
        model = CompiledRoom(room).model
        assert room.pieces
        for number, maker in room.pieces.items():
            geoms = np.nonzero(model.geom_bodyid == number)[0]
            assert len(geoms) > 0
            if maker == "person":  # taller than wide: this is the right body
                assert model.geom_pos[geoms, 2].max() > 1.0


# --- files ---


def test_a_data_set_holds_the_rendered_images_and_continues_where_it_stopped(tmp_path):
    yaml = write_dataset(tmp_path, {"train": 2, "test": 3}, SIZE, kinds=("hall", "street"))
    text = yaml.read_text()
    assert "train: images/train" in text
    assert f"  {len(NAMES) - 1}: {NAMES[-1]}" in text
    pairs = read_split(tmp_path, "test", 3)
    for number, (image, boxes) in enumerate(pairs):
        view = render_objects("test", number // 2, SIZE, ("hall", "street")[number % 2])
        np.testing.assert_array_equal(image, view.image)
        np.testing.assert_allclose(boxes.xyxy, view.detections.xyxy, atol=1e-3)
        assert boxes.classes == view.detections.classes
        # YOLO counts from the image corner, where the left edge of a box is a whole number
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


def test_a_data_set_of_other_lenses_is_another_one(tmp_path):
    kinds = ("street", "hall", "room")
    for name, focal in (("own", None), ("any", (0.4, 2.0))):
        write_dataset(tmp_path / name, {"train": 3}, SIZE, kinds=kinds, focal=focal)
        images = [image for image, _ in read_split(tmp_path / name, "train", 3)]
        wanted = [render_objects("train", 0, SIZE, kind, focal=focal).image for kind in kinds]
        np.testing.assert_array_equal(images, wanted)
    with pytest.raises(ValueError, match="other settings"):
        write_dataset(tmp_path / "own", {"train": 3}, SIZE, kinds=kinds, focal=(0.4, 2.0))
    with pytest.raises(ValueError, match=r"focal=\[2.0, 0.4\]"):
        write_dataset(tmp_path / "wrong", {"train": 3}, SIZE, kinds=kinds, focal=(2.0, 0.4))


def test_classes_are_those_of_the_kinds_and_keep_their_names_in_files(tmp_path):
    """Crossings have cyclists, arenas their obstacles; the numbers in files are those of the list of both."""
    kinds = ("crossing", "arena")
    write_dataset(tmp_path, {"test": 4}, SIZE, kinds=kinds)
    found = set()
    for number, (image, boxes) in enumerate(read_split(tmp_path, "test", 4)):
        view = render_objects("test", number // 2, SIZE, kinds[number % 2])
        np.testing.assert_array_equal(image, view.image)
        assert boxes.classes == view.detections.classes
        assert boxes.names == names_of(kinds)
        found |= set(boxes.classes)
    assert {"cyclist", "person"} < found
    assert found & {"cylinder", "vehicle"}
    assert names_of(("street", "hall", "room")) == (
        "car", "van", "truck", "person", "box", "pillar", "furniture",
    )  # fmt: skip


# --- scores ---


def found(boxes: list[list[float]], scores: list[float], labels: list[int]) -> Detections2D:
    return Detections2D(
        np.array(boxes, float).reshape(-1, 4), np.array(scores), np.array(labels, int), ("a", "b", "c")
    )


def test_cocos_average_precision_by_hand():
    """Class a: true, false, true: precision 1 up to recall 1/2, then 2/3; COCO's 101 points."""
    pytest.importorskip("pycocotools", reason=NEEDED)
    truth = found([[0, 0, 50, 50], [100, 0, 150, 50], [0, 100, 80, 180]], [1, 1, 1], [0, 0, 1])
    guess = found(
        [[0, 0, 50, 50], [300, 300, 350, 350], [100, 0, 150, 50], [0, 100, 80, 165]],
        [0.9, 0.8, 0.7, 0.9], [0, 0, 0, 1],
    )  # fmt: skip
    values = train.average_precisions([truth], [guess])
    assert values["a"]["AP50"] == pytest.approx(100 * (51 + 50 * 2 / 3) / 101, abs=0.01)
    assert values["b"]["AP50"] == pytest.approx(100)
    assert values["b"]["AP50-95"] == pytest.approx(70)  # IoU 65 / 80 = 0.8125: 0.5 to 0.8 of ten
    assert np.isnan(values["c"]["AP50"])
    assert values["all"]["AP50"] == pytest.approx((values["a"]["AP50"] + 100) / 2, abs=0.01)
    assert (values["a"]["objects"], values["all"]["objects"]) == (2, 3)


# --- the detector ---


def test_random_weights_are_seeded_and_the_exported_file_agrees(tmp_path):
    pytest.importorskip("libreyolo", reason=NEEDED)
    from eldenet.perception.onnx_detector import OnnxDetector

    everything = {"threshold": 0.0, "nms": 1.0, "between_classes": 1.0}
    detector = LibreYoloDetector(names=NAMES, input_size=SIZE, seed=3, **everything)
    frame = np.random.default_rng(0).integers(0, 255, (120, 200, 3)).astype(np.uint8)
    mine = detector(frame)
    other = LibreYoloDetector(names=NAMES, input_size=SIZE, seed=3, **everything)(frame)
    np.testing.assert_array_equal(mine.xyxy, other.xyxy)
    file = OnnxDetector(detector.export(tmp_path / "d.onnx"), **everything)
    assert (file.layout_name, file.letterbox, file.names) == ("yolov9", "topleft", NAMES)
    theirs = file(frame)
    assert len(theirs) == len(mine) > 100
    data = tmp_path / "data.yaml"
    for content, message in (
        ("names: [cat]", "classes"),
        ("download: https://example.org/a.zip", "download"),
    ):
        data.write_text(content)
        with pytest.raises(ValueError, match=message):
            detector.train(data, tmp_path / "run", libreyolo_detector.YoloTraining(epochs=1))
    for boxes in (mine, theirs):  # equal scores have no order
        boxes.xyxy[:] = boxes.xyxy[np.lexsort(boxes.xyxy.T.round(2))]
    np.testing.assert_allclose(theirs.xyxy, mine.xyxy, atol=0.02)


@pytest.mark.slow
def test_a_detector_learns_resumes_and_exports_what_it_learned(tmp_path):
    pytest.importorskip("libreyolo", reason=NEEDED)
    from eldenet.perception.onnx_detector import OnnxDetector

    folder = tmp_path / "run"
    words = ["--kinds", "hall", "--train", "24", "--test", "4", "--size", "96", "160"]
    words += ["--batch", "4", "--threads", "1", "--device", "cpu"]
    (folder / "train").mkdir(parents=True)  # as a run leaves it if killed before its first checkpoint
    record = train.train(options(folder, *words, "--epochs", "4", "--resume"))
    assert json.loads((folder / "run.json").read_text())["metrics"]["all"]["objects"] > 5
    assert (folder / "detections.png").is_file()
    loss = np.loadtxt(folder / "train/results.csv", delimiter=",", skiprows=1, usecols=2)
    assert len(loss) == 4
    assert loss[-1] < 0.9 * loss[0]
    assert record["file"]["bytes"] > 1e6
    assert record["frames"] == "streets-v1"
    train.train(options(folder, *words, "--epochs", "5", "--resume"))
    assert len((folder / "train/results.csv").read_text().splitlines()) == 6
    trained = LibreYoloDetector(folder / "train/weights/last.pt", input_size=SIZE, threshold=0.01)
    image, _ = read_split(folder / "data", "test", 1)[0]
    mine, theirs = trained(image), OnnxDetector(folder / "detector.onnx", threshold=0.01)(image)
    np.testing.assert_allclose(theirs.score[:5], mine.score[:5], atol=1e-3)
    np.testing.assert_allclose(theirs.xyxy[:5], mine.xyxy[:5], atol=0.1)

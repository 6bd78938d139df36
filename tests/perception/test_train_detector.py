"""experiments/detector: data sets of rendered images."""

import numpy as np
import pytest
from support.scripts import load_scripts

from eldenet.geometry import to_corner
from eldenet.simulation.furnished_rooms.rooms import generate_room
from eldenet.simulation.rendering.shading import CompiledRoom

detection_data, object_views = load_scripts("detector", "detection_data", "object_views")
names_of, render_objects, OBJECTS = object_views.names_of, object_views.render_objects, object_views.OBJECTS
read_split, write_dataset = detection_data.read_split, detection_data.write_dataset
SIZE = (96, 160)
NAMES = names_of(("street", "hall"))


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

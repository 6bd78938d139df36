"""Rendered images with the 2D boxes of their objects."""

import numpy as np
import pytest

from eldenet.geometry import to_corner
from eldenet.simulation.furnished_rooms.rooms import generate_room
from eldenet.simulation.street_views import OBJECTS, render_objects

SIZE = (96, 160)


@pytest.mark.parametrize("kind", OBJECTS)
def test_boxes_lie_inside_the_image_and_rendering_is_reproducible(kind):
    views = [render_objects("train", index, SIZE, kind) for index in range(3)]
    assert {name for view in views for name in view.detections.classes} <= set(OBJECTS[kind])
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


def test_the_pieces_of_a_room_have_the_indices_of_their_bodies():
    import mujoco

    for index in range(4):
        room = generate_room("train", index)
        model = mujoco.MjModel.from_xml_string(room.text)
        assert room.pieces
        assert max(room.pieces) < model.nbody
        for number, maker in room.pieces.items():
            geoms = np.nonzero(model.geom_bodyid == number)[0]
            assert len(geoms) > 0
            if maker == "person":  # taller than wide: this is the right body
                assert model.geom_pos[geoms, 2].max() > 1.0
    found = [render_objects("train", index, SIZE, "room").detections.classes for index in range(4)]
    assert {name for classes in found for name in classes} <= {"furniture", "person"}

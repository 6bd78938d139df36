"""Boxes drawn in the image and in a bird's-eye view."""

from dataclasses import replace

import numpy as np
import pytest
from support.standing_boxes import BLANK, CAMERA, boxes

from eldenet.boxes import Boxes3D, Detections2D
from eldenet.perception.drawing import color_of, draw_bev, draw_boxes, draw_detections


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
    assert not (BLANK != 40).any()  # the given image does not change


@pytest.mark.parametrize("z", [0.5, -0.5, -20.0])
def test_boxes_beside_and_behind_the_camera_are_cut_or_left_out(z):
    drawn = draw_boxes(BLANK, boxes([0.8, 0.5, z]), CAMERA)
    assert (drawn != BLANK).any() == (z > -2)


def test_labels_do_not_overlap_and_the_nearest_stays_in_place():
    alone = draw_boxes(BLANK, boxes([0.0, 0.8, 10.0]), CAMERA)
    row = boxes([[0.05 * place, 0.8, 10.0 + 0.3 * place] for place in range(12)])
    drawn = draw_boxes(BLANK, row, CAMERA)
    patch = ((alone != draw_boxes(BLANK, boxes([0.0, 0.8, 10.0]), CAMERA, labels=False)).any(-1)).nonzero()
    np.testing.assert_array_equal(drawn[patch], alone[patch])
    dark = (drawn == 20).all(-1).sum() / (alone == 20).all(-1).sum()
    assert 1.5 < dark < 5  # of twelve labels, those that fit above it


def test_the_front_face_is_shaded_if_it_is_known():
    one = boxes([0.0, 0.8, 10.0], yaw=np.pi / 2)  # its front looks at the camera
    plain, shaded = (draw_boxes(BLANK, one, CAMERA, front=front, labels=False) for front in (False, True))
    assert (shaded != plain).any(-1).sum() > 200
    two = boxes([[-2.0, 0.8, 10.0], [2.0, 0.8, 10.0]], yaw=np.pi / 2)
    one_known = draw_boxes(BLANK, two, CAMERA, front=np.array([False, True]), labels=False)
    changed = (one_known != draw_boxes(BLANK, two, CAMERA, labels=False)).any(-1)
    assert changed[:, 160:].any()
    assert not changed[:, :160].any()


def drawn_pixels(panel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a bird's-eye view in the color of cars."""
    color = np.array([int(0.75 * part) for part in color_of("car")])
    return np.nonzero(np.abs(panel.astype(int) - color).max(-1) < 8)


def test_the_birds_eye_view_shows_a_box_at_its_place():
    rows, columns = drawn_pixels(draw_bev(boxes([3.0, 0.8, 20.0]), CAMERA, 320, size=(412, 300), reach=40.0))
    assert (columns.mean() - 150) / 10 == pytest.approx(3.0, abs=0.15)
    assert (412 - 6 - rows.mean()) / 10 == pytest.approx(20.0, abs=0.15)
    assert draw_bev(Boxes3D.empty(("car",)), CAMERA, 320).any()


@pytest.mark.parametrize("center", [[30.0, 0.8, 20.0], [-30.0, 0.8, 20.0], [0.0, 0.8, 70.0]])
def test_every_box_is_inside_the_birds_eye_view(center):
    rows, columns = drawn_pixels(draw_bev(boxes(center), CAMERA, 320, size=(400, 300)))
    assert 0 < rows.min() <= rows.max() < 399
    assert 0 < columns.min() <= columns.max() < 299


def test_a_2d_box_is_drawn_on_its_outermost_pixels():
    def drawn(xyxy: list[float]) -> np.ndarray:
        found = Detections2D(np.array([xyxy]), np.ones(1), np.zeros(1, int), ("car",))
        return (draw_detections(BLANK, found) == color_of("car")).all(-1)

    assert drawn([20.0, 30, 60, 80])[30:80, 20].all()
    height, width = BLANK.shape[:2]
    whole = drawn([-0.5, -0.5, width - 0.5, height - 0.5])
    assert whole[-1].all()
    assert whole[:, -1].all()
    few = drawn([49.5, 51.5, 53.5, 55.5])
    assert few[52:56, 53].all()
    assert not few[52:56, 54].any()
    assert not few[56, 50:54].any()


def test_doubtful_boxes_are_dashed_and_marked():
    sure = boxes([0.0, 0.8, 6.0], yaw=0.3)
    unsure = replace(sure, quality={"doubtful": np.ones(1)})
    lines = [(draw_boxes(BLANK, one, CAMERA, labels=False) != BLANK).any(-1).sum() for one in (sure, unsure)]
    assert 0.4 * lines[0] < lines[1] < 0.8 * lines[0]
    above = [len(drawn_pixels(draw_bev(one, CAMERA, 320))[0]) for one in (sure, unsure)]
    assert 0.4 * above[0] < above[1] < 0.9 * above[0]
    marked = draw_boxes(BLANK, unsure, CAMERA) != draw_boxes(BLANK, unsure, CAMERA, labels=False)
    plain = draw_boxes(BLANK, sure, CAMERA) != draw_boxes(BLANK, sure, CAMERA, labels=False)
    assert np.ptp(np.nonzero(marked)[1]) > np.ptp(np.nonzero(plain)[1])  # a longer label

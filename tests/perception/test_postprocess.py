"""Pictures that are fitted to a detector, and which of its boxes are kept."""

import numpy as np
import pytest
from support.detector_files import SIZE

from eldenet.perception.postprocess import class_wise_nms, fit_picture, in_frame, one_class_each


@pytest.mark.parametrize("letterbox", ["topleft", "center", "stretch"])
def test_boxes_come_back_from_every_letterbox(letterbox, tmp_path):
    """What is drawn at a place of the fitted picture is found at its place in the frame."""
    frame = np.zeros((100, 100, 3), np.uint8)
    frame[40:60, 20:50] = 255
    picture, scale, shift = fit_picture(frame, SIZE, letterbox)
    assert picture.shape == (*SIZE, 3)
    rows, columns = np.nonzero((picture > 200).all(-1))
    box = np.array([[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]], float)
    found, score, label = in_frame(
        box, np.array([[0.1, 0.9]]), scale, shift, frame.shape[:2], threshold=0.3, nms=0.5
    )
    np.testing.assert_allclose(found, [[20, 40, 50, 60]], atol=2)
    assert (score.tolist(), label.tolist()) == ([0.9], [1])


@pytest.mark.parametrize("letterbox", ["topleft", "center", "stretch"])
def test_the_whole_picture_is_the_whole_frame(letterbox):
    frame = np.full((98, 400, 3), 255, np.uint8)  # 31.36 rows of the input, so 31
    picture, scale, shift = fit_picture(frame, SIZE, letterbox)
    rows, columns = np.nonzero((picture > 200).all(-1))
    box = np.array([[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]], float)
    np.testing.assert_allclose((box - np.tile(shift, 2)) / np.tile(scale, 2), [[0, 0, 400, 98]], atol=1e-9)


def test_nms_is_class_wise():
    boxes = np.array([[0, 0, 10, 10], [0, 0, 10, 11], [0, 0, 10, 10.0]])
    kept = class_wise_nms(boxes, np.array([0.5, 0.9, 0.4]), np.array([0, 0, 1]), 0.5)
    assert kept.tolist() == [1, 2]


def test_one_object_has_one_class():
    """Best first: the second is the first's twin of another class, the third of its own, the fourth apart."""
    boxes = np.array([[0, 0, 10, 10], [0, 0, 10, 9.0], [0, 0, 10, 9.5], [0, 0, 10, 8.0]])
    label = np.array([0, 1, 0, 1])
    assert one_class_each(boxes, label, 0.85).tolist() == [0, 2, 3]
    assert one_class_each(boxes, label, 1.0).tolist() == [0, 1, 2, 3]
    assert one_class_each(boxes[:0], label[:0], 0.85).tolist() == []
    apart = np.array([[0, 0, 10, 10], [20, 0, 30, 10.0]])
    assert one_class_each(apart, np.array([0, 1]), 0.0).tolist() == [0, 1]

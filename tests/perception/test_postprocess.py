"""Images fitted to a detector's input, and the choice among its boxes."""

import numpy as np
import pytest
from support.detector_files import SIZE

from eldenet.perception.postprocess import cross_class_nms, fit_image, select_boxes


@pytest.mark.parametrize("letterbox", ["topleft", "center", "stretch"])
def test_boxes_return_from_every_letterbox(letterbox):
    """An object drawn in the frame is found in the fitted image and returned at its place in the frame."""
    frame = np.zeros((98, 400, 3), np.uint8)  # 31.36 rows of the input, so 31
    frame[38:60, 20:150] = 255
    fitted, placement = fit_image(frame, SIZE, letterbox)
    assert fitted.shape == (*SIZE, 3)
    rows, columns = np.nonzero((fitted > 200).all(-1))
    box = np.array([[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]], float)
    found, score, label = select_boxes(box, np.array([[0.1, 0.9]]), placement, threshold=0.3, nms=0.5)
    np.testing.assert_allclose(found, [[20, 38, 150, 60]], atol=4)
    whole = np.array([0, 0, 400, 98]) * np.tile(placement.scale, 2) + np.tile(placement.shift, 2)
    np.testing.assert_allclose(whole, whole.round(), atol=1e-9)  # exact for sizes that are rounded
    assert (score.tolist(), label.tolist()) == ([0.9], [1])


def test_nms_compares_boxes_of_one_class():
    boxes = np.array([[0, 0, 10, 10], [0, 0, 10, 11], [0, 0, 10, 10.0]])
    score = np.array([[0.5, 0], [0.9, 0], [0, 0.4]])
    _, placement = fit_image(np.zeros((*SIZE, 3), np.uint8), SIZE, "stretch")
    _, best, label = select_boxes(boxes, score, placement, threshold=0.3, nms=0.5)
    assert (best.tolist(), label.tolist()) == ([0.9, 0.4], [0, 1])


def test_cross_class_nms_keeps_one_class_per_object():
    """Best first: the second is a twin of the first with another class, the third has its class."""
    boxes = np.array([[0, 0, 10, 10], [0, 0, 10, 9.0], [0, 0, 10, 9.5], [0, 0, 10, 8.0]])
    label = np.array([0, 1, 0, 1])
    assert cross_class_nms(boxes, label, 0.85).tolist() == [0, 2, 3]
    assert cross_class_nms(boxes, label, 1.0).tolist() == [0, 1, 2, 3]
    assert cross_class_nms(boxes[:0], label[:0], 0.85).tolist() == []
    apart = np.array([[0, 0, 10, 10], [20, 0, 30, 10.0]])
    assert cross_class_nms(apart, np.array([0, 1]), 0.0).tolist() == [0, 1]

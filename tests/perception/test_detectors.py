"""Detectors without a file: known boxes, functions, torchvision; riders and bicycles become cyclists."""

import numpy as np
import pytest
import torch
from support.detector_files import FRAME, WANTED

from eldenet.boxes import Detections2D
from eldenet.perception.detectors import (
    CallableDetector,
    FixedDetections,
    TorchvisionDetector,
    merge_cyclists,
)


def test_fixed_detections_come_in_order():
    known = [Detections2D(WANTED, np.full(2, score), np.array([0, 1]), ("car", "dog")) for score in (0.5, 1)]
    fixed = FixedDetections(known)
    assert [fixed(FRAME) for _ in known] == known


def test_a_function_is_a_detector_that_counts_from_the_corner():
    found = CallableDetector(lambda frame: (WANTED.tolist(), [0.5, 0.6], [0, 1]), ("car", "dog"))(FRAME)
    np.testing.assert_array_equal(found.xyxy, WANTED - 0.5)
    assert found.classes == ["car", "dog"]


def test_a_function_may_name_its_classes():
    found = CallableDetector(lambda frame: (WANTED, [0.5, 0.6], ["dog", "car"]), ("car", "dog"))(FRAME)
    assert found.label.tolist() == [1, 0]
    with pytest.raises(ValueError, match="labels dog are not in names"):
        CallableDetector(lambda frame: (WANTED, [0.5, 0.6], ["dog", "car"]), ("car",))(FRAME)
    with pytest.raises(ValueError, match="the detector returned a ndarray: return three arrays"):
        CallableDetector(lambda frame: np.zeros((2, 6)), ("car",))(FRAME)
    with pytest.raises(ValueError, match=r"shapes \(2,\), \(2,\), \(2, 4\): return boxes \(N, 4\), scores"):
        CallableDetector(lambda frame: ([0, 1], [0.5, 0.6], WANTED), ("car", "dog"))(FRAME)
    with pytest.raises(ValueError, match=r"scores 0 to 1 and labels 0\.5 to 0\.6: return boxes, scores"):
        CallableDetector(lambda frame: (WANTED, [0, 1], [0.5, 0.6]), ("car", "dog"))(FRAME)
    with pytest.raises(ValueError, match="labels are float64: give whole numbers"):
        Detections2D(WANTED, np.ones(2), np.zeros(2), ("car",))


def test_a_torchvision_network_gets_images_in_its_own_precision():
    from torchvision.models.detection import ssdlite320_mobilenet_v3_large

    torch.manual_seed(0)
    model = ssdlite320_mobilenet_v3_large(weights=None, weights_backbone=None, num_classes=3)
    detector = TorchvisionDetector(model, ("nothing", "car", "dog"), threshold=0.0)
    single = detector(FRAME)
    model.double()
    double = detector(FRAME)
    assert len(double) > 0
    assert (double.xyxy.dtype, double.score.dtype) == (single.xyxy.dtype, single.score.dtype)
    assert set(double.classes) <= {"car", "dog"}
    assert (double.xyxy >= -0.5).all()


def test_a_person_on_a_bicycle_becomes_a_cyclist_with_both_masks():
    xyxy = np.array([[10, 10, 30, 60], [5, 35, 40, 75], [80, 10, 95, 60], [100, 0, 150, 50.0]])
    mask = np.zeros((4, 80, 160), bool)
    mask[0, 10:60, 10:30], mask[1, 40:75, 5:40] = True, True
    names = ("person", "bicycle", "car")
    found = merge_cyclists(Detections2D(xyxy, np.ones(4), np.array([0, 1, 0, 2]), names, mask=mask))
    assert found.classes == ["cyclist", "person", "car"]
    np.testing.assert_array_equal(found.xyxy[0], [5, 10, 40, 75])
    np.testing.assert_array_equal(found.mask[0], mask[:2].any(0))
    assert mask[0].sum() == 1000  # the detector's own masks do not change

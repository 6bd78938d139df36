"""ONNX detectors: files of every layout, made here with known boxes."""

from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto
from support.detector_files import FILES, FRAME, NAMES, WANTED, save, yolov8

from eldenet.perception.detectors import (
    COCO_NAMES,
    Detector,
)
from eldenet.perception.onnx_detector import OnnxDetector


@pytest.mark.parametrize("layout", sorted(FILES))
def test_every_layout_is_recognized_and_decoded(layout, tmp_path):
    detector = OnnxDetector(save(tmp_path / "d.onnx", *FILES[layout]))
    assert detector.layout_name == layout
    assert isinstance(detector, Detector)
    found = detector(FRAME)
    assert found.classes == ["dog", "cow"]
    # a frame of twice the input; detectors count from the corner, so pixel centers are at halves
    np.testing.assert_allclose(found.xyxy, WANTED - 0.5, atol=2e-3 if layout != "fastestdet" else 0.2)
    np.testing.assert_allclose(found.score, [0.9, 0.7], atol=1e-3)


def test_classes_and_scores_can_be_chosen(tmp_path):
    path = save(tmp_path / "d.onnx", *FILES["yolov8"])
    assert OnnxDetector(path, keep=["cow"])(FRAME).classes == ["cow"]
    assert OnnxDetector(path, threshold=0.8)(FRAME).classes == ["dog"]
    assert len(OnnxDetector(path, threshold=0.95)(FRAME)) == 0
    assert len(OnnxDetector(path, nms=0.999)(FRAME)) == 4
    for name, wrong in (("threshold", 30), ("nms", -1), ("between_classes", 2), ("threads", -3)):
        with pytest.raises(ValueError, match=name):
            OnnxDetector(path, **{name: wrong})
    with pytest.raises(ValueError, match="horse"):
        OnnxDetector(path, keep=["horse"])


@pytest.mark.parametrize("layout", sorted(FILES))
def test_every_layout_gets_its_order_of_colors(layout, tmp_path):
    """The file finds objects only where the first channel it is given is bright."""
    path = save(tmp_path / "d.onnx", *FILES[layout], by_first_channel=True)
    red, blue = FRAME.copy(), FRAME.copy()
    red[..., 0] = blue[..., 2] = 255
    found = {name: len(OnnxDetector(path)(frame)) for name, frame in (("red", red), ("blue", blue))}
    bgr = layout in ("yolox", "fastestdet")  # as their authors train them, with OpenCV's pictures
    assert found == {"red": 0 if bgr else 2, "blue": 2 if bgr else 0}


def test_unknown_layouts_sizes_and_names_are_refused(tmp_path):
    odd = save(tmp_path / "odd.onnx", np.zeros((1, 17)), {})
    with pytest.raises(ValueError, match="layout="):
        OnnxDetector(odd)
    nameless = save(tmp_path / "n.onnx", yolov8(), {})
    with pytest.raises(ValueError, match="names"):
        OnnxDetector(nameless)
    assert OnnxDetector(nameless, names=NAMES)(FRAME).names == NAMES
    with pytest.raises(ValueError, match="3 classes, but 2 names"):
        OnnxDetector(nameless, names=NAMES[:2])
    with pytest.raises(ValueError, match="input_size"):
        OnnxDetector(nameless, names=NAMES, input_size=(32, 32))
    with pytest.raises(FileNotFoundError, match=r"\.onnx"):
        OnnxDetector(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("no model")
    with pytest.raises(ValueError, match="no ONNX file"):
        OnnxDetector(tmp_path / "text.onnx")
    with pytest.raises(ValueError, match="frame is"):
        OnnxDetector(nameless, names=NAMES)(FRAME.astype(np.float32))


def test_a_file_under_the_agpl_says_so(tmp_path):
    output, metadata = FILES["yolov8"]
    path = save(tmp_path / "a.onnx", output, metadata | {"license": "AGPL-3.0 License"})
    with pytest.warns(UserWarning, match="AGPL"):
        OnnxDetector(path)


def test_a_half_precision_file_gets_its_own_numbers(tmp_path, monkeypatch):
    path = save(tmp_path / "half.onnx", *FILES["yolov8"], kind=TensorProto.FLOAT16)
    monkeypatch.setenv("HOME", str(tmp_path))
    found = OnnxDetector("~/half.onnx")(FRAME)
    np.testing.assert_allclose(found.xyxy, WANTED - 0.5, atol=2e-3)
    save(path, *FILES["yolov8"], kind=TensorProto.UINT8)
    with pytest.raises(ValueError, match=r"input of tensor\(uint8\), a detector takes tensor\(float\)"):
        OnnxDetector(path)


def test_a_detector_says_that_it_fell_back(tmp_path, monkeypatch):
    path = save(tmp_path / "d.onnx", *FILES["yolov8"])
    with pytest.warns(UserWarning, match="runs by CPUExecutionProvider: CUDAExecutionProvider is not"):
        OnnxDetector(path, providers=["CUDAExecutionProvider", "CPUExecutionProvider"])
    for wrong in (["cuda"], "CPUExecutionProvider", []):
        with pytest.raises(ValueError, match="this ONNX Runtime has"):
            OnnxDetector(path, providers=wrong)
    # installed, but its driver is not: ONNX Runtime takes the CPU, and its log is off
    there = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    monkeypatch.setattr("onnxruntime.get_available_providers", lambda: there)
    with pytest.warns(UserWarning, match="cannot start on this machine"):
        OnnxDetector(path, providers=there[:1])


def test_a_detector_keeps_the_better_of_two_classes(tmp_path):
    output, metadata = FILES["yolov8"]
    twice = output.copy()
    twice[0, :4, 30] = output[0, :4, 7]  # the dog again, as a cat
    twice[0, 4, 30] = 0.5
    path = save(tmp_path / "twins.onnx", twice, metadata)
    assert OnnxDetector(path)(FRAME).classes == ["dog", "cow"]
    assert sorted(OnnxDetector(path, between_classes=1.0)(FRAME).classes) == ["cat", "cow", "dog"]
    assert OnnxDetector(path, keep=["cat", "cow"])(FRAME).classes == ["cow"]  # the dog does not become a cat


def test_real_weights_find_the_cars(monkeypatch):
    import os

    from eldenet.perception.kitti_object import KittiObjects

    if not (os.environ.get("ELDENET_WEIGHTS") and os.environ.get("ELDENET_DATA")):
        pytest.skip("set ELDENET_WEIGHTS and ELDENET_DATA")
    folder = Path(os.environ["ELDENET_WEIGHTS"]) / "detector"
    image = KittiObjects().image("000008")
    for name, layout in (("yolox_nano_coco_256x832", "yolox"), ("fastestdet_coco_352", "fastestdet")):
        detector = OnnxDetector(folder / f"{name}.onnx")
        assert (detector.layout_name, detector.names) == (layout, COCO_NAMES)
        found = detector(image)
        assert found.classes[:5] == ["car"] * 5
        if layout == "yolox":
            assert len(found) == 10
            both = OnnxDetector(folder / f"{name}.onnx", between_classes=1.0)(image)
            assert sorted(set(both.classes)) == ["car", "truck"]
            assert len(both) == 11  # one of the cars is found as a truck too
            np.testing.assert_allclose(found.score[:5], [0.89, 0.89, 0.86, 0.86, 0.84], atol=0.006)

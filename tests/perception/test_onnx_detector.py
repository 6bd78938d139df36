"""ONNX detectors: files of every layout, with known boxes."""

from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto
from support.detector_files import ANCHORS, FILES, FRAME, NAMES, WANTED, save, yolov8

from eldenet.perception.detectors import COCO_NAMES, Detector
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
    for name, wrong in (("threshold", 30), ("nms", -1), ("between_classes", 2)):
        with pytest.raises(ValueError, match=name):
            OnnxDetector(path, **{name: wrong})
    with pytest.raises(ValueError, match="horse"):
        OnnxDetector(path, keep=["horse"])


@pytest.mark.parametrize("layout", sorted(FILES))
def test_every_layout_gets_its_color_order(layout, tmp_path):
    """The file finds objects only if its first channel is bright."""
    path = save(tmp_path / "d.onnx", *FILES[layout], by_first_channel=True)
    red, blue = FRAME.copy(), FRAME.copy()
    red[..., 0] = blue[..., 2] = 255
    found = {name: len(OnnxDetector(path)(frame)) for name, frame in (("red", red), ("blue", blue))}
    bgr = layout in ("yolox", "fastestdet")  # trained on OpenCV's images
    assert found == {"red": 0 if bgr else 2, "blue": 2 if bgr else 0}


def test_unknown_layouts_sizes_and_names_are_refused(tmp_path):
    save(tmp_path / "odd.onnx", np.zeros((1, 17)), {})
    save(tmp_path / "yolov5.onnx", np.zeros((1, 3 * ANCHORS, 6)), {"names": "['cat']"})  # six columns
    nameless = save(tmp_path / "nameless.onnx", yolov8(), {})
    (tmp_path / "text.onnx").write_text("no model")
    for file, options, message in (
        ("odd", {}, "layout="),
        ("yolov5", {}, "no layout"),
        ("nameless", {}, "names="),
        ("nameless", {"names": NAMES[:2]}, "3 classes, but 2 names"),
        ("nameless", {"names": NAMES, "input_size": (32, 32)}, "input_size"),
        ("none", {}, "does not exist"),
        ("text", {}, "not a valid ONNX file"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            OnnxDetector(tmp_path / f"{file}.onnx", **options)
    detector = OnnxDetector(nameless, names=NAMES)
    assert detector(FRAME).names == NAMES
    with pytest.raises(ValueError, match="frame is"):
        detector(FRAME.astype(np.float32))


def test_a_file_under_the_agpl_warns(tmp_path):
    output, metadata = FILES["yolov8"]
    path = save(tmp_path / "a.onnx", output, metadata | {"license": "AGPL-3.0 License"})
    with pytest.warns(UserWarning, match="AGPL"):
        OnnxDetector(path)


def test_a_half_precision_file_gets_half_precision_images(tmp_path, monkeypatch):
    path = save(tmp_path / "half.onnx", *FILES["yolov8"], kind=TensorProto.FLOAT16)
    monkeypatch.setenv("HOME", str(tmp_path))
    found = OnnxDetector("~/half.onnx")(FRAME)
    np.testing.assert_allclose(found.xyxy, WANTED - 0.5, atol=2e-3)
    save(path, *FILES["yolov8"], kind=TensorProto.UINT8)
    with pytest.raises(ValueError, match=r"takes tensor\(uint8\): give .* takes tensor\(float\)"):
        OnnxDetector(path)


def test_an_object_found_as_two_classes_keeps_the_better_one(tmp_path):
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


def test_a_detector_that_fails_on_a_frame_is_named(tmp_path):
    """Of another layout, or damaged where only running it shows."""
    path = save(tmp_path / "d.onnx", *FILES["fastestdet"])
    with pytest.raises(ValueError, match=rf"^{path} has .* classes, but 3 names: give names="):
        OnnxDetector(path, layout="yolox")
    detector = OnnxDetector(path)
    detector.input_name = "gone"
    with pytest.raises(ValueError, match=rf"^{path} is .*gone"):
        detector(FRAME)

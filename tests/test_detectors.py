"""Detectors: ONNX files of every layout, made here with known boxes, and the simple adapters."""

import json
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper, numpy_helper

from eldenet.boxes import Detections2D
from eldenet.perception.detectors import (
    COCO_NAMES,
    CallableDetector,
    Detector,
    FixedDetections,
    TorchvisionDetector,
    merge_cyclists,
    only,
    rename,
)
from eldenet.perception.letterbox import class_wise_nms, fit_picture, in_frame, one_class_each
from eldenet.perception.onnx_detector import OnnxDetector

SIZE = (64, 128)
ANCHORS = sum((SIZE[0] // s) * (SIZE[1] // s) for s in (8, 16, 32))
FRAME = np.zeros((128, 256, 3), np.uint8)  # twice the input: no padding whatever the letterbox
WANTED = np.array([[20.0, 10, 60, 50], [100, 30, 160, 100]])  # [px of the frame]
NAMES = ("cat", "dog", "cow")


def save(
    path: Path, output: np.ndarray, metadata: dict[str, str], size=SIZE, *,
    by_first_channel=False, kind=TensorProto.FLOAT,
) -> Path:  # fmt: skip
    """A graph that answers every picture with ``output``; 0 times the picture keeps it a function of it.

    ``by_first_channel``: with zeros, where the first channel is dark. ``kind``: of the picture's numbers.
    """
    constant = numpy_helper.from_array(output.astype(np.float32), "boxes")
    zero = numpy_helper.from_array(np.zeros(1, np.float32), "zero")
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        helper.make_node("Add", ["boxes", "nothing"], ["output"]),
    ]
    constants = [constant, zero]
    if by_first_channel:
        constants += [
            numpy_helper.from_array(np.array(value, kind), name)
            for name, value, kind in (("first", 0, np.int64), ("dark", 0.02, np.float32))
        ]
        nodes = [
            helper.make_node("Gather", ["images", "first"], ["channel"], axis=1),
            helper.make_node("ReduceMean", ["channel"], ["mean"], keepdims=0),
            helper.make_node("Greater", ["mean", "dark"], ["bright"]),
            helper.make_node("Cast", ["bright"], ["factor"], to=TensorProto.FLOAT),
            helper.make_node("Mul", ["boxes", "factor"], ["output"]),
        ]
    nodes[0].input[0] = "numbers"
    nodes.insert(0, helper.make_node("Cast", ["images"], ["numbers"], to=TensorProto.FLOAT))
    picture = helper.make_tensor_value_info("images", kind, [1, 3, *size])
    result = helper.make_tensor_value_info("output", TensorProto.FLOAT, list(output.shape))
    model = helper.make_model(
        helper.make_graph(nodes, "g", [picture], [result], constants),
        opset_imports=[helper.make_opsetid("", 13)],
        ir_version=8,
    )
    helper.set_model_props(model, metadata)
    onnx.save(model, path)
    return path


def yolov8(corners: bool = False) -> np.ndarray:
    out = np.zeros((1, 4 + len(NAMES), ANCHORS))
    boxes = WANTED / 2
    if not corners:
        boxes = np.concatenate([(boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]], 1)
    for place, (box, label) in enumerate(zip(boxes, (1, 2), strict=True)):
        out[0, :4, 7 + place], out[0, 4 + label, 7 + place] = box, 0.9 - 0.2 * place
        out[0, :4, 20 + place], out[0, 4 + label, 20 + place] = (
            box + 0.5,
            0.6 - 0.2 * place,
        )  # NMS's
    return out


def yolox() -> np.ndarray:
    out = np.full((1, ANCHORS, 5 + len(NAMES)), 0.0)
    first = {8: 0, 16: 128, 32: 160}
    for box, label, stride, score in zip(WANTED / 2, (1, 2), (8, 16), (0.9, 0.7), strict=True):
        center, wide = (box[:2] + box[2:]) / 2, box[2:] - box[:2]
        column, row = np.floor(center / stride).astype(int)
        place = first[stride] + row * (SIZE[1] // stride) + column
        out[0, place, :2] = center / stride - (column, row)
        out[0, place, 2:4] = np.log(wide / stride)
        out[0, place, 4], out[0, place, 5 + label] = 1.0, score
    return out


def fastestdet() -> np.ndarray:
    out = np.zeros((1, 5 + len(NAMES), 4, 8))
    for box, label, score in zip(WANTED / 2, (1, 2), (0.9, 0.7), strict=True):
        center, wide = (box[:2] + box[2:]) / 2, (box[2:] - box[:2]) / [SIZE[1], SIZE[0]]
        column, row = np.floor(center / 16).astype(int)
        out[0, 1:3, row, column] = np.arctanh(np.minimum(center / 16 - (column, row), 0.999))
        out[0, 3:5, row, column] = np.log(wide / (1 - wide))
        out[0, 0, row, column], out[0, 5 + label, row, column] = score, score
    return out


def finished() -> np.ndarray:
    out = np.zeros((1, 10, 6))
    out[0, :2] = [[*(WANTED[0] / 2), 0.9, 1], [*(WANTED[1] / 2), 0.7, 2]]
    return out


FILES = {
    "yolov8": (yolov8(), {"names": str(dict(enumerate(NAMES)))}),
    "yolov9": (yolov8(corners=True), {"names": json.dumps(NAMES), "letterbox_pad": "topleft"}),
    "yolox": (yolox(), {"names": json.dumps({str(i): n for i, n in enumerate(NAMES)})}),
    "fastestdet": (fastestdet(), {"names": str(list(NAMES))}),
    "nms": (finished(), {"names": str(list(NAMES))}),
}


@pytest.mark.parametrize("layout", sorted(FILES))
def test_every_layout_is_recognised_and_decoded(layout, tmp_path):
    detector = OnnxDetector(save(tmp_path / "d.onnx", *FILES[layout]))
    assert detector.layout_name == layout
    assert isinstance(detector, Detector)
    found = detector(FRAME)
    assert found.classes == ["dog", "cow"]
    # a frame of twice the input; detectors count from the corner, so pixel centres are at halves
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


@pytest.mark.parametrize("layout", sorted(FILES))
def test_every_layout_gets_its_order_of_colours(layout, tmp_path):
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


def test_a_detector_keeps_the_better_of_two_classes(tmp_path):
    output, metadata = FILES["yolov8"]
    twice = output.copy()
    twice[0, :4, 30] = output[0, :4, 7]  # the dog again, as a cat
    twice[0, 4, 30] = 0.5
    path = save(tmp_path / "twins.onnx", twice, metadata)
    assert OnnxDetector(path)(FRAME).classes == ["dog", "cow"]
    assert sorted(OnnxDetector(path, between_classes=1.0)(FRAME).classes) == ["cat", "cow", "dog"]
    assert OnnxDetector(path, keep=["cat", "cow"])(FRAME).classes == ["cow"]  # the dog does not become a cat


def test_the_simple_adapters():
    known = Detections2D(WANTED, np.ones(2), np.array([0, 1]), ("car", "dog"))
    fixed = FixedDetections([known])
    assert fixed(FRAME) is known
    with pytest.raises(ValueError, match="more frames"):
        fixed(FRAME)
    called = CallableDetector(lambda frame: (WANTED.tolist(), [0.5, 0.6], [0, 1]), ("car", "dog"))(FRAME)
    np.testing.assert_array_equal(called.xyxy, WANTED - 0.5)
    assert only(called, ["Dog"]).classes == ["dog"]
    assert rename(called, {"dog": "hound"}).classes == ["car", "hound"]


def test_torchvision_networks_are_taken():
    from torchvision.models.detection import ssdlite320_mobilenet_v3_large

    model = ssdlite320_mobilenet_v3_large(weights=None, weights_backbone=None, num_classes=3)
    found = TorchvisionDetector(model, ("nothing", "car", "dog"), threshold=0.0)(FRAME)
    assert set(found.classes) <= {"car", "dog"}
    assert (found.xyxy >= -0.5).all()


def test_a_torchvision_network_sees_its_own_precision():
    from torchvision.models.detection import ssdlite320_mobilenet_v3_large

    torch.manual_seed(0)
    model = ssdlite320_mobilenet_v3_large(weights=None, weights_backbone=None, num_classes=3)
    detector = TorchvisionDetector(model, ("nothing", "car", "dog"), threshold=0.0)
    single = detector(FRAME)
    model.double()
    double = detector(FRAME)
    assert len(double) > 0
    assert (double.xyxy.dtype, double.score.dtype) == (single.xyxy.dtype, single.score.dtype)


def test_a_torchvision_network_may_answer_in_bfloat16():
    class Halved(torch.nn.Module):
        """The interface; torchvision's own networks have no such arithmetic on a CPU."""

        def __init__(self):
            super().__init__()
            self.layer = torch.nn.Conv2d(3, 1, 1, dtype=torch.bfloat16)

        def forward(self, images):
            (image,) = images
            assert self.layer(image).shape == (1, *FRAME.shape[:2])
            boxes = torch.from_numpy(WANTED).to(image)
            score = torch.tensor([0.5, 0.25]).to(image)
            return [{"boxes": boxes, "scores": score, "labels": torch.tensor([1, 2]), "masks": None}]

    found = TorchvisionDetector(Halved(), ("nothing", "car", "dog"))(FRAME)
    np.testing.assert_array_equal(found.xyxy, WANTED[:1] - 0.5)
    assert (found.classes, found.score.tolist()) == (["car"], [0.5])


def test_a_person_on_a_bicycle_is_a_cyclist():
    names = ("person", "bicycle", "car")
    xyxy = np.array([[10, 10, 30, 60], [5, 35, 40, 75], [80, 10, 95, 60], [100, 0, 150, 50.0]])
    found = merge_cyclists(Detections2D(xyxy, np.ones(4), np.array([0, 1, 0, 2]), names))
    assert found.classes == ["cyclist", "person", "car"]
    np.testing.assert_array_equal(found.xyxy[0], [5, 10, 40, 75])


def test_a_cyclists_mask_is_the_riders_and_the_bicycles():
    mask = np.zeros((2, 80, 50), bool)
    mask[0, 10:60, 10:30], mask[1, 40:75, 5:40] = True, True
    boxes = np.array([[9.5, 9.5, 29.5, 59.5], [4.5, 39.5, 39.5, 74.5]])
    pair = Detections2D(boxes, np.ones(2), np.array([0, 1]), ("person", "bicycle"), mask=mask)
    found = merge_cyclists(pair)
    assert found.classes == ["cyclist"]
    np.testing.assert_array_equal(found.mask, mask.any(0, keepdims=True))
    assert mask[0].sum() == 1000  # the detector's own are left as they were


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

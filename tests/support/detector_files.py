"""ONNX files of every detector layout with known boxes, and a frame for them."""

import json
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

SIZE = (64, 128)
ANCHORS = sum((SIZE[0] // s) * (SIZE[1] // s) for s in (8, 16, 32))
FRAME = np.zeros((128, 256, 3), np.uint8)  # twice the input: no padding whatever the letterbox
WANTED = np.array([[20.0, 10, 60, 50], [100, 30, 160, 100]])  # [px of the frame]
NAMES = ("cat", "dog", "cow")


def save(
    path: Path, output: np.ndarray, metadata: dict[str, str], size=SIZE, *,
    by_first_channel=False, kind=TensorProto.FLOAT,
) -> Path:  # fmt: skip
    """Save a graph that returns ``output`` for every image.

    ``by_first_channel``: it returns zeros if the first channel is dark. ``kind``: data type of the image.
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
        out[0, :4, 20 + place], out[0, 4 + label, 20 + place] = box + 0.5, 0.6 - 0.2 * place  # for NMS
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

"""Detectors as ONNX files, run by ONNX Runtime: YOLOv8-style and YOLOv9 exports, YOLOX, FastestDet.

Only the graph in the file is executed. The layouts follow the exporters' documentation; the decoding is our
own.
"""

import ast
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eldenet.boxes import BoxStyle, Detections2D
from eldenet.deploy.predictor import check_frame
from eldenet.perception.detectors import COCO_NAMES
from eldenet.perception.postprocess import fit_image, select_boxes
from eldenet.system.checks import one_of
from eldenet.system.errors import reading, some_of
from eldenet.system.onnx_files import open_session

_STRIDES = (8, 16, 32)
_INPUTS = {"tensor(float)": np.float32, "tensor(float16)": np.float16}  # half=True of many exporters


class Layout(NamedTuple):
    """Input and output format of a family of exports.

    Attributes:
        letterbox: "topleft" or "center" (aspect ratio kept, padded), or "stretch".
        bgr: the color order of the input is BGR.
        scale: factor on 0-255.
        decode: output ``(...)`` and input ``(height, width)`` -> xyxy ``(N, 4)`` [input px], scores
            ``(N, classes)``.
    """

    letterbox: str
    bgr: bool
    scale: float
    decode: Callable[[np.ndarray, tuple[int, int]], tuple[np.ndarray, np.ndarray]]


def _center_to_corners(boxes: np.ndarray) -> np.ndarray:
    """Convert cx, cy, w, h ``(N, 4)`` to xyxy ``(N, 4)``."""
    center, half = boxes[:, :2], boxes[:, 2:] / 2
    return np.concatenate([center - half, center + half], axis=1)


def _yolox(output: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """``(1, N, 5 + classes)``: offsets in grid cells, log sizes, objectness."""
    cells, strides = [], []
    for stride in _STRIDES:
        rows, columns = np.indices((size[0] // stride, size[1] // stride))
        cells.append(np.stack([columns.ravel(), rows.ravel()], axis=1))
        strides.append(np.full((rows.size, 1), stride))
    grid, step = np.concatenate(cells), np.concatenate(strides)
    raw = output[0].astype(np.float64)
    boxes = np.concatenate([(raw[:, :2] + grid) * step, np.exp(np.minimum(raw[:, 2:4], 20)) * step], axis=1)
    return _center_to_corners(boxes), raw[:, 4:5] * raw[:, 5:]


def _yolov8(output: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """``(1, 4 + classes, N)``: cx, cy, w, h in pixels."""
    raw = output[0].T.astype(np.float64)
    return _center_to_corners(raw[:, :4]), raw[:, 4:]


def _yolov9(output: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """``(1, 4 + classes, N)``: xyxy in pixels."""
    raw = output[0].T.astype(np.float64)
    return raw[:, :4], raw[:, 4:]


def _fastestdet(output: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """``(1, 5 + classes, h, w)``: objectness, offset (tanh), size (sigmoid), classes, per cell."""
    raw = output[0].astype(np.float64)
    _, height, width = raw.shape
    rows, columns = np.indices((height, width))
    x, y = (columns + np.tanh(raw[1])) / width * size[1], (rows + np.tanh(raw[2])) / height * size[0]
    wide, tall = (1 / (1 + np.exp(-raw[k])) * side for k, side in ((3, size[1]), (4, size[0])))
    boxes = np.stack([x, y, wide, tall], axis=-1).reshape(-1, 4)
    score = np.maximum(raw[0], 0) ** 0.6 * np.maximum(raw[5:], 0) ** 0.4
    return _center_to_corners(boxes), score.reshape(len(score), -1).T


def _with_nms(output: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """``(1, K, 6)``: xyxy, score, class; the graph includes NMS."""
    raw = output[0].astype(np.float64)
    score = np.zeros((len(raw), int(raw[:, 5].max(initial=0)) + 1))
    score[np.arange(len(raw)), raw[:, 5].astype(int)] = raw[:, 4]
    return raw[:, :4], score


LAYOUTS = {
    "yolov8": Layout("center", False, 1 / 255, _yolov8),
    "yolov9": Layout("topleft", False, 1 / 255, _yolov9),
    "yolox": Layout("topleft", True, 1.0, _yolox),
    "fastestdet": Layout("stretch", True, 1 / 255, _fastestdet),
    "nms": Layout("center", False, 1 / 255, _with_nms),
}


class OnnxDetector:
    """A detector from an ONNX file.

    Layouts: "yolov8" (also the original YOLOv9's export: center boxes, padded on all sides), "yolov9"
    (libreyolo's: corner boxes, padded right and below), "yolox", "fastestdet", "nms" (NMS in the graph).
    "auto" chooses by the output's shape and the file's metadata.

    Args:
        letterbox: "topleft", "center" or "stretch"; None: the file's ``letterbox_pad``, or the layout's.
        names: of the classes; None: the file's, else COCO's if there are 80 or their number is unknown.
        input_size: ``(height, width)`` [px]; needed if the file leaves it open; None: the file's.
        threshold: detections below this score are dropped.
        nms: IoU above which the worse of two boxes of a class is dropped.
        between_classes: the same for two boxes of different classes; 1: keep both.
        keep: names of the classes to keep; None: all.
        box_style: how its boxes enclose objects.
        threads: of ONNX Runtime; 0: its own choice.
        providers: of ONNX Runtime, in order of preference; the first one that is installed must run.

    Raises:
        FileNotFoundError: the file does not exist.
        ImportError: ONNX Runtime is not installed.
        ValueError: not an ONNX file, an unknown layout, a number out of range, or no provider is available or
            starts.

    Warns:
        UserWarning: another provider than the first one runs; or the file is under the AGPL.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        layout: str = "auto",
        letterbox: str | None = None,
        names: Sequence[str] | None = None,
        input_size: tuple[int, int] | None = None,
        threshold: float = 0.3,
        nms: float = 0.5,
        between_classes: float = 0.85,
        keep: Sequence[str] | None = None,
        box_style: BoxStyle = "tight",
        threads: int = 1,
        providers: Sequence[str] = ("CPUExecutionProvider",),
    ) -> None:
        one_of("layout", layout, ("auto", *LAYOUTS))
        for name, share in (("threshold", threshold), ("nms", nms), ("between_classes", between_classes)):
            if not 0 <= share <= 1:
                raise ValueError(f"{name}={share}: give a share from 0 to 1, such as 0.5")
        self.path = path = Path(path).expanduser()
        self.session = open_session(path, providers, threads=threads)
        metadata = self.session.get_modelmeta().custom_metadata_map
        _warn_of_license(path, metadata)
        node = self.session.get_inputs()[0]
        if node.type not in _INPUTS:
            raise ValueError(f"{path} takes {node.type}: give a detector that takes {' or '.join(_INPUTS)}")
        self.input_name, self.input_type = node.name, _INPUTS[node.type]
        self.input_size = _input_size(node.shape, input_size, path)
        self.layout_name = self._detect_layout(path, metadata) if layout == "auto" else layout
        self.layout = LAYOUTS[self.layout_name]
        self.letterbox = letterbox or metadata.get("letterbox_pad") or self.layout.letterbox
        one_of("letterbox", self.letterbox, ("topleft", "center", "stretch"))
        self.names = self._names(names, metadata, path)
        self.threshold, self.nms, self.between_classes = threshold, nms, between_classes
        self.keep, self.box_style = keep, box_style
        unknown = sorted(set(keep or ()) - set(self.names))
        if unknown:
            raise ValueError(
                f"keep: {path} has no {some_of(unknown, 3)}, only {', '.join(map(str, self.names))}"
            )

    def __call__(self, frame: np.ndarray) -> Detections2D:
        """Find objects in ``(H, W, 3)`` uint8 RGB."""
        check_frame(frame)
        fitted, placement = fit_image(frame, self.input_size, self.letterbox)
        if self.layout.bgr:
            fitted = fitted[..., ::-1]
        tensor = np.ascontiguousarray(fitted.transpose(2, 0, 1)[None], np.float32)
        tensor *= np.float32(self.layout.scale)
        inputs = {self.input_name: tensor.astype(self.input_type, copy=False)}
        with reading(self.path, f"detector of layout {self.layout_name}", "export it again, or give layout="):
            xyxy, score = self.layout.decode(self.session.run(None, inputs)[0], self.input_size)
        wanted = None if self.keep is None else [self.names.index(name) for name in self.keep]
        xyxy, best, label = select_boxes(
            xyxy, score, placement, threshold=self.threshold, nms=self.nms,
            between_classes=self.between_classes, keep=wanted,
        )  # fmt: skip
        return Detections2D(xyxy, best, label, self.names, self.box_style)

    def _detect_layout(self, path: Path, metadata: dict[str, str]) -> str:
        """Layout by the shape of the first output."""
        output = self.session.get_outputs()[0].shape
        shape = [side if isinstance(side, int) else None for side in output]
        height, width = self.input_size
        anchors = sum((height // stride) * (width // stride) for stride in _STRIDES)
        if len(shape) == 4 and shape[2:] == [height // 16, width // 16]:
            return "fastestdet"
        if len(shape) == 3:
            if shape[2] == 6 and shape[1] not in (anchors, 3 * anchors):  # three a cell: YOLOv5 of one class
                return "nms"
            if shape[1] == anchors and (shape[2] or 0) > 5:
                return "yolox"
            if shape[2] == anchors or (shape[2] is None and (shape[1] or 0) > 4):
                return "yolov9" if metadata.get("letterbox_pad") == "topleft" else "yolov8"
        raise ValueError(
            f"{path}: no layout has an output of {output} for an input of {height} x {width}: give layout=, "
            f"one of {', '.join(LAYOUTS)}"
        )

    def _names(self, names: Sequence[str] | None, metadata: dict[str, str], path: Path) -> tuple[str, ...]:
        shape = self.session.get_outputs()[0].shape
        channels = {"yolox": (2, 5), "yolov8": (1, 4), "yolov9": (1, 4), "fastestdet": (1, 5)}
        axis, extra = channels.get(self.layout_name, (0, 0))
        count = shape[axis] - extra if extra and isinstance(shape[axis], int) else None
        found = tuple(names) if names is not None else _names_in(metadata)
        if found is None and count in (None, len(COCO_NAMES)):
            found = COCO_NAMES
        if found is None:
            raise ValueError(f"{path} does not name its {count} classes: give names=[...]")
        if count is not None and len(found) != count:
            raise ValueError(f"{path} has {count} classes, but {len(found)} names: give names=[...] for all")
        return found


def _input_size(shape: list[Any], wanted: tuple[int, int] | None, path: Path) -> tuple[int, int]:
    fixed = all(isinstance(side, int) for side in shape[2:])
    if wanted is None and not fixed:
        raise ValueError(f"{path} leaves its input size open: give input_size=[height, width]")
    height, width = wanted or shape[2:]
    if fixed and [height, width] != shape[2:]:
        raise ValueError(f"input_size={[height, width]}, but {path} has a fixed input of {shape[2:]}")
    return int(height), int(width)


def _names_in(metadata: dict[str, str]) -> tuple[str, ...] | None:
    """Class names as exporters store them: JSON or a Python literal, a list or a dict by number."""
    try:
        stored = ast.literal_eval(metadata.get("names", ""))  # reads such JSON too
    except (ValueError, SyntaxError):
        return None
    if isinstance(stored, dict):
        stored = [stored[key] for key in sorted(stored, key=int)]
    return tuple(str(name) for name in stored)


def _warn_of_license(path: Path, metadata: dict[str, str]) -> None:
    text = " ".join(metadata.values())
    if "AGPL" in text or "GPL" in metadata.get("license", ""):
        warnings.warn(
            f"{path} is under {metadata.get('license', 'the AGPL')}, whose terms may extend to software and "
            "networks that use it",
            stacklevel=3,
        )

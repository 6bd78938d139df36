"""The detector protocol, and simple adapters to it."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eldenet.boxes import BoxStyle, Detections2D
from eldenet.deploy.predictor import check_frame
from eldenet.geometry import from_corner
from eldenet.perception.iou import iou_2d
from eldenet.system.errors import some_of

COCO_NAMES = (
    "person", "bicycle", "car", "motorcycle", "airplane", "bus", "train", "truck", "boat",
    "traffic light", "fire hydrant", "stop sign", "parking meter", "bench", "bird", "cat", "dog",
    "horse", "sheep", "cow", "elephant", "bear", "zebra", "giraffe", "backpack", "umbrella", "handbag",
    "tie", "suitcase", "frisbee", "skis", "snowboard", "sports ball", "kite", "baseball bat",
    "baseball glove", "skateboard", "surfboard", "tennis racket", "bottle", "wine glass", "cup",
    "fork", "knife", "spoon", "bowl", "banana", "apple", "sandwich", "orange", "broccoli", "carrot",
    "hot dog", "pizza", "donut", "cake", "chair", "couch", "potted plant", "bed", "dining table",
    "toilet", "tv", "laptop", "mouse", "remote", "keyboard", "cell phone", "microwave", "oven",
    "toaster", "sink", "refrigerator", "book", "clock", "vase", "scissors", "teddy bear", "hair drier",
    "toothbrush",
)  # fmt: skip
ROAD_NAMES = ("person", "bicycle", "car", "motorcycle", "bus", "truck")  # those of COCO in traffic


@runtime_checkable
class Detector(Protocol):
    """``frame (H, W, 3)`` uint8 RGB -> :class:`~eldenet.boxes.Detections2D` in pixels of that frame."""

    def __call__(self, frame: np.ndarray) -> Detections2D:
        """Find objects in ``(H, W, 3)`` uint8 RGB."""
        ...


class FixedDetections:
    """Known detections (labels, a simulator, a file), one per call, in order.

    Args:
        detections: of the frames, in the order of the calls.
    """

    def __init__(self, detections: Iterable[Detections2D]) -> None:
        self._remaining = iter(detections)

    def __call__(self, frame: np.ndarray) -> Detections2D:
        """The detections of the next frame ``(H, W, 3)``; StopIteration where none are left."""
        return next(self._remaining)


class CallableDetector:
    """Any function as a detector.

    Args:
        function: frame -> ``(xyxy (N, 4), score (N,), label (N,))``, as arrays or lists; boxes counted from
            the image corner (the first pixel reaches from 0 to 1), as most detectors do; labels are classes'
            names, or their places in ``names``.
        names: of all classes.
        box_style: how its boxes enclose objects.
    """

    def __init__(
        self,
        function: Callable[[np.ndarray], tuple[Any, Any, Any]],
        names: tuple[str, ...],
        box_style: BoxStyle = "tight",
    ) -> None:
        self.function, self.names, self.box_style = function, tuple(names), box_style

    def __call__(self, frame: np.ndarray) -> Detections2D:
        """Find objects in ``(H, W, 3)`` uint8 RGB; ValueError for another answer, or a label without name."""
        found = self.function(frame)
        if not isinstance(found, list | tuple) or len(found) != 3:
            parts = f" of {len(found)}" if isinstance(found, list | tuple) else ""
            raise ValueError(
                f"the detector returned a {type(found).__name__}{parts}: return three arrays, boxes (N, 4), "
                "scores (N,), labels (N,)"
            )
        xyxy, score, label = (np.asarray(part) for part in found)
        if any(isinstance(one, str) for one in label.flat):
            if unknown := sorted({*map(str, label.flat)} - {*self.names}):
                raise ValueError(f"labels {some_of(unknown, 3)} are not in names: name every class")
            label = np.array([self.names.index(name) for name in label.flat])
        if xyxy.size != 4 * score.size or label.size != score.size:
            raise ValueError(
                f"the detector returned shapes {xyxy.shape}, {score.shape}, {label.shape}: return boxes "
                "(N, 4), scores (N,), labels (N,), in this order"
            )
        if label.size and not (np.all(label == np.rint(label)) and np.all((score >= 0) & (score <= 1))):
            raise ValueError(
                f"the detector returned scores {_span(score)} and labels {_span(label)}: return boxes, "
                "scores from 0 to 1, labels as whole numbers or names, in this order"
            )
        return Detections2D(
            from_corner(xyxy.reshape(-1, 4)),
            score.reshape(-1),
            label.reshape(-1).astype(np.int64),
            self.names,
            self.box_style,
        )


def _span(values: np.ndarray) -> str:
    return f"{values.min():g} to {values.max():g}"


class TorchvisionDetector:
    """A detection network of torchvision, or one with the same interface.

    Frames are converted to the device and precision of the model's parameters at each call.

    Args:
        model: ``images -> [{"boxes", "scores", "labels"}]``, such as
            ``torchvision.models.detection.ssdlite320_mobilenet_v3_large(weights="DEFAULT")``; it is put into
            eval mode.
        names: of the classes, such as ``weights.meta["categories"]`` of torchvision's weights.
        threshold: detections below this score are dropped.
        box_style: how its boxes enclose objects.
    """

    def __init__(
        self, model: Any, names: tuple[str, ...], *, threshold: float = 0.3, box_style: BoxStyle = "tight"
    ) -> None:
        self.model, self.names = model.eval(), tuple(names)
        self.threshold, self.box_style = threshold, box_style

    def __call__(self, frame: np.ndarray) -> Detections2D:
        """Find objects in ``(H, W, 3)`` uint8 RGB."""
        import torch

        check_frame(frame)
        weight = next((part for part in self.model.parameters() if part.is_floating_point()), torch.empty(0))
        image = torch.from_numpy(np.ascontiguousarray(frame.transpose(2, 0, 1)))
        with torch.inference_mode():
            found = self.model([(image.to(weight.device).float() / 255).to(weight.dtype)])[0]
        # only what is used: masks are large; and as float32, for NumPy has no bfloat16
        boxes, score = (found[name].float().cpu().numpy() for name in ("boxes", "scores"))
        label = found["labels"].cpu().numpy().astype(np.int64)
        kept = score >= self.threshold
        return Detections2D(from_corner(boxes[kept]), score[kept], label[kept], self.names, self.box_style)


def merge_cyclists(detections: Detections2D) -> Detections2D:
    """Turn each person on a bicycle into one "cyclist": KITTI counts them as one object, COCO as two.

    The boxes must overlap by a fifth of the smaller one, and the person's feet must be above the bicycle's
    lower edge, or near it.
    """
    names = detections.names if "cyclist" in detections.names else (*detections.names, "cyclist")
    classes, xyxy = detections.classes, np.array(detections.xyxy, np.float64)
    label, kept = detections.label.copy(), np.ones(len(detections), bool)
    mask = None if detections.mask is None else detections.mask.copy()
    covered = iou_2d(xyxy, xyxy, of_first=True)
    riders = [i for i, name in enumerate(classes) if name == "person"]
    for bicycle in (i for i, name in enumerate(classes) if name == "bicycle"):
        best, most = None, 0.2
        for person in riders:
            share = max(covered[bicycle, person], covered[person, bicycle])  # of the smaller one
            tall = xyxy[person, 3] - xyxy[person, 1]
            if share > most and xyxy[person, 3] < xyxy[bicycle, 3] + 0.1 * tall:
                best, most = person, share
        if best is not None:
            riders.remove(best)
            kept[best] = False
            xyxy[bicycle, :2] = np.minimum(xyxy[bicycle, :2], xyxy[best, :2])
            xyxy[bicycle, 2:] = np.maximum(xyxy[bicycle, 2:], xyxy[best, 2:])
            label[bicycle] = names.index("cyclist")
            if mask is not None:
                mask[bicycle] |= mask[best]
    return replace(detections, xyxy=xyxy, label=label, names=names, mask=mask).select(kept)

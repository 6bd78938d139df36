"""Draw boxes: into the image, and in a bird's-eye view with a grid in meters."""

from collections.abc import Sequence

import cv2
import numpy as np

from eldenet.boxes import FRONT_FACE, NEAR, Boxes3D, Detections2D, clipped_edges
from eldenet.geometry import PinholeCamera
from eldenet.perception.iou import footprints

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_COLOR_OF = {
    "car": (255, 120, 60), "van": (255, 190, 60), "truck": (190, 120, 255), "person": (80, 200, 255),
    "pedestrian": (80, 200, 255), "cyclist": (120, 230, 110), "bicycle": (120, 230, 110),
    "bus": (255, 110, 190), "box": (170, 220, 80), "pillar": (60, 220, 200), "motorcycle": (90, 150, 255),
}  # fmt: skip
_PATCH = (20, 20, 20)  # behind a label
_ROWS = 4  # lines that a label may move up
_MARGIN = 6  # of a bird's-eye view, above and below [px]
_GROUND, _GRID, _FIELD_OF_VIEW, _INK = (250, 250, 250), (222, 222, 222), (238, 243, 250), (90, 90, 90)


def color_of(name: str) -> tuple[int, int, int]:
    """The RGB color of a class, the same in every image."""
    colors = list(_COLOR_OF.values())
    number = sum(ord(letter) * (place + 1) for place, letter in enumerate(name.lower()))
    return _COLOR_OF.get(name.lower(), colors[number % len(colors)])


def draw_boxes(
    image: np.ndarray,
    boxes: Boxes3D,
    camera: PinholeCamera,
    *,
    front: bool | np.ndarray = False,
    labels: bool = True,
) -> np.ndarray:
    """Draw the edges of every box, dashed if it is doubtful, on a copy of ``image (H, W, 3)`` uint8 RGB.

    Args:
        boxes: in the camera's level frame.
        front: shade the front face of all boxes, or of those chosen ``(N,)``: for boxes whose front is known.
        labels: write class and distance [m] above each box, with its interval if it has one, and a question
            mark if it is doubtful. Where labels would overlap, those of distant boxes move up or go.
    """
    picture = np.ascontiguousarray(image).copy()
    thick = max(1, round(image.shape[0] / 300))
    front = np.broadcast_to(front, len(boxes))
    texts = []
    for index in np.argsort(-np.linalg.norm(boxes.center, axis=1)):  # distant boxes first
        corners = camera.to_camera(boxes.corners[index])
        color = color_of(boxes.names[boxes.label[index]])
        if front[index] and (corners[list(FRONT_FACE), 2] > NEAR).all():
            face = _pixels(corners[list(FRONT_FACE)], camera)
            shade = picture.copy()
            cv2.fillPoly(shade, [_fixed(face)], color, cv2.LINE_AA, 4)
            picture = cv2.addWeighted(shade, 0.35, picture, 0.65, 0)
        edges = clipped_edges(corners)
        if not len(edges):
            continue
        for ends in edges:
            _line(picture, _pixels(ends, camera), color, thick, dashed=bool(boxes.doubtful[index]))
        if labels:
            pixels = _pixels(edges.reshape(-1, 3), camera)
            box = boxes[int(index)]
            text = f"{box.name} {box.distance:.1f} m"
            if box.interval is not None:
                text += " ({:.1f}-{:.1f})".format(*box.interval)
            if boxes.doubtful[index]:
                text += " ?"
            if boxes.track_id is not None:
                text = f"#{boxes.track_id[index]} {text}"
            texts.append((text, pixels[:, 0].min(), pixels[:, 1].min(), color))
    _write_all(picture, texts[::-1])
    return picture


def draw_detections(image: np.ndarray, detections: Detections2D) -> np.ndarray:
    """Draw 2D boxes, classes and scores on a copy of ``image (H, W, 3)`` uint8 RGB."""
    picture, texts = np.ascontiguousarray(image).copy(), []
    for box, score, name in zip(detections.xyxy, detections.score, detections.classes, strict=True):
        color = color_of(name)
        # the outermost pixels inside the box and the image
        last = np.array([picture.shape[1] - 1, picture.shape[0] - 1])
        left, top = np.clip(np.ceil(box[:2]), 0, last).astype(int).tolist()
        right, bottom = np.clip(np.floor(box[2:]), 0, last).astype(int).tolist()
        cv2.rectangle(picture, (left, top), (right, bottom), color, 1)
        texts.append((f"{name} {score:.2f}", left, top, color))
    _write_all(picture, texts)
    return picture


def draw_bev(
    boxes: Boxes3D,
    camera: PinholeCamera,
    width: int,
    *,
    size: tuple[int, int] = (400, 300),
    reach: float | None = None,
    truth: Boxes3D | None = None,
) -> np.ndarray:
    """Draw a bird's-eye view ``(*size, 3)`` uint8: the camera at the bottom, boxes, a grid in round meters.

    Args:
        boxes: in the level frame; doubtful ones are dashed, tracked ones get an arrow to where they are in a
            second.
        camera: its field of view is shaded.
        width: of the camera's image [px]; for the field of view.
        size: (height, width) of the view [px].
        reach: depth at the upper edge [m]; None: as far as the boxes reach, 10 to 120 m.
        truth: other boxes, drawn in gray.
    """
    height, wide = size
    reach = bev_reach(boxes, size) if reach is None else reach
    scale = (height - 2 * _MARGIN) / reach  # [px/m]
    panel = np.full((height, wide, 3), _GROUND, np.uint8)

    def place(points: np.ndarray) -> np.ndarray:
        """Pixels ``(..., 2)`` of ground points ``(..., 2)`` x, z [m]."""
        x, z = points[..., 0], points[..., 1]
        return np.stack([wide / 2 + x * scale, height - _MARGIN - z * scale], axis=-1)

    sides = camera.homography @ np.array([[0, width - 1], [0, 0], [1, 1.0]])
    ends = (sides[[0, 2]] / sides[2]).T * reach * 1.5
    view = place(np.concatenate([[[0.0, 0.0]], ends]))
    cv2.fillPoly(panel, [_fixed(view)], _FIELD_OF_VIEW, cv2.LINE_AA, 4)
    step = next((value for value in (1, 2, 5, 10, 20) if reach / value <= 8), 50)
    for z in np.arange(0, reach, step):
        row = round(height - _MARGIN - z * scale)
        cv2.line(panel, (0, row), (wide, row), _GRID, 1)
    side = wide / 2 / scale
    for x in np.arange(-np.floor(side / step) * step, side, step):
        column = round(wide / 2 + x * scale)
        cv2.line(panel, (column, 0), (column, height), _GRID, 1)
    for z in np.arange(step, reach - 12 / scale, step):  # a number below the upper edge
        corner = (3, round(height - _MARGIN - z * scale) - 2)
        cv2.putText(panel, f"{z:g} m", corner, _FONT, 0.35, _INK, 1, cv2.LINE_AA)
    if truth is not None:
        for corners in footprints(truth.bev):
            cv2.polylines(panel, [_fixed(place(corners))], True, (150, 150, 150), 2, cv2.LINE_AA, 4)
    for index, corners in enumerate(footprints(boxes.bev)):
        color = tuple(int(0.75 * part) for part in color_of(boxes.names[boxes.label[index]]))
        for ends in zip(place(corners), place(np.roll(corners, -1, axis=0)), strict=True):
            _line(panel, np.stack(ends), color, 2, dashed=bool(boxes.doubtful[index]))
        if boxes.velocity is not None:
            ends = boxes.center[index, [0, 2]] + np.array([[0, 0], boxes.velocity[index, [0, 2]]])
            start, end = place(ends).round().astype(int)
            cv2.arrowedLine(panel, start.tolist(), end.tolist(), color, 1, cv2.LINE_AA, tipLength=0.25)
    eye = place(np.array([[-0.5, 0], [0.5, 0], [0, 1.2]]) * max(1.0, reach / 40))
    cv2.fillPoly(panel, [_fixed(eye)], _INK, cv2.LINE_AA, 4)
    return panel


def bev_reach(boxes: Boxes3D, size: tuple[int, int]) -> float:
    """Depth [m] at the upper edge of a bird's-eye view of ``size`` that shows the boxes: 10 to 120 m."""
    height, wide = size
    aside = np.abs(boxes.center[:, 0]) * 2 * height / wide  # reach of a view that is wide enough for x
    farthest = float(max(boxes.center[:, 2].max(), aside.max())) if len(boxes) else 10.0
    return float(np.clip(farthest * 1.12 + 2, 10.0, 120.0))


def picture_beside_bev(picture: np.ndarray, panel: np.ndarray) -> np.ndarray:
    """Join two pictures ``(h, w, 3)`` uint8, resized to one height; the result has even sides."""
    tall = max(picture.shape[0], panel.shape[0])
    parts = [
        np.asarray(cv2.resize(part, (round(part.shape[1] * tall / part.shape[0]), tall)), np.uint8)
        for part in (picture, panel)
    ]
    row = np.concatenate([parts[0], np.full((tall, 4, 3), 255, np.uint8), parts[1]], axis=1)
    return np.pad(row, ((0, row.shape[0] % 2), (0, row.shape[1] % 2), (0, 0)), constant_values=255)


def _pixels(points: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Pixels ``(K, 2)`` of camera points ``(K, 3)`` in front, clipped to what OpenCV can draw."""
    pixels = (points / points[:, 2:]) @ camera.intrinsics.T
    return np.asarray(np.clip(pixels[:, :2], -20000, 20000))


def _line(
    picture: np.ndarray, ends: np.ndarray, color: tuple[int, ...], thick: int, *, dashed: bool = False
) -> None:
    """Draw a line between the pixels ``ends (2, 2)``; a dashed one has five dashes."""
    shares = np.arange(0, 9, 2)[:, None] / 9 if dashed else np.zeros((1, 1))
    step = (ends[1] - ends[0]) * (1 / 9 if dashed else 1)
    for start in ends[0] + shares * (ends[1] - ends[0]):
        first, last = _fixed(np.stack([start, start + step]))
        cv2.line(picture, first.tolist(), last.tolist(), color, thick, cv2.LINE_AA, 4)


def _fixed(points: np.ndarray) -> np.ndarray:
    """Pixels ``(..., 2)`` in sixteenths, for OpenCV's ``shift=4``."""
    return np.asarray(np.round(np.clip(points, -20000, 20000) * 16), np.int32)


def _write_all(picture: np.ndarray, texts: Sequence[tuple[str, float, float, tuple[int, int, int]]]) -> None:
    """Write texts ``(text, left, top, color)`` on dark patches of ``(H, W, 3)`` uint8, in place.

    The first ones stay where they belong; others move up by at most ``_ROWS`` lines, or are left out.
    """
    size = max(0.35, picture.shape[0] / 900)
    taken = np.zeros(picture.shape[:2], bool)
    for text, left, top, color in texts:
        (wide, tall), _ = cv2.getTextSize(text, _FONT, size, 1)
        x = int(np.clip(left, 0, max(0, picture.shape[1] - wide - 2)))
        lowest = int(np.clip(top - 3, tall + 2, picture.shape[0] - 2))
        for y in range(lowest, max(tall + 1, lowest - _ROWS * (tall + 5)), -1):
            patch = (slice(y - tall - 2, y + 3), slice(x, x + wide + 3))
            if not taken[patch].any():
                picture[patch] = _PATCH
                cv2.putText(picture, text, (x + 1, y), _FONT, size, color, 1, cv2.LINE_AA)
                taken[patch] = True
                break

"""Depth for people: a photo beside its depth in colours, and a scale that says which colour is how far."""

import cv2
import numpy as np

from eldenet.pictures import colour_depth

SMALLEST_HEIGHT = 240  # [px]: below that, the numbers of the scale could not be read
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def visible_range(depth: np.ndarray) -> tuple[float, float]:
    """Nearest and farthest depth [m] worth a colour: the 2nd and 98th percentile of what is known."""
    known = depth[np.isfinite(depth) & (depth > 0)]
    if not known.size:
        return 0.0, 1.0
    near, far = (float(value) for value in np.percentile(known, (2, 98)))
    return near, max(far, near + 0.05)


def photo_beside_depth(photo: np.ndarray, depth: np.ndarray, near: float, far: float) -> np.ndarray:
    """One picture ``(h, w, 3)`` uint8 RGB: photo, coloured depth, scale in metres.

    Args:
        photo: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` [m]; unknown (0 or not finite) is black.
        near: depth of the warm end [m].
        far: depth of the cool end [m].

    The picture is ``H`` high (small photos are enlarged by a whole factor to 240 pixels or more), and its
    height and width are even, as video codecs want them.
    """
    known = np.isfinite(depth) & (depth > 0)
    panels = [photo, colour_depth(depth, near, far, known)]
    factor = -(-SMALLEST_HEIGHT // photo.shape[0]) if photo.shape[0] < SMALLEST_HEIGHT else 1
    if factor > 1:
        panels = [np.repeat(np.repeat(panel, factor, axis=0), factor, axis=1) for panel in panels]
    height = panels[0].shape[0]
    gap = np.full((height, 4, 3), 255, np.uint8)
    row = np.concatenate([panels[0], gap, panels[1], gap, depth_scale(near, far, height)], axis=1)
    return np.pad(row, ((0, row.shape[0] % 2), (0, row.shape[1] % 2), (0, 0)), constant_values=255)


def depth_scale(near: float, far: float, height: int) -> np.ndarray:
    """Colours from ``near`` (top) to ``far`` [m], round numbers beside them: ``(height, w, 3)`` uint8 RGB."""
    size = height / 800 + 0.2  # of the letters
    margin, bar = round(24 * size) + 2, max(10, height // 24)
    ticks = round_numbers(near, far)
    digits = max(0, min(2, -int(np.floor(np.log10(ticks[1] - ticks[0]) + 1e-9))))
    labels = [f"{tick:.{digits}f} m" for tick in ticks]
    wide = cv2.getTextSize("00.00 m", _FONT, size, 1)[0][
        0
    ]  # always the same: a video's frames have one width
    scale = np.full((height, bar + 10 + wide + 6, 3), 255, np.uint8)
    length = height - 2 * margin
    ramp = np.linspace(near, far, length)[:, None].repeat(bar, axis=1)
    scale[margin : margin + length, :bar] = colour_depth(ramp, near, far)
    for tick, label in zip(ticks, labels, strict=True):
        row = margin + round((tick - near) / (far - near) * (length - 1))
        cv2.line(scale, (bar, row), (bar + 5, row), (0, 0, 0), 1)
        middle = row + cv2.getTextSize(label, _FONT, size, 1)[0][1] // 2
        cv2.putText(scale, label, (bar + 9, middle), _FONT, size, (0, 0, 0), 1, cv2.LINE_AA)
    return scale


def round_numbers(near: float, far: float) -> list[float]:
    """Three to eight numbers that people read easily, evenly spaced within ``[near, far]``."""
    step = 10.0 ** np.floor(np.log10((far - near) / 3))
    step = next(step * times for times in (5, 2, 1) if (far - near) / (step * times) >= 3 or times == 1)
    first = np.ceil(near / step - 1e-9)
    count = int(np.floor(far / step + 1e-9) - first) + 1
    return [round(float((first + i) * step), 6) for i in range(count)]

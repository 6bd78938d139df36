"""Depth of a video without flicker: a causal filter along the motion of the pixels."""

from functools import cache
from typing import NamedTuple

import numpy as np

# of the maps on which motion and correction are computed [px]: as steady as on full ones, and faster
WIDTH = 64
FINEST_SCALE = 1  # motion is measured on half of that: twice as fast, no worse
NEW = 0.3  # share of the new depth where a pixel is recognized
TOLERANCE = 20.0  # difference of gray values at which a pixel is hardly recognized
TREND = 0.1  # share of a surprise in scale that becomes trend
FASTEST = 0.1  # change of scale per frame that still is motion
RECOGNIZED = 0.5  # share of the pixels below which a new scene starts
JUMP = 0.4  # change of scale at which a new scene starts


class _Memory(NamedTuple):
    gray: np.ndarray  # (h, w) uint8
    depth: np.ndarray  # (H, W) float32 [m], as the network gave it
    steady: np.ndarray  # (H, W) float32 [m], as it came out
    log_depth: np.ndarray  # (h, w) float32, of steady
    trend: float  # of the mean of log_depth per frame


class SteadyFilter:
    """Steady the depth of one video, frame by frame.

    Every pixel is followed from the last frame by optical flow (DIS, Kroeger et al. 2016). Where it looks the
    same, the new depth is mixed with the filtered one of the last frame; elsewhere the new depth stays. This
    happens on small maps, and the depth gets the enlarged correction, so its details stay sharp. The trend of
    the scale is part of the prediction, so depth does not lag while the camera moves. The filter sees no
    later frame. A cut, or any picture of another scene, resets it: then depth comes back unchanged.

    A filter belongs to one video: give each video, and each thread, its own.
    """

    def __init__(self) -> None:
        import cv2

        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
        self._flow.setFinestScale(FINEST_SCALE)
        self._memory: _Memory | None = None

    def __call__(self, image: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return the steady depth ``(H, W)`` float32 [m] of the next frame.

        Args:
            image: ``(h, w, 3)`` uint8 RGB of any size; the smaller, the faster.
            depth: ``(H, W)`` float32 [m], above 0, of the whole image.
        """
        import cv2

        width, height = WIDTH, max(WIDTH // 2, round(WIDTH * image.shape[0] / image.shape[1]))
        gray = cv2.resize(
            cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (width, height), interpolation=cv2.INTER_AREA
        )
        log_depth = cv2.log(cv2.resize(depth, (width, height), interpolation=cv2.INTER_AREA))
        last, self._memory = self._memory, _Memory(gray, depth, depth, log_depth, 0.0)
        if last is not None and np.array_equal(depth, last.depth):  # the same frame again
            self._memory = last
            return last.steady
        if last is None or last.gray.shape != gray.shape or last.depth.shape != depth.shape:
            return depth
        motion = self._flow.calc(gray, last.gray, None)  # type: ignore[call-overload]
        where = _grid(height, width) + motion
        same = _same_surface(gray, last.gray, where)
        if same.mean() < RECOGNIZED:
            return depth
        surprise = log_depth - (_follow(last.log_depth, where) + np.float32(last.trend))
        known = surprise[same > RECOGNIZED]
        shift = float(np.median(known)) if known.size else 0.0
        if abs(shift) > JUMP:
            return depth
        trend = float(np.clip(last.trend + TREND * shift, -FASTEST, FASTEST))
        correction = np.float32(NEW - 1) * same * surprise
        steady = depth * cv2.resize(cv2.exp(correction), depth.shape[::-1])
        self._memory = _Memory(gray, depth, steady, log_depth + correction, trend)
        return self._memory.steady


def _same_surface(gray: np.ndarray, last: np.ndarray, where: np.ndarray) -> np.ndarray:
    """How sure it is, in 0 to 1, that each pixel shows what the last frame shows at ``where (h, w, 2)``."""
    import cv2

    height, width = gray.shape
    difference = cv2.absdiff(gray, _follow(last, where)).astype(np.float32) * np.float32(1 / TOLERANCE)
    same = cv2.exp(-(difference * difference))
    x, y = where[..., 0], where[..., 1]
    same[(x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)] = 0
    return same


def _follow(last: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Return what lay at ``where (H, W, 2)`` [px] in the last map ``(h, w)``."""
    import cv2

    found: np.ndarray = cv2.remap(  # the stubs want both maps, OpenCV takes one of pairs
        last,
        where,
        None,
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,  # type: ignore[call-overload]
    )
    return found


@cache
def _grid(height: int, width: int) -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)

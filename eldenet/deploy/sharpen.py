"""Depth of a picture whose edges are those of the picture."""

import numpy as np

SHORT_SIDE, LONG_SIDE = 240, 960  # at which `sharpen` works, or less [px]
WINDOW, STEP = 7, 3  # samples across its window, and pixels between them
COLOR_SIGMA = 0.08  # difference of colors in [0, 1] at which weights fall off
PASSES, HALVINGS = 2, 8  # a median is found by halving the range of depths in the window


def sharpen(depth: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Move the edges of a depth map to those of its picture.

    Each pixel becomes the median of the depths around it, weighted by how alike the colors are (weighted
    median filtering, Ma et al., ICCV 2013). So the ramps that networks draw between near and far become
    steps. Nothing is learned.

    Args:
        depth: ``(h, w)`` [m], of any size.
        image: ``(H, W, 3)`` uint8 RGB.

    Returns:
        Depth ``(h', w')`` float32 [m], whose sides have at most 240 and 960 px.
    """
    import cv2

    height, width = image.shape[:2]
    scale = min(1.0, SHORT_SIDE / min(height, width), LONG_SIDE / max(height, width))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32) / 255
    out = cv2.resize(depth.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    difference = np.square(_windows(small) - small).sum(axis=-1)
    weights = np.exp(-difference / (2 * COLOR_SIGMA**2))
    half = weights.sum(axis=0) / 2
    for _ in range(PASSES):
        depths = _windows(out)
        low, high = depths.min(axis=0), depths.max(axis=0)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            enough = (weights * (depths <= middle)).sum(axis=0) >= half
            low, high = np.where(enough, low, middle), np.where(enough, middle, high)
        out = high
    return np.asarray(out)


def _windows(maps: np.ndarray) -> np.ndarray:
    """Samples around each pixel of ``(H, W, ...)``: ``(samples, H, W, ...)``."""
    reach = STEP * (WINDOW // 2)
    padded = np.pad(maps, [(reach, reach)] * 2 + [(0, 0)] * (maps.ndim - 2), mode="edge")
    height, width = maps.shape[:2]
    steps = range(0, 2 * reach + 1, STEP)
    return np.stack([padded[y : y + height, x : x + width] for y in steps for x in steps])

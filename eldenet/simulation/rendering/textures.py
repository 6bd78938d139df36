"""All surface patterns in one atlas with its pyramid, sampled at the hits of a frame's rays."""

from functools import lru_cache

import numpy as np

from eldenet.simulation.rendering.patterns import FAMILIES, SIDE

LEVELS = 6


class Atlas:
    """All patterns with their pyramid, flat: one level per power of two, sampled bilinearly.

    The level fits the pixel's footprint, so far tiles turn gray instead of sparkling.

    Attributes:
        planes: ``(3, T)`` uint8 weights, 200 = 1.0; level by level, pattern by pattern, row by row.
    """

    UNIT = np.float32(1 / 200)

    def __init__(self) -> None:
        first = [
            p(np.random.default_rng((77, i, k)))
            for i, (p, count) in enumerate(FAMILIES)
            for k in range(count)
        ]
        level = np.clip(np.stack(first) * 200 + 0.5, 0, 255).astype(np.uint8)
        levels = [level]
        for _ in range(LEVELS - 1):
            wide = levels[-1].astype(np.float32)
            half = (wide[:, ::2, ::2] + wide[:, 1::2, ::2] + wide[:, ::2, 1::2] + wide[:, 1::2, 1::2]) / 4
            levels.append((half + 0.5).astype(np.uint8))
        self.count = len(first)
        starts = np.cumsum([0] + [lv.shape[0] * lv.shape[1] * lv.shape[2] for lv in levels[:-1]])
        self.starts = starts.astype(np.int32)
        self.planes = np.ascontiguousarray(np.concatenate([lv.reshape(-1, 3) for lv in levels]).T)

    def sample(self, pattern: np.ndarray, u: np.ndarray, v: np.ndarray, footprint: np.ndarray) -> np.ndarray:
        """Weights ``(3, N)`` float32 at texture coordinates (period 1), bilinear.

        Args:
            pattern: ``(N,)`` int32 pattern numbers.
            u: ``(N,)`` float32.
            v: ``(N,)`` float32.
            footprint: ``(N,)`` float32, size of a pixel in texture units; chooses the pyramid's level.
        """
        level = np.frexp(np.minimum(footprint * np.float32(SIDE * 0.8), np.float32(2**LEVELS - 1)))[1]
        level = np.clip(level, 0, LEVELS - 1)
        side = np.right_shift(np.int32(SIDE), level)
        mask = side - 1
        base = self.starts.take(level) + pattern * side * side
        x, y = u * side - np.float32(0.5), v * side - np.float32(0.5)
        fx, fy = np.floor(x), np.floor(y)
        ix, iy = fx.astype(np.int32), fy.astype(np.int32)
        x, y = (x - fx).astype(np.float32), (y - fy).astype(np.float32)
        left, right = ix & mask, (ix + 1) & mask
        top, bottom = base + (iy & mask) * side, base + ((iy + 1) & mask) * side
        corners = (top + left, top + right, bottom + left, bottom + right)
        out = np.empty((3, len(u)), np.float32)
        for c in range(3):
            a, b, e, f = (self.planes[c].take(corner).astype(np.float32) for corner in corners)
            a += (b - a) * x
            e += (f - e) * x
            a += (e - a) * y
            np.multiply(a, self.UNIT, out=out[c])
        return out


@lru_cache(maxsize=1)
def atlas() -> Atlas:
    """Return the one atlas of this process, built on first use (about 0.3 s)."""
    return Atlas()

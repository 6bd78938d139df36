"""What patterns are made of: texels, noise and the three weights of a blend."""

from collections.abc import Callable

import cv2
import numpy as np

#: Texels along a pattern's edge.
SIDE = 128

Weights = np.ndarray  # (SIDE, SIDE, 3) float32 in [0, ~1.3]
Pattern = Callable[[np.random.Generator], Weights]


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Coordinates ``(u, v)`` of the texels' centers in [0, 1]."""
    axis = (np.arange(SIDE, dtype=np.float32) + 0.5) / SIDE
    v, u = np.meshgrid(axis, axis, indexing="ij")
    return u, v


def noise(rng: np.random.Generator, cells_u: int, cells_v: int, octaves: int = 3) -> np.ndarray:
    """Periodic value noise ``(SIDE, SIDE)`` in [0, 1]."""
    total = np.zeros((SIDE, SIDE), np.float32)
    weight = 0.0
    for octave in range(octaves):
        nu, nv = min(SIDE, cells_u << octave), min(SIDE, cells_v << octave)
        coarse = np.pad(rng.random((nv, nu)).astype(np.float32), 2, mode="wrap")
        su, sv = SIDE // nu, SIDE // nv
        fine = cv2.resize(
            coarse, (coarse.shape[1] * su, coarse.shape[0] * sv), interpolation=cv2.INTER_LINEAR
        )
        total += fine[2 * sv : 2 * sv + SIDE, 2 * su : 2 * su + SIDE] * 0.5**octave
        weight += 0.5**octave
    total /= weight
    return (total - total.min()) / (total.max() - total.min() + 1e-6)


def mix(second: np.ndarray, third: np.ndarray | float = 0.0, light: np.ndarray | float = 1.0) -> Weights:
    """Weights of a blend: A where both are 0, B where ``second`` is 1, C where ``third`` is 1."""
    second = np.clip(second, 0, 1)
    third = np.broadcast_to(np.clip(third, 0, 1), second.shape)
    out = np.stack([(1 - second) * (1 - third), second * (1 - third), third], axis=-1)
    return (out * np.broadcast_to(light, second.shape)[..., None]).astype(np.float32)

"""The floor in a depth map: how the camera is tilted, and how high it is. Needs NumPy only.

The inverse depth of a plane is linear in the pixels' rays: ``1 / z = rays @ m``, ``m = normal / height``. So
a fit in inverse depth weighs relative errors, which is what depth has, and needs no scale to begin with.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from eldenet.geometry import PinholeCamera

SLOPE = 0.25  # greatest tilt that is found [rad]
AGREES = 0.04  # relative error of depth on the floor
BELOW = 0.10  # relative depth beyond the floor's that lies below it: there is nothing
LEAST_SHARE, MOST_BELOW = 0.3, 0.03  # of the known pixels in the lower half: on the floor, below it
LEAST_EXTENT = 1.5  # of the floor seen, ahead and across, relative to the camera's height
LEVELED_BY, LEAST_FLOORS = 15, 3  # last floors whose median counts, and the fewest
MOST_TILT, MOST_SCALE = 0.2, 1.4  # greatest tilt [rad] and factor that are corrected
LEAST_TILT, LEAST_SCALE = 0.01, 0.03  # tilt [rad] and error of the factor below which nothing is corrected
_PIXELS, _TRIALS, _LEAST = 600, 100, 40  # about so many pixels; planes tried; fewest pixels of a floor


class Floor(NamedTuple):
    """A floor as a camera sees it.

    Attributes:
        pitch: of the camera below the horizon, beyond what its level frame says [rad].
        roll: the same, clockwise as it looks [rad].
        height: of the camera above the floor, by the depth's scale [m].
    """

    pitch: float
    roll: float
    height: float


def find_floor(depth: np.ndarray, camera: PinholeCamera) -> Floor | None:
    """Fit the floor in the lower half of a depth map ``(H, W)`` [m] (0 and NaN: unknown).

    RANSAC, then least squares. None where too little of a floor is seen, or something lies below it: then it
    is a table, or a wall's foot beside a strip of floor.
    """
    rows, columns = (grid.ravel() for grid in _lower_half(depth.shape))
    pixels = np.stack([columns, rows, np.ones(len(rows))], axis=1) @ camera.homography.T
    known = np.isfinite(depth[rows, columns]) & (depth[rows, columns] > 0)
    rays, inverse = pixels[known], 1 / depth[rows, columns][known].astype(np.float64)
    if len(rays) < _LEAST:
        return None
    lowest = np.argsort(-rays[:, 1], kind="stable")[: len(rays) * 2 // 3]
    triples = lowest[np.random.default_rng(0).integers(0, len(lowest), (_TRIALS, 3))]
    triples = triples[np.abs(np.linalg.det(rays[triples])) > 1e-4]
    planes = np.linalg.solve(rays[triples], inverse[triples][..., None])[..., 0]
    planes = planes[planes[:, 1] > math.cos(SLOPE) * np.linalg.norm(planes, axis=1)]
    if not len(planes):
        return None
    beyond = planes @ rays.T / inverse - 1
    votes = (np.abs(beyond) < AGREES).sum(axis=1) - (beyond > BELOW).sum(axis=1)
    plane = planes[votes.argmax()]
    for _ in range(3):
        inside = np.abs(rays @ plane / inverse - 1) < AGREES
        if inside.sum() < _LEAST:
            return None
        plane = np.linalg.lstsq(rays[inside] / inverse[inside, None], np.ones(inside.sum()), rcond=None)[0]
    beyond = rays @ plane / inverse - 1
    inside, height = np.abs(beyond) < AGREES, 1 / float(np.linalg.norm(plane))
    across, down, ahead = plane * height
    seen = rays[inside] / inverse[inside, None] / height
    extent = [np.ptp(np.quantile(seen[:, axis], (0.05, 0.95))) for axis in (0, 2)] if inside.any() else [0.0]
    if (
        down < math.cos(SLOPE)
        or inside.mean() < LEAST_SHARE
        or min(extent) < LEAST_EXTENT
        or (beyond > BELOW).mean() > MOST_BELOW
    ):
        return None
    return Floor(math.atan2(ahead, down), math.atan2(across, down), height)


class Leveler:
    """Unknown tilt of a camera and scale of its depth, by the last floors that it saw.

    It finds them up to :data:`MOST_TILT` and :data:`MOST_SCALE`. Beyond, it corrects nothing: the driver's
    watch says what is wrong.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all floors; call this when the camera was moved."""
        self._floors: deque[Floor] = deque(maxlen=LEVELED_BY)

    def __call__(self, depth: np.ndarray, camera: PinholeCamera, height: float) -> tuple[float, float, float]:
        """Pitch and roll to add [rad], and a factor for depth; (0, 0, 1): correct nothing.

        Args:
            depth: ``(H, W)`` [m].
            camera: in the level frame, as far as its tilt is known.
            height: of the camera above the floor [m].
        """
        found = find_floor(depth, camera)
        if found is not None:
            self._floors.append(found)
        if len(self._floors) < LEAST_FLOORS:
            return 0.0, 0.0, 1.0
        pitch, roll, seen = np.median(self._floors, axis=0).tolist()
        factor = height / seen
        if max(abs(pitch), abs(roll)) > MOST_TILT or not 1 / MOST_SCALE < factor < MOST_SCALE:
            return 0.0, 0.0, 1.0
        pitch, roll = (angle if abs(angle) > LEAST_TILT else 0.0 for angle in (pitch, roll))
        return pitch, roll, factor if abs(factor - 1) > LEAST_SCALE else 1.0


def _lower_half(shape: tuple[int, ...]) -> np.ndarray:
    """Rows and columns of about ``_PIXELS`` pixels in a grid over the lower half."""
    height, width = shape
    step = max(1, int(math.sqrt(height * width / 2 / _PIXELS)))
    return np.mgrid[height // 2 : height : step, 0:width:step]

"""A camera, an empty image and boxes for the tests of perception."""

import numpy as np

from eldenet.boxes import Boxes3D
from eldenet.geometry import PinholeCamera, pinhole

CAMERA = PinholeCamera(pinhole(300.0, 300.0, 160.0, 60.0))
BLANK = np.full((120, 320, 3), 40, np.uint8)


def boxes(center: np.ndarray, yaw: float = 0.0, label: int = 0) -> Boxes3D:
    center = np.atleast_2d(np.asarray(center, float))
    count = len(center)
    size, ones = np.tile([4.0, 1.6, 1.5], (count, 1)), np.ones(count)
    return Boxes3D(center, size, yaw * ones, ones, np.full(count, label), ("car", "person"))

"""Does the depth agree with the size of the things that were detected? Rooms' weights on a street do not."""

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import PinholeCamera
from eldenet.perception.priors import prior_of

# of things without a prior, as they stand: roughly [m]
HEIGHTS = {"chair": 0.85, "refrigerator": 1.7, "toilet": 0.75, "microwave": 0.3, "bottle": 0.25, "cup": 0.1}
LEAST_OBJECTS = 3
TOLERANCE = 2.5  # factor: hidden feet, people who sit and cut boxes stay below it
UPRIGHT = 1.8  # least height of a standing person's box, in widths
ROOMS, STREETS = 25.0, 40.0  # [m]: weights for rooms reach no farther, weights for streets reach farther


class SizeCheck:
    """Compares depth with what the heights of 2D boxes say, over many pictures.

    Args:
        max_depth: that the network can answer [m]; None: unknown.
    """

    def __init__(self, max_depth: float | None = None) -> None:
        self.max_depth = max_depth
        self.ratios: list[float] = []

    def add(self, depth: np.ndarray, detections: Detections2D, camera: PinholeCamera) -> None:
        """Take a picture's depth ``(H, W)`` [m] and its objects; those that its border cuts do not count."""
        rows, columns = depth.shape
        for box, name in zip(detections.xyxy, detections.classes, strict=True):
            left, top, right, bottom = box
            prior = prior_of(name)
            height = HEIGHTS.get(name.lower()) if prior is None else prior.size[2]
            cut = left < 1 or top < 1 or right > columns - 2 or bottom > rows - 2
            tall, wide = bottom - top, right - left
            sits = prior is not None and prior.shape == "upright" and tall < UPRIGHT * wide
            if height is None or cut or sits or tall < 1 or wide < 1:
                continue
            middle = depth[
                round(top + tall / 4) : round(bottom - tall / 4) + 1,
                round(left + wide / 4) : round(right - wide / 4) + 1,
            ]
            known = middle[np.isfinite(middle) & (middle > 0)]
            if known.size:
                expected = camera.intrinsics[1, 1] * height / tall
                self.ratios.append(float(np.median(known) / expected))

    def warning(self) -> str:
        """One line if depth and sizes contradict each other, with what would work; else empty."""
        if len(self.ratios) < LEAST_OBJECTS:
            return ""
        ratio = float(np.median(self.ratios))
        if 1 / TOLERANCE <= ratio <= TOLERANCE:
            return ""
        found = (
            f"note: {len(self.ratios)} objects of known size are at {ratio:.2g} times the distance that "
            "their size implies (median), so their boxes are wrong: "
        )
        reach = self.max_depth
        if ratio < 1 and reach is not None and reach <= ROOMS:
            return (
                f"{found}these weights are for rooms (depth up to {reach:g} m). On a street give weights of "
                "streets (checkpoint=...; docs/training.md), or boxes without depth: "
                "perception.lifter.method=no_depth perception.lifter.camera_height=<meters above the ground>"
            )
        if ratio > 1 and reach is not None and reach > STREETS:
            return (
                f"{found}these weights are for streets (depth up to {reach:g} m). In rooms give "
                "checkpoint=eldenet_indoor"
            )
        return f"{found}check that intrinsics=[fx,fy,cx,cy] are those of pictures of this size"

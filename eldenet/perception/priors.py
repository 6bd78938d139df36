"""Class priors: typical sizes, and the shapes that fill the boxes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from eldenet.boxes import BoxStyle

Shape = Literal["vehicle", "upright", "box"]


@dataclass(frozen=True)
class ClassPrior:
    """Size and shape of a class.

    Attributes:
        size: mean length, width, height [m].
        spread: relative standard deviation of each.
        shape: "vehicle" (corners cut, smaller roof), "upright" (slim, such as a person) or "box".
        kinds: subclasses with this name; depth tells them apart, and the one that fits best counts.
    """

    size: tuple[float, float, float]
    spread: tuple[float, float, float]
    shape: Shape
    kinds: tuple["ClassPrior", ...] = ()


_CAR = ClassPrior((3.90, 1.61, 1.52), (0.11, 0.07, 0.08), "vehicle")
_VAN = ClassPrior((4.93, 1.86, 2.16), (0.12, 0.08, 0.14), "vehicle")
_BOX_TRUCK = ClassPrior((8.5, 2.5, 3.15), (0.3, 0.07, 0.1), "vehicle")
_PICK_UP = ClassPrior((5.2, 1.95, 1.9), (0.2, 0.1, 0.12), "vehicle")
_TRUCK = ClassPrior((6.5, 2.2, 2.6), (0.35, 0.15, 0.25), "vehicle", (_BOX_TRUCK, _PICK_UP))  # COCO's are both
_PERSON = ClassPrior((0.67, 0.61, 1.71), (0.3, 0.25, 0.08), "upright")

#: Under KITTI's and COCO's names. Cars, vans, pedestrians and cyclists: means over KITTI's tracking labels
#: (17,332 cars); the others are rough.
PRIORS: Mapping[str, ClassPrior] = {
    "car": _CAR,
    "van": _VAN,
    "truck": _TRUCK,
    "bus": ClassPrior((11.0, 2.6, 3.2), (0.2, 0.08, 0.1), "vehicle"),
    "pedestrian": _PERSON,
    "person": _PERSON,
    "person_sitting": ClassPrior((0.8, 0.6, 1.25), (0.3, 0.25, 0.15), "upright"),
    "cyclist": ClassPrior((1.77, 0.60, 1.71), (0.1, 0.2, 0.06), "upright"),
    "bicycle": ClassPrior((1.75, 0.55, 1.1), (0.1, 0.25, 0.15), "upright"),
    "motorcycle": ClassPrior((2.1, 0.8, 1.35), (0.12, 0.25, 0.2), "upright"),
    "box": ClassPrior((0.8, 0.6, 0.7), (0.4, 0.4, 0.5), "box"),
    "pillar": ClassPrior((0.4, 0.4, 2.6), (0.3, 0.3, 0.2), "box"),
}


def prior_of(name: str, priors: Mapping[str, ClassPrior] = PRIORS) -> ClassPrior | None:
    """The prior of a class, or None; upper and lower case are the same name, whose last entry counts."""
    return {key.lower(): prior for key, prior in priors.items()}.get(name.lower())


def silhouette(shape: Shape, style: BoxStyle) -> np.ndarray:
    """Points ``(M, 3)`` in units of (length, height, width) whose extent in the image is the 2D box.

    Convention: a "projected" box encloses the eight corners (KITTI's labels); a "tight" one encloses the
    visible object, and a car does not fill the corners of its box.
    """
    corners = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    if style == "projected" or shape == "box":
        return corners
    if shape == "upright":  # an ellipse at the feet, at the shoulders, and a small one at the head
        angles = np.arange(8) * np.pi / 4
        circle = np.stack([np.cos(angles), np.zeros(8), np.sin(angles)], axis=1) * 0.5
        return np.concatenate(
            [circle * scale + [0, y, 0] for y, scale in ((0.5, 0.8), (0.1, 0.95), (-0.5, 0.3))]
        )
    cut = 0.42
    outline = [(x, z) for x in (-0.5, 0.5) for z in (-cut, cut)]
    outline += [(x, z) for x in (-cut, cut) for z in (-0.5, 0.5)]
    low = [(x, y, z) for x, z in outline for y in (0.4, -0.02)]
    wheels = [(x, 0.5, z) for x in (-0.36, 0.36) for z in (-0.5, 0.5)]
    roof = [(x, -0.5, z) for x in (-0.33, 0.1) for z in (-0.38, 0.38)]
    return np.array(low + wheels + roof)

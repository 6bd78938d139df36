"""Weights of rooms on a street, and the reverse, do not pass unseen."""

import numpy as np
import pytest

from eldenet.boxes import Detections2D
from eldenet.geometry import PinholeCamera, pinhole
from eldenet.perception.size_check import SizeCheck
from eldenet.simulation.street_views import render_street

CAMERA = PinholeCamera(pinhole(400.0, 400.0, 320.0, 120.0))


def seen(*boxes: tuple[float, float, float, float], name: str = "person") -> Detections2D:
    count = len(boxes)
    return Detections2D(np.array(boxes, float), np.ones(count), np.zeros(count, int), (name,))


def checked(factor: float, max_depth: float | None, name: str = "person") -> str:
    """The warning about four objects at ``factor`` times their distance of about 6.8 m."""
    check = SizeCheck(max_depth)
    for _ in range(4):
        check.add(np.full((240, 640), 6.84 * factor), seen((300, 70, 340, 170), name=name), CAMERA)
    return check.warning()


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_depth_that_fits_the_sizes_passes(factor) -> None:
    assert checked(factor, 10.0) == checked(factor, 80.0) == ""


def test_rooms_weights_on_a_street_are_told_what_would_work() -> None:
    line = checked(0.1, 20.0)
    assert "4 objects" in line
    assert "0.1 times" in line
    assert "rooms (depth up to 20 m)" in line
    assert "perception.lifter.method=no_depth perception.lifter.camera_height=" in line
    assert "\n" not in line


def test_street_weights_in_rooms_are_told_what_would_work() -> None:
    assert "checkpoint=eldenet_indoor" in checked(4.0, 80.0)
    assert "checkpoint=eldenet_indoor" in checked(6.0, 80.0, "chair")  # 3.4 m away


@pytest.mark.parametrize(("factor", "reach"), [(0.1, 80.0), (4.0, 10.0), (0.1, None), (9.0, None)])
def test_otherwise_the_intrinsics_are_doubted(factor, reach) -> None:
    assert "check that intrinsics" in checked(factor, reach)


def test_few_cut_sitting_and_unknown_objects_say_nothing() -> None:
    far = np.full((240, 640), 100.0)
    check = SizeCheck(80.0)
    check.add(far, seen((300, 70, 340, 170), (310, 70, 350, 170)), CAMERA)  # two are too few
    check.add(far, seen((0, 70, 40, 170), (300, 70, 340, 239), (300, 100, 380, 170)), CAMERA)
    check.add(far, seen((300, 70, 340, 170), name="umbrella"), CAMERA)
    check.add(np.zeros((240, 640)), seen((300, 70, 340, 170)), CAMERA)  # unknown depth
    assert len(check.ratios) == 2
    assert check.warning() == ""


def test_true_depth_of_rendered_streets_passes_and_a_tenth_of_it_does_not() -> None:
    true, short = SizeCheck(80.0), SizeCheck(20.0)
    for index in range(2):
        view = render_street("val", index, (192, 416))
        true.add(view.depth, view.detections, view.camera)
        short.add(view.depth / 10, view.detections, view.camera)
    assert len(true.ratios) > 5
    assert true.warning() == ""
    assert "rooms" in short.warning()

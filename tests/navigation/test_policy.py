"""One step of the trained driver: in which frame and from where it remembers what it saw."""

import numpy as np
import pytest

from eldenet.navigation.on_robot import as_ranges
from eldenet.navigation.policy import Navigator
from eldenet.navigation.ranges import depth_to_ranges
from eldenet.simulation.robot import ROBOT

GOAL = (5.0, 0.2)
CAMERA = np.array([[460.0, 0, 320], [0, 460.0, 240], [0, 0, 1]])


def ranges_with_a_pillar(away: float) -> np.ndarray:
    ranges = np.full(ROBOT.columns, ROBOT.far)
    ranges[10:16] = away
    return ranges


def remembered(navigator: Navigator) -> np.ndarray:
    """Distances of all remembered points within 3 m of where the robot was last (M,)."""
    return np.sort(navigator.observer.memory.near(np.zeros((1, 3)))[3])


@pytest.mark.parametrize("origin", [(4e3, -7e3), (691_000.0, 5_335_000.0), (1e6, 1e6)])
def test_it_drives_alike_wherever_the_frame_has_its_origin(origin):
    """Positions of a GPS receiver are millions of meters from the origin of their frame."""
    near, far = Navigator.load(), Navigator.load()
    for number in range(8):
        pose = (0.1 * number, 0.02 * number, 0.05 * number)
        moved = (pose[0] + origin[0], pose[1] + origin[1], pose[2])
        ranges = ranges_with_a_pillar(2.0 - 0.1 * number)
        assert near.step(ranges, GOAL, pose) == far.step(ranges, GOAL, moved)
    assert len(remembered(near)) >= 6
    assert remembered(far) == pytest.approx(remembered(near), abs=1e-3)
    near.reset()
    assert near.step(ranges_with_a_pillar(2.0), GOAL, (9.0, 9.0, 0.0)) is not None
    assert len(remembered(near)) == 6  # of a frame that begins here


def test_an_old_scan_is_remembered_from_where_it_was_taken():
    """A robot that turns at 1.2 rad/s has turned by 0.36 rad when a depth map arrives after 0.3 s."""
    late, there = Navigator.load(), Navigator.load()
    for navigator in (late, there):
        navigator.step(ranges_with_a_pillar(2.0), GOAL, (0.0, 0.0, 0.0))
    late.step(ranges_with_a_pillar(2.0), GOAL, (0.0, 0.0, 0.36), scanned_from=(0.0, 0.0, 0.0))
    assert remembered(late) == pytest.approx(remembered(there), abs=1e-5)
    assert np.ptp(late.observer.memory.points(0), axis=0).max() < 1.0  # no second pillar beside the first
    assert late.step(ranges_with_a_pillar(2.0), GOAL, (0, 0, 0), scanned_from=(np.nan, 0, 0)) == (0.0, 0.0)
    assert late.stop_reason == "scanned_from not finite"


@pytest.mark.parametrize("kind", [np.uint16, np.int32, bool, np.float32, np.float64])
@pytest.mark.parametrize("shape", [(480, 640), (40,), (5,)])
def test_millimeters_are_refused(kind, shape):
    """A depth camera gives uint16: read as meters, a wall at 0.6 m would be out of range."""
    depth, navigator = np.full(shape, 600, kind), Navigator.load()
    with pytest.raises(ValueError, match=r"^(depth is of type|100%).*divide millimeters by 1000$"):
        navigator.step(depth, GOAL, (0.0, 0.0, 0.0), intrinsics=CAMERA)
    assert not navigator.observer.last.any()
    assert as_ranges(np.full(shape, 0.6), CAMERA).max() < 1.0


@pytest.mark.parametrize("far", [np.inf, 65.535, 1000.0])
@pytest.mark.parametrize("shape", [(480, 640), (40,)])
def test_much_that_is_out_of_range_is_no_millimeters(shape, far):
    """Some cameras write inf there, some a number; the floor or a wall is nearer somewhere."""
    depth = np.full(shape, far)
    depth[int(0.8 * shape[0]) :] = 2.0
    expected = np.where(np.isfinite(depth), np.minimum(depth, 50.0), 50.0)
    odometry = (0.0, 0.0, 0.0)
    assert Navigator.load().step(depth, GOAL, odometry, intrinsics=CAMERA) == Navigator.load().step(
        expected, GOAL, odometry, intrinsics=CAMERA
    )


@pytest.mark.parametrize("depth", [np.full((480, 640), np.inf), np.full(40, np.inf), np.full(40, 80.0)])
def test_nothing_in_range_stays_legal(depth):
    speed, _ = Navigator.load().step(depth, GOAL, (0.0, 0.0, 0.0), intrinsics=CAMERA)
    assert speed > 0


@pytest.mark.parametrize(
    "intrinsics",
    [CAMERA.tolist(), tuple(map(tuple, CAMERA.tolist())), [460, 460, 320, 240], (460.0, 460.0, 320.0, 240.0)],
)
def test_intrinsics_may_be_lists_or_tuples(intrinsics):
    """The depth predictor takes the same four numbers, or the same matrix."""
    depth = np.full((480, 640), 1.0)
    expected = Navigator.load().step(depth, GOAL, (0.0, 0.0, 0.0), intrinsics=CAMERA)
    assert Navigator.load().step(depth, list(GOAL), [0, 0, 0], intrinsics=intrinsics) == expected
    assert (as_ranges(depth, intrinsics) == as_ranges(depth, CAMERA)).all()
    assert (depth_to_ranges(depth, intrinsics) == depth_to_ranges(depth, CAMERA)).all()


@pytest.mark.parametrize(("wrong", "line"), [
    ({"intrinsics": [460.0, 320.0]}, r"intrinsics=\[460.0, 320.0\]: give \[fx, fy, cx, cy\] of"),
    ({"goal": (5.0, 0.2, 0.0)}, r"goal=\(5.0, 0.2, 0.0\): give \(distance, bearing\), 2 numbers"),
    ({"odometry": (1.0, 2.0)}, r"odometry=\(1.0, 2.0\): give \(x, y, heading\), 3 numbers"),
    ({"scanned_from": 3.0}, r"scanned_from=3.0: give \(x, y, heading\), 3 numbers"),
])  # fmt: skip
def test_a_wrong_length_is_one_clear_line(wrong, line):
    good = {"goal": GOAL, "odometry": (0.0, 0.0, 0.0), "intrinsics": CAMERA}
    with pytest.raises(ValueError, match=line) as error:
        Navigator.load().step(np.full((480, 640), 6.0), **(good | wrong))
    assert "\n" not in str(error.value)

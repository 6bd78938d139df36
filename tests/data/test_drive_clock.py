"""Poses with another clock than the pictures are put right by how both turn, or it is not told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eldenet.data.drive_clock import find_delay
from eldenet.data.drive_poses import DrivePoses, Mount, read_poses
from eldenet.data.self_calibration import Pair
from eldenet.geometry import level_rotation, pinhole

LENS, STEP = pinhole(230.0, 230.0, 159.5, 119.5), 0.25
FORWARD = level_rotation(0.1).T[:, 2]


def drive(path: Path, bend: float, sign: int = 1) -> DrivePoses:
    """Poses of 40 s in bows; ``sign`` of the heading that is told."""
    times = np.arange(0, 40, 0.1)
    heading = bend * (np.sin(0.9 * times) + np.sin(2.3 * times + 1))
    places = np.cumsum(0.03 * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    rows = np.column_stack([times, places, sign * heading]).round(6)
    path.write_text("\n".join(["seconds,x,y,heading", *(",".join(map(str, row)) for row in rows)]))
    return read_poses(path, Mount(0.4, 0.1, 0.1))


def pairs(poses: DrivePoses) -> list[Pair]:
    """Corners that the camera sees on its way, each pair of pictures a quarter of a second apart."""
    rng = np.random.default_rng(0)
    found = []
    for begin in np.arange(4.0, 34.0, STEP):
        one, other = poses.at(begin), poses.at(begin + STEP)
        motion = np.linalg.inv(other) @ one
        rays = np.column_stack([rng.uniform(-0.7, 0.7, 30), rng.uniform(-0.5, 0.5, 30), np.ones(30)])
        points = rays * rng.uniform(0.8, 5.0, 30)[:, None]
        later = points @ motion[:3, :3].T + motion[:3, 3]
        here, there = ((seen @ LENS.T)[:, :2] / seen[:, 2:] for seen in (points, later))
        there += rng.normal(0, 0.3, there.shape)
        found.append(Pair(here, there, motion, (float(begin), float(begin + STEP))))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delay", "lens"), [(0.0, LENS), (-0.8, pinhole(330.0, 330.0, 159.5, 119.5)), (2.6, LENS)]
)
def test_a_delay_is_found_whatever_lens_was_told(tmp_path, delay, lens):
    poses = drive(tmp_path / "o.csv", 0.3)
    late = replace(poses, seconds=poses.seconds + delay)
    assert find_delay(pairs(poses), late, lens, FORWARD) == pytest.approx(delay, abs=0.02)


def test_a_straight_drive_rare_poses_or_pictures_without_times_do_not_tell_it(tmp_path):
    straight = drive(tmp_path / "o.csv", 0.001)
    assert find_delay(pairs(straight), straight, LENS, FORWARD) is None
    bows = drive(tmp_path / "o.csv", 0.3)
    rare = replace(bows, cameras=bows.cameras[::10], seconds=bows.seconds[::10])  # one each second
    assert find_delay(pairs(bows), rare, LENS, FORWARD) is None
    timeless = [pair._replace(times=None) for pair in pairs(bows)]
    assert find_delay(timeless, bows, LENS, FORWARD) is None


def test_a_heading_of_the_wrong_sign_is_refused(tmp_path):
    seen = pairs(drive(tmp_path / "o.csv", 0.3))
    clockwise = drive(tmp_path / "o.csv", 0.3, sign=-1)
    with pytest.raises(ValueError, match=r"o.csv turns the other way than the pictures: give heading in rad"):
        find_delay(seen, clockwise, LENS, FORWARD)

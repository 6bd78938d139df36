"""Poses of a drive are read as they were meant, or refused in one line."""

from pathlib import Path

import numpy as np
import pytest

from eldenet.data.drive_poses import Mount, read_poses

MOUNT = Mount(0.4, 0.1, 0.2)


def odometry(path: Path, rows: np.ndarray, header: str = "seconds,x,y,heading") -> Path:
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def straight(count: int = 21) -> np.ndarray:
    """A robot that drives 2 m to the left, along y."""
    way = np.linspace(0, 2, count)
    return np.column_stack([way * 2, np.zeros(count), way, np.full(count, np.pi / 2)])


def test_the_camera_stands_on_the_robot_and_looks_ahead_and_down(tmp_path):
    poses = read_poses(odometry(tmp_path / "o.csv", straight()), MOUNT)
    camera = poses.cameras[10]
    np.testing.assert_allclose(camera[:3, 3], [0.0, 1.2, 0.4], atol=1e-9)
    right, down, forward = camera[:3, :3].T
    np.testing.assert_allclose(forward, [0.0, np.cos(0.1), -np.sin(0.1)], atol=1e-9)
    np.testing.assert_allclose(right, [1.0, 0.0, 0.0], atol=1e-9)
    assert down[2] < 0


def test_a_pose_between_two_rows_is_interpolated_also_across_half_a_turn(tmp_path):
    rows = straight()
    rows[:, 3] = np.where(np.arange(21) % 2, np.pi - 0.1, -np.pi + 0.1)
    poses = read_poses(odometry(tmp_path / "o.csv", rows), MOUNT)
    camera = poses.at(0.1)
    assert camera is not None
    np.testing.assert_allclose(camera[:3, 2], [-np.cos(0.1), 0.0, -np.sin(0.1)], atol=1e-6)
    assert poses.at(-0.1) is None
    assert poses.at(4.1) is None


def test_no_pose_is_made_up_in_a_gap(tmp_path):
    rows = np.delete(straight(), range(8, 14), axis=0)
    poses = read_poses(odometry(tmp_path / "o.csv", rows), MOUNT)
    assert poses.at(2.0) is None
    assert poses.at(0.5) is not None


def matrices(path: Path, count: int = 12, scale: float = 1.0) -> Path:
    header = "rgb," + ",".join(f"m{i}{j}" for i in range(3) for j in range(4))
    poses = np.tile(np.eye(4)[:3], (count, 1, 1))
    poses[:, 2, 3] = 0.2 * scale * np.arange(count)
    lines = [f"place/{i:02d}.jpg," + ",".join(map(str, pose.ravel())) for i, pose in enumerate(poses)]
    path.write_text("\n".join([header, *lines]))
    return path


def test_camera_poses_belong_to_the_pictures_that_they_name(tmp_path):
    poses = read_poses(matrices(tmp_path / "p.csv"))
    found = poses.of_pictures([Path(f"shots/{i:02d}.jpg") for i in (3, 5, 99)])
    assert found[0] is not None
    assert found[0][2, 3] == pytest.approx(0.6)
    assert found[2] is None
    with pytest.raises(
        ValueError, match=r"poses of 0 of 2 pictures, such as place/00.jpg: name pictures such"
    ):
        poses.of_pictures([Path("a.jpg"), Path("b.jpg")])


def test_two_rows_of_one_picture_are_refused(tmp_path):
    """Such as those of two cameras, whose folders name their pictures alike."""
    table = matrices(tmp_path / "p.csv")
    table.write_text(table.read_text().replace("place/07.jpg", "other/03.jpg"))
    with pytest.raises(ValueError, match=r"p.csv has 03.jpg in several rows: give one row per picture"):
        read_poses(table).of_pictures([Path(f"shots/{i:02d}.jpg") for i in range(12)])


def test_poses_of_slam_in_tum_s_format_are_those_of_their_matrices(tmp_path):
    turned = "0 0.7071068 0 0.7071068"  # the camera looks along the world's x
    lines = [f"{1700000000 + 0.1 * i:.1f} {0.2 * i:.1f} 0 1.5 {turned}" for i in range(12)]
    path = tmp_path / "KeyFrameTrajectory.txt"
    path.write_text("\n".join(["# timestamp tx ty tz qx qy qz qw", *lines]))
    poses = read_poses(path)
    np.testing.assert_allclose(poses.cameras[3][:3, 3], [0.6, 0.0, 1.5])
    np.testing.assert_allclose(poses.cameras[3][:3, 2], [1.0, 0.0, 0.0], atol=1e-6)
    assert poses.at(1700000000.25)[0, 3] == pytest.approx(0.5)
    with pytest.raises(ValueError, match="leave out camera_height"):
        read_poses(path, MOUNT)
    path.write_text("\n".join(line.replace(turned, "1 1 1 1") for line in lines))
    with pytest.raises(ValueError, match="no unit quaternions"):
        read_poses(path)
    path.write_text(
        "\n".join(["# timestamp tx ty tz qx qy qz qw", "", *lines[:3], f"lost 0.8 0 1.5 {turned}"])
    )
    with pytest.raises(ValueError, match=r"line 6: seconds is 'lost'"):
        read_poses(path)


def test_rows_without_names_are_one_for_each_picture(tmp_path):
    rows = straight()[:, 1:]
    poses = read_poses(odometry(tmp_path / "o.csv", rows, "x,y,heading"), MOUNT)
    assert len(poses.of_pictures([Path(f"{i}.png") for i in range(21)])) == 21
    with pytest.raises(ValueError, match=r"has 21 poses for 20 pictures: give one row per picture"):
        poses.of_pictures([Path(f"{i}.png") for i in range(20)])


def changed(column: int, change) -> np.ndarray:
    rows = straight()
    rows[:, column] = change(rows[:, column])
    return rows


def spoiled() -> np.ndarray:
    rows = straight()
    rows[4, 2] = np.nan
    return rows


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (changed(2, lambda y: 1000 * y), r"moves 500 m per second: give meters; divide millimeters by 1000"),
        (changed(2, lambda y: 0 * y), r"moves 0 m: drive at least 1 m"),
        (
            np.column_stack([np.arange(9), np.zeros((9, 2)), np.arange(9)]),
            r"moves 0 m and turns 458 degrees: .*turning on the spot shows none",
        ),
        (
            changed(3, lambda heading: np.arange(21) * 30.0),
            r"turns 7.08 rad per second: give heading in radians",
        ),
        (changed(0, lambda seconds: seconds[::-1]), r"seconds do not increase after"),
        (spoiled(), r"line 6: y is 'nan': give a finite number"),
        (straight()[:1], r"has 1 poses"),
    ],
)
def test_a_drive_that_shows_no_depth_is_refused(tmp_path, rows, said):
    with pytest.raises(ValueError, match=said):
        read_poses(odometry(tmp_path / "o.csv", rows), MOUNT)


def test_other_columns_and_a_mount_of_camera_poses_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"has the columns 't,x,y,yaw': give seconds,x,y,heading"):
        read_poses(odometry(tmp_path / "o.csv", straight(), "t,x,y,yaw"), MOUNT)
    with pytest.raises(ValueError, match=r"poses of the camera itself: leave out camera_height"):
        read_poses(matrices(tmp_path / "p.csv"), MOUNT)
    with pytest.raises(ValueError, match=r"moves 200 m from row to row: give meters"):
        read_poses(matrices(tmp_path / "p.csv", scale=1000))

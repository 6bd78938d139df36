"""KITTI's calibration and scans: points to the last digit, errors that name the file."""

from pathlib import Path

import numpy as np
import pytest
from support.layouts import DRIVES, FOCAL, kitti_calibration, kitti_raw, kitti_scan

from eldenet.data.kitti import KITTIRaw
from eldenet.data.kitti_lidar import project_scan, rectified_intrinsics, velodyne_to_image
from eldenet.geometry import back_project


def test_partial_calibration_and_missing_keys(tmp_path: Path) -> None:
    kitti_calibration(tmp_path, "2011_09_26", partial=True)
    folder = tmp_path / "2011_09_26"
    assert rectified_intrinsics(folder, 2)[0, 0] == FOCAL["2011_09_26"]
    with pytest.raises(
        ValueError, match=r"calib_cam_to_cam\.txt has no 'R_rect_00', only P_rect_02, P_rect_03"
    ):
        velodyne_to_image(folder, 2)
    with pytest.raises(ValueError, match="has no 'P_rect_01'"):
        rectified_intrinsics(folder, 1)
    (folder / "calib_cam_to_cam.txt").write_text("P_rect_02: 721 0 609\n")
    with pytest.raises(ValueError, match="P_rect_02 has 3 numbers, wanted 12"):
        rectified_intrinsics(folder, 2)
    (folder / "calib_cam_to_cam.txt").write_text("P_rect_02: 0 0 0 0 0 0 0 0 0 0 0 0\n")
    with pytest.raises(ValueError, match="no focal length"):
        rectified_intrinsics(folder, 2)
    (folder / "calib_cam_to_cam.txt").write_text("")
    with pytest.raises(ValueError, match="no line 'key: numbers'"):
        rectified_intrinsics(folder, 2)


def by_hand(points: np.ndarray, matrix: np.ndarray, size: tuple[int, int], *, eigen: bool) -> np.ndarray:
    """Point by point, in the order of the file."""
    depth = np.zeros(size)
    for x, y, z, _ in points.astype(np.float64):
        u, v, w = matrix @ (x, y, z, 1)
        if x < 0 or w <= 0:
            continue
        col, row = round(u / w) - eigen, round(v / w) - eigen
        meters = x if eigen else w
        if 0 <= row < size[0] and 0 <= col < size[1] and not 0 < depth[row, col] <= meters:
            depth[row, col] = meters
    return depth


@pytest.mark.parametrize("projection", ["camera", "eigen"])
def test_projection_equals_point_by_point(tmp_path: Path, projection: str) -> None:
    data = KITTIRaw(kitti_raw(tmp_path), split="all", projection=projection)
    assert data.names == [f"{drive}/image_02/0000000069" for drive in DRIVES]
    assert data.ground_truth == "sparse"
    matrix = velodyne_to_image(tmp_path / "2011_09_26", 2)
    expected = by_hand(kitti_scan(DRIVES[0]), matrix, (375, 1242), eigen=projection == "eigen")
    frame = data.load_frame(0)
    np.testing.assert_array_equal(frame.depth, expected.astype(np.float32))
    assert 0.005 < (frame.depth > 0).mean() < 0.1
    if projection == "camera":  # back in space, a point is where the scan has it, up to half a pixel
        assert frame.intrinsics is not None
        points = back_project(frame.depth, frame.intrinsics)[frame.depth > 0]
        assert np.isfinite(points).all()


def test_nearest_wins_whatever_the_order() -> None:
    matrix = np.array([[100.0, 0, 0, 0], [0, 100, 0, 0], [0, 0, 1, 0]]) @ np.array(
        [[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]]
    )
    points = np.array([[20.0, -2, -2], [10, -1, -1], [30, -3, -3], [-5, 1, 1]])
    for order in ([0, 1, 2, 3], [2, 1, 0, 3], [1, 2, 0, 3]):
        depth = project_scan(points[order], matrix, (20, 20))
        assert depth[10, 10] == 10
        assert np.count_nonzero(depth) == 1

"""KITTI's object files: labels, results, calibration and scans."""

from pathlib import Path

import numpy as np
import pytest

from eldenet.boxes import Boxes3D
from eldenet.geometry import PinholeCamera
from eldenet.perception.kitti_object import KittiObjects, read_labels, to_labels, write_labels

CAR = "Car 0.00 0 1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 1.62"


def test_labels_are_read_and_written(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(CAR + "\nDontCare -1 -1 -10 5 229 214 367 -1 -1 -1 -1000 -1000 -1000 -10\n")
    read = read_labels(path)
    assert read.types == ("Car", "DontCare")
    np.testing.assert_allclose(read.size[0], [4.15, 1.73, 1.57])
    np.testing.assert_allclose(read.boxes.bottom_center[0], [1.00, 1.75, 13.22])
    write_labels(tmp_path / "b.txt", read)
    again = read_labels(tmp_path / "b.txt")
    for name in ("xyxy", "size", "location", "yaw", "occluded"):
        np.testing.assert_allclose(getattr(again, name), getattr(read, name), atol=1e-4)


def test_boxes_survive_a_result_file(tmp_path):
    rng = np.random.default_rng(0)
    boxes = Boxes3D(
        rng.uniform([-5, 0, 5], [5, 2, 30], (6, 3)), rng.uniform(1, 4, (6, 3)), rng.uniform(-3, 3, 6),
        rng.random(6), np.arange(6) % 2, ("car", "person"),
    )  # fmt: skip
    write_labels(tmp_path / "r.txt", to_labels(boxes, np.zeros((6, 4))))
    back = read_labels(tmp_path / "r.txt")
    assert set(back.types) == {"Car", "Pedestrian"}
    np.testing.assert_allclose(back.boxes.center, boxes.center, atol=2e-4)
    np.testing.assert_allclose(back.score, boxes.score, atol=1e-4)
    assert (tmp_path / "r.txt").read_text().splitlines()[0].count(" ") == 15


def test_a_doubtful_box_is_marked_as_of_unknown_occlusion():
    boxes = Boxes3D(
        np.array([[0.0, 0, 9], [2, 0, 9]]), np.ones((2, 3)), np.zeros(2), np.ones(2), np.zeros(2, int),
        ("car",), {"doubtful": np.array([0.0, 1.0])},
    )  # fmt: skip
    assert to_labels(boxes, np.zeros((2, 4))).occluded.tolist() == [-1, 3]


def test_results_have_the_axes_of_the_camera():
    """For a camera that looks down by 0.12 rad: by hand, and as the benchmark projects them."""
    c, s = np.cos(0.12), np.sin(0.12)
    camera = PinholeCamera(
        np.array([[400.0, 0, 320], [0, 400, 100], [0, 0, 1]]), np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    )
    boxes = Boxes3D(
        np.array([[-2.0, 0.85, 12.0]]), np.array([[4.0, 1.6, 1.5]]), np.array([0.4]), np.ones(1),
        np.zeros(1, int), ("car",),
    )  # fmt: skip
    given = to_labels(boxes, np.zeros((1, 4)), camera.rotation)
    np.testing.assert_allclose(given.location[0], [-2, 1.6 * c - 12 * s, 1.6 * s + 12 * c], atol=1e-9)
    projected = np.append(given.location[0], 1) @ np.column_stack([camera.intrinsics, np.zeros(3)]).T
    np.testing.assert_allclose(projected[:2] / projected[2], camera.project(boxes.bottom_center)[0])
    front = camera.rotation.T @ np.array([np.cos(0.4), 0, -np.sin(0.4)])
    assert given.yaw[0] == pytest.approx(np.arctan2(-front[2], front[0]))
    np.testing.assert_allclose(given.alpha, given.yaw - np.arctan2(*given.location[0, [0, 2]]))


@pytest.mark.parametrize("line", ["Car 1 2 3", CAR.replace("13.22", "far"), CAR + " 1 2"])
def test_wrong_lines_are_named(line, tmp_path):
    (tmp_path / "a.txt").write_text(f"{CAR}\n{line}\n")
    with pytest.raises(ValueError, match="line 2"):
        read_labels(tmp_path / "a.txt")


def test_empty_files_have_no_objects_and_missing_ones_are_named(tmp_path):
    (tmp_path / "a.txt").write_text("")
    assert len(read_labels(tmp_path / "a.txt")) == 0
    with pytest.raises(FileNotFoundError):
        read_labels(tmp_path / "b.txt")
    with pytest.raises(FileNotFoundError, match="image_2"):
        KittiObjects(tmp_path)


def test_a_scan_lands_where_the_calibration_says(tmp_path):
    import cv2

    for name in ("image_2", "calib", "label_2", "velodyne"):
        (tmp_path / name).mkdir()
    cv2.imwrite(str(tmp_path / "image_2/000000.png"), np.zeros((100, 200, 3), np.uint8))
    (tmp_path / "label_2/000000.txt").write_text(CAR + "\n")
    calibration = tmp_path / "calib/000000.txt"
    calibration.write_text(
        "P2: 100 0 100 0 0 100 50 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
        "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
    )
    scan = np.array([[10, 0, 0, 1], [5, 0, 0, 1], [10, 2, -1, 1], [-5, 0, 0, 1]], np.float32)  # x forward
    scan.tofile(tmp_path / "velodyne/000000.bin")
    kitti = KittiObjects(tmp_path)
    depth = kitti.lidar_depth("000000", (100, 200))
    assert depth is not None
    assert depth[50, 100] == 5  # the nearer of two on one pixel
    assert depth[60, 80] == 10  # 2 m left, 1 m below
    assert np.count_nonzero(depth) == 2
    (tmp_path / "velodyne/000000.bin").unlink()
    assert kitti.lidar_depth("000000", (100, 200)) is None
    calibration.write_text("P0: 1 2 3\n")
    with pytest.raises(ValueError, match="P2"):
        kitti.camera("000000")


def test_kittis_classes_have_the_same_label_in_every_file(tmp_path):
    lines = {kind: f"{kind} 0 0 0 1 1 9 9 1.5 1.6 4 0 1 9 0" for kind in ("Car", "Pedestrian", "Rickshaw")}
    numbers = []
    for kinds in (("Car", "Pedestrian"), ("Pedestrian", "Rickshaw", "Car")):
        path = tmp_path / "-".join(kinds)
        path.write_text("\n".join(lines[kind] for kind in kinds))
        found = read_labels(path)
        assert found.boxes.classes == found.detections.classes == list(kinds)
        numbers.append(dict(zip(kinds, found.boxes.label.tolist(), strict=True)))
    assert numbers[0]["Car"] == numbers[1]["Car"]
    assert numbers[0]["Pedestrian"] == numbers[1]["Pedestrian"]


def test_kittis_2d_labels_are_projections_of_its_3d_labels():
    import os

    if not os.environ.get("ELDENET_DATA") or not (Path(os.environ["ELDENET_DATA"]) / "kitti/object").is_dir():
        pytest.skip("set ELDENET_DATA: KITTI's object frames")
    kitti = KittiObjects()
    assert "000008" in kitti.names
    for name in kitti.names:
        truth = kitti.labels(name)
        truth = truth.select(np.array([kind in ("Car", "Van", "Pedestrian") for kind in truth.types]))
        whole = truth.select((truth.truncated == 0) & (truth.occluded <= 1))
        if not len(whole):
            continue
        # the labels' 2D boxes are projections of their 3D boxes
        projected = whole.boxes.project(kitti.camera(name), kitti.image(name).shape[:2])
        np.testing.assert_allclose(projected, whole.xyxy, atol=12)
        assert np.median(np.abs(projected - whole.xyxy)) < 2.5

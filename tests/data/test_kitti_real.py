"""Real KITTI frames: the devkit's, scans against derived maps, the selection, calibration."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.layouts import devkit_meters, real_folder

from eldenet.data.kitti import KITTIDepth, KITTIRaw, KITTISelection
from eldenet.data.kitti_calibration import (
    entry,
    project_scan,
    read_scan,
    rectified_intrinsics,
    velodyne_to_image,
)


@pytest.fixture
def real() -> Path:
    return real_folder("kitti", "raw")


def test_real_devkit_frames(real: Path) -> None:
    data = KITTIDepth(split="all")
    files = sorted((real / "depth").rglob("groundtruth/image_02/*.png"))
    assert len(data) == len(files) > 0
    for i, file in enumerate(files):
        frame = data.load_frame(i)
        np.testing.assert_array_equal(frame.depth.astype(np.float64), devkit_meters(file))
        assert 0.1 < (frame.depth > 0).mean() < 0.4
        picture_file = data.frame_files(i)[0]
        np.testing.assert_array_equal(frame.image, cv2.imread(str(picture_file))[..., ::-1])
        assert frame.intrinsics is not None
        np.testing.assert_allclose(frame.intrinsics[:2, 2], [609.5593, 172.854])


def test_real_derived_maps_with_raw_pictures(real: Path) -> None:
    """The derived maps lie as the merged devkit does."""
    data = KITTIDepth(real / "depth_derived", depth="velodyne_raw", split="all")
    assert len(data) == 20
    for i, file in enumerate(file for _, file in data.files):
        np.testing.assert_array_equal(data.load_frame(i).depth.astype(np.float64), devkit_meters(file))


def test_real_scans_give_back_the_derived_maps(real: Path) -> None:
    data = KITTIRaw(split="all")
    assert len(data) > 0
    for i, name in enumerate(data.names):
        drive, camera, number = name.split("/")
        file = real / "depth_derived" / drive / "proj_depth/velodyne_raw" / camera / f"{number}.png"
        derived = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        # in double: in single precision a handful of points change sides of half a step of 1/256 m
        matrix = velodyne_to_image(real / "raw" / drive[:10], 2)
        depth = project_scan(read_scan(data.frame_files(i)[1]), matrix, derived.shape)
        np.testing.assert_array_equal(np.round(depth * 256).astype(np.uint16), derived)
        frame = data.load_frame(i)
        np.testing.assert_array_equal(frame.depth, depth.astype(np.float32))
        np.testing.assert_array_equal(frame.depth > 0, derived > 0)


def test_real_object_scans_give_back_the_derived_maps(real: Path) -> None:
    """The 3D-object set names its matrices otherwise; the projection is the same."""
    done = 0
    for file in sorted((real / "depth_derived/object/training").glob("*.png")):
        scan = next((real / "object/training").glob(f"velodyne*/{file.stem}.bin"))
        calib = real / f"object/training/calib/{file.stem}.txt"
        rotation, rigid = np.eye(4), np.eye(4)
        rotation[:3, :3] = entry(calib, "R0_rect", (3, 3))
        rigid[:3] = entry(calib, "Tr_velo_to_cam", (3, 4))
        matrix = entry(calib, "P2", (3, 4)) @ rotation @ rigid
        derived = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
        depth = project_scan(read_scan(scan), matrix, derived.shape)
        np.testing.assert_array_equal(np.round(depth * 256).astype(np.uint16), derived)
        done += 1
    assert done > 0


def test_real_selection(real: Path) -> None:
    options: dict[str, Any] = {"frames": None, "calibration": "optional"}
    for depth, count in (("velodyne_raw", 2), ("groundtruth", 1)):
        data = KITTISelection(depth=depth, on_error="skip", **options)
        assert len(data) == count
        for i, file in enumerate(file for _, file in data.files):
            frame = data.load_frame(i)
            assert frame.image.shape == (352, 1216, 3)
            np.testing.assert_array_equal(frame.depth.astype(np.float64), devkit_meters(file))
    with pytest.raises(FileNotFoundError, match=r"0000000003 \(no depth\)"):
        KITTISelection(**options)


@pytest.mark.parametrize(
    ("date", "fx", "cx", "cy"),
    [("2011_09_26", 721.5377, 609.5593, 172.854), ("2011_10_03", 718.856, 607.1928, 185.2157)],
)
def test_real_calibration(real: Path, date: str, fx: float, cx: float, cy: float) -> None:
    matrix = rectified_intrinsics(real / "raw" / date, 2)
    np.testing.assert_array_equal(matrix, [[fx, 0, cx], [0, fx, cy], [0, 0, 1]])
    if date == "2011_10_03":
        with pytest.raises(FileNotFoundError, match=r"calib_velo_to_cam\.txt does not exist"):
            velodyne_to_image(real / "raw" / date, 2)

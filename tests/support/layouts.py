"""Tiny data sets in the layouts that people have on disk, written by the tests."""

import json
import os
from pathlib import Path
from typing import NamedTuple

import cv2
import h5py
import numpy as np
import pytest
from scipy.io import savemat


class Content(NamedTuple):
    """One frame as the layouts store it: color, depth [m], [mm] with holes, and in eight bits over 10 m."""

    rgb: np.ndarray
    meters: np.ndarray
    millimeters: np.ndarray
    eight: np.ndarray


def content(size: tuple[int, int] = (48, 64)) -> Content:
    meters = np.random.default_rng(0).uniform(0.7, 9.9, size).astype(np.float32)
    rgb = np.zeros((*size, 3), np.uint8)
    half = size[1] // 2
    rgb[:, :half], rgb[:, half:] = (200, 30, 30), (30, 200, 90)
    millimeters = np.round(meters * 1000).astype(np.uint16)
    millimeters[5:9, 7:20] = 0
    return Content(rgb, meters, millimeters, np.round(meters / 10 * 255).astype(np.uint8))


SMALL = content()


def picture(path: Path, array: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), array[..., ::-1] if array.ndim == 3 else array)


def densedepth(root: Path, frame: Content = SMALL) -> Path:
    rows = []
    for scene in ("kitchen_0001_out", "office_0002_out"):
        picture(root / f"data/nyu2_train/{scene}/1.jpg", frame.rgb)
        picture(root / f"data/nyu2_train/{scene}/1.png", frame.eight)
        rows.append(f"data/nyu2_train/{scene}/1.jpg,data/nyu2_train/{scene}/1.png\n")
    (root / "data/nyu2_train.csv").write_text("".join(rows))
    picture(root / "data/nyu2_test/00000_colors.png", frame.rgb)
    picture(root / "data/nyu2_test/00000_depth.png", frame.millimeters)
    (root / "data/nyu2_test.csv").write_text(
        "data/nyu2_test/00000_colors.png,data/nyu2_test/00000_depth.png\n"
    )
    return root


def labeled(root: Path, frame: Content = SMALL, numbers: tuple[int, ...] = (3, 22, 23, 30)) -> Path:
    rows = []
    for n in numbers:
        stem = f"data/nyu2_train/labeled_out/{n:04d}"
        picture(root / f"{stem}.jpg", frame.rgb)
        picture(root / f"{stem}.png", frame.eight)
        rows.append(f"{stem}.jpg,{stem}.png\n")
    (root / "data/nyu2_train.csv").write_text("".join(rows))
    return root


SYNC_FRAMES = (("kitchen_0001", "00000"), ("office_0002", "00041"))


def sync(root: Path, frame: Content = SMALL, frames: tuple[tuple[str, str], ...] = SYNC_FRAMES) -> Path:
    for scene, number in frames:
        picture(root / scene / f"rgb_{number}.jpg", frame.rgb)
        picture(root / scene / f"sync_depth_{number}.png", frame.millimeters)
    return root


def hdf5(root: Path, frame: Content = SMALL) -> Path:
    for name in ("train/kitchen_0001/00001", "train/office_0002/00001", "val/official/00002"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        with h5py.File(root / f"{name}.h5", "w") as file:
            file["rgb"], file["depth"] = frame.rgb.transpose(2, 0, 1), frame.meters
    return root


def mat(root: Path, frame: Content = SMALL, count: int = 4) -> Path:
    root.mkdir(parents=True, exist_ok=True)
    raw = frame.meters.copy()
    raw[5:9, 7:20] = 0
    with h5py.File(root / "nyu_depth_v2_labeled.mat", "w") as file:
        file["images"] = np.stack([(frame.rgb + i).transpose(2, 1, 0) for i in range(count)]).astype(np.uint8)
        file["depths"] = np.stack([(frame.meters + i).T for i in range(count)])
        file["rawDepths"] = np.stack([raw.T for _ in range(count)])
    mat_split(root, train=(2, 3), test=(1, 4))
    return root


def mat_split(root: Path, *, train: tuple[int, ...], test: tuple[int, ...]) -> None:
    numbers = {"trainNdxs": train, "testNdxs": test}
    savemat(root / "splits.mat", {name: np.array([part], np.uint16).T for name, part in numbers.items()})


def folder(root: Path, frame: Content = SMALL, count: int = 10) -> Path:
    for i in range(count):
        picture(root / f"images/f{i:03d}.png", frame.rgb)
        picture(root / f"depths/f{i:03d}.png", frame.millimeters)
    return root


CAMERA = {  # the keys and the size of numbers of an official file
    "extrinsic": {"baseline": 0.209313, "pitch": 0.038, "roll": 0.0, "yaw": -0.0195, "x": 1.7, "z": 1.22},
    "intrinsic": {"fx": 2262.52, "fy": 2265.3017905988554, "u0": 1096.98, "v0": 513.137},
}
CITIES = {"train": ("aachen", "darmstadt", "ulm"), "val": ("munster",), "test": ("berlin",)}


def disparity_of(meters: np.ndarray, camera: dict = CAMERA) -> np.ndarray:
    """An official disparity picture: round(256 d) + 1, holes 0."""
    focal = camera["extrinsic"]["baseline"] * camera["intrinsic"]["fx"]
    steps = np.round(256 * focal / np.where(meters > 0, meters, 1)) + 1
    return np.where(meters > 0, steps, 0).astype(np.uint16)


def cityscapes(root: Path, frame: Content = SMALL, place: str = "{kind}", camera: dict = CAMERA) -> Path:
    """Official files; ``place`` says where a zip was unpacked."""
    disparity = disparity_of(frame.meters * 5, camera)
    disparity[5:9, 7:20] = 0
    for part, cities in CITIES.items():
        for city in cities:
            stem = f"{part}/{city}/{city}_000000_000019"
            picture(root / place.format(kind="leftImg8bit") / f"{stem}_leftImg8bit.png", frame.rgb)
            picture(root / place.format(kind="disparity") / f"{stem}_disparity.png", disparity)
            file = root / place.format(kind="camera") / f"{stem}_camera.json"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(camera))
    return root


def gt_fine(root: Path, ids: np.ndarray) -> None:
    """The label ids of every frame of :func:`cityscapes`."""
    for part, cities in CITIES.items():
        for city in cities:
            picture(root / f"gtFine/{part}/{city}/{city}_000000_000019_gtFine_labelIds.png", ids)


def cityscapes_mtan(root: Path, size: tuple[int, int] = (128, 256), count: int = 4) -> Path:
    """MTAN's arrays: v = p / 65535."""
    meters = np.random.default_rng(0).uniform(4, 70, (*size, 1))
    meters[5:9, 7:20] = 0
    steps = 0.22 * 2262.52 * 256 / np.where(meters > 0, meters, 1) + 1
    for part in ("train", "val"):
        for kind in ("image", "depth"):
            (root / part / kind).mkdir(parents=True, exist_ok=True)
        for number in range(count):
            image = np.full((*size, 3), (0.2, 0.4, 0.6))
            np.save(root / f"{part}/image/{number}.npy", image)
            np.save(
                root / f"{part}/depth/{number}.npy", np.where(meters > 0, steps / 65535, 0).astype(np.float32)
            )
    return root


# --- KITTI ------------------------------------------------------------------------------------------------

DRIVES = ("2011_09_26_drive_0001_sync", "2011_09_26_drive_0002_sync", "2011_09_28_drive_0003_sync")
VAL_DRIVE = "2011_09_26_drive_0005_sync"
KITTI_SIZES = {"2011_09_26": (375, 1242), "2011_09_28": (370, 1224)}
FOCAL = {"2011_09_26": 721.5377, "2011_09_28": 707.0493}


class KITTIContent(NamedTuple):
    """One frame of a drive: color, and depth as the file holds it (1/256 m, 0 = unknown)."""

    rgb: np.ndarray
    steps: np.ndarray


def kitti_frame(drive: str) -> KITTIContent:
    height, width = KITTI_SIZES[drive[:10]]
    generator = np.random.default_rng(int(drive[-9:-5]))
    steps = np.where(
        generator.random((height, width)) < 0.05, generator.integers(1300, 19000, (height, width)), 0
    )
    rgb = np.zeros((height, width, 3), np.uint8)
    rgb[..., 0], rgb[..., 1] = np.arange(height)[:, None] % 256, np.arange(width)[None] % 256
    return KITTIContent(rgb, steps.astype(np.uint16))


def kitti_calibration(raw: Path, date: str, *, partial: bool = False) -> None:
    """The files of one date; the partial one holds the projections alone."""
    fx = FOCAL.get(date, 721.5377)
    lines = ["calib_time: 09-Jan-2012 13:57:47"]
    for camera, offset in ((2, 44.85728), (3, -339.5242)):
        rows = f"{fx} 0 609.5593 {offset} 0 {fx} 172.854 0.2163791 0 0 1 0.002745884"
        lines.append(f"P_rect_{camera:02d}: {rows}")
    if not partial:
        lines.append("R_rect_00: 1 0 0 0 1 0 0 0 1")
        (raw / date).mkdir(parents=True, exist_ok=True)
        (raw / date / "calib_velo_to_cam.txt").write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.0763 -0.2717\n")
    (raw / date).mkdir(parents=True, exist_ok=True)
    (raw / date / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")


def kitti_pictures(raw: Path, drive: str, numbers: tuple[int, ...], ending: str = ".png") -> None:
    for number in numbers:
        path = raw / drive[:10] / drive / f"image_02/data/{number:010d}{ending}"
        picture(path, kitti_frame(drive).rgb)


def kitti_depth(root: Path, *, kind: str = "groundtruth", numbers: tuple[int, ...] = (5,)) -> Path:
    """The devkit with train and val, KITTI raw beside it; pictures begin five frames before the maps."""
    for drive in (*DRIVES, VAL_DRIVE):
        part = "val" if drive == VAL_DRIVE else "train"
        for number in numbers:
            name = f"{part}/{drive}/proj_depth/{kind}/image_02/{number:010d}.png"
            picture(root / "depth" / name, kitti_frame(drive).steps)
        kitti_pictures(root / "raw", drive, (0, *numbers))
        kitti_calibration(root / "raw", drive[:10])
    return root / "depth"


def kitti_scan(drive: str) -> np.ndarray:
    """Points all around the car, float32 x, y, z, reflectance."""
    generator = np.random.default_rng(int(drive[-9:-5]))
    points = generator.uniform((-40, -20, -2, 0), (70, 20, 1, 1), (20000, 4))
    return points.astype(np.float32)


def kitti_raw(root: Path, drives: tuple[str, ...] = DRIVES) -> Path:
    for drive in drives:
        kitti_pictures(root, drive, (0, 69))
        kitti_calibration(root, drive[:10])
        scan = root / drive[:10] / drive / "velodyne_points/data/0000000069.bin"
        scan.parent.mkdir(parents=True, exist_ok=True)
        kitti_scan(drive).tofile(scan)
    return root


def kitti_selection(root: Path, numbers: tuple[int, ...] = (5, 8), *, intrinsics: bool = True) -> Path:
    folder, drive = root / "val_selection_cropped", VAL_DRIVE
    rgb, steps = (part[23:, 13:1229] for part in kitti_frame(drive))
    for number in numbers:
        name = f"{number:010d}_image_02"
        picture(folder / f"image/{drive}_image_{name}.png", rgb)
        for kind in ("groundtruth_depth", "velodyne_raw"):
            picture(folder / f"{kind}/{drive}_{kind}_{name}.png", steps)
        if intrinsics:
            file = folder / f"intrinsics/{drive}_image_{name}.txt"
            file.parent.mkdir(exist_ok=True)
            file.write_text("721.5377 0 596.5593 0 721.5377 149.854 0 0 1")
    return root


def eigen_list(path: Path, drives: tuple[str, ...], number: int = 5, none: tuple[str, ...] = ()) -> Path:
    """Lines as BTS writes them; drives in ``none`` have no improved ground truth."""
    lines = []
    for drive in drives:
        depth = f"{drive}/proj_depth/groundtruth/image_02/{number:010d}.png"
        where = f"{drive[:10]}/{drive}/image_02/data/{number:010d}.png"
        lines.append(f"{where} {'None' if drive in none else depth} 721.5377\n")
    path.write_text("".join(lines))
    return path


def devkit_meters(path: Path) -> np.ndarray:
    """Meters as the devkit's readme says."""
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float64) / 256


def real_folder(place: str, holds: str) -> Path:
    """``$ELDENET_DATA/<place>`` with real frames; a test without them is skipped and says why."""
    if not os.environ.get("ELDENET_DATA"):
        pytest.skip("ELDENET_DATA is not set: no real data to read")
    root = Path(os.environ["ELDENET_DATA"]) / place
    if not (root / holds).exists():
        pytest.skip(f"{root / holds} is not there")
    return root

"""Places to adapt to, as folders of pictures and depth in the order of time.

Rendered places are rooms of the split "test" (for the choice of the recipe: "val") seen by one camera of
another lens and light than any training frame. Real places are those of ``$ELDENET_DATA/other_cameras``.
"""

import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from eldenet.geometry import pinhole
from eldenet.simulation.furnished_rooms.rooms import generate_room
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.camera_noise import develop
from eldenet.simulation.rendering.mjcf import Draw
from eldenet.simulation.rendering.shading import CompiledRoom

SIZE = (120, 160)  # (height, width) of rendered frames [px]
NEAREST = 0.4  # [m]: of the view, for a camera to stand there
ROOMS, STANDS, TURNS = 10, 4, 5  # a place: its rooms, spots in each, frames that turn at each spot


@dataclass(frozen=True)
class Camera:
    """A camera that goes through rendered rooms.

    Attributes:
        height: above the floor [m].
        focal: fx in widths of the picture; training frames have 0.76 to 0.88.
        pitch: upward [rad].
        lamps: factors of the lamps' red, green and blue.
        ambient: share of light from everywhere; training rooms have 0.35 to 0.65.
    """

    height: float
    focal: float
    pitch: float
    lamps: tuple[float, float, float]
    ambient: float


#: Robots and hands; training frames are taken from 0.25 to 1.0 m and 1.2 to 1.8 m.
CAMERAS = {
    "robot_wide": Camera(0.45, 0.55, -0.10, (1.3, 0.9, 0.5), 0.25),
    "robot_tele": Camera(0.80, 1.20, -0.15, (0.7, 0.9, 1.3), 0.15),
    "hand_wide": Camera(1.40, 0.60, -0.30, (1.4, 0.8, 0.4), 0.20),
    "tall_tele": Camera(2.00, 1.10, -0.40, (0.8, 1.0, 1.2), 0.70),
}
#: Place of ``other_cameras`` -> fx, fy, cx, cy at half its size [px].
REAL = {
    "hololens_office": (220.25, 220.2, 119.55, 74.95),
    "tum_fr3_cabinet": (200.8, 202.2, 119.8, 92.6),
}


def write_place(name: str, folder: Path, split: str = "test") -> tuple[float, float, float, float]:
    """Write ``images/`` and ``depths/`` (16-bit PNG [mm]); return fx, fy, cx, cy [px]."""
    if not (folder / "done").is_file():
        if name in REAL:
            _copy(name, folder)
        else:
            render(CAMERAS[name], folder, split, list(CAMERAS).index(name))
        (folder / "done").touch()
    if name in REAL:
        return REAL[name]
    height, width = SIZE
    fx = CAMERAS[name].focal * width
    return fx, fx, (width - 1) / 2, (height - 1) / 2


def _copy(name: str, folder: Path) -> None:
    _make_folders(folder)
    root = Path(os.environ["ELDENET_DATA"]) / "other_cameras"
    lines = [line for line in (root / "pairs.csv").read_text().splitlines() if line.startswith(name)]
    for number, (image, depth) in enumerate(sorted(line.split(",")[:2] for line in lines)):
        picture, millimeters = (
            cv2.imread(str(root / image)),
            cv2.imread(str(root / depth), cv2.IMREAD_UNCHANGED),
        )
        size = (picture.shape[1] // 2, picture.shape[0] // 2)  # a quarter of the pixels, to save time
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / "images" / f"{number:04d}.png"), small)
        nearest = cv2.resize(millimeters, size, interpolation=cv2.INTER_NEAREST_EXACT)
        cv2.imwrite(str(folder / "depths" / f"{number:04d}.png"), nearest)


def _make_folders(folder: Path) -> None:
    for part in ("images", "depths"):
        (folder / part).mkdir(parents=True, exist_ok=True)


def render(
    camera: Camera, folder: Path, split: str, number: int, *, rooms: int = ROOMS, turns: int = TURNS
) -> None:
    """Write what a camera sees in rooms ``rooms * number`` and on of a split."""
    _make_folders(folder)
    height, width = SIZE
    fx = camera.focal * width
    ray_camera = RayCamera(SIZE, pinhole(fx, fx, (width - 1) / 2, (height - 1) / 2))
    probe = RayCamera((9, 12), np.diag([12 / width, 9 / height, 1.0]) @ ray_camera.intrinsics)
    written = 0
    for index in range(rooms * number, rooms * (number + 1)):
        room = generate_room(split, index)
        room.ambient = camera.ambient
        room.lights = [
            (*row[:3], *(a * b for a, b in zip(row[3:6], camera.lamps, strict=True)), row[6])
            for row in room.lights
        ]
        compiled = CompiledRoom(room)
        rng = np.random.default_rng((number, index))
        for _ in range(STANDS):
            position, yaw, near = _stand(compiled, probe, camera, rng)
            if near < NEAREST:
                continue
            for turn in range(turns):
                rotation = camera_rotation(yaw + 0.15 * turn, camera.pitch, rng.normal(0, 0.01))
                linear, hits = compiled.photograph(ray_camera, position, rotation)
                image = develop(linear, Draw((number, 7)), (number, index, written))  # one camera: one tone
                depth = np.rint(hits.depth.reshape(SIZE) * 1000).astype(np.uint16)
                cv2.imwrite(str(folder / "images" / f"{written:04d}.png"), image[..., ::-1])
                cv2.imwrite(str(folder / "depths" / f"{written:04d}.png"), depth)
                written += 1


def _stand(
    compiled: CompiledRoom, probe: RayCamera, camera: Camera, rng: np.random.Generator
) -> tuple[np.ndarray, float, float]:
    """Draw where the camera stands, where it looks, and how near the view is: the best of 20 [m]."""
    sx, sy, _ = compiled.room.size
    best = (np.array([0.0, 0.0, camera.height]), 0.0, -1.0)
    for _ in range(20):
        x, y = rng.uniform(-0.5, 0.5, 2) * (sx - 0.6, sy - 0.6)
        yaw = float(np.arctan2(-y, -x) + rng.uniform(-0.7, 0.7)) - 0.3
        if any(
            x0 - 0.2 < x < x1 + 0.2 and y0 - 0.2 < y < y1 + 0.2
            for x0, y0, x1, y1, _ in compiled.room.obstacles
        ):
            continue
        position = np.array([x, y, camera.height])
        depths = [
            probe.probe(compiled.model, compiled.data, position, camera_rotation(yaw + a, camera.pitch))[0]
            for a in (0.0, 0.6)
        ]
        near = float(np.partition(np.concatenate(depths), 8)[8])
        if near > best[2]:
            best = (position, yaw, near)
        if near > 0.7:
            break
    return best

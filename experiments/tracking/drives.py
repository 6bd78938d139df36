"""Rendered drives: streets and crossings whose objects move, seen by a camera that drives or stands.

The objects' depth and visible pixels are rendered; the detector and the errors of the depth are drawn.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.geometry import PinholeCamera, extent_of, pinhole
from eldenet.simulation.furnished_rooms.rooms import SPLITS
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation
from eldenet.simulation.rendering.shading import CompiledRoom
from eldenet.simulation.street_views import BOX_NAMES, FOCAL
from eldenet.simulation.streets import FAR, generate_scene

SIZE = (128, 416)
SECONDS = 0.1  # between frames
SPEEDS = {
    "person": (0.8, 1.8),
    "cyclist": (3.0, 6.0),
    "car": (4.0, 10.0),
    "van": (4.0, 10.0),
    "truck": (4.0, 8.0),
}
ROAD = 3.6  # [m]: vehicles nearer to the camera's path drive, the others are parked
LEAST_PIXELS, LEAST_HEIGHT = 25, 7.0
VISIBLE = 0.3  # share of an object's 2D box that its pixels must fill to be found
MISSED, FALSE = 0.08, 0.1  # share of visible objects that are not found, false boxes per frame
REMEMBERED = 0.5  # [s]: after which an object's depth error is another one


@dataclass(frozen=True)
class Frame:
    """One frame of a drive.

    Attributes:
        depth: ``(H, W)`` [m], exact.
        instance: ``(H, W)`` number of the object, -1 elsewhere.
        numbers: ``(T,)`` of the visible objects.
        xyxy: ``(T, 4)`` their 2D boxes [px].
        detections: what a detector finds.
        error: ``(objects + 1,)`` standard normal, correlated in time; the last is the rest's.
    """

    depth: np.ndarray
    instance: np.ndarray
    numbers: np.ndarray
    xyxy: np.ndarray
    detections: Detections2D
    error: np.ndarray


def camera() -> PinholeCamera:
    height, width = SIZE
    focal = width * FOCAL["street"]
    return PinholeCamera(pinhole(focal, focal, (width - 1) / 2, (height - 1) * 0.47))


def drive(split: str, index: int, frames: int) -> Iterator[Frame]:
    """Yield the frames of a drive; every second camera stands still."""
    import mujoco

    scene = generate_scene(split, index, ("street", "crossing")[index % 2])
    compiled = CompiledRoom(scene.room)
    model, data = compiled.model, compiled.data
    rng = np.random.default_rng((SPLITS[split], index))
    count = len(scene.names)
    start = model.body_pos[1 : count + 1].copy()
    turn = data.xmat[1 : count + 1].reshape(-1, 3, 3)
    velocity = np.zeros((count, 3))
    for number, name in enumerate(scene.names):
        moves = name in ("person", "cyclist") or (name in SPEEDS and abs(start[number, 1]) < ROAD)
        if moves and rng.random() < 0.85:
            velocity[number] = rng.uniform(*SPEEDS[name]) * turn[number, :, 1]  # +y is the front
    own = 0.0 if index // 2 % 2 else rng.uniform(3.0, 8.0)
    lens = camera()
    rays = RayCamera(SIZE, lens.intrinsics, far=FAR["street"])
    owner = np.append(model.geom_bodyid - 1, -1)
    error = rng.normal(size=count + 1)
    keep = np.exp(-SECONDS / REMEMBERED)
    for step in range(frames):
        time = step * SECONDS
        model.body_pos[1 : count + 1] = start + velocity * time
        mujoco.mj_kinematics(model, data)
        position = np.array([own * time, 0.0, scene.camera_height])
        hits = rays.cast(model, data, position, camera_rotation(0.0, *scene.tilt))
        found = owner[hits.geom]
        instance = np.where(found < count, found, -1).reshape(SIZE)
        error = keep * error + np.sqrt(1 - keep**2) * rng.normal(size=count + 1)
        numbers, xyxy = visible(instance)
        detections = detect(rng, instance, numbers, xyxy, scene.names)
        yield Frame(hits.depth.astype(np.float32).reshape(SIZE), instance, numbers, xyxy, detections, error)


def visible(instance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers ``(T,)`` and 2D boxes ``(T, 4)`` of the objects that are large enough to count."""
    numbers, pixels = np.unique(instance[instance >= 0], return_counts=True)
    numbers = numbers[pixels >= LEAST_PIXELS]
    xyxy = np.array([extent_of(*np.nonzero(instance == number)) for number in numbers]).reshape(-1, 4)
    tall = xyxy[:, 3] - xyxy[:, 1] >= LEAST_HEIGHT
    return numbers[tall], xyxy[tall]


def detect(
    rng: np.random.Generator, instance: np.ndarray, numbers: np.ndarray, xyxy: np.ndarray, names: list[str]
) -> Detections2D:
    """Return shaken boxes of most visible objects, and now and then a box of nothing."""
    boxes, labels = [], []
    for number, box in zip(numbers, xyxy, strict=True):
        filled = (instance == number).sum() / np.prod(box[2:] - box[:2])
        if (
            filled < VISIBLE * (0.5 if names[number] in ("person", "cyclist") else 1.0)
            or rng.random() < MISSED
        ):
            continue
        side = np.tile(box[2:] - box[:2], 2)
        boxes.append(box + np.clip(rng.normal(0, 1, 4), -2, 2) * (0.4 + 0.02 * side))
        labels.append(BOX_NAMES.index(names[number]))
    if rng.random() < FALSE:
        middle = np.array([rng.uniform(40, SIZE[1] - 40), rng.uniform(55, 80)])
        half = np.array([rng.uniform(5, 20), rng.uniform(5, 12)])
        boxes.append(np.concatenate([middle - half, middle + half]))
        labels.append(0)
    table = np.array(boxes, float).reshape(-1, 4)
    last = np.array([SIZE[1], SIZE[0]] * 2) - 0.5
    table = np.clip(table, -0.5, last)
    return Detections2D(table, np.full(len(table), 0.9), np.array(labels, np.int64), BOX_NAMES)


def measured(frame: Frame, sigma: float) -> np.ndarray:
    """Return the depth ``(H, W)`` [m] with a relative error of ``sigma`` for each object."""
    return frame.depth * np.exp(sigma * frame.error[frame.instance]).astype(np.float32)

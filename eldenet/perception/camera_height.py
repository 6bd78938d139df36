"""The scale of weights for a camera whose height above a visible floor is known."""

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import eldenet
from eldenet.compose import listed
from eldenet.data.io import read_image
from eldenet.data.splits import evenly_spaced, val_blocks
from eldenet.deploy.prediction import Source
from eldenet.deploy.predictor import DepthPredictor, enlarged, for_camera
from eldenet.deploy.video_files import VideoFile
from eldenet.geometry import PinholeCamera, check_intrinsics, intrinsic_matrix, level_rotation, resize_image
from eldenet.perception.ground import MAX_SLOPE, GroundPlane, fit_ground, floor_tolerance
from eldenet.results.before_after import (
    check_scale,
    compare,
    panel_size,
    record_change,
    refuse_copies,
    say_changes,
    thumbnail,
)
from eldenet.results.run_log import RunLog
from eldenet.system.files import write_rows
from eldenet.system.resources import Resources
from eldenet.visualization import photo_beside_depths, stack_rows, visible_range, write_picture

FREE_SLOPE = 0.7  # [rad]: of a floor before a camera in a hand, whose pitch is not known
LEAST_FLOORS = 20  # frames with a floor
LEAST_SHARE = 0.3  # of all frames
#: Share of the floors' log scale that all depth follows, by how the pitch is known and by which way depth
#: goes. Chosen on rendered cameras: experiments/adapt/floors.md.
FLOOR_SHARE = {
    "given": {"grows": 0.4, "shrinks": 0.7},
    "fitted": {"grows": 0.2, "shrinks": 0.4},
}
LEAST_FLOOR_SCALE = 0.3  # log scale of floors; a smaller one may be an error of their own depth
HELD_OUT, BLOCKS, GAP = 0.25, 20, 1  # share, blocks of time, frames left out beside one
CLEARLY_BELOW = 0.2  # of the camera's height above a level surface
MOST_BELOW = 0.05  # share of the pixels that may lie clearly below the floor
SHOWN = 3  # frames of the picture
TITLES = ("image", "before", "after")


def calibrate(s: Mapping[str, Any], source: Source, folder: Path, resources: Resources) -> bool:
    """Fit a scale, check it on held-out frames, keep the better weights; return whether the scaled ones are.

    ``s`` are the settings of ``eldenet adapt camera_height=...``; ``source`` has pictures in the order of
    time, or a video.

    Raises:
        ValueError: too few frames show a floor, the held-out ones are copies of others, or the factor of its
            depth is not plausible.
    """
    start = eldenet.load(s["weights"], trusted_modules=listed(s["trusted_modules"]))
    log, known_pitch = RunLog(folder), s["camera_pitch"] is not None
    predictor = DepthPredictor(start, device=resources.device, steady=False)
    pitch = math.radians(s["camera_pitch"]) if known_pitch else None
    view = FloorView(level_camera(s["intrinsics"], pitch), s["camera_height"], known_pitch)
    names, log_scales, shown, thumbnails = measure_floors(source, predictor, view, s["frames"], log)
    refuse_few(log_scales)
    held, fitted = hold_out_floors(log_scales, s["seed"])
    refuse_copies([thumbnails[i] for i in held], [thumbnails[i] for i in fitted])
    of_floors = float(np.nanmedian(log_scales[fitted]))
    check_scale(
        float(np.exp(of_floors)),
        "camera_height [m], camera_pitch [degrees], intrinsics [px] and weights",
        force=s["force"],
    )
    scale = scale_of_all(of_floors, known_pitch=known_pitch)
    before, after = np.abs(log_scales[held]), np.abs(log_scales[held] - np.log(scale))
    changes = {"scale_error": compare("scale_error", before.tolist(), after.tolist())}
    found, count = int(np.isfinite(log_scales).sum()), len(log_scales)
    log.say(f"{found} of {count} frames show the floor; times {np.exp(of_floors):.2f} its depth is right")
    few = "this may be an error of the floor alone, so depth stays as it is"
    log.say(few if scale == 1 else f"all depth is multiplied by a part of that: {scale:.2f}")
    say_changes(log, f"{s['weights']}: floors of {changes['scale_error'].frames} held-out frames", changes)
    model = copy.deepcopy(start)
    model.rescale(scale)
    rows = [[names[i], b, a] for i, b, a in zip(held, before, after, strict=True)]
    write_rows(folder / "held_out.csv", ["name", "scale_error_before", "scale_error_after"], rows)
    draw(folder / "before_after.png", shown, scale)
    facts = {
        "scale": scale,
        "floor_scale": float(np.exp(of_floors)),
        "frames": count,
        "frames_with_floor": found,
        "config": dict(s),
    }
    return record_change(folder, log, start, model, changes, s["weights"], facts)


class FloorView(NamedTuple):
    """The camera, its height above the floor [m], and whether its pitch is given: then its frame is level."""

    camera: PinholeCamera
    height: float
    known_pitch: bool


def measure_floors(
    source: Source, predictor: DepthPredictor, view: FloorView, most: int, log: RunLog
) -> tuple[list[str], np.ndarray, list[tuple[np.ndarray, np.ndarray]], list[np.ndarray]]:
    """Return names, log scales ``(N,)``, ``SHOWN`` photos with depth [m], and all thumbnails."""
    camera = view.camera
    predict = for_camera(predictor, camera.intrinsics)
    names: list[str] = []
    log_scales: list[float] = []
    shown: list[tuple[np.ndarray, np.ndarray]] = []
    thumbnails: list[np.ndarray] = []
    pictures, total = frames_of(source, most)
    with log.bar("floors", total) as bar:
        for name, photo in pictures:
            check_intrinsics(camera.intrinsics, photo.shape[:2])
            depth = predict(photo)
            names.append(name)
            thumbnails.append(thumbnail(photo))
            log_scales.append(log_scale(depth, camera, view.height, known_pitch=view.known_pitch))
            if len(names) % max(1, total // SHOWN) == 0 and len(shown) < SHOWN:
                size = panel_size(photo)
                shown.append((resize_image(photo, size), enlarged(depth, size)))
            bar.advance(1)
    return names, np.array(log_scales), shown, thumbnails


def frames_of(source: Source, most: int) -> tuple[Iterator[tuple[str, np.ndarray]], int]:
    """Return name and picture ``(H, W, 3)`` uint8 RGB of ``most`` evenly chosen frames, and their number.

    Of a video that does not tell its length, they are the first ones.
    """
    if not source.is_video:
        paths = [Path(path) for path in source.names]
        chosen = [paths[i] for i in evenly_spaced(len(paths), most)]
        return ((path.name, read_image(path, upright=True)) for path in chosen), len(chosen)
    (path,) = source.names
    video = VideoFile(Path(path))
    wanted = set(evenly_spaced(video.announced or most, most))
    numbered = enumerate(frame for frame, _ in video.frames())
    return ((f"{number:06d}", frame) for number, frame in numbered if number in wanted), len(wanted)


def level_camera(intrinsics: Sequence[float] | np.ndarray, pitch: float | None) -> PinholeCamera:
    """Return the camera of ``(3, 3)``, in a level frame if its ``pitch`` below the horizon [rad] is known."""
    return PinholeCamera(intrinsic_matrix(intrinsics), level_rotation(pitch or 0.0))


def log_scale(depth: np.ndarray, camera: PinholeCamera, height: float, *, known_pitch: bool) -> float:
    """Return the logarithm of the factor that puts the floor ``height`` [m] below; NaN without a floor.

    Of a camera with known pitch, the floor's true depth is known at each of its pixels, and the factor is the
    median ratio; a level surface with more below it is no floor. Else the plane's own height decides, which
    shares the errors of its tilt.

    Args:
        depth: predicted ``(H, W)`` [m].
        camera: in the level frame if its pitch is known.
        height: of the camera above the floor [m].
        known_pitch: whether the camera is in the level frame.
    """
    plane = fit_ground(depth, camera, max_slope=MAX_SLOPE if known_pitch else FREE_SLOPE)
    if plane is None:
        return float("nan")
    if not known_pitch:
        return float(np.log(height / plane.offset))
    if hides_a_floor(depth, camera, plane):
        return float("nan")
    rows, columns = floor_pixels(depth, camera, plane)
    slope = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ camera.homography[1]  # fall per depth
    below = slope > 0.02  # well below the horizon
    if not below.any():
        return float("nan")
    return float(np.median(np.log(height / slope[below] / depth[rows[below], columns[below]])))


def hides_a_floor(depth: np.ndarray, camera: PinholeCamera, plane: GroundPlane) -> bool:
    """Return whether much of ``depth (H, W)`` [m] lies clearly below ``plane``: a table or a bed."""
    rows, columns = (grid.ravel() for grid in np.indices(depth.shape))
    distance = depth.ravel()
    height = plane.height_above(camera.back_project(columns, rows, distance))
    margin = CLEARLY_BELOW * plane.offset + floor_tolerance(distance)
    return bool((height < -margin).mean() > MOST_BELOW)


def floor_pixels(
    depth: np.ndarray, camera: PinholeCamera, plane: GroundPlane
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns ``(P,)`` of the pixels of the lower half that lie on ``plane``."""
    rows, columns = np.mgrid[depth.shape[0] // 2 : depth.shape[0], : depth.shape[1]].reshape(2, -1)
    distance = depth[rows, columns]
    height = plane.height_above(camera.back_project(columns, rows, distance))
    inside = np.abs(height) < floor_tolerance(distance)
    return rows[inside], columns[inside]


def scale_of_all(of_floors: float, *, known_pitch: bool) -> float:
    """Return the factor for all depth, given the median log scale ``of_floors``.

    A network is often more wrong about the floor than about the rest, above all where it takes a tall camera
    for a lower one, and a fitted pitch adds its own error. So all depth follows the floor in part.
    """
    if abs(of_floors) < LEAST_FLOOR_SCALE:
        return 1.0
    share = FLOOR_SHARE["given" if known_pitch else "fitted"]["grows" if of_floors > 0 else "shrinks"]
    return float(np.exp(share * of_floors))


def hold_out_floors(log_scales: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers ``(K,)`` of held-out frames and of those that fit the scale.

    Raises:
        ValueError: no frame of one of the two has a log scale.
    """
    held, beside = val_blocks(len(log_scales), HELD_OUT, BLOCKS, GAP, seed)
    fitted = np.setdiff1d(np.arange(len(log_scales)), [*held, *beside])
    for name, part in (("held-out", held), ("other", fitted)):
        if not np.isfinite(log_scales[part]).any():
            raise ValueError(
                f"none of the {len(part)} {name} frames shows a floor: keep the floor in view in all of the "
                "recording, or hold out other frames (another seed=)"
            )
    return np.array(held), fitted


def refuse_few(log_scales: np.ndarray) -> None:
    """Raise ValueError if too few of the frames ``(N,)`` have a log scale."""
    found = int(np.isfinite(log_scales).sum())
    if found < max(LEAST_FLOORS, LEAST_SHARE * len(log_scales)):
        raise ValueError(
            f"{found} of {len(log_scales)} frames show a floor: {LEAST_FLOORS} frames and {LEAST_SHARE:.0%} "
            "of all are needed, because the depth error differs from image to image. Tilt the camera down, "
            "or record depth frames"
        )


def draw(path: Path, frames: Sequence[tuple[np.ndarray, np.ndarray]], scale: float) -> None:
    """Draw photos ``(H, W, 3)`` with their depth before and after, and a scale in meters."""
    rows = []
    for photo, depth in frames:
        near, far = visible_range(np.stack([depth, depth * scale]))
        rows.append(photo_beside_depths(photo, [depth, depth * scale], near, far))
    write_picture(path, stack_rows(rows, TITLES))

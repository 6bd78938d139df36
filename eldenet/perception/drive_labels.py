"""The depth that a drive's own motion tells, as a folder of sparse frames for ``eldenet adapt``."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from eldenet.data.bags import Bag
from eldenet.data.depth_from_motion import TURN_COUNTS, MotionDepth, View, apart
from eldenet.data.drive_poses import DrivePoses, in_order
from eldenet.data.frame_files import seconds_of
from eldenet.data.io import read_image
from eldenet.deploy.prediction import Source
from eldenet.deploy.video_files import VideoFile
from eldenet.geometry import check_intrinsics, four_numbers, intrinsic_matrix, nearest_points
from eldenet.results.run_log import RunLog
from eldenet.system.files import safe_stem
from eldenet.visualization import write_picture

LEAST_POINTS = 50  # of a frame
LEAST_FRAMES = 30
LEAST_SPACING = 0.05  # of labeled pictures [m]
LONGEST_STEP = 1.0  # between two poses [m]; a longer one joins two recordings
FEWEST_NEAR = 0.25  # of the pictures between the first and last pose: share with a pose near in time

Placed = tuple[str, np.ndarray, np.ndarray, float | None]
"""Name, picture ``(H, W, 3)`` uint8 RGB, pose ``(4, 4)`` and time [s] of a frame."""


def label_drive(
    source: Source | Bag, poses: DrivePoses, intrinsics: object, folder: Path, most: int, log: RunLog
) -> list[float]:
    """Write ``images/`` and ``depths/`` (16-bit PNG [mm]); return fx, fy, cx, cy of the written pictures.

    Args:
        source: pictures in the order of time, a video, or a bag of ROS.
        intrinsics: of the source's pictures [px].
        most: pictures to write, about.

    Raises:
        ValueError: pictures and poses do not fit, or too few pictures show enough points.
    """
    if most < LEAST_FRAMES:
        raise ValueError(f"frames={most}: a drive needs {LEAST_FRAMES} or more")
    matrix = intrinsic_matrix(intrinsics)  # type: ignore[arg-type]
    placed = place_frames(source, poses)
    first = next(placed)
    size = (first[1].shape[0], first[1].shape[1])
    check_intrinsics(matrix, size)
    depth = MotionDepth(matrix, size, None if poses.mount is None else poses.mount.height)
    steps = [apart(*pair) for pair in pairwise(_during(source, poses))]
    travel = sum(min(way, LONGEST_STEP) + TURN_COUNTS * turn for way, turn in steps)
    counts: list[int] = []
    written = 0

    def views() -> Iterator[View]:
        for name, picture, pose, _ in (first, *placed):
            if picture.shape[:2] != size:
                raise ValueError(f"{name} is {picture.shape[:2]}, the first picture {size}: give one size")
            yield depth.view(name, picture, pose)

    spacing = max(LEAST_SPACING, travel / most)
    with log.bar("depth from motion", min(len(steps), round(travel / spacing)) + 1) as bar:
        for view, points in depth.along(views(), spacing):
            counts.append(len(points.depth))
            if counts[-1] >= LEAST_POINTS:
                columns, rows = np.rint(points.pixels).astype(np.int64).T
                known = nearest_points(rows, columns, points.depth, depth.seen_size)
                name = f"{written:06d}-{safe_stem(Path(view.name).stem)}.png"
                write_picture(folder / "images" / name, view.image)
                write_picture(folder / "depths" / name, np.rint(known * 1000).astype(np.uint16))
                written += 1
            bar.advance(1)
    if written < LEAST_FRAMES:
        raise ValueError(
            f"the motion tells the depth of {LEAST_POINTS} corners or more in {written} of {len(counts)} "
            f"pictures (median {np.median(counts):.0f} corners): {LEAST_FRAMES} pictures are needed. Drive "
            "on among things with texture, with several pictures per 0.1 m, and check that poses and "
            "pictures have one clock, the axes (x ahead, y left, heading counter-clockwise), camera_pitch "
            "and intrinsics"
        )
    log.say(
        f"{written} of {len(counts)} pictures along {travel:.1f} m have {LEAST_POINTS} or more corners of "
        f"known depth (median {np.median(counts):.0f})"
    )
    return four_numbers(depth.seen_intrinsics)


def _during(source: Source | Bag, poses: DrivePoses) -> np.ndarray:
    """The poses ``(N, 4, 4)`` of pictures, or between a video's beginning and end; all of a bag."""
    if not (isinstance(source, Bag) or source.is_video):
        return np.stack([pose for _, pose, _ in _of_pictures(source, poses)])
    if isinstance(source, Bag) or poses.seconds is None:
        return poses.cameras
    (file,) = source.names
    video = VideoFile(Path(file))
    end = video.announced / video.frames_per_second or np.inf
    return poses.cameras[(poses.seconds >= 0) & (poses.seconds <= end)]


def place_frames(source: Source | Bag, poses: DrivePoses) -> Iterator[Placed]:
    """Yield the frames whose pose is known, in the order of time.

    Raises:
        ValueError: poses have no times, none falls into the video, or pictures and poses do not fit.
    """
    if isinstance(source, Bag):
        yield from _of_film(source.frames(), poses)
        return
    if source.is_video:
        (file,) = source.names
        yield from _of_film(VideoFile(Path(file)).frames(), poses)
        return
    for path, pose, time in _of_pictures(source, poses):
        yield path.name, read_image(path, upright=True), pose, time


def _of_pictures(source: Source, poses: DrivePoses) -> list[tuple[Path, np.ndarray, float | None]]:
    """The pictures whose pose is known, with it and their time, in the order of time."""
    paths = in_order([Path(path) for path in source.names])
    times = [time for path in paths if (time := seconds_of(path.stem)) is not None]
    timed: list[tuple[Path, np.ndarray | None, float | None]]
    if poses.seconds is not None and poses.names is None and len(times) == len(paths):
        stated = sorted(zip(times, paths, strict=True))  # names may leave out last zeros
        timed = [(path, poses.at(time), time) for time, path in stated]
        _refuse_other_clock(poses, [pose for _, pose, _ in timed], times)
    else:
        timed = [(path, pose, None) for path, pose in zip(paths, poses.of_pictures(paths), strict=True)]
    return [(path, pose, time) for path, pose, time in timed if pose is not None]


def _of_film(frames: Iterator[tuple[np.ndarray, float]], poses: DrivePoses) -> Iterator[Placed]:
    if poses.seconds is None:
        raise ValueError(f"{poses.path} has no column seconds: a video or bag needs the times of its poses")
    known: list[np.ndarray | None] = []
    times: list[float] = []
    for number, (picture, time) in enumerate(frames):
        times.append(time)
        known.append(poses.at(time))
        pose = known[-1]
        if pose is not None:
            yield f"{number:06d}", picture, pose, time
    _refuse_other_clock(poses, known, times)


def _refuse_other_clock(poses: DrivePoses, known: list[np.ndarray | None], times: list[float]) -> None:
    """Refuse pictures of which hardly any that was taken between the first and last pose has a pose near."""
    stamps = np.asarray(poses.seconds)
    covered = sum(stamps[0] <= time <= stamps[-1] for time in times)
    if sum(pose is not None for pose in known) <= FEWEST_NEAR * covered:
        raise ValueError(
            f"{poses.path} has poses from {stamps[0]:.2f} to {stamps[-1]:.2f} s, one each "
            f"{np.median(np.diff(stamps)):.3g} s, the pictures are from {min(times, default=0):.2f} to "
            f"{max(times, default=0):.2f} s: give seconds of one clock (a video's begin at 0), at least two "
            "poses per second"
        )

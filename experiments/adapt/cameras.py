"""Measure what a drive tells about its camera when neither lens, mount nor clock are given.

python experiments/adapt/cameras.py    # all rows that cameras.csv lacks; prints the table

Drives and odometry's errors are those of drives.py; those of more than two rooms or arenas are cut to five.
"""

import csv
import math
import shutil
from pathlib import Path

import drives
import numpy as np
import torch
from places import REAL

from eldenet.adapt import USUAL_AHEAD
from eldenet.data.depth_from_motion import MotionDepth
from eldenet.data.drive_clock import find_delay
from eldenet.data.drive_poses import Mount, read_poses
from eldenet.data.io import read_image
from eldenet.data.self_calibration import find_pairs
from eldenet.deploy.prediction import find_source
from eldenet.deploy.video_files import open_video
from eldenet.geometry import pinhole
from eldenet.perception.drive_camera import settle_camera
from eldenet.perception.drive_labels import label_drive, place_frames
from eldenet.results.run_log import RunLog

PLACES = ("robot_wide", "robot_tele", "arena_low", "arena_robot", "arena_down", *REAL)
FRAMES, MOST_PARTS = 60, 5
PER_SECOND = 8  # pictures of a drive as a video
TABLE = Path(__file__).parent / "cameras.csv"
HEADER = ["place", "seed"]
HEADER += [f"{name}{found}" for name in ("fx", "pitch", "ahead", "height") for found in ("", "_found")]
HEADER += ["error_given", "error_found", "delay", "delay_found"]


def measure(place: str, seed: int) -> list[object]:
    """Return a row of the table: [px], [degrees], [m], label errors as shares, delays [s]."""
    folder = drives.WORK / f"camera-{place}-{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    parts, way = drives.LONG.get(place, (drives.PARTS, drives.WAY))
    drives.LONG[place] = (min(parts, MOST_PARTS), way)
    _, lens, _ = drives.prepare(place, seed, folder)
    height, true = None, None
    if place in drives.RENDERED:
        camera = drives.RENDERED[place]
        height, true = camera.height, Mount(camera.height, -camera.pitch, drives.AHEAD)
    _, _, error_given = _labeled(folder, lens, true)
    found = _labeled(folder, None, Mount(ahead=USUAL_AHEAD))
    if math.isnan(found[0]) and height is not None:  # perhaps it only does not tell the height
        focal, mount, error = _labeled(folder, None, Mount(height, ahead=USUAL_AHEAD))
        found = focal, mount and mount._replace(height=None), error
    row = [lens[0], found[0]]
    for name in ("pitch", "ahead", "height"):
        values = [getattr(mount, name, None) for mount in (true, found[1])]
        row += [math.nan if value is None else value for value in values]
    row[2:4] = [math.degrees(pitch) for pitch in row[2:4]]
    cells = [*(f"{value:.3f}" for value in row), f"{error_given:.4f}", f"{found[2]:.4f}"]
    return [place, seed, *cells, *(f"{delay:.3f}" for delay in _delays(folder, seed))]


def _delays(folder: Path, seed: int) -> tuple[float, float]:
    """The delay of the poses of a video [s], drawn, and the one found; NaN where the drive does not tell."""
    delay = float(np.random.default_rng((7, seed)).uniform(-1, 1))
    lines = [line.split(",", 1) for line in (folder / "poses.csv").read_text().splitlines()]
    rows = [f"{number / PER_SECOND + delay:.4f},{row}" for number, (_, row) in enumerate(lines[1:])]
    (folder / "timed.csv").write_text("\n".join([f"seconds,{lines[0][1]}", *rows]))
    pictures = [folder / "drive/pictures" / Path(name).name for name, _ in lines[1:]]
    with open_video(folder / "walk.mp4", PER_SECOND) as add:
        for picture in pictures:
            add(read_image(picture))
    poses = read_poses(folder / "timed.csv", Mount(ahead=USUAL_AHEAD))
    source = find_source(str(folder / "walk.mp4"), folder / "run", None)
    height, width = read_image(pictures[0]).shape[:2]
    depth = MotionDepth(pinhole(width, width, (width - 1) / 2, (height - 1) / 2), (height, width))
    pairs = find_pairs(depth.view(*frame) for frame in place_frames(source, poses))
    forward = None if poses.mount is None else np.array([0.0, 0.0, 1.0])
    found = find_delay(pairs, poses, depth.seen_intrinsics, forward)
    return delay, math.nan if found is None else found


def _labeled(
    folder: Path, lens: tuple[float, ...] | None, mount: Mount | None
) -> tuple[float, Mount | None, float]:
    """Focal length [px], mount of the camera, error of its labels; NaN where the drive does not tell.

    With a ``lens``, the ``mount`` is given, too; without, only its height may be.
    """
    known = lens is not None
    mount = mount or Mount()
    source = find_source(str(folder / "drive/pictures"), folder / "run", None)
    labels, log = folder / f"labels-{known}", RunLog(folder / "run")
    shutil.rmtree(labels, ignore_errors=True)
    focal, told, label_error = math.nan, None, math.nan
    try:
        matrix, poses = settle_camera(
            source,
            read_poses(folder / "poses.csv", mount),
            lens,
            pitch=math.degrees(mount.pitch) if known else None,
            ahead=mount.ahead if known else None,
            log=log,
        )
        focal, told = matrix[0, 0], poses.mount
        label_drive(source, poses, matrix, labels, FRAMES, log)
        label_error = drives.label_error(labels, folder / "drive/truth")[2]
    except ValueError as error:
        print(error)
    return focal, told, label_error


def main() -> None:
    torch.set_num_threads(1)
    rows = list(csv.DictReader(TABLE.open())) if TABLE.is_file() else []
    done = {(row["place"], row["seed"]) for row in rows}
    for seed in range(2):
        for place in PLACES:
            if (place, str(seed)) not in done:
                row = measure(place, seed)
                new = not TABLE.is_file()
                with TABLE.open("a", newline="") as file:
                    csv.writer(file, lineterminator="\n").writerows([HEADER, row] if new else [row])
                print(*row, flush=True)


if __name__ == "__main__":
    main()

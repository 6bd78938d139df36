"""Measure what a drive tells about its camera when neither lens nor mount are given.

python experiments/adapt/cameras.py    # all rows that cameras.csv lacks; prints the table

Drives and odometry's errors are those of drives.py; those of more than two rooms or arenas are cut to five.
"""

import csv
import math
import shutil
from pathlib import Path

import drives
import torch
from places import REAL

from eldenet.adapt import USUAL_AHEAD
from eldenet.data.drive_poses import Mount, read_poses
from eldenet.deploy.prediction import find_source
from eldenet.perception.drive_camera import settle_camera
from eldenet.perception.drive_labels import label_drive
from eldenet.results.run_log import RunLog

PLACES = ("robot_wide", "robot_tele", "arena_low", "arena_robot", "arena_down", *REAL)
FRAMES, MOST_PARTS = 60, 5
TABLE = Path(__file__).parent / "cameras.csv"
HEADER = ["place", "seed"]
HEADER += [f"{name}{found}" for name in ("fx", "pitch", "ahead", "height") for found in ("", "_found")]
HEADER += ["error_given", "error_found"]


def measure(place: str, seed: int) -> list[object]:
    """Return a row: focal length [px], pitch [degrees], place before the axle, height [m], label error."""
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
    return [place, seed, *(f"{value:.3f}" for value in row), f"{error_given:.4f}", f"{found[2]:.4f}"]


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

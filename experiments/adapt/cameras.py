"""Measure what a drive tells about its camera when neither lens nor pitch are given.

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
HEADER = ["place", "seed", "fx", "fx_found", "pitch", "pitch_found", "ahead", "ahead_found"]
HEADER += ["error_given", "error_found"]


def measure(place: str, seed: int) -> list[object]:
    """Return a row: focal length [px], pitch [degrees], place before the axle [m], error of labels."""
    folder = drives.WORK / f"camera-{place}-{seed}"
    shutil.rmtree(folder, ignore_errors=True)
    parts, way = drives.LONG.get(place, (drives.PARTS, drives.WAY))
    drives.LONG[place] = (min(parts, MOST_PARTS), way)
    _, lens, _ = drives.prepare(place, seed, folder)
    true = Mount(0.4, 0.0, drives.AHEAD)
    if place in drives.RENDERED:
        camera = drives.RENDERED[place]
        true = Mount(camera.height, -camera.pitch, drives.AHEAD)
    mounted = place in drives.RENDERED
    source = find_source(str(folder / "drive/pictures"), folder / "run", None)
    log = RunLog(folder / "run")
    errors = []
    found: tuple[float, Mount | None] = (math.nan, None)
    for known in (True, False):
        told = true if known else true._replace(pitch=0.0, ahead=USUAL_AHEAD)
        poses = read_poses(folder / "poses.csv", told if mounted else None)
        given = lens if known else None
        try:
            matrix, poses = settle_camera(
                source,
                poses,
                given,
                pitch=math.degrees(true.pitch) if known else None,
                ahead=true.ahead if known else None,
                log=log,
            )
            labels = folder / f"labels-{known}"
            label_drive(source, poses, matrix, labels, FRAMES, log)
            errors.append(drives.label_error(labels, folder / "drive/truth")[2])
        except ValueError as error:
            print(error)
            errors.append(math.nan)
            continue
        found = matrix[0, 0], poses.mount
    numbers = [f"{value:.2f}" for value in (lens[0], found[0], *_mount(true if mounted else None, found[1]))]
    return [place, seed, *numbers, *(f"{error:.4f}" for error in errors)]


def _mount(*mounts: Mount | None) -> list[float]:
    """Pitch [degrees] of all and places [m] of all; NaN of none."""
    pitches = [math.nan if mount is None else math.degrees(mount.pitch) for mount in mounts]
    return pitches + [math.nan if mount is None else mount.ahead for mount in mounts]


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

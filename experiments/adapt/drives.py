"""Measure what ``adapt poses=`` gives: tuned on a drive without depth, scored with true depth elsewhere.

python experiments/adapt/drives.py                       # all trials that drives.csv lacks; prints the table
python experiments/adapt/drives.py robot_wide 0          # one trial; only its drive, if the row is stored

Odometry is wrong by 2 % of the way and 0.5 degrees per meter (standard deviations: one part stays over the
drive, one is drawn for each step). Rendered robots drive through rooms or an arena until something is near,
then turn; real places are those of ``$ELDENET_DATA/other_cameras``, whose camera poses get the same errors.
"""

import csv
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import cv2  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402
from places import CAMERAS, REAL, Camera  # noqa: E402

import eldenet  # noqa: E402
from eldenet.adapt import AdaptSettings, adapt  # noqa: E402
from eldenet.compose import compose  # noqa: E402
from eldenet.data.drive_poses import MATRIX  # noqa: E402
from eldenet.data.io import read_image  # noqa: E402
from eldenet.deploy.predictor import DepthPredictor, for_camera  # noqa: E402
from eldenet.geometry import pinhole  # noqa: E402
from eldenet.simulation.arena_view import ArenaView  # noqa: E402
from eldenet.simulation.arenas import RESOLUTION, SIDE, clearance_map, generate_arena  # noqa: E402
from eldenet.simulation.furnished_rooms.rooms import generate_room  # noqa: E402
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation  # noqa: E402
from eldenet.simulation.rendering.camera_noise import develop  # noqa: E402
from eldenet.simulation.rendering.mjcf import Draw  # noqa: E402
from eldenet.simulation.rendering.shading import CompiledRoom  # noqa: E402

HERE = Path(__file__).parent
WORK = Path(tempfile.gettempdir()) / "eldenet-drives"
WAY_ERROR, TURN_ERROR = 0.02, np.radians(0.5)  # share; [rad per m]
SIZE = (240, 320)  # of rendered pictures [px]
AHEAD = 0.1  # of rendered cameras before the axle [m]
_ROBOT = Camera(0.40, 0.722, 0.0, (1.0, 1.0, 1.0), 0.3)
#: A low robot with a longer lens, and the robot of ``eldenet navigate`` on a short and three long drives, one
#: of which goes through rooms, too, and with its camera 20 degrees down.
ARENA = {
    "arena_low": Camera(0.30, 0.90, -0.05, (1.0, 1.0, 1.0), 0.3),
    "arena_robot": _ROBOT,
    "arena_long": _ROBOT,
    "arena_many": _ROBOT,
    "arena_rooms": _ROBOT,
    "arena_down": replace(_ROBOT, pitch=-0.35),
}
RENDERED = {**{name: CAMERAS[name] for name in ("robot_wide", "robot_tele")}, **ARENA}
PARTS, WAY = 2, 6.0  # rooms that a robot drives through, and its way in each [m]
#: The same of long drives.
LONG = {"arena_long": (8, 7.5), "arena_many": (20, 3.0), "arena_rooms": (20, 3.0), "arena_down": (20, 3.0)}
REPORT_PARTS = 1  # rooms that only report
STEP, TURN, CLOSE = 0.05, 0.09, 0.35  # of a drive [m], [rad], and room that it keeps [m]
HEADER = ["place", "seed", "pictures", "corners", "label_error", "kept", "report_frames"]
HEADER += [f"{name}_{when}" for name in ("abs_rel", "near", "scale") for when in ("before", "after")]
HEADER += ["seconds"]
Free = Callable[[float, float], bool]


def stage(place: str, part: int) -> tuple[CompiledRoom, Free, float]:
    """Return a room or arena, where a robot's center may be, and half its width [m]."""
    if place in ARENA:
        with_doors = place == "arena_rooms" and part % 2
        arena = generate_arena("train", 20, 5_000 + part, kind="rooms" if with_doors else "open")
        clearance = clearance_map(arena.obstacles)
        middle = len(clearance) // 2

        def open_floor(x: float, y: float) -> bool:
            row, column = int(x / RESOLUTION) + middle, int(y / RESOLUTION) + middle
            inside = max(abs(x), abs(y)) < SIDE / 2 - CLOSE
            return inside and bool(clearance[row, column] > CLOSE)

        return ArenaView(arena).room, open_floor, SIDE / 2
    room = generate_room("test", 10 * list(CAMERAS).index(place) + part)
    sx, sy, _ = room.size

    def free(x: float, y: float) -> bool:
        inside = abs(x) < sx / 2 - CLOSE and abs(y) < sy / 2 - CLOSE
        return inside and not any(
            x0 - CLOSE < x < x1 + CLOSE and y0 - CLOSE < y < y1 + CLOSE
            for x0, y0, x1, y1, _ in room.obstacles
        )

    camera = RENDERED[place]
    room.ambient = camera.ambient
    room.lights = [
        (*row[:3], *(a * b for a, b in zip(row[3:6], camera.lamps, strict=True)), row[6])
        for row in room.lights
    ]
    return CompiledRoom(room), free, max(sx, sy) / 2


def bounce(
    free: Free, half: float, long: float, rng: np.random.Generator
) -> Iterator[tuple[float, float, float]]:
    """Poses of a robot that drives ``long`` [m] in bows until something is near, then turns away from it."""
    for _ in range(10_000):
        x, y, heading = rng.uniform(-half, half), rng.uniform(-half, half), rng.uniform(-np.pi, np.pi)
        if free(x, y):
            break
    way, side = 0.0, 1.0
    turns = 0
    while way < long and turns < 400:
        yield x, y, heading
        ahead = all(free(x + d * np.cos(heading), y + d * np.sin(heading)) for d in (STEP, 0.15))
        if ahead:
            heading += 0.03 * np.sin(2.0 * way)
            x, y, way = x + STEP * np.cos(heading), y + STEP * np.sin(heading), way + STEP
            side = side if rng.random() > 0.05 else -side
        else:
            heading, turns = heading + side * TURN, turns + 1


def render(place: str, parts: range, folder: Path, seed: int, every: int) -> np.ndarray:
    """Write pictures and true depth; return the robot's poses ``(N, 3)`` of each picture."""
    camera = RENDERED[place]
    long = LONG.get(place, (PARTS, WAY))[1]
    height, width = SIZE
    fx = camera.focal * width
    rays = RayCamera(SIZE, pinhole(fx, fx, (width - 1) / 2, (height - 1) / 2))
    poses: list[tuple[float, float, float]] = []
    for part in parts:
        room, free, half = stage(place, part)
        rng = np.random.default_rng((seed, part))
        for number, (x, y, heading) in enumerate(bounce(free, half, long, rng)):
            if number % every:
                continue
            at = np.array([x + AHEAD * np.cos(heading), y + AHEAD * np.sin(heading), camera.height])
            linear, hits = room.photograph(rays, at, camera_rotation(heading, camera.pitch))
            image = develop(linear, Draw((seed, 7)), (seed, part, number))
            name = f"{len(poses):05d}.png"
            cv2.imwrite(str(folder / "pictures" / name), image[..., ::-1])
            depth = np.rint(hits.depth.reshape(SIZE) * 1000).clip(0, 65535).astype(np.uint16)
            cv2.imwrite(str(folder / "truth" / name), depth)
            poses.append((x + 30.0 * part, y, heading))  # rooms far apart, as odometry would tell
    return np.array(poses)


def as_matrices(poses: np.ndarray) -> np.ndarray:
    """Poses ``(N, 3)`` in the plane as ``(N, 4, 4)``."""
    found = np.tile(np.eye(4), (len(poses), 1, 1))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    found[:, 0, 0], found[:, 0, 1], found[:, 1, 0], found[:, 1, 1] = c, -s, s, c
    found[:, :2, 3] = poses[:, :2]
    return found


def as_odometry(poses: np.ndarray, up: tuple[float, float, float], seed: int) -> np.ndarray:
    """Poses ``(N, 4, 4)`` with the errors of odometry, which turns wrongly about ``up`` of a pose's frame."""
    rng = np.random.default_rng(seed)
    scale, drift = rng.normal(0, WAY_ERROR), rng.normal(0, TURN_ERROR)
    found = [poses[0]]
    for before, after in pairwise(poses):
        step = np.linalg.inv(before) @ after
        way = float(np.linalg.norm(step[:3, 3]))
        if way < 1.0:  # else another room
            step[:3, 3] *= 1 + scale + rng.normal(0, WAY_ERROR)
            turn = drift * way + rng.normal(0, TURN_ERROR) * np.sqrt(way)
            step[:3, :3] = cv2.Rodrigues(turn * np.array(up))[0] @ step[:3, :3]
        found.append(found[-1] @ step)
    return np.stack(found)


def prepare(
    place: str, seed: int, folder: Path
) -> tuple[list[str], tuple[float, ...], list[tuple[Path, Path]]]:
    """Write a drive; return adapt's settings, the lens [px], and pictures with depth that report."""
    shutil.rmtree(folder, ignore_errors=True)  # of a trial that was stopped
    for part in ("pictures", "truth"):
        for base in (folder / "drive", folder / "report"):
            (base / part).mkdir(parents=True, exist_ok=True)
    if place in REAL:
        return _real(place, seed, folder)
    camera = RENDERED[place]
    parts = LONG.get(place, (PARTS, WAY))[0]
    poses = render(place, range(parts), folder / "drive", seed, 1)
    render(place, range(parts, parts + REPORT_PARTS), folder / "report", seed, 8)
    told = as_odometry(as_matrices(poses), (0.0, 0.0, 1.0), seed)
    rows = [
        (f"{i:05d}.png", *pose[:2, 3].round(5), np.arctan2(pose[1, 0], pose[0, 0]).round(6))
        for i, pose in enumerate(told)
    ]
    _write(folder / "poses.csv", ("image", "x", "y", "heading"), rows)
    fx = camera.focal * SIZE[1]
    lens = (fx, fx, (SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2)
    mount = [f"camera_height={camera.height}", f"camera_pitch={-np.degrees(camera.pitch):.4f}"]
    report = [(p, folder / "report/truth" / p.name) for p in sorted((folder / "report/pictures").iterdir())]
    return [*mount, f"camera_ahead={AHEAD}"], lens, report


def _real(
    place: str, seed: int, folder: Path
) -> tuple[list[str], tuple[float, ...], list[tuple[Path, Path]]]:
    root = Path(os.environ["ELDENET_DATA"]) / "other_cameras"
    with (root / place / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = np.array([[float(row[name]) for name in MATRIX] for row in rows]).reshape(-1, 3, 4)
    count = 2 * len(rows) // 3
    told = as_odometry(poses[:count], (0.0, 1.0, 0.0), seed)
    for row in rows[:count]:
        for part, path in (
            ("pictures", root / row["rgb"]),
            ("truth", (root / row["rgb"]).with_suffix(".png")),
        ):
            link = folder / "drive" / part / path.name
            link.unlink(missing_ok=True)
            link.symlink_to(path)
    _write(
        folder / "poses.csv",
        ("rgb", *MATRIX),
        [(row["rgb"], *pose[:3].ravel().round(6)) for row, pose in zip(rows[:count], told, strict=True)],
    )
    fx, fy, cx, cy = REAL[place]
    lens = (2 * fx, 2 * fy, 2 * cx + 0.5, 2 * cy + 0.5)  # REAL is of half the size
    late = [root / row["rgb"] for row in rows[count + 3 :]]
    return [], lens, [(path, path.with_suffix(".png")) for path in late]


def _write(path: Path, header: tuple[str, ...], rows: list[tuple[object, ...]]) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])


def meters(path: Path) -> np.ndarray:
    """Depth ``(H, W)`` [m] of a PNG file in millimeters; right before a wall all of it may be small."""
    return np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / 1000.0)


def score(weights: str | Path, frames: list[tuple[Path, Path]], lens: tuple[float, ...]) -> np.ndarray:
    """Return AbsRel, AbsRel of what is at 0.3 to 1 m, and |log scale|: means over the frames."""
    predictor = DepthPredictor(eldenet.load(weights), steady=False)
    predict = for_camera(predictor, pinhole(*lens))
    rows = []
    for picture, truth in frames:
        depth, guess = meters(truth), np.asarray(predict(read_image(picture)))
        if depth.shape != guess.shape:
            depth = cv2.resize(depth, guess.shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        known = (depth > 0.1) & (depth < 10)
        near = known & (depth >= 0.3) & (depth <= 1.0)
        error = np.abs(guess - depth) / np.where(known, depth, 1)
        scale = abs(np.log(np.median(depth[known]) / np.median(guess[known])))
        rows.append([error[known].mean(), error[near].mean() if near.sum() > 50 else np.nan, scale])
    return np.nanmean(rows, axis=0) if rows else np.full(3, np.nan)


def label_error(labels: Path, truth: Path) -> tuple[int, float, float]:
    """Number of labeled pictures, median corners, and median relative error of the labels."""
    counts, errors = [], []
    for path in sorted((labels / "depths").glob("*.png")):
        found, depth = meters(path), meters(truth / f"{path.stem.partition('-')[2]}.png")
        if depth.shape != found.shape:
            depth = cv2.resize(depth, found.shape[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        both = (found > 0) & (depth > 0)
        counts.append(int((found > 0).sum()))
        errors.append(np.abs(found[both] - depth[both]) / depth[both])
    if not counts:
        return 0, 0.0, float("nan")
    return len(counts), float(np.median(counts)), float(np.median(np.concatenate(errors)))


def trial(place: str, seed: int) -> list[object]:
    """Adapt on one drive; return a row of ``drives.csv``."""
    started = time.monotonic()
    folder = WORK / f"{place}-{seed}"
    given, lens, report = prepare(place, seed, folder)
    words = [f"source={folder / 'drive/pictures'}", f"poses={folder / 'poses.csv'}", *given]
    words += [f"intrinsics={list(lens)}", "trainer.epochs=10", "minutes=60", f"seed={seed}"]
    words += ["runtime.threads=1", "runtime.workers=0", "runtime.precision=fp32", "runtime.device=cpu"]
    before = score("eldenet_indoor", report, lens)
    run = folder / "run"
    try:
        kept = "yes" if adapt(compose(AdaptSettings, [*words, f"output={run}"])) else "no"
        after = score(run, report, lens)
    except ValueError as error:
        print(error)
        kept, after = "refused", before
    labeled = label_error(run / "labels", folder / "drive/truth")
    pairs = [f"{value:.4f}" for both in zip(before, after, strict=True) for value in both]
    shown = [labeled[0], f"{labeled[1]:.0f}", f"{labeled[2]:.4f}"]
    return [place, seed, *shown, kept, len(report), *pairs, round(time.monotonic() - started)]


def print_table(rows: list[dict[str, str]]) -> None:
    """Print the trials in Markdown."""
    lines = [
        "| place | seed | labeled pictures | corners | their error | kept | AbsRel | at 0.3 to 1 m | scale |",
        "|---|---:|---:|---:|---:|---|---:|---:|---:|",
    ]
    for row in sorted(rows, key=lambda row: (row["place"], row["seed"])):
        pairs = " | ".join(
            f"{float(row[f'{name}_before']):.3f} -> {float(row[f'{name}_after']):.3f}"
            for name in ("abs_rel", "near", "scale")
        )
        cells = " | ".join(row[name] for name in HEADER[:4])
        error = f"{100 * float(row['label_error']):.1f} %" if row["kept"] != "refused" else "-"
        lines.append(f"| {cells} | {error} | {row['kept']} | {pairs} |")
    print("\n".join(lines))


def main() -> None:
    """Run the trial that the command names, or all."""
    torch.set_num_threads(1)
    table = HERE / "drives.csv"
    rows = list(csv.DictReader(table.open())) if table.is_file() else []
    done = {(row["place"], row["seed"]) for row in rows}
    trials = [(place, seed) for seed in range(2) for place in (*RENDERED, *REAL)]
    if len(sys.argv) > 1:
        trials = [(sys.argv[1], int(sys.argv[2]))]
    for place, seed in trials:
        if (place, str(seed)) not in done:
            row = trial(place, seed)
            new = not table.is_file()
            with table.open("a", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows([HEADER, row] if new else [row])
            print(*row, flush=True)
        elif len(sys.argv) > 1:
            prepare(place, seed, WORK / f"{place}-{seed}")
    print_table(list(csv.DictReader(table.open())))


if __name__ == "__main__":
    main()

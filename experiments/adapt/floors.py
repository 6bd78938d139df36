"""How much of a floor's error do all depths share? Measured with rendered cameras in rooms of ``val``.

python experiments/adapt/floors.py

``FLOOR_SHARE`` and ``LEAST_FLOOR_SCALE`` of ``perception.camera_height`` were chosen on the first 30 cameras
of ``floors.md``; the others were rendered afterwards. Cameras that are written already are not rendered or
predicted again.
"""

import csv
import tempfile
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402
from places import SIZE, Camera, render  # noqa: E402

import eldenet  # noqa: E402
from eldenet.data.io import read_depth, read_image  # noqa: E402
from eldenet.deploy.predictor import DepthPredictor, for_camera  # noqa: E402
from eldenet.geometry import pinhole  # noqa: E402
from eldenet.perception.camera_height import (  # noqa: E402
    FLOOR_SHARE,
    LEAST_FLOOR_SCALE,
    LEAST_SHARE,
    level_camera,
    log_scale,
)
from eldenet.system.files import read_table  # noqa: E402

WEIGHTS = ("eldenet_indoor", "eldenet_rooms")
CHOOSING, CHECKING = range(30), range(30, 50)  # numbers of cameras
ROOMS, TURNS = 6, 2
STORED = Path(__file__).with_name("floors.csv")
WORK = Path(tempfile.gettempdir()) / "eldenet-floors"
COLUMNS = ["weights", "camera", "height", "focal", "pitch", "depth_error", "floor_given", "floor_fitted"]
COLUMNS += ["frames", "found_given", "found_fitted"]


def draw_camera(rng: np.random.Generator) -> Camera:
    """Draw a camera: from a vacuum cleaner's to a tall robot's, of many lenses and lights."""
    height = float(np.exp(rng.uniform(np.log(0.3), np.log(2))))
    focal, pitch = float(rng.uniform(0.5, 1.2)), -float(rng.uniform(0.05, 0.45))
    return Camera(height, focal, pitch, tuple(rng.uniform(0.5, 1.4, 3)), float(rng.uniform(0.15, 0.7)))


def measure(predictor: DepthPredictor, camera: Camera, folder: Path) -> list[float]:
    """Return medians over the frames: log error of depth, of floors with given and fitted pitch; counts."""
    height, width = SIZE
    intrinsics = (camera.focal * width, camera.focal * width, (width - 1) / 2, (height - 1) / 2)
    predict = for_camera(predictor, pinhole(*intrinsics))
    level, free = level_camera(intrinsics, -camera.pitch), level_camera(intrinsics, None)
    rows = []
    for picture in sorted((folder / "images").iterdir()):
        truth = read_depth(folder / "depths" / f"{picture.stem}.png", "mm")
        known = (truth > 0.1) & (truth < 10)
        depth = predict(read_image(picture))
        given = log_scale(depth, level, camera.height, known_pitch=True)
        fitted = log_scale(depth, free, camera.height, known_pitch=False)
        rows.append([np.log(np.median(truth[known]) / np.median(depth[known])), given, fitted])
    values = np.array(rows)
    found = np.isfinite(values[:, 1:]).sum(axis=0)
    return [*np.nanmedian(values, axis=0), len(values), *found]


def main() -> None:
    """Measure what ``floors.csv`` lacks, then write ``floors.md``."""
    torch.set_num_threads(1)
    rng = np.random.default_rng(1)
    predictors = {name: DepthPredictor(eldenet.load(name), steady=False) for name in WEIGHTS}
    stored = read_table(STORED, COLUMNS) if STORED.is_file() else []
    done = {(row["weights"], row["camera"]) for row in stored}
    with STORED.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        if not stored:
            writer.writerow(COLUMNS)
        for number in (*CHOOSING, *CHECKING):
            camera, folder = draw_camera(rng), WORK / str(number)
            for name, predictor in predictors.items():
                if (name, str(number)) in done:
                    continue
                if not (folder / "done").exists():
                    render(camera, folder, "val", number, rooms=ROOMS, turns=TURNS)
                    (folder / "done").touch()
                shown = [f"{x:.3f}" for x in (camera.height, camera.focal, camera.pitch)]
                *errors, frames, given, fitted = measure(predictor, camera, folder)
                row = [name, number, *shown, *(f"{x:.4f}" for x in errors), frames, given, fitted]
                writer.writerow(row)
                file.flush()
    report()


def read_cameras(weights: str, pitch: str, numbers: range) -> tuple[np.ndarray, np.ndarray]:
    """Return the log error of all depth and that of the floors, of each camera that sees enough floors."""
    rows = [row for row in read_table(STORED, COLUMNS) if row["weights"] == weights]
    rows = [row for row in rows if int(row["camera"]) in numbers]
    rows = [row for row in rows if int(row[f"found_{pitch}"]) >= LEAST_SHARE * int(row["frames"])]
    depth, floor = (np.array([float(r[n]) for r in rows]) for n in ("depth_error", f"floor_{pitch}"))
    return depth, floor


def report() -> None:
    """Write ``floors.md``: what share of the floors' error all depth has, and the error after each rule."""
    lines = [
        "Of each camera: the median over its frames of log(true / predicted), of all depth and of floors.",
        "",
        "Slope: of all depth's on the floors', through 0. Depth grows if the floors' is above 0.",
        "",
        "| weights | pitch | depth | cameras | slope | `FLOOR_SHARE` |",
        "|---|---|---|---:|---:|---:|",
    ]
    for weights in WEIGHTS:
        for pitch, shares in FLOOR_SHARE.items():
            depth, floor = read_cameras(weights, pitch, CHOOSING)
            for way, those in (("grows", floor > 0), ("shrinks", floor <= 0)):
                slope = (floor[those] @ depth[those]) / (floor[those] @ floor[those])
                cells = [weights, pitch, way, str(those.sum()), f"{slope:.2f}", f"{shares[way]:g}"]
                lines.append(f"| {' | '.join(cells)} |")
    for numbers, title in (
        (CHOOSING, "The cameras that chose the shares"),
        (CHECKING, "Cameras that were rendered afterwards"),
    ):
        lines += ["", f"## {title}", "", *rules(numbers)]
    lines += ["", "Made by `python experiments/adapt/floors.py`."]
    STORED.with_suffix(".md").write_text("\n".join(lines) + "\n")


def rules(numbers: range) -> list[str]:
    """Return the table of what rules do to the error of scale of all depth."""
    lines = [
        f"Medians of |log(true / predicted)| of all depth. Limit: {LEAST_FLOOR_SCALE:g} of the floors'.",
        "",
        "| weights | pitch | depth follows floors | error before | after | moved | worse | worst change |",
        "|---|---|---|---:|---:|---:|---:|---:|",
    ]
    for weights in WEIGHTS:
        for pitch, shares in FLOOR_SHARE.items():
            depth, floor = read_cameras(weights, pitch, numbers)
            part = np.where(floor > 0, shares["grows"], shares["shrinks"])
            large = np.abs(floor) >= LEAST_FLOOR_SCALE
            for rule, share in (
                ("wholly", np.ones(len(floor))),
                ("in part", part),
                ("in part, from the limit on", part * large),
            ):
                before, after = np.abs(depth), np.abs(depth - share * floor)
                cells = [weights, pitch, rule, f"{np.median(before):.3f}", f"{np.median(after):.3f}"]
                cells += [f"{(share > 0).sum()} of {len(floor)}", str((after > before).sum())]
                lines.append(f"| {' | '.join(cells)} | {(after - before).max():+.3f} |")
    return lines


if __name__ == "__main__":
    main()

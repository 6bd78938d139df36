"""How much of a floor's error do all depths share? Measured with 30 rendered cameras in rooms of ``val``.

python experiments/adapt/floors.py

``FLOOR_SHARE`` and ``LEAST_FLOOR_SCALE`` of ``perception.camera_height`` were chosen on ``floors.md``.
Cameras that are written already are not rendered or predicted again.
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
CAMERAS, ROOMS, TURNS = 30, 6, 2
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
        for number in range(CAMERAS):
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


def report() -> None:
    """Write ``floors.md``: the error of scale of all depth after it was moved by a share of the floor's."""
    lines = [
        "Medians over the cameras of |log scale|. Moved: where the floor's is at least the limit.",
        "",
        "| weights | pitch | slope | share | limit | error before | after | moved | worse |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for weights in WEIGHTS:
        rows = [row for row in read_table(STORED, COLUMNS) if row["weights"] == weights]
        for pitch in ("given", "fitted"):
            seen = [r for r in rows if int(r[f"found_{pitch}"]) >= LEAST_SHARE * int(r["frames"])]
            depth, floor = (np.array([float(r[n]) for r in seen]) for n in ("depth_error", f"floor_{pitch}"))
            slope = (floor @ depth) / (floor @ floor)
            for share in (1.0, FLOOR_SHARE[pitch == "given"]):
                for limit in (0.0, LEAST_FLOOR_SCALE):
                    moved = np.abs(floor) >= limit
                    before, after = np.abs(depth), np.abs(depth - share * floor * moved)
                    cells = [weights, pitch, f"{slope:.2f}", f"{share:g}", f"{limit:g}"]
                    cells += [f"{np.median(before):.3f}", f"{np.median(after):.3f}"]
                    cells += [f"{moved.sum()} of {len(moved)}", str((after > before).sum())]
                    lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "Made by `python experiments/adapt/floors.py`."]
    STORED.with_suffix(".md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

"""Score weights or an exported file on what people point a camera at: places, shapes, lenses, distances.

python experiments/bench/run.py eldenet_indoor
python experiments/bench/run.py int8=exports/indoor-int8.onnx --runtime onnxruntime --places nyu
python experiments/bench/run.py indoor_exponent=eldenet_indoor --lens-exponent 0.85
python experiments/bench/run.py          the table of what is stored

A shape or a longer lens is a part of the frame, with the focal length of the frame. Its depth is scored on
its own pixels, beside the whole frame's depth on the same pixels. Frames are those of ``$ELDENET_DATA``;
rooms are rendered.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.deploy import runtimes  # noqa: E402
from eldenet.deploy.predictor import DepthPredictor  # noqa: E402
from eldenet.evaluation.bootstrap import mean_interval, scenes_of  # noqa: E402
from eldenet.evaluation.protocol import EvalProtocol  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.results.tables import to_markdown  # noqa: E402
from eldenet.system.files import read_table, write_rows, write_text  # noqa: E402
from eldenet.uncertainty import DepthEstimate, as_estimate  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[1]))
from places import OTHER_CAMERAS, camera_frames, split_frames  # noqa: E402

HERE = Path(__file__).parent
STORED = HERE / "frames.csv.xz"
ROOMS = ["data=rooms", "data.size=[192,256]", "data.frames.test=64", "data.detail=true"]
#: Place -> settings of its frames and their split; the others are places of other cameras.
SPLITS = {
    "nyu": (["data=nyu_labelled"], "val"),
    "nyu_dev": (["data=nyu_labelled", "data.val.split=dev"], "val"),
    "rooms": (ROOMS, "test"),
    "rooms_near": ([*ROOMS, "data.near=1"], "test"),
    "rooms_down": ([*ROOMS, "data.down=1"], "test"),
    "rooms_plain": ([*ROOMS, "data.plain=1"], "test"),
}
PLACES = (*SPLITS, *OTHER_CAMERAS)
SHAPES = {"16:9": 16 / 9, "2:1": 2.0, "3:4": 3 / 4, "9:16": 9 / 16}  # width / height
ZOOMS = {"1.25x": 1.25, "1.5x": 1.5, "2x": 2.0}
BINS = ((0.2, 0.5), (0.5, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 10.0))  # true depth [m]
NEAR = tuple(f"abs_rel_{low:g}_{high:g}" for low, high in BINS)
WHOLE = ("delta1", "abs_rel", "delta1_aligned")  # in the table of whole frames
FIGURES = (*WHOLE, "median_truth", "median_depth", "inside80", *NEAR)  # of a whole frame
#: Of each part: delta1 of its own depth, and of the whole frame's on the same pixels.
OF_PARTS = [f"{figure}_{part}" for part in (*SHAPES, *ZOOMS) for figure in ("delta1", "whole_delta1")]
COLUMNS = ("weights", "runtime", "place", "frame", *FIGURES, *OF_PARTS)
ENOUGH = 50  # pixels of a distance


def part_of(size: tuple[int, int], part: str) -> tuple[slice, slice]:
    """Rows and columns of the middle of a frame of ``(height, width)`` that a shape or a lens shows."""
    height, width = size
    if part in ZOOMS:
        seen = round(height / ZOOMS[part]), round(width / ZOOMS[part])
    else:
        seen = min(height, round(width / SHAPES[part])), min(width, round(height * SHAPES[part]))
    starts = [(side - length) // 2 for side, length in zip(size, seen, strict=True)]
    return tuple(slice(start, start + length) for start, length in zip(starts, seen, strict=True))


def share_right(depth: np.ndarray, truth: np.ndarray) -> float:
    """delta1 of valid depths ``(N,)`` [m]."""
    return float((np.maximum(depth / truth, truth / depth) < 1.25).mean())


def figures(found, truth: np.ndarray, known: np.ndarray, protocol: EvalProtocol) -> list[float]:
    """``FIGURES`` of a whole frame from its estimate and its true depth [m]."""
    truth = truth[known]
    depth = found.depth[known].clip(protocol.min_depth, protocol.max_depth)
    aligned = depth * np.median(truth) / np.median(depth)
    relative = np.abs(depth - truth) / truth
    inside = math.nan
    if found.sigma is not None:
        low, high = (limit[known] for limit in found.interval(0.8))
        inside = float(((low <= truth) & (truth <= high)).mean())
    near = [relative[(truth >= low) & (truth < high)] for low, high in BINS]
    return [
        share_right(depth, truth),
        float(relative.mean()),
        share_right(aligned, truth),
        float(np.median(truth)),
        float(np.median(depth)),
        inside,
        *(float(part.mean()) if len(part) >= ENOUGH else math.nan for part in near),
    ]


def focal_for(predictor: DepthPredictor, focal: float, size: Sequence[int], exponent: float) -> float:
    """Fx [px] that gives canonical depth times a power of the ratio of focal lengths, if that is above 1."""
    ratio = focal * predictor.size_for(size[0], size[1])[1] / size[1] / predictor.canonical_px
    return focal * min(1.0, ratio ** (exponent - 1))


def predict(predictor: DepthPredictor, image: np.ndarray, focal: float, exponent: float) -> DepthEstimate:
    """The estimate of a picture, which a network that knows no focal lengths is not told."""
    known = focal_for(predictor, focal, image.shape, exponent) if predictor.canonical_px else None
    return as_estimate(predictor(image, focal=known))


def score(name: str, predictor: DepthPredictor, place: str, exponent: float) -> Iterator[list[object]]:
    """Rows of a network's frames of a place."""
    protocol, frames = split_frames(*SPLITS[place]) if place in SPLITS else camera_frames(place)
    runtime = getattr(predictor.model, "runtime", "torch")
    for image, depth, intrinsics, frame, *_ in frames:
        truth, mask = (torch.from_numpy(values)[None, None] for values in (depth, depth > 0))
        known = protocol.valid_mask(truth, mask)[0, 0].numpy()
        if known.sum() < ENOUGH:
            continue
        found = predict(predictor, image, intrinsics[0, 0], exponent)
        values = figures(found, depth, known, protocol)
        for part in (*SHAPES, *ZOOMS):
            box = part_of(depth.shape, part)
            seen = known[box]
            if seen.sum() < ENOUGH:
                values += [math.nan, math.nan]
                continue
            own = predict(predictor, np.ascontiguousarray(image[box]), intrinsics[0, 0], exponent).depth
            for one in (own, found.depth[box]):
                limited = one[seen].clip(protocol.min_depth, protocol.max_depth)
                values.append(share_right(limited, depth[box][seen]))
        yield [name, runtime, place, frame, *(f"{value:.4g}" for value in values)]


def predictor_of(source: str, runtime: str) -> DepthPredictor:
    """The predictor of weights, or of an exported file."""
    is_file = Path(source).suffix in runtimes.READS
    network = runtimes.load(source, runtime, threads=1) if is_file else eldenet.load(source)
    return DepthPredictor(network, steady=False, uncertainty=network.distribution is not None)


def log_slopes(rows: Sequence[dict[str, str]]) -> list[str]:
    """Slopes between the ln medians of frames: predicted over true, and true over predicted.

    The first is 1 where the scale follows the scene. Where the second is 1, no correction of the predicted
    scale alone helps on average: the first is as low as the picture leaves the scale unsure.
    """
    truth, depth = (np.log([float(row[name]) for row in rows]) for name in ("median_truth", "median_depth"))
    return [f"{np.polyfit(*pair, 1)[0]:.2f}" for pair in ((truth, depth), (depth, truth))]


def mean(rows: Sequence[dict[str, str]], figure: str) -> str:
    """The mean of a figure over the frames that have it."""
    values = np.array([float(row[figure]) for row in rows])
    return f"{np.nanmean(values):.3f}" if np.isfinite(values).any() else ""


def change(rows: Sequence[dict[str, str]], part: str) -> str:
    """delta1 of parts, and how far it lies from the whole frame's on the same pixels, with its interval."""
    rows = [row for row in rows if math.isfinite(float(row[f"delta1_{part}"]))]
    if not rows:
        return ""
    values = np.array([float(row[f"delta1_{part}"]) - float(row[f"whole_delta1_{part}"]) for row in rows])
    low, high = mean_interval(values, scenes_of([row["frame"] for row in rows]))
    return f"{mean(rows, f'delta1_{part}')} ({values.mean():+.3f} [{low:+.3f}, {high:+.3f}])"


def report(stored: Sequence[dict[str, str]]) -> None:
    """Write ``results.md``."""
    groups: dict[tuple[str, str, str], list[dict[str, str]]] = {}
    for row in stored:
        groups.setdefault((row["place"], row["weights"], row["runtime"]), []).append(row)
    text = ["# bench\n"]
    heads = {
        "Whole frames": ["frames", "δ1", "AbsRel", "δ1, aligned", "log slope", "back", "inside 80 %"],
        "Distances: AbsRel of pixels at": [f"{low:g} to {high:g} m" for low, high in BINS],
        "Shapes: δ1 (less the whole frame's on the same pixels)": list(SHAPES),
        "Lenses: δ1 (less the whole frame's on the same pixels)": list(ZOOMS),
    }
    for number, (title, columns) in enumerate(heads.items()):
        lines = []
        for key, rows in sorted(groups.items(), key=lambda item: (PLACES.index(item[0][0]), item[0])):
            cells = [
                [len(rows), *(mean(rows, name) for name in WHOLE), *log_slopes(rows), mean(rows, "inside80")],
                [mean(rows, name) for name in NEAR],
                [change(rows, part) for part in SHAPES],
                [change(rows, part) for part in ZOOMS],
            ][number]
            if any(cells):
                lines.append([*key, *map(str, cells)])
        text.append(f"## {title}\n\n{to_markdown(['place', 'weights', 'runtime', *columns], lines, [])}")
    facts = environment()
    machine = f"{facts['hardware']['processor']}, 1 thread, torch {facts['versions']['torch']}"
    text.append(
        "Brackets: 95 % intervals over scenes. Aligned: each frame times median(truth) / median(prediction). "
        "Inside: share of pixels whose true depth lies in the 80 % interval. Log slope: of predicted over "
        f"true median, over frames; back: of true over predicted. {machine}. "
        "Made by `python experiments/bench/run.py`.\n"
    )
    write_text(HERE / "results.md", "\n".join(text))


def main() -> None:
    """Score ``sources``, store the figures of their frames, and write the report."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument(
        "sources", nargs="*", help="packaged weights, folders or exported files, or NAME=SOURCE"
    )
    options.add_argument(
        "--places", nargs="*", choices=PLACES, default=[name for name in PLACES if name != "nyu_dev"]
    )
    options.add_argument("--runtime", default="auto", help="of an exported file")
    options.add_argument("--lens-exponent", type=float, default=1.0, help="of experiments/lens/exponent.py")
    args = options.parse_args()
    torch.set_num_threads(1)
    stored = [dict(row) for row in read_table(STORED, COLUMNS)] if STORED.exists() else []
    for given in args.sources:
        name, _, source = given.rpartition("=")
        predictor = predictor_of(source, args.runtime)
        for place in args.places:
            rows = [
                dict(zip(COLUMNS, map(str, row), strict=True))
                for row in score(name or source, predictor, place, args.lens_exponent)
            ]
            new = {(row["weights"], row["runtime"], row["place"]) for row in rows}
            stored = [
                row for row in stored if (row["weights"], row["runtime"], row["place"]) not in new
            ] + rows
            write_rows(STORED, COLUMNS, [[row[column] for column in COLUMNS] for row in stored])
            print(name or source, place, mean(rows, "delta1"), flush=True)
    report(stored)


if __name__ == "__main__":
    main()

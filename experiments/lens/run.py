"""Measure what a longer lens does to depth, on center crops of real frames.

python experiments/lens/run.py runs/seed0 runs/seed1 runs/seed2

A crop shows what a longer lens at the same place would see. Its depth is compared with the depth of the whole
frame cut to the same pixels, so both are scored on the same pixels. Frames are those of ``$ELDENET_DATA``.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from eldenet.system.resources import prepare_environment

prepare_environment()

import cv2  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.evaluation.bootstrap import mean_interval  # noqa: E402
from eldenet.evaluation.protocol import EvalProtocol  # noqa: E402
from eldenet.geometry import crop_intrinsics  # noqa: E402
from eldenet.results.plots import pyplot_for_files, save_figure  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.system.files import read_table, write_rows  # noqa: E402
from eldenet.system.timing import median_ms, time_interleaved  # noqa: E402
from eldenet.types import Frame  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[1]))
from places import OTHER_CAMERAS, camera_frames, split_frames  # noqa: E402

HERE = Path(__file__).parent
FACTORS = (1.0, 1.25, 1.5, 2.0)
CAMERAS = ("given", "not given")
PLACES = ("nyu", *OTHER_CAMERAS)


class Row(NamedTuple):
    """Figures of one network, place, factor and camera: per image, on the pixels of the crop.

    Attributes:
        crop: delta1 and AbsRel of the crop's own prediction ``(N, 2)``.
        whole: of the whole frame's prediction ``(N, 2)``.
    """

    weights: str
    place: str
    factor: float
    camera: str
    crop: np.ndarray
    whole: np.ndarray


def frames_of(place: str, count: int | None, part: str = "val") -> tuple[EvalProtocol, list[Frame]]:
    """Return the rules of a place and up to ``count`` of its frames, spread over all."""
    nyu = ["data=nyu_labelled", f"data.val.split={part}"]
    protocol, frames = camera_frames(place) if place in OTHER_CAMERAS else split_frames(nyu)
    return protocol, frames[:: 1 if count is None else -(-len(frames) // count)]


def center(size: tuple[int, int], factor: float) -> tuple[slice, slice]:
    """Rows and columns of the middle of a frame that a lens ``factor`` times as long sees."""
    starts = [(side - round(side / factor)) // 2 for side in size]
    return tuple(slice(a, a + round(side / factor)) for a, side in zip(starts, size, strict=True))


def errors(
    predicted: np.ndarray, depth: np.ndarray, valid: np.ndarray, protocol: EvalProtocol
) -> list[float]:
    """Return delta1 and AbsRel of a map [m]."""
    guess, truth = predicted.clip(protocol.min_depth, protocol.max_depth)[valid], depth[valid]
    ratio = np.maximum(guess / truth, truth / guess)
    return [float((ratio < 1.25).mean()), float((np.abs(guess - truth) / truth).mean())]


def score(source: str, place: str, protocol: EvalProtocol, frames: list[Frame]) -> Iterator[Row]:
    """Score a network's crops of a place; one that knows no focal lengths is given none."""
    predictor = eldenet.DepthPredictor(eldenet.load(source), steady=False)
    cameras = CAMERAS if predictor.canonical_px else CAMERAS[1:]
    found = {(factor, camera): ([], []) for factor in FACTORS for camera in cameras}
    for image, depth, intrinsics, *_ in frames:
        truth, mask = (torch.from_numpy(values)[None, None] for values in (depth, depth > 0))
        known = protocol.valid_mask(truth, mask)[0, 0].numpy()
        for camera in cameras:
            whole = predictor(image, intrinsics=intrinsics if camera == "given" else None)
            for factor in FACTORS:
                box = center(depth.shape, factor)
                if not known[box].any():
                    continue
                part = crop_intrinsics(intrinsics, box[0].start, box[1].start)
                seen = predictor(
                    np.ascontiguousarray(image[box]), intrinsics=part if camera == "given" else None
                )
                crops, wholes = found[factor, camera]
                crops.append(errors(seen, depth[box], known[box], protocol))
                wholes.append(errors(whole[box], depth[box], known[box], protocol))
    name = Path(source).name
    for (factor, camera), (crops, wholes) in found.items():
        yield Row(name, place, factor, camera, np.array(crops), np.array(wholes))


def latency(source: str, frame: Frame) -> str:
    """Return a sentence about the time that a frame takes with its focal length and without."""
    model = eldenet.load(source)
    predictor = eldenet.DepthPredictor(model, steady=False)
    size = predictor.size_for(*frame.depth.shape)
    image = torch.rand(1, 3, *size)
    calls = {"network": lambda: model(image), "predictor": lambda: predictor(frame.image)}
    if model.canonical_px:
        calls["network with focal"] = lambda: model(image, focal=200.0)
        calls["predictor with intrinsics"] = lambda: predictor(frame.image, intrinsics=frame.intrinsics)
    with torch.inference_mode():
        times = time_interleaved(calls, rounds=15)
    shown = "; ".join(f"{name}: {median_ms(times[name]):.2f} ms" for name in times)
    return f"Median latency at {size[0]} x {size[1]}, in turns: {shown}."


def summary(rows: list[Row]) -> Iterator[dict[str, object]]:
    """Average over the networks: figures per place, factor and camera, differences with their intervals."""
    for place in dict.fromkeys(row.place for row in rows):
        for factor in FACTORS:
            for camera in dict.fromkeys(row.camera for row in rows):
                same = [r for r in rows if (r.place, r.factor, r.camera) == (place, factor, camera)]
                crop, whole = (
                    np.mean([getattr(r, name) for r in same], axis=0) for name in ("crop", "whole")
                )
                change = crop - whole  # per image, mean over the networks
                lines: dict[str, object] = {"place": place, "factor": factor, "camera": camera}
                for column, name in enumerate(("delta1", "abs_rel")):
                    values = change[:, column]
                    low, high = mean_interval(values)
                    lines |= {
                        name: float(crop[:, column].mean()),
                        f"{name}_whole": float(whole[:, column].mean()),
                        f"{name}_change": float(values.mean()),
                        f"{name}_interval": (low, high),
                    }
                yield lines


def table(rows: list[Row]) -> list[str]:
    columns = ("place", "lens", "focal length", "δ1", "whole frame", "change", "95 %")
    columns += ("AbsRel", "whole frame", "change", "95 %")
    lines = ["| " + " | ".join(columns) + " |", "|---|---:|---|" + 2 * "---:|---:|---:|---|"]
    for line in summary(rows):
        cells = [line["place"], f"{line['factor']:g}x", line["camera"]]
        for name in ("delta1", "abs_rel"):
            low, high = line[f"{name}_interval"]
            cells += [f"{line[name]:.3f}", f"{line[f'{name}_whole']:.3f}", f"{line[f'{name}_change']:+.3f}"]
            cells.append(f"{low:+.3f} to {high:+.3f}")
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return lines


def draw(rows: list[Row], path: Path) -> None:
    """Plot both metrics over the lens, for each place; thin lines are single networks."""
    pyplot = pyplot_for_files()
    places = list(dict.fromkeys(row.place for row in rows))
    figure, panels = pyplot.subplots(
        2, len(places), figsize=(3.2 * len(places), 5), sharex=True, squeeze=False, layout="constrained"
    )
    cameras = list(dict.fromkeys(row.camera for row in rows))
    kinds = [("whole frame, same pixels", cameras[0], "whole", "#999999")]
    colors = {"given": "#3b6ea5", "not given": "#c1554d"}
    kinds += [(f"crop, focal length {camera}", camera, "crop", colors[camera]) for camera in cameras]
    for column, place in enumerate(places):
        for metric, name in enumerate(("δ1", "AbsRel")):
            axes = panels[metric][column]
            for label, camera, figures, color in kinds:
                lines = [
                    [
                        getattr(r, figures)[:, metric].mean()
                        for r in rows
                        if (r.weights, r.place, r.camera) == (weights, place, camera)
                    ]
                    for weights in dict.fromkeys(row.weights for row in rows)
                ]
                for line in lines:
                    axes.plot(FACTORS, line, color=color, linewidth=0.6, alpha=0.6)
                axes.plot(FACTORS, np.mean(lines, axis=0), color=color, marker="o", label=label)
            axes.set_ylabel(name)
            axes.grid(alpha=0.3)
            axes.spines[["top", "right"]].set_visible(False)
        panels[0][column].set_title(place)
        panels[1][column].set_xticks(FACTORS, [f"{factor:g}x" for factor in FACTORS])
        panels[1][column].set_xlabel("lens")
    panels[0][0].legend(fontsize=7)
    save_figure(figure, path)


def write_csv(rows: list[Row], output: Path) -> None:
    """Write one line per network, place, factor and camera into ``figures.csv``, which has all tables."""
    names = ("delta1", "delta1_whole", "abs_rel", "abs_rel_whole")
    columns = ["table", "weights", "place", "factor", "focal_length", "frames", *names]
    path = output.with_name("figures.csv")
    stored = [list(line.values()) for line in read_table(path, columns)] if path.is_file() else []
    lines: list[list[object]] = [line for line in stored if line[0] != output.name]
    for row in rows:
        crop, whole = row.crop.mean(axis=0), row.whole.mean(axis=0)
        figures = [f"{value:.4f}" for value in (crop[0], whole[0], crop[1], whole[1])]
        lines.append([output.name, row.weights, row.place, row.factor, row.camera, len(row.crop), *figures])
    write_rows(path, columns, lines)


def main() -> None:
    """Score, then write a table in Markdown, one in CSV, and a plot."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("weights", nargs="+", help="run folders or packaged weights, one per seed")
    options.add_argument("--frames", type=int, help="frames per place; all unless given")
    options.add_argument("--part", default="val", help="of NYU: val, or dev to choose a recipe on")
    options.add_argument("--places", nargs="+", default=PLACES, help="some of the places")
    options.add_argument(
        "--output",
        type=Path,
        default=HERE / "results",
        help="name of the table and the plot, without an ending",
    )
    given = options.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    rows: list[Row] = []
    for place in given.places:
        protocol, frames = frames_of(place, given.frames, given.part)
        for source in given.weights:
            rows += score(source, place, protocol, frames)
        print("\n".join(table([row for row in rows if row.place == place])), flush=True)
    model = eldenet.load(given.weights[0])
    known = f"canonical camera of {model.canonical_px:g} px" if model.canonical_px else "no canonical camera"
    where = environment()
    counts = {row.place: len(row.crop) for row in rows}
    lines = [
        f"{where['hardware']['processor']}, 1 thread, torch {where['versions']['torch']}, {where['date']}; "
        f"{', '.join(Path(source).name for source in given.weights)}, {known}; frames: "
        f"{', '.join(f'{place} {count}' for place, count in counts.items())} (NYU's part {given.part}).",
        "",
        *table(rows),
        "",
        latency(given.weights[0], frames_of("nyu", 1)[1][0]),
        "",
        "Made by `python experiments/lens/run.py`.",
    ]
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.with_suffix(".md").write_text("\n".join(lines) + "\n")
    write_csv(rows, given.output)
    draw(rows, given.output.with_suffix(".png"))


if __name__ == "__main__":
    main()

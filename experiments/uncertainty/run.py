"""Score networks that know their sigma beside plain ones and beside the mirror-image trick.

python experiments/uncertainty/run.py --runs runs/uncertainty

The folder holds trainings as ``<row>/seed<number>``, see README.md. Every network's temperature is fitted on
the frames of ``dev``; all figures are of ``val``. What is in ``scores.jsonl.xz`` is not scored again.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.compose import compose  # noqa: E402
from eldenet.data.base import DepthDataset  # noqa: E402
from eldenet.data.loaders import collate  # noqa: E402
from eldenet.data.nyu_scenes import VAL_FRAMES  # noqa: E402
from eldenet.evaluation.bootstrap import bootstrap_interval  # noqa: E402
from eldenet.evaluation.calibration import fit_temperature  # noqa: E402
from eldenet.evaluation.metric_names import UNCERTAINTY_METRICS  # noqa: E402
from eldenet.evaluation.protocol import EvalProtocol  # noqa: E402
from eldenet.evaluation.splits import chosen_protocol, open_split  # noqa: E402
from eldenet.evaluation.uncertainty_metrics import PROTOCOL, UncertaintyMeter, UncertaintyScores  # noqa: E402
from eldenet.model import DepthNet  # noqa: E402
from eldenet.results.packed_runs import read_records, write_records  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.results.uncertainty_plots import sparsification_plot  # noqa: E402
from eldenet.system.files import read_table, write_rows, write_text  # noqa: E402
from eldenet.system.timing import median_ms, time_interleaved  # noqa: E402
from eldenet.train import TrainSettings  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[1]))
from places import camera_split  # noqa: E402

HERE = Path(__file__).parent
SCORES, IMAGES = HERE / "scores.jsonl.xz", HERE / "images.csv.xz"  # of each run; of its images
LATENCY = "latency"  # name of a record of SCORES
LEAST_SPREAD = 1e-4  # of the mirror-image trick, where both predictions agree
COLUMNS = ("name", "abs_rel", "delta1", *UNCERTAINTY_METRICS)
#: Place -> an input of 120 rows with its pictures' aspect.
PLACES = {"hololens_office": (120, 180), "tum_fr3_cabinet": (120, 160)}
PLAIN = "plain"


class Scored(NamedTuple):
    """One network on one set of frames.

    Attributes:
        depth: ``(name, abs_rel, delta1)`` per image.
        own: measures of its own sigma; None: it knows none.
        mirror: of the difference between the depth of a picture and of its mirror image.
    """

    depth: list[tuple[str, float, float]]
    own: UncertaintyScores | None
    mirror: UncertaintyScores


@torch.inference_mode()
def score(model: DepthNet, frames: DepthDataset, protocol: EvalProtocol) -> Scored:
    """Predict every frame and its mirror image once."""
    meters = {name: UncertaintyMeter(model.distribution or "laplace") for name in ("own", "mirror")}
    rows = []
    for index in range(len(frames)):
        batch: dict[str, Any] = collate([frames[index]])
        truth, valid = batch["depth"], protocol.valid_mask(batch["depth"], batch["mask"])
        if not valid.any():
            continue
        estimate, mirrored = model.predict(batch["image"]), model(batch["image"].flip(-1)).flip(-1)
        depth = protocol.align(estimate.depth, truth, valid)
        spreads = {"mirror": (estimate.depth / mirrored).log().abs().clamp(min=LEAST_SPREAD)}
        if estimate.sigma is not None:
            spreads["own"] = estimate.spread
        for name, spread in spreads.items():
            resized = protocol.resize_to_gt(spread, truth.shape[-2:])
            meters[name].update(batch["name"], depth, truth, resized, valid)
        p, g = depth[valid].double(), truth[valid].double()
        right = (torch.maximum(p / g, g / p) < 1.25).double().mean()
        rows.append((batch["name"][0], float(((p - g).abs() / g).mean()), float(right)))
    own = meters["own"].compute() if model.distribution else None
    return Scored(rows, own, meters["mirror"].compute())


def nyu(split: str) -> tuple[DepthDataset, EvalProtocol]:
    """Frames of a part of the labeled set, with their own depth."""
    config = compose(
        TrainSettings, ["+experiment=nyu_study", "model_name=any", "output=any", f"data.val.split={split}"]
    )
    protocol = chosen_protocol(config.data, config.protocol)
    return open_split(config.data, "val", protocol), protocol


def measure(run: Path, name: str) -> None:
    """Score one training and add its figures under its name."""
    model = eldenet.load(str(run)).eval()
    frames, protocol = nyu("val")
    record: dict[str, Any] = {
        "row": run.parent.name,
        "seed": int(run.name.removeprefix("seed")),
        "temperature": None,
    }
    record["uncertainty_protocol"], record["protocol"] = PROTOCOL.as_dict(), protocol.as_dict()
    if model.distribution:
        before = score(model, frames, protocol).own
        assert before is not None
        record["coverage90_before"] = before.metrics["coverage90"]
        record["temperature"] = fit_temperature(model, *nyu("dev"))
    found = score(model, frames, protocol)
    rows = [list(row.values()) for row in image_rows() if row["run"] != name]
    for kind, scores in (("own", found.own), ("mirror", found.mirror)):
        if scores is not None:
            for left, right in zip(found.depth, scores.rows, strict=True):
                figures = (f"{value:.5g}" for value in (*left[1:], *right[1:]))
                rows.append([name, kind, left[0], *figures])
            record[kind] = {
                "curves": {error: curve.tolist() for error, curve in scores.curves.items()},
                "coverage": scores.coverage.tolist(),
            }
    record["other_cameras"] = {place: elsewhere(model, place) for place in PLACES if model.distribution}
    write_rows(IMAGES, ("run", "sigma", *COLUMNS), rows)
    write_records(SCORES, read_records(SCORES) | {name: record | environment()})


def image_rows() -> list[dict[str, str]]:
    """The stored figures of images."""
    return read_table(IMAGES, ("run", "sigma", *COLUMNS)) if IMAGES.is_file() else []


def elsewhere(model: DepthNet, place: str) -> dict[str, float]:
    """Figures on another camera's frames: sigma as it comes."""
    protocol, frames = camera_split(place, PLACES[place])
    found = score(model, frames, protocol)
    assert found.own is not None
    means = {"abs_rel": float(np.mean([row[1] for row in found.depth]))}
    means["delta1"] = float(np.mean([row[2] for row in found.depth]))
    return (
        means
        | found.own.metrics
        | {f"mirror_{key}": found.mirror.metrics[key] for key in ("ause_abs_rel", "ause_rmse")}
    )


def scene_of(name: str) -> int:
    """Number of the block of frames, which is a scene, of a labeled frame."""
    number = int(Path(name).stem)
    return next(i for i, (first, last) in enumerate(VAL_FRAMES) if first <= number <= last)


def images(row: str, kind: str, seeds: Sequence[int]) -> dict[str, np.ndarray]:
    """Mean over seeds of a row's figures of each image, by column, and the scene of each image."""
    stored, names = image_rows(), [f"{row}/seed{seed}" for seed in seeds]
    tables = [[line for line in stored if (line["run"], line["sigma"]) == (name, kind)] for name in names]
    return {
        column: np.mean([[float(line[column]) for line in table] for table in tables], axis=0)
        for column in COLUMNS[1:]
    } | {"scene": np.array([scene_of(line["name"]) for line in tables[0]])}


def by_scene(found: Mapping[str, np.ndarray], figure: Callable[[Mapping[str, np.ndarray]], float]) -> str:
    """A figure of images with its interval over the scenes that were drawn, as a table shows it."""
    scenes = [np.flatnonzero(found["scene"] == number) for number in np.unique(found["scene"])]

    def of(drawn: np.ndarray) -> float:
        rows = np.concatenate([scenes[number] for number in drawn])
        return figure({name: values[rows] for name, values in found.items()})

    low, high = bootstrap_interval(of, len(scenes))
    return f"{figure(found):.3f} ({low:.3f} to {high:.3f})"


def mean_of(name: str) -> Callable[[Mapping[str, np.ndarray]], float]:
    """The mean over images of a column."""
    return lambda found: float(found[name].mean())


def left_share(found: Mapping[str, np.ndarray]) -> float:
    """AbsRel without the least certain fifth, of the whole AbsRel."""
    return float(found["abs_rel_sure80"].mean() / found["abs_rel"].mean())


def latency(rows: Sequence[tuple[str, Path]]) -> list[list[str]]:
    """Medians of one picture of 120 x 160 [ms], in turns in one process, with sigma where it is known."""
    from eldenet.deploy import runtimes

    image = np.random.default_rng(0).random((1, 3, 120, 160), np.float32)
    calls = {}
    for row, run in rows:
        model = eldenet.load(str(run))
        for runtime in ("torch", "onnxruntime", "openvino"):
            network = runtimes.load(model, runtime, threads=1, size=(120, 160))
            calls[row, runtime] = lambda network=network: network.run_maps(image)
    times = time_interleaved(calls, rounds=60, seconds=0.05)
    return [
        [row, *(f"{median_ms(times[row, name]):.3f}" for name in ("torch", "onnxruntime", "openvino"))]
        for row, _ in rows
    ]


def markdown(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table."""
    lines = [titles, ["---"] * len(titles), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def report(runs: Path | None, *, time_it: bool) -> None:
    """Write ``results.md`` and the plots from what is stored; ``time_it``: measure latencies first."""
    stored = read_records(SCORES)
    records = [record for name, record in sorted(stored.items()) if name != LATENCY]
    names = sorted({record["row"] for record in records}, key=lambda name: (name == PLAIN, name))
    seeds = {name: [record["seed"] for record in records if record["row"] == name] for name in names}
    lines, curves, temperatures, rows = [], {}, [], []
    for name in names:
        own = [record for record in records if record["row"] == name]
        for kind, label in (("own", f"{name}: sigma"), ("mirror", f"{name}: mirror image")):
            if kind not in own[0]:
                continue
            found = images(name, kind, seeds[name])
            cells = [by_scene(found, mean_of(metric)) for metric in ("ause_abs_rel", "ause_rmse")]
            cells += [by_scene(found, left_share)]
            cells += [
                by_scene(found, mean_of(metric)) if kind == "own" else "-"
                for metric in ("coverage50", "coverage80", "coverage90", "coverage95", "nll")
            ]
            rows.append([label, str(len(own)), *cells])
            curves[label] = {
                error: np.mean([record[kind]["curves"][error] for record in own], axis=0)
                for error in ("abs_rel", "rmse")
            }
        if "own" in own[0]:
            temperatures += [
                f"- {name}, seed {record['seed']}: temperature {record['temperature']:.3f}; without it 90 % "
                f"intervals cover {record['coverage90_before']:.3f}"
                for record in own
            ]
    titles = ["uncertainty", "seeds", "AUSE AbsRel ↓", "AUSE RMSE ↓", "AbsRel of the sure 80 % / all ↓"]
    titles += ["in 50 %", "in 80 %", "in 90 %", "in 95 %", "NLL ↓"]
    lines += ["# Results", "", "130 frames of 23 scenes (`val`); intervals over scenes drawn 2000 times.", ""]
    lines += [markdown(titles, rows), "", *temperatures, "", "## Depth", ""]
    lines += [
        markdown(["row", "seeds", "δ1 ↑", "AbsRel ↓", "δ1 - plain, same seeds"], depth_rows(seeds)),
        "",
    ]
    lines += ["## Other cameras, as it comes", "", markdown(*elsewhere_rows(records)), ""]
    if time_it and runs is not None:
        firsts = [(name, runs / name / "seed0") for name in names if (runs / name / "seed0").is_dir()]
        stored[LATENCY] = {"rows": latency(firsts)} | environment()
        write_records(SCORES, stored)
    if LATENCY in stored:
        lines += [
            "## Latency",
            "",
            "Median of one 120 x 160 picture [ms], one thread, in turns in one process.",
        ]
        cells = stored[LATENCY]["rows"]
        lines += ["", markdown(["row", "torch", "ONNX Runtime", "OpenVINO"], cells), ""]
    processor = records[0]["hardware"]["processor"]
    lines += [
        f"Machine: {processor}. Protocol of sigma: {PROTOCOL.name}; of depth: "
        f"{records[0]['protocol']['name']}."
    ]
    write_text(HERE / "results.md", "\n".join(lines) + "\n")
    sparsification_plot(HERE / "sparsification.png", curves)


def depth_rows(seeds: Mapping[str, Sequence[int]]) -> list[list[str]]:
    """Depth of each row, and its difference to the plain head's of the same seeds."""
    rows = []
    for name, own in seeds.items():
        found = images(name, "mirror", own)  # every row has this file
        cells = [by_scene(found, mean_of(metric)) for metric in ("delta1", "abs_rel")]
        shared = [seed for seed in own if seed in seeds.get(PLAIN, ())]
        difference = "-"
        if name != PLAIN and shared:
            ours, plain = (images(row, "mirror", shared) for row in (name, PLAIN))
            both = {"scene": ours["scene"], "difference": ours["delta1"] - plain["delta1"]}
            difference = by_scene(both, mean_of("difference"))
        rows.append([name, str(len(own)), *cells, difference])
    return rows


def elsewhere_rows(records: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Means over the seeds of each row and place."""
    columns = [
        "delta1",
        "abs_rel",
        "ause_abs_rel",
        "mirror_ause_abs_rel",
        "ause_rmse",
        "mirror_ause_rmse",
        "abs_rel_sure80",
        "coverage50",
        "coverage80",
        "coverage90",
        "coverage95",
    ]
    rows = []
    for name in sorted({record["row"] for record in records if record["other_cameras"]}):
        for place in PLACES:
            found = [record["other_cameras"][place] for record in records if record["row"] == name]
            rows.append(
                [name, place, *(f"{np.mean([one[column] for one in found]):.3f}" for column in columns)]
            )
    return ["row", "place", *columns], rows


def main() -> None:
    """Score what is not stored yet, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--runs",
        type=Path,
        help="folder of the trainings; without it the page is written from what is stored",
    )
    parser.add_argument("--latency", action="store_true", help="measure latencies too, on an idle machine")
    arguments = parser.parse_args()
    runs: Path | None = arguments.runs
    torch.set_num_threads(1)
    for record in sorted(runs.glob("*/seed*/run.json")) if runs else ():
        name = f"{record.parent.parent.name}/{record.parent.name}"
        if name not in read_records(SCORES):
            print(f"scoring {record.parent}", flush=True)
            measure(record.parent, name)
    report(runs, time_it=arguments.latency)


if __name__ == "__main__":
    main()

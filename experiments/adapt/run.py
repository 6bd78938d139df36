"""Measure what ``python -m eldenet.adapt`` gives for real and rendered cameras.

python experiments/adapt/run.py eldenet_indoor

Tables, page and plot go to the folder of the weights. Trials that are written already are not run again,
so an interrupted run goes on.
"""

import argparse
import csv
import tempfile
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import matplotlib  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402
from places import CAMERAS, REAL, write_place  # noqa: E402

import eldenet  # noqa: E402
from eldenet.adapt import AdaptSettings, adapt  # noqa: E402
from eldenet.compose import compose  # noqa: E402
from eldenet.data.io import read_depth, read_image  # noqa: E402
from eldenet.deploy.predictor import DepthPredictor, for_camera  # noqa: E402
from eldenet.geometry import PinholeCamera, pinhole  # noqa: E402
from eldenet.perception.camera_height import FREE_SLOPE  # noqa: E402
from eldenet.perception.ground import fit_ground  # noqa: E402
from eldenet.results.plots import save_figure  # noqa: E402
from eldenet.results.run_record import RUN_FILE, environment, read_record  # noqa: E402
from eldenet.system.files import read_table  # noqa: E402

HERE = Path(__file__).parent
WORK = Path(tempfile.gettempdir()) / "eldenet-adapt"  # frames and run folders
FRAMES = 125  # of a trial, of which adapt holds out a quarter
EPOCHS = dict.fromkeys((*CAMERAS, *REAL), 6) | {"tum_fr3_cabinet": 12}  # it has few frames
TIMES = 10  # as much training is what a trial is compared with
LONG = ("hololens_office", "robot_wide", "hand_wide")  # places with ten times the training
DEPTH, HEIGHT = "depth_frames.csv", "camera_height.csv"
DEPTH_HEADER = [
    "weights",
    "place",
    "block",
    "seed",
    "epochs",
    "frames",
    "kept",
    "report_frames",
    "abs_rel_before",
]
DEPTH_HEADER += ["abs_rel_after", "delta1_before", "delta1_after"]
HEIGHT_HEADER = [
    "weights",
    "place",
    "block",
    "pitch",
    "outcome",
    "scale",
    "report_frames",
    "error_before",
    "error_after",
]


def split(names: list[str], block: int) -> tuple[list[str], list[str]]:
    """Return the frames to adapt on and those that report: quarter ``block`` of the time, 3 frames apart."""
    quarters = np.array_split(np.arange(len(names)), 4)
    report = quarters[block]
    others = [i for i in range(len(names)) if not report[0] - 3 <= i <= report[-1] + 3]
    return [names[i] for i in others[:FRAMES]], [names[i] for i in report]


def link(names: list[str], place: Path, folder: Path) -> None:
    """Make a folder of some frames of a place."""
    for part in ("images", "depths"):
        (folder / part).mkdir(parents=True, exist_ok=True)
        for file in (place / part).iterdir():
            if file.stem in names and not (folder / part / file.name).exists():
                (folder / part / file.name).symlink_to(file)


def score(weights: str | Path, place: Path, names: list[str], camera: tuple[float, ...]) -> np.ndarray:
    """Return AbsRel, delta1 and ``|log(median true / median predicted)|`` of each frame."""
    predictor = DepthPredictor(eldenet.load(weights), steady=False)
    predict = for_camera(predictor, pinhole(*camera))
    rows = []
    for name in names:
        (image,) = (place / "images").glob(f"{name}.*")
        depth = read_depth(place / "depths" / f"{name}.png", "mm")
        known = (depth > 0.1) & (depth < 10)
        truth, guess = depth[known], predict(read_image(image))[known]
        ratio = np.maximum(truth / guess, guess / truth)
        scale = abs(np.log(np.median(truth) / np.median(guess)))
        rows.append([np.mean(np.abs(guess - truth) / truth), np.mean(ratio < 1.25), scale])
    return np.array(rows)


def adapted(weights: str, place: str, block: int, seed: int, epochs: int) -> list[object]:
    """Adapt on depth frames; return a row of ``depth_frames.csv``."""
    source = WORK / "places" / place
    camera = write_place(place, source)
    names = sorted(path.stem for path in (source / "images").iterdir())
    mine, report = split(names, block)
    run = WORK / weights / f"{place}-{block}-{seed}-{epochs}"
    link(mine, source, run / "frames")
    settings = [f"data.root={run / 'frames'}", f"intrinsics={list(camera)}", f"weights={weights}"]
    settings += [f"trainer.epochs={epochs}", "minutes=120", f"seed={seed}", f"data.split_seed={seed}"]
    settings += ["data.gap=0"] if place in REAL else []  # their frames are far apart already
    settings += ["runtime.threads=1", "runtime.workers=0", "runtime.precision=fp32", "runtime.device=cpu"]
    before = score(weights, source, report, camera).mean(axis=0)
    try:
        better = adapt(compose(AdaptSettings, [*settings, f"output={run}"]))
        kept = read_record(run / RUN_FILE)["tuned"] if better else "no"
        after = score(run, source, report, camera).mean(axis=0)
    except ValueError as error:
        print(error)
        kept, after = "refused", before
    figures = [f"{value:.4f}" for value in (before[0], after[0], before[1], after[1])]
    return [weights, place, block, seed, epochs, len(mine), kept, len(report), *figures]


def measured_height(place: Path, names: list[str], camera: tuple[float, ...]) -> float:
    """Return the camera's height in place of a tape measure: that of the floors in measured depth [m]."""
    planes = [
        fit_ground(read_depth(place / "depths" / f"{name}.png", "mm"), PinholeCamera(pinhole(*camera)),
                   max_slope=FREE_SLOPE)
        for name in names
    ]  # fmt: skip
    return float(np.median([plane.offset for plane in planes if plane is not None]))


def calibrated(weights: str, place: str, block: int, *, pitch: bool) -> list[object]:
    """Adapt with the camera's height alone; return a row of ``camera_height.csv``."""
    source = WORK / "places" / place
    camera = write_place(place, source)
    names = sorted(path.stem for path in (source / "images").iterdir())
    mine, report = split(names, block)
    run = WORK / weights / f"{place}-{block}-height-{pitch}"
    link(mine, source, run / "frames")
    height = CAMERAS[place].height if place in CAMERAS else measured_height(source, mine, camera)
    settings = [f"source={run / 'frames' / 'images'}", f"intrinsics={list(camera)}", f"weights={weights}"]
    settings += [
        f"camera_height={height}",
        "frames=60",
        "runtime.threads=1",
        "runtime.workers=0",
        "runtime.device=cpu",
    ]
    if pitch:
        settings.append(f"camera_pitch={-np.degrees(CAMERAS[place].pitch)}")
    before = np.median(score(weights, source, report, camera)[:, 2])
    scale = ""
    try:
        kept = adapt(compose(AdaptSettings, [*settings, f"output={run}"]))
        outcome = "kept" if kept else "not kept"
        after = np.median(score(run, source, report, camera)[:, 2])
    except ValueError as error:
        print(error)
        outcome, after = "refused", before
    if outcome == "kept":
        new, old = eldenet.load(run).head.max_depth, eldenet.load(weights).head.max_depth
        scale = f"{new / old:.4f}"
    return [
        weights,
        place,
        block,
        "given" if pitch else "fitted",
        outcome,
        scale,
        len(report),
        f"{before:.4f}",
        f"{after:.4f}",
    ]


def rows_of(weights: str, path: Path, header: list[str]) -> list[dict[str, str]]:
    """Return the rows of these weights that are written already."""
    rows = read_table(path, header) if path.is_file() else []
    return [row for row in rows if row["weights"] == weights]


def append(path: Path, header: list[str], row: list[object]) -> None:
    """Write a row as soon as it is known."""
    new = not path.is_file()
    with path.open("a", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([header, row] if new else [row])
    print(*row, flush=True)


def main() -> None:
    """Run the trials of the weights that the command names, then write their page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", nargs="?", default="eldenet_indoor", help="packaged weights to start from")
    weights = parser.parse_args().weights
    torch.set_num_threads(1)
    all_heights(weights)
    all_depths(weights)
    write_page(weights)


def all_heights(weights: str) -> None:
    """Run what ``camera_height.csv`` lacks."""
    table = HERE / HEIGHT
    done = {(r["place"], r["block"], r["pitch"]) for r in rows_of(weights, table, HEIGHT_HEADER)}
    for pitch, places in ((True, CAMERAS), (False, {**CAMERAS, **REAL})):
        for block in (0, 2):
            for place in places:
                if (place, str(block), "given" if pitch else "fitted") not in done:
                    append(table, HEIGHT_HEADER, calibrated(weights, place, block, pitch=pitch))


def all_depths(weights: str) -> None:
    """Run what ``depth_frames.csv`` lacks."""
    table = HERE / DEPTH
    done = {(r["place"], r["block"], r["seed"], r["epochs"]) for r in rows_of(weights, table, DEPTH_HEADER)}
    trials = [(place, 3, 0, EPOCHS[place]) for place in CAMERAS]
    for seed in range(2):
        trials += [(place, block, seed, EPOCHS[place]) for place in REAL for block in range(4)]
    trials += [(place, 3, 0, EPOCHS[place] * TIMES) for place in LONG]
    for place, block, seed, epochs in trials:
        if (place, str(block), str(seed), str(epochs)) not in done:
            append(table, DEPTH_HEADER, adapted(weights, place, block, seed, epochs))


def write_page(weights: str) -> None:
    """Write ``<weights>.md`` and ``<weights>.png`` from the two tables."""
    depth, height = (
        rows_of(weights, HERE / name, header)
        for name, header in ((DEPTH, DEPTH_HEADER), (HEIGHT, HEIGHT_HEADER))
    )
    trials = [row for row in depth if row["epochs"] == str(EPOCHS[row["place"]])]
    longer = {row["place"]: row for row in depth if row not in trials}
    where = environment()
    lines = [
        f"{where['hardware']['processor']}, 1 thread, torch {where['versions']['torch']}; {weights}, "
        "6 epochs (tum_fr3_cabinet: 12). Each figure is of frames that adapt never saw.",
        "",
        "## Depth frames",
        "",
        "| place | trials | kept | worse | AbsRel before | after | δ1 before | after |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for place in dict.fromkeys(row["place"] for row in trials):
        mine = [row for row in trials if row["place"] == place]
        mean = {name: np.mean([float(row[name]) for row in mine]) for name in DEPTH_HEADER[8:]}
        kept = sum(row["kept"] not in ("no", "refused") for row in mine)
        cells = " | ".join(f"{mean[name]:.3f}" for name in DEPTH_HEADER[8:])
        lines.append(f"| {place} | {len(mine)} | {kept} | {sum(map(worse, mine))} | {cells} |")
    count = sum(map(worse, trials))
    lines += [
        "",
        f"{count} of {len(trials)} trials end with a higher AbsRel than they began.",
        "",
    ]
    if longer:
        lines += [
            f"## Against {TIMES} times the training on the same frames",
            "",
            f"| place | AbsRel before | after | after {TIMES} times | share of the gap closed |",
            "|---|---:|---:|---:|---:|",
        ]
    first = {(row["place"], row["block"]): row for row in trials if row["seed"] == "0"}
    for place, row in longer.items():
        short = first.get((place, row["block"]))
        if short is None:
            continue
        old, new, best = (float(r[n]) for r, n in ((short, "abs_rel_before"), (short, "abs_rel_after"),
                                                   (row, "abs_rel_after")))  # fmt: skip
        share = f"{100 * (old - new) / (old - best):.0f} %" if best < old else "no gap"
        lines.append(f"| {place} | {old:.3f} | {new:.3f} | {best:.3f} | {share} |")
    lines += [
        *([""] if longer else []),
        "## The camera's height alone",
        "",
        "Median over frames of the error of scale, |log(median true / median predicted)|.",
        "",
        "| place | block | pitch | outcome | depth times | before | after |",
        "|---|---:|---|---|---:|---:|---:|",
    ]
    for row in height:
        cells = [row[name] for name in ("place", "block", "pitch", "outcome", "scale")]
        cells += [f"{float(row[name]):.3f}" for name in ("error_before", "error_after")]
        lines.append(f"| {' | '.join(cells)} |")
    for pitch in ("given", "fitted"):
        tried = [row for row in height if row["pitch"] == pitch]
        old, new = (np.array([float(row[n]) for row in tried]) for n in ("error_before", "error_after"))
        kept = np.array([row["outcome"] == "kept" for row in tried])
        if len(tried):
            change = f"{np.median(old):.3f} to {np.median(new):.3f}"
            lines += [
                "",
                f"Pitch {pitch}: the median of all {len(tried)} goes from {change}; {kept.sum()} kept, ",
            ]
            lines[-1] += f"{int((new > old).sum())} worse."
        if kept.any():
            lines[-1] += f" Of those kept: {np.median(old[kept]):.3f} to {np.median(new[kept]):.3f}."
    lines += ["", f"Made by `python experiments/adapt/run.py {weights}`."]
    (HERE / f"{weights}.md").write_text("\n".join(lines) + "\n")
    plot(trials, height, HERE / f"{weights}.png")


def worse(row: dict[str, str]) -> bool:
    """Return whether a trial ended with a higher AbsRel."""
    return float(row["abs_rel_after"]) > float(row["abs_rel_before"])


def plot(trials: list[dict[str, str]], height: list[dict[str, str]], path: Path) -> None:
    """Draw before against after: one point per trial, better below the line."""
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    panels = (
        (axes[0], trials, "abs_rel_before", "abs_rel_after", "AbsRel, about 90 depth frames"),
        (axes[1], height, "error_before", "error_after", "median error of scale, camera's height alone"),
    )
    for ax, rows, before, after, title in panels:
        for number, place in enumerate((*CAMERAS, *REAL)):
            points = [(float(r[before]), float(r[after])) for r in rows if r["place"] == place]
            ax.scatter(*zip(*points, strict=True), label=place, s=22, color=f"C{number}")
        top = 1.05 * max(float(row[before]) for row in rows)
        ax.plot([0, top], [0, top], color="0.6", lw=1)
        ax.set(title=title, xlabel="before", ylabel="after", xlim=(0, top), ylim=(0, top))
    axes[0].legend(fontsize=8)
    save_figure(figure, path)


if __name__ == "__main__":
    main()

"""Convergence of a study's runs: curves, speed, fluctuation, and their table.

python experiments/convergence.py experiments/fig7_convergence    # convergence.md, .csv and .png of its runs
"""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import numpy as np

from eldenet.results.plots import pyplot_for_files, save_figure
from eldenet.results.tables import to_markdown
from eldenet.studies.matching import stored_runs
from eldenet.studies.plan import Study, read_study
from eldenet.system.files import write_rows, write_text

Curve = tuple[list[int], list[float]]  # epochs and values
SHARE = 0.9  # of a curve's own descent
MARGIN = 1.15  # of a second level above the one that every run reaches
WINDOW = 5  # epochs of the running mean
CURVES = {"train_loss": "training loss", "val_loss": "validation loss", "val_mse": "MSE"}
LOSSES = ("train_loss", "val_loss")  # compare only if all runs train with the same loss
TITLES = {
    "epochs": "epochs",
    "own": f"{SHARE:.0%} of its own descent [epoch]",
    "early": f"at {MARGIN:g} x level [epoch]",
    "late": "at level [epoch]",
    "fluctuation": "fluctuation",
}
NOTES = (
    f"level: the last value of the worst run of the block, so every run reaches it; at level, at {MARGIN:g} "
    "x level: the first epoch at which a run is there or below",
    f"{SHARE:.0%} of its own descent: the first epoch at which a run has made that much of its way from its "
    "first to its best value; a bad start makes it early, so it does not compare rows",
    f"fluctuation: mean absolute distance from the running mean over {WINDOW} epochs in the second half of "
    "the training, relative to its mean there",
    "training loss: on the labels, without a teacher's term; validation loss: a * (1 - SSIM) / 2 + b * MAE "
    "under the protocol, with the training's weights; a run that is validated once has no curve of it",
    "mean ± sample standard deviation over the seeds; convergence.csv has every run",
)


def validation_loss(run: Mapping[str, Any], row: Mapping[str, float]) -> float | None:
    """The training's loss on the validation frames under the protocol, from the metrics of one epoch.

    ``a * (1 - SSIM) / 2 + b * MAE`` with the run's own weights, without a teacher's terms; None for a loss
    with other terms or maps in other units than meters.
    """
    ssim, mae = (np.nan if row.get(name) is None else row[name] for name in ("val_ssim", "val_mae"))
    values, loss = {"SSIMLoss": (1 - ssim) / 2, "L1Loss": mae}, 0.0
    for term in _label_terms(run).values():
        kind = term["loss"]["_target_"].rpartition(".")[2]
        if kind not in values or term.get("space", "meters") != "meters":
            return None
        loss += term["weight"] * values[kind]
    return float(loss) if np.isfinite(loss) else None


def _label_terms(run: Mapping[str, Any]) -> dict[str, Any]:
    """Return the terms of the loss that compare with labels: all but a teacher's."""
    terms = run["config"]["loss"]["terms"]
    return {name: term for name, term in terms.items() if "teacher" not in term}


def curves(run: Mapping[str, Any]) -> dict[str, Curve]:
    """Training and validation curves of one run by name: those of the training have every epoch.

    A curve with gaps is left out: sparse ground truth has no SSIM. The training loss is that on the labels,
    without a teacher's term. The SSIM of the training comes from the loss term ``ssim``, (1 - SSIM) / 2, of
    augmented frames at the network's input size.
    """
    history = (run.get("training") or {}).get("history", ())
    validated = [row for row in history if "val_mse" in row]
    losses = [validation_loss(run, row) for row in validated]
    found: dict[str, tuple[list[Any], list[Any]]] = {
        "train_loss": (history, [_loss_on_labels(run, row) for row in history]),
        "train_ssim": (
            history,
            [1 - 2 * row["train_ssim"] if "train_ssim" in row else None for row in history],
        ),
        "train_mse": (history, [row.get("train_mse") for row in history]),
        "val_ssim": (validated, [row.get("val_ssim") for row in validated]),
        "val_mse": (validated, [row["val_mse"] for row in validated]),
        "val_loss": (validated, losses),
    }
    return {
        name: ([row["epoch"] for row in rows], values)
        for name, (rows, values) in found.items()
        if values and None not in values
    }


def _loss_on_labels(run: Mapping[str, Any], row: Mapping[str, float]) -> float | None:
    """The training loss of one epoch without a teacher's terms; None: it was not logged."""
    total = row.get("train_total")
    if total is None:
        return None
    taught = {
        name: term["weight"] for name, term in run["config"]["loss"]["terms"].items() if "teacher" in term
    }
    return total - sum(weight * row[f"train_{name}"] for name, weight in taught.items())


def first_epoch(epochs: Sequence[float], values: Sequence[float], level: float) -> float | None:
    """The first epoch at which a curve is at or below ``level``; None: it never is."""
    return next((epoch for epoch, value in zip(epochs, values, strict=True) if value <= level), None)


def own_descent(epochs: Sequence[float], values: Sequence[float]) -> float | None:
    """First epoch at which a falling curve has made 90 % of its way from its first to its best value."""
    return first_epoch(epochs, values, values[0] - SHARE * (values[0] - min(values)))


def fluctuation(values: Sequence[float]) -> float | None:
    """Mean absolute distance from the running mean in the second half of a curve, relative to the mean there.

    0 for a steady descent; None if no epoch of the second half has a whole window around it.
    """
    whole = np.asarray(values, dtype=float)
    first = max(len(whole) // 2, WINDOW // 2)
    last = len(whole) - WINDOW // 2
    if first >= last:
        return None
    smooth = np.convolve(whole, np.full(WINDOW, 1 / WINDOW), mode="valid")  # starts at WINDOW // 2
    half = whole[first:last]
    return float(np.abs(half - smooth[first - WINDOW // 2 :]).mean() / np.abs(half).mean())


@dataclass(frozen=True)
class Line:
    """Figures of one curve of one run; None: it has none."""

    row: str
    seed: int
    curve: str
    level: float | None
    figures: Mapping[str, float | None]


@dataclass(frozen=True)
class Convergence:
    """Curves of a study (``row/seed0`` -> name -> epochs and values) and their figures."""

    curves: Mapping[str, Mapping[str, Curve]]
    lines: Sequence[Line]

    def by_run(self) -> tuple[list[str], list[list[str]]]:
        """Titles and cells, a line for every curve of every run."""
        cells = [[f"{line.row}/seed{line.seed}", CURVES[line.curve], *_cells([line])] for line in self.lines]
        return ["run", "curve", "level", *TITLES.values()], cells

    def by_row(self) -> tuple[list[str], list[list[str]]]:
        """Titles and cells, seeds together: mean and sample standard deviation."""
        groups: dict[tuple[str, str], list[Line]] = {}
        for line in self.lines:
            groups.setdefault((line.row, line.curve), []).append(line)
        cells = [
            [row, CURVES[curve], str(len(lines)), *_cells(lines)] for (row, curve), lines in groups.items()
        ]
        return ["row", "curve", "seeds", "level", *TITLES.values()], cells


def _cells(lines: Sequence[Line]) -> list[str]:
    """Level and figures of the runs of a row."""
    figures = (_text([line.figures[name] for line in lines], name) for name in TITLES)
    return [_text([lines[0].level], "level"), *figures]


def _text(values: Sequence[float | None], name: str) -> str:
    """Mean ± sample standard deviation; "-" if one run has no value: the others would mislead."""
    known = [value for value in values if value is not None]
    if len(known) < len(values):
        return "-"
    digits = {"level": 3, "fluctuation": 4}.get(name, 1)
    if len(set(known)) == 1 and digits == 1:
        return f"{known[0]:g}"  # an epoch
    mean = f"{fmean(known):.{digits}f}"
    return mean if len(known) == 1 else f"{mean} ± {stdev(known):.{digits}f}"


def convergence(study: Study) -> Convergence:
    """Speed and fluctuation of every stored run of a study; runs are compared at the level of their block."""
    blocks: dict[str, list[tuple[str, dict[str, Any]]]] = {}
    for row in study.rows:
        blocks.setdefault(row.block, []).extend((row.name, run) for run in stored_runs(study, row).runs)
    found: dict[str, dict[str, Curve]] = {}
    lines: list[Line] = []
    for runs in blocks.values():
        of_block = {f"{name}/seed{run['seed']}": curves(run) for name, run in runs}
        levels = _levels([run for _, run in runs], list(of_block.values()))
        for (name, run), values in zip(runs, of_block.values(), strict=True):
            lines += [
                Line(name, run["seed"], curve, levels[curve], _figures(values[curve], levels[curve]))
                for curve in CURVES
                if curve in values and len(values[curve][0]) > 1
            ]
        found |= of_block
    return Convergence(found, lines)


def _levels(
    runs: Sequence[Mapping[str, Any]], found: Sequence[Mapping[str, Curve]]
) -> dict[str, float | None]:
    """The worst last value of each curve; None for the losses of runs that train with different ones."""
    one_loss = len({json.dumps(_label_terms(run), sort_keys=True) for run in runs}) == 1
    return {
        key: max((curve[key][1][-1] for curve in found if key in curve), default=None)
        if one_loss or key not in LOSSES
        else None
        for key in CURVES
    }


def _figures(curve: Curve, level: float | None) -> dict[str, float | None]:
    epochs, values = curve
    return {
        "epochs": float(epochs[-1]),
        "own": own_descent(epochs, values),
        "early": None if level is None else first_epoch(epochs, values, MARGIN * level),
        "late": None if level is None else first_epoch(epochs, values, level),
        "fluctuation": fluctuation(values),
    }


def _by_row(runs: Mapping[str, Mapping[str, Any]], key: str) -> dict[str, list[tuple[Any, Any]]]:
    """Row -> epochs and values of each of its runs with the curve ``key``."""
    rows: dict[str, list[tuple[Any, Any]]] = {}
    for name, curve in runs.items():
        if key in curve:
            rows.setdefault(name.rpartition("/")[0] or name, []).append(curve[key])
    return rows


def curves_plot(path: Path, runs: Mapping[str, Mapping[str, Any]]) -> None:
    """Plot loss, SSIM and MSE over the epochs; ``runs`` is "row/seed" -> name -> epochs and values.

    Each row has a color: a thin line for every run, a thick one for their mean; a dot for each run that was
    validated once. The axes are scaled to all epochs but the first.
    """
    pyplot = pyplot_for_files()
    parts, curves_of_each = {"train": "training", "val": "validation"}, ("loss", "ssim", "mse")
    titles = {"loss": "loss", "ssim": "SSIM", "mse": "MSE [m²]"}
    panels = {f"{part}_{name}": f"{parts[part]} {titles[name]}" for part in parts for name in curves_of_each}
    figure, axes = pyplot.subplots(2, 3, figsize=(12, 6), sharex=True)
    names = dict.fromkeys(name.rpartition("/")[0] or name for name in runs)
    colors = {row: f"C{number}" for number, row in enumerate(names)}
    for axis, (key, title) in zip(axes.flat, panels.items(), strict=True):
        rows = _by_row(runs, key)
        for row, curves in rows.items():
            for epochs, values in curves:
                dot = "." if len(values) == 1 else ""
                axis.plot(epochs, values, marker=dot, color=colors[row], linewidth=0.6, alpha=0.6)
            shortest = min(len(epochs) for epochs, _ in curves)
            mean = np.mean([values[:shortest] for _, values in curves], axis=0)
            label = f"{row} ({len(curves)} seed{'s' if len(curves) > 1 else ''})"
            axis.plot(curves[0][0][:shortest], mean, color=colors[row], linewidth=1.6, label=label)
        axis.set_title(title, fontsize=9)
        axis.grid(alpha=0.3)
        later = [value for curves in rows.values() for _, values in curves for value in values[1:] or values]
        if not rows:
            axis.text(0.5, 0.5, "not logged", ha="center", transform=axis.transAxes, fontsize=8)
        if later:  # a bad first epoch would squeeze the others, so it may lie outside the axes
            room = 0.05 * (max(later) - min(later)) or 0.1
            axis.set_ylim(min(later) - room, max(later) + room)
    axes[0, 0].legend(fontsize=7)
    for axis in axes[1]:
        axis.set_xlabel("epoch")
    figure.tight_layout()
    save_figure(figure, path)


def main(folder: Path) -> None:
    """Write the pages of a study."""
    study = read_study(folder)
    found = convergence(study)
    text = [f"# {study.name}: convergence", "", to_markdown(*found.by_row(), NOTES)]
    write_rows(folder / "convergence.csv", *found.by_run())
    if found.curves:
        curves_plot(folder / "convergence.png", found.curves)
        text += ["![curves](convergence.png)", ""]
    text += [f"Made by `python experiments/convergence.py {folder}`.", ""]
    write_text(folder / "convergence.md", "\n".join(text))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

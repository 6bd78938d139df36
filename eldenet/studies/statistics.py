"""What the runs of a study say together: paired differences with their intervals, speed and steadiness."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.bootstrap import bootstrap_interval

DRAWS, LEVEL = 10_000, 0.95


def per_image(files: Sequence[Path], metric: str) -> dict[str, float]:
    """``metric`` of every image, mean over the runs (seeds) whose ``per_image.csv`` these are.

    Raises:
        ValueError: the runs scored different images.
    """
    found: list[dict[str, float]] = []
    for file in files:
        with file.open(newline="") as lines:
            found.append({row["name"]: float(row[metric]) for row in csv.DictReader(lines)})
        if found[-1].keys() != found[0].keys():
            raise ValueError(f"{file} and {files[0]} scored different images: they can't be paired")
    return {name: float(np.mean([values[name] for values in found])) for name in found[0]}


def paired_interval(
    ours: Mapping[str, float], theirs: Mapping[str, float], *, seed: int = 0
) -> tuple[float, float, float]:
    """Mean difference ``ours - theirs`` and its 95 % interval: paired percentile bootstrap over the images.

    It speaks of the choice of images, not of the chance in a training: that is what several seeds are for.

    Raises:
        ValueError: the two scored different images.
    """
    if ours.keys() != theirs.keys():
        raise ValueError("the two rows scored different images: they can't be paired")
    difference = np.array([ours[name] - theirs[name] for name in ours])
    difference = difference[np.isfinite(difference)]
    low, high = bootstrap_interval(
        lambda chosen: float(difference[chosen].mean()), len(difference), draws=DRAWS, share=LEVEL, seed=seed
    )
    return float(difference.mean()), low, high


def validation_loss(run: Mapping[str, Any], row: Mapping[str, float]) -> float | None:
    """The training's loss on the validation frames under the protocol, from the metrics of one epoch.

    ``a * (1 - SSIM) / 2 + b * MAE`` with the run's own weights; None for a loss with other terms.
    """
    terms = run["config"]["loss"]["terms"]
    values = {"ssim": (1 - row.get("val_ssim", np.nan)) / 2, "l1": row.get("val_mae", np.nan)}
    if not set(terms) <= set(values):
        return None
    loss = sum(term["weight"] * values[name] for name, term in terms.items())
    return float(loss) if np.isfinite(loss) else None


def curves(run: Mapping[str, Any]) -> dict[str, list[float]]:
    """Training and validation curves of one run by their names, one value per validated epoch."""
    history = [row for row in run["training"]["history"] if "val_mse" in row]
    found: dict[str, list[float]] = {
        "epoch": [row["epoch"] for row in history],
        "train_loss": [row["train_total"] for row in history],
        "val_ssim": [row["val_ssim"] for row in history],
        "val_mse": [row["val_mse"] for row in history],
    }
    losses = [validation_loss(run, row) for row in history]
    if None not in losses:
        found["val_loss"] = [loss for loss in losses if loss is not None]
    return found


def convergence_epoch(epochs: Sequence[float], values: Sequence[float], share: float = 0.9) -> float:
    """First epoch at which a falling curve has done ``share`` of its way from its first to its best value."""
    first, best = values[0], min(values)
    goal = first - share * (first - best)
    return float(next(epoch for epoch, value in zip(epochs, values, strict=True) if value <= goal))


def fluctuation(values: Sequence[float]) -> float:
    """Mean absolute step between epochs in the second half of a curve, relative to its mean there."""
    half = np.asarray(values[len(values) // 2 :], dtype=float)
    return float(np.abs(np.diff(half)).mean() / np.abs(half).mean()) if len(half) > 1 else float("nan")

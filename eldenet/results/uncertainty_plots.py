"""Files about a network's sigma in a run folder: a table per image, and two plots."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldenet.evaluation.metric_names import UNCERTAINTY_METRICS
from eldenet.evaluation.uncertainty_metrics import RELIABILITY_LEVELS, UncertaintyScores
from eldenet.results.plots import pyplot_for_files, save_figure
from eldenet.system.extras import require
from eldenet.system.files import write_rows

if TYPE_CHECKING:
    from eldenet.results.run_log import RunLog

TITLES = {"abs_rel": "AbsRel", "rmse": "RMSE"}


def write_uncertainty(folder: Path, scores: UncertaintyScores, log: "RunLog") -> None:
    """Write ``uncertainty.csv``, ``sparsification.png`` and ``reliability.png``.

    Without matplotlib the plots are left out, and the log says so: the scores took long.
    """
    write_rows(folder / "uncertainty.csv", ("name", *UNCERTAINTY_METRICS), scores.rows)
    try:
        require("a plot of sigma", "matplotlib")
    except ImportError as error:
        log.say(f"left out: {error}")
        return
    sparsification_plot(folder / "sparsification.png", {"sigma": scores.curves})
    reliability_plot(folder / "reliability.png", {"sigma": scores.coverage})


def sparsification_plot(path: Path, rows: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    """Plot the error that is left against the share of removed pixels: each row's, and its oracle's dashed.

    ``rows`` are name -> error -> curves ``(2, steps + 1)``, own and oracle's.
    """
    pyplot = pyplot_for_files()
    figure, every_axes = pyplot.subplots(1, len(TITLES), figsize=(9, 4), sharey=True)
    for axes, (error, title) in zip(every_axes, TITLES.items(), strict=True):
        for name, curves in rows.items():
            own, oracle = curves[error]
            share = np.linspace(0, 1, len(own))
            line = axes.plot(share, own, "-", label=name)[0]
            axes.plot(share, oracle, "--", color=line.get_color(), linewidth=1, label=f"{name}: oracle")
        axes.plot((0, 1), (1, 1), ":", color="gray", linewidth=1)
        axes.set(
            xlabel="share of pixels removed, least certain first", title=title, xlim=(0, 1), ylim=(0, 1.1)
        )
    every_axes[0].set_ylabel("error that is left, of the image's")
    every_axes[0].legend(fontsize=8)
    figure.tight_layout()
    save_figure(figure, path)


def reliability_plot(path: Path, rows: Mapping[str, np.ndarray]) -> None:
    """Plot the share of pixels inside an interval against the share that it promises.

    ``rows`` are name -> shares at ``RELIABILITY_LEVELS``.
    """
    pyplot = pyplot_for_files()
    figure, axes = pyplot.subplots(figsize=(4.5, 4.5))
    axes.plot((0, 1), (0, 1), ":", color="gray", linewidth=1)
    for name, coverage in rows.items():
        axes.plot((0, *RELIABILITY_LEVELS), (0, *coverage), "o-", markersize=3, label=name)
    axes.set(xlabel="interval", ylabel="pixels inside it", xlim=(0, 1), ylim=(0, 1))
    axes.legend(fontsize=8)
    figure.tight_layout()
    save_figure(figure, path)

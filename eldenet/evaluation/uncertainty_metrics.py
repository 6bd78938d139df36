"""How good a predicted sigma is: sparsification, coverage of intervals, likelihood; image by image.

Pixels and alignment are those of the depth's protocol. Each image's pixels are removed in equal steps, the
least certain first. A sparsification curve is the error of those that are left, divided by the whole image's
error; it ends at 0. AUSE is the area between the curve and the oracle's, which removes the pixels of the
largest error of the same kind first (Ilg et al., "Uncertainty Estimates and Multi-Hypotheses Networks for
Optical Flow", ECCV 2018). Every measure is the mean over images.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from eldenet.evaluation.metric_names import UNCERTAINTY_METRICS
from eldenet.uncertainty import LEVELS, deviations

STEPS = 20  # of a curve
REMOVED = 0.2  # share of an image's pixels left out in abs_rel_sure80
#: The rules of these measures, as ``run.json`` stores them.
PROTOCOL = {
    "name": "per_image_20_steps",
    "steps": STEPS,
    "removed": REMOVED,
    "unit": "the error's",  # sigma / depth ranks pixels for AbsRel, sigma [m] for RMSE
    "levels": LEVELS,  # of the intervals
    "average": "image",
}
CURVES = ("abs_rel", "rmse")
RELIABILITY_LEVELS = tuple(level / 20 for level in range(1, 20))


@dataclass(frozen=True)
class UncertaintyScores:
    """Measures of a data set."""

    metrics: dict[str, float]  # by name
    rows: list[tuple[Any, ...]]  # (name, *measures) per image, in the data set's order
    # error -> mean sparsification curves (2, steps + 1): by sigma, and the oracle's
    curves: dict[str, np.ndarray]
    coverage: np.ndarray  # share of pixels inside the intervals of RELIABILITY_LEVELS, mean over images


@dataclass(frozen=True)
class ImageUncertainty:
    """Measures of one image."""

    values: tuple[float, ...]  # in the order of UNCERTAINTY_METRICS
    curves: dict[str, np.ndarray]  # as in UncertaintyScores
    coverage: np.ndarray  # share of pixels inside the intervals of RELIABILITY_LEVELS


def score_image(
    depth: np.ndarray, truth: np.ndarray, spread: np.ndarray, distribution: str
) -> ImageUncertainty:
    """Measure one image by the pixels that count, ``(N,)`` each.

    ``depth`` is predicted and ``truth`` known [m], or both are inverse depth, as the metrics compare them;
    ``spread`` is the predicted standard deviation of ln depth, of a "laplace" or "gaussian" ``distribution``.
    """
    depth, truth, spread = (values.astype(np.float64) for values in (depth, truth, spread))
    error, log_error = np.abs(depth - truth), np.abs(np.log(truth / depth))
    curves = {
        "abs_rel": sparsification(error / truth, spread),
        "rmse": np.sqrt(sparsification(error**2, spread * depth)),
    }
    area = {name: float((own - oracle).sum()) / STEPS for name, (own, oracle) in curves.items()}
    inside = [
        log_error <= deviations(distribution, level) * spread for level in (*LEVELS, *RELIABILITY_LEVELS)
    ]
    shares = [float(each.mean()) for each in inside]
    kept = curves["abs_rel"][0][round(REMOVED * STEPS)] * float((error / truth).mean())
    values = (
        area["abs_rel"],
        area["rmse"],
        kept,
        *shares[: len(LEVELS)],
        float(mean_nll(log_error, spread, distribution)),
    )
    return ImageUncertainty(values, curves, np.array(shares[len(LEVELS) :]))


def sparsification(error: np.ndarray, uncertainty: np.ndarray) -> np.ndarray:
    """Curves ``(2, steps + 1)`` of the mean ``error (N,)`` that is left over that of all pixels.

    The first removes pixels by their ``uncertainty``, the second, the oracle's, by their error.
    """
    count = len(error)
    left = [round(count * (1 - step / STEPS)) for step in range(STEPS)]
    whole = max(float(error.mean()), 1e-12)
    curves = np.zeros((2, STEPS + 1))
    for row, order in enumerate((uncertainty, error)):
        total = np.cumsum(error[np.argsort(order)])
        curves[row, :-1] = [total[max(n, 1) - 1] / max(n, 1) / whole for n in left]
    return curves


def mean_nll(log_error: np.ndarray, spread: np.ndarray, distribution: str) -> np.floating[Any]:
    """Mean negative log-likelihood of ln depth ``(N,)``, as in :mod:`eldenet.losses.likelihood`."""
    if distribution == "laplace":
        scale = spread / math.sqrt(2)
        return (log_error / scale + np.log(2 * scale)).mean()
    return (0.5 * (log_error / spread) ** 2 + np.log(spread)).mean() + 0.5 * math.log(2 * math.pi)


class UncertaintyMeter:
    """Collects :func:`score_image` of every image, for a sigma of this ``distribution``."""

    def __init__(self, distribution: str) -> None:
        self.distribution = distribution
        self.images: list[tuple[str, ImageUncertainty | None]] = []

    def update(
        self, names: Sequence[str], depth: Tensor, truth: Tensor, spread: Tensor, valid: Tensor
    ) -> None:
        """Add a batch of aligned maps ``(B, 1, H, W)``; an image without a valid pixel gets no measures."""
        maps = [values.cpu().numpy() for values in (depth, truth, spread, valid)]
        for name, own, true, doubt, known in zip(names, *maps, strict=True):
            scored = (
                score_image(own[known], true[known], doubt[known], self.distribution) if known.any() else None
            )
            self.images.append((name, scored))

    def compute(self) -> UncertaintyScores:
        """Means over the images."""
        scored = [image for _, image in self.images if image is not None]
        nothing = (math.nan,) * len(UNCERTAINTY_METRICS)
        means = np.mean([image.values for image in scored], axis=0)
        return UncertaintyScores(
            metrics=dict(zip(UNCERTAINTY_METRICS, means.tolist(), strict=True)),
            rows=[(name, *(nothing if image is None else image.values)) for name, image in self.images],
            curves={name: np.mean([image.curves[name] for image in scored], axis=0) for name in CURVES},
            coverage=np.mean([image.coverage for image in scored], axis=0),
        )

"""A depth map with its uncertainty: depth, standard deviation and intervals, as arrays or tensors."""

import math
from statistics import NormalDist
from typing import Any, NamedTuple

DISTRIBUTIONS = ("laplace", "gaussian")
UNSURE = 0.3  # sigma / depth beyond which pictures show no depth
LEVELS = (0.5, 0.8, 0.9, 0.95)  # of the intervals whose coverage is measured
NO_SIGMA = "this network predicts no sigma: train one with model/head=uncertain loss=ssim_nll"


class DepthEstimate(NamedTuple):
    """Depth and how far it may be off, as arrays or tensors of the same shape.

    Attributes:
        depth: [m].
        sigma: standard deviation [m]; None: the network predicts none.
        distribution: of the error in ln depth, "laplace" or "gaussian".
    """

    depth: Any
    sigma: Any = None
    distribution: str | None = None

    def interval(self, level: float = 0.9) -> tuple[Any, Any]:
        """Low and high [m]: the true depth should lie between them in ``level`` of all pixels.

        The interval is symmetric in ln depth: ``depth / f`` to ``depth * f``.

        Raises:
            ValueError: the network predicts no sigma, or not ``0 < level < 1``.
        """
        if self.sigma is None or self.distribution is None:
            raise ValueError(NO_SIGMA)
        factor = math.e ** (deviations(self.distribution, level) * self.sigma / self.depth)
        return self.depth / factor, self.depth * factor

    @property
    def spread(self) -> Any:
        """Standard deviation of ln depth, which is sigma / depth; None: the network predicts no sigma."""
        return None if self.sigma is None else self.sigma / self.depth

    @property
    def unsure(self) -> Any:
        """Bool, where sigma is more than ``UNSURE`` of the depth; None: the network predicts no sigma."""
        return None if self.sigma is None else self.sigma > UNSURE * self.depth


def as_estimate(depth: Any) -> DepthEstimate:
    """Return an estimate as it is, and a depth map as an estimate without sigma."""
    return depth if isinstance(depth, DepthEstimate) else DepthEstimate(depth)


def deviations(distribution: str, level: float) -> float:
    """Return how many standard deviations around the center contain ``level`` of a distribution.

    Raises:
        ValueError: not ``0 < level < 1``.
    """
    if not 0 < level < 1:
        raise ValueError(f"level={level}: give a share between 0 and 1, such as 0.9")
    if distribution == "laplace":
        return -math.log(1 - level) / math.sqrt(2)
    return NormalDist().inv_cdf((1 + level) / 2)

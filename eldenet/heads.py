"""Heads turn a network's raw map into meters within their range."""

import math
from typing import Any, Self

import torch
from torch import Tensor, nn

from eldenet.configurable import Configurable
from eldenet.system.checks import one_of
from eldenet.uncertainty import DISTRIBUTIONS, NO_SIGMA


class Head(Configurable, nn.Module):
    """Raw map ``(B, 1, H, W)`` -> depth ``(B, 1, H, W)`` [m] within ``[min_depth, max_depth]``.

    A new head implements :meth:`to_meters`.

    Attributes:
        channels: of the raw map.
        distribution: of the error in ln depth, "laplace" or "gaussian"; None: the head predicts no sigma.
        lengths: arguments that :meth:`rescaled` multiplies.

    Args:
        min_depth: [m].
        max_depth: [m].

    Raises:
        ValueError: not ``0 < min_depth < max_depth``.
    """

    channels = 1
    distribution: str | None = None
    lengths: tuple[str, ...] = ("min_depth", "max_depth")

    def __init__(self, min_depth: float = 0.1, max_depth: float = 10.0) -> None:
        super().__init__()
        if not 0 < min_depth < max_depth:
            raise ValueError(f"min_depth={min_depth}, max_depth={max_depth}: give 0 < min_depth < max_depth")
        self.min_depth, self.max_depth = float(min_depth), float(max_depth)

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real numbers ``(B, 1, H, W)`` to meters."""
        raise NotImplementedError

    def to_spread(self, raw: Tensor) -> Tensor:
        """Standard deviation of ln depth ``(B, 1, H, W)``.

        Raises:
            ValueError: the head predicts none.
        """
        raise ValueError(NO_SIGMA)

    def rescaled(self, factor: float) -> Self:
        """Return a head of the same kind whose depth and range are ``factor`` times this one's."""
        settings: dict[str, Any] = {name: value for name, value in self.config.items() if name != "_target_"}
        settings |= {name: settings[name] * factor for name in self.lengths}
        return type(self)(**settings)

    def forward(self, raw: Tensor) -> Tensor:
        """Same as :meth:`to_meters`: ``(B, channels, H, W)`` -> ``(B, 1, H, W)`` [m]."""
        return self.to_meters(raw)


class LinearHead(Head):
    """``min + (max - min) * sigmoid(raw)``: an error in meters counts the same at every distance."""

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real numbers ``(B, 1, H, W)`` to meters."""
        return self.min_depth + (self.max_depth - self.min_depth) * raw.sigmoid()


class InverseHead(Head):
    """The sigmoid is inverse depth, as in Monodepth (Godard et al. 2017, eq. 6): near depth is finer."""

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real numbers ``(B, 1, H, W)`` to meters."""
        far, near = 1 / self.max_depth, 1 / self.min_depth
        return 1 / (far + (near - far) * raw.sigmoid())


class LogHead(Head):
    """The sigmoid is the logarithm of depth: errors count by their ratio, as in AbsRel and delta."""

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real numbers ``(B, 1, H, W)`` to meters."""
        log_ratio = math.log(self.max_depth / self.min_depth)
        return self.min_depth * torch.exp(log_ratio * raw.sigmoid())  # a power takes longer in ONNX Runtime


class ScaledHead(Head):
    """The raw map times a scale, clamped to the range: for networks trained elsewhere.

    Raw values beyond the range get no gradient, so a network that starts far away may not learn. The other
    heads do not have this problem.

    Args:
        scale: [m] per unit of the raw map; 0.01 for centimeters.
        min_depth: [m].
        max_depth: [m].
    """

    lengths = ("scale", "min_depth", "max_depth")

    def __init__(self, scale: float = 1.0, min_depth: float = 0.1, max_depth: float = 10.0) -> None:
        super().__init__(min_depth, max_depth)
        self.scale = float(scale)

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real numbers ``(B, 1, H, W)`` to meters."""
        return (raw * self.scale).clamp(self.min_depth, self.max_depth)


class UncertainHead(Head):
    """Depth by another head, and how far it may be off: a second raw channel gives the scale of the error.

    The error of ln depth follows a Laplace or a normal distribution whose scale each pixel has for itself
    (Kendall & Gal, "What Uncertainties Do We Need in Bayesian Deep Learning for Computer Vision?", NeurIPS
    2017, section 3.1, here of ln depth). :class:`~eldenet.losses.likelihood.LikelihoodTerm` trains it. The
    standard deviation of ln depth is ``min_spread * (max_spread / min_spread) ** sigmoid(raw)``, so that no
    pixel can dominate the loss.

    Args:
        depth: turns the first channel into meters.
        distribution: "laplace" or "gaussian".
        min_spread: least standard deviation of ln depth: 0.01 is 1 % of the depth.
        max_spread: the largest one.

    Attributes:
        temperature: factor of every standard deviation, fitted after the training on frames that it did not
            see (Guo et al. 2017), see :func:`eldenet.evaluation.calibration.fit_temperature`.

    Raises:
        ValueError: an unknown distribution, or not ``0 < min_spread < max_spread``.
    """

    channels = 2
    temperature: Tensor

    def __init__(
        self, depth: Head, *, distribution: str = "laplace", min_spread: float = 0.01, max_spread: float = 1.0
    ) -> None:
        super().__init__(depth.min_depth, depth.max_depth)
        one_of("distribution", distribution, DISTRIBUTIONS)
        if not 0 < min_spread < max_spread:
            raise ValueError(
                f"min_spread={min_spread}, max_spread={max_spread}: give 0 < min_spread < max_spread"
            )
        self.depth, self.distribution = depth, distribution
        self.min_spread, self.max_spread = float(min_spread), float(max_spread)
        self.register_buffer("temperature", torch.ones(()))

    def to_meters(self, raw: Tensor) -> Tensor:
        """First channel of ``(B, 2, H, W)`` -> meters ``(B, 1, H, W)``."""
        return self.depth.to_meters(raw[:, :1])

    def to_spread(self, raw: Tensor) -> Tensor:
        """Second channel of ``(B, 2, H, W)`` -> standard deviation of ln depth ``(B, 1, H, W)``."""
        # a power of a number would be slow in OpenVINO
        steps = raw[:, 1:].sigmoid() * math.log(self.max_spread / self.min_spread)
        return self.temperature * self.min_spread * steps.exp()

    def rescaled(self, factor: float) -> Self:
        """Return a head whose depth and range are ``factor`` times this one's; the spread is relative."""
        limits = {"min_spread": self.min_spread, "max_spread": self.max_spread}
        head = type(self)(self.depth.rescaled(factor), distribution=str(self.distribution), **limits)
        head.temperature.copy_(self.temperature)
        return head


def add_channels(network: nn.Module, count: int) -> None:
    """Give the raw map of a network, in place, ``count`` more channels.

    The network's last convolution of one channel, and a batch normalization after it, get them. The depth
    stays; the new channels start at 0.

    Raises:
        ValueError: the network has no convolution of one channel.
    """
    parts = list(network.modules())
    places = [i for i, part in enumerate(parts) if isinstance(part, nn.Conv2d) and part.out_channels == 1]
    if not places:
        raise ValueError(
            f"this head needs {1 + count} raw channels, and no convolution of {type(network).__name__} has "
            "one channel to widen: end the network in nn.Conv2d(..., 1, ...)"
        )
    conv = parts[places[-1]]
    assert isinstance(conv, nn.Conv2d)
    norms = [p for p in parts[places[-1] :] if isinstance(p, nn.BatchNorm2d) and p.num_features == 1]
    new = torch.zeros(count, *conv.weight.shape[1:])
    if norms:  # they cannot normalize maps of zeros
        nn.init.kaiming_normal_(new)
    conv.out_channels += count
    conv.weight = nn.Parameter(torch.cat([conv.weight.detach(), new]))
    if conv.bias is not None:
        conv.bias = nn.Parameter(torch.cat([conv.bias.detach(), torch.zeros(count)]))
    for norm in norms:
        norm.num_features += count
        norm.weight = nn.Parameter(torch.cat([norm.weight.detach(), torch.ones(count)]))
        norm.bias = nn.Parameter(torch.cat([norm.bias.detach(), torch.zeros(count)]))
        norm.running_mean = torch.cat([norm.running_mean, torch.zeros(count)])  # type: ignore[list-item]
        norm.running_var = torch.cat([norm.running_var, torch.ones(count)])  # type: ignore[list-item]

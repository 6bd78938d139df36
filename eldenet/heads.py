"""Heads turn a network's raw map into meters within a range of their own."""

from typing import Any, Self

import torch
from torch import Tensor, nn

from eldenet.configurable import Configurable


class Head(Configurable, nn.Module):
    """Raw map ``(B, 1, H, W)`` -> depth ``(B, 1, H, W)`` [m] within ``[min_depth, max_depth]``.

    A new head implements :meth:`to_meters`.

    Args:
        min_depth: [m].
        max_depth: [m].

    Raises:
        ValueError: not ``0 < min_depth < max_depth``.
    """

    def __init__(self, min_depth: float = 0.1, max_depth: float = 10.0) -> None:
        super().__init__()
        if not 0 < min_depth < max_depth:
            raise ValueError(f"min_depth={min_depth}, max_depth={max_depth}: give 0 < min_depth < max_depth")
        self.min_depth, self.max_depth = float(min_depth), float(max_depth)

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real number to meters."""
        raise NotImplementedError

    def rescaled(self, factor: float) -> Self:
        """Return a head of the same kind whose depth is ``factor`` times this one's; so is its range."""
        settings: dict[str, Any] = {name: value for name, value in self.config.items() if name != "_target_"}
        settings |= {name: settings[name] * factor for name in ("min_depth", "max_depth")}
        return type(self)(**settings)

    def forward(self, raw: Tensor) -> Tensor:
        """Same as :meth:`to_meters`."""
        return self.to_meters(raw)


class LinearHead(Head):
    """``min + (max - min) * sigmoid(raw)``: an error in meters counts the same at every distance."""

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real number to meters."""
        return self.min_depth + (self.max_depth - self.min_depth) * raw.sigmoid()


class InverseHead(Head):
    """The sigmoid is inverse depth, as in Monodepth (Godard et al. 2017, eq. 6): near depth is finer."""

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real number to meters."""
        far, near = 1 / self.max_depth, 1 / self.min_depth
        return 1 / (far + (near - far) * raw.sigmoid())


class LogHead(Head):
    """The sigmoid is the logarithm of depth: errors count by their ratio, as in AbsRel and delta."""

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real number to meters."""
        ratio = self.max_depth / self.min_depth
        return self.min_depth * ratio ** raw.sigmoid()


class ScaledHead(Head):
    """The raw map times a scale, clamped to the range: for networks trained elsewhere.

    Raw values beyond the range get no gradient, so a network that starts far away may not learn. The other
    heads do not have this problem.

    Args:
        scale: [m] per unit of the raw map; 0.01 for centimeters.
        min_depth: [m].
        max_depth: [m].

    Raises:
        ValueError: a scale that is not above 0.
    """

    def __init__(self, scale: float = 1.0, min_depth: float = 0.1, max_depth: float = 10.0) -> None:
        super().__init__(min_depth, max_depth)
        if scale <= 0:
            raise ValueError(f"scale={scale}: give more than 0 meters per unit of the raw map")
        self.scale = float(scale)

    def to_meters(self, raw: Tensor) -> Tensor:
        """Map any real number to meters."""
        return (raw * self.scale).clamp(self.min_depth, self.max_depth)

    def rescaled(self, factor: float) -> Self:
        """Return a head whose depth, range and scale are ``factor`` times this one's."""
        return type(self)(self.scale * factor, self.min_depth * factor, self.max_depth * factor)


def in_meters(depth: Tensor, focal: float | Tensor | None, canonical_px: float | None) -> Tensor:
    """Return meters of canonical depth ``(B, 1, H, W)``: times ``focal / canonical_px``.

    Args:
        depth: canonical depth.
        focal: fx [px of the network's image], a number or ``(B,)``; 0, NaN and None: the canonical camera's.
        canonical_px: focal length of the canonical camera [px]; None: ``depth`` is in meters already.
    """
    if focal is None or canonical_px is None:
        return depth
    return depth * focal_ratio(torch.as_tensor(focal, device=depth.device), canonical_px)


def focal_ratio(focal: Tensor, canonical_px: float) -> Tensor:
    """Return meters per canonical meter ``(B, 1, 1, 1)`` for ``focal (B,)`` [px]; 1 where it is 0 or NaN."""
    ratio = focal.float().reshape(-1, 1, 1, 1) / canonical_px
    return ratio.where(ratio > 0, torch.ones_like(ratio))

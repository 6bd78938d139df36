"""Errors of a camera's ranges by distance, as ``sensor=noisy`` draws them; kept as a small JSON file.

An error is the logarithm of a column's range over the true one. Each distance bin has a bias and a spread;
the rest, divided by the spread, is the sum of three parts: one that the whole frame shares and that changes
slowly from frame to frame, one that about four neighboring columns share, and one of each column.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from eldenet.system.errors import reading
from eldenet.system.files import read_json, write_text
from eldenet.weights import check_packaged

EDGE_STEP = 0.2  # neighboring columns whose true log ranges differ by more belong to different segments


@dataclass(frozen=True)
class RangeErrors:
    """Errors of ranges by distance.

    Attributes:
        edges: of the bins of true range [m]; the lists below have one entry per bin.
        bias: median error.
        spread: standard deviation of the error without misses and ghosts.
        miss: rate at which a segment is missed in one scan.
        scale: standard deviation of the frame's part, in spreads.
        smooth: of the part that neighboring columns share, in spreads.
        column: of each column's own part, in spreads.
        memory: correlation of the frame's part with the previous scan.
        far: median and standard deviation of the error where nothing is in range.
        sectors: per bin of a sector's nearest true range: bias, spread, miss and ghost rate, count.
        measured: notes about the measurement.
    """

    edges: tuple[float, ...]
    bias: tuple[float, ...]
    spread: tuple[float, ...]
    miss: tuple[float, ...]
    scale: float
    smooth: float
    column: float
    memory: float
    far: tuple[float, float] = (0.0, 0.0)
    sectors: tuple[dict[str, float], ...] = ()
    measured: dict[str, Any] = field(default_factory=dict)

    @property
    def middles(self) -> np.ndarray:
        """Middle of each bin ``(bins,)`` [m]."""
        return (np.array(self.edges[1:]) + self.edges[:-1]) / 2

    def write(self, path: Path) -> None:
        """Write a JSON file."""
        write_text(path, json.dumps(asdict(self), indent=1) + "\n")

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a file that :meth:`write` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file contains something else.
        """
        if not Path(path).is_file():
            raise FileNotFoundError(
                f"no range errors at {path}: give packaged, or a range_errors.json, see "
                "docs/navigation_training.md"
            )
        check_packaged(Path(path))
        with reading(path, "file of range errors", "give packaged, or another file"):
            content = read_json(Path(path))
            lists = ("edges", "bias", "spread", "miss", "far", "sectors")
            errors = cls(**(content | {name: tuple(content[name]) for name in lists}))
            check_edges("edges", errors.edges)
        return errors


def check_edges(name: str, edges: Sequence[float]) -> None:
    """Raise ``ValueError`` unless these are edges of distance bins [m]."""
    if len(edges) < 2 or not np.isfinite(edges).all() or not (np.diff(edges) > 0).all():
        raise ValueError(f"{name}={list(edges)}: give two or more finite distances, rising [m]")


def segments(ranges: np.ndarray) -> np.ndarray:
    """Number of each column's segment in true ranges ``(..., columns)``, counted from the right."""
    step = np.abs(np.diff(np.log(ranges), axis=-1)) > EDGE_STEP
    return np.concatenate([np.zeros_like(step[..., :1], int), np.cumsum(step, axis=-1)], axis=-1)

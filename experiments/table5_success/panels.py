"""A figure of panels, one per physics and sensor: what the figures of tables 5 and 6 share."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any


def draw_panels(
    panels: Sequence[tuple[str, str]], draw: Callable[[Any, tuple[str, str]], None], ylabel: str, path: Path
) -> None:
    """Draw every panel against density and write the figure.

    Args:
        panels: (physics, sensor).
        draw: ``(axis, panel)`` -> its labelled lines.
        ylabel: of the first panel.
        path: of the picture.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(panels), figsize=(4.6 * len(panels), 3.6), sharey=True, squeeze=False)
    for axis, panel in zip(axes[0], panels, strict=True):
        draw(axis, panel)
        axis.set(title=f"{panel[1]}, {panel[0]}", xlabel="obstacles on 400 m2")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel(ylabel)
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=130)
    plt.close(figure)

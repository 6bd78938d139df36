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
        axis.set(title=f"{panel[1]}, {panel[0]}", xlabel="obstacles on 400 m²")
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel(ylabel)
    lines: dict[str, Any] = {}  # a method may be in one panel alone
    for axis in axes[0]:
        handles, labels = axis.get_legend_handles_labels()
        lines |= dict(zip(labels, handles, strict=True))
    figure.tight_layout()
    figure.legend(lines.values(), lines, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=130, bbox_inches="tight")
    plt.close(figure)

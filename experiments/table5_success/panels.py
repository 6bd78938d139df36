"""The figures of tables 5 and 6: one panel for each physics and sensor."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from eldenet.results.plots import save_figure

Panel = tuple[str, str]  # physics, sensor
Points = Sequence[Sequence[float]]  # obstacles, value and, if there is one, its interval: low, high
COLUMNS = 3  # of panels
SPREAD = 0.6  # share of a column's width in which its methods lie side by side
MARKERS = "osDv^P<X>*h"


def draw_panels(
    curves: Mapping[Panel, Mapping[str, Points]],
    path: Path,
    *,
    ylabel: str,
    ylim: tuple[float, float] | None = None,
) -> None:
    """Draw every panel with a column for each density, and write the figure.

    A method has one color and marker in all panels. Methods lie side by side, so that equal values stay
    visible.

    Args:
        curves: panel -> method -> its points.
        path: file of the figure.
        ylabel: label of each row's first panel.
        ylim: range of all panels.
    """
    from matplotlib.figure import Figure

    methods = list(dict.fromkeys(method for panel in curves.values() for method in panel))
    courses = sorted({point[0] for panel in curves.values() for points in panel.values() for point in points})
    columns = min(len(curves), COLUMNS)
    rows = -(-len(curves) // columns)
    width = 7.0 if columns == 1 else 4.6
    figure = Figure(figsize=(width * columns, (4.2 if rows == 1 else 3.2) * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    lines = {}
    for axis, (panel, drawn) in zip(axes.flat, curves.items(), strict=False):
        for method, points in drawn.items():
            place = methods.index(method)
            beside = shift(place, len(methods))
            ends = [[abs(end - point[1]) for end in point[2:4]] for point in points]
            lines[method] = axis.errorbar(
                [courses.index(point[0]) + beside for point in points],
                [point[1] for point in points],
                yerr=list(zip(*ends, strict=True)) or None,
                marker=MARKERS[place % len(MARKERS)],
                color=f"C{place}" if place < 10 else "0.3",
                markersize=4.5,
                linewidth=1.2,
                capsize=2,
            )
        axis.set(title=f"{panel[1]}, {panel[0]}", xlabel="obstacles on 400 m²", ylim=ylim)
        axis.set_xticks(range(len(courses)), [f"{course:g}" for course in courses])
        axis.set_xlim(-0.5, len(courses) - 0.5)
        for edge in range(1, len(courses)):
            axis.axvline(edge - 0.5, color="0.85", linewidth=0.8)
        axis.grid(axis="y", alpha=0.3)
    for axis in axes.flat[len(curves) :]:
        axis.set_visible(False)
    for row in axes:
        row[0].set_ylabel(ylabel)
    shown = [method for method in methods if method in lines]
    figure.legend([lines[method] for method in shown], shown, fontsize=8, loc="outside right center")
    save_figure(figure, path)


def shift(place: int, methods: int) -> float:
    """Return how far a method's points lie beside the middle of their column."""
    return (place - (methods - 1) / 2) * min(0.12, SPREAD / methods)

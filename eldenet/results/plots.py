"""Plots of a study: accuracy against cost, and differences to a reference row."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from eldenet.results.paired_intervals import Difference
from eldenet.system.extras import require
from eldenet.system.files import part_file


def pareto_front(points: Sequence[tuple[float, float]], *, lower_is_better: bool = False) -> list[int]:
    """Indices of the points ``(cost, metric)`` on the Pareto front, the cheapest first."""
    front: list[int] = []
    best, sign = float("-inf"), -1 if lower_is_better else 1
    for index in sorted(range(len(points)), key=lambda i: (points[i][0], -sign * points[i][1])):
        if sign * points[index][1] > best:
            front.append(index)
            best = sign * points[index][1]
    return front


def pyplot_for_files() -> Any:
    """Return matplotlib's pyplot, set to draw without a display and to take dollar signs for text."""
    require("plots", "matplotlib")
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams["text.parse_math"] = False
    from matplotlib import pyplot

    return pyplot


def save_figure(figure: Any, path: Path) -> None:
    """Write a plot as PNG and close it. The same plot gives the same bytes; 128 colors save two thirds."""
    from PIL import Image

    picture = BytesIO()
    figure.savefig(picture, dpi=120)
    pyplot_for_files().close(figure)
    with part_file(path) as unfinished:
        Image.open(picture).convert("RGB").quantize(128).save(unfinished, optimize=True)


def pareto_plot(
    path: Path,
    blocks: Mapping[str, Sequence[tuple[str, float, float]]],
    *,
    metric: str,
    cost: str,
    lower_is_better: bool,
) -> None:
    """Plot the rows ``(name, cost, metric)`` of each block: one color per block, its Pareto front a line.

    Args:
        path: of the PNG.
        blocks: name of a block -> its rows.
        metric: label of the upward axis.
        cost: label of the other one.
        lower_is_better: for the metric.
    """
    from matplotlib.ticker import LogLocator

    pyplot = pyplot_for_files()
    figure, axes = pyplot.subplots(figsize=(8, 5))
    colors: dict[str, Any] = {}
    for block, rows in blocks.items():
        points = [(row[1], row[2]) for row in rows]
        front = [points[i] for i in pareto_front(points, lower_is_better=lower_is_better)]
        line = axes.plot(*zip(*front, strict=True), "-", linewidth=1)[0]
        axes.plot(*zip(*points, strict=True), "o", color=line.get_color(), label=block)
        colors |= {row[0]: line.get_color() for row in rows}
    axes.set_xscale("log")
    axes.margins(x=0.25, y=0.1)  # names stand to the right of their points
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    axes.xaxis.set_minor_formatter("{x:g}")
    axes.set_xlabel(cost)
    axes.set_ylabel(metric)
    axes.legend(fontsize=8, loc="best")  # clear of the points
    axes.grid(alpha=0.3, which="both")
    figure.tight_layout()
    name_points(axes, {name: [(x, y)] for rows in blocks.values() for name, x, y in rows}, colors)
    save_figure(figure, path)


def name_points(
    axes: Any, points: Mapping[str, Sequence[tuple[float, float]]], colors: Mapping[str, Any] | None = None
) -> None:
    """Write each name right of its last or left of its first point ``(x, y)``, the highest names first.

    Where there is room, names stay clear of other names, points and the legend, and leave the axes at the top
    only. Call this last: it measures what is drawn.
    """
    axes.figure.draw_without_rendering()  # limits and layout are settled from here on
    inside, legend = axes.get_window_extent(), axes.get_legend()
    taken = [] if legend is None else [legend.get_window_extent()]
    for name, own in sorted(points.items(), key=lambda row: -max(y for _, y in row[1])):
        others = [point for other in points if other != name for point in points[other]]
        pixels = axes.transData.transform(others) if others else []
        for right, up in ((4, 4), (4, -9), (6, -2), (-4, 4), (-4, -9), (-6, -2)):
            point, side = (max(own), "left") if right > 0 else (min(own), "right")
            note = axes.annotate(
                name,
                point,
                xytext=(right, up),
                textcoords="offset points",
                fontsize=7,
                ha=side,
                color=(colors or {}).get(name, "black"),
            )
            box = note.get_window_extent()
            within = inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0
            on_name = any(box.padded(4, 0).overlaps(other) for other in taken)
            if within and not on_name and not any(box.padded(4).contains(*pixel) for pixel in pixels):
                break
            note.remove()
        else:
            axes.add_artist(note)  # there is no room: the last one stays
        taken.append(box)


def differences_plot(
    path: Path,
    blocks: Mapping[str, Mapping[str, Difference]],
    *,
    metric: str,
    references: Mapping[str, str],
) -> None:
    """Plot each row's difference to the reference row with its interval, the best on top.

    Each of the ``blocks`` (name -> row -> difference) has a panel; ``references`` names its reference row.
    """
    pyplot = pyplot_for_files()
    heights = [len(rows) for rows in blocks.values()]
    figure, panels = pyplot.subplots(
        len(blocks),
        1,
        figsize=(7, 1.0 * len(blocks) + 0.22 * sum(heights)),
        squeeze=False,
        height_ratios=heights,
    )
    for axis, (block, rows) in zip(panels[:, 0], blocks.items(), strict=True):
        best_last = sorted(
            rows.items(), key=lambda row: row[1].mean, reverse=next(iter(rows.values())).lower_is_better
        )
        for height, (_, found) in enumerate(best_last):
            color = {"better": "C2", "worse": "C3"}.get(found.verdict, "C0")
            axis.plot((found.low, found.high), (height, height), "-" if found.seeds else ":", color=color)
            axis.plot(found.mean, height, "o", color=color, markersize=4)
        axis.axvline(0, color="black", linewidth=0.8)
        axis.set_yticks(range(len(best_last)), [name for name, _ in best_last], fontsize=7)
        axis.set_ylim(-0.7, len(best_last) - 0.3)
        axis.grid(alpha=0.3, axis="x")
        axis.set_title(block, fontsize=9)
        axis.set_xlabel(f"{metric} less that of {references[block]}; dotted: scenes alone", fontsize=8)
    figure.tight_layout()
    save_figure(figure, path)

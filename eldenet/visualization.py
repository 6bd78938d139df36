"""Pictures of depth: colors, a scale in meters, and rows of image, ground truth, prediction and error."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from eldenet.geometry import resize_sparse
from eldenet.system.files import write_bytes

if TYPE_CHECKING:
    from torch import Tensor

UNKNOWN = (0, 0, 0)
PALE = 150  # of 255: what is added to a third of a color where the network is unsure
LARGEST_SHARE = 50.0  # [% of the depth] of the colors of sigma and of errors
PANEL_WIDTH = 256  # [px], about
WIDEST_PANEL = 480  # [px]; wider maps shrink, so that a row of four fits a screen
GAP = 2  # [px]
SMALLEST_HEIGHT = 240  # [px]; the numbers of a smaller scale would be illegible
TITLE_HEIGHT = 18  # [px]
PANELS = ("image", "depth [m]", "prediction [m]", "error [% of the depth]")


def color_depth(depth: np.ndarray, near: float, far: float, known: np.ndarray | None = None) -> np.ndarray:
    """Color a depth map ``(H, W)`` [m] as ``(H, W, 3)`` uint8 RGB: near is warm, far is cool.

    Args:
        depth: [m].
        near: depth of the warm end [m].
        far: depth of the cool end [m].
        known: bool; where False the picture is black.
    """
    share = (np.nan_to_num(depth) - near) / max(far - near, 1e-9)
    return _colors(1 - share, cv2.COLORMAP_TURBO, known)


def _colors(share: np.ndarray, palette: int, known: np.ndarray | None) -> np.ndarray:
    """Colors ``(H, W, 3)`` uint8 RGB of shares ``(H, W)`` in [0, 1]."""
    colors = cv2.applyColorMap((255 * np.clip(share, 0, 1)).astype(np.uint8), palette)[..., ::-1].copy()
    if known is not None:
        colors[~known] = UNKNOWN
    return colors


def depth_row(image: "Tensor", depth: "Tensor", mask: "Tensor", prediction: "Tensor") -> np.ndarray:
    """One picture ``(h, w, 3)`` uint8: image, ground truth, prediction, error, their scales [m] and [%].

    Takes ``image (3, h, w)`` in [0, 1] and ``(1, H, W)`` maps [m]; the two depth panels share one range.
    Maps wider than ``WIDEST_PANEL`` shrink, and their known points stay points; small ones are enlarged by a
    whole factor.
    """
    truth, known, guess = (tensor.squeeze(0).cpu().numpy() for tensor in (depth, mask, prediction))
    height, width = truth.shape
    if width > WIDEST_PANEL:
        height, width = round(height * WIDEST_PANEL / width), WIDEST_PANEL
        truth = resize_sparse(np.where(known, truth, 0), (height, width))
        known = truth > 0
        guess = np.asarray(cv2.resize(guess, (width, height), interpolation=cv2.INTER_NEAREST_EXACT))
    photo = (image.permute(1, 2, 0).cpu().numpy() * 255).round().astype(np.uint8)
    photo = np.asarray(cv2.resize(photo, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    near, far = visible_range(np.where(known, truth, 0))
    panels = [
        photo,
        color_depth(truth, near, far, known),
        color_depth(guess, near, far),
        color_share(100 * np.abs(guess - truth) / np.where(known, truth, 1.0), known),
    ]
    times = max(1, round(PANEL_WIDTH / width))
    panels = [_enlarged(panel, times) for panel in panels]
    scales = [depth_scale(near, far, height * times), share_scale(height * times)]
    return _joined([*panels, *scales], _blank(height * times, GAP), axis=1)


def _joined(pieces: Sequence[np.ndarray], gap: np.ndarray, axis: int) -> np.ndarray:
    """Pieces with a gap between any two."""
    return np.concatenate([part for piece in pieces for part in (piece, gap)][:-1], axis)


def _blank(height: int, width: int) -> np.ndarray:
    """White ``(height, width, 3)`` uint8."""
    return np.full((height, width, 3), 255, np.uint8)


def _enlarged(picture: np.ndarray, times: int) -> np.ndarray:
    """Picture ``(times * H, times * W, 3)`` of ``(H, W, 3)``."""
    return picture.repeat(times, axis=0).repeat(times, axis=1)


def _write(picture: np.ndarray, text: str, corner: tuple[int, int], size: float) -> None:
    """Write black letters on ``(H, W, 3)``; ``corner`` is their lower left one (column, row) [px]."""
    cv2.putText(picture, text, corner, cv2.FONT_HERSHEY_SIMPLEX, size, (0, 0, 0), 1, cv2.LINE_AA)


def _letters(height: int) -> float:
    """Size of the letters beside panels of a height [px]."""
    return height / 800 + 0.2


def _length(text: str) -> int:
    """Length of a text in letters of size 1 [px]."""
    return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 1)[0][0]


def stack_rows(rows: Sequence[np.ndarray], titles: Sequence[str] = (), *, scales: int = 1) -> np.ndarray:
    """Stack rows ``(h, w, 3)`` below ``titles`` of their panels; narrow rows are padded.

    Each row ends in ``scales`` scales: two of :func:`depth_row`.
    """
    width = max(row.shape[1] for row in rows)
    rows = [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255) for row in rows]
    picture = _joined(rows, _blank(GAP, width), axis=0)
    if not titles:
        return picture
    strip = _blank(TITLE_HEIGHT, width)
    panels = rows[0].shape[1] - scales * depth_scale(0.0, 1.0, rows[0].shape[0]).shape[1]
    for number, title in enumerate(titles):
        _write(strip, title, (number * panels // len(titles) + 3, 13), 0.42)
    return np.concatenate([strip, picture])


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write ``(H, W, 3)`` uint8 RGB, or ``(H, W)`` uint8 or uint16, as PNG.

    Raises:
        OSError: the file could not be written.
    """
    pixels = picture[..., ::-1] if picture.ndim == 3 else picture
    # not cv2.imwrite, which does not say why it fails
    write_bytes(path, cv2.imencode(".png", np.ascontiguousarray(pixels))[1].tobytes())


def image_over_depth(image: np.ndarray, depth: np.ndarray, max_depth: float) -> np.ndarray:
    """Image ``(H, W, 3)`` uint8 above its colored depth [m] and a line about it, ``PANEL_WIDTH`` wide."""
    known = (depth > 0) & (depth <= max_depth)
    near, far = visible_range(np.where(known, depth, 0))
    pieces = []
    colors = color_depth(depth, near, far, known)
    for picture, way in ((image, cv2.INTER_AREA), (colors, cv2.INTER_NEAREST_EXACT)):
        height = max(1, round(picture.shape[0] * PANEL_WIDTH / picture.shape[1]))
        pieces.append(np.asarray(cv2.resize(picture, (PANEL_WIDTH, height), interpolation=way), np.uint8))
    legend = _blank(16, PANEL_WIDTH)
    _write(legend, f"{near:.2f} to {far:.2f} m, {known.mean():.0%} known", (3, 12), 0.38)
    return np.concatenate([*pieces, legend], axis=0)


def contact_sheet(panels: Sequence[tuple[str, np.ndarray]], columns: int) -> np.ndarray:
    """Titled panels ``(h, W, 3)`` of one width in rows of ``columns``; a long title keeps its end."""
    width = panels[0][1].shape[1]
    rows = []
    for first in range(0, len(panels), columns):
        row = panels[first : first + columns]
        height = max(panel.shape[0] for _, panel in row) + TITLE_HEIGHT
        strip = _blank(height, columns * (width + GAP) - GAP)
        for number, (title, panel) in enumerate(row):
            left = number * (width + GAP)
            text = title if len(title) <= 38 else f"...{title[-35:]}"
            _write(strip, text, (left + 3, 13), 0.38)
            strip[TITLE_HEIGHT : TITLE_HEIGHT + panel.shape[0], left : left + width] = panel
        rows.append(strip)
    return stack_rows(rows)


def visible_range(depth: np.ndarray) -> tuple[float, float]:
    """The range of colors of depth ``(H, W)`` [m]: the 2nd and 98th percentile of the known; else 0 and 1."""
    known = depth[np.isfinite(depth) & (depth > 0)]
    if not known.size:
        return 0.0, 1.0
    near, far = (float(value) for value in np.percentile(known, (2, 98)))
    return near, max(far, near + 0.05)


def photo_beside_depth(
    photo: np.ndarray, depth: np.ndarray, near: float, far: float, *, unsure: np.ndarray | None = None
) -> np.ndarray:
    """One picture ``(h, w, 3)`` uint8 RGB: photo, colored depth, scale in meters, titles above them.

    Args:
        photo: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` [m]; unknown (0 or not finite) is black.
        near: depth of the warm end [m].
        far: depth of the cool end [m].
        unsure: ``(H, W)`` bool, where the colors are pale.

    Small photos are enlarged by a whole factor to ``SMALLEST_HEIGHT`` or more. Height and width are even, as
    video codecs need.
    """
    known = np.isfinite(depth) & (depth > 0)
    colors = color_depth(depth, near, far, known)
    if unsure is not None:
        at = unsure & known
        colors[at] = colors[at] // 3 + PALE  # toward white, so that the depth can still be read
    titles = ("picture", "depth" if unsure is None else "depth (pale: unsure)")
    return _beside(photo, [colors], lambda height: depth_scale(near, far, height), titles)


def photo_beside_depths(
    photo: np.ndarray, depths: Sequence[np.ndarray], near: float, far: float
) -> np.ndarray:
    """Same as :func:`photo_beside_depth` for several depth maps ``(H, W)`` [m], with one scale, no titles."""
    panels = [color_depth(depth, near, far, np.isfinite(depth) & (depth > 0)) for depth in depths]
    return _beside(photo, panels, lambda height: depth_scale(near, far, height))


def photo_beside_sigma(photo: np.ndarray, depth: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """One picture ``(h, w, 3)`` uint8 RGB: photo, sigma in percent of the depth, scale, titles.

    Dark is sure; bright is ``LARGEST_SHARE`` percent and more. All maps are ``(H, W)`` [m].
    """
    return _beside(photo, [color_share(100 * sigma / depth)], share_scale, ("picture", "sigma, of the depth"))


def share_scale(height: int) -> np.ndarray:
    """Scale ``(height, w, 3)`` uint8 RGB of :func:`color_share` [%]."""
    return depth_scale(0.0, LARGEST_SHARE, height, unit="%", color=color_share)


def color_share(percent: np.ndarray, known: np.ndarray | None = None) -> np.ndarray:
    """Color ``(H, W)`` [%] as ``(H, W, 3)`` uint8 RGB: dark is 0, bright is ``LARGEST_SHARE`` and more."""
    return _colors(percent / LARGEST_SHARE, cv2.COLORMAP_INFERNO, known)


def _beside(
    photo: np.ndarray,
    panels: Sequence[np.ndarray],
    scale: Callable[[int], np.ndarray],
    titles: Sequence[str] = (),
) -> np.ndarray:
    """Photo, panels ``(H, W, 3)`` and the scale of their height below titles, in a picture of even sides."""
    factor = -(-SMALLEST_HEIGHT // photo.shape[0])
    pieces = [_enlarged(panel, factor) for panel in (photo, *panels)]
    height, width = pieces[0].shape[:2]
    row = _joined([*pieces, scale(height)], _blank(height, 4), axis=1)
    if titles:
        size = min([_letters(height), *(0.95 * width / _length(title) for title in titles)])
        strip = _blank(2 * round(15 * size) + 6, row.shape[1])
        for number, title in enumerate(titles):
            _write(strip, title, (number * (width + 4) + 2, round(22 * size) + 3), size)
        row = np.concatenate([strip, row])
    return np.pad(row, ((0, row.shape[0] % 2), (0, row.shape[1] % 2), (0, 0)), constant_values=255)


def depth_scale(
    near: float,
    far: float,
    height: int,
    *,
    unit: str = "m",
    color: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Colors from ``near`` (top) to ``far`` beside round numbers: ``(height, w, 3)`` uint8 RGB.

    Args:
        color: values -> colors; None: those of :func:`color_depth`.
    """
    size = _letters(height)
    margin, bar = round(24 * size) + 2, max(10, height // 24)
    ticks = round_numbers(near, far)
    digits = max(0, min(2, -int(np.floor(np.log10(ticks[1] - ticks[0]) + 1e-9))))
    labels = [f"{tick:.{digits}f} {unit}" for tick in ticks]
    font = cv2.FONT_HERSHEY_SIMPLEX
    (wide, _), _ = cv2.getTextSize("00.00 m", font, size, 1)  # constant, as the frames of a video need
    scale = _blank(height, bar + 10 + wide + 6)
    length = height - 2 * margin
    ramp = np.linspace(near, far, length)[:, None].repeat(bar, axis=1)
    scale[margin : margin + length, :bar] = color(ramp) if color else color_depth(ramp, near, far)
    for tick, label in zip(ticks, labels, strict=True):
        row = margin + round((tick - near) / (far - near) * (length - 1))
        cv2.line(scale, (bar, row), (bar + 5, row), (0, 0, 0), 1)
        (_, tall), _ = cv2.getTextSize(label, font, size, 1)
        _write(scale, label, (bar + 9, row + tall // 2), size)
    return scale


def round_numbers(near: float, far: float) -> list[float]:
    """Three to eight round numbers, evenly spaced within ``[near, far]``."""
    step = 10.0 ** np.floor(np.log10((far - near) / 3))
    step = next(step * times for times in (5, 2, 1) if (far - near) / (step * times) >= 3 or times == 1)
    first = np.ceil(near / step - 1e-9)
    count = int(np.floor(far / step + 1e-9) - first) + 1
    return [round(float((first + i) * step), 6) for i in range(count)]

"""Surface patterns drawn by formula (wood, tiles, fabric, books, windows ...), and the atlas that holds them.

A pattern does not hold colors but three weights per texel: the surface's color is
``w0 * A + w1 * B + w2 * C`` with the material's own three colors, so a hundred patterns make any number
of surfaces. Row 0 is the lower edge.
"""

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np

#: Texels along a pattern's edge.
SIDE = 128
#: Levels of the atlas's pyramid.
LEVELS = 6

Weights = np.ndarray  # (SIDE, SIDE, 3) float32 in [0, ~1.3]
Pattern = Callable[[np.random.Generator], Weights]


def grid() -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates ``(u, v)`` of the texels' centers in [0, 1]."""
    axis = (np.arange(SIDE, dtype=np.float32) + 0.5) / SIDE
    v, u = np.meshgrid(axis, axis, indexing="ij")
    return u, v


def noise(rng: np.random.Generator, cells_u: int, cells_v: int, octaves: int = 3) -> np.ndarray:
    """Return periodic value noise ``(SIDE, SIDE)`` in [0, 1]."""
    total = np.zeros((SIDE, SIDE), np.float32)
    weight = 0.0
    for octave in range(octaves):
        nu, nv = min(SIDE, cells_u << octave), min(SIDE, cells_v << octave)
        coarse = np.pad(rng.random((nv, nu)).astype(np.float32), 2, mode="wrap")
        su, sv = SIDE // nu, SIDE // nv
        fine = cv2.resize(coarse, None, fx=su, fy=sv, interpolation=cv2.INTER_LINEAR)
        total += fine[2 * sv : 2 * sv + SIDE, 2 * su : 2 * su + SIDE] * 0.5**octave
        weight += 0.5**octave
    total /= weight
    return (total - total.min()) / (total.max() - total.min() + 1e-6)


def mix(second: np.ndarray, third: np.ndarray | float = 0.0, light: np.ndarray | float = 1.0) -> Weights:
    """Return weights ``(SIDE, SIDE, 3)``: A where both are 0, B by ``second``, C by ``third``."""
    second = np.clip(second, 0, 1)
    third = np.broadcast_to(np.clip(third, 0, 1), second.shape)
    out = np.stack([(1 - second) * (1 - third), second * (1 - third), third], axis=-1)
    return (out * np.broadcast_to(light, second.shape)[..., None]).astype(np.float32)


def plain(rng: np.random.Generator) -> Weights:
    """Paint: almost uniform."""
    return mix(0.25 * noise(rng, 2, 2), 0.0, 0.98 + 0.04 * noise(rng, 16, 16, 2))


def plaster(rng: np.random.Generator) -> Weights:
    """Uneven, stained plaster or wallpaper."""
    return mix(noise(rng, 2, 2, 4) ** 2, 0.0, 0.9 + 0.2 * noise(rng, 8, 8, 4))


def planks(rng: np.random.Generator) -> Weights:
    """Floor boards along u, each with its own tone and grain."""
    u, v = grid()
    rows = int(rng.integers(4, 11))
    row = np.floor(v * rows).astype(int)
    offset = rng.random(rows)[row]
    column = np.floor(((u + offset) % 1.0) * 2).astype(int)
    tone = rng.random((rows, 2))[row, column]
    seam = ((v * rows) % 1.0 < 0.07) | (((u + offset) % 1.0 * 2) % 1.0 < 0.015)
    grain = noise(rng, 2, 32, 2)
    return mix(0.75 * tone + 0.25 * grain, 0.65 * seam, 0.85 + 0.3 * grain)


def grain(rng: np.random.Generator) -> Weights:
    """Furniture wood."""
    _, v = grid()
    warp = noise(rng, 2, 4, 2)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * (v * int(rng.integers(4, 12)) + 1.5 * warp))
    return mix(0.7 * rings + 0.3 * noise(rng, 2, 64, 1), 0.0, 0.9 + 0.2 * warp)


def tiles(rng: np.random.Generator) -> Weights:
    """Square or long tiles with grout; some sets are two-colored."""
    u, v = grid()
    nu, nv = int(rng.integers(2, 6)), int(rng.integers(2, 6))
    iu, iv = np.floor(u * nu).astype(int), np.floor(v * nv).astype(int)
    tone = rng.random((nv, nu))[iv, iu] * 0.35
    if rng.random() < 0.35:
        tone = ((iu + iv) % 2).astype(np.float32)
    gap = 0.03 + 0.03 * rng.random()
    grout = ((u * nu) % 1.0 < gap * 1.2) | ((v * nv) % 1.0 < gap * 1.2)
    return mix(tone, grout * 1.0, 0.92 + 0.14 * noise(rng, 4, 4, 3))


def bricks(rng: np.random.Generator) -> Weights:
    """Running bond."""
    u, v = grid()
    rows, cols = int(rng.integers(6, 12)), int(rng.integers(3, 5))
    row = np.floor(v * rows).astype(int)
    shifted = (u + 0.5 / cols * (row % 2)) % 1.0
    column = np.floor(shifted * cols).astype(int)
    tone = rng.random((rows, cols))[row, column]
    mortar = ((v * rows) % 1.0 < 0.14) | ((shifted * cols) % 1.0 < 0.07)
    return mix(tone, mortar * 1.0, 0.8 + 0.4 * noise(rng, 16, 16, 3))


def carpet(rng: np.random.Generator) -> Weights:
    """Fine pile with soft stains."""
    stains = noise(rng, 4, 4, 3) * 0.5 + 0.5 * rng.random((SIDE, SIDE))
    return mix(stains, 0.0, 0.8 + 0.4 * noise(rng, 64, 64, 1))


def speckle(rng: np.random.Generator) -> Weights:
    """Granite, terrazzo, marble."""
    fine, broad = noise(rng, 32, 32, 2), noise(rng, 4, 4, 4)
    grains, veins = np.clip(3 * (fine - 0.4), 0, 1) * 0.8, np.clip(6 * (broad - 0.7), 0, 1) * 0.7
    return mix(grains, veins, 0.9 + 0.2 * broad)


def stripes(rng: np.random.Generator) -> Weights:
    """Fabric stripes of unequal width."""
    u, v = grid()
    axis = u if rng.random() < 0.6 else v
    bands = rng.integers(0, 3, int(rng.integers(6, 24)))
    pick = bands[np.floor(axis * len(bands)).astype(int)]
    return mix(pick == 1, (pick == 2) * 1.0, 0.85 + 0.3 * noise(rng, 16, 16, 3))


def plaid(rng: np.random.Generator) -> Weights:
    """Checked fabric."""
    u, v = grid()
    bands = rng.random(int(rng.integers(4, 12)))
    a, b = (bands[np.floor(x * len(bands)).astype(int)] for x in (u, v))
    second, third = 0.5 * (a > 0.5) + 0.5 * (b > 0.5), 0.8 * ((a > 0.85) | (b > 0.85))
    return mix(second, third, 0.85 + 0.3 * noise(rng, 32, 32, 2))


def blobs(rng: np.random.Generator) -> Weights:
    """Flowers, camouflage, quilt prints."""
    first, second = noise(rng, 8, 8, 2), noise(rng, 8, 8, 2)
    return mix(first > 0.55, (second > 0.62) * 1.0, 0.85 + 0.3 * noise(rng, 4, 4, 3))


def folds(rng: np.random.Generator) -> Weights:
    """Curtain or crumpled cloth: shading of vertical folds."""
    u, v = grid()
    phase = 2 * np.pi * (u * int(rng.integers(4, 14)) + 0.35 * noise(rng, 2, 2, 2) + 0.1 * v)
    return mix(0.3 * noise(rng, 16, 2, 2), 0.0, 0.72 + 0.22 * np.sin(phase) + 0.12 * np.sin(2.3 * phase))


def crumple(rng: np.random.Generator) -> Weights:
    """Bedding, clothes in a heap."""
    ridged = np.abs(noise(rng, 4, 4, 4) - 0.5) * 2
    return mix(0.3 * noise(rng, 4, 4), 0.0, 0.65 + 0.55 * ridged**0.7)


def tufted(rng: np.random.Generator) -> Weights:
    """Quilted leather or mattress."""
    u, v = grid()
    count = int(rng.integers(3, 7))
    wave = np.abs(np.sin(np.pi * count * (u + v))) * np.abs(np.sin(np.pi * count * (u - v)))
    return mix(0.2 * noise(rng, 8, 8), 0.0, 0.7 + 0.4 * wave**0.5)


def _rectangle(u: np.ndarray, v: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    """Texels ``(SIDE, SIDE)`` bool inside a rectangle."""
    return (u >= x0) & (u < x1) & (v >= y0) & (v < y1)


def _panel(
    light: np.ndarray, u: np.ndarray, v: np.ndarray, box: tuple[float, float, float, float], edge: float
) -> None:
    """Carve a raised panel into ``(SIDE, SIDE)`` light: dark lower edge, bright upper edge."""
    x0, y0, x1, y1 = box
    light[_rectangle(u, v, x0, y0, x1, y1)] *= 0.72
    light[_rectangle(u, v, x0 + edge, y0 + edge, x1 - edge, y1 - edge)] *= 1.36


def fronts(rng: np.random.Generator) -> Weights:
    """Cabinet or drawer fronts with handles; fits one face."""
    u, v = grid()
    nu, nv = int(rng.integers(1, 4)), int(rng.integers(1, 5))
    light = 0.93 + 0.1 * noise(rng, 2, 16, 2)
    handle = np.zeros((SIDE, SIDE), bool)
    gap = np.zeros((SIDE, SIDE), bool)
    style = int(rng.integers(0, 3))
    for i in range(nu):
        for j in range(nv):
            x0, y0, x1, y1 = i / nu, j / nv, (i + 1) / nu, (j + 1) / nv
            inner = _rectangle(u, v, x0 + 0.012, y0 + 0.012, x1 - 0.012, y1 - 0.012)
            gap |= _rectangle(u, v, x0, y0, x1, y1) & ~inner
            if style:
                _panel(light, u, v, (x0 + 0.2 / nu, y0 + 0.15 / nv, x1 - 0.2 / nu, y1 - 0.15 / nv), 0.02)
            cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
            if nv >= 2 and style != 2:
                handle |= _rectangle(u, v, cx - 0.12 / nu, cy - 0.018, cx + 0.12 / nu, cy + 0.018)
            else:
                side = x0 + 0.1 / nu if i % 2 else x1 - 0.1 / nu
                handle |= _rectangle(u, v, side - 0.018, cy - 0.09 / nv, side + 0.018, cy + 0.09 / nv)
    light = np.where(gap, light * 0.35, light)
    return mix(noise(rng, 2, 32, 2) * 0.6, handle * 1.0, light)


def door(rng: np.random.Generator) -> Weights:
    """Room door with panels and a handle; fits one face."""
    u, v = grid()
    light = 0.97 + 0.05 * noise(rng, 2, 16, 2)
    for x0, x1 in ((0.12, 0.46), (0.54, 0.88)) if rng.random() < 0.6 else ((0.15, 0.85),):
        for y0, y1 in ((0.05, 0.4), (0.47, 0.94)):
            _panel(light, u, v, (x0, y0, x1, y1), 0.025)
    handle = _rectangle(u, v, 0.9, 0.44, 0.96, 0.48)
    return mix(0.4 * noise(rng, 2, 32, 2), handle * 1.0, light)


def books(rng: np.random.Generator) -> Weights:
    """Rows of book spines or small goods; fits one face."""
    out = mix(np.zeros((SIDE, SIDE)), 0.0, 0.25)
    rows = int(rng.integers(2, 6))
    for j in range(rows):
        y0, y1 = int(j * SIDE / rows), int((j + 1) * SIDE / rows)
        x = 0
        while x < SIDE - 2:
            width = int(rng.integers(2, 8))
            if rng.random() < 0.92:
                height = int((y1 - y0) * (0.6 + 0.32 * rng.random()))
                weights = rng.random(3) ** 2
                out[y0 + 3 : y0 + 3 + height, x : x + width] = 0.25 + 0.8 * weights
                out[y0 + 3 : y0 + 3 + height, x] *= 0.5
            x += width
        out[y0 : y0 + 3] = (0.9, 0.1, 0.0)
    return out


def poster(rng: np.random.Generator) -> Weights:
    """Picture, poster, screen: random shapes in three colors, often framed; fits one face."""
    u, v = grid()
    base = noise(rng, 2, 2, 4)
    second, third = base * float(rng.random() * 1.5), np.zeros((SIDE, SIDE), np.float32)
    for _ in range(int(rng.integers(2, 9))):
        x, y, r = rng.random(), rng.random(), 0.05 + 0.3 * rng.random()
        round_shape = rng.random() < 0.5
        rectangle = _rectangle(u, v, x - r, y - r / 2, x + r, y + r / 2)
        inside = (u - x) ** 2 + (v - y) ** 2 < r * r if round_shape else rectangle
        target = second if rng.random() < 0.5 else third
        target[inside] = rng.random()
    light = 0.5 + 0.7 * noise(rng, 4, 4, 4)
    border = 0.03 + 0.09 * rng.random()
    edge = ~_rectangle(u, v, border, border, 1 - border, 1 - border)
    light = np.where(edge, 1.1 * rng.random() + 0.1, light)
    return mix(np.where(edge, 0.0, second), np.where(edge, 0.0, third), light)


def text(rng: np.random.Generator) -> Weights:
    """Paper, whiteboard, calendar, label: lines of marks; fits one face."""
    u, v = grid()
    lines = int(rng.integers(6, 16))
    ink = ((v * lines) % 1.0 < 0.45) & (noise(rng, 32, lines if lines in (8, 16) else 8, 1) > 0.45)
    ink &= _rectangle(u, v, 0.08, 0.06, 0.92, 0.94) & (
        rng.random(lines)[np.floor(v * lines).astype(int)] < 0.75
    )
    picture = _rectangle(u, v, 0.1, 0.1, 0.1 + 0.5 * rng.random(), 0.1 + 0.4 * rng.random())
    return mix(ink * 0.9, picture * 0.9, 0.95 + 0.08 * noise(rng, 4, 4))


def outdoors(rng: np.random.Generator) -> Weights:
    """What a window shows: sky (A), trees or houses (B), bars (C); fits one face, v up."""
    u, v = grid()
    skyline = 0.2 + 0.6 * noise(rng, 8, 8, 2)[0][None]
    trees = np.clip((skyline - v) * 12, 0, 1) * (0.35 + 0.6 * noise(rng, 8, 8, 4))
    nu, nv = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    bars = ((u * nu) % 1.0 < 0.05 * nu) | ((v * nv) % 1.0 < 0.05 * nv) | (u > 0.95) | (v > 0.95)
    return mix(trees, bars * 1.0)


def blinds(rng: np.random.Generator) -> Weights:
    """Venetian blinds, vents, radiators: fine bars."""
    u, v = grid()
    axis = v if rng.random() < 0.6 else u
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * axis * int(rng.integers(8, 30)))
    return mix(0.8 * wave, 0.0, 0.9 + 0.15 * noise(rng, 2, 2))


def appliance(rng: np.random.Generator) -> Weights:
    """Oven, microwave, washing machine, computer: dark window and buttons; fits one face."""
    u, v = grid()
    x0, y0, x1, y1 = 0.1, 0.12, 0.6 + 0.3 * rng.random(), 0.6 + 0.2 * rng.random()
    pane = _rectangle(u, v, x0, y0, x1, y1)
    if rng.random() < 0.3:
        pane = (u - 0.5) ** 2 + (v - 0.45) ** 2 < 0.1
    knobs = (((u * 8) % 1.0 - 0.5) ** 2 + ((v * 8) % 1.0 - 0.5) ** 2 < 0.06) & (v > 0.86)
    light = 0.9 + 0.15 * noise(rng, 2, 2, 3)
    return mix(pane * 0.95, knobs * 1.0, light)


def foliage(rng: np.random.Generator) -> Weights:
    """Leaves."""
    second, third = noise(rng, 16, 16, 2) > 0.5, 0.5 * (noise(rng, 16, 16, 2) > 0.7)
    return mix(second, third, 0.5 + 0.7 * noise(rng, 16, 16, 3))


def facade(rng: np.random.Generator) -> Weights:
    """House front: a wall (A) with rows of windows (B) in frames (C), some with a cornice."""
    u, v = grid()
    nu, nv = int(rng.integers(2, 6)), int(rng.integers(2, 4))
    wide, tall = 0.3 + 0.35 * rng.random(), 0.4 + 0.3 * rng.random()
    x, y = np.abs((u * nu) % 1.0 - 0.5) * 2, np.abs((v * nv) % 1.0 - 0.45) * 2
    frame, pane = (x < wide + 0.12) & (y < tall + 0.08), (x < wide) & (y < tall)
    pane &= (x > 0.05) | (rng.random() < 0.4)
    iu, iv = np.floor(u * nu).astype(int), np.floor(v * nv).astype(int)
    glass = 0.55 + 0.45 * rng.random((nv, nu))[iv, iu]
    cornice = ((v * nv) % 1.0 > 0.94) & (rng.random() < 0.6)
    edge = frame & ~pane if rng.random() < 0.8 else frame & ~frame
    light = 0.85 + 0.2 * noise(rng, 4, 4, 4) + 0.08 * noise(rng, 32, 32, 1)
    return mix(np.where(pane, glass, 0.12 * noise(rng, 8, 8, 3)), (edge | cornice) * 0.9, light)


# Variants of each pattern in the atlas. Their order fixes the patterns' numbers and so the rooms.
FAMILIES: tuple[tuple[Pattern, int], ...] = (
    (plain, 3), (plaster, 4), (planks, 8), (grain, 6), (tiles, 8), (bricks, 4), (carpet, 4), (speckle, 6),
    (stripes, 6), (plaid, 6), (blobs, 6), (folds, 5), (crumple, 5), (tufted, 3), (fronts, 12), (door, 6),
    (books, 8), (poster, 24), (text, 6), (outdoors, 10), (blinds, 6), (appliance, 6), (foliage, 3),
    (facade, 10),
)  # fmt: skip


def variants(family: str) -> range:
    """Return the pattern numbers of a family, e.g. ``variants("planks")``."""
    place = [pattern.__name__ for pattern, _ in FAMILIES].index(family)
    first = sum(count for _, count in FAMILIES[:place])
    return range(first, first + FAMILIES[place][1])


class Atlas:
    """All patterns with their image pyramids, sampled bilinearly.

    The level follows the pixel's footprint, so distant tiles turn gray instead of sparkling.
    """

    UNIT = np.float32(1 / 200)

    def __init__(self) -> None:
        first = [
            pattern(np.random.default_rng((77, number, variant)))
            for number, (pattern, count) in enumerate(FAMILIES)
            for variant in range(count)
        ]
        level = np.clip(np.stack(first) * 200 + 0.5, 0, 255).astype(np.uint8)
        levels = [level]
        for _ in range(LEVELS - 1):
            wide = levels[-1].astype(np.float32)
            half = (wide[:, ::2, ::2] + wide[:, 1::2, ::2] + wide[:, ::2, 1::2] + wide[:, 1::2, 1::2]) / 4
            levels.append((half + 0.5).astype(np.uint8))
        self.count = len(first)
        starts = np.cumsum([0] + [lv.shape[0] * lv.shape[1] * lv.shape[2] for lv in levels[:-1]])
        self.starts = starts.astype(np.int32)
        # (3, T) uint8 weights, 200 = 1.0; level by level, pattern by pattern, row by row
        self.planes = np.ascontiguousarray(np.concatenate([lv.reshape(-1, 3) for lv in levels]).T)

    def sample(self, pattern: np.ndarray, u: np.ndarray, v: np.ndarray, footprint: np.ndarray) -> np.ndarray:
        """Return the weights ``(3, N)`` float32 at texture coordinates (period 1).

        Args:
            pattern: ``(N,)`` int32 pattern numbers.
            u: ``(N,)`` float32.
            v: ``(N,)`` float32.
            footprint: ``(N,)`` float32, size of a pixel in texture units; chooses the pyramid's level.
        """
        level = np.frexp(np.minimum(footprint * np.float32(SIDE * 0.8), np.float32(2**LEVELS - 1)))[1]
        level = np.clip(level, 0, LEVELS - 1)
        side = np.right_shift(np.int32(SIDE), level)
        mask = side - 1
        base = self.starts.take(level) + pattern * side * side
        x, y = u * side - np.float32(0.5), v * side - np.float32(0.5)
        fx, fy = np.floor(x), np.floor(y)
        ix, iy = fx.astype(np.int32), fy.astype(np.int32)
        x, y = (x - fx).astype(np.float32), (y - fy).astype(np.float32)
        left, right = ix & mask, (ix + 1) & mask
        top, bottom = base + (iy & mask) * side, base + ((iy + 1) & mask) * side
        corners = (top + left, top + right, bottom + left, bottom + right)
        out = np.empty((3, len(u)), np.float32)
        for c in range(3):
            a, b, e, f = (self.planes[c].take(corner).astype(np.float32) for corner in corners)
            a += (b - a) * x
            e += (f - e) * x
            a += (e - a) * y
            np.multiply(a, self.UNIT, out=out[c])
        return out


@lru_cache(maxsize=1)
def atlas() -> Atlas:
    """Return the one atlas of this process, built on first use (about 0.3 s)."""
    return Atlas()

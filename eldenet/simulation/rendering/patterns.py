"""Surface patterns drawn by formula: wood, tiles, brick, carpet, fabric, fronts, posters, windows.

A pattern does not hold colors but three weights per texel: the surface's color is
``w0 * A + w1 * B + w2 * C`` with the material's own three colors, so a hundred patterns make any number
of surfaces. Row 0 is the lower edge.
"""

import numpy as np

from eldenet.simulation.rendering.motifs import (
    appliance,
    blinds,
    books,
    door,
    foliage,
    fronts,
    outdoors,
    poster,
    text,
)
from eldenet.simulation.rendering.noise import SIDE, Pattern, Weights, grid, mix, noise


def plain(rng: np.random.Generator) -> Weights:
    """Paint: almost nothing."""
    return mix(0.25 * noise(rng, 2, 2), 0.0, 0.98 + 0.04 * noise(rng, 16, 16, 2))


def plaster(rng: np.random.Generator) -> Weights:
    """Uneven, stained plaster or wallpaper ground."""
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
    return mix(
        noise(rng, 4, 4, 3) * 0.5 + 0.5 * rng.random((SIDE, SIDE)), 0.0, 0.8 + 0.4 * noise(rng, 64, 64, 1)
    )


def speckle(rng: np.random.Generator) -> Weights:
    """Granite, terrazzo, marble."""
    fine, broad = noise(rng, 32, 32, 2), noise(rng, 4, 4, 4)
    return mix(
        np.clip(3 * (fine - 0.4), 0, 1) * 0.8, np.clip(6 * (broad - 0.7), 0, 1) * 0.7, 0.9 + 0.2 * broad
    )


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
    return mix(
        0.5 * (a > 0.5) + 0.5 * (b > 0.5),
        0.8 * ((a > 0.85) | (b > 0.85)),
        0.85 + 0.3 * noise(rng, 32, 32, 2),
    )


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


# How many variants of each pattern the atlas holds; the order fixes their numbers, hence the hashes of rooms.
FAMILIES: tuple[tuple[Pattern, int], ...] = (
    (plain, 3),
    (plaster, 4),
    (planks, 8),
    (grain, 6),
    (tiles, 8),
    (bricks, 4),
    (carpet, 4),
    (speckle, 6),
    (stripes, 6),
    (plaid, 6),
    (blobs, 6),
    (folds, 5),
    (crumple, 5),
    (tufted, 3),
    (fronts, 12),
    (door, 6),
    (books, 8),
    (poster, 24),
    (text, 6),
    (outdoors, 10),
    (blinds, 6),
    (appliance, 6),
    (foliage, 3),
)


def variants(family: str) -> range:
    """Pattern numbers of a family, e.g. ``variants("planks")``."""
    first = 0
    for pattern, count in FAMILIES:
        if pattern.__name__ == family:
            return range(first, first + count)
        first += count
    raise ValueError(f"no texture family {family!r}: use one of {[p.__name__ for p, _ in FAMILIES]}")

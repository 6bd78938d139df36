"""Patterns of things rather than of materials: fronts, doors, books, posters, windows, leaves."""

import numpy as np

from eldenet.simulation.rendering.noise import SIDE, Weights, grid, mix, noise


def _frame(u: np.ndarray, v: np.ndarray, x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return (u >= x0) & (u < x1) & (v >= y0) & (v < y1)


def _panel(
    light: np.ndarray, u: np.ndarray, v: np.ndarray, box: tuple[float, float, float, float], edge: float
) -> None:
    """Carve a raised panel: dark lower edge, bright upper edge."""
    x0, y0, x1, y1 = box
    light[_frame(u, v, x0, y0, x1, y1)] *= 0.72
    light[_frame(u, v, x0 + edge, y0 + edge, x1 - edge, y1 - edge)] *= 1.36


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
            gap |= _frame(u, v, x0, y0, x1, y1) & ~_frame(
                u, v, x0 + 0.012, y0 + 0.012, x1 - 0.012, y1 - 0.012
            )
            if style:
                _panel(light, u, v, (x0 + 0.2 / nu, y0 + 0.15 / nv, x1 - 0.2 / nu, y1 - 0.15 / nv), 0.02)
            cx, cy = (x0 + x1) / 2, (y0 + y1) / 2
            if nv >= 2 and style != 2:
                handle |= _frame(u, v, cx - 0.12 / nu, cy - 0.018, cx + 0.12 / nu, cy + 0.018)
            else:
                side = x0 + 0.1 / nu if i % 2 else x1 - 0.1 / nu
                handle |= _frame(u, v, side - 0.018, cy - 0.09 / nv, side + 0.018, cy + 0.09 / nv)
    light = np.where(gap, light * 0.35, light)
    return mix(noise(rng, 2, 32, 2) * 0.6, handle * 1.0, light)


def door(rng: np.random.Generator) -> Weights:
    """Room door with panels and a handle; fits one face."""
    u, v = grid()
    light = 0.97 + 0.05 * noise(rng, 2, 16, 2)
    for x0, x1 in ((0.12, 0.46), (0.54, 0.88)) if rng.random() < 0.6 else ((0.15, 0.85),):
        for y0, y1 in ((0.05, 0.4), (0.47, 0.94)):
            _panel(light, u, v, (x0, y0, x1, y1), 0.025)
    handle = _frame(u, v, 0.9, 0.44, 0.96, 0.48)
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
        inside = (
            (u - x) ** 2 + (v - y) ** 2 < r * r
            if rng.random() < 0.5
            else _frame(u, v, x - r, y - r / 2, x + r, y + r / 2)
        )
        target = second if rng.random() < 0.5 else third
        target[inside] = rng.random()
    light = 0.5 + 0.7 * noise(rng, 4, 4, 4)
    border = 0.03 + 0.09 * rng.random()
    edge = ~_frame(u, v, border, border, 1 - border, 1 - border)
    light = np.where(edge, 1.1 * rng.random() + 0.1, light)
    return mix(np.where(edge, 0.0, second), np.where(edge, 0.0, third), light)


def text(rng: np.random.Generator) -> Weights:
    """Paper, whiteboard, calendar, label: lines of marks; fits one face."""
    u, v = grid()
    lines = int(rng.integers(6, 16))
    ink = ((v * lines) % 1.0 < 0.45) & (noise(rng, 32, lines if lines in (8, 16) else 8, 1) > 0.45)
    ink &= _frame(u, v, 0.08, 0.06, 0.92, 0.94) & (rng.random(lines)[np.floor(v * lines).astype(int)] < 0.75)
    picture = _frame(u, v, 0.1, 0.1, 0.1 + 0.5 * rng.random(), 0.1 + 0.4 * rng.random())
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
    pane = _frame(u, v, x0, y0, x1, y1)
    if rng.random() < 0.3:
        pane = (u - 0.5) ** 2 + (v - 0.45) ** 2 < 0.1
    knobs = (((u * 8) % 1.0 - 0.5) ** 2 + ((v * 8) % 1.0 - 0.5) ** 2 < 0.06) & (v > 0.86)
    light = 0.9 + 0.15 * noise(rng, 2, 2, 3)
    return mix(pane * 0.95, knobs * 1.0, light)


def foliage(rng: np.random.Generator) -> Weights:
    """Leaves."""
    return mix(
        noise(rng, 16, 16, 2) > 0.5, 0.5 * (noise(rng, 16, 16, 2) > 0.7), 0.5 + 0.7 * noise(rng, 16, 16, 3)
    )

"""Furniture, household goods and people of boxes, cylinders, capsules and ellipsoids.

Every maker fills a :class:`~eldenet.simulation.mjcf.Body` within its footprint ``width`` x ``depth`` [m],
centred on the body's origin, back at ``y = -depth / 2``, front towards +y, and returns the surfaces on
which things may stand.
"""

from collections.abc import Callable
from typing import NamedTuple

from eldenet.simulation.materials import Materials
from eldenet.simulation.mjcf import Body, Draw


class Surface(NamedTuple):
    """A level place for clutter: centre, height and extents in the body's frame [m]."""

    x: float
    y: float
    z: float
    wx: float
    wy: float


Maker = Callable[[Draw, Materials, Body, float, float], list[Surface]]


def _legs(d: Draw, b: Body, width: float, depth: float, height: float, material: int) -> None:
    thick = d.uniform(0.03, 0.08)
    x, y = width / 2 - thick, depth / 2 - thick
    round_legs = d.chance(0.4)
    for sx in (-1, 1):
        for sy in (-1, 1):
            if round_legs:
                b.cylinder(sx * x, sy * y, 0, thick / 2, height, material)
            else:
                b.box(sx * x, sy * y, 0, thick, thick, height, material)


def table(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Dining table, desk or bench, on legs or on panels."""
    height, top = d.uniform(0.68, 0.78), d.pick((*m.woods, m.white, m.stone))
    thick = d.uniform(0.02, 0.06)
    b.box(0, 0, height - thick, width, depth, thick, top)
    if d.chance(0.25):
        for s in (-1, 1):
            b.box(s * (width / 2 - 0.03), 0, 0, 0.04, depth * 0.9, height - thick, top)
    else:
        _legs(d, b, width, depth, height - thick, d.pick((m.woods[0], m.metal, m.dark)))
    if d.chance(0.3):
        b.box(0, -depth * 0.3, height - 0.18, width * 0.8, 0.03, 0.12, top)
    return [Surface(0, 0, height, width, depth)]


def round_table(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Round table on a column."""
    height, radius = d.uniform(0.45, 0.78), min(width, depth) / 2
    b.cylinder(0, 0, height - 0.04, radius, 0.04, d.pick((*m.woods, m.white)))
    b.cylinder(0, 0, 0.03, d.uniform(0.03, 0.07), height - 0.06, m.metal)
    b.cylinder(0, 0, 0, radius * 0.5, 0.03, m.metal)
    return [Surface(0, 0, height, radius * 1.3, radius * 1.3)]


def coffee_table(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Low table, often with a lower board."""
    height, top = d.uniform(0.32, 0.5), d.pick((*m.woods, m.dark, m.white))
    b.box(0, 0, height - 0.04, width, depth, 0.04, top)
    _legs(d, b, width, depth, height - 0.04, top)
    if d.chance(0.5):
        b.box(0, 0, 0.12, width * 0.9, depth * 0.9, 0.02, top)
    return [Surface(0, 0, height, width, depth)]


def chair(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Chair with slats or a full back; its back stands at -y."""
    seat, top = d.uniform(0.42, 0.48), d.uniform(0.78, 1.05)
    frame, cover = d.pick((*m.woods, m.metal, m.dark)), d.pick((*m.fabrics, *m.woods, *m.colors[:3]))
    _legs(d, b, width, depth, seat, frame)
    b.box(0, 0, seat, width, depth, d.uniform(0.03, 0.09), cover)
    y = -depth / 2 + 0.02
    if d.chance(0.5):
        b.box(0, y, seat + 0.12, width, 0.04, top - seat - 0.12, cover)
    else:
        for s in (-1, 1):
            b.box(s * (width / 2 - 0.02), y, seat, 0.035, 0.035, top - seat, frame)
        for k in range(d.integer(1, 3)):
            b.box(0, y, seat + 0.12 + 0.14 * k, width - 0.06, 0.025, 0.07, frame)
    return []


def office_chair(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Swivel chair on a star base."""
    cover = d.pick((m.dark, *m.fabrics))
    b.box(0, 0, 0.05, width * 1.1, 0.06, 0.04, m.dark)
    b.box(0, 0, 0.05, 0.06, depth * 1.1, 0.04, m.dark)
    b.cylinder(0, 0, 0.08, 0.03, 0.36, m.metal)
    b.ellipsoid(0, 0.02, 0.48, width * 0.52, depth * 0.52, 0.06, cover)
    b.box(0, -depth * 0.48, 0.58, width * 0.85, 0.07, d.uniform(0.35, 0.65), cover, euler=(d.uniform(2, 12), 0, 0))
    if d.chance(0.6):
        for s in (-1, 1):
            b.box(s * width * 0.52, 0, 0.64, 0.05, depth * 0.55, 0.03, m.dark)
    return []


def stool(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Stool, bar stool or pouffe."""
    height, radius = d.pick((0.42, 0.46, 0.65, 0.74)), min(width, depth) / 2
    if height < 0.45 and d.chance(0.5):
        b.cylinder(0, 0, 0, radius, height, d.pick(m.fabrics))
    else:
        b.cylinder(0, 0, height - 0.05, radius * 0.9, 0.05, d.pick((*m.fabrics, *m.woods)))
        for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            b.limb((sx * radius * 0.8, sy * radius * 0.8, 0.02), (sx * radius * 0.5, sy * radius * 0.5, height - 0.05), 0.015, m.metal)
    return []


def sofa(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Sofa or armchair with cushions."""
    cover = d.pick(m.fabrics)
    seat, arm, back = d.uniform(0.38, 0.46), d.uniform(0.1, 0.24), d.uniform(0.72, 0.95)
    inner = width - 2 * arm
    count = max(1, round(inner / 0.65))
    b.box(0, 0, 0.06, width, depth, seat - 0.2, cover)
    b.box(0, -depth / 2 + 0.12, 0.06, width, 0.24, back - 0.12, cover)
    for s in (-1, 1):
        b.box(s * (width - arm) / 2, 0.02, 0.06, arm, depth - 0.02, d.uniform(0.5, 0.62), cover)
    for k in range(count):
        x = (k + 0.5) * inner / count - inner / 2
        b.box(x, 0.1, seat - 0.14, inner / count - 0.015, depth - 0.26, 0.16, cover)
        b.box(x, -depth / 2 + 0.3, seat, inner / count - 0.03, 0.16, back - seat, cover, euler=(d.uniform(6, 16), 0, 0))
    for _ in range(d.integer(0, 3)):
        b.box(
            d.uniform(-inner / 2 + 0.2, inner / 2 - 0.2), 0.02, seat + 0.02, 0.42, 0.13, 0.4, d.pick((*m.fabrics, *m.clothes)),
            euler=(d.uniform(10, 35), d.uniform(-20, 20), 0),
        )  # fmt: skip
    return [Surface(0, 0.15, seat + 0.02, inner, depth * 0.4)] if d.chance(0.3) else []


def bed(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Bed with head board, cover and pillows."""
    frame, cover, top = d.pick((*m.woods, m.dark, m.fabrics[0])), d.pick(m.beddings), d.uniform(0.42, 0.65)
    b.box(0, -depth / 2 + 0.03, 0, width, 0.06, d.uniform(0.7, 1.25), frame)
    b.box(0, 0.02, 0.12, width, depth - 0.06, 0.18, frame)
    b.box(0, 0.02, 0.3, width - 0.04, depth - 0.1, top - 0.34, m.white)
    length = depth * d.uniform(0.55, 0.95)
    b.box(0, depth / 2 - length / 2, 0.24, width + 0.05, length, top - 0.22, cover)
    if d.chance(0.4):
        b.box(0, depth / 2 - 0.04, 0, width, 0.06, d.uniform(0.4, 0.8), frame)
    count = 1 if width < 1.1 else d.integer(2, 4)
    for k in range(count):
        x = ((k + 0.5) / count - 0.5) * width * 0.9
        pillow = d.pick((m.white, *m.beddings, *m.fabrics))
        b.ellipsoid(x, -depth / 2 + d.uniform(0.22, 0.4), top + 0.08, 0.9 * width / count / 2, 0.2, 0.1, pillow, euler=(d.uniform(-35, 0), 0, d.uniform(-10, 10)))
    for _ in range(d.integer(0, 3)):
        b.ellipsoid(d.uniform(-0.4, 0.4) * width, d.uniform(-0.1, 0.4) * depth, top, d.uniform(0.2, 0.5), d.uniform(0.15, 0.4), d.uniform(0.04, 0.14), d.pick((*m.beddings, *m.clothes)), euler=(0, 0, d.uniform(0, 180)))
    return [Surface(0, 0.2, top + 0.02, width * 0.8, depth * 0.5)] if d.chance(0.5) else []


def cabinet(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Chest of drawers, sideboard, night table, cupboard of any height."""
    height = d.uniform(0.45, 0.65) if width < 0.6 else d.pick((0.55, 0.75, 0.85, 0.95, 1.2, 1.4))
    carcass, front = d.pick((*m.woods, m.white)), d.pick(m.fronts)
    base = d.pick((0.0, 0.05, 0.12))
    if base > 0.1:
        _legs(d, b, width, depth, base, carcass)
    b.box(0, -0.01, base, width, depth - 0.02, height - base, carcass)
    b.box(0, depth / 2 - 0.01, base + 0.02, width - 0.02, 0.025, height - base - 0.05, front)
    b.box(0, 0, height, width + 0.03, depth + 0.02, 0.025, d.pick((carcass, m.stone, m.woods[1])))
    return [Surface(0, 0, height + 0.025, width, depth)]


def wardrobe(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Tall closet, fridge or locker."""
    height = d.uniform(1.7, 2.3)
    if width < 0.75 and d.chance(0.6):
        body = d.pick((m.white, m.metal, m.dark))
        b.box(0, 0, 0.03, width, depth, height - 0.3, body)
        b.box(0, depth / 2, height * 0.6, width - 0.01, 0.05, height * 0.4 - 0.28, body)
        b.box(0, depth / 2, 0.06, width - 0.01, 0.05, height * 0.6 - 0.08, body)
        b.limb((-width * 0.4, depth / 2 + 0.06, height * 0.35), (-width * 0.4, depth / 2 + 0.06, height * 0.57), 0.012, m.metal)
        return []
    b.box(0, -0.01, 0, width, depth - 0.02, height, d.pick(m.woods))
    b.box(0, depth / 2 - 0.01, 0.06, width - 0.03, 0.03, height - 0.1, d.pick(m.fronts))
    return [Surface(0, 0, height, width * 0.9, depth * 0.8)]


def shelf(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Bookcase or storage rack, filled."""
    height, board = d.pick((0.85, 1.2, 1.6, 1.9, 2.1)), d.pick((*m.woods, m.white, m.metal))
    levels = max(2, round(height / d.uniform(0.3, 0.45)))
    gap = height / levels
    for s in (-1, 1):
        b.box(s * (width / 2 - 0.012), 0, 0, 0.025, depth, height, board)
    if d.chance(0.7):
        b.box(0, -depth / 2 + 0.008, 0, width, 0.015, height, board)
    for k in range(levels + 1):
        b.box(0, 0, k * gap - (0.025 if k == levels else 0), width - 0.04, depth, 0.025, board)
    for k in range(levels):
        z, style = k * gap + 0.025, d.unit()
        if style < 0.45:  # a row of books: one box whose front is printed, a little shorter than the gap
            length = (width - 0.08) * d.uniform(0.4, 1.0)
            x = d.sign() * (width - 0.06 - length) / 2
            b.box(x, d.uniform(-0.03, 0.02), z, length, depth * 0.75, gap * d.uniform(0.55, 0.85), d.pick(m.books))
        if style > 0.3:
            for _ in range(d.integer(0, 3)):
                w, h = d.uniform(0.05, 0.3) * width, gap * d.uniform(0.3, 0.85)
                b.box(d.uniform(-0.5, 0.5) * (width - 0.08 - w), 0.02, z, w, depth * d.uniform(0.4, 0.8), h, d.pick((*m.colors, *m.papers)))
    return [Surface(0, 0, height, width, depth)] if height < 1.7 else []


def counter(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Kitchen run: lower cabinets, stone top, sink or stove, upper cabinets, splash back."""
    front, height = m.fronts[0], 0.88
    b.box(0, -0.02, 0.0, width, depth - 0.08, height - 0.03, m.woods[0])
    step = d.uniform(0.5, 0.8)
    count = max(1, round(width / step))
    for k in range(count):
        x = ((k + 0.5) / count - 0.5) * width
        special = d.chance(0.25)
        b.box(x, depth / 2 - 0.04, 0.1, width / count - 0.015, 0.03, height - 0.14, d.pick(m.appliances) if special else front)
    b.box(0, 0, height, width + 0.02, depth + 0.02, 0.04, d.pick((m.stone, m.woods[1], m.white)))
    b.box(0, -depth / 2 + 0.01, height + 0.04, width, 0.02, d.uniform(0.05, 0.5), d.pick((m.stone, m.walls[1], m.white)))
    x = d.uniform(-0.3, 0.3) * width
    if d.chance(0.6):
        b.box(x, 0.02, height + 0.035, 0.5, 0.38, 0.012, m.metal)
        b.limb((x, -0.2, height), (x, -0.2, height + 0.25), 0.015, m.metal)
        b.limb((x, -0.2, height + 0.25), (x, -0.02, height + 0.22), 0.013, m.metal)
    else:
        for k in range(4):
            b.cylinder(x + (k % 2 - 0.5) * 0.28, (k // 2 - 0.5) * 0.26, height + 0.04, 0.09, 0.012, m.dark)
    if d.chance(0.7):
        upper = d.uniform(0.6, 0.85)
        for k in range(count):
            if d.chance(0.85):
                xk = ((k + 0.5) / count - 0.5) * width
                b.box(xk, -depth / 2 + 0.17, 1.4, width / count - 0.01, 0.34, upper, front)
    return [Surface(0, 0.05, height + 0.04, width, depth * 0.7)]


def sink(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Wash stand with basin, tap and mirror."""
    height = d.uniform(0.78, 0.88)
    if d.chance(0.6):
        b.box(0, 0, 0, width, depth - 0.04, height - 0.04, d.pick(m.fronts))
    else:
        b.cylinder(0, 0, 0, 0.09, height - 0.04, m.white)
    b.box(0, 0, height - 0.04, width, depth, 0.04, d.pick((m.white, m.stone)))
    b.ellipsoid(0, 0.03, height, min(0.24, width * 0.4), depth * 0.36, 0.012, m.white)
    b.limb((0, -depth * 0.36, height), (0, -depth * 0.36, height + 0.16), 0.014, m.metal)
    b.limb((0, -depth * 0.36, height + 0.16), (0, -depth * 0.1, height + 0.13), 0.012, m.metal)
    b.box(0, -depth / 2 + 0.01, height + 0.25, width * d.uniform(0.6, 1.1), 0.02, d.uniform(0.5, 0.9), d.pick((m.pictures[0], m.walls[0], m.metal)))
    return [Surface(0, -0.05, height, width, depth * 0.8)]


def toilet(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Toilet with cistern."""
    b.box(0, -depth / 2 + 0.09, 0.38, width, 0.18, 0.38, m.white)
    b.cylinder(0, 0.02, 0, 0.12, 0.3, m.white)
    b.ellipsoid(0, 0.08, 0.34, 0.18, depth * 0.38, 0.1, m.white)
    b.ellipsoid(0, 0.08, 0.42, 0.19, depth * 0.38, 0.02, d.pick((m.white, m.woods[0])))
    if d.chance(0.4):
        b.box(0, -depth * 0.25, 0.44, width * 0.8, 0.04, 0.38, m.white, euler=(10, 0, 0))
    return [Surface(0, -depth / 2 + 0.09, 0.76, width * 0.8, 0.14)]


def bathtub(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Tub with a rim, often behind a curtain."""
    height = d.uniform(0.45, 0.58)
    b.box(0, 0, 0, width, depth, height - 0.2, m.white)
    for s in (-1, 1):
        b.box(0, s * (depth / 2 - 0.04), height - 0.2, width, 0.08, 0.2, m.white)
        b.box(s * (width / 2 - 0.05), 0, height - 0.2, 0.1, depth, 0.2, m.white)
    if d.chance(0.5):
        w = width * d.uniform(0.3, 0.9)
        b.box(d.sign() * (width - w) / 2, depth / 2 - 0.03, 0.2, w, 0.05, 1.75, m.curtain)
        b.limb((-width / 2, depth / 2 - 0.03, 1.97), (width / 2, depth / 2 - 0.03, 1.97), 0.015, m.metal)
    return [Surface(0, -depth / 2 + 0.05, height, width * 0.8, 0.06)]


def desk(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Desk with screens, keyboard, drawers."""
    surfaces = table(d, m, b, width, depth)
    z = surfaces[0].z
    if d.chance(0.7):
        b.box(d.sign() * (width / 2 - 0.25), 0.02, 0.02, 0.4, depth * 0.85, z - 0.12, d.pick(m.fronts))
    for _ in range(d.integer(0, 2)):
        x, w = d.uniform(-0.3, 0.3) * width, d.uniform(0.4, 0.62)
        b.box(x, -depth * 0.22, z, 0.22, 0.16, 0.015, m.dark)
        b.box(x, -depth * 0.26, z, 0.05, 0.03, 0.2, m.dark)
        b.box(x, -depth * 0.24, z + 0.12, w, 0.03, w * 0.6, m.dark)
        b.box(x, -depth * 0.24 + 0.016, z + 0.135, w - 0.03, 0.004, w * 0.6 - 0.03, m.screen)
        b.box(x + d.uniform(-0.1, 0.1), depth * 0.18, z, 0.42, 0.14, 0.02, m.dark)
    return surfaces


def tv_stand(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Low board with a television."""
    height, size = d.uniform(0.4, 0.6), width * d.uniform(0.5, 0.85)
    b.box(0, 0, 0, width, depth, height, d.pick(m.woods))
    b.box(0, depth / 2, 0.03, width - 0.04, 0.02, height - 0.06, d.pick((*m.fronts, m.books[0])))
    b.box(0, 0, height, 0.3, 0.2, 0.06, m.dark)
    b.box(0, 0, height + 0.05, size, 0.05, size * 0.58, m.dark)
    b.box(0, 0.026, height + 0.08, size - 0.05, 0.004, size * 0.58 - 0.06, m.screen)
    return [Surface(-width * 0.4, 0, height, width * 0.15, depth)]


def lamp(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Floor lamp."""
    height = d.uniform(1.2, 1.8)
    b.cylinder(0, 0, 0, 0.14, 0.03, m.dark)
    b.cylinder(0, 0, 0.03, 0.015, height - 0.25, m.metal)
    b.cylinder(0, 0, height - 0.25, d.uniform(0.12, 0.24), 0.28, m.shade)
    return []


def plant(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Pot plant."""
    pot = d.uniform(0.18, 0.4)
    b.cylinder(0, 0, 0, width * 0.28, pot, d.pick(m.colors))
    b.cylinder(0, 0, pot, 0.02, 0.3, m.woods[0])
    for _ in range(d.integer(4, 9)):
        b.ellipsoid(
            d.uniform(-0.3, 0.3) * width, d.uniform(-0.3, 0.3) * depth, pot + d.uniform(0.15, 0.9),
            d.uniform(0.08, 0.25), d.uniform(0.04, 0.1), d.uniform(0.05, 0.25), m.leaves,
            euler=(d.uniform(-60, 60), d.uniform(-60, 60), d.uniform(0, 180)),
        )  # fmt: skip
    return []


def basket(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Bin, basket, carton, stack of boxes, suitcase."""
    style = d.integer(0, 3)
    if style == 0:
        b.cylinder(0, 0, 0, width * 0.42, d.uniform(0.25, 0.6), d.pick((*m.colors, m.metal, m.dark)))
    elif style == 1:
        z = 0.0
        for k in range(d.integer(1, 3)):
            h = d.uniform(0.15, 0.4)
            b.box(d.uniform(-0.04, 0.04), 0, z, width * d.uniform(0.7, 1), depth * d.uniform(0.7, 1), h, d.pick((*m.colors, *m.woods)), euler=(0, 0, d.uniform(-15, 15)))
            z += h
    elif style == 2:
        b.box(0, 0, 0, width, depth * 0.5, d.uniform(0.4, 0.7), d.pick((*m.colors, *m.fabrics)))
    else:
        for _ in range(d.integer(2, 5)):
            b.ellipsoid(d.uniform(-0.1, 0.1), d.uniform(-0.1, 0.1), d.uniform(0.05, 0.3), 0.22, 0.2, d.uniform(0.06, 0.15), d.pick((*m.clothes, *m.fabrics)), euler=(d.uniform(-20, 20), d.uniform(-20, 20), 0))
    return []


def person(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """A standing person of capsules, facing +y."""
    h = d.uniform(1.45, 1.95) / 1.75
    shirt, trousers = d.pick(m.clothes), d.pick((*m.clothes, m.dark))
    stride = d.uniform(-0.18, 0.18)
    for s in (-1, 1):
        knee = (s * 0.1 * h, s * stride * 0.5, 0.48 * h)
        b.limb((s * 0.11 * h, s * stride, 0.08), knee, 0.065 * h, trousers)
        b.limb(knee, (s * 0.09 * h, 0, 0.92 * h), 0.085 * h, trousers)
        b.box(s * 0.11 * h, s * stride + 0.06, 0, 0.1, 0.26, 0.08, m.dark)
        reach, lift = d.uniform(-0.1, 0.3), d.uniform(0.0, 0.3)
        elbow = (s * 0.28 * h, reach * 0.3, 1.12 * h)
        b.limb((s * 0.22 * h, 0, 1.38 * h), elbow, 0.052 * h, shirt)
        b.limb(elbow, (s * 0.24 * h, reach, (0.88 + lift) * h), 0.042 * h, d.pick((m.skin, shirt)))
    b.limb((0, 0, 1.0 * h), (0, 0, 1.3 * h), 0.155 * h, shirt)
    b.limb((-0.13 * h, 0, 1.36 * h), (0.13 * h, 0, 1.36 * h), 0.085 * h, shirt)
    b.cylinder(0, 0, 1.4 * h, 0.055 * h, 0.14 * h, m.skin)
    b.ellipsoid(0, 0.01, 1.62 * h, 0.08 * h, 0.1 * h, 0.12 * h, m.skin)
    b.ellipsoid(0, -0.02, 1.66 * h, 0.088 * h, 0.1 * h, 0.1 * h, m.hair)
    return []


def rack(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Clothes rack or coat stand."""
    height = d.uniform(1.3, 1.7)
    for s in (-1, 1):
        b.limb((s * width / 2, 0, 0.03), (s * width / 2, 0, height), 0.015, m.metal)
        b.box(s * width / 2, 0, 0, 0.04, depth, 0.03, m.metal)
    b.limb((-width / 2, 0, height), (width / 2, 0, height), 0.015, m.metal)
    x = -width / 2 + 0.1
    while x < width / 2 - 0.1:
        thick = d.uniform(0.05, 0.14)
        length = d.uniform(0.55, 1.05)
        b.box(x, 0, height - length, thick, depth * d.uniform(0.7, 1.0), length - 0.03, d.pick((*m.clothes, *m.colors)))
        x += thick + d.uniform(0.01, 0.1)
    return []


def clutter(d: Draw, m: Materials, b: Body, surface: Surface, amount: float) -> None:
    """Set bottles, cups, books, boxes, papers, bowls, table lamps on a surface."""
    area = surface.wx * surface.wy
    count = min(9, int(amount * d.uniform(2.0, 9.0) * min(1.0, area + 0.25)))
    for _ in range(count):
        x = surface.x + d.uniform(-0.46, 0.46) * surface.wx
        y = surface.y + d.uniform(-0.4, 0.4) * surface.wy
        thing(d, m, b, x, y, surface.z)


def thing(d: Draw, m: Materials, b: Body, x: float, y: float, z: float) -> None:
    """One small object that stands at (x, y, z)."""
    style, color, turn = d.integer(0, 8), d.pick((*m.colors, m.white, m.metal)), (0.0, 0.0, d.uniform(0, 180))
    if style <= 1:
        b.box(x, y, z, d.uniform(0.06, 0.3), d.uniform(0.05, 0.22), d.uniform(0.04, 0.3), color, euler=turn)
    elif style == 2:
        b.cylinder(x, y, z, d.uniform(0.025, 0.05), d.uniform(0.07, 0.14), color)
    elif style == 3:
        r, h = d.uniform(0.025, 0.06), d.uniform(0.12, 0.26)
        b.cylinder(x, y, z, r, h, color)
        b.cylinder(x, y, z + h, r * 0.4, h * 0.35, d.pick((color, m.white, m.dark)))
    elif style == 4:
        b.box(x, y, z, d.uniform(0.15, 0.3), d.uniform(0.12, 0.22), 0.004, d.pick(m.papers), euler=turn)
    elif style == 5:
        for k in range(d.integer(1, 4)):
            b.box(x, y, z + 0.035 * k, d.uniform(0.14, 0.24), d.uniform(0.1, 0.18), 0.033, d.pick(m.colors), euler=(0, 0, d.uniform(0, 90)))
    elif style == 6:
        b.ellipsoid(x, y, z + 0.04, d.uniform(0.05, 0.16), d.uniform(0.05, 0.16), 0.05, color)
    elif style == 7:
        r = d.uniform(0.04, 0.1)
        b.cylinder(x, y, z, r, d.uniform(0.08, 0.25), color)
        if d.chance(0.5):
            b.ellipsoid(x, y, z + 0.28, r * 1.6, r * 1.6, 0.12, m.leaves)
    else:
        b.cylinder(x, y, z, 0.06, 0.02, m.dark)
        b.cylinder(x, y, z + 0.02, 0.015, 0.2, m.metal)
        b.cylinder(x, y, z + 0.2, d.uniform(0.08, 0.15), 0.18, m.shade)

"""Tables, seats, beds and storage of boxes, cylinders, capsules and ellipsoids.

Every maker fills a :class:`~.rendering.mjcf.Body` on a footprint of about ``width`` x ``depth`` [m], centered
on the body's origin with its back at ``y = -depth / 2``, and returns the surfaces that clutter may stand on.
"""

from collections.abc import Callable
from typing import NamedTuple

from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Body, Draw


class Surface(NamedTuple):
    """A level place for clutter: center, height and extents in the body's frame [m]."""

    x: float
    y: float
    z: float
    wx: float
    wy: float


Maker = Callable[[Draw, Materials, Body, float, float], list[Surface]]


def legs(d: Draw, b: Body, width: float, depth: float, height: float, material: int) -> None:
    """Four legs, square or round."""
    thick = d.uniform(0.03, 0.08)
    x, y = width / 2 - thick, depth / 2 - thick
    round_legs = d.chance(0.4)
    for sx in (-1, 1):
        for sy in (-1, 1):
            if round_legs:
                b.cylinder((sx * x, sy * y, 0), thick / 2, height, material)
            else:
                b.box((sx * x, sy * y, 0), (thick, thick, height), material)


def table(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Dining table, desk or bench, on legs or on panels."""
    height, top = d.uniform(0.68, 0.78), d.pick((*m.woods, m.white, m.stone))
    thick = d.uniform(0.02, 0.06)
    b.box((0, 0, height - thick), (width, depth, thick), top)
    if d.chance(0.12):  # a cloth that hangs down
        drop = d.uniform(0.2, 0.6)
        b.box((0, 0, height - drop), (width + 0.02, depth + 0.02, drop + 0.005), d.pick(m.beddings))
    if d.chance(0.25):
        for s in (-1, 1):
            b.box((s * (width / 2 - 0.03), 0, 0), (0.04, depth * 0.9, height - thick), top)
    else:
        legs(d, b, width, depth, height - thick, d.pick((m.woods[0], m.metal, m.dark)))
    if d.chance(0.3):
        b.box((0, -depth * 0.3, height - 0.18), (width * 0.8, 0.03, 0.12), top)
    return [Surface(0, 0, height, width, depth)]


def round_table(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Round table on a column."""
    height, radius = d.uniform(0.45, 0.78), min(width, depth) / 2
    b.cylinder((0, 0, height - 0.04), radius, 0.04, d.pick((*m.woods, m.white)))
    b.cylinder((0, 0, 0.03), d.uniform(0.03, 0.07), height - 0.06, m.metal)
    b.cylinder((0, 0, 0), radius * 0.5, 0.03, m.metal)
    return [Surface(0, 0, height, radius * 1.3, radius * 1.3)]


def coffee_table(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Low table, often with a lower board."""
    height, top = d.uniform(0.32, 0.5), d.pick((*m.woods, m.dark, m.white))
    b.box((0, 0, height - 0.04), (width, depth, 0.04), top)
    legs(d, b, width, depth, height - 0.04, top)
    if d.chance(0.5):
        b.box((0, 0, 0.12), (width * 0.9, depth * 0.9, 0.02), top)
    return [Surface(0, 0, height, width, depth)]


def crib(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Crib, railing, drying rack, banister: bars."""
    height, frame = d.uniform(0.75, 1.05), d.pick((*m.woods, m.white, m.metal))
    low = d.uniform(0.05, 0.3)
    for s in (-1, 1):
        y = s * (depth / 2 - 0.02)
        b.box((0, y, height - 0.04), (width, 0.035, 0.04), frame)
        b.box((0, y, low), (width, 0.035, 0.04), frame)
        count = round(width / 0.12)
        for k in range(count + 1):
            b.box(((k / count - 0.5) * (width - 0.03), y, low), (0.022, 0.022, height - low - 0.02), frame)
        b.box((s * (width / 2 - 0.02), 0, 0), (0.04, depth, height if d.chance(0.5) else low), frame)
    if d.chance(0.7):
        b.box((0, 0, low + 0.05), (width - 0.08, depth - 0.08, 0.12), d.pick(m.beddings))
    return []


def bed(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Bed with headboard, cover and pillows."""
    frame, cover, top = d.pick((*m.woods, m.dark, m.fabrics[0])), d.pick(m.beddings), d.uniform(0.42, 0.65)
    b.box((0, -depth / 2 + 0.03, 0), (width, 0.06, d.uniform(0.7, 1.25)), frame)
    b.box((0, 0.02, 0.12), (width, depth - 0.06, 0.18), frame)
    b.box((0, 0.02, 0.3), (width - 0.04, depth - 0.1, top - 0.34), m.white)
    length = depth * d.uniform(0.55, 0.95)
    b.box((0, depth / 2 - length / 2, 0.24), (width + 0.05, length, top - 0.22), cover)
    if d.chance(0.4):
        b.box((0, depth / 2 - 0.04, 0), (width, 0.06, d.uniform(0.4, 0.8)), frame)
    count = 1 if width < 1.1 else d.integer(2, 4)
    for k in range(count):
        x = ((k + 0.5) / count - 0.5) * width * 0.9
        pillow = d.pick((m.white, *m.beddings, *m.fabrics))
        b.ellipsoid(
            (x, -depth / 2 + d.uniform(0.22, 0.4), top + 0.08),
            (0.9 * width / count / 2, 0.2, 0.1),
            pillow,
            euler=(d.uniform(-35, 0), 0, d.uniform(-10, 10)),
        )
    for _ in range(d.integer(0, 3)):
        b.ellipsoid(
            (d.uniform(-0.4, 0.4) * width, d.uniform(-0.1, 0.4) * depth, top),
            (d.uniform(0.2, 0.5), d.uniform(0.15, 0.4), d.uniform(0.04, 0.14)),
            d.pick((*m.beddings, *m.clothes)),
            euler=(0, 0, d.uniform(0, 180)),
        )
    return [Surface(0, 0.2, top + 0.02, width * 0.8, depth * 0.5)] if d.chance(0.5) else []


def cabinet(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Chest of drawers, sideboard, nightstand, cupboard of any height."""
    height = d.uniform(0.45, 0.65) if width < 0.6 else d.pick((0.55, 0.75, 0.85, 0.95, 1.2, 1.4))
    carcass, front = d.pick((*m.woods, m.white)), d.pick(m.fronts)
    base = d.pick((0.0, 0.05, 0.12))
    if base > 0.1:
        legs(d, b, width, depth, base, carcass)
    b.box((0, -0.01, base), (width, depth - 0.02, height - base), carcass)
    b.box((0, depth / 2 - 0.01, base + 0.02), (width - 0.02, 0.025, height - base - 0.05), front)
    b.box((0, 0, height), (width + 0.03, depth + 0.02, 0.025), d.pick((carcass, m.stone, m.woods[1])))
    return [Surface(0, 0, height + 0.025, width, depth)]


def wardrobe(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Tall closet, fridge or locker."""
    height = d.uniform(1.7, 2.3)
    if width < 0.75 and d.chance(0.6):
        body = d.pick((m.white, m.metal, m.dark))
        b.box((0, 0, 0.03), (width, depth, height - 0.3), body)
        b.box((0, depth / 2, height * 0.6), (width - 0.01, 0.05, height * 0.4 - 0.28), body)
        b.box((0, depth / 2, 0.06), (width - 0.01, 0.05, height * 0.6 - 0.08), body)
        b.limb(
            (-width * 0.4, depth / 2 + 0.06, height * 0.35),
            (-width * 0.4, depth / 2 + 0.06, height * 0.57),
            0.012,
            m.metal,
        )
        return []
    b.box((0, -0.01, 0), (width, depth - 0.02, height), d.pick(m.woods))
    b.box((0, depth / 2 - 0.01, 0.06), (width - 0.03, 0.03, height - 0.1), d.pick(m.fronts))
    return [Surface(0, 0, height, width * 0.9, depth * 0.8)]


def shelf(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Bookcase or storage rack, filled."""
    height, board = d.pick((0.85, 1.2, 1.6, 1.9, 2.1)), d.pick((*m.woods, m.white, m.metal))
    levels = max(2, round(height / d.uniform(0.3, 0.45)))
    gap = height / levels
    for s in (-1, 1):
        b.box((s * (width / 2 - 0.012), 0, 0), (0.025, depth, height), board)
    if d.chance(0.7):
        b.box((0, -depth / 2 + 0.008, 0), (width, 0.015, height), board)
    for k in range(levels + 1):
        b.box((0, 0, k * gap - (0.025 if k == levels else 0)), (width - 0.04, depth, 0.025), board)
    for k in range(levels):
        z, style = k * gap + 0.025, d.unit()
        if style < 0.45:  # a row of books: one box whose front is printed, a little shorter than the gap
            length = (width - 0.08) * d.uniform(0.4, 1.0)
            x = d.sign() * (width - 0.06 - length) / 2
            b.box(
                (x, d.uniform(-0.03, 0.02), z),
                (length, depth * 0.75, gap * d.uniform(0.55, 0.85)),
                d.pick(m.books),
            )
        if style > 0.3:
            for _ in range(d.integer(0, 3)):
                w, h = d.uniform(0.05, 0.3) * width, gap * d.uniform(0.3, 0.85)
                b.box(
                    (d.uniform(-0.5, 0.5) * (width - 0.08 - w), 0.02, z),
                    (w, depth * d.uniform(0.4, 0.8), h),
                    d.pick((*m.colors, *m.papers)),
                )
    return [Surface(0, 0, height, width, depth)] if height < 1.7 else []


def desk(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Desk with screens, keyboard, drawers."""
    surfaces = table(d, m, b, width, depth)
    z = surfaces[0].z
    if d.chance(0.7):
        b.box((d.sign() * (width / 2 - 0.25), 0.02, 0.02), (0.4, depth * 0.85, z - 0.12), d.pick(m.fronts))
    for _ in range(d.integer(0, 2)):
        x, w = d.uniform(-0.3, 0.3) * width, d.uniform(0.4, 0.62)
        b.box((x, -depth * 0.22, z), (0.22, 0.16, 0.015), m.dark)
        b.box((x, -depth * 0.26, z), (0.05, 0.03, 0.2), m.dark)
        b.box((x, -depth * 0.24, z + 0.12), (w, 0.03, w * 0.6), m.dark)
        b.box((x, -depth * 0.24 + 0.016, z + 0.135), (w - 0.03, 0.004, w * 0.6 - 0.03), m.screen)
        b.box((x + d.uniform(-0.1, 0.1), depth * 0.18, z), (0.42, 0.14, 0.02), m.dark)
    return surfaces


def chair(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Chair with slats or a full back; its back stands at -y."""
    seat, top = d.uniform(0.42, 0.48), d.uniform(0.78, 1.05)
    frame, cover = d.pick((*m.woods, m.metal, m.dark)), d.pick((*m.fabrics, *m.woods, *m.colors[:3]))
    legs(d, b, width, depth, seat, frame)
    b.box((0, 0, seat), (width, depth, d.uniform(0.03, 0.09)), cover)
    y = -depth / 2 + 0.02
    if d.chance(0.5):
        b.box((0, y, seat + 0.12), (width, 0.04, top - seat - 0.12), cover)
    else:
        for s in (-1, 1):
            b.box((s * (width / 2 - 0.02), y, seat), (0.035, 0.035, top - seat), frame)
        for k in range(d.integer(1, 3)):
            b.box((0, y, seat + 0.12 + 0.14 * k), (width - 0.06, 0.025, 0.07), frame)
    return []


def office_chair(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Swivel chair on a star base."""
    cover = d.pick((m.dark, *m.fabrics))
    b.box((0, 0, 0.05), (width * 1.1, 0.06, 0.04), m.dark)
    b.box((0, 0, 0.05), (0.06, depth * 1.1, 0.04), m.dark)
    b.cylinder((0, 0, 0.08), 0.03, 0.36, m.metal)
    b.ellipsoid((0, 0.02, 0.48), (width * 0.52, depth * 0.52, 0.06), cover)
    b.box(
        (0, -depth * 0.48, 0.58),
        (width * 0.85, 0.07, d.uniform(0.35, 0.65)),
        cover,
        euler=(d.uniform(2, 12), 0, 0),
    )
    if d.chance(0.6):
        for s in (-1, 1):
            b.box((s * width * 0.52, 0, 0.64), (0.05, depth * 0.55, 0.03), m.dark)
    return []


def stool(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Stool, bar stool or pouffe."""
    height, radius = d.pick((0.42, 0.46, 0.65, 0.74)), min(width, depth) / 2
    if height < 0.45 and d.chance(0.5):
        b.cylinder((0, 0, 0), radius, height, d.pick(m.fabrics))
    else:
        b.cylinder((0, 0, height - 0.05), radius * 0.9, 0.05, d.pick((*m.fabrics, *m.woods)))
        for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            b.limb(
                (sx * radius * 0.8, sy * radius * 0.8, 0.02),
                (sx * radius * 0.5, sy * radius * 0.5, height - 0.05),
                0.015,
                m.metal,
            )
    return []


def sofa(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Sofa or armchair with cushions."""
    if d.chance(0.4):
        return _round_sofa(d, m, b, width, depth)
    cover = d.pick(m.fabrics)
    seat, arm, back = d.uniform(0.38, 0.46), d.uniform(0.1, 0.24), d.uniform(0.72, 0.95)
    inner = width - 2 * arm
    count = max(1, round(inner / 0.65))
    b.box((0, 0, 0.06), (width, depth, seat - 0.2), cover)
    b.box((0, -depth / 2 + 0.12, 0.06), (width, 0.24, back - 0.12), cover)
    for s in (-1, 1):
        b.box((s * (width - arm) / 2, 0.02, 0.06), (arm, depth - 0.02, d.uniform(0.5, 0.62)), cover)
    for k in range(count):
        x = (k + 0.5) * inner / count - inner / 2
        b.box((x, 0.1, seat - 0.14), (inner / count - 0.015, depth - 0.26, 0.16), cover)
        b.box(
            (x, -depth / 2 + 0.3, seat),
            (inner / count - 0.03, 0.16, back - seat),
            cover,
            euler=(d.uniform(6, 16), 0, 0),
        )
    for _ in range(d.integer(0, 3)):
        b.box(
            (d.uniform(-inner / 2 + 0.2, inner / 2 - 0.2), 0.02, seat + 0.02),
            (0.42, 0.13, 0.4),
            d.pick((*m.fabrics, *m.clothes)),
            euler=(d.uniform(10, 35), d.uniform(-20, 20), 0),
        )
    return [Surface(0, 0.15, seat + 0.02, inner, depth * 0.4)] if d.chance(0.3) else []


def _round_sofa(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Stuffed sofa: rolled arms and back, plump cushions."""
    cover, roll, seat = d.pick(m.fabrics), d.uniform(0.09, 0.15), d.uniform(0.38, 0.46)
    x, y = width / 2 - roll, depth / 2 - roll
    b.box((0, 0, 0.05), (width - 0.1, depth - 0.1, seat - 0.2), cover)
    b.limb((-x, -y, 0.82 - roll), (x, -y, 0.82 - roll), roll, cover)
    b.box((0, -y, 0.1), (width - 2 * roll, roll * 1.6, 0.7 - roll), cover)
    for s in (-1, 1):
        b.limb((s * x, -y, 0.6 - roll), (s * x, y, 0.6 - roll), roll, cover)
        b.box((s * x, 0, 0.05), (roll * 1.5, depth - 0.06, 0.5 - roll), cover)
    inner = width - 4 * roll
    count = max(1, round(inner / 0.65))
    for k in range(count):
        t = (k + 0.5) * inner / count - inner / 2
        b.ellipsoid((t, 0.06, seat - 0.06), (inner / count * 0.54, depth * 0.4, 0.13), cover)
        b.ellipsoid(
            (t, -y + roll + 0.08, seat + 0.2),
            (inner / count * 0.52, 0.14, 0.25),
            d.pick((cover, cover, *m.fabrics)),
        )
    return []

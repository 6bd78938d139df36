"""Chairs, stools and sofas; makers as in :mod:`~eldenet.simulation.furnished_rooms.furniture`."""

from eldenet.simulation.furnished_rooms.furniture import Surface, legs
from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Body, Draw


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

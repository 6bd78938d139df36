"""Kitchen and bathroom fixtures, lamps, plants, people and clutter.

What takes a width and a depth is a maker like those of :mod:`eldenet.simulation.furnished_rooms.furniture`.
"""

from eldenet.simulation.furnished_rooms.furniture import Surface
from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Body, Draw


def counter(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Kitchen counter: lower cabinets, stone top, sink or stove, backsplash, upper cabinets."""
    front, height = m.fronts[0], 0.88
    b.box((0, -0.02, 0.0), (width, depth - 0.08, height - 0.03), m.woods[0])
    step = d.uniform(0.5, 0.8)
    count = max(1, round(width / step))
    for k in range(count):
        x = ((k + 0.5) / count - 0.5) * width
        special = d.chance(0.25)
        b.box(
            (x, depth / 2 - 0.04, 0.1),
            (width / count - 0.015, 0.03, height - 0.14),
            d.pick(m.appliances) if special else front,
        )
    b.box((0, 0, height), (width + 0.02, depth + 0.02, 0.04), d.pick((m.stone, m.woods[1], m.white)))
    b.box(
        (0, -depth / 2 + 0.01, height + 0.04),
        (width, 0.02, d.uniform(0.05, 0.5)),
        d.pick((m.stone, m.walls[1], m.white)),
    )
    x = d.uniform(-0.3, 0.3) * width
    if d.chance(0.6):
        b.box((x, 0.02, height + 0.035), (0.5, 0.38, 0.012), m.metal)
        b.limb((x, -0.2, height), (x, -0.2, height + 0.25), 0.015, m.metal)
        b.limb((x, -0.2, height + 0.25), (x, -0.02, height + 0.22), 0.013, m.metal)
    else:
        for k in range(4):
            b.cylinder((x + (k % 2 - 0.5) * 0.28, (k // 2 - 0.5) * 0.26, height + 0.04), 0.09, 0.012, m.dark)
    if d.chance(0.7):
        upper = d.uniform(0.6, 0.85)
        for k in range(count):
            if d.chance(0.85):
                xk = ((k + 0.5) / count - 0.5) * width
                b.box((xk, -depth / 2 + 0.17, 1.4), (width / count - 0.01, 0.34, upper), front)
    return [Surface(0, 0.05, height + 0.04, width, depth * 0.7)]


def sink(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Washstand with basin, faucet and mirror."""
    height = d.uniform(0.78, 0.88)
    if d.chance(0.6):
        b.box((0, 0, 0), (width, depth - 0.04, height - 0.04), d.pick(m.fronts))
    else:
        b.cylinder((0, 0, 0), 0.09, height - 0.04, m.white)
    b.box((0, 0, height - 0.04), (width, depth, 0.04), d.pick((m.white, m.stone)))
    b.ellipsoid((0, 0.03, height), (min(0.24, width * 0.4), depth * 0.36, 0.012), m.white)
    b.limb((0, -depth * 0.36, height), (0, -depth * 0.36, height + 0.16), 0.014, m.metal)
    b.limb((0, -depth * 0.36, height + 0.16), (0, -depth * 0.1, height + 0.13), 0.012, m.metal)
    b.box(
        (0, -depth / 2 + 0.01, height + 0.25),
        (width * d.uniform(0.6, 1.1), 0.02, d.uniform(0.5, 0.9)),
        d.pick((m.pictures[0], m.walls[0], m.metal)),
    )
    return [Surface(0, -0.05, height, width, depth * 0.8)]


def toilet(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Toilet with tank."""
    b.box((0, -depth / 2 + 0.09, 0.38), (width, 0.18, 0.38), m.white)
    b.cylinder((0, 0.02, 0), 0.12, 0.3, m.white)
    b.ellipsoid((0, 0.08, 0.34), (0.18, depth * 0.38, 0.1), m.white)
    b.ellipsoid((0, 0.08, 0.42), (0.19, depth * 0.38, 0.02), d.pick((m.white, m.woods[0])))
    if d.chance(0.4):
        b.box((0, -depth * 0.25, 0.44), (width * 0.8, 0.04, 0.38), m.white, euler=(10, 0, 0))
    return [Surface(0, -depth / 2 + 0.09, 0.76, width * 0.8, 0.14)]


def bathtub(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Tub with a rim, often behind a curtain."""
    height = d.uniform(0.45, 0.58)
    b.box((0, 0, 0), (width, depth, height - 0.2), m.white)
    for s in (-1, 1):
        b.box((0, s * (depth / 2 - 0.04), height - 0.2), (width, 0.08, 0.2), m.white)
        b.box((s * (width / 2 - 0.05), 0, height - 0.2), (0.1, depth, 0.2), m.white)
    if d.chance(0.5):
        w = width * d.uniform(0.3, 0.9)
        b.box((d.sign() * (width - w) / 2, depth / 2 - 0.03, 0.2), (w, 0.05, 1.75), m.curtain)
        b.limb((-width / 2, depth / 2 - 0.03, 1.97), (width / 2, depth / 2 - 0.03, 1.97), 0.015, m.metal)
    return [Surface(0, -depth / 2 + 0.05, height, width * 0.8, 0.06)]


def tv_stand(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Low board with a television."""
    height, size = d.uniform(0.4, 0.6), width * d.uniform(0.5, 0.85)
    b.box((0, 0, 0), (width, depth, height), d.pick(m.woods))
    b.box((0, depth / 2, 0.03), (width - 0.04, 0.02, height - 0.06), d.pick((*m.fronts, m.books[0])))
    b.box((0, 0, height), (0.3, 0.2, 0.06), m.dark)
    b.box((0, 0, height + 0.05), (size, 0.05, size * 0.58), m.dark)
    b.box((0, 0.026, height + 0.08), (size - 0.05, 0.004, size * 0.58 - 0.06), m.screen)
    return [Surface(-width * 0.4, 0, height, width * 0.15, depth)]


def lamp(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Floor lamp."""
    height = d.uniform(1.2, 1.8)
    b.cylinder((0, 0, 0), 0.14, 0.03, m.dark)
    b.cylinder((0, 0, 0.03), 0.015, height - 0.25, m.metal)
    b.cylinder((0, 0, height - 0.25), d.uniform(0.12, 0.24), 0.28, m.shade)
    return []


def plant(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Potted plant."""
    pot = d.uniform(0.18, 0.4)
    b.cylinder((0, 0, 0), width * 0.28, pot, d.pick(m.colors))
    b.cylinder((0, 0, pot), 0.02, 0.3, m.woods[0])
    for _ in range(d.integer(4, 9)):
        b.ellipsoid(
            (d.uniform(-0.3, 0.3) * width, d.uniform(-0.3, 0.3) * depth, pot + d.uniform(0.15, 0.9)),
            (d.uniform(0.08, 0.25), d.uniform(0.04, 0.1), d.uniform(0.05, 0.25)),
            m.leaves,
            euler=(d.uniform(-60, 60), d.uniform(-60, 60), d.uniform(0, 180)),
        )
    return []


def basket(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Bin, basket, carton, stack of boxes, suitcase."""
    style = d.integer(0, 3)
    if style == 0:
        b.cylinder((0, 0, 0), width * 0.42, d.uniform(0.25, 0.6), d.pick((*m.colors, m.metal, m.dark)))
    elif style == 1:
        z = 0.0
        for _ in range(d.integer(1, 3)):
            h = d.uniform(0.15, 0.4)
            b.box(
                (d.uniform(-0.04, 0.04), 0, z),
                (width * d.uniform(0.7, 1), depth * d.uniform(0.7, 1), h),
                d.pick((*m.colors, *m.woods)),
                euler=(0, 0, d.uniform(-15, 15)),
            )
            z += h
    elif style == 2:
        b.box((0, 0, 0), (width, depth * 0.5, d.uniform(0.4, 0.7)), d.pick((*m.colors, *m.fabrics)))
    else:
        for _ in range(d.integer(2, 5)):
            b.ellipsoid(
                (d.uniform(-0.1, 0.1), d.uniform(-0.1, 0.1), d.uniform(0.05, 0.3)),
                (0.22, 0.2, d.uniform(0.06, 0.15)),
                d.pick((*m.clothes, *m.fabrics)),
                euler=(d.uniform(-20, 20), d.uniform(-20, 20), 0),
            )
    return []


def person(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Standing person of capsules, facing +y."""
    h = d.uniform(1.45, 1.95) / 1.75
    shirt, trousers = d.pick(m.clothes), d.pick((*m.clothes, m.dark))
    stride = d.uniform(-0.18, 0.18)
    for s in (-1, 1):
        knee = (s * 0.1 * h, s * stride * 0.5, 0.48 * h)
        b.limb((s * 0.11 * h, s * stride, 0.08), knee, 0.065 * h, trousers)
        b.limb(knee, (s * 0.09 * h, 0, 0.92 * h), 0.085 * h, trousers)
        b.box((s * 0.11 * h, s * stride + 0.06, 0), (0.1, 0.26, 0.08), m.dark)
        reach, lift = d.uniform(-0.1, 0.3), d.uniform(0.0, 0.3)
        elbow = (s * 0.28 * h, reach * 0.3, 1.12 * h)
        b.limb((s * 0.22 * h, 0, 1.38 * h), elbow, 0.052 * h, shirt)
        b.limb(elbow, (s * 0.24 * h, reach, (0.88 + lift) * h), 0.042 * h, d.pick((m.skin, shirt)))
    b.limb((0, 0, 1.0 * h), (0, 0, 1.3 * h), 0.155 * h, shirt)
    b.limb((-0.13 * h, 0, 1.36 * h), (0.13 * h, 0, 1.36 * h), 0.085 * h, shirt)
    b.cylinder((0, 0, 1.4 * h), 0.055 * h, 0.14 * h, m.skin)
    b.ellipsoid((0, 0.01, 1.62 * h), (0.08 * h, 0.1 * h, 0.12 * h), m.skin)
    b.ellipsoid((0, -0.02, 1.66 * h), (0.088 * h, 0.1 * h, 0.1 * h), m.hair)
    return []


def rack(d: Draw, m: Materials, b: Body, width: float, depth: float) -> list[Surface]:
    """Clothes rack or coat stand."""
    height = d.uniform(1.3, 1.7)
    for s in (-1, 1):
        b.limb((s * width / 2, 0, 0.03), (s * width / 2, 0, height), 0.015, m.metal)
        b.box((s * width / 2, 0, 0), (0.04, depth, 0.03), m.metal)
    b.limb((-width / 2, 0, height), (width / 2, 0, height), 0.015, m.metal)
    x = -width / 2 + 0.1
    while x < width / 2 - 0.1:
        thick = d.uniform(0.05, 0.14)
        length = d.uniform(0.55, 1.05)
        b.box(
            (x, 0, height - length),
            (thick, depth * d.uniform(0.7, 1.0), length - 0.03),
            d.pick((*m.clothes, *m.colors)),
        )
        x += thick + d.uniform(0.01, 0.1)
    return []


def clutter(d: Draw, m: Materials, b: Body, surface: Surface, amount: float) -> None:
    """Put bottles, cups, books, boxes, papers, bowls, table lamps on a surface."""
    area = surface.wx * surface.wy
    count = min(9, int(amount * d.uniform(2.0, 9.0) * min(1.0, area + 0.25)))
    for _ in range(count):
        x = surface.x + d.uniform(-0.46, 0.46) * surface.wx
        y = surface.y + d.uniform(-0.4, 0.4) * surface.wy
        small_object(d, m, b, x, y, surface.z)


_NATURAL_STYLES = (0, 0, 1, 2, 2, 3, 4, 4, 5, 5, 6, 7, 9, 9, 10, 10, 11, 12, 12, 12, 8)


def small_object(d: Draw, m: Materials, b: Body, x: float, y: float, z: float) -> None:
    """Add one small object that stands at (x, y, z)."""
    style = d.pick(_NATURAL_STYLES) if m.natural else d.integer(0, 8)
    color, turn = d.pick((*m.colors, m.white, m.metal)), (0.0, 0.0, d.uniform(0, 180))
    if style <= 1:
        b.box(
            (x, y, z), (d.uniform(0.06, 0.3), d.uniform(0.05, 0.22), d.uniform(0.04, 0.3)), color, euler=turn
        )
    elif style == 2:
        b.cylinder((x, y, z), d.uniform(0.025, 0.05), d.uniform(0.07, 0.14), color)
    elif style == 3:
        r, h = d.uniform(0.025, 0.06), d.uniform(0.12, 0.26)
        b.cylinder((x, y, z), r, h, color)
        b.cylinder((x, y, z + h), r * 0.4, h * 0.35, d.pick((color, m.white, m.dark)))
    elif style == 4:
        b.box((x, y, z), (d.uniform(0.15, 0.3), d.uniform(0.12, 0.22), 0.004), d.pick(m.papers), euler=turn)
    elif style == 5:
        for k in range(d.integer(1, 4)):
            b.box(
                (x, y, z + 0.035 * k),
                (d.uniform(0.14, 0.24), d.uniform(0.1, 0.18), 0.033),
                d.pick(m.colors),
                euler=(0, 0, d.uniform(0, 90)),
            )
    elif style == 6:
        b.ellipsoid((x, y, z + 0.04), (d.uniform(0.05, 0.16), d.uniform(0.05, 0.16), 0.05), color)
    elif style == 7:
        r = d.uniform(0.04, 0.1)
        b.cylinder((x, y, z), r, d.uniform(0.08, 0.25), color)
        if d.chance(0.5):
            b.ellipsoid((x, y, z + 0.28), (r * 1.6, r * 1.6, 0.12), m.leaves)
    elif style == 9:  # a row of books or folders
        width = d.uniform(0.15, 0.5)
        b.box((x, y, z), (width, d.uniform(0.14, 0.22), d.uniform(0.18, 0.3)), d.pick(m.books), euler=turn)
    elif style == 10:  # a framed photograph or a tablet
        width, tall = d.uniform(0.1, 0.3), d.uniform(0.12, 0.3)
        b.box((x, y, z), (width, 0.02, tall), m.dark, euler=(-12, 0, turn[2]))
        b.box(
            (x, y, z + 0.015), (width - 0.03, 0.026, tall - 0.03), d.pick(m.pictures), euler=(-12, 0, turn[2])
        )
    elif style == 11:  # a computer, a radio, a printer
        b.box((x, y, z), (d.uniform(0.2, 0.5), d.uniform(0.15, 0.4), d.uniform(0.1, 0.3)), m.dark, euler=turn)
    elif style == 12:  # bottles, jars or cans side by side
        for k in range(d.integer(2, 5)):
            tall = d.uniform(0.08, 0.3)
            b.cylinder(
                (x + 0.075 * k, y, z), d.uniform(0.02, 0.036), tall, d.pick((*m.colors, m.white, m.dark))
            )
    else:  # 8: a table lamp
        b.cylinder((x, y, z), 0.06, 0.02, m.dark)
        b.cylinder((x, y, z + 0.02), 0.015, 0.2, m.metal)
        b.cylinder((x, y, z + 0.2), d.uniform(0.08, 0.15), 0.18, m.shade)

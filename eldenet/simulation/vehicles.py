"""Cars, vans, trucks, cyclists, pillars and cartons of boxes, cylinders and capsules.

A maker fills a :class:`~.rendering.mjcf.Body` whose front faces +y: lengths run along y, widths along x.
The geoms touch the box ``length`` x ``width`` x ``height`` on all sides; a round pillar is as long as wide.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from eldenet.simulation.rendering.materials import Materials, any_color
from eldenet.simulation.rendering.mjcf import Body, Draw, Palette
from eldenet.simulation.rendering.textures import variants

Range = tuple[float, float]
_SLICES = 5  # of a slanted windshield
_RIM = 10  # straight pieces of a bicycle's wheel


class Paint(NamedTuple):
    """Material numbers of one street."""

    bodies: list[int]
    glass: int
    rubber: int
    lamp: int
    tail: int
    card: list[int]


def paints(draw: Draw, palette: Palette) -> Paint:
    """Add the colors of vehicles and cartons to a palette."""
    plain = variants("plain")[0]
    usual = ((0.8, 0.8, 0.8), (0.05, 0.05, 0.06), (0.35, 0.36, 0.38), (0.4, 0.05, 0.05), (0.08, 0.12, 0.3))
    bodies = [palette.add([draw.pick(usual)], plain, 1.0, gloss=0.6) for _ in range(5)]
    bodies += [palette.add([any_color(draw, 0.9)], plain, 1.0, gloss=0.5) for _ in range(3)]
    brown = (0.5, 0.36, 0.22)
    card = [palette.add([brown, (0.42, 0.3, 0.18), (0.7, 0.65, 0.55)], variants("text")[0], 0.0)]
    card += [palette.add([any_color(draw)], draw.pick(variants("plaster")), 1.0) for _ in range(2)]
    return Paint(
        bodies,
        palette.add([(0.03, 0.04, 0.05)], plain, 1.0, gloss=0.9),
        palette.add([(0.02, 0.02, 0.02)], plain, 1.0),
        palette.add([(0.9, 0.9, 0.85)], plain, 1.0, gloss=0.8, emission=0.3),
        palette.add([(0.5, 0.02, 0.02)], plain, 1.0, gloss=0.8, emission=0.1),
        card,
    )


def car(d: Draw, p: Paint, b: Body, length: float, width: float, height: float) -> None:
    """Sedan, hatchback or station wagon."""
    paint, waist = d.pick(p.bodies), height * d.uniform(0.56, 0.64)
    _chassis(d, p, b, length, width, waist, paint)
    front = length * d.uniform(0.16, 0.24)  # where the windshield meets the hood
    rear = -length * d.pick((0.32, 0.40, 0.46))
    slant, widths = (0.06 * length, 0.18 * length), (width * 0.92, width * 0.72)
    _cabin(p, b, (rear, front), slant, widths, (waist, height), paint)


def van(d: Draw, p: Paint, b: Body, length: float, width: float, height: float) -> None:
    """Delivery van or minivan: one volume behind a short hood."""
    paint, waist = d.pick(p.bodies), height * d.uniform(0.45, 0.55)
    _chassis(d, p, b, length, width, waist, paint)
    span = (-length * 0.49, length * d.uniform(0.32, 0.42))
    slant, widths = (0.02 * length, 0.14 * length), (width * 0.97, width * 0.86)
    _cabin(p, b, span, slant, widths, (waist, height), paint)


def truck(d: Draw, p: Paint, b: Body, length: float, width: float, height: float) -> None:
    """Truck: a cab and a closed load."""
    paint, load = d.pick(p.bodies), d.pick((*p.bodies, *p.card))
    cab = min(2.0, 0.35 * length)
    _wheels(p, b, length, width, 0.45)
    b.box((0, length / 2 - cab / 2, 0.4), (width * 0.94, cab, height * 0.78 - 0.4), paint)
    b.box((0, length / 2 - 0.02, height * 0.45), (width * 0.8, 0.05, height * 0.24), p.glass)
    b.box((0, -cab / 2 - 0.1, 0.75), (width, length - cab - 0.2, height - 0.75), load)
    b.box((0, -cab / 2, 0.5), (width * 0.5, length - cab, 0.3), p.rubber)


def carton(d: Draw, p: Paint, b: Body, length: float, width: float, height: float) -> None:
    """A closed box on the floor."""
    b.box((0, 0, 0), (width, length, height), d.pick(p.card))


def pillar(d: Draw, p: Paint, b: Body, length: float, width: float, height: float) -> None:
    """A round or square post."""
    if d.chance(0.5):
        b.cylinder((0, 0, 0), width / 2, height, d.pick(p.card))
    else:
        b.box((0, 0, 0), (width, length, height), d.pick(p.card))


def cyclist(d: Draw, p: Paint, m: Materials, b: Body, length: float, width: float, height: float) -> None:
    """A bicycle whose wheels can be seen through, and its rider."""
    paint, shirt, trousers = d.pick(p.bodies), d.pick(m.clothes), d.pick((*m.clothes, m.dark))
    radius, tire = 0.33, 0.02
    hubs = [(0.0, s * (length / 2 - radius - tire), radius + tire) for s in (-1, 1)]
    for _, y, z in hubs:
        angles = np.linspace(0, 2 * np.pi, _RIM + 1).tolist()
        rim = [(0.0, y + radius * np.cos(angle), z + radius * np.sin(angle)) for angle in angles]
        for start, end in pairwise(rim):
            b.limb(start, end, tire, p.rubber)
    pedals, saddle, head = (0.0, -0.05, 0.3), (0.0, -0.22, 0.88), (0.0, hubs[1][1] - 0.22, 0.92)
    tubes = ((hubs[0], pedals), (hubs[0], saddle), (pedals, saddle), (pedals, head), (saddle, head))
    for start, end in tubes:
        b.limb(start, end, 0.02, paint)
    b.limb(head, hubs[1], 0.02, paint)
    grip = width / 2 - 0.05
    b.limb((-grip, head[1], 1.0), (grip, head[1], 1.0), 0.02, p.rubber)
    shoulder = height - 0.34
    b.limb((0, -0.2, 0.98), (0, 0.05, shoulder - 0.06), 0.15, shirt)
    b.limb((-0.13, 0.08, shoulder), (0.13, 0.08, shoulder), 0.08, shirt)
    turn = d.uniform(0, 2 * np.pi)
    for s in (-1, 1):
        foot = (
            s * 0.1,
            -0.05 + 0.16 * np.cos(turn + s * np.pi / 2),
            0.3 + 0.16 * np.sin(turn + s * np.pi / 2),
        )
        knee = (s * 0.12, 0.22, 0.5 + 0.5 * foot[2])
        b.limb((s * 0.1, -0.18, 0.95), knee, 0.08, trousers)
        b.limb(knee, foot, 0.06, trousers)
        elbow = (s * (width / 2 - 0.05), 0.28, 0.5 * (shoulder + 1.0))
        b.limb((s * 0.2, 0.08, shoulder), elbow, 0.05, shirt)
        b.limb(elbow, (s * grip, head[1], 1.0), 0.045, d.pick((m.skin, shirt)))
    b.ellipsoid((0, 0.14, height - 0.12), (0.08, 0.1, 0.12), d.pick((m.skin, m.hair)))


def _chassis(d: Draw, p: Paint, b: Body, length: float, width: float, waist: float, paint: int) -> None:
    """Add wheels, and the body below the windows with cut corners."""
    _wheels(p, b, length, width, d.uniform(0.29, 0.35))
    low, cut = d.uniform(0.18, 0.28), d.uniform(0.84, 0.92)
    b.box((0, 0, low), (width, length * cut, waist - low), paint)
    b.box((0, 0, low + 0.05), (width * 0.84, length, waist - low - 0.12), paint)
    for s in (-1, 1):
        b.box((s * width * 0.33, length / 2 - 0.08, waist - 0.3), (0.3, 0.14, 0.12), p.lamp)
        b.box((s * width * 0.35, -length / 2 + 0.08, waist - 0.28), (0.22, 0.14, 0.14), p.tail)


def _wheels(p: Paint, b: Body, length: float, width: float, radius: float) -> None:
    for sx in (-1, 1):
        for sy in (-1, 1):
            place = (sx * (width / 2 - 0.12), sy * length * 0.31, radius - 0.11)
            b.cylinder(place, radius, 0.22, p.rubber, euler=(0, 90, 0))


def _cabin(p: Paint, b: Body, span: Range, slant: Range, widths: Range, levels: Range, paint: int) -> None:
    """Add windows that lean inwards (``slant``, rear and front [m]) under a painted roof.

    Their lower edge lies at ``span`` (y, rear and front); widths and levels are below and above [m].
    """
    step = (levels[1] - 0.05 - levels[0]) / _SLICES
    for k in range(_SLICES):
        share = (k + 0.5) / _SLICES
        rear, front = span[0] + share * slant[0], span[1] - share * slant[1]
        width = widths[0] + share * (widths[1] - widths[0])
        b.box((0, (rear + front) / 2, levels[0] + k * step), (width, front - rear, step), p.glass)
    rear, front = span[0] + slant[0], span[1] - slant[1]
    b.box((0, (rear + front) / 2, levels[1] - 0.05), (widths[1], front - rear, 0.05), paint)

"""What makes a room look lived in: sun, fans, beams, pipes, cables, coats, shoes, heaps of clothes."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from eldenet.simulation.furnished_rooms.household import small_object
from eldenet.simulation.furnished_rooms.walls import Wall
from eldenet.simulation.rendering.bounced_light import Sun
from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Body, Draw
from eldenet.simulation.rendering.shading import Room


def add_fittings(d: Draw, m: Materials, room: Room, walls: Sequence[Wall]) -> list[Body]:
    """Return bodies to add to a furnished room; add sockets, coats ... to its walls, and suns to ``room``.

    Only coats avoid what is there already.
    """
    if m.daylight > 0 and d.chance(0.5):
        room.suns += [sun for wall in walls for sun in _suns(d, m, wall)][:2]
    sx, sy, h = room.size
    body = Body()
    chances = ((_fan, 0.18 if h > 2.35 else 0.0), (_beams, 0.12), (_pipes, 0.12), (_lamp_rail, 0.1))
    for add, probability in chances:
        if d.chance(probability):
            add(d, m, body, (sx, sy, h))
    for wall in walls:
        _at_wall(d, m, wall)
    scattered = [_heap(d, m, room) for _ in range(d.integer(0, 4))]
    scattered += [_clothes_on(d, m, piece) for piece in room.obstacles if piece[4] < 1.0 and d.chance(0.3)]
    return [part for part in (body, *scattered) if part.geoms]


def _suns(d: Draw, m: Materials, wall: Wall) -> list[Sun]:
    """Sun through each window of a wall, from one direction."""
    slope, drop = d.uniform(-1.2, 1.2), d.uniform(0.5, 1.4)  # along the wall and down, per meter inwards
    (nx, ny), (ax, ay) = wall.normal, wall.along
    toward = np.array([-nx - slope * ax, -ny - slope * ay, drop])
    toward /= np.sqrt(np.square(toward).sum())
    suns = []
    for x, width, low, high in wall.windows:
        center = (*wall.to_world(x, 0.03), (low + high) / 2)
        half = (width / 2, (high - low) / 2)
        direction = (float(toward[0]), float(toward[1]), float(toward[2]))
        suns.append(
            Sun(center, (ax, ay, 0.0), (nx, ny, 0.0), direction, half, m.daylight * d.uniform(0.4, 1.2))
        )
    return suns


def _fan(d: Draw, m: Materials, b: Body, size: tuple[float, float, float]) -> None:
    """Ceiling fan with four or five blades."""
    sx, sy, h = size
    x, y, drop = d.uniform(-0.15, 0.15) * sx, d.uniform(-0.15, 0.15) * sy, d.uniform(0.2, 0.4)
    blade, count, first = d.pick((*m.woods, m.white, m.dark)), d.pick((4, 5)), d.uniform(0, 90)
    b.cylinder((x, y, h - drop), 0.015, drop, m.metal)
    b.cylinder((x, y, h - drop - 0.1), 0.1, 0.12, d.pick((m.metal, m.white)))
    for k in range(count):
        turn = first + 360 / count * k
        away = 0.42
        bx, by = x + away * np.cos(np.radians(turn)), y + away * np.sin(np.radians(turn))
        b.box((float(bx), float(by), h - drop - 0.05), (0.6, 0.13, 0.012), blade, euler=(0, 0, turn))


def _beams(d: Draw, m: Materials, b: Body, size: tuple[float, float, float]) -> None:
    """Beams under the ceiling."""
    sx, sy, h = size
    thick, material = d.uniform(0.08, 0.25), d.pick((*m.woods, m.white, m.ceiling))
    count = max(2, round(sy / d.uniform(0.8, 1.8)))
    for k in range(count):
        b.box((0, ((k + 0.5) / count - 0.5) * sy, h - thick), (sx, thick * 0.7, thick), material)


def _pipes(d: Draw, m: Materials, b: Body, size: tuple[float, float, float]) -> None:
    """Pipes or ducts below the ceiling, and a white pipe in a corner."""
    sx, sy, h = size
    for _ in range(d.integer(1, 3)):
        y, z = d.uniform(-0.45, 0.45) * sy, h - d.uniform(0.12, 0.35)
        radius = d.pick((0.02, 0.03, 0.06, 0.12))
        b.limb((-sx / 2, y, z), (sx / 2, y, z), radius, d.pick((m.metal, m.white, m.dark)))
    b.limb((sx / 2 - 0.06, -sy / 2 + 0.08, 0), (sx / 2 - 0.06, -sy / 2 + 0.08, h), 0.025, m.white)


def _lamp_rail(d: Draw, m: Materials, b: Body, size: tuple[float, float, float]) -> None:
    """Lamps on a rail below the ceiling."""
    sx, sy, h = size
    y = d.uniform(-0.3, 0.3) * sy
    b.box((0, y, h - 0.06), (sx * 0.6, 0.04, 0.03), m.dark)
    for k in range(d.integer(2, 4)):
        b.cylinder(((k - 1.5) * sx * 0.15, y, h - 0.25), 0.05, 0.14, m.dark, euler=(d.uniform(-40, 40), 0, 0))


def _at_wall(d: Draw, m: Materials, wall: Wall) -> None:
    """Sockets and cables, coats on hooks, pairs of shoes, and a board that leans against the wall."""
    body, half = wall.body, wall.length / 2
    for _ in range(d.integer(0, 3)):
        x = d.uniform(-half, half) * 0.95
        body.box((x, 0.005, 0.28), (0.08, 0.012, 0.08), m.white)
        if d.chance(0.6):
            _cable(d, m, body, x)
    if d.chance(0.22):
        _coats(d, m, wall)
    for _ in range(d.integer(0, 2)):
        x = d.uniform(-half, half) * 0.9
        material = d.pick((m.dark, *m.colors, *m.woods))
        body.box((x, d.uniform(0.15, 0.3), 0), (0.09, 0.27, d.uniform(0.07, 0.2)), material)
        body.box((x + 0.13, d.uniform(0.15, 0.3), 0), (0.09, 0.27, d.uniform(0.07, 0.2)), material)
    if d.chance(0.2):  # a board, a picture or a mirror leans against the wall
        x, width, tall = d.uniform(-half, half) * 0.8, d.uniform(0.3, 0.9), d.uniform(0.5, 1.6)
        body.box((x, 0.12, 0), (width, 0.03, tall), d.pick((*m.woods, *m.pictures, m.white)), euler=(8, 0, 0))


def _cable(d: Draw, m: Materials, b: Body, x: float) -> None:
    """A cable from a socket to the floor and along it."""
    cable, y = d.pick((m.dark, m.dark, m.white)), 0.02
    points = [(x, y, 0.28), (x + d.uniform(-0.1, 0.1), 0.05, 0.01)]
    for _ in range(d.integer(1, 4)):
        px, py, _ = points[-1]
        points.append((px + d.uniform(-0.5, 0.5), max(0.03, py + d.uniform(-0.15, 0.3)), 0.01))
    for start, end in pairwise(points):
        b.limb(start, end, 0.006, cable)


def _coats(d: Draw, m: Materials, wall: Wall) -> None:
    """Coats or towels that hang from hooks, where the wall is free at eye height."""
    x = d.uniform(-0.5, 0.5) * (wall.length - 0.8)
    if any(x - 0.4 < high and x + 0.4 > low for low, high in wall.high):
        return
    wall.body.box((x, 0.012, 1.6), (0.7, 0.025, 0.09), d.pick((*m.woods, m.white)))
    for k in range(d.integer(1, 3)):
        length = d.uniform(0.4, 1.0)
        wall.body.ellipsoid(
            (x - 0.25 + 0.24 * k, 0.1, 1.62 - length / 2),
            (d.uniform(0.1, 0.2), 0.08, length / 2),
            d.pick(m.clothes),
        )


def _heap(d: Draw, m: Materials, room: Room) -> Body:
    """Clothes and small objects on the floor, anywhere."""
    sx, sy, _ = room.size
    b = Body((d.uniform(-0.45, 0.45) * sx, d.uniform(-0.45, 0.45) * sy, 0), d.uniform(0, 360))
    if d.chance(0.4):
        _clothes(d, m, b, 0.0, 0.3)
    for _ in range(d.integer(0, 4)):
        small_object(d, m, b, d.uniform(-0.4, 0.4), d.uniform(-0.4, 0.4), 0.0)
    return b


def _clothes_on(d: Draw, m: Materials, piece: tuple[float, float, float, float, float]) -> Body:
    """Clothes about where one sits on a low piece, a row of ``Room.obstacles``; in a doorway on the floor."""
    x0, y0, x1, y1, height = piece
    top = height * 0.55
    b = Body(((x0 + x1) / 2, (y0 + y1) / 2, 0), d.uniform(0, 360))
    _clothes(d, m, b, top, min(x1 - x0, y1 - y0) * 0.4)
    return b


def _clothes(d: Draw, m: Materials, b: Body, z: float, reach: float) -> None:
    for _ in range(d.integer(1, 4)):
        b.ellipsoid(
            (d.uniform(-0.5, 0.5) * reach, d.uniform(-0.5, 0.5) * reach, z + 0.03),
            (reach * d.uniform(0.4, 0.9), reach * d.uniform(0.3, 0.7), d.uniform(0.03, 0.12)),
            d.pick((*m.clothes, *m.fabrics)),
            euler=(d.uniform(-15, 15), d.uniform(-15, 15), d.uniform(0, 180)),
        )

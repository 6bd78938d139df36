"""Arenas as a camera sees them with ``detail``: furniture, doors, windows, cables, things that hang.

Footprints stay those of :mod:`eldenet.simulation.arena_mjcf`, which physics and ranges use. A table has legs
and air below it here, so this is for pictures and their depth alone.
"""

from eldenet.simulation.arena_mjcf import CEILING
from eldenet.simulation.arenas import SPLITS, Arena
from eldenet.simulation.furnished_rooms import furniture, household
from eldenet.simulation.obstacle import WALL_HEIGHT, Obstacle
from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Body, Draw, numbers, world_text

_LOW = (furniture.coffee_table, furniture.stool, household.basket)
_MIDDLE = (furniture.table, furniture.desk, furniture.cabinet, furniture.crib, household.basket)
_TALL = (furniture.shelf, furniture.wardrobe, furniture.cabinet, household.rack)


def detailed_arena(arena: Arena) -> str:
    """Return the MJCF text of an arena; body ``n + 1`` is obstacle ``n``, pedestrians as mocap bodies."""
    seed = (SPLITS.get(arena.split, 0), arena.density, arena.index)
    draw = Draw((*seed, 4))
    materials = Materials(Draw((*seed, 1)), natural=True)
    shell = Body()
    _hall(draw, materials, shell, arena.side)
    bodies = [_obstacle(draw, materials, obstacle) for obstacle in arena.obstacles]
    return world_text("arena", materials.palette, [*bodies, shell.text()])


def _obstacle(d: Draw, m: Materials, obstacle: Obstacle) -> str:
    """Return the body of an obstacle: a piece of furniture of its footprint, a person, a pillar."""
    body = Body((obstacle.x, obstacle.y, 0.0), 57.29578 * obstacle.yaw)
    wide, deep, tall = 2 * obstacle.half[0], 2 * obstacle.half[1], obstacle.height
    surfaces: list[furniture.Surface] = []
    if obstacle.kind == "person":
        household.person(d, m, body, wide, deep)
    elif obstacle.is_wall:
        body.box((0, 0, 0), (wide, deep, tall), m.walls[0])
        for side in (-1, 1):  # a baseboard
            body.box((0, side * deep / 2, 0), (wide, 0.02, 0.1), m.trim)
    elif obstacle.kind == "cylinder":
        if tall < 1.2 and d.chance(0.5):
            surfaces = d.pick((furniture.stool, furniture.round_table, household.plant))(
                d, m, body, wide, deep
            )
        else:
            body.cylinder((0, 0, 0), wide / 2, tall, d.pick((*m.colors, *m.walls, m.metal)))
    elif obstacle.kind == "vehicle" or d.chance(0.25):
        body.box((0, 0, 0), (wide, deep, tall), d.pick((*m.colors, *m.fronts)))
        body.box((0, 0, tall), (0.6 * wide, 0.8 * deep, 0.25), m.dark)
    else:
        makers = _LOW if tall < 0.5 else _MIDDLE if tall < 1.2 else _TALL
        surfaces = d.pick(makers)(d, m, body, wide, deep)
    for surface in surfaces:
        household.clutter(d, m, body, surface, 1.0)
    text = body.text()
    return text.replace("<body ", '<body mocap="true" ', 1) if obstacle.path else text


def _hall(d: Draw, m: Materials, b: Body, side: float) -> None:
    """Floor, ceiling, low walls with doors and windows, the hall around them, what hangs, and cables."""
    half, thick, outer = side / 2, 0.05, side / 2 + 1
    b.plane((0, 0, 0), (0, 0, 1), m.floor)
    b.plane((0, 0, CEILING), (0, 0, -1), m.ceiling)
    for number, (nx, ny) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        b.plane((nx * outer, ny * outer, 0), (-nx, -ny, 0), m.walls[1])
        wall = Body((nx * half, ny * half, 0), (90.0, -90.0, 180.0, 0.0)[number])  # +y looks into the arena
        wall.box((0, -thick, 0), (side + 0.2, 0.1, WALL_HEIGHT), m.walls[0])
        wall.box((0, 0.01, 0), (side, 0.02, 0.12), m.trim)
        place = -half + d.uniform(0.5, 2.0)
        while place < half - 1.5:
            width = d.uniform(0.8, 1.6)
            _on_wall(d, m, wall, place + width / 2, width)
            place += width + d.uniform(0.3, 3.0)
        b.geoms += _inlined(wall)
    for _ in range(d.integer(2, 8)):  # beams, pipes and lamps that hang
        x, y, z = d.uniform(-half, half), d.uniform(-half, half), d.uniform(1.6, 3.6)
        if d.chance(0.5):
            b.limb((x, y, CEILING), (x, y, z), 0.015, m.dark)
            b.ellipsoid((x, y, z), (0.2, 0.2, 0.15), d.pick((m.white, m.shade, m.dark)))
        else:
            b.limb((-half, y, z), (half, y, z), d.uniform(0.02, 0.12), d.pick((m.metal, m.white, *m.woods)))
    for _ in range(d.integer(4, 14)):  # cables on the floor
        points = [(d.uniform(-half, half), d.uniform(-half, half), 0.008)]
        for _ in range(4):
            x, y, z = points[-1]
            points.append((x + d.uniform(-0.8, 0.8), y + d.uniform(-0.8, 0.8), z))
            b.limb(points[-2], points[-1], 0.008, d.pick((m.dark, m.white)))


def _on_wall(d: Draw, m: Materials, b: Body, x: float, width: float) -> None:
    """A door, a window, a picture, a radiator or a shelf that overhangs."""
    style = d.unit()
    if style < 0.3:
        b.box((x, 0.01, 0), (width + 0.14, 0.03, WALL_HEIGHT), m.trim)
        b.box((x, 0.02, 0), (width, 0.03, WALL_HEIGHT - 0.07), d.pick(m.doors))
    elif style < 0.55:
        b.box((x, 0.01, 0.75), (width + 0.12, 0.03, 1.1), m.trim)
        b.box((x, 0.02, 0.81), (width, 0.03, 0.98), m.window)
        b.box((x, 0.06, 0.72), (width + 0.2, 0.16, 0.03), m.trim)
    elif style < 0.7:
        b.box((x, 0.06, 0.15), (width, 0.1, 0.55), m.blind)
    elif style < 0.85:
        b.box((x, 0.015, 1.1), (min(width, 1.0), 0.03, 0.7), d.pick((*m.pictures, *m.papers)))
    else:
        b.box((x, 0.16, 1.2), (width, 0.32, 0.03), d.pick(m.woods))
        household.clutter(d, m, b, furniture.Surface(x, 0.16, 1.23, width, 0.3), 1.5)


def _inlined(body: Body) -> list[str]:
    """The geoms of a body as a frame inside another body."""
    x, y, z = body.position
    turn = numbers((0.0, 0.0, body.yaw))
    return [f'<frame pos="{numbers((x, y, z))}" euler="{turn}">', *body.geoms, "</frame>"]

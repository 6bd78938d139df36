"""Furnished rooms: walls with doors and windows, furniture along them, clutter on top.

A room depends on ``(split, index)`` alone and is the same on every machine (:class:`~.rendering.mjcf.Draw`,
four decimals). Seeds are ``(SPLITS[split], index, 0)`` for a room, ``(..., 1)`` for its cameras,
``(..., 2, view)`` for a frame's noise, ``(..., 7)`` for what ``detail`` adds and ``(..., 8)`` for which rooms
are plain; the splits share none, so no room is in two of them.
"""

from eldenet.simulation.furnished_rooms import furniture, household
from eldenet.simulation.furnished_rooms.fittings import add_fittings
from eldenet.simulation.furnished_rooms.kinds import KINDS, Item, Kind
from eldenet.simulation.furnished_rooms.walls import Wall, overlaps
from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Body, Draw, world_text
from eldenet.simulation.rendering.shading import Room

#: First number of every split's seeds.
SPLITS = {"train": 0, "val": 1, "test": 2}


def generate_room(split: str, index: int, detail: bool = False, plain: float = 0.0) -> Room:
    """Generate room ``index`` of a split.

    ``detail`` is that of :func:`.render.render_room`; ``plain`` is the chance that its surfaces have no
    pattern.
    """
    draw = Draw((SPLITS[split], index, 0))
    details = Draw((SPLITS[split], index, 7)) if detail else None
    return _Builder(draw, details, Draw((SPLITS[split], index, 8)).chance(plain)).build()


class _Builder:
    """Builds one room. The order of the random draws defines it, so new features belong at the end.

    ``details`` are the draws of what ``detail`` adds; None: nothing.
    """

    def __init__(self, draw: Draw, details: Draw | None, plain: bool) -> None:
        d = self.d = draw
        name = d.pick([kind for kind, spec in KINDS.items() for _ in range(spec.share)])
        self.kind: Kind = KINDS[name]
        size = (d.uniform(*self.kind.side), d.uniform(*self.kind.side), d.uniform(*self.kind.height))
        self.room = Room(name, size)
        self.details = details
        self.m = Materials(d, natural=details is not None, plain=plain)
        self.shell = Body()
        self.bodies: list[Body] = []
        self.walls: list[Wall] = []
        self.clutter = d.uniform(0.4, 1.7) if details is None else d.uniform(0.8, 2.6)

    def build(self) -> Room:
        d, (sx, sy, h) = self.d, self.room.size
        self.shell.plane((0, 0, 0), (0, 0, 1), self.m.floor)
        self.shell.plane((0, 0, h), (0, 0, -1), self.m.ceiling)
        for side in range(4):
            self._wall(Wall(d, self.m, side, self.room.size))
        self._columns()
        for _ in range(d.integer(*self.kind.groups) + int(sx * sy / 14)):
            self._group()
        self._ceiling()
        self._people()
        for _ in range(int(d.uniform(0, 5) * self.clutter)):
            self._on_floor()
        if self.details is not None:
            self.bodies += add_fittings(self.details, self.m, self.room, self.walls)
            self.room.detail = True
            self.room.ambient *= 0.5  # the other half bounces
        parts = [*self.shell.geoms, *(body.text() for body in self.bodies)]
        self.room.text = world_text("room", self.m.palette, parts)
        return self.room

    def _wall(self, wall: Wall) -> None:
        """Add a wall with furniture along it and pictures above."""
        wall.build(self.shell)
        if wall.doorway is not None:  # nothing stands where a door swings
            x, width = wall.doorway
            self._block(*wall.to_world(x, 0.35), *_turned(width + 0.2, 0.7, wall.side % 2 == 1), 0.0)
        self._furnish(wall)
        wall.decorate()
        self.bodies.append(wall.body)
        self.walls.append(wall)
        self.room.lights += wall.lights

    def _furnish(self, wall: Wall) -> None:
        """Set pieces side by side along a wall."""
        d = self.d
        x = -wall.length / 2 + d.uniform(0.0, 0.5)
        density = d.uniform(0.65, 1.0) if self.details is None else d.uniform(0.85, 1.0)
        while x < wall.length / 2 - 0.4:
            item: Item = d.pick(self.kind.along)
            width, depth = d.uniform(*item.width), d.uniform(*item.depth)
            if not d.chance(density):
                x += d.uniform(0.3, 1.0)
                continue
            span = (x, x + width)
            if span[1] > wall.length / 2 or overlaps(span, wall.taken):
                x += 0.35
                continue
            place = wall.to_world(x + width / 2, depth / 2 + d.uniform(0.01, 0.06))
            if self._free(*place, *_turned(width, depth, wall.side % 2 == 1)):
                self._make(item, *place, width, depth, wall.yaw + d.pick((0.0, 0.0, 0.0, d.uniform(-6, 6))))
                if item.tall:
                    wall.high.append(span)
            x += width + d.pick((0.02, 0.1, 0.3, 0.6))

    def _make(self, item: Item, x: float, y: float, width: float, depth: float, yaw: float) -> None:
        """Add a piece with clutter on it and block its place."""
        body = Body((x, y, 0), yaw)
        for surface in item.maker(self.d, self.m, body, width, depth):
            household.clutter(self.d, self.m, body, surface, self.clutter)
        self.bodies.append(body)
        self.room.pieces[len(self.bodies)] = item.maker.__name__  # body 0 is the world
        self._block(x, y, *_turned(width, depth, round(yaw / 90) % 2 == 1), 2.2 if item.tall else item.height)
        if item.maker is household.lamp:
            self.room.lights.append((x, y, 1.5, 0.5, 0.42, 0.3, 1.2))

    def _block(self, x: float, y: float, wx: float, wy: float, height: float) -> None:
        self.room.obstacles.append((x - wx / 2, y - wy / 2, x + wx / 2, y + wy / 2, height))

    def _free(self, x: float, y: float, wx: float, wy: float, margin: float = 0.0) -> bool:
        """Whether a rectangle lies inside the room and is free."""
        sx, sy, _ = self.room.size
        x0, y0, x1, y1 = x - wx / 2 - margin, y - wy / 2 - margin, x + wx / 2 + margin, y + wy / 2 + margin
        if x0 < -sx / 2 or x1 > sx / 2 or y0 < -sy / 2 or y1 > sy / 2:
            return False
        return all(x1 <= a or x0 >= c or y1 <= b or y0 >= e for a, b, c, e, _ in self.room.obstacles)

    def _columns(self) -> None:
        """Add chimney breasts, corner closets and pillars."""
        d, (sx, sy, h) = self.d, self.room.size
        for _ in range(d.integer(0, 2) if d.chance(0.45) else 0):
            width, depth = d.uniform(0.25, 1.4), d.uniform(0.25, 0.9)
            x = d.sign() * (sx - width) / 2 if d.chance(0.75) else d.uniform(-0.3, 0.3) * sx
            y = d.sign() * (sy - depth) / 2 if d.chance(0.5) else d.uniform(-0.4, 0.4) * sy
            if self._free(x, y, width, depth):
                body = Body((x, y, 0))
                body.box((0, 0, 0), (width, depth, h), d.pick(self.m.walls))
                self.bodies.append(body)
                self._block(x, y, width, depth, h)

    def _group(self) -> None:
        """Add something away from the walls: a table with chairs, a sofa, a shelf as divider."""
        d, (sx, sy, _) = self.d, self.room.size
        item = d.pick(self.kind.middle)
        for _ in range(6):
            width, depth, turned = d.uniform(*item.width), d.uniform(*item.depth), d.chance(0.5)
            room = (depth, width) if turned else (width, depth)
            x, y = d.uniform(-0.5, 0.5) * (sx - room[0]), d.uniform(-0.5, 0.5) * (sy - room[1])
            if self._free(x, y, *room, margin=0.15):
                break
        else:
            return
        yaw = (90.0 if turned else 0.0) + d.pick((0.0, 180.0)) + d.pick((0.0, d.uniform(-15, 15)))
        if d.chance(0.3):
            rug = Body((x, y, 0), yaw)
            rug.box((0, 0, 0), (width + d.uniform(0.2, 1.2), depth + d.uniform(0.2, 1.0), 0.012), self.m.rug)
            self.bodies.append(rug)
        self._make(item, x, y, width, depth, yaw)
        if item.maker in (furniture.table, furniture.round_table):
            self._chairs(x, y, *room)

    def _chairs(self, x: float, y: float, wx: float, wy: float) -> None:
        """Add chairs around a table, some pulled out or turned."""
        d = self.d
        chair = Item(furniture.chair, (0.4, 0.5), (0.4, 0.5), 0.9)
        seats = [(0.0, -1.0, 0.0), (0.0, 1.0, 180.0), (-1.0, 0.0, 270.0), (1.0, 0.0, 90.0)]
        for sx, sy, yaw in seats:
            along = wx if sx == 0 else wy
            for k in range(max(1, round(along / 0.75))):
                if not d.chance(0.65):
                    continue
                t = ((k + 0.5) / max(1, round(along / 0.75)) - 0.5) * along
                out = d.uniform(0.0, 0.35)
                cx = x + (t if sx == 0 else sx * (wx / 2 + out))
                cy = y + (t if sy == 0 else sy * (wy / 2 + out))
                if abs(cx) < self.room.size[0] / 2 - 0.25 and abs(cy) < self.room.size[1] / 2 - 0.25:
                    width, depth = d.uniform(*chair.width), d.uniform(*chair.depth)
                    self._make(chair, cx, cy, width, depth, yaw + d.uniform(-25, 25))

    def _ceiling(self) -> None:
        """Add lamps on or under the ceiling, not always lit if there is daylight."""
        d, m, (sx, sy, h) = self.d, self.m, self.room.size
        lit = d.chance(0.75) or not self.room.lights
        tone = d.pick(((1.0, 0.96, 0.9), (1.0, 0.85, 0.65), (0.92, 0.97, 1.0)))
        nx, ny = max(1, round(sx / 3.5)), max(1, round(sy / 3.5))
        style, power = d.pick((0, 0, 1, 1, 2, 3)), d.uniform(0.5, 1.3) / (nx * ny) ** 0.35
        body = Body((0, 0, 0))
        for i in range(min(nx, 3)):
            for j in range(min(ny, 3)):
                x = ((i + 0.5) / nx - 0.5) * sx + d.uniform(-0.2, 0.2)
                y = ((j + 0.5) / ny - 0.5) * sy + d.uniform(-0.2, 0.2)
                drop = 0.05
                if style == 0:
                    body.box((x, y, h - 0.04), (1.2, 0.3, 0.04), m.lamp if lit else m.white)
                elif style == 1:
                    body.ellipsoid((x, y, h - 0.05), (0.2, 0.2, 0.1), m.lamp if lit else m.white)
                elif style == 2 and h > 2.3:
                    drop = d.uniform(0.4, 0.8)
                    body.cylinder((x, y, h - drop), 0.008, drop, m.dark)
                    body.ellipsoid((x, y, h - drop), (0.2, 0.2, 0.14), m.lamp if lit else m.shade)
                if lit and len(self.room.lights) < 6:
                    self.room.lights.append((x, y, h - drop - 0.25, *(power * t for t in tone), 2.2))
        if body.geoms:
            self.bodies.append(body)
        self.room.ambient = d.uniform(0.1, 0.4)

    def _people(self) -> None:
        """Add up to two people, mostly none."""
        d, (sx, sy, _) = self.d, self.room.size
        for _ in range(d.pick((0, 0, 0, 0, 0, 0, 1, 1, 2))):
            x, y = d.uniform(-0.4, 0.4) * sx, d.uniform(-0.4, 0.4) * sy
            if self._free(x, y, 0.5, 0.4):
                person = Item(household.person, (0.5, 0.5), (0.4, 0.4), 1.8, True)
                self._make(person, x, y, 0.5, 0.4, d.uniform(0, 360))

    def _on_floor(self) -> None:
        """Add a basket, a carton, clothes or a small object on the floor."""
        d, (sx, sy, _) = self.d, self.room.size
        width = d.uniform(0.2, 0.45)
        x, y = d.uniform(-0.45, 0.45) * sx, d.uniform(-0.45, 0.45) * sy
        if not self._free(x, y, width, width):
            return
        if d.chance(0.5):
            basket = Item(household.basket, (0.2, 0.5), (0.2, 0.5), 0.5)
            self._make(basket, x, y, width, width, d.uniform(0, 360))
        else:
            body = Body((x, y, 0), d.uniform(0, 360))
            household.small_object(d, self.m, body, 0, 0, 0)
            self.bodies.append(body)


def _turned(width: float, depth: float, sideways: bool) -> tuple[float, float]:
    """Return a footprint's extents in the room's x and y."""
    return (depth, width) if sideways else (width, depth)

"""One furnished room from one seed: walls with doors and windows, furniture along them, clutter on top.

The text of a room depends on ``(split, index)`` alone and is the same on every machine
(:class:`~eldenet.simulation.mjcf.Draw`, four decimals). Seed streams: room ``index`` of a split comes from
``(SPLITS[split], index, 0)``, its cameras from ``(SPLITS[split], index, 1)``, a frame's sensor from
``(SPLITS[split], index, 2, view)``; the splits share no stream, so no room is in two of them.
"""

import hashlib
from dataclasses import dataclass, field

from eldenet.simulation import furniture as f
from eldenet.simulation.kinds import KINDS, Item, Kind
from eldenet.simulation.materials import Materials
from eldenet.simulation.mjcf import Body, Draw

#: First number of the seed of every split.
SPLITS = {"train": 0, "val": 1, "test": 2}

#: Per wall (south, east, north, west): inward normal, direction of the wall's own x, yaw of furniture on it.
SIDES = (
    ((0.0, 1.0), (1.0, 0.0), 0.0),
    ((-1.0, 0.0), (0.0, 1.0), 90.0),
    ((0.0, -1.0), (-1.0, 0.0), 180.0),
    ((1.0, 0.0), (0.0, -1.0), 270.0),
)


@dataclass
class Room:
    """A room ready to compile.

    Attributes:
        kind: bedroom, kitchen, ...
        size: extents in x and y and ceiling height [m]; the origin is the middle of the floor.
        text: MJCF.
        lights: rows of x, y, z [m], r, g, b, reach [m].
        obstacles: rows of x0, y0, x1, y1, height [m]: where a camera cannot stand.
        ambient: share of the light that comes from everywhere.
    """

    kind: str
    size: tuple[float, float, float]
    text: str = ""
    lights: list[tuple[float, ...]] = field(default_factory=list)
    obstacles: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    ambient: float = 0.5

    @property
    def sha256(self) -> str:
        """Hash of the MJCF text."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def generate_room(split: str, index: int) -> Room:
    """Generate room ``index`` of a split.

    Raises:
        ValueError: unknown split or negative index.
    """
    if split not in SPLITS:
        raise ValueError(f"split={split!r}: use one of {list(SPLITS)}")
    if index < 0:
        raise ValueError(f"index={index}: rooms are numbered from 0")
    draw = Draw((SPLITS[split], index, 0))
    return _Builder(draw).build()


class _Builder:
    """Puts one room together; the order of the draws is the room, so new features go at the end."""

    def __init__(self, draw: Draw) -> None:
        d = self.d = draw
        name = d.pick([kind for kind, spec in KINDS.items() for _ in range(spec.share)])
        self.kind: Kind = KINDS[name]
        size = (d.uniform(*self.kind.side), d.uniform(*self.kind.side), d.uniform(*self.kind.height))
        self.room = Room(name, size)
        self.m = Materials(d)
        self.shell = Body()
        self.bodies: list[Body] = []
        self.clutter = d.uniform(0.4, 1.7)

    def build(self) -> Room:
        sx, sy, _ = self.room.size
        self._planes()
        for side in range(4):
            self._wall(side, sx if side % 2 == 0 else sy)
        self._columns()
        for _ in range(self.d.integer(*self.kind.groups) + int(sx * sy / 14)):
            self._group()
        self._ceiling()
        self._people()
        for _ in range(int(self.d.uniform(0, 5) * self.clutter)):
            self._on_floor()
        bodies = "\n".join(body.text() for body in self.bodies)
        shell = "\n".join(self.shell.geoms)
        self.room.text = (
            '<mujoco model="room">\n<compiler angle="degree"/>\n'
            f"{self.m.palette.assets()}\n<worldbody>\n{shell}\n{bodies}\n</worldbody>\n</mujoco>\n"
        )
        return self.room

    def _planes(self) -> None:
        """Floor and ceiling."""
        self.shell.plane((0, 0, 0), (0, 0, 1), self.m.floor)
        self.shell.plane((0, 0, self.room.size[2]), (0, 0, -1), self.m.ceiling)

    def _wall(self, side: int, length: float) -> None:
        """One wall: a door or an opening, windows, furniture along it, pictures above."""
        d, (sx, sy, h) = self.d, self.room.size
        (nx, ny), _, yaw = SIDES[side]
        back = -(sy if side % 2 == 0 else sx) / 2
        body = Body((nx * back, ny * back, 0), yaw)
        taken: list[tuple[float, float]] = []  # spans along the wall that reach the floor
        high: list[tuple[float, float]] = []  # spans at eye height
        gap: tuple[float, float, float] | None = None
        if d.chance(0.75 if side == 0 else 0.3) and length > 1.8:
            width, height = d.uniform(0.75, 1.0), min(h - 0.1, d.uniform(1.95, 2.15))
            if d.chance(0.25):
                width = min(d.uniform(1.0, 2.2), length - 0.6)
            x = d.uniform(-1, 1) * (length - width - 0.3) / 2
            gap = self._door(body, x, width, height)
            taken.append((x - width / 2 - 0.15, x + width / 2 + 0.15))
            self._block(side, x, width + 0.2, 0.7, 0.0)
        self._surface(body, length, h, gap)
        if d.chance(0.55):
            high += self._window(body, length, h, taken)
        high += taken
        self._furnish(side, body, length, taken, high)
        self._decorate(body, length, h, high)
        self.bodies.append(body)

    def _surface(self, body: Body, length: float, h: float, gap: tuple[float, float, float] | None) -> None:
        """The wall itself, around a gap ``(x, width, height)``, with a skirting board."""
        d, m = self.d, self.m
        wall = m.walls[0] if d.chance(0.85) else m.walls[1]
        skirting = d.pick((0.0, 0.0, 0.08, 0.14))
        (nx, ny), _, _ = SIDES[int(body.yaw // 90) % 4]
        spans = [(-length / 2 - 0.12, length / 2 + 0.12)]
        if gap is None:  # a plane costs a third of a box
            self.shell.plane(body.position, (nx, ny, 0), wall)
        else:  # boxes around the gap; behind it, the far wall of the next room
            x, width, height = gap
            spans = [(spans[0][0], x - width / 2), (x + width / 2, spans[0][1])]
            body.box(x, -0.06, height, width, 0.12, h - height, wall)
            beyond = d.uniform(1.0, 4.0)
            back = (body.position[0] - nx * beyond, body.position[1] - ny * beyond, 0)
            self.shell.plane(back, (nx, ny, 0), m.walls[1])
        for low, high in spans:
            if gap is not None:
                body.box((low + high) / 2, -0.06, 0, high - low, 0.12, h, wall)
            if skirting:
                body.box((low + high) / 2, 0.006, 0, high - low, 0.012, skirting, m.trim)
        if d.chance(0.12):
            body.box(0, 0.01, d.uniform(0.8, 1.2), length, 0.02, 0.06, m.trim)
        if d.chance(0.15):
            body.box(0, 0.02, h - 0.1, length, 0.05, 0.1, m.trim)

    def _door(self, body: Body, x: float, width: float, height: float) -> tuple[float, float, float] | None:
        """A frame with a closed, ajar or missing door; returns the gap in the wall, if any."""
        d, m = self.d, self.m
        for s in (-1, 1):
            body.box(x + s * (width / 2 + 0.035), 0.005, 0, 0.07, 0.15 if width > 0 else 0, height, m.trim)
        body.box(x, 0.005, height, width + 0.14, 0.15, 0.07, m.trim)
        if width <= 1.0 and d.chance(0.55):
            body.box(x, 0.01, 0.0, width, 0.04, height, d.pick(m.doors))
            return None
        if width <= 1.0 and d.chance(0.7):  # open, hinged on one side, into the room
            s, angle = d.sign(), d.uniform(50, 100)
            leaf = Body(yaw=0)
            leaf.box(0, 0, 0, 0.04, width, height - 0.01, d.pick(m.doors), euler=(0, 0, s * (90 - angle)))
            # the leaf turns around its middle; place that so that the hinge stays on the frame
            turn = (90 - angle) / 90.0
            body.geoms += [g.replace('pos="0.0000 0.0000', f'pos="{x + s * width * (0.5 - 0.35 * turn):.4f} {width * 0.5:.4f}') for g in leaf.geoms]
        return x, width, height

    def _window(self, body: Body, length: float, h: float, taken: list[tuple[float, float]]) -> list[tuple[float, float]]:
        """Windows with frames, sills, blinds or curtains; the brightest lights the room."""
        d, m = self.d, self.m
        width, low = min(d.uniform(0.7, 2.4), length * 0.7), d.uniform(0.3, 1.2)
        high = min(h - 0.15, low + d.uniform(0.8, 1.6))
        x = d.uniform(-1, 1) * (length - width) * 0.45
        if high - low < 0.4 or _overlaps((x - width / 2, x + width / 2), taken):
            return []
        body.box(x, 0.0, low - 0.06, width + 0.14, 0.05, high - low + 0.12, m.trim)
        body.box(x, 0.012, low, width, 0.03, high - low, m.blind if d.chance(0.2) else m.window)
        body.box(x, 0.06, low - 0.06, width + 0.2, 0.14, 0.03, m.trim)
        if d.chance(0.55):
            bottom = d.pick((0.05, 0.3, max(0.05, low - 0.2)))
            reach = d.uniform(0.15, 0.6) * width
            for s in (-1, 1):
                if d.chance(0.85):
                    body.box(x + s * (width / 2 + 0.1 - reach / 4), 0.1, bottom, reach, 0.08, high + 0.08 - bottom, m.curtain)
            body.limb((x - width / 2 - 0.3, 0.1, high + 0.1), (x + width / 2 + 0.3, 0.1, high + 0.1), 0.014, m.metal)
        if d.chance(0.3) and low > 0.7:
            body.box(x, 0.07, 0.12, width * 0.8, 0.1, low - 0.3, m.blind)
        if m.daylight > 0:
            wx, wy = self._to_world(body, x, 0.35)
            power = 0.35 * m.daylight * (width * (high - low)) ** 0.5
            self.room.lights.append((wx, wy, (low + high) / 2, power * 0.95, power, power * 1.05, 3.0))
        return [(x - width / 2 - 0.1, x + width / 2 + 0.1)]

    def _to_world(self, body: Body, x: float, y: float) -> tuple[float, float]:
        (nx, ny), (ax, ay), _ = SIDES[int(body.yaw // 90) % 4]
        return body.position[0] + ax * x + nx * y, body.position[1] + ay * x + ny * y

    def _furnish(self, side: int, wall: Body, length: float, taken: list[tuple[float, float]], high: list[tuple[float, float]]) -> None:
        """Walk along the wall and set pieces side by side."""
        d = self.d
        x = -length / 2 + d.uniform(0.0, 0.5)
        density = d.uniform(0.65, 1.0)
        while x < length / 2 - 0.4:
            item: Item = d.pick(self.kind.along)
            width, depth = d.uniform(*item.width), d.uniform(*item.depth)
            if d.chance(1 - density):
                x += d.uniform(0.3, 1.0)
                continue
            span = (x, x + width)
            if span[1] > length / 2 or _overlaps(span, taken):
                x += 0.35
                continue
            offset = depth / 2 + d.uniform(0.01, 0.06)
            if self._place(item, wall, side, x + width / 2, offset, width, depth, SIDES[side][2]):
                if item.tall:
                    high.append(span)
            x += width + d.pick((0.02, 0.1, 0.3, 0.6))

    def _place(self, item: Item, wall: Body, side: int, x: float, offset: float, width: float, depth: float, yaw: float) -> bool:
        wx, wy = self._to_world(wall, x, offset)
        if side % 2:
            width, depth = depth, width
        if not self._free(wx, wy, width, depth):
            return False
        if side % 2:
            width, depth = depth, width
        self._make(item, wx, wy, width, depth, yaw + self.d.pick((0.0, 0.0, 0.0, self.d.uniform(-6, 6))))
        return True

    def _make(self, item: Item, wx: float, wy: float, width: float, depth: float, yaw: float) -> None:
        """Build a piece with its clutter and note where it stands."""
        body = Body((wx, wy, 0), yaw)
        for surface in item.maker(self.d, self.m, body, width, depth):
            f.clutter(self.d, self.m, body, surface, self.clutter)
        self.bodies.append(body)
        sideways = round(yaw / 90) % 2
        half = (depth / 2, width / 2) if sideways else (width / 2, depth / 2)
        height = 2.2 if item.tall else item.height
        self.room.obstacles.append((wx - half[0], wy - half[1], wx + half[0], wy + half[1], height))
        if item.maker is f.lamp:
            self.room.lights.append((wx, wy, 1.5, 0.5, 0.42, 0.3, 1.2))

    def _free(self, x: float, y: float, width: float, depth: float, margin: float = 0.0) -> bool:
        """Whether a rectangle lies inside the room and on nothing."""
        sx, sy, _ = self.room.size
        x0, y0, x1, y1 = x - width / 2 - margin, y - depth / 2 - margin, x + width / 2 + margin, y + depth / 2 + margin
        if x0 < -sx / 2 or x1 > sx / 2 or y0 < -sy / 2 or y1 > sy / 2:
            return False
        return all(x1 <= a or x0 >= c or y1 <= b or y0 >= e for a, b, c, e, _ in self.room.obstacles)

    def _block(self, side: int, x: float, width: float, depth: float, height: float) -> None:
        """Keep a place on the floor free of furniture (a door's swing)."""
        (nx, ny), (ax, ay), _ = SIDES[side]
        sx, sy, _ = self.room.size
        back = (sy if side % 2 == 0 else sx) / 2
        cx, cy = -nx * (back - depth / 2) + ax * x, -ny * (back - depth / 2) + ay * x
        half = (width / 2, depth / 2) if side % 2 == 0 else (depth / 2, width / 2)
        self.room.obstacles.append((cx - half[0], cy - half[1], cx + half[0], cy + half[1], height))

    def _columns(self) -> None:
        """Chimney breasts, closets in a corner, pillars."""
        d, (sx, sy, h) = self.d, self.room.size
        for _ in range(d.integer(0, 2) if d.chance(0.45) else 0):
            width, depth = d.uniform(0.25, 1.4), d.uniform(0.25, 0.9)
            x = d.sign() * (sx - width) / 2 if d.chance(0.75) else d.uniform(-0.3, 0.3) * sx
            y = d.sign() * (sy - depth) / 2 if d.chance(0.5) else d.uniform(-0.4, 0.4) * sy
            if self._free(x, y, width, depth):
                body = Body((x, y, 0))
                body.box(0, 0, 0, width, depth, h, d.pick(self.m.walls))
                self.bodies.append(body)
                self.room.obstacles.append((x - width / 2, y - depth / 2, x + width / 2, y + depth / 2, h))

    def _group(self) -> None:
        """Something in the open: a table with chairs, a sofa, a shelf as divider."""
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
            rug.box(0, 0, 0, width + d.uniform(0.2, 1.2), depth + d.uniform(0.2, 1.0), 0.012, self.m.rug)
            self.bodies.append(rug)
        self._make(item, x, y, width, depth, yaw)
        if item.maker in (f.table, f.round_table):
            self._chairs(x, y, *room)

    def _chairs(self, x: float, y: float, wx: float, wy: float) -> None:
        """Chairs around a table, some pulled out or turned."""
        d = self.d
        chair = Item(f.chair, (0.4, 0.5), (0.4, 0.5), 0.9)
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
                self._make(chair, cx, cy, d.uniform(*chair.width), d.uniform(*chair.depth), yaw + d.uniform(-25, 25))

    def _decorate(self, body: Body, length: float, h: float, high: list[tuple[float, float]]) -> None:
        """Pictures, boards, shelves, clocks, switches where the wall is free at eye height."""
        d, m = self.d, self.m
        for _ in range(d.integer(0, 2 + int(length))):
            width, height = d.uniform(0.2, 1.0), d.uniform(0.2, 0.8)
            x, z = d.uniform(-0.5, 0.5) * (length - width), d.uniform(1.1, 1.6)
            span = (x - width / 2, x + width / 2)
            if z + height > h - 0.05 or _overlaps(span, high):
                continue
            high.append(span)
            style = d.unit()
            if style < 0.65:
                body.box(x, 0.015, z, width, 0.03, height, d.pick((*m.pictures, *m.pictures, m.papers[0])))
            elif style < 0.8:
                body.box(x, 0.1, z, width, 0.2, 0.025, d.pick((*m.woods, m.white)))
                f.clutter(d, m, body, f.Surface(x, 0.1, z + 0.025, width, 0.15), 1.5)
            elif style < 0.9:
                body.cylinder(x, 0.02, z, height * 0.2, 0.03, d.pick(m.colors), euler=(90, 0, 0))
            else:
                body.box(x, 0.15, z + 0.1, width, 0.3, min(height, h - z - 0.15), d.pick(m.fronts))
        if d.chance(0.4):
            body.box(d.uniform(-0.4, 0.4) * length, 0.005, 1.1, 0.08, 0.01, 0.12, m.white)

    def _ceiling(self) -> None:
        """Lamps on or under the ceiling; without any, daylight and ambient have to do."""
        d, m, (sx, sy, h) = self.d, self.m, self.room.size
        lit = d.chance(0.75) or not self.room.lights
        tone = d.pick(((1.0, 0.96, 0.9), (1.0, 0.85, 0.65), (0.92, 0.97, 1.0)))
        nx, ny = max(1, round(sx / 3.5)), max(1, round(sy / 3.5))
        style, power = d.integer(0, 3), d.uniform(0.5, 1.3) / (nx * ny) ** 0.35
        body = Body((0, 0, 0))
        for i in range(min(nx, 3)):
            for j in range(min(ny, 3)):
                x = ((i + 0.5) / nx - 0.5) * sx + d.uniform(-0.2, 0.2)
                y = ((j + 0.5) / ny - 0.5) * sy + d.uniform(-0.2, 0.2)
                drop = 0.05
                if style == 0:
                    body.box(x, y, h - 0.04, 1.2, 0.3, 0.04, m.lamp if lit else m.white)
                elif style == 1:
                    body.ellipsoid(x, y, h - 0.05, 0.2, 0.2, 0.1, m.lamp if lit else m.white)
                elif style == 2 and h > 2.3:
                    drop = d.uniform(0.4, 0.8)
                    body.cylinder(x, y, h - drop, 0.008, drop, m.dark)
                    body.ellipsoid(x, y, h - drop, 0.2, 0.2, 0.14, m.lamp if lit else m.shade)
                if lit and len(self.room.lights) < 6:
                    self.room.lights.append((x, y, h - drop - 0.25, *(power * t for t in tone), 2.2))
        if body.geoms:
            self.bodies.append(body)
        self.room.ambient = d.uniform(0.1, 0.4)

    def _people(self) -> None:
        """Now and then somebody."""
        d, (sx, sy, _) = self.d, self.room.size
        for _ in range(d.pick((0, 0, 0, 0, 1, 1, 2))):
            x, y = d.uniform(-0.4, 0.4) * sx, d.uniform(-0.4, 0.4) * sy
            if self._free(x, y, 0.5, 0.4):
                self._make(Item(f.person, (0.5, 0.5), (0.4, 0.4), 1.8, True), x, y, 0.5, 0.4, d.uniform(0, 360))

    def _on_floor(self) -> None:
        """Baskets, cartons, clothes and small things that lie about."""
        d, (sx, sy, _) = self.d, self.room.size
        width = d.uniform(0.2, 0.45)
        x, y = d.uniform(-0.45, 0.45) * sx, d.uniform(-0.45, 0.45) * sy
        if not self._free(x, y, width, width):
            return
        if d.chance(0.5):
            self._make(Item(f.basket, (0.2, 0.5), (0.2, 0.5), 0.5), x, y, width, width, d.uniform(0, 360))
        else:
            body = Body((x, y, 0), d.uniform(0, 360))
            f.thing(d, self.m, body, 0, 0, 0)
            self.bodies.append(body)


def _overlaps(span: tuple[float, float], others: list[tuple[float, float]]) -> bool:
    return any(span[0] < high and span[1] > low for low, high in others)

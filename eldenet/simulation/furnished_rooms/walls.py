"""Walls with doors, windows, baseboards and pictures."""

from eldenet.simulation.furnished_rooms.furniture import Surface
from eldenet.simulation.furnished_rooms.household import clutter
from eldenet.simulation.rendering.materials import Materials
from eldenet.simulation.rendering.mjcf import Body, Draw

#: Per wall (south, east, north, west): inward normal, direction of the wall's own x, yaw of furniture on it.
SIDES = (
    ((0.0, 1.0), (1.0, 0.0), 0.0),
    ((-1.0, 0.0), (0.0, 1.0), 90.0),
    ((0.0, -1.0), (-1.0, 0.0), 180.0),
    ((1.0, 0.0), (0.0, -1.0), 270.0),
)

Span = tuple[float, float]  # low and high x along the wall [m]


def overlaps(span: Span, others: list[Span]) -> bool:
    """Whether a span overlaps any of the others."""
    return any(span[0] < high and span[1] > low for low, high in others)


class Wall:
    """One wall of a room of ``size`` [m]; ``side`` is its place in :data:`SIDES`.

    Its frame has x along the wall, y into the room, the origin in the middle on the floor.
    """

    def __init__(self, draw: Draw, materials: Materials, side: int, size: tuple[float, float, float]) -> None:
        self.d, self.m, self.side = draw, materials, side
        along_x = side % 2 == 0
        self.length, self.height = size[0] if along_x else size[1], size[2]  # [m]
        self.normal, self.along, self.yaw = SIDES[side]
        back = (size[1] if along_x else size[0]) / 2
        self.body = Body((-self.normal[0] * back, -self.normal[1] * back, 0.0), self.yaw)
        self.taken: list[Span] = []  # by doors
        self.high: list[Span] = []  # in use at eye height
        self.doorway: tuple[float, float] | None = None  # x and width of a door to keep free [m]
        self.lights: list[tuple[float, ...]] = []  # rows of Room.lights
        self.windows: list[tuple[float, float, float, float]] = []  # x, width, lower and upper edge [m]

    def to_world(self, x: float, y: float) -> tuple[float, float]:
        """Return a point of the wall's frame in the room's floor coordinates."""
        (nx, ny), (ax, ay) = self.normal, self.along
        return self.body.position[0] + ax * x + nx * y, self.body.position[1] + ay * x + ny * y

    def build(self, shell: Body) -> None:
        """Add door, wall and window; planes go to ``shell``."""
        d = self.d
        gap = self._door() if d.chance(0.75 if self.side == 0 else 0.25) and self.length > 1.8 else None
        self._surface(shell, gap)
        if d.chance(0.55):
            self._window()
        self.high += self.taken

    def _door(self) -> tuple[float, float, float] | None:
        """Add a frame with a closed, open or no door; return the gap ``(x, width, height)``, if any."""
        d, m, body = self.d, self.m, self.body
        width, height = d.uniform(0.75, 1.0), min(self.height - 0.1, d.uniform(1.95, 2.15))
        if d.chance(0.25):
            width = min(d.uniform(1.0, 2.2), self.length - 0.6)
        x = d.uniform(-1, 1) * (self.length - width - 0.3) / 2
        self.taken.append((x - width / 2 - 0.15, x + width / 2 + 0.15))
        self.doorway = (x, width)
        for s in (-1, 1):
            body.box((x + s * (width / 2 + 0.035), 0.005, 0), (0.07, 0.15, height), m.trim)
        body.box((x, 0.005, height), (width + 0.14, 0.15, 0.07), m.trim)
        if width <= 1.0 and d.chance(0.55):
            body.box((x, 0.01, 0.0), (width, 0.04, height), d.pick(m.doors))
            return None
        if width <= 1.0 and d.chance(0.7):
            self._open_leaf(x + d.sign() * width / 2, width, height)
        return x, width, height

    def _open_leaf(self, hinge: float, width: float, height: float) -> None:
        """Add a door that opens into the room; its sines are constants, the same on every machine."""
        turns = ((0.0, 1.0, 0.0), (15.0, 0.9659, 0.2588), (30.0, 0.8660, 0.5), (-10.0, 0.9848, -0.1736))
        turn, cosine, sine = self.d.pick(turns)
        self.body.box(
            (hinge - sine * width / 2, 0.06 + cosine * width / 2, 0),
            (0.04, width, height - 0.01),
            self.d.pick(self.m.doors),
            euler=(0, 0, turn),
        )

    def _surface(self, shell: Body, gap: tuple[float, float, float] | None) -> None:
        """Add the wall itself, around a gap, with baseboard, chair rail and cornice."""
        d, m, body, h, length = self.d, self.m, self.body, self.height, self.length
        wall = m.walls[0] if d.chance(0.85) else m.walls[1]
        baseboard = d.pick((0.0, 0.0, 0.08, 0.14))
        normal = (*self.normal, 0.0)
        spans = [(-length / 2 - 0.12, length / 2 + 0.12)]
        if gap is None:  # a plane costs a third of a box
            shell.plane(body.position, normal, wall)
        else:  # boxes around the gap; behind it, the far wall of the next room
            x, width, height = gap
            spans = [(spans[0][0], x - width / 2), (x + width / 2, spans[0][1])]
            body.box((x, -0.06, height), (width, 0.12, h - height), wall)
            self._next_room(shell, x, width)
        for low, high in spans:
            if gap is not None:
                body.box(((low + high) / 2, -0.06, 0), (high - low, 0.12, h), wall)
            if baseboard:
                body.box(((low + high) / 2, 0.006, 0), (high - low, 0.012, baseboard), m.trim)
        if d.chance(0.12):
            body.box((0, 0.01, d.uniform(0.8, 1.2)), (length, 0.02, 0.06), m.trim)
        if d.chance(0.15):
            body.box((0, 0.02, h - 0.1), (length, 0.05, 0.1), m.trim)

    def _next_room(self, shell: Body, x: float, width: float) -> None:
        """Add what a gap shows: a far wall, something in front of it, perhaps a light."""
        d, m, body = self.d, self.m, self.body
        beyond = d.uniform(1.2, 4.5)
        shell.plane((*self.to_world(0.0, -beyond), 0.0), (*self.normal, 0.0), m.walls[1])
        for _ in range(d.integer(0, 3)):
            wx, wz = d.uniform(0.3, 1.2), d.pick((0.5, 0.8, 1.2, 2.0))
            y = -beyond + 0.25 if d.chance(0.6) else -d.uniform(0.5, max(0.6, beyond - 0.3))
            body.box(
                (x + d.uniform(-1, 1) * width, y, 0),
                (wx, 0.45, wz),
                d.pick((*m.fronts, *m.woods, *m.fabrics, *m.books)),
            )
        if d.chance(0.5):
            body.box(
                (x + d.uniform(-0.5, 0.5) * width, -beyond + 0.02, 1.2), (0.6, 0.03, 0.5), d.pick(m.pictures)
            )
        if d.chance(0.6):
            self.lights.append((*self.to_world(x, -beyond / 2), self.height - 0.4, 0.6, 0.55, 0.45, 1.2))

    def _window(self) -> None:
        """Add a window with frame, sill, blind or curtains, radiator; by day it lights the room."""
        d, m, body = self.d, self.m, self.body
        width, low = min(d.uniform(0.7, 2.4), self.length * 0.7), d.uniform(0.3, 1.2)
        high = min(self.height - 0.15, low + d.uniform(0.8, 1.6))
        x = d.uniform(-1, 1) * (self.length - width) * 0.45
        if high - low < 0.4 or overlaps((x - width / 2, x + width / 2), self.taken):
            return
        body.box((x, 0.0, low - 0.06), (width + 0.14, 0.05, high - low + 0.12), m.trim)
        body.box((x, 0.012, low), (width, 0.03, high - low), m.blind if d.chance(0.2) else m.window)
        body.box((x, 0.06, low - 0.06), (width + 0.2, 0.14, 0.03), m.trim)
        if d.chance(0.55):
            self._curtains(x, width, low, high)
        if d.chance(0.3) and low > 0.7:
            body.box((x, 0.07, 0.12), (width * 0.8, 0.1, low - 0.3), m.blind)
        self.windows.append((x, width, low, high))
        if m.daylight > 0:
            power = 0.35 * m.daylight * (width * (high - low)) ** 0.5
            place = (*self.to_world(x, 0.35), (low + high) / 2)
            self.lights.append((*place, power * 0.95, power, power * 1.05, 3.0))
        self.high.append((x - width / 2 - 0.1, x + width / 2 + 0.1))

    def _curtains(self, x: float, width: float, low: float, high: float) -> None:
        d, body, bottom = self.d, self.body, self.d.pick((0.05, 0.3, max(0.05, low - 0.2)))
        reach = d.uniform(0.15, 0.6) * width
        for s in (-1, 1):
            if d.chance(0.85):
                middle = x + s * (width / 2 + 0.1 - reach / 4)
                body.box((middle, 0.1, bottom), (reach, 0.08, high + 0.08 - bottom), self.m.curtain)
        end = width / 2 + 0.3
        body.limb((x - end, 0.1, high + 0.1), (x + end, 0.1, high + 0.1), 0.014, self.m.metal)

    def decorate(self) -> None:
        """Add pictures, shelves, clocks, wall cabinets and switches where the wall is free at eye height."""
        d, m, body = self.d, self.m, self.body
        for _ in range(d.integer(0, 2 + int(self.length))):
            width, height = d.uniform(0.2, 1.0), d.uniform(0.2, 0.8)
            x, z = d.uniform(-0.5, 0.5) * (self.length - width), d.uniform(1.1, 1.6)
            span = (x - width / 2, x + width / 2)
            if z + height > self.height - 0.05 or overlaps(span, self.high):
                continue
            self.high.append(span)
            style = d.unit()
            if style < 0.65:
                body.box(
                    (x, 0.015, z), (width, 0.03, height), d.pick((*m.pictures, *m.pictures, m.papers[0]))
                )
            elif style < 0.8:
                body.box((x, 0.1, z), (width, 0.2, 0.025), d.pick((*m.woods, m.white)))
                clutter(d, m, body, Surface(x, 0.1, z + 0.025, width, 0.15), 1.5)
            elif style < 0.9:
                body.cylinder((x, 0.02, z), height * 0.2, 0.03, d.pick(m.colors), euler=(90, 0, 0))
            else:
                body.box(
                    (x, 0.15, z + 0.1), (width, 0.3, min(height, self.height - z - 0.15)), d.pick(m.fronts)
                )
        if d.chance(0.4):
            body.box((d.uniform(-0.4, 0.4) * self.length, 0.005, 1.1), (0.08, 0.01, 0.12), m.white)

"""Streets and halls with objects whose boxes are known; :mod:`.street_views` renders them.

A scene depends on ``(split, index, kind)`` alone; its seeds start with ``STREAM``.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from eldenet.simulation import vehicles
from eldenet.simulation.furnished_rooms import household
from eldenet.simulation.furnished_rooms.rooms import SPLITS, Room
from eldenet.simulation.rendering.materials import Materials, jitter
from eldenet.simulation.rendering.mjcf import Body, Draw, world_text
from eldenet.simulation.rendering.textures import variants
from eldenet.simulation.street_furniture import PARKING, StreetFurniture
from eldenet.system.checks import one_of

KINDS = ("street", "hall", "crossing")
NAMES = ("car", "van", "truck", "person", "box", "pillar")  # cyclists are in crossings alone
FAR = {"street": 120.0, "hall": 40.0, "crossing": 120.0}  # [m]
STREAM = 7

Range = tuple[float, float]
# length, width, height [m]: mean and deviation; of cars, vans and cyclists over KITTI's tracking labels
_SIZES: dict[str, tuple[Range, Range, Range]] = {
    "car": ((3.90, 0.43), (1.61, 0.11), (1.52, 0.12)),
    "van": ((4.93, 0.45), (1.86, 0.12), (2.16, 0.25)),
    "cyclist": ((1.77, 0.10), (0.60, 0.05), (1.71, 0.07)),
    "truck": ((8.0, 1.5), (2.45, 0.15), (3.1, 0.3)),
    "box": ((0.8, 0.25), (0.6, 0.15), (0.7, 0.25)),
    "pillar": ((0.4, 0.08), (0.4, 0.08), (2.6, 0.3)),
}
_MAKERS: dict[str, Callable[..., None]] = {
    "car": vehicles.car,
    "van": vehicles.van,
    "truck": vehicles.truck,
    "box": vehicles.carton,
    "pillar": vehicles.pillar,
}


class Scene(NamedTuple):
    """A street or hall ready to compile, the names of its objects, and where the camera stands."""

    room: Room
    names: list[str]
    sky: tuple[float, float, float]  # linear RGB
    camera_height: float  # [m]
    tilt: tuple[float, float]  # pitch upwards and roll of the camera [rad]


def generate_scene(split: str, index: int, kind: str = "street", detail: bool = False) -> Scene:
    """Generate scene ``index`` of a split; the first bodies of the model are its objects.

    With ``detail`` a street has sidewalks, trees, poles, signs and house fronts; a hall looks natural.
    """
    one_of("kind", kind, KINDS)
    details = Draw((STREAM, SPLITS[split], index, len(KINDS))) if detail else None
    return _Builder(Draw((STREAM, SPLITS[split], index, KINDS.index(kind))), kind, details).build()


class _Builder:
    """Places objects where there is room; world x is ahead of the camera, y to its left.

    ``details`` are the draws of what ``detail`` adds; None: nothing.
    """

    def __init__(self, draw: Draw, kind: str, details: Draw | None) -> None:
        self.d, self.kind = draw, kind
        self.m = Materials(draw, natural=details is not None)
        self.paint = vehicles.paints(draw, self.m.palette)
        self.bodies: list[Body] = []
        self.names: list[str] = []
        self.taken: list[tuple[float, float, float]] = []  # circles x, y, radius [m]
        self.shell = Body()
        self.furniture = None if details is None else StreetFurniture(details, self.m, self.shell)

    def build(self) -> Scene:
        d = self.d
        if self.kind != "hall":
            self._street()
            room = Room("street", (400.0, 400.0, 200.0), ambient=d.uniform(0.35, 0.6))
            sun = (d.uniform(-60, 20), d.uniform(-60, 60), 120.0)
            room.lights.append((*sun, 0.25, 0.24, 0.22, 1000.0))
            camera, tilt = d.uniform(1.5, 1.8), (d.uniform(-0.017, 0.017), d.uniform(-0.012, 0.012))
        else:
            room = self._hall()
            camera, tilt = d.uniform(0.5, 1.5), (d.uniform(-0.06, 0.02), d.uniform(-0.012, 0.012))
        parts = [body.text() for body in (*self.bodies, self.shell)]
        room.text = world_text("street", self.m.palette, parts)
        room.detail = self.furniture is not None
        tone = d.uniform(0.6, 1.0)
        return Scene(room, self.names, (0.55 * tone, 0.7 * tone, 0.95 * tone), camera, tilt)

    def _street(self) -> None:
        """A road with parked and driving cars, people on the sidewalks, houses behind them.

        A crossing has more people, also on the road, and cyclists.
        """
        d = self.d
        gray = jitter(d, (0.22, 0.22, 0.23), 0.06)
        asphalt = self.m.palette.add([gray, (0.3, 0.3, 0.3), (0.15, 0.15, 0.15)], variants("speckle")[0], 1.5)
        mark = self.m.palette.add([(0.7, 0.7, 0.68)], variants("plain")[0], 1.0)
        self.shell.plane((0, 0, 0), (0, 0, 1), asphalt)
        half = d.uniform(4.0, 6.5)
        for start in range(4, 80, 8):
            self.shell.box((start, -d.uniform(1.6, 1.8), 0), (3, 0.14, 0.004), mark)
        for side in (-1, 1):
            sidewalk = d.uniform(2, 4)
            edge = side * (half + PARKING + sidewalk)
            x = -5.0
            while x < 110.0:
                wide, deep, tall = d.uniform(6, 16), d.uniform(4, 8), d.uniform(3, 12)
                if d.chance(0.8):
                    y = edge + side * (deep / 2 + d.uniform(0, 2))
                    walls = self.m.walls if self.furniture is None else self.furniture.fronts
                    self.shell.box((x + wide / 2, y, 0), (wide, deep, tall), d.pick(walls))
                    if self.furniture is not None:
                        self.furniture.roof(x + wide / 2, y, wide, deep, tall)
                x += wide + d.uniform(0, 5)
            if self.furniture is not None:
                self.furniture.side(side, half, sidewalk)
            self._row(side, half, parked=True)
            for _ in range(d.integer(1, 4)):
                x, y = d.uniform(5, 40), side * (half + d.uniform(1.3, 2.5 + sidewalk))
                self._put("person", x, y, d.uniform(0, 360))
            if d.chance(0.5):
                self._put("pillar", d.uniform(6, 40), side * (half + d.uniform(1.3, 2.2)), 0.0)
        if self.kind == "crossing":
            self._walkers(half)
        self._row(1, 1.6, parked=False)
        self._row(-1, 3.2, parked=False)
        for _ in range(d.integer(0, 2)):  # crossing or turning
            name = d.pick(("car", "van", "person"))
            self._put(name, d.uniform(10, 45), d.uniform(-3, 3), d.uniform(0, 360))

    def _walkers(self, half: float) -> None:
        """People who cross or wait, and cyclists along the road."""
        d = self.d
        for _ in range(d.integer(4, 10)):
            self._put("person", d.uniform(6, 40), d.uniform(-half - 4, half + 4), d.uniform(0, 360))
        for _ in range(d.integer(4, 9)):
            yaw = d.pick((90.0, 90.0, -90.0, -90.0, d.uniform(0, 360))) + d.uniform(-8, 8)
            self._put("cyclist", d.uniform(6, 45), d.uniform(-half, half), yaw)

    def _row(self, side: int, away: float, *, parked: bool) -> None:
        """Vehicles in a row along the road."""
        d = self.d
        x = d.uniform(3, 12)
        while x < 70:
            name = d.pick(("car",) * 8 + ("van", "van", "truck"))
            if d.chance(0.65 if parked else 0.3):
                turned = d.chance(0.5) if parked else side > 0
                self._put(name, x, side * away, (90.0 if turned else -90.0) + d.uniform(-4, 4))
            x += d.uniform(5.5, 9) if parked else d.uniform(10, 25)

    def _hall(self) -> Room:
        """A big room with people, cartons and pillars."""
        d = self.d
        room = Room("hall", (2 * d.uniform(12, 18), d.uniform(8, 16), d.uniform(2.8, 4.5)))
        sx, sy, tall = room.size
        self.shell.plane((0, 0, 0), (0, 0, 1), self.m.floor)
        self.shell.plane((0, 0, tall), (0, 0, -1), self.m.ceiling)
        for x, y, nx, ny in ((sx / 2, 0, -1, 0), (-sx / 2, 0, 1, 0), (0, sy / 2, 0, -1), (0, -sy / 2, 0, 1)):
            self.shell.plane((x, y, 0), (nx, ny, 0), d.pick(self.m.walls))
        for _ in range(d.integer(6, 14)):
            name = d.pick(("person", "person", "box", "box", "box", "pillar"))
            x = d.uniform(1.5, min(10.0, sx / 2 - 1))
            self._put(name, x, d.uniform(-0.45, 0.45) * min(sy, 1.7 * x), d.uniform(0, 360))
        for x in (2.5, 7.5):
            room.lights.append((x, d.uniform(-2, 2), tall - 0.3, 0.9, 0.85, 0.8, 3.0))
        room.ambient = d.uniform(0.2, 0.45)
        return room

    def _put(self, name: str, x: float, y: float, yaw: float) -> None:
        """Add an object unless it would overlap another or begin less than 1 m ahead of the camera."""
        d = self.d
        if name == "person":
            length, width, tall = 0.6, 0.6, 1.75
        else:
            length, width, tall = (mean + d.uniform(-1.6, 1.6) * std for mean, std in _SIZES[name])
        radius = max(width, length if name in ("person", "box", "pillar") else length / 2) * 0.6
        front = np.array([-np.sin(np.radians(yaw)), np.cos(np.radians(yaw))])
        reach = max(0.0, length / 2 - radius)
        circles = [(x + s * reach * front[0], y + s * reach * front[1], radius) for s in (-1.0, 0.0, 1.0)]
        for cx, cy, r in circles:
            if cx < r + 1 or any(
                (cx - a) ** 2 + (cy - b) ** 2 < (r + c + 0.1) ** 2 for a, b, c in self.taken
            ):
                return
        self.taken += circles
        body = Body((x, y, 0), yaw)
        if name == "person":
            household.person(d, self.m, body, width, length)
        elif name == "cyclist":
            vehicles.cyclist(d, self.paint, self.m, body, length, width, tall)
        else:
            _MAKERS[name](d, self.paint, body, length, width, tall)
        self.bodies.append(body)
        self.names.append(name)

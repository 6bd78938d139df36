"""What stands along a street: sidewalks, trees, lamp posts, signs, hedges, fences, house fronts.

World coordinates as in :mod:`eldenet.simulation.streets`: x ahead, y to the left; a street's ``side`` is 1
(left) or -1. Everything goes into one body, for only objects with a label need bodies of their own.
"""

import numpy as np

from eldenet.simulation.rendering.materials import Materials, jitter, natural_color
from eldenet.simulation.rendering.mjcf import Body, Color, Draw
from eldenet.simulation.rendering.textures import variants

_SIGNS: tuple[Color, ...] = ((0.6, 0.05, 0.05), (0.05, 0.15, 0.5), (0.8, 0.8, 0.8), (0.75, 0.6, 0.05))
END = 90.0  # [m] of the street
PARKING = 2.2  # width of the parking lane on each side of the road [m]


class StreetFurniture:
    """Adds what stands along a street to a body."""

    def __init__(self, draw: Draw, materials: Materials, body: Body) -> None:
        self.d, self.m, self.b = draw, materials, body
        d = draw
        plain, add = variants("plain")[0], materials.palette.add
        slab = jitter(d, (0.4, 0.39, 0.37), 0.06)
        self.slabs = add([slab, (0.3, 0.3, 0.29), (0.25, 0.25, 0.25)], d.pick(variants("tiles")), 1.5)
        self.curb = add([jitter(d, (0.5, 0.5, 0.48), 0.06)], variants("plaster")[0], 1.0)
        self.bark = add([(0.2, 0.15, 0.1), (0.12, 0.09, 0.06), (0.3, 0.25, 0.2)], variants("grain")[0], 0.5)
        green = jitter(d, (0.12, 0.22, 0.06), 0.05)
        light = (green[0] * 1.8, green[1] * 1.6, green[2] * 1.5)
        self.leaves = add([green, light, (0.04, 0.08, 0.02)], d.pick(variants("foliage")), 0.8)
        self.lawn = add([green, light, (0.2, 0.2, 0.08)], variants("carpet")[0], 2.0)
        self.signs = [add([color], plain, 1.0) for color in _SIGNS]
        self.poles = [materials.metal, materials.dark]
        walls = (natural_color(d, 0.5), natural_color(d, 0.5), (0.5, 0.28, 0.2), (0.7, 0.66, 0.58))
        self.fronts = [
            add([wall, (0.05, 0.06, 0.08), jitter(d, (0.7, 0.7, 0.68))], front, d.uniform(7, 12), offset=0.5)
            for wall in walls
            for front in (d.pick(variants("facade")),)
        ]

    def side(self, side: int, half: float, sidewalk: float) -> None:
        """Add one side of a street, beyond half of the road and the parking lane [m]."""
        d, near = self.d, half + PARKING
        self.b.box((END / 2 - 5, side * (near + sidewalk / 2), 0), (END + 10, sidewalk, 0.12), self.slabs)
        self.b.box((END / 2 - 5, side * (near - 0.07), 0), (END + 10, 0.15, 0.13), self.curb)
        if d.chance(0.4):  # a lawn behind the sidewalk
            self.b.box((END / 2 - 5, side * (near + sidewalk + 2), 0), (END + 10, 4.0, 0.1), self.lawn)
        for gap, chance, add in (
            (d.uniform(7, 14), d.pick((0.0, 0.5, 0.9)), self._tree),
            (d.uniform(18, 30), 0.85, self._lamp_post),
            (d.uniform(10, 25), 0.6, self._sign),
            (d.uniform(8, 20), 0.3, self._small),
        ):
            x = d.uniform(4, 4 + gap)
            while x < END:
                if d.chance(chance):
                    add(x, side, near + d.uniform(0.3, 0.9))
                x += gap * d.uniform(0.7, 1.3)
        x = d.uniform(0, 8)
        while x < END + 20:  # trees behind the houses and at the end of the street
            crown, y = d.uniform(2.0, 4.5), side * (near + sidewalk + d.uniform(9, 16))
            y = side * d.uniform(0, 8) if x > END else y
            self.b.ellipsoid((x, y, crown), (crown, crown, crown * d.uniform(0.9, 1.6)), self.leaves)
            x += d.uniform(3, 10) if x < END else 2.0
        x = 0.0
        while x < END:  # in front of the houses
            long = d.uniform(3, 15)
            if d.chance(0.3):
                tall, material = d.uniform(0.5, 1.9), d.pick((self.leaves, self.leaves, *self.m.woods))
                self.b.box((x + long / 2, side * (near + sidewalk + 0.3), 0), (long, 0.4, tall), material)
            x += long

    def roof(self, x: float, y: float, wide: float, deep: float, tall: float) -> None:
        """Add a roof and a chimney to a house."""
        d, tile = self.d, self.d.pick((*self.m.woods, self.m.dark, self.m.walls[1]))
        if d.chance(0.5):
            for s in (-1, 1):
                self.b.box((x, y + s * deep * 0.26, tall), (wide, deep * 0.62, 0.15), tile, (s * -35, 0, 0))
        else:
            self.b.box((x, y, tall), (wide + 0.3, deep + 0.3, 0.25), tile)
        if d.chance(0.5):
            self.b.box((x + d.uniform(-0.3, 0.3) * wide, y, tall), (0.6, 0.6, 1.6), self.m.walls[0])

    def _tree(self, x: float, side: int, away: float) -> None:
        d, y = self.d, side * away
        trunk, crown = d.uniform(1.8, 3.2), d.uniform(0.9, 2.2)
        self.b.limb(
            (x, y, 0), (x + d.uniform(-0.2, 0.2), y, trunk + crown * 0.6), d.uniform(0.08, 0.2), self.bark
        )
        for _ in range(d.integer(3, 7)):
            spot = [d.uniform(-0.6, 0.6) * crown for _ in range(3)]
            radii = (crown * d.uniform(0.4, 0.8), crown * d.uniform(0.4, 0.8), crown * d.uniform(0.35, 0.7))
            self.b.ellipsoid((x + spot[0], y + spot[1], trunk + crown + spot[2]), radii, self.leaves)

    def _lamp_post(self, x: float, side: int, away: float) -> None:
        d, y, pole = self.d, side * away, self.d.pick(self.poles)
        tall, arm = d.uniform(4.5, 8.0), d.uniform(0.3, 1.8)
        self.b.limb((x, y, 0), (x, y, tall), d.uniform(0.05, 0.1), pole)
        self.b.limb((x, y, tall), (x, y - side * arm, tall + 0.2), 0.04, pole)
        self.b.box((x, y - side * arm, tall + 0.12), (0.2, 0.6, 0.1), self.m.white)

    def _sign(self, x: float, side: int, away: float) -> None:
        d, y, tall, plate = self.d, side * away, self.d.uniform(1.9, 2.8), self.d.pick(self.signs)
        self.b.limb((x, y, 0), (x, y, tall), 0.035, self.m.metal)
        width = d.uniform(0.4, 0.8)
        if d.chance(0.5):
            self.b.cylinder((x - 0.04, y, tall), width / 2, 0.03, plate, euler=(0, 90, 0))
        else:
            self.b.box((x - 0.04, y, tall - 0.2), (0.03, width, d.uniform(0.3, 0.9)), plate)

    def _small(self, x: float, side: int, away: float) -> None:
        """Bin, bollard, post box, bush."""
        d, y = self.d, side * away
        if d.chance(0.4):
            self.b.cylinder((x, y, 0.1), d.uniform(0.06, 0.3), d.uniform(0.6, 1.1), d.pick(self.m.colors))
        elif d.chance(0.5):
            self.b.box((x, y, 0.1), (0.5, 0.6, d.uniform(0.8, 1.3)), d.pick((*self.m.colors, *self.signs)))
        else:
            self.b.ellipsoid((x, y, 0.5), (0.6, 0.5, d.uniform(0.4, 0.8)), self.leaves)


def sky_color(rays: np.ndarray, tone: tuple[float, float, float], draw: Draw) -> np.ndarray:
    """Return the sky's light ``(N, 3)`` in directions ``(N, 3)``: white at the horizon, with clouds."""
    up = np.clip(rays[:, 2], 0, 1)
    haze = np.exp(-up / draw.uniform(0.05, 0.4))
    across = np.arctan2(rays[:, 1], rays[:, 0])
    clouds, cover = np.zeros(len(rays)), draw.uniform(-0.4, 1.2)
    for octave in range(1, 5):
        a, b = draw.uniform(0, 6.3), draw.uniform(0, 6.3)
        clouds += np.sin(3 * octave * across + a + 2 * up) * np.sin(14 * octave * up + b + across) / octave
    white = np.clip(haze + np.clip(clouds * 0.5 + cover - 0.3, 0, 1), 0, 1)[:, None]
    blue = np.array(tone, dtype=np.float64)
    return (white * max(tone) * 1.1 + (1 - white) * blue).astype(np.float32)

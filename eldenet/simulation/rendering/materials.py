"""Materials of one room, in colors that occur indoors."""

import colorsys

from eldenet.simulation.rendering.mjcf import Color, Draw, Palette
from eldenet.simulation.rendering.textures import variants

WALLS: tuple[Color, ...] = (
    (0.80, 0.78, 0.73), (0.76, 0.72, 0.63), (0.72, 0.72, 0.71), (0.70, 0.64, 0.52), (0.80, 0.74, 0.58),
    (0.62, 0.68, 0.70), (0.66, 0.70, 0.60), (0.58, 0.52, 0.44), (0.74, 0.60, 0.50), (0.84, 0.84, 0.83),
)  # fmt: skip
WOODS: tuple[Color, ...] = (
    (0.55, 0.37, 0.20), (0.42, 0.25, 0.13), (0.28, 0.15, 0.08), (0.66, 0.50, 0.32), (0.72, 0.60, 0.43),
    (0.20, 0.12, 0.08), (0.48, 0.30, 0.20), (0.60, 0.42, 0.22), (0.35, 0.30, 0.26),
)  # fmt: skip
WHITE = WALLS[-1]
#: Patterns of walls, floors, furniture and cloths.
SURFACES = (
    "plaster", "planks", "grain", "tiles", "bricks", "carpet", "speckle", "stripes", "plaid", "blobs",
    "crumple", "tufted", "fronts",
)  # fmt: skip
SKINS: tuple[Color, ...] = ((0.80, 0.60, 0.48), (0.66, 0.45, 0.33), (0.45, 0.29, 0.20), (0.30, 0.19, 0.13))


def shade(color: Color, factor: float) -> Color:
    """Return a lighter or darker tone, below full white."""
    return (min(0.95, color[0] * factor), min(0.95, color[1] * factor), min(0.95, color[2] * factor))


def jitter(draw: Draw, color: Color, amount: float = 0.06) -> Color:
    """Return the color with a small random change."""
    r, g, b = (min(0.95, max(0.02, c + draw.uniform(-amount, amount))) for c in color)
    return (r, g, b)


def any_color(draw: Draw, saturation: float = 0.8) -> Color:
    """Draw any color, gray, dark and muted ones more often than bright ones."""
    value = draw.uniform(0.2, 0.97) ** 1.7 + 0.02
    color = colorsys.hsv_to_rgb(draw.unit(), saturation * draw.unit() ** 1.5 + 0.08 * draw.unit(), value)
    return (color[0], color[1], color[2])


def natural_color(draw: Draw, saturation: float = 0.8) -> Color:
    """Draw a color as people buy things: gray, beige, brown and navy far more often than pink or green."""
    hue = draw.pick((0.02, 0.06, 0.08, 0.1, 0.12, 0.58, 0.62)) if draw.chance(0.8) else draw.unit()
    value = draw.uniform(0.1, 0.95) ** 1.5 + 0.02
    strength = saturation * draw.uniform(0.05, 0.6) * (1.0 if draw.chance(0.85) else 1.7)
    color = colorsys.hsv_to_rgb((hue + draw.uniform(-0.02, 0.02)) % 1.0, min(1.0, strength), value)
    return (color[0], color[1], color[2])


class Materials:
    """Material numbers of one room, by role; lists hold several to choose from.

    Args:
        draw: of the room.
        natural: colors and patterns as most homes and offices have them; without it, any color.
        plain: walls, floor, furniture and cloths without a pattern; pictures, books and prints keep theirs.
    """

    def __init__(self, draw: Draw, natural: bool = False, plain: bool = False) -> None:
        self.draw, self.palette, self.natural, self.plain = draw, Palette(), natural, plain
        self.wood_colors = [jitter(draw, draw.pick(WOODS)) for _ in range(3)]
        self.walls = [self._wall() for _ in range(2)]
        self.floor = self._floor()
        ceiling = shade(jitter(draw, WHITE, 0.04), draw.uniform(0.8, 1.05))
        self.ceiling = self._add(ceiling, draw.pick(("plain", "tiles", "plaster")), 2.4)
        trim = jitter(draw, draw.pick((WHITE, WALLS[0], self.wood_colors[0])))
        self.trim = self._add(trim, "plain", 1.0, gloss=0.2)
        self.woods = [self._wood(i) for i in range(3)]
        self.fronts = [self._front(i) for i in range(3)]
        self.doors = [self._door(i) for i in range(2)]
        self.fabrics = [self.fabric() for _ in range(5)]
        self.beddings = [self.bedding() for _ in range(2)]
        self.rug = self.fabric(scale=1.6)
        self.curtain = self._add(self._color(0.6), "folds", draw.uniform(0.6, 1.4))
        self.stone = self._add(self._color(0.3), "speckle", draw.uniform(0.4, 1.2), gloss=0.5)
        self.white = self._add(jitter(draw, (0.85, 0.85, 0.84), 0.04), "plain", 1.0, gloss=0.4)
        self.dark = self._add(jitter(draw, (0.08, 0.08, 0.08), 0.04), "plain", 1.0, gloss=0.3)
        self.metal = self._add(jitter(draw, (0.5, 0.5, 0.52), 0.15), "plain", 1.0, gloss=0.7)
        self.skin = self._add(draw.pick(SKINS), "plain", 1.0)
        self.hair = self._add(jitter(draw, (0.12, 0.09, 0.07), 0.05), "carpet", 0.2)
        self.clothes = [self.fabric(scale=0.5) for _ in range(3)]
        self.colors = [self._goods() for _ in range(14)]
        self.books = [self._fit("books", 1.2) for _ in range(4)]
        self.pictures = [self._fit("poster", 1.1) for _ in range(5)]
        self.papers = [self._add3((WHITE, (0.2, 0.2, 0.25), self._color()), "text", 0.0) for _ in range(2)]
        self.appliances = [self._appliance() for _ in range(2)]
        self.blind = self._add3((jitter(draw, WHITE), shade(jitter(draw, WHITE), 0.5)), "blinds", 0.0)
        self.leaves = self._add3(((0.12, 0.25, 0.08), (0.25, 0.42, 0.15), (0.4, 0.45, 0.2)), "foliage", 0.4)
        self.screen = self._fit("poster", 1.0, emission=draw.pick((0.0, 0.0, 0.5, 0.9)))
        self.lamp = self.palette.add([(1.0, 0.95, 0.82)], variants("plain")[0], 1.0, emission=3.0)
        parchment, glow = jitter(draw, (0.9, 0.82, 0.65), 0.08), draw.pick((0.0, 0.8, 2.0))
        self.shade = self.palette.add([parchment], variants("folds")[0], 0.5, emission=glow)
        day = draw.pick((0.0, 0.9, 1.8, 3.0, 5.0))  # night to glaring noon
        glass = [((0.02, 0.03, 0.05), (0.03, 0.03, 0.04)), ((0.8, 0.9, 1.0), (0.25, 0.35, 0.2))][day > 0]
        self.window = self.palette.add(
            [*glass, (0.5, 0.5, 0.5)], draw.pick(variants("outdoors")), 0.0, emission=day, gloss=0.5
        )
        self.daylight = day

    def _color(self, saturation: float = 0.8) -> Color:
        return (natural_color if self.natural else any_color)(self.draw, saturation)

    def _add(self, color: Color, family: str, period: float, gloss: float = 0.0) -> int:
        second = jitter(self.draw, shade(color, self.draw.uniform(0.6, 1.1)), 0.05)
        return self._add3((color, second, self._color()), family, period, gloss)

    def _add3(
        self, colors: tuple[Color, ...], family: str, period: float, gloss: float = 0.0, emission: float = 0.0
    ) -> int:
        if self.plain and family in SURFACES:
            colors, family = colors[:1], "plain"
        pattern = self.draw.pick(variants(family))
        offset = self.draw.unit()
        return self.palette.add(colors, pattern, period, gloss=gloss, emission=emission, offset=offset)

    def _fit(self, family: str, saturation: float, emission: float = 0.0) -> int:
        colors = tuple(self._color(saturation) for _ in range(3))
        return self._add3(colors, family, 0.0, 0.1, emission)

    def _goods(self) -> int:
        """Small objects: boxes, bottles, bags, plain or printed."""
        color = self._color(1.0)
        family = self.draw.pick(("plain", "plain", "poster", "text", "stripes", "blobs"))
        return self._add(color, family, 0.0, gloss=self.draw.uniform(0, 0.4))

    def _appliance(self) -> int:
        """White, black or steel, with a dark window."""
        body = jitter(self.draw, self.draw.pick(((0.8, 0.8, 0.8), (0.15, 0.15, 0.16), (0.5, 0.5, 0.52))))
        return self._add3((body, (0.04, 0.04, 0.05), (0.6, 0.6, 0.6)), "appliance", 0.0, gloss=0.4)

    def _wall(self) -> int:
        d = self.draw
        color = jitter(d, d.pick(WALLS)) if d.chance(0.85) else self._color(0.9)
        color = shade(color, d.uniform(0.75, 1.1))
        quiet = ("stripes", "blobs", "plaster", "plain", "grain")  # their colors lie close together
        others: tuple[str, ...] = ("tiles", "bricks", "stripes", "blobs", "grain")
        if self.natural:
            others = ("plain",) * 8 + ("tiles", "bricks", "stripes")
        family = d.pick(("plain",) * 4 + ("plaster",) * 2 + others)
        if family in quiet:
            tones = (color, shade(color, d.uniform(0.82, 1.05)), jitter(d, shade(color, 0.9), 0.05))
            return self._add3(tones, family, d.uniform(0.5, 3.0))
        tones = (color, jitter(d, shade(color, 0.8)), shade(jitter(d, WALLS[2]), d.uniform(0.5, 1.1)))
        return self._add3(tones, family, d.uniform(0.6, 1.2), 0.4 if family == "tiles" else 0.0)

    def _floor(self) -> int:
        d = self.draw
        family = d.pick(("planks",) * 3 + ("tiles",) * 2 + ("carpet",) * 2 + ("speckle", "plaster"))
        if family == "planks":
            color = shade(self.wood_colors[0], d.uniform(0.9, 1.4))
            tones = (color, shade(color, d.uniform(0.55, 0.9)), shade(color, 0.25))
            return self._add3(tones, family, d.uniform(0.8, 1.8), d.uniform(0, 0.6))
        color = jitter(d, d.pick((*WALLS, (0.45, 0.42, 0.40), (0.35, 0.30, 0.27), (0.30, 0.32, 0.38))))
        color = shade(color, d.uniform(0.6, 1.05))
        second = shade(color, d.uniform(0.5, 0.9))
        tones = (color, second, shade(jitter(d, WALLS[2]), d.uniform(0.4, 1.0)))
        period = d.uniform(0.8, 2.4)
        return self._add3(tones, family, period, 0.0 if family == "carpet" else d.uniform(0, 0.6))

    def _wood(self, index: int) -> int:
        d = self.draw
        color = self.wood_colors[index] if d.chance(0.75) else self._color(0.5)
        tones = (color, shade(color, d.uniform(0.5, 0.9)), shade(color, 0.4))
        return self._add3(tones, d.pick(("grain", "grain", "plain")), d.uniform(0.4, 1.2), d.uniform(0, 0.5))

    def _front(self, index: int) -> int:
        d = self.draw
        color = self.wood_colors[index] if d.chance(0.6) else d.pick((self._color(0.6), (0.82, 0.82, 0.8)))
        handle = d.pick(((0.6, 0.6, 0.6), (0.1, 0.1, 0.1), (0.65, 0.5, 0.25)))
        tones = (color, shade(color, d.uniform(0.6, 0.95)), handle)
        return self._add3(tones, "fronts", 0.0, d.uniform(0, 0.4))

    def _door(self, index: int) -> int:
        d = self.draw
        painted = not d.chance(0.5)
        color = jitter(d, d.pick((WHITE, WALLS[0], WALLS[1]))) if painted else self.wood_colors[index]
        return self._add3((color, shade(color, 0.8), (0.5, 0.47, 0.4)), "door", 0.0, 0.2)

    def fabric(self, scale: float = 1.0) -> int:
        """Add a cloth: plain, striped, checked or printed."""
        d = self.draw
        quiet = ("carpet", "carpet", "crumple")
        family = d.pick((*quiet, *(quiet * 3 if self.natural else ()), "stripes", "plaid", "blobs", "tufted"))
        color = self._color(0.9)
        if d.chance(0.93 if self.natural else 0.7):
            tones = (color, shade(color, d.uniform(0.5, 1.6)), self._color(0.9))
        else:
            tones = (color, self._color(), self._color())
        return self._add3(tones, family, scale * d.uniform(0.3, 1.2))

    def bedding(self) -> int:
        """Add a bed cover: often light, crumpled or printed."""
        d = self.draw
        color = jitter(d, (0.8, 0.8, 0.78)) if d.chance(0.4) else self._color(0.9)
        family = d.pick(("crumple", "crumple", "tufted", "stripes", "plaid", "blobs", "folds"))
        tones = (color, shade(color, d.uniform(0.6, 1.2)), self._color())
        return self._add3(tones, family, d.uniform(0.5, 1.5))

"""MJCF text that is the same on every machine: seeded random numbers, fixed decimals."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

T = TypeVar("T")
Color = tuple[float, float, float]
Vector = tuple[float, float, float]


class Draw:
    """Seeded random numbers from ``PCG64``'s 53-bit doubles alone, the most stable of NumPy's streams."""

    def __init__(self, seed: Sequence[int]) -> None:
        self._generator = np.random.Generator(np.random.PCG64(np.random.SeedSequence(tuple(seed))))
        self._block: list[float] = []

    def unit(self) -> float:
        """Uniform in [0, 1)."""
        if not self._block:
            self._block = self._generator.random(512).tolist()
        return self._block.pop()

    def uniform(self, low: float, high: float) -> float:
        """Uniform in [low, high)."""
        return low + (high - low) * self.unit()

    def chance(self, probability: float) -> bool:
        """True with this probability."""
        return self.unit() < probability

    def pick(self, options: Sequence[T]) -> T:
        """One of the options, with equal probability."""
        return options[int(self.unit() * len(options))]

    def integer(self, low: int, high: int) -> int:
        """Uniform integer in [low, high]."""
        return low + int(self.unit() * (high - low + 1))

    def sign(self) -> float:
        """-1.0 or 1.0."""
        return 1.0 if self.unit() < 0.5 else -1.0


def number(value: float) -> str:
    """Format with four decimals (0.1 mm), never "-0.0000"."""
    text = f"{value:.4f}"
    return "0.0000" if text == "-0.0000" else text


def numbers(values: Sequence[float]) -> str:
    """Format several numbers, separated by spaces."""
    return " ".join(map(number, values))


class Body:
    """Geoms in one frame, as of a piece of furniture: origin on the floor, +y to the front.

    Args:
        position: of the frame in the world [m].
        yaw: counter-clockwise [degrees].
    """

    def __init__(self, position: Sequence[float] = (0.0, 0.0, 0.0), yaw: float = 0.0) -> None:
        self.position, self.yaw = position, yaw
        self.geoms: list[str] = []

    def _geom(
        self, kind: str, center: Sequence[float], size: str, material: int, euler: Sequence[float] | None
    ) -> None:
        turn = f' euler="{numbers(euler)}"' if euler else ""
        self.geoms.append(
            f'<geom type="{kind}" pos="{numbers(center)}" size="{size}" material="m{material}"{turn}/>'
        )

    def box(self, base: Vector, extents: Vector, material: int, euler: Sequence[float] | None = None) -> None:
        """Add a box by the center of its lower face and its full extents [m]."""
        x, y, z = base
        half_x, half_y, half_z = (max(extent, 0.002) / 2 for extent in extents)
        size = numbers((half_x, half_y, half_z))
        self._geom("box", (x, y, z + half_z), size, material, euler)

    def cylinder(
        self, base: Vector, radius: float, height: float, material: int, euler: Sequence[float] | None = None
    ) -> None:
        """Add an upright cylinder by the center of its lower face [m]; ``euler`` tips it over."""
        x, y, z = base
        self._geom("cylinder", (x, y, z + height / 2), numbers((radius, height / 2)), material, euler)

    def ellipsoid(
        self, center: Vector, radii: Vector, material: int, euler: Sequence[float] | None = None
    ) -> None:
        """Add an ellipsoid by its center and radii [m]."""
        self._geom("ellipsoid", center, numbers(radii), material, euler)

    def limb(self, start: Sequence[float], end: Sequence[float], radius: float, material: int) -> None:
        """Add a capsule from one point to another [m]."""
        ends = numbers((*start, *end))
        self.geoms.append(
            f'<geom type="capsule" fromto="{ends}" size="{number(radius)}" material="m{material}"/>'
        )

    def plane(self, position: Sequence[float], normal: Sequence[float], material: int) -> None:
        """Add an infinite plane that faces along ``normal``."""
        place = f'pos="{numbers(position)}" zaxis="{numbers(normal)}"'
        self.geoms.append(f'<geom type="plane" {place} size="0 0 1" material="m{material}"/>')

    def text(self) -> str:
        """Return the MJCF of the body."""
        inner = "\n".join(self.geoms)
        return f'<body pos="{numbers(self.position)}" euler="0 0 {number(self.yaw)}">\n{inner}\n</body>'


def world_text(name: str, palette: "Palette", parts: Sequence[str]) -> str:
    """Return the MJCF of a model with the materials of a palette and these bodies and geoms."""
    inner = "\n".join(parts)
    return (
        f'<mujoco model="{name}">\n<compiler angle="degree"/>\n{palette.assets()}\n'
        f"<worldbody>\n{inner}\n</worldbody>\n</mujoco>\n"
    )


class Palette:
    """The materials of one room; a material's number is its place in the MJCF.

    The model carries them as ``<numeric>``, so its text alone is the whole room. Columns of :attr:`rows`:
    A rgb, B rgb, C rgb, pattern, period u [m], period v [m] (0 = the pattern fits the face once), gloss,
    emission, offset.
    """

    COLUMNS = 15

    def __init__(self) -> None:
        self.rows: list[tuple[float, ...]] = []

    def add(
        self, colors: Sequence[Color], pattern: int, period: float = 0.0, *, gloss: float = 0.0,
        emission: float = 0.0, offset: float = 0.0,
    ) -> int:  # fmt: skip
        """Add a material and return its number; one or two colors are repeated to three."""
        three = (list(colors) * 3)[:3]
        look = (float(pattern), period, period, gloss, emission, offset)
        self.rows.append((*three[0], *three[1], *three[2], *look))
        return len(self.rows) - 1

    def assets(self) -> str:
        """Return the ``<asset>`` and ``<custom>`` sections."""
        looks = "\n".join(
            f'<material name="m{i}" rgba="{numbers(row[:3])} 1"/>' for i, row in enumerate(self.rows)
        )
        # one for each: MuJoCo 3 takes at most 500 numbers in one
        data = "\n".join(f'<numeric name="m{i}" data="{numbers(row)}"/>' for i, row in enumerate(self.rows))
        return f"<asset>\n{looks}\n</asset>\n<custom>\n{data}\n</custom>"

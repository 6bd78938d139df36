"""What lamps alone leave out: light after one bounce, sun through windows, and the shade where things touch.

Bounces follow instant radiosity (Keller 1997): rays from the lamps hit walls and furniture, and a few of
those places shine on as weak lamps of the surface's color, the strongest with shadows of their own.
"""

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from eldenet.simulation.rendering.camera import Hits, cast_rays
from eldenet.simulation.rendering.shadows import shadow

if TYPE_CHECKING:
    from eldenet.simulation.rendering.shading import CompiledRoom

_RAYS = 24  # of each lamp
_GLOWS = 6  # places that shine on
_SHADOWED = 3  # of them, the strongest: each shadow costs a cast
_LATER_BOUNCES = 1.5  # what the second and later bounces add, as a factor on the first
_NEAR = 0.6  # [m2] keeps a glow's neighborhood from burning out
_GLOW_STRIDE = 6
_CONTACT = 0.22  # [m] reach of the shade where things touch


class Glow(NamedTuple):
    """A lit place that shines on: point and normal ``(3,)``, power ``(3,)`` in RGB."""

    point: np.ndarray
    normal: np.ndarray
    power: np.ndarray


def glows(room: "CompiledRoom") -> list[Glow]:
    """Return the places of a room that shine on, the same for every view."""
    points, normals, powers = [], [], []
    for lamp in room.room.lights:
        origin = np.array(lamp[:3])
        distance, geom, normal = cast_rays(room.model, room.data, origin, _sphere(_RAYS), 30.0)
        hit = (geom >= 0) & (distance > 0.1)
        point = (origin + _sphere(_RAYS) * distance[:, None])[hit].T.astype(np.float32)
        hits = Hits(distance[hit], geom[hit], point, np.ascontiguousarray(normal[hit].T, dtype=np.float32))
        color = np.array(lamp[3:6], dtype=np.float32)[:, None]
        power = room.albedo(hits, np.full(point.shape[1], 0.5, np.float32)) * color
        points.append(hits.point)
        normals.append(hits.normal)
        powers.append(power * np.float32(4 * _LATER_BOUNCES / _RAYS * lamp[6] ** 2))
    if not any(point.size for point in points):  # no lamp, or each shut in by something
        return []
    return _gather(*(np.concatenate(part, axis=1) for part in (points, normals, powers)))


def _gather(point: np.ndarray, normal: np.ndarray, power: np.ndarray) -> list[Glow]:
    """Join ``(3, N)`` lit places into a few far apart, each with the power of those nearest to it."""
    features = np.concatenate([point, normal * np.float32(0.7)])
    chosen = [int(power.sum(axis=0).argmax())]
    away = np.square(features - features[:, chosen[0], None]).sum(axis=0)
    nearest = np.zeros(point.shape[1], np.intp)
    while len(chosen) < min(_GLOWS, point.shape[1]):
        chosen.append(int(away.argmax()))
        squared = np.square(features - features[:, chosen[-1], None]).sum(axis=0)
        nearest[squared < away] = len(chosen) - 1
        away = np.minimum(away, squared)
    found = [
        Glow(point[:, place], normal[:, place], power[:, nearest == number].sum(axis=1))
        for number, place in enumerate(chosen)
    ]
    return sorted(found, key=lambda glow: -float(glow.power.sum()))


def _sphere(count: int) -> np.ndarray:
    """Unit vectors ``(count, 3)`` spread evenly over the sphere (Fibonacci's spiral)."""
    number = np.arange(count) + 0.5
    z, turn = 1 - 2 * number / count, number * np.pi * (1 + 5**0.5)
    flat = np.sqrt(1 - z * z)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)


def add_bounces(light: np.ndarray, room: "CompiledRoom", hits: Hits, size: tuple[int, int]) -> None:
    """Add the light of :func:`glows` to ``light`` ``(3, N)``, in place."""
    for number, glow in enumerate(room.glows):
        ray = glow.point[:, None] - hits.point
        squared = (ray * ray).sum(axis=0)
        ray /= np.sqrt(squared) + np.float32(1e-6)
        strength = np.maximum((ray * hits.normal).sum(axis=0), np.float32(0.0))
        strength *= np.maximum(-(glow.normal @ ray), np.float32(0.0)) / (np.float32(_NEAR) + squared)
        if number < _SHADOWED:
            origin = glow.point + np.float32(0.03) * glow.normal
            strength *= shadow(room.model, room.data, origin, hits, size, stride=_GLOW_STRIDE)
        for c in range(3):
            light[c] += strength * glow.power[c]


def contact_shade(hits: Hits, size: tuple[int, int]) -> np.ndarray:
    """Return the share of light ``(N,)`` that neighbors leave to each point: less where things touch.

    Screen-space ambient occlusion: a visible neighbor within ``_CONTACT`` that rises above the point's own
    plane takes light away. Sampled at half of the resolution.
    """
    height, width = size
    point = np.ascontiguousarray(hits.point.reshape(3, height, width)[:, ::2, ::2])
    normal = np.ascontiguousarray(hits.normal.reshape(3, height, width)[:, ::2, ::2])
    rows, columns = point.shape[1:]
    taken = np.zeros((rows, columns), np.float32)
    pixel = width / 128
    for number in range(12):
        turn, away = 2.4 * number, pixel * (1.0, 2.5, 5.0)[number % 3]
        dy, dx = round(away * np.sin(turn)), round(away * np.cos(turn))
        row, column = _shifted(rows, dy), _shifted(columns, dx)
        rise = point[:, row[1]][:, :, column[1]] - point[:, row[0]][:, :, column[0]]
        squared = (rise * rise).sum(axis=0)
        height_above = (rise * normal[:, row[0]][:, :, column[0]]).sum(axis=0)
        share = height_above / (np.sqrt(squared) + np.float32(1e-4)) - np.float32(0.1)
        share = np.maximum(share, 0) / (1 + squared * np.float32(1 / _CONTACT**2))
        taken[row[0], column[0]] += share
    open_share = np.clip(1 - taken * np.float32(2.2 / 12), 0.2, 1)
    open_share = cv2.GaussianBlur(open_share, (3, 3), 0.6)
    return cv2.resize(open_share, (width, height), interpolation=cv2.INTER_LINEAR).ravel()


def _shifted(length: int, step: int) -> tuple[slice, slice]:
    """Return the slices of the points and of their neighbors ``step`` farther."""
    if step >= 0:
        return slice(0, length - step), slice(step, length)
    return slice(-step, length), slice(0, length + step)


class Sun(NamedTuple):
    """Sun through a window."""

    center: tuple[float, float, float]  # of the window [m]
    along: tuple[float, float, float]  # the wall
    normal: tuple[float, float, float]  # of the wall, inwards
    toward: tuple[float, float, float]  # the sun: unit direction
    half: tuple[float, float]  # of the window's width and height [m]
    strength: float  # of its light


def add_sun(light: np.ndarray, sun: Sun, room: "CompiledRoom", hits: Hits, size: tuple[int, int]) -> None:
    """Add the patch of sun that falls through a window to ``light`` ``(3, N)``, in place."""
    center, along, normal, toward = (np.array(part, np.float32) for part in sun[:4])
    inside = normal @ (hits.point - center[:, None])  # distance to the window's plane
    through = hits.point - toward[:, None] * (inside / (toward @ normal)) - center[:, None]
    x, z = along @ through, through[2]
    soft = np.float32(30.0)
    lit = np.clip((sun.half[0] - np.abs(x)) * soft, 0, 1) * np.clip((sun.half[1] - np.abs(z)) * soft, 0, 1)
    lit *= np.clip((np.abs(x) - 0.03) * 60, 0, 1) * (inside > 0.02)  # the window's bar
    if not lit.any():
        return
    lit *= np.maximum(toward @ hits.normal, 0) * np.float32(sun.strength)
    lit *= shadow(room.model, room.data, center + np.float32(0.15) * normal, hits, size)
    light += lit * np.array([[1.0], [0.93], [0.8]], np.float32)

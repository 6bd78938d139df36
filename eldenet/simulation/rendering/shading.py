"""From a compiled room to linear RGB: light, surfaces, textures.

Lambertian shading with the three strongest point lights (distance fall-off; the strongest, with ``detail``
two, cast shadows at a quarter of the resolution), ambient light that fades in corners and behind furniture,
gloss, textures from the atlas.
Arrays are ``(3, N)``, a row per coordinate or color: NumPy is several times faster on those.
"""

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from eldenet.simulation.rendering.bounced_light import Sun, add_bounces, add_sun, contact_shade, glows
from eldenet.simulation.rendering.camera import Hits, RayCamera
from eldenet.simulation.rendering.mjcf import Palette
from eldenet.simulation.rendering.shadows import shadow
from eldenet.simulation.rendering.textures import atlas

_FACE_U = np.array([1, 0, 0], dtype=np.intp)  # which local axes span a face, by its normal's axis
_FACE_V = np.array([2, 2, 1], dtype=np.intp)


@dataclass
class Room:
    """A room (or a street, or an arena) ready to compile."""

    kind: str  # bedroom, kitchen, ...
    # extents in x and y and ceiling height [m]; the origin is the middle of the floor
    size: tuple[float, float, float]
    text: str = ""  # MJCF
    lights: list[tuple[float, ...]] = field(default_factory=list)  # rows of x, y, z [m], r, g, b, reach [m]
    # rows of x0, y0, x1, y1, height [m]: where a camera cannot stand
    obstacles: list[tuple[float, float, float, float, float]] = field(default_factory=list)
    # body number in the model -> maker ("chair", "person", ...) of the furniture and people
    pieces: dict[int, str] = field(default_factory=dict)
    ambient: float = 0.5  # share of the light that comes from everywhere
    suns: list[Sun] = field(default_factory=list)  # sun that falls through a window
    detail: bool = False  # light bounces once, two lights cast shadows, and it is darker where things touch


class CompiledRoom:
    """A room in the physics engine, with the material of every geom read from the model itself."""

    def __init__(self, room: Room) -> None:
        import mujoco

        self.room = room
        self.model: Any = mujoco.MjModel.from_xml_string(room.text)
        self.data: Any = mujoco.MjData(self.model)  # call update() after moving a body
        self._read_materials()
        self.update()
        self.glows = glows(self) if room.detail and room.kind != "street" else []

    def update(self) -> None:
        """Recompute where every geom is."""
        import mujoco

        mujoco.mj_kinematics(self.model, self.data)
        rotation = self.data.geom_xmat.astype(np.float32)
        self.rotation = np.ascontiguousarray(rotation.T)  # (9, G)
        place = np.einsum("gij,gi->jg", rotation.reshape(-1, 3, 3), self.data.geom_xpos)
        self.origin = place.astype(np.float32)  # (3, G) in the geom's own axes

    def _read_materials(self) -> None:
        """Read the look of every geom, and how textures lie on its faces."""
        model = self.model
        table = model.numeric_data.reshape(-1, Palette.COLUMNS).astype(np.float32)[model.geom_matid]
        self.colors = np.ascontiguousarray(table[:, :9].T)
        self.pattern = table[:, 9].astype(np.int32)
        self.gloss, self.emission, offset = (np.ascontiguousarray(table[:, k]) for k in (12, 13, 14))
        half = model.geom_aabb[:, 3:].astype(np.float32)
        half = np.where((half > 0) & (half < 1e3), half, np.float32(1.0))  # planes have no extent
        # per geom and face axis: texture coordinate = local * scale + shift
        fits = table[:, 10] <= 0
        self.scale_u, self.scale_v = (
            np.where(fits[:, None], 0.5 / half[:, face], 1 / np.maximum(period, 1e-3)[:, None])
            .astype(np.float32)
            .ravel()
            for face, period in ((_FACE_U, table[:, 10]), (_FACE_V, table[:, 11]))
        )
        self.shift = np.where(fits, np.float32(0.5), offset)

    def photograph(
        self, camera: RayCamera, position: np.ndarray, rotation: np.ndarray
    ) -> tuple[np.ndarray, Hits]:
        """Return the light that reaches a camera, linear RGB ``(H, W, 3)`` float32, and its rays' hits."""
        hits = camera.cast(self.model, self.data, position, rotation)
        point, normal = hits.point, hits.normal
        depth = hits.depth.astype(np.float32)
        view = position.astype(np.float32)[:, None] - point
        view /= np.sqrt(_dot(view, view)) + np.float32(1e-6)
        facing = np.maximum(np.abs(_dot(view, normal)), np.float32(0.25))
        footprint = depth / (np.float32(camera.intrinsics[0, 0]) * facing)
        albedo = self.albedo(hits, footprint)
        occlusion = ambient_occlusion(self.room, point, normal, depth.reshape(camera.size))
        if self.room.detail:
            occlusion *= contact_shade(hits, camera.size)
        ambient = (
            np.float32(self.room.ambient) * occlusion * (np.float32(0.75) + np.float32(0.25) * normal[2])
        )
        light = np.stack([ambient + self.emission.take(hits.geom)] * 3)
        shine = np.zeros_like(light)
        gloss = self.gloss.take(hits.geom)
        open_sky = np.sqrt(occlusion)
        brightest = sorted(self.room.lights, key=lambda light: -_power(light, position))[:3]
        for rank, row in enumerate(brightest):
            lamp = np.array(row[:3], dtype=np.float32)
            ray = lamp[:, None] - point
            squared = _dot(ray, ray)
            ray /= np.sqrt(squared) + np.float32(1e-6)
            strength = np.maximum(_dot(ray, normal) * np.float32(0.92) + np.float32(0.08), 0) * open_sky
            strength /= np.float32(0.25) + squared * np.float32(1 / row[6] ** 2)
            if rank == 0 or (rank == 1 and self.room.detail):
                far = 400.0 if self.room.detail else 30.0  # a street's sun is far away
                strength *= shadow(self.model, self.data, lamp, hits, camera.size, far=far)
            if rank == 0:
                ray += view  # the half vector: only the strongest light leaves highlights
                peak = _dot(ray, normal) ** 2 / (_dot(ray, ray) + np.float32(1e-6))
                peak *= peak
                peak *= peak
                peak *= peak
                shine[:] = gloss * peak * strength * np.float32(0.3 * row[4])
            for c in range(3):
                light[c] += strength * np.float32(row[3 + c])
        add_bounces(light, self, hits, camera.size)
        for sun in self.room.suns:
            add_sun(light, sun, self, hits, camera.size)
        albedo *= light
        albedo += shine
        return np.ascontiguousarray(albedo.T).reshape(*camera.size, 3), hits

    def albedo(self, hits: Hits, footprint: np.ndarray) -> np.ndarray:
        """Return the surface color ``(3, N)`` of every hit; ``footprint`` is a pixel's size there [m]."""
        geom, point, normal = hits.geom, hits.point, hits.normal
        rot = [row.take(geom) for row in self.rotation]
        local = np.stack(
            [rot[j] * point[0] + rot[3 + j] * point[1] + rot[6 + j] * point[2] for j in range(3)]
        )
        local -= self.origin.take(geom, axis=1)
        facing = [
            np.abs(rot[j] * normal[0] + rot[3 + j] * normal[1] + rot[6 + j] * normal[2]) for j in range(3)
        ]
        axis = np.where(facing[0] > facing[1], np.intp(0), np.intp(1))
        axis[facing[2] > np.maximum(facing[0], facing[1])] = 2
        count = len(geom)
        rows = np.arange(count)
        u, v = (local.ravel().take(face[axis] * count + rows) for face in (_FACE_U, _FACE_V))
        cell = geom * 3 + axis
        su, sv, shift = self.scale_u.take(cell), self.scale_v.take(cell), self.shift.take(geom)
        footprint = footprint * np.minimum(su, sv)
        w = atlas().sample(self.pattern.take(geom), u * su + shift, v * sv + shift, footprint)
        colors = [row.take(geom) for row in self.colors]
        return np.stack([w[0] * colors[c] + w[1] * colors[3 + c] + w[2] * colors[6 + c] for c in range(3)])


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Dot product ``(N,)`` of vectors ``(3, N)``."""
    out: np.ndarray = a[0] * b[0]
    out += a[1] * b[1]
    out += a[2] * b[2]
    return out


def _power(light: tuple[float, ...], position: np.ndarray) -> float:
    """Power of a light at a position ``(3,)`` [m]."""
    away = sum((a - float(b)) ** 2 for a, b in zip(light[:3], position, strict=True))
    return light[4] * light[6] ** 2 / (0.5 + away)


def ambient_occlusion(room: Room, point: np.ndarray, normal: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the share of ambient light ``(N,)``: less near the room's edges and behind objects."""
    sx, sy, h = room.size
    out = np.ones(point.shape[1], np.float32)
    for axis, middle, half in ((0, 0.0, sx / 2), (1, 0.0, sy / 2), (2, h / 2, h / 2)):
        near = np.float32(half) - np.abs(point[axis] - np.float32(middle))
        edge = np.float32(0.5) / (np.float32(1) + np.square(np.maximum(near, 0) * np.float32(3.0)))
        out *= 1 - edge * (1 - np.abs(normal[axis]))
    if room.detail:  # contact_shade knows better
        return out
    # behind something: the pixel lies deeper than its neighborhood
    for window in (depth.shape[1] // 20 * 2 + 1, depth.shape[1] // 8 * 2 + 1):
        mean = cv2.blur(depth, (window, window), borderType=cv2.BORDER_REPLICATE)
        dip = np.clip((depth - mean) / (np.float32(0.12) * mean + np.float32(0.05)), 0, 1)
        out *= (1 - np.float32(0.3) * dip).ravel()
    return out

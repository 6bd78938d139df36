"""A crossing for people: top view with the trail, beside what the camera sees and what the sectors say."""

import math
from typing import Any

import cv2
import numpy as np

from eldenet.geometry import PinholeCamera
from eldenet.navigation.episodes import GOAL_RADIUS, Crossings
from eldenet.navigation.observer import SECTORS
from eldenet.navigation.sensors import Sight
from eldenet.perception.drawing import draw_boxes
from eldenet.simulation.arena_view import robot_intrinsics
from eldenet.simulation.arenas import Arena, Obstacle
from eldenet.simulation.robot import ROBOT
from eldenet.visualization import color_depth, visible_range

_COLORS = {
    "cylinder": (120, 144, 156),
    "box": (161, 136, 107),
    "vehicle": (84, 110, 122),
    "person": (239, 108, 80),
}
_FLOOR, _WALL, _TRAIL, _ROBOT, _GOAL = (
    (245, 245, 242),
    (60, 60, 60),
    (30, 100, 220),
    (250, 190, 20),
    (40, 160, 70),
)
_FED = {"simulator": (90, 90, 90), "depth": (66, 133, 190), "box": (239, 108, 80)}
_FONT = cv2.FONT_HERSHEY_SIMPLEX
TITLE = 20  # height of the line of text above a picture [px]


class Scene:
    """Draws one crossing.

    Args:
        arena: the world.
        size: of the top view [px].

    Attributes:
        trail: poses so far; append to it.
    """

    def __init__(self, arena: Arena, size: int = 480) -> None:
        self.arena, self.size = arena, size
        self.scale = size / (arena.side + 0.6)
        self.trail: list[tuple[float, float, float]] = []
        self._standing = np.full((size, size, 3), _FLOOR, np.uint8)
        half = arena.side / 2
        corners = (self.pixel(-half, half), self.pixel(half, -half))
        cv2.rectangle(self._standing, *corners, _WALL, 3)
        for obstacle in arena.obstacles:
            if not obstacle.path:
                self._obstacle(self._standing, obstacle, 0.0)

    def pixel(self, x: float, y: float) -> tuple[int, int]:
        """Column and row of a point of the arena [m]."""
        return round(self.size / 2 + x * self.scale), round(self.size / 2 - y * self.scale)

    def _obstacle(self, picture: np.ndarray, obstacle: Obstacle, time: float) -> None:
        x, y = obstacle.position(time)
        color = _COLORS[obstacle.kind]
        if obstacle.round:
            cv2.circle(
                picture, self.pixel(x, y), round(obstacle.half[0] * self.scale), color, -1, cv2.LINE_AA
            )
        else:
            self._box(picture, (x, y, obstacle.yaw), obstacle.half, color)

    def _box(
        self,
        picture: np.ndarray,
        pose: tuple[float, float, float],
        half: tuple[float, float],
        color: tuple[int, int, int],
    ) -> None:
        x, y, yaw = pose
        c, s = math.cos(yaw), math.sin(yaw)
        corners = [
            self.pixel(x + c * a * half[0] - s * b * half[1], y + s * a * half[0] + c * b * half[1])
            for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        cv2.fillConvexPoly(picture, np.array(corners), color, cv2.LINE_AA)

    def top_view(self, crossings: Crossings, slot: int) -> np.ndarray:
        """``(size, size, 3)`` uint8 RGB: obstacles, way-points, what was seen, trail, robot."""
        picture = self._standing.copy()
        world = crossings.worlds[slot]
        for obstacle in self.arena.pedestrians:
            self._obstacle(picture, obstacle, 0.0 if world is None else world.time)
        for x, y in self.arena.waypoints:
            cv2.circle(picture, self.pixel(x, y), round(GOAL_RADIUS * self.scale), _GOAL, 2, cv2.LINE_AA)
        x, y, yaw = (float(value) for value in crossings.poses[slot])
        sight = crossings.sights[slot]
        eye = (x + ROBOT.camera_ahead * math.cos(yaw), y + ROBOT.camera_ahead * math.sin(yaw))
        if sight is not None:
            for number, nearest in enumerate(sight.ranges.reshape(SECTORS, -1).min(axis=1)):
                step = ROBOT.field_of_view / SECTORS
                first = yaw - ROBOT.field_of_view / 2 + number * step
                edges = [
                    self.pixel(eye[0] + nearest * math.cos(a), eye[1] + nearest * math.sin(a))
                    for a in np.linspace(first, first + step, 6)
                ]
                cv2.polylines(
                    picture, [np.array([self.pixel(*eye), *edges])], True, (170, 190, 215), 1, cv2.LINE_AA
                )
            for angle, distance in zip(ROBOT.column_angles, sight.ranges, strict=True):
                if distance < ROBOT.far:
                    at = (
                        eye[0] + distance * math.cos(yaw + angle),
                        eye[1] + distance * math.sin(yaw + angle),
                    )
                    cv2.circle(picture, self.pixel(*at), 1, (200, 30, 30), -1)
        for before, after in zip(self.trail, self.trail[1:], strict=False):
            cv2.line(picture, self.pixel(*before[:2]), self.pixel(*after[:2]), _TRAIL, 2, cv2.LINE_AA)
        self._box(picture, (x, y, yaw), (ROBOT.length / 2, ROBOT.width / 2), _ROBOT)
        cv2.line(picture, self.pixel(x, y), self.pixel(*eye), (0, 0, 0), 2)
        return picture

    def draw(self, crossings: Crossings, slot: int, note: str = "", view: Any = None) -> np.ndarray:
        """Camera, depth and sectors beside the top view, under a line of text.

        ``(size + 20, size + 2 / 5 * size * 4 / 3, 3)`` uint8 RGB; without a look yet, the top view alone.

        Args:
            crossings: under way.
            slot: which robot.
            note: the line of text.
            view: :class:`~eldenet.simulation.arena_view.ArenaView` for sensors without pictures; None: their
                panels stay empty.
        """
        top = self.top_view(crossings, slot)
        sight = crossings.sights[slot]
        if sight is None:
            return _titled(top, note)
        if sight.image is None and view is not None:
            world = crossings.worlds[slot]
            photo = view.photo(tuple(crossings.poses[slot]), 0.0 if world is None else world.time)
            sight = sight._replace(image=photo.image, depth=photo.depth)
        return _titled(np.concatenate([camera_panels(sight, self.size), top], axis=1), note)


def _titled(picture: np.ndarray, note: str) -> np.ndarray:
    """A line of text above a picture, covering nothing of it."""
    line = np.full((TITLE, picture.shape[1], 3), 255, np.uint8)
    cv2.putText(line, note, (6, 14), _FONT, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([line, picture], axis=0)


def _label(picture: np.ndarray, text: str) -> None:
    """Text on a white patch in the upper left corner, in place."""
    (width, height), below = cv2.getTextSize(text, _FONT, 0.4, 1)
    cv2.rectangle(picture, (0, 0), (width + 7, height + below + 3), (255, 255, 255), -1)
    cv2.putText(picture, text, (4, height + 2), _FONT, 0.4, (0, 0, 0), 1, cv2.LINE_AA)


def camera_panels(sight: Sight, size: int) -> np.ndarray:
    """Photo, depth and sector bars below each other ``(size, 2 / 5 * size * 4 / 3, 3)`` uint8 RGB."""
    height = size * 2 // 5
    width = height * 4 // 3
    near, far = (0.3, 8.0) if sight.depth is None else visible_range(sight.depth)
    empty = np.full((height, width, 3), 225, np.uint8)
    photo = empty
    if sight.image is not None:
        photo = np.asarray(cv2.resize(sight.image, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
        if sight.boxes is not None:
            photo = draw_boxes(
                photo, sight.boxes, PinholeCamera(robot_intrinsics((height, width))), front=False
            )
    depth = empty
    if sight.depth is not None:
        colors = color_depth(sight.depth, near, far, sight.depth > 0)
        depth = np.asarray(cv2.resize(colors, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
    bars = sector_bars(sight, (size - 2 * height, width))
    if sight.image is not None:
        _label(photo, "camera")
    if sight.depth is not None:
        _label(depth, f"depth, {near:.1f} to {far:.1f} m")
    return np.concatenate([photo, depth, bars], axis=0)


def sector_bars(sight: Sight, size: tuple[int, int]) -> np.ndarray:
    """Nearest range [m] per sector, left to right as the camera sees them; each says what fed it."""
    height, width = size
    picture: np.ndarray = np.full((height, width, 3), 255, np.uint8)
    for number, (near, source) in enumerate(zip(sight.sectors, sight.sectors_fed_by, strict=True)):
        distance = float(near)
        left = (SECTORS - 1 - number) * width // SECTORS
        right = (SECTORS - number) * width // SECTORS
        top = height - 2 - round((height - 22) * math.sqrt(distance / ROBOT.far))
        cv2.rectangle(picture, (left + 3, top), (right - 3, height - 2), _FED[source], -1)
        cv2.putText(picture, f"{distance:.1f}", (left + 8, top - 4), _FONT, 0.38, (0, 0, 0), 1, cv2.LINE_AA)
        short = source.replace("simulator", "rays")
        cv2.putText(picture, short, (left + 8, height - 8), _FONT, 0.36, (255, 255, 255), 1, cv2.LINE_AA)
    return picture

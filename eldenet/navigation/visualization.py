"""Pictures and videos of an episode: top view with the trail, camera, depth and sectors."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from eldenet.geometry import PinholeCamera
from eldenet.navigation.episodes import GOAL_RADIUS, Episodes, EpisodeSettings, Event
from eldenet.navigation.evaluation import Policy
from eldenet.navigation.observer import SECTORS
from eldenet.navigation.sensors import Sensor, SensorScan
from eldenet.perception.drawing import draw_boxes
from eldenet.simulation.arena_view import ArenaView, robot_intrinsics
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT, view_of
from eldenet.system.files import part_file
from eldenet.visualization import color_depth

_COLORS = {
    "cylinder": (120, 144, 156),
    "box": (161, 136, 107),
    "vehicle": (84, 110, 122),
    "person": (239, 108, 80),
}
_FLOOR, _WALL, _TRAIL = (245, 245, 242), (60, 60, 60), (30, 100, 220)
_ROBOT, _GOAL = (250, 190, 20), (40, 160, 70)
_FED = {"simulator": (90, 90, 90), "depth": (66, 133, 190), "box": (239, 108, 80)}
_FONT = cv2.FONT_HERSHEY_SIMPLEX
TITLE = 20  # height of the line of text above a picture [px]
VIDEO_FORMATS = ("gif", "webp", "mp4")
SCALE_BAR = 2.0  # length of the map's scale [m]
WEBP_QUALITY = 55
_ENDS = {Event.NONE: "", Event.GOAL: "  goal", Event.COLLISION: "  COLLISION", Event.TIMEOUT: "  time-out"}


class Scene:
    """Draws one episode; its top view has ``size`` x ``size`` pixels.

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
        """Draw an obstacle at a time [s] on a picture ``(H, W, 3)`` uint8, in place."""
        x, y = obstacle.position(time)
        color = _WALL if obstacle.is_wall else _COLORS[obstacle.kind]
        if obstacle.round:
            radius = round(obstacle.half[0] * self.scale)
            cv2.circle(picture, self.pixel(x, y), radius, color, -1, cv2.LINE_AA)
        else:
            self._box(picture, (x, y, obstacle.yaw), obstacle.half, color)

    def _box(
        self,
        picture: np.ndarray,
        pose: tuple[float, float, float],
        half: tuple[float, float],
        color: tuple[int, int, int],
    ) -> None:
        """Draw a turned rectangle on a picture ``(H, W, 3)`` uint8, in place."""
        x, y, yaw = pose
        c, s = math.cos(yaw), math.sin(yaw)
        corners = [
            self.pixel(x + c * a * half[0] - s * b * half[1], y + s * a * half[0] + c * b * half[1])
            for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]
        cv2.fillConvexPoly(picture, np.array(corners), color, cv2.LINE_AA)

    def top_view(self, episodes: Episodes, slot: int) -> np.ndarray:
        """``(size, size, 3)`` uint8 RGB: obstacles, way-points, last scan, trail, robot."""
        picture = self._standing.copy()
        world = episodes.worlds[slot]
        for obstacle in self.arena.pedestrians:
            self._obstacle(picture, obstacle, world.time)
        for x, y in self.arena.waypoints:
            cv2.circle(picture, self.pixel(x, y), round(GOAL_RADIUS * self.scale), _GOAL, 2, cv2.LINE_AA)
        x, y, yaw = (float(value) for value in episodes.poses[slot])
        scan = episodes.scans[slot]
        camera = (x + ROBOT.camera_ahead * math.cos(yaw), y + ROBOT.camera_ahead * math.sin(yaw))

        def seen(angle: float, distance: float) -> tuple[int, int]:
            return self.pixel(camera[0] + distance * math.cos(angle), camera[1] + distance * math.sin(angle))

        step = ROBOT.field_of_view / SECTORS
        for number, nearest in enumerate(scan.sectors):
            first = yaw - ROBOT.field_of_view / 2 + number * step
            edges = [seen(angle, nearest) for angle in np.linspace(first, first + step, 6)]
            outline = [np.array([self.pixel(*camera), *edges])]
            cv2.polylines(picture, outline, True, (170, 190, 215), 1, cv2.LINE_AA)
        for angle, distance in zip(view_of(len(scan.ranges)).column_angles, scan.ranges, strict=True):
            if distance < ROBOT.far:
                cv2.circle(picture, seen(yaw + angle, distance), 1, (200, 30, 30), -1)
        for before, after in pairwise(self.trail):
            cv2.line(picture, self.pixel(*before[:2]), self.pixel(*after[:2]), _TRAIL, 2, cv2.LINE_AA)
        half = (world.size * ROBOT.length / 2, world.size * ROBOT.width / 2)
        self._box(picture, (x, y, yaw), half, _ROBOT)
        cv2.line(picture, self.pixel(x, y), self.pixel(*camera), (0, 0, 0), 2)
        return picture

    def _scale_bar(self, picture: np.ndarray) -> None:
        """Draw ``SCALE_BAR`` meters in the lower right corner of ``(H, W, 3)`` uint8, in place."""
        right, low = self.size - 14, self.size - 14
        text = f"{SCALE_BAR:.0f} m"
        left = right - round(SCALE_BAR * self.scale)
        cv2.rectangle(picture, (left - 6, low - 18), (right + 6, low + 6), (255, 255, 255), -1)
        cv2.line(picture, (left, low), (right, low), (0, 0, 0), 2)
        cv2.putText(picture, text, ((left + right) // 2 - 12, low - 5), _FONT, 0.4, (0, 0, 0), 1, cv2.LINE_AA)

    @property
    def speed(self) -> float:
        """Mean speed between the last two poses of the trail [m/s]."""
        if len(self.trail) < 2:
            return 0.0
        return math.dist(self.trail[-1][:2], self.trail[-2][:2]) / ROBOT.period

    def draw(self, episodes: Episodes, slot: int, note: str = "", view: Any = None) -> np.ndarray:
        """Camera, depth and sectors beside the top view, under a line of text.

        ``(size + TITLE, size + w, 3)`` uint8 RGB, ``w`` as in :func:`camera_panels`.

        ``view`` is an :class:`~eldenet.simulation.arena_view.ArenaView` for sensors without images; without
        one, their panels stay empty.
        """
        top = self.top_view(episodes, slot)
        self._scale_bar(top)
        _label(top, "map")
        scan = episodes.scans[slot]
        if scan.image is None and view is not None:
            photo = view.photo(tuple(episodes.poses[slot]), episodes.worlds[slot].time)
            scan = scan._replace(image=photo.image, depth=photo.depth)
        return _titled(np.concatenate([camera_panels(scan, self.size), top], axis=1), note)


def _titled(picture: np.ndarray, note: str) -> np.ndarray:
    """Add a line of text above a picture: ``(H + TITLE, W, 3)`` uint8."""
    line = np.full((TITLE, picture.shape[1], 3), 255, np.uint8)
    cv2.putText(line, note, (6, 14), _FONT, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return np.concatenate([line, picture], axis=0)


def _label(picture: np.ndarray, text: str) -> None:
    """Write text on a white patch in the upper left corner of ``(H, W, 3)`` uint8, in place."""
    (width, height), below = cv2.getTextSize(text, _FONT, 0.4, 1)
    cv2.rectangle(picture, (0, 0), (width + 7, height + below + 3), (255, 255, 255), -1)
    cv2.putText(picture, text, (4, height + 2), _FONT, 0.4, (0, 0, 0), 1, cv2.LINE_AA)


def _color_scale(depth: np.ndarray) -> None:
    """Draw the scale of the colors along the lower edge of ``(H, W, 3)`` uint8, in place."""
    height, width = depth.shape[:2]
    left, right, top, low = 30, width - 30, height - 16, height - 6
    depth[top - 4 :] = 255
    meters = np.linspace(ROBOT.near, ROBOT.far, right - left)
    depth[top:low, left:right] = color_depth(np.tile(meters, (low - top, 1)), ROBOT.near, ROBOT.far)
    for text, column in ((f"{ROBOT.near:g}", 4), (f"{ROBOT.far:g}", right + 6)):
        cv2.putText(depth, text, (column, low), _FONT, 0.4, (0, 0, 0), 1, cv2.LINE_AA)


def camera_panels(scan: SensorScan, size: int) -> np.ndarray:
    """Photo, depth and sector bars, one below the other ``(size, w, 3)`` uint8 RGB.

    Photo and depth are 2/5 of ``size`` high, ``w`` is 4/3 of that.
    """
    height = size * 2 // 5
    width = height * 4 // 3
    photo = depth = np.full((height, width, 3), 225, np.uint8)
    if scan.image is not None:
        photo = np.asarray(cv2.resize(scan.image, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)
        if scan.boxes is not None:
            camera = PinholeCamera(robot_intrinsics((height, width)))
            photo = draw_boxes(photo, scan.boxes, camera)
        _label(photo, "camera")
    if scan.depth is not None:
        colors = color_depth(scan.depth, ROBOT.near, ROBOT.far, scan.depth > 0)
        depth = np.asarray(cv2.resize(colors, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)
        _color_scale(depth)
        _label(depth, "depth [m]")
    return np.concatenate([photo, depth, sector_bars(scan, (size - 2 * height, width))], axis=0)


def sector_bars(scan: SensorScan, size: tuple[int, int]) -> np.ndarray:
    """Nearest range [m] and its source per sector, left to right: ``(*size, 3)`` uint8 RGB."""
    height, width = size
    picture: np.ndarray = np.full((height, width, 3), 255, np.uint8)
    for number, (near, source) in enumerate(zip(scan.sectors, scan.sectors_fed_by, strict=True)):
        distance = float(near)
        left = (SECTORS - 1 - number) * width // SECTORS
        right = (SECTORS - number) * width // SECTORS
        top = height - 2 - round((height - 34) * math.sqrt(distance / ROBOT.far))  # below the title
        cv2.rectangle(picture, (left + 3, top), (right - 3, height - 2), _FED[source], -1)
        cv2.putText(picture, f"{distance:.1f}", (left + 8, top - 4), _FONT, 0.38, (0, 0, 0), 1, cv2.LINE_AA)
        short = source.replace("simulator", "rays")
        cv2.putText(picture, short, (left + 8, height - 8), _FONT, 0.36, (255, 255, 255), 1, cv2.LINE_AA)
    _label(picture, "nearest [m]")
    return picture


def record_episode(
    arena: Arena,
    policy: Policy,
    sensor: Sensor,
    path: Path,
    settings: EpisodeSettings = EpisodeSettings(),  # noqa: B008 - immutable
    *,
    advance: Callable[[int], None] = lambda count: None,
) -> tuple[Event, float]:
    """Run one episode and write it as a video at true speed; no display is needed.

    The ending of ``path`` is one of ``VIDEO_FORMATS``; ``advance`` is called for each frame.

    Returns:
        How the episode ended, and its duration [s].
    """
    episodes = Episodes(1, sensor, settings)
    episodes.start(0, arena, (settings.seed, arena.index))
    policy.reset(0, episodes.worlds[0])
    scene, view = Scene(arena), ArenaView(arena)
    event = Event.NONE
    with video_writer(path, 1 / ROBOT.period) as add:
        while True:
            senses = episodes.sense()
            scene.trail.append(tuple(episodes.poses[0]))
            now = f"{episodes.seconds[0]:4.1f} s  {scene.speed:.1f} m/s{_ENDS[event]}"
            note = f"{policy.name}  {arena.name}  true speed  {now}"
            frame = scene.draw(episodes, 0, note, view)
            for _ in range(1 if event is Event.NONE else 8):  # the last frame stays for a moment
                add(frame)
            advance(1)
            if event is not Event.NONE:
                return event, float(episodes.seconds[0])
            _, events = episodes.step(policy.commands(senses))
            event = Event(int(events[0]))


@contextmanager
def video_writer(path: Path, per_second: float) -> Iterator[Callable[[np.ndarray], None]]:
    """Yield a function that adds a frame ``(H, W, 3)`` uint8 RGB to a ``.gif``, ``.webp`` or ``.mp4``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".mp4":
        from eldenet.deploy.video_files import open_video

        with open_video(path, per_second) as add:
            yield add
        return
    from PIL import Image

    frames: list[Image.Image] = []
    if path.suffix == ".webp":
        yield lambda frame: frames.append(Image.fromarray(frame))
        options: dict[str, Any] = {"quality": WEBP_QUALITY, "method": 4}
    else:
        yield lambda frame: frames.append(Image.fromarray(frame).quantize(method=Image.Quantize.FASTOCTREE))
        options = {"optimize": False}
    duration = round(1000 / per_second)
    with part_file(path) as unfinished:
        first, *others = frames
        first.save(unfinished, save_all=True, append_images=others, duration=duration, loop=0, **options)

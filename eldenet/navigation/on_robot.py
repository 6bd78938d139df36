"""A driver on a robot: depth, goal and odometry in, speed and turn rate out, five times per second.

Imports neither MuJoCo nor Gymnasium.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from eldenet.geometry import PinholeCamera, check_meters, intrinsic_matrix, level_rotation
from eldenet.navigation.floor import Leveler
from eldenet.navigation.latency import MAX_LATENCY, ahead, check_latency
from eldenet.navigation.lidar import Scan, scan_to_ranges
from eldenet.navigation.observer import Observer, Senses
from eldenet.navigation.range_filter import RangeFilter
from eldenet.navigation.range_scale import RangeScale
from eldenet.navigation.ranges import CAUTION, depth_to_ranges, fill_unseen
from eldenet.navigation.watch import Look, Watch, absurd
from eldenet.simulation.robot import ROBOT, front
from eldenet.system.errors import warn_once
from eldenet.uncertainty import DepthEstimate

MOST_UNSURE = 0.85  # share of a depth map that may be unsure; with more, the robot stands still
TURN = 2 * math.pi + 1e-6  # [rad], and its rounding
FLOOR_FROM = 1.4  # [m] before the lens: a picture should show the floor from here on at the latest
SENT = round(MAX_LATENCY / ROBOT.period) + 1  # commands that are kept
POSE, GOAL = ("x", "y", "heading"), ("distance", "bearing")


class OnRobot:
    """Base class of the drivers that a robot can use; a subclass has ``commands`` and ``reset``.

    Attributes:
        observer: whose ``last`` is the command that the robot executes.
        range_filter: that :meth:`step` passes its ranges through; None: none.
        range_scale: that :meth:`step` then corrects them with, for a camera that measures all ranges too long
            or too short; None (default): nothing.
        leveler: that corrects an unknown tilt of the camera and a wrong scale of its depth by the floor; None
            (default): nothing.
        watch: that stops it when something is wrong, see :mod:`eldenet.navigation.watch`; None: none.
        stop_reason: why the last :meth:`step` stopped the robot; None: it drives.
    """

    observer: Observer
    #: Way that it may drive without coming nearer to its goal [m].
    patience = 30.0

    def __init__(self) -> None:
        self.watch: Watch | None = Watch(self.patience)
        self.range_filter: RangeFilter | None = RangeFilter()
        self.range_scale: RangeScale | None = None
        self.leveler: Leveler | None = None
        self.stop_reason: str | None = None
        self._origin: np.ndarray | None = None  # of step's poses (1, 3)
        self._sent: list[tuple[float, float]] = []

    def commands(self, senses: Senses, robots: np.ndarray | None = None) -> np.ndarray:
        """Speed [m/s] and turn rate [rad/s] ``(N, 2)``."""
        raise NotImplementedError

    @property
    def no_way(self) -> bool:
        """Whether the driver's map has closed every way to the goal; one that plans none does not know."""
        return False

    def reset(self, robot: int | slice = slice(None), world: Any = None) -> None:
        """Forget what a robot saw; call this at every new start."""
        self.stop_reason = None
        self._origin = None
        self._sent = []
        for part in (self.range_filter, self.range_scale, self.watch):
            if part is not None:
                part.reset()

    def wait(self) -> None:
        """Note that the robot executed ``observer.last`` for a period; call this for each without a step."""
        self._sent = [*self._sent, tuple(self.observer.last[0].tolist())][-SENT:]

    def step(
        self,
        depth: np.ndarray | Scan,
        goal: Sequence[float],
        odometry: Sequence[float],
        *,
        sigma: np.ndarray | None = None,
        intrinsics: np.ndarray | Sequence[Any] | None = None,
        image: np.ndarray | None = None,
        camera_height: float = ROBOT.camera_height,
        camera_pitch: float = 0.0,
        camera_roll: float = 0.0,
        stamp: float | None = None,
        scanned_from: Sequence[float] | None = None,
        latency: float = 0.0,
        max_speed: float = ROBOT.max_speed,
    ) -> tuple[float, float]:
        """Decide for a driver of one robot; call this every 0.2 s, each time with a new depth map.

        A depth map that comes twice counts as two scans that agree.

        At the goal, with input that is not finite or cannot be true, or where :attr:`watch` finds a fault, it
        stops the robot and says why in :attr:`stop_reason`; it drives on as soon as that is over. The driver
        remembers nothing of such a period, unless the fault is that it gets nowhere.

        Args:
            depth: depth map ``(H, W)`` [m], with ``intrinsics``; or a lidar's
                :class:`~eldenet.navigation.lidar.Scan`, of any angles; or ranges ``(columns,)``
                [m], equal in angle over the field of view, right to left; or those of five sectors ``(5,)``.
            goal: distance [m] and bearing [rad, counter-clockwise from ahead].
            odometry: x, y [m] and heading [rad] in any fixed frame.
            sigma: standard deviation of a network's depth map ``(H, W)`` [m], read as Laplace's. The robot
                drives as slowly as the low end of the depth's interval asks for, and forgets remembered
                obstacles only up to there. None: the depth is as it says, as a depth camera's.
            intrinsics: ``(3, 3)`` or ``(fx, fy, cx, cy)`` of the depth map [px].
            image: frame ``(H, W, 3)`` uint8 RGB that the depth was predicted from, which shows a covered or
                frozen lens.
            camera_height: of its optical center above the floor [m].
            camera_pitch: of its optical axis below the horizon [rad].
            camera_roll: about that axis, clockwise as it looks [rad].
            stamp: time of ``depth`` by ``time.monotonic`` (:attr:`watch` has the clock) [s]; None: not known.
            scanned_from: the odometry at the time of ``depth``, if that is older; None: ``odometry``.
            latency: from the time of ``odometry`` until the robot executes the command [s]. The driver
                decides for the pose that its last commands lead to until then.
            max_speed: a faster command is slowed down on the same arc [m/s].

        Returns:
            Speed [m/s] and turn rate [rad/s, counter-clockwise]; (0.0, 0.0) where it stops. Unknown ranges
            or sectors (0, nan) read as near, and inf as free; of a depth map and a scan, see
            :func:`~eldenet.navigation.ranges.depth_to_ranges` and
            :func:`~eldenet.navigation.lidar.scan_to_ranges`.

        Raises:
            ValueError: an argument is no number or has no numbers, ``depth`` or ``image`` has another shape,
                ``depth`` is in millimeters, ``sigma`` is not of its shape, a pose, goal or intrinsics have
                another length, a goal's bearing is in degrees, a depth map has no intrinsics or those of no
                lens, its camera or lidar sees less than 25 degrees to each side, a scan's angles are not one
                in radians per range, or ``camera_height``, ``latency``, ``max_speed`` or a tilt is out of
                range.
        """
        for name, value in (
            ("camera_height", camera_height), ("camera_pitch", camera_pitch), ("camera_roll", camera_roll),
            ("stamp", 0.0 if stamp is None else stamp), ("latency", latency), ("max_speed", max_speed),
        ):  # fmt: skip
            if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
                raise ValueError(f"{name}={value!r:.60}: give a number")
        check_latency(latency)
        if not 0 < max_speed < math.inf:
            raise ValueError(f"max_speed={max_speed}: give a finite speed above 0 [m/s]")
        scan = None
        if isinstance(depth, Scan):
            scan = Scan(_numbers("ranges", depth.ranges), _numbers("angles", depth.angles), depth.ahead)
            depth = scan.ranges
        depth = _numbers("depth", depth)  # its own type, which as_ranges checks
        sigma = None if sigma is None else _numbers("sigma", sigma).astype(np.float64)
        image = None if image is None else _picture(image)
        now, goal_row = _row("odometry", odometry, POSE), _row("goal", goal, GOAL)  # (1, 3), (1, 2)
        check_bearing(goal_row[0, 1], now[0, 2])
        scanned = None if scanned_from is None else _row("scanned_from", scanned_from, POSE)
        matrix = None if intrinsics is None else intrinsic_matrix(intrinsics, check=False)
        self.wait()
        reason = unfit(depth, matrix, now, goal_row, scanned)
        if reason is None and sigma is not None and (unsure := unsure_share(depth, sigma)) > MOST_UNSURE:
            reason = f"{unsure:.0%} of the view is unsure: a covered lens, darkness or a bare wall"
        if reason is None and self.watch is not None:
            reason = self.watch.arrived(goal_row[0, 0]) or self.watch.stale(stamp, latency)
        if reason is not None:
            return self._stand(reason)
        tilt, camera, raw = (camera_pitch, camera_roll), None, depth
        if depth.ndim == 2 and matrix is not None:
            camera = PinholeCamera(matrix, level_rotation(*tilt))
            _warn_of_floor_below(depth.shape[0], matrix, camera_height, camera_pitch)
        if self.leveler is not None and camera is not None:
            pitch, roll, factor = self.leveler(depth, camera, camera_height)
            if (pitch, roll, factor) != (0.0, 0.0, 1.0):
                tilt, depth, camera = (camera_pitch + pitch, camera_roll + roll), depth * factor, None
                sigma = None if sigma is None else sigma * factor
        try:
            ranges = low = as_ranges(depth if scan is None else scan, matrix, camera_height, tilt=tilt)
        except ValueError as error:
            if tilt == (camera_pitch, camera_roll):
                raise
            return self._stand(f"the camera is not as it was said: {error}")  # by the leveler, in a drive
        if sigma is not None:
            low = as_ranges(depth, matrix, camera_height, tilt=tilt, low=nearest_depth(depth, sigma))
        ranges, cautious = fill_unseen(ranges, low)
        if self.watch is not None:
            measured, hole = ranges, ~((depth > 0) | np.isneginf(depth))
            if depth.ndim == 2 and hole.any():  # where the camera's reach ends, a hole drives along
                known = np.where(hole, np.inf, depth)
                measured = fill_unseen(as_ranges(known, matrix, camera_height, tilt=tilt), low)[0]
            look = Look(raw, front(ranges), front(measured), now[0], image, camera, camera_height, latency)
            if (reason := self.watch.judge(look, self._sent)) is not None:
                return self._stand(reason)
        given_pose, given_goal = now[0], goal_row[0]  # of now: the driver decides for a later time
        # the memory has float32, which does not suffice for positions such as UTM's
        self._origin = now * (1, 1, 0) if self._origin is None else self._origin
        now, scanned = now - self._origin, None if scanned is None else scanned - self._origin
        for part in (self.range_filter, self.range_scale):
            if part is not None:
                ranges, near = part(ranges, (now if scanned is None else scanned)[0], cautious)
                cautious = ranges if near is None else near
        if latency:
            scanned = now if scanned is None else scanned
            now, goal_row = (row[None] for row in ahead(now[0], goal_row[0], self._sent, latency))
        command = self.commands(Senses(ranges[None], now, goal_row, cautious[None], scanned))[0]
        if abs(command[0]) > max_speed:
            command = command * (max_speed / abs(command[0]))
            self.observer.last[0] = command
        if self.watch is not None:
            reason = self.watch.lost(given_pose, given_goal, self.no_way)
        if reason is not None:
            return self._stand(reason)
        self.stop_reason = None
        speed, turn = command.tolist()
        return speed, turn

    def _stand(self, reason: str) -> tuple[float, float]:
        self.stop_reason = reason
        self.observer.last[:] = 0.0
        return 0.0, 0.0


def unfit(
    depth: np.ndarray,
    intrinsics: np.ndarray | None,
    odometry: np.ndarray,
    goal: np.ndarray,
    scanned_from: np.ndarray | None,
) -> str | None:
    """Why nothing can be decided by these; None: it can.

    Args:
        depth: as in :meth:`OnRobot.step`, ranges of a scan.
        intrinsics: ``(3, 3)`` [px].
        odometry: ``(1, 3)`` x, y [m], heading [rad].
        goal: ``(1, 2)`` distance [m], bearing [rad].
        scanned_from: ``(1, 3)``, as ``odometry``.
    """
    if intrinsics is not None and not np.isfinite(intrinsics).all():
        return "intrinsics not finite"
    if depth.size and not ((depth > 0) | np.isneginf(depth)).any():
        return "no value of depth is known"
    seen = Senses(np.zeros((1, 1)), odometry, goal, scanned_from=scanned_from)
    return seen.not_finite or absurd(depth, goal[0], odometry[0])


def _numbers(name: str, values: Any) -> np.ndarray:
    """Return numbers as an array of their own type."""
    try:
        array = np.asarray(values)
    except ValueError:  # rows of several lengths
        array = np.array(None)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name}={' '.join(repr(values).split())[:60]}: give an array of numbers")
    return array


def _picture(values: Any) -> np.ndarray:
    """Return a frame ``(H, W, 3)`` uint8 RGB as an array."""
    image = _numbers("image", values)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or not image.size:
        raise ValueError(
            f"image has type {image.dtype} and shape {image.shape}: give the camera's frame (H, W, 3) uint8 "
            "RGB"
        )
    return image


def check_bearing(bearing: float, heading: float) -> None:
    """Raise ``ValueError`` for a goal's bearing that looks like degrees; infinite and nan pass.

    A heading that was never wrapped may be any number of turns, and so may a bearing that takes it off.
    """
    if TURN < abs(bearing) < math.inf and not abs(bearing + heading) <= TURN:
        raise ValueError(
            f"goal: a bearing of {bearing:g} is more than a turn: degrees? Give radians, counter-clockwise "
            f"from ahead ({bearing:g} degrees are {math.radians(bearing):.3g}); math.remainder(bearing, "
            "math.tau) wraps others"
        )


def _row(name: str, values: Sequence[float], parts: Sequence[str]) -> np.ndarray:
    """Return numbers as ``(1, len(parts))``."""
    try:
        row = np.asarray(values, np.float64)
    except (TypeError, ValueError):  # no numbers, or rows of several lengths
        row = np.empty(0)
    if row.shape != (len(parts),):
        raise ValueError(f"{name}={values}: give ({', '.join(parts)}), {len(parts)} numbers")
    return row[None]


def unsure_share(depth: np.ndarray, sigma: np.ndarray) -> float:
    """Return the share of a depth map ``(H, W)`` [m] whose ``sigma (H, W)`` [m] is too large or unknown.

    Raises:
        ValueError: ``sigma`` has another shape, or ``depth`` is no map.
    """
    if depth.ndim != 2 or sigma.shape != depth.shape:
        raise ValueError(f"sigma has shape {sigma.shape}, depth {depth.shape}: give both as (H, W) [m]")
    return float(np.mean(~(sigma >= 0) | DepthEstimate(depth, sigma).unsure))


def nearest_depth(depth: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return how near things may be ``(H, W)`` [m], of a depth map with ``sigma (H, W)`` [m].

    It is 0 where sigma is nan or negative, and inf where depth is unknown.
    """
    with np.errstate(all="ignore"):
        low = DepthEstimate(depth, sigma, "laplace").interval(CAUTION)[0]
    return np.where(depth > 0, np.where((sigma >= 0) & ~np.isnan(low), low, 0.0), np.inf)


def _warn_of_floor_below(rows: int, matrix: np.ndarray, height: float, pitch: float) -> None:
    """Warn once where low things leave the picture below so far ahead that the robot forgets them."""
    down = pitch + math.atan((rows - 0.5 - matrix[1, 2]) / matrix[1, 1])  # of the lowest ray [rad]
    if down <= 0 or height / math.tan(down) > FLOOR_FROM:  # beyond straight down the tangent is below 0
        seen = f"only from {height / math.tan(down):.1f} m on" if down > 0 else "nowhere"
        warn_once(
            f"a camera {height:g} m high with camera_pitch={pitch:g} shows the floor {seen}, so low things "
            f"are forgotten before the robot is past them: tilt it down to show it from {FLOOR_FROM:g} m on"
        )


def as_ranges(
    depth: np.ndarray | Scan,
    intrinsics: np.ndarray | Sequence[Any] | None,
    camera_height: float = ROBOT.camera_height,
    *,
    tilt: tuple[float, float] = (0.0, 0.0),
    low: np.ndarray | None = None,
) -> np.ndarray:
    """Return ranges ``(columns,)`` [m] from a depth map, a scan (all round), columns, or sectors.

    Columns beside the view of a depth map are nan. ``tilt`` is its camera's pitch and roll [rad],
    ``low (H, W)`` [m] how near its things may be.
    """
    if isinstance(depth, Scan):
        return scan_to_ranges(depth)
    if depth.ndim == 2:
        if intrinsics is None:
            raise ValueError("a depth map needs intrinsics=(fx, fy, cx, cy) of its camera [px]")
        return depth_to_ranges(depth, intrinsics, camera_height=camera_height, tilt=tilt, low=low)
    if depth.ndim != 1 or not depth.size or ROBOT.columns % depth.size:
        raise ValueError(
            f"depth has shape {depth.shape}: give depth (H, W), ranges ({ROBOT.columns},) or sectors (5,)"
        )
    check_meters(depth)
    # unknown (0, nan) counts as near: the robot must stop where its camera is blind; inf is free
    known = depth > 0
    ranges = np.where(known, np.clip(depth.astype(np.float64), ROBOT.near, ROBOT.far), ROBOT.near)
    return np.repeat(ranges, ROBOT.columns // depth.size)

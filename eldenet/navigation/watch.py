"""What a driver on a robot must not drive by: each rule names one fault, and why the robot then stands.

Needs NumPy and OpenCV, no simulator; :meth:`~eldenet.navigation.on_robot.OnRobot.step` asks it every time.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from eldenet.geometry import PinholeCamera
from eldenet.navigation.floor import Floor, find_floor
from eldenet.navigation.range_filter import seen_from
from eldenet.simulation.robot import ROBOT

GOAL_TOLERANCE = 0.5  # as in training [m]
FARTHEST = 1e8  # greatest distance of a goal, and of a pose from the origin [m]: a GPS receiver's are 1e7
TOO_NEAR = 0.05  # no camera measures less: then it is another unit [m]
NEARLY_ALL = 0.95  # share of the known values
STALE = 0.4  # age that data may have beyond the latency [s]
CONTENT = 4.5  # 99 % of the second derivatives of a picture 32 x 24 are below it behind a covered lens
REPEATS = 2  # pictures in a row that repeat the one before, or show nothing
MOVED, TURNED = 0.02, 0.02  # motion after which a scan must differ [m], [rad]
EVEN = 0.2  # share of a scan that may differ then though it shows even walls only
SAME_RANGE, SAME_PIXEL = 0.05, 2.5  # change of a view that stays: median of ranges, mean of gray levels
OTHER_RANGE = 0.15  # relative change of a range that noise does not make
SLIPS = 5  # periods in a row in which the view stays though it cannot: a camera may be that much behind
STANDS = 0.001  # motion of a pose that stands [m], [rad]
LAG = 1.0  # time for which a robot that is told to drive may stand, beyond the latency [s]
TOLD, TOLD_TURN = 0.1, 0.2  # what it was told meanwhile, at least [m], [rad]
SLOWEST, SLOWEST_TURN = 0.1, 0.2  # commands below both are not compared with the odometry [m/s], [rad/s]
COMPARED, FEWEST = 25, 6  # last periods with such commands; fewest of them to judge by
OTHER_UNIT = 10.0  # factor between told and measured motion
SLUGGISH = 6  # periods by which wheels that slip, or a latency that nobody told, delay a turn
TOLD_FAR, OPPOSITE, AGREES = 2.0, -0.7, 0.3  # turns that were told [rad]; correlations with those measured
ALONG = 0.5  # of the way: a robot that drives moves at least so much along its heading
TILT = math.radians(4.0)  # by which the floor may be off its level [rad]
SCALE = 1.25  # factor by which the floor may be off its height
FLOORS = 5  # last floors, whose median counts
STUCK_WAY, STUCK_TIME = 0.3, 30.0  # a robot that stays within a way [m] for a time [s] is stuck
NEARER = 0.5  # progress toward the goal that counts [m]


class Look(NamedTuple):
    """What a driver is given in one period.

    Attributes:
        depth: as given, of any shape [m].
        ranges: ``(columns,)`` of it, the camera's [m].
        measured: the same where holes in a depth map count as far [m].
        pose: ``(3,)`` x, y [m] and heading [rad] of the odometry.
        image: ``(H, W, 3)`` uint8 that the depth was predicted from; None: unknown.
        camera: of a depth map, in the level frame; None: ranges.
        height: of the camera above the floor [m].
        latency: until commands are executed [s].
    """

    depth: np.ndarray
    ranges: np.ndarray
    measured: np.ndarray
    pose: np.ndarray
    image: np.ndarray | None
    camera: PinholeCamera | None
    height: float
    latency: float


class Move(NamedTuple):
    """What a robot was told in one period, way [m] and turn [rad], and what its odometry did.

    Attributes:
        told: way, 0 or more.
        told_turn: counter-clockwise.
        way: that it drove.
        ahead: part of the way along its heading, negative where it moves the other way than told.
        turned: difference of the headings, not wrapped.
    """

    told: float
    told_turn: float
    way: float
    ahead: float
    turned: float


class Watch:
    """Stops one robot by what it is given, period by period.

    Args:
        patience: way that it may drive without coming nearer to its goal [m].

    Attributes:
        tolerance: distance below which a goal is reached [m].
        clock: what ``stamp`` is compared with [s].
    """

    def __init__(self, patience: float) -> None:
        self.patience = patience
        self.tolerance = GOAL_TOLERANCE
        self.clock: Callable[[], float] = time.monotonic
        self.reset()

    def reset(self) -> None:
        """Forget what was seen; call this at every new start."""
        self._seen: Look | None = None  # the first look with the present picture
        self._repeats = self._empty = self._slips = 0
        self._still: tuple[Look, np.ndarray | None] | None = None  # the first look with the present view
        self._stood: np.ndarray | None = None  # where the odometry stands
        self._told = np.zeros(3)  # way [m], turn [rad] and time [s] that it was told to drive since
        self._last: np.ndarray | None = None  # pose one period ago, for contrary_odometry
        self._moves: deque[Move] = deque(maxlen=COMPARED)
        self._contrary: str | None = None
        self._floors: deque[Floor] = deque(maxlen=FLOORS)
        self._nearest = math.inf
        self._goal = np.full(2, math.nan)
        self._way = 0.0  # since the goal was nearest [m]
        self._before: np.ndarray | None = None  # pose one period ago, for lost
        self._places: deque[np.ndarray] = deque(maxlen=round(STUCK_TIME / ROBOT.period))

    def judge(self, look: Look, sent: Sequence[tuple[float, float]]) -> str | None:
        """Why the robot must stand; None if nothing is wrong. ``sent`` are its commands, oldest first."""
        # all of them, whatever the first says: each remembers what it sees
        rules = (
            self.covered(look),
            self.frozen_camera(look),
            self.frozen_odometry(look, sent),
            self.contrary_odometry(look, sent),
            self.slipping(look),
            self.floor(look),
        )
        return next((reason for reason in rules if reason), None)

    # --- the data of one period -----------------------------------------------------------------------------

    def stale(self, stamp: float | None, latency: float) -> str | None:
        """Data that are older than the latency allows, or from the future."""
        if stamp is None:
            return None
        age, allowed = self.clock() - stamp, latency + STALE
        if abs(age) <= allowed:
            return None
        when = f"{age:.1f} s old" if age > 0 else f"{-age:.1f} s in the future"
        return f"data are {when}, {allowed:.1f} s are allowed: check their rate, and the clock of stamp="

    def covered(self, look: Look) -> str | None:
        """A picture without contrast: a network also predicts depth for a covered lens."""
        self._empty = 0 if look.image is None or has_content(look.image) else self._empty + 1
        if self._empty < REPEATS:
            return None
        return "the picture shows nothing: a covered lens, darkness or a bare wall"

    # --- over time ------------------------------------------------------------------------------------------

    def frozen_camera(self, look: Look) -> str | None:
        """Picture or depth that stays the same, to the last bit, while the odometry moves."""
        if self._seen is None or not _same(look, self._seen):
            # copies: callers may write the next frame into the same array
            image = None if look.image is None else look.image.copy()
            self._seen, self._repeats = look._replace(depth=look.depth.copy(), image=image), 0
            return None
        self._repeats += 1
        way, turn = motion(self._seen.pose, look.pose)
        if self._repeats < REPEATS or (way < MOVED and turn < TURNED):
            return None
        if look.image is None and not changes(look.ranges, self._seen.pose, look.pose):
            return None
        return "the picture does not change while the wheels turn: a frozen camera"

    def frozen_odometry(self, look: Look, sent: Sequence[tuple[float, float]]) -> str | None:
        """Odometry that stands though the robot is told to drive, until it moves again or :meth:`reset`."""
        if self._stood is None or max(motion(self._stood, look.pose)) > STANDS:
            self._stood, self._told = look.pose, np.zeros(3)
            return None
        speed, turn = _executed(look, sent)
        if speed or turn:
            self._told += np.array([abs(speed), abs(turn), 1.0]) * ROBOT.period
        way, turned, seconds = self._told
        if seconds < LAG - 1e-9 or (way < TOLD and turned < TOLD_TURN):
            return None
        return (
            f"the odometry stands though the robot was told to drive for {seconds:.1f} s: frozen, or the "
            "motors are off; reset() once that is over"
        )

    def contrary_odometry(self, look: Look, sent: Sequence[tuple[float, float]]) -> str | None:
        """Odometry that contradicts the commands, by a sign, order or unit, until :meth:`reset`."""
        before, self._last = self._last, look.pose
        speed, turn = _executed(look, sent)
        drives = abs(speed) >= SLOWEST or abs(turn) >= SLOWEST_TURN
        if self._contrary is None and before is not None and drives:
            dx, dy, turned = look.pose - before
            middle = before[2] + math.remainder(turned, math.tau) / 2
            ahead = math.copysign(1.0, speed) * (dx * math.cos(middle) + dy * math.sin(middle))
            told, told_turn = abs(speed) * ROBOT.period, turn * ROBOT.period
            self._moves.append(Move(told, told_turn, math.hypot(dx, dy), ahead, turned))
            self._contrary = contradiction(self._moves)
        return self._contrary

    def slipping(self, look: Look) -> str | None:
        """A view that stays as it is, but for noise, though the odometry moves so that it cannot."""
        small = None if look.image is None else _small(look.image)
        if self._still is None or not stays(look, small, *self._still):
            self._still, self._slips = (look, small), 0
        elif contradicts(look, self._still[0]):
            self._slips += 1
        if self._slips < SLIPS:
            return None
        return (
            "the view stays as it is while the odometry moves: the wheels slip, or the camera is frozen; "
            "reset() once that is over"
        )

    def floor(self, look: Look) -> str | None:
        """The floor of the depth map is not where the camera's height, pitch and roll put it."""
        found = None if look.camera is None else find_floor(look.depth, look.camera)
        if found is None:
            return None
        self._floors.append(found)
        if len(self._floors) < FLOORS:
            return None
        pitch, roll, height = np.median(self._floors, axis=0)
        for name, angle in (("pitch", pitch), ("roll", roll)):
            if abs(angle) > TILT:
                return (
                    f"the floor is tilted by {math.degrees(abs(angle)):.0f} degrees: the camera's {name} is "
                    f"{angle:+.2f} rad more than camera_{name}= says"
                )
        factor = height / look.height
        if not 1 / SCALE < factor < SCALE:
            return (
                f"the floor is {height:.2f} m below the camera, not {look.height:g}: camera_height or the "
                f"depth's scale is off by a factor of {factor:.2f}"
            )
        return None

    # --- the goal -------------------------------------------------------------------------------------------

    def arrived(self, distance: float) -> str | None:
        """The goal is reached."""
        return "goal reached" if distance < self.tolerance else None

    def lost(self, pose: np.ndarray, goal: np.ndarray, no_way: bool) -> str | None:
        """A goal ``(2,)`` (distance [m], bearing [rad]) to which no way is known, or long none is found.

        ``no_way`` is whether a planner's map has closed every way from ``pose (3,)``.
        """
        distance, bearing = goal.tolist()
        at = pose[:2] + distance * np.array([math.cos(pose[2] + bearing), math.sin(pose[2] + bearing)])
        if not math.dist(at, self._goal) < NEARER:  # another one
            self._goal, self._nearest = at, math.inf
            self._places.clear()
        self._way += 0.0 if self._before is None else math.dist(pose[:2], self._before[:2])
        self._before = pose
        if distance < self._nearest - NEARER:
            self._nearest, self._way = distance, 0.0
        self._places.append(pose[:2])
        if no_way:
            return "no way to the goal is left on the map of what was seen: an unreachable goal"
        if self._way > self.patience:
            return f"{self._way:.0f} m driven without coming nearer to the goal: unreachable, or a dead end"
        places = np.array(self._places)
        if len(places) == self._places.maxlen and np.ptp(places, axis=0).max() < STUCK_WAY:
            return (
                f"the robot has not left its place for {STUCK_TIME:g} s: nothing is free ahead; another "
                "goal, or reset() once that is over"
            )
        return None


def _executed(look: Look, sent: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Speed [m/s] and turn rate [rad/s] that the robot executed in the last period."""
    late = math.ceil(look.latency / ROBOT.period - 1e-9)
    return sent[-1 - late] if len(sent) > late else (0.0, 0.0)


def contradiction(moves: Sequence[Move]) -> str | None:
    """What is wrong with odometry that contradicts the commands; None: nothing, or too little was driven."""
    told, told_turn, way, ahead, turned = np.array(moves).T
    wrapped = np.abs(np.abs(turned) - math.tau) < 0.5  # from pi to -pi
    turned = np.where(wrapped, turned - np.copysign(math.tau, turned), turned)
    after = "; reset() once that is mended"
    driven = (told >= SLOWEST * ROBOT.period) & (way > SLOWEST * ROBOT.period)
    if driven.sum() >= FEWEST:
        if (factor := np.median(way[driven] / told[driven])) > OTHER_UNIT:
            return f"the odometry moves {factor:.0f} times as far as the robot was told: give meters{after}"
        if (share := np.median(ahead[driven] / way[driven])) < ALONG:
            angle = math.degrees(math.acos(max(share, -1.0)))
            return (
                f"the odometry moves {angle:.0f} degrees off its heading: give x, y [m], heading [rad] in "
                f"this order, heading 0 along x, counter-clockwise toward y{after}"
            )
    turning = np.abs(told_turn) >= SLOWEST_TURN * ROBOT.period
    factor = np.median(np.abs(turned[turning] / told_turn[turning])) if turning.sum() >= FEWEST else 0.0
    if factor > OTHER_UNIT:
        return f"the odometry turns {factor:.0f} times as far as the robot was told: give radians{after}"
    if len(moves) == COMPARED and np.abs(told_turn).sum() >= TOLD_FAR:
        agree = [_alike(told_turn[: COMPARED - late], turned[late:]) for late in range(SLUGGISH + 1)]
        if min(agree[:2]) < OPPOSITE and max(agree) < AGREES:
            return (
                "the odometry turns the other way than the robot was told: heading and turn rate are "
                f"counter-clockwise{after}"
            )
    return None


def _alike(one: np.ndarray, other: np.ndarray) -> float:
    """Correlation of turns ``(N,)`` about 0."""
    return float(one @ other / max(math.sqrt((one @ one) * (other @ other)), 1e-9))


def absurd(depth: np.ndarray, goal: np.ndarray, pose: np.ndarray) -> str | None:
    """Numbers that no camera, goal ``(2,)`` or pose ``(3,)`` has; None: they may be true."""
    known = depth[(depth > 0) | np.isneginf(depth)]
    if known.size and np.isneginf(known).all():
        return "all of the depth reads too close (-inf): a covered lens, or a wall at the camera"
    if known.size and (known < TOO_NEAR).mean() > NEARLY_ALL:
        return f"the depth is below {TOO_NEAR} m nearly everywhere: give meters"
    if not 0 <= goal[0] <= FARTHEST:
        return f"the goal is {goal[0]:g} m away: give 0 to {FARTHEST:g}"
    if not np.abs(pose).max() <= FARTHEST:
        return f"odometry={pose.tolist()}: give meters and radians, up to {FARTHEST:g}"
    return None


def has_content(image: np.ndarray) -> bool:
    """Whether a picture ``(H, W, 3)`` or ``(H, W)`` uint8 shows anything, behind the noise of its pixels."""
    import cv2

    # the glow through a finger is smooth
    edges = np.abs(cv2.Laplacian(_small(image), cv2.CV_32F))[1:-1, 1:-1]
    return bool(np.quantile(edges, 0.99) > CONTENT)


def _small(image: np.ndarray) -> np.ndarray:
    """Gray levels ``(24, 32)`` of a picture."""
    import cv2

    gray = image.mean(axis=2) if image.ndim == 3 else image.astype(float)
    return np.asarray(cv2.resize(gray.astype(np.float32), (32, 24), interpolation=cv2.INTER_AREA))


def motion(before: np.ndarray, now: np.ndarray) -> tuple[float, float]:
    """Way [m] and turn [rad] between two poses ``(3,)``."""
    return math.dist(before[:2], now[:2]), abs(math.remainder(float(now[2] - before[2]), math.tau))


def changes(ranges: np.ndarray, before: np.ndarray, now: np.ndarray) -> bool:
    """Whether a scan ``(columns,)`` [m] must look different after a motion: not along an even wall."""
    inside = (ranges > ROBOT.near) & (ranges < ROBOT.far)
    bearing, away = seen_from(now, ranges, before)
    seen = inside & (np.abs(bearing) < ROBOT.field_of_view / 2)
    expected = _toward(bearing[seen], ranges)
    return bool(seen.any() and (np.abs(expected - away[seen]) > MOVED / 2).mean() > EVEN)


def contradicts(look: Look, before: Look) -> bool:
    """Whether most of two scans agree with each other, but not with the motion between them."""
    inside = (look.measured > ROBOT.near) & (look.measured < ROBOT.far)
    bearing, away = seen_from(look.pose, look.measured, before.pose)
    seen = inside & (np.abs(bearing) < ROBOT.field_of_view / 2)
    first, second = (_toward(bearing[seen], ranges) for ranges in (before.measured, look.measured))
    wrong = (np.abs(np.log(first / away[seen])) > OTHER_RANGE) & (np.abs(np.log(first / second)) < SAME_RANGE)
    return bool(seen.any() and wrong.mean() > 0.5)


def _toward(bearing: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    """Ranges at other bearings [rad] of a scan ``(columns,)`` [m]: exact along straight walls."""
    return np.asarray(1 / np.interp(bearing, ROBOT.column_angles, 1 / ranges))


def stays(look: Look, small: np.ndarray | None, before: Look, before_small: np.ndarray | None) -> bool:
    """Whether two looks show the same but for noise; ``small (24, 32)`` are their pictures."""
    if small is not None and before_small is not None and np.abs(small - before_small).mean() > SAME_PIXEL:
        return False
    inside = np.minimum(look.measured, before.measured) < ROBOT.far
    changed = np.abs(np.log(look.measured[inside] / before.measured[inside]))
    return bool(inside.mean() > EVEN and np.median(changed) < SAME_RANGE)


def _same(look: Look, before: Look) -> bool:
    """Whether two looks show the same picture, or where there is none the same depth."""
    first, second = (
        (look.depth, before.depth)
        if look.image is None or before.image is None
        else (look.image, before.image)
    )
    return first.shape == second.shape and np.array_equal(first, second, equal_nan=first.dtype.kind == "f")

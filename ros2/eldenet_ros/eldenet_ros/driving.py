"""What the driving node decides, and when it stops the robot. Needs no ROS."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from eldenet.geometry import check_camera_height
from eldenet.navigation.latency import check_latency
from eldenet.navigation.lidar import Scan
from eldenet.navigation.on_robot import OnRobot
from eldenet.navigation.ranges import LOWEST_CAMERA
from eldenet.navigation.watch import GOAL_TOLERANCE

POSES = 1000  # that are kept: 0.5 s of a fast odometry, and more


@dataclass(frozen=True)
class Command:
    """Speed [m/s] and turn rate [rad/s, counter-clockwise], and why the robot stands; "" while it drives."""

    speed: float = 0.0
    turn: float = 0.0
    reason: str = ""


class Pilot:
    """Drives to a goal, and stops without fresh depth and odometry.

    The driver's own watch stops it too, such as for a camera that is frozen or has been tilted.

    Data are fresh while their stamp is less than ``stale`` from the clock, before or after it. So a topic
    that falls silent, a camera that repeats one picture, a slow network and clocks that differ stop the
    robot.

    Args:
        driver: decides; :class:`~eldenet.navigation.policy.Navigator`, or a planner that steers with it.
        camera_height: of the optical center above the floor [m].
        camera_pitch: of the optical axis below the horizon [rad].
        camera_roll: about that axis, clockwise as it looks [rad].
        max_speed: a faster command is slowed down, with its turn rate [m/s].
        latency: from the odometry until the robot executes the command [s].
        stale: data whose stamp is as far from the clock, or farther, stop the robot [s].

    Raises:
        ValueError: an argument is out of range.
    """

    def __init__(
        self,
        driver: OnRobot,
        *,
        camera_height: float,
        camera_pitch: float = 0.0,
        camera_roll: float = 0.0,
        max_speed: float = 1.0,
        latency: float = 0.0,
        stale: float = 0.5,
    ) -> None:
        for name, value in (("camera_height", camera_height), ("max_speed", max_speed), ("stale", stale)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}={value}: give a number above 0")
        check_camera_height(camera_height, LOWEST_CAMERA)
        check_latency(latency)
        self.driver = driver
        self.mount = {
            "camera_height": camera_height, "camera_pitch": camera_pitch, "camera_roll": camera_roll
        }  # fmt: skip
        self.max_speed, self.latency, self.stale = max_speed, latency, stale
        self.depth: np.ndarray | Scan | None = None
        self.sigma: np.ndarray | None = None
        self.intrinsics: np.ndarray | None = None
        self.poses: deque[tuple[float, tuple[float, float, float]]] = deque(maxlen=POSES)  # with stamps
        self.frame: str | None = None
        self.goal: tuple[float, float] | None = None
        self.stamps = {"depth": math.nan, "odometry": math.nan}
        self._decided: np.ndarray | Scan | None = None  # depth of the last decision
        self._command = Command()  # of that decision

    def see(
        self,
        depth: np.ndarray | Scan,
        intrinsics: np.ndarray | None,
        stamp: float,
        sigma: np.ndarray | None = None,
    ) -> None:
        """Take a depth image ``(H, W)`` [m], its intrinsics ``(3, 3)`` [px] and its ``stamp`` [s].

        ``sigma (H, W)`` [m] is a network's. A lidar's scan takes the place of the depth image, and has no
        intrinsics.
        """
        self.depth, self.intrinsics, self.sigma = depth, intrinsics, sigma
        self.stamps["depth"] = stamp

    def move(self, pose: tuple[float, float, float], frame: str, stamp: float) -> None:
        """Take a pose x, y [m], heading [rad] in ``frame``; ``stamp`` [s]. A new frame ends the goal."""
        if self.frame != frame:
            self.reset()  # the goal was a place in the other frame
        if self.frame != frame or (self.poses and stamp < self.poses[-1][0]):  # the clock began anew
            self.poses.clear()
        if math.isfinite(stamp):
            self.poses.append((stamp, pose))
        self.frame = frame
        self.stamps["odometry"] = stamp

    def aim(self, x: float, y: float, frame: str) -> str:
        """Drive to a point [m] in the odometry's frame; return "", or why it is rejected: then it stops."""
        self.goal = None
        if not (math.isfinite(x) and math.isfinite(y)):
            return "goal rejected: its position is not finite"
        if self.frame is None:
            return "goal rejected: no odometry yet; send it again later"
        if frame != self.frame:
            return (
                f"goal rejected: it is in frame '{frame}', the odometry in '{self.frame}': send it in that "
                "frame (in RViz, set Fixed Frame to it)"
            )
        self.goal = (x, y)
        self._decided = None
        return ""

    def reset(self) -> None:
        """Forget what stopped the robot, what it saw and the goal: it stands until there is another."""
        self.goal = None
        self.driver.reset()

    def decide(self, now: float) -> Command:
        """Return the command at ``now`` [s]; call this every 0.2 s."""
        command = self._without_step(now)
        if command is None:
            command = self._step()
        else:
            self.driver.wait()
        if not (math.isfinite(command.speed) and math.isfinite(command.turn)):
            command = Command(reason="the driver's command is not finite")
        self.driver.observer.last[:] = command.speed, command.turn  # what it does, whatever was chosen
        return command

    def _without_step(self, now: float) -> Command | None:
        """The command where the driver is not asked; None: it has something new to decide by."""
        for name, stamp in self.stamps.items():
            if math.isnan(stamp):
                return Command(reason=f"no {name} yet")
            if not abs(now - stamp) < self.stale:
                late = f"{abs(now - stamp):.1f} s {'in the future' if stamp > now else 'old'}"
                return Command(reason=f"{name} is {late}: check its publisher, its rate, and both clocks")
        if self.intrinsics is None and not isinstance(self.depth, Scan):
            return Command(reason="no camera_info of the depth yet")
        if self.goal is None or not self.poses or self.depth is None:
            return Command(reason="no goal")
        distance, bearing = self._towards(self.goal)
        if distance < GOAL_TOLERANCE:
            self.goal = None
            return Command(reason="goal reached")
        known = math.isfinite(distance) and math.isfinite(bearing)
        # the driver trusts two scans that agree, so a picture must not be given to it twice
        return self._command if known and self.depth is self._decided else None

    def _towards(self, goal: tuple[float, float]) -> tuple[float, float]:
        """Distance [m] and bearing [rad] of a point from the last pose; nan where that is not finite."""
        x, y, yaw = self.poses[-1][1]
        bearing = math.atan2(goal[1] - y, goal[0] - x) - yaw
        bearing = math.remainder(bearing, math.tau) if math.isfinite(bearing) else math.nan
        return math.dist((x, y), goal), bearing

    def _step(self) -> Command:
        """Let the driver decide."""
        try:
            speed, turn = self.driver.step(
                self.depth,
                self._towards(self.goal),
                self.poses[-1][1],
                sigma=self.sigma,
                intrinsics=self.intrinsics,
                **self.mount,
                scanned_from=self._pose_at(self.stamps["depth"]),
                latency=self.latency,
                max_speed=self.max_speed,
            )
        except ValueError as error:  # such as a camera that sees too little
            return Command(reason=str(error))
        if self.driver.stop_reason:
            return Command(reason=self.driver.stop_reason)
        self._decided, self._command = self.depth, Command(speed, turn)
        return self._command

    def _pose_at(self, stamp: float) -> tuple[float, float, float]:
        """Return the pose whose stamp is nearest: the network takes time, and the robot drives meanwhile."""
        return min(reversed(self.poses), key=lambda each: abs(each[0] - stamp))[1]

"""Localization from wheel odometry and occasional positions, such as from ultra-wideband beacons or GPS.

An extended Kalman filter estimates the pose and the errors of the odometry: the scale of distances and the
drift of the heading (Larsen, Bak, Andersen, Poulsen, "Location estimation for an autonomously guided vehicle
using an augmented Kalman filter to autocalibrate the odometry", FUSION 1998). A position contains no heading;
the filter learns it from driving.

Needs NumPy only, no simulator.
"""

import math
from typing import NamedTuple

import numpy as np

Pose = tuple[float, float, float]
#: Standard deviations of x, y [m] and heading [rad]: at the start, and by wheel slip in a meter.
_AT_START, _SLIP = (0.02, 0.02, 0.01), (0.01, 0.01, 0.003)


class Drift(NamedTuple):
    """Errors of wheel odometry, drawn from normal distributions once per episode.

    Attributes:
        distance: standard deviation of the scale of distances.
        heading: standard deviation of the heading's drift [rad/m].
    """

    distance: float = 0.02
    heading: float = math.radians(1.0)


EXACT, USUAL = Drift(0.0, 0.0), Drift()


class Localizer:
    """Pose estimate of one robot.

    Args:
        pose: at the start, also of the odometry: x, y [m], heading [rad], in the frame of the positions.
        deviation: standard deviation of the positions [m].
        distance: expected standard deviation of the odometry's scale of distances.
        heading: expected standard deviation of its heading drift [rad/m].

    Attributes:
        odometry: odometry without the errors known so far ``(x, y, heading)``. It does not jump at a fix, so
            remembered obstacles keep their place.
    """

    def __init__(
        self,
        pose: Pose,
        *,
        deviation: float,
        distance: float = USUAL.distance,
        heading: float = USUAL.heading,
    ) -> None:
        self.odometry = pose
        self._raw = pose
        self._noise = deviation**2 * np.eye(2)
        self._state = np.array([*pose, 0.0, 0.0])  # pose, scale of distances, heading's drift
        self._covariance = np.diag([value**2 for value in (*_AT_START, distance, heading)])

    @property
    def pose(self) -> Pose:
        """Current estimate: x, y [m], heading [rad]."""
        x, y, yaw = self._state[:3].tolist()
        return x, y, yaw

    def move(self, odometry: Pose) -> None:
        """Update with raw odometry: x, y [m], heading [rad].

        Raises:
            ValueError: it is not finite; the estimate stays as it was.
        """
        _refuse_not_finite("odometry", odometry)
        dx, dy = odometry[0] - self._raw[0], odometry[1] - self._raw[1]
        c, s = math.cos(self._raw[2]), math.sin(self._raw[2])
        turned = odometry[2] - self._raw[2]
        self._raw = odometry
        scale, drift = self._state[3:].tolist()
        ahead, left = (c * dx + s * dy) / (1 + scale), (c * dy - s * dx) / (1 + scale)
        way = math.hypot(ahead, left)
        turned -= drift * way
        yaw = self._state[2]
        c, s = math.cos(yaw), math.sin(yaw)
        step = np.array([c * ahead - s * left, s * ahead + c * left])
        self._state[:2] += step
        self._state[2] += turned
        jacobian = np.eye(5)
        jacobian[:2, 2] = -step[1], step[0]
        jacobian[:2, 3] = -step / (1 + scale)
        jacobian[2, 3:] = drift * way / (1 + scale), -way
        # neither scale nor drift explains slip
        slip = np.diag([*(value**2 for value in _SLIP), 0.0, 0.0]) * way
        self._covariance = jacobian @ self._covariance @ jacobian.T + slip
        x, y, yaw = self.odometry
        c, s = math.cos(yaw), math.sin(yaw)
        self.odometry = (x + c * ahead - s * left, y + s * ahead + c * left, yaw + turned)

    def fix(self, x: float, y: float) -> None:
        """Update with an external position [m].

        Raises:
            ValueError: it is not finite; the estimate stays as it was.
        """
        _refuse_not_finite("position", (x, y))
        gain = self._covariance[:, :2] @ np.linalg.inv(self._covariance[:2, :2] + self._noise)
        self._state += gain @ (np.array([x, y]) - self._state[:2])
        self._covariance -= gain @ self._covariance[:2]
        self._covariance = (self._covariance + self._covariance.T) / 2

    def towards(self, x: float, y: float) -> tuple[float, float]:
        """Return distance [m] and bearing [rad, counter-clockwise from ahead] of a point."""
        dx, dy = x - self._state[0], y - self._state[1]
        return float(math.hypot(dx, dy)), float(math.remainder(math.atan2(dy, dx) - self._state[2], math.tau))


def _refuse_not_finite(name: str, values: tuple[float, ...]) -> None:
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{name} {values} is not finite and would spoil the estimate for good: skip it")

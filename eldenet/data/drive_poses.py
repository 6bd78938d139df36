"""Where a camera was during a drive, by the robot's wheel odometry or by any tracker's camera poses."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from eldenet.data.paths import natural_order
from eldenet.geometry import level_rotation
from eldenet.system.files import read_table, read_text

BASE = ("x", "y", "heading")
MATRIX = tuple(f"m{row}{column}" for row in range(3) for column in range(4))
NAMES = ("image", "rgb")  # columns that name the picture of a row
TUM = ("seconds", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
ALLOWED = (
    "seconds,x,y,heading (of the robot's base: meters, radians), or m00 ... m23 (camera to world, meters) "
    "with a column seconds, image or rgb, or TUM's lines of eight numbers (time tx ty tz qx qy qz qw)"
)
LEAST_WAY = 1.0  # of a drive [m]
FASTEST, FASTEST_TURN = 10.0, 4.0  # of a drive on average [m/s], [rad/s]
LONGEST_STEP = 5.0  # between two pictures whose poses have no times [m]
LARGEST_GAP = 0.5  # between two poses that are interpolated [s]
SAME_TIME = 0.01  # from a pose beside a larger gap: the pose itself [s]
_BASE_FROM_LEVEL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


class Mount(NamedTuple):
    """How a camera is mounted on a robot."""

    height: float | None = None  # of the optical center above the floor [m]; None: not known
    pitch: float = 0.0  # of the optical axis below the horizon [rad]
    ahead: float = 0.0  # how far the optical center lies before the point whose pose odometry gives [m]


@dataclass(frozen=True)
class DrivePoses:
    """The camera's poses, in the order of their rows."""

    path: Path
    cameras: np.ndarray  # (N, 4, 4) camera to world [m]
    seconds: np.ndarray | None  # (N,) when [s], or None
    names: tuple[str, ...] | None  # of the pictures, or None
    # on a robot whose base the rows are of: z is 0 at the floor, or at the camera if its height is unknown;
    # None: the rows are the camera's own, in any world
    mount: Mount | None

    def of_pictures(self, paths: Sequence[Path]) -> list[np.ndarray | None]:
        """Return the pose ``(4, 4)`` of each picture, by name if the file has names, else by order.

        Raises:
            ValueError: fewer than half of the pictures have a pose, numbers differ, or a name comes twice.
        """
        if self.names is None:
            if len(paths) != len(self.cameras):
                raise ValueError(
                    f"{self.path} has {len(self.cameras)} poses for {len(paths)} pictures: give one row per "
                    "picture, in their order, or name the picture of each row in a column image"
                )
            return list(self.cameras)
        names = [Path(name).name for name in self.names]
        if twice := [name for name, count in Counter(names).items() if count > 1]:
            raise ValueError(
                f"{self.path} has {twice[0]} in several rows: give one row per picture, of one folder"
            )
        known = dict(zip(names, self.cameras, strict=True))
        found = [known.get(path.name) for path in paths]
        count = sum(pose is not None for pose in found)
        if 2 * count < len(paths):
            raise ValueError(
                f"{self.path} has poses of {count} of {len(paths)} pictures, such as {self.names[0]}: name "
                f"pictures such as {paths[0].name}"
            )
        return found

    def at(self, seconds: float) -> np.ndarray | None:
        """Return the pose ``(4, 4)`` at a time [s], interpolated; None where there are no poses near."""
        times = self.seconds
        if times is None or not times[0] <= seconds <= times[-1]:
            return None
        after = min(max(1, int(np.searchsorted(times, seconds))), len(times) - 1)
        if times[after] - times[after - 1] > LARGEST_GAP:
            nearest = after if seconds - times[after - 1] > times[after] - seconds else after - 1
            return self.cameras[nearest] if abs(times[nearest] - seconds) < SAME_TIME else None
        from scipy.spatial.transform import Rotation, Slerp

        span = times[after - 1 : after + 1]
        share = (seconds - span[0]) / (span[1] - span[0])
        before, next_one = self.cameras[after - 1], self.cameras[after]
        pose = (1 - share) * before + share * next_one
        turns = Rotation.from_matrix(np.stack([before[:3, :3], next_one[:3, :3]]))
        pose[:3, :3] = Slerp(span, turns)([seconds]).as_matrix()[0]
        return np.asarray(pose)


def read_poses(path: Path, mount: Mount = Mount()) -> DrivePoses:  # noqa: B008 - immutable
    """Read a CSV file of poses in the order of time, or camera poses in TUM's format, as SLAM writes them.

    Convention: x ahead, y left, heading counter-clockwise (REP 103); cameras x right, y down, z forward.
    Poses of a robot's base need the camera's ``mount``.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: columns are missing, numbers are not finite, times do not increase, units look wrong, or
            the camera does not drive.
    """
    text = read_text(path, "give a CSV file of poses")
    lines = {number: line.split() for number, line in enumerate(text.splitlines(), 1) if line[:1] != "#"}
    lines = {number: words for number, words in lines.items() if words}
    if lines and all(len(words) == len(TUM) for words in lines.values()):
        return _tum_poses(path, lines, mount)
    header = text.partition("\n")[0].strip()
    columns = [name.strip() for name in header.split(",")]
    of_base = all(name in columns for name in BASE)
    if not of_base and not all(name in columns for name in MATRIX):
        raise ValueError(f"{path} has the columns {header[:200]!r}: give {ALLOWED}")
    if not of_base:
        _refuse_mount(path, mount)
    label = next((name for name in NAMES if name in columns), None)
    with_times = "seconds" in columns
    numbers = [*(BASE if of_base else MATRIX), *(["seconds"] if with_times else [])]
    table = read_table(path, numbers)
    if len(table) < 2:
        raise ValueError(f"{path} has {len(table)} poses: give one for each picture, or for each 0.1 s")
    values = _values(path, {n: [row[name] for name in numbers] for n, row in enumerate(table, 2)}, numbers)
    seconds = values[:, -1] if with_times else None
    if seconds is not None:
        _check_order(path, seconds)
    if of_base:
        _check_way(path, values[:, :2], values[:, 2], seconds)
        cameras = np.stack([_on_robot(pose, mount) for pose in values[:, :3]])
    else:
        cameras = np.tile(np.eye(4), (len(values), 1, 1))
        cameras[:, :3] = values[:, :12].reshape(-1, 3, 4)
        turns = cameras[:, :3, :3]
        squares = turns @ turns.transpose(0, 2, 1)
        if np.abs(squares - np.eye(3)).max() > 0.01 or np.linalg.det(turns).min() < 0:
            raise ValueError(f"{path}: m00 ... m22 are no rotations: give camera to world, row by row")
        _check_way(path, cameras[:, :3, 3], None, seconds)
    names = None if label is None else tuple(row[label] for row in table)
    return DrivePoses(path, cameras, seconds, names, mount if of_base else None)


def _tum_poses(path: Path, lines: Mapping[int, Sequence[str]], mount: Mount) -> DrivePoses:
    """Camera to world from numbered lines of a time, a place and a quaternion (x, y, z, w)."""
    from scipy.spatial.transform import Rotation

    _refuse_mount(path, mount)
    values = _values(path, lines, TUM)
    if np.abs(np.linalg.norm(values[:, 4:], axis=1) - 1).max() > 0.01:
        raise ValueError(f"{path}: qx, qy, qz, qw are no unit quaternions: give time tx ty tz qx qy qz qw")
    _check_order(path, values[:, 0])
    _check_way(path, values[:, 1:4], None, values[:, 0])
    cameras = np.tile(np.eye(4), (len(values), 1, 1))
    cameras[:, :3, :3] = Rotation.from_quat(values[:, 4:]).as_matrix()
    cameras[:, :3, 3] = values[:, 1:4]
    return DrivePoses(path, cameras, values[:, 0], None, None)


def _refuse_mount(path: Path, mount: Mount) -> None:
    if mount.height is not None or mount.pitch:
        raise ValueError(f"{path} has poses of the camera itself: leave out camera_height and camera_pitch")


def _check_order(path: Path, seconds: np.ndarray) -> None:
    if (back := np.flatnonzero(np.diff(seconds) <= 0)).size:
        raise ValueError(
            f"{path}: seconds do not increase after {seconds[back[0]]:g}: sort the rows by time, one row each"
        )


def _values(path: Path, rows: Mapping[int, Sequence[str]], columns: Sequence[str]) -> np.ndarray:
    """Numbers ``(rows, columns)`` of the cells of rows, by their line in the file."""
    values = np.full((len(rows), len(columns)), math.nan)
    for row, (line, cells) in enumerate(rows.items()):
        for column, text in enumerate(cells):
            with suppress(ValueError):
                values[row, column] = float(text)
            if not math.isfinite(values[row, column]):
                raise ValueError(
                    f"{path}, line {line}: {columns[column]} is {text[:40]!r}: give a finite number, or no "
                    "such row"
                )
    return values


def _on_robot(pose: np.ndarray, mount: Mount) -> np.ndarray:
    """The camera's pose ``(4, 4)`` on a robot whose base is at x, y [m], heading [rad]."""
    x, y, heading = pose
    c, s = math.cos(heading), math.sin(heading)
    camera = np.eye(4)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    camera[:3, :3] = turn @ _BASE_FROM_LEVEL @ level_rotation(mount.pitch)
    camera[:3, 3] = x + mount.ahead * c, y + mount.ahead * s, mount.height or 0.0
    return camera


def _check_way(
    path: Path, places: np.ndarray, heading: np.ndarray | None, seconds: np.ndarray | None
) -> None:
    """Refuse places ``(N, 2 or 3)`` and headings ``(N,)`` that no drive has."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    duration = None if seconds is None else seconds[-1] - seconds[0]
    usual = steps.sum() / duration if duration else float(np.median(steps))
    if usual > (FASTEST if duration else LONGEST_STEP):
        per = "per second" if duration else "from row to row"
        raise ValueError(f"{path} moves {usual:.3g} m {per}: give meters; divide millimeters by 1000")
    turned = 0.0 if heading is None else float(np.abs(np.diff(np.unwrap(heading))).sum())
    if duration and turned / duration > FASTEST_TURN:
        raise ValueError(
            f"{path} turns {turned / duration:.3g} rad per second: give heading in radians, not degrees"
        )
    if steps.sum() < LEAST_WAY or np.ptp(places, axis=0).max() < LEAST_WAY / 2:
        turning = f" and turns {math.degrees(turned):.0f} degrees" if turned > 1 else ""
        raise ValueError(
            f"{path} moves {steps.sum():.2g} m{turning}: drive at least {LEAST_WAY:g} m, because depth comes "
            "from seeing things from several places; turning on the spot shows none"
        )


def in_order(paths: Sequence[Path]) -> list[Path]:
    """Return pictures in the order of time, which is that of their names."""
    return sorted(paths, key=lambda path: natural_order(path.name))

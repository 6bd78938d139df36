"""Recordings of ROS as a source of pictures: bags of ROS 2 (a folder, .mcap, .db3) and of ROS 1 (.bag)."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from eldenet.data.picture_decoding import decode_picture
from eldenet.data.ros_messages import COLORS, is_distorted, read_color, read_intrinsics, read_pose, seconds
from eldenet.geometry import four_numbers, intrinsic_matrix
from eldenet.system.errors import reading
from eldenet.system.extras import require
from eldenet.system.files import write_rows

ENDINGS = (".mcap", ".db3", ".bag")
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
LENS, ODOMETRY = "sensor_msgs/msg/CameraInfo", "nav_msgs/msg/Odometry"
STRAIGHTENED = ("plumb_bob", "rational_polynomial")  # models of distortion that OpenCV's pinhole camera has


def is_bag(path: Path) -> bool:
    """Return whether a file or folder is a bag, by its name or the folder's ``metadata.yaml``."""
    return path.suffix.lower() in ENDINGS or (path / "metadata.yaml").is_file()


class Bag:
    """The pictures of a bag as those of a pinhole camera, and the odometry beside them.

    Times [s] are those of the messages' headers; where these are 0, those of the recording.

    Args:
        path: of the bag.
        topic: of the pictures; None: the only one with colors.
        intrinsics: fx, fy, cx, cy of the pictures [px]; None: those of their ``CameraInfo``, by which
            pictures of a lens that bends straight lines are straightened. Pictures whose topic ends in a
            name with ``rect`` are straight already.

    Attributes:
        pictures: how many there are.

    Raises:
        FileNotFoundError: there is no such bag.
        ValueError: it cannot be read, has no such topic or several, or states a lens that no camera has.
    """

    def __init__(self, path: Path, topic: str | None = None, intrinsics: Any = None) -> None:
        require(f"source={path}", "rosbags")
        if not path.exists():
            raise FileNotFoundError(f"source={path} does not exist: give a bag of ROS")
        self.path = path
        with self._open() as bag:
            self._kinds = {each.topic: each.msgtype for each in bag.connections}
            counts = {each.topic: each.msgcount for each in bag.connections}
        pictures = self._topics(IMAGE, COMPRESSED)
        if topic is None and len(pictures) > 1:
            pictures = [each for each in pictures if self._has_colors(each)] or pictures
            pictures = [each for each in pictures if _raw(each) == each or _raw(each) not in pictures]
        self._topic = self._chosen("pictures", pictures, topic, "topic")
        self.pictures = counts[self._topic]
        self._straighten: Callable[[np.ndarray], np.ndarray] = lambda picture: picture
        self._lens = self._learn_lens() if intrinsics is None else intrinsic_matrix(intrinsics)

    @property
    def knows_lens(self) -> bool:
        """Whether the intrinsics are given, or a calibrated camera's are recorded."""
        return self._lens is not None

    @property
    def intrinsics(self) -> list[float]:
        """fx, fy, cx, cy of the pictures of :meth:`frames` [px].

        Raises:
            ValueError: it does not know them.
        """
        if self._lens is None:
            raise ValueError(
                f"{self.path} needs a CameraInfo of a calibrated camera beside {self._topic}, and has "
                f"{', '.join(self._topics(LENS)) or 'none'}: give intrinsics=[fx,fy,cx,cy] [px] or fov="
            )
        return four_numbers(self._lens)

    @contextmanager
    def _open(self) -> Iterator[Any]:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        advice = "record it again, or repair it (ros2 bag reindex, mcap recover)"
        usual = get_typestore(Stores.LATEST)  # bags before ROS 2 Iron do not define their messages
        with reading(self.path, "bag", advice), AnyReader([self.path], default_typestore=usual) as bag:
            yield bag

    def _topics(self, *kinds: str) -> list[str]:
        return [topic for topic, kind in self._kinds.items() if kind in kinds]

    def _chosen(self, what: str, found: list[str], named: str | None, setting: str) -> str:
        """The topic that a setting names, or the only one."""
        if not found:
            others = ", ".join(f"{topic} ({kind})" for topic, kind in self._kinds.items())
            raise ValueError(f"{self.path} has no topic of {what}: record one beside {others or 'nothing'}")
        if named is None and len(found) == 1:
            return found[0]
        if named not in found:
            other = "" if named is None else f", not {named}"
            raise ValueError(
                f"{self.path} has {what} in {', '.join(found)}{other}: give {setting}= one of them"
            )
        return named

    def _has_colors(self, topic: str) -> bool:
        first = next(self._messages(topic), None)
        if first is None:
            return False
        kind, message = self._kinds[topic], first[1]
        return "depth" not in message.format.lower() if kind == COMPRESSED else message.encoding in COLORS

    def _messages(self, topic: str) -> Iterator[tuple[float, Any]]:
        """Yield each message of a topic after its time [s]."""
        with self._open() as bag:
            chosen = [each for each in bag.connections if each.topic == topic]
            for connection, nanoseconds, data in bag.messages(chosen):
                message = bag.deserialize(data, connection.msgtype)
                yield seconds(message.header.stamp) or nanoseconds * 1e-9, message

    def frames(self) -> Iterator[tuple[np.ndarray, float]]:
        """Yield the pictures ``(H, W, 3)`` uint8 RGB with their times [s]; none goes back in time.

        Raises:
            ValueError: a picture cannot be read.
        """
        latest = -np.inf
        for time, message in self._messages(self._topic):
            if time > latest:
                latest = time
                yield self._straighten(self._picture(message)), time

    def _picture(self, message: Any) -> np.ndarray:
        import cv2

        try:
            if self._kinds[self._topic] == IMAGE:
                return read_color(message)
            picture, fault = decode_picture(bytes(message.data), cv2.IMREAD_COLOR)
            if picture is None or fault:
                raise ValueError(f"a picture in the format {message.format!r} cannot be decoded {fault}")
        except ValueError as error:
            raise ValueError(f"{self.path}, {self._topic}: {error}") from error
        return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)

    def _learn_lens(self) -> np.ndarray | None:
        """Intrinsics ``(3, 3)`` [px] of the pictures, straightened from here on; None: not known."""
        folder, _, name = _raw(self._topic).rpartition("/")
        known, beside = self._topics(LENS), f"{folder}/camera_info"
        chosen = [beside] if beside in known else known
        info = next(self._messages(chosen[0]), None) if len(chosen) == 1 else None
        first = next(self._messages(self._topic), None)
        if info is None or first is None:
            return None
        # ROS 1 has K, D and P
        lens = SimpleNamespace(**{key.lower(): value for key, value in vars(info[1]).items()})
        if np.ravel(lens.k)[0] == 0:  # as drivers say it of a camera that nobody calibrated
            return None
        size = self._picture(first[1]).shape[:2]
        rectified = "rect" in name
        try:
            matrix = read_intrinsics(lens, (size[0], size[1]), rectified=rectified)
            if rectified or not is_distorted(lens):
                return matrix
            if lens.distortion_model not in STRAIGHTENED:
                raise ValueError(
                    f"a lens of the model {lens.distortion_model}: record rectified pictures (image_proc)"
                )
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}") from error
        import cv2

        bent = np.asarray(lens.d, np.float64)
        maps = cv2.initUndistortRectifyMap(matrix, bent, np.eye(3), matrix, size[::-1], cv2.CV_32FC1)
        self._straighten = lambda picture: cv2.remap(picture, *maps, cv2.INTER_LINEAR)
        return matrix

    def write_odometry(self, topic: str | None, path: Path) -> Path:
        """Write the poses of the robot's base as rows ``seconds,x,y,heading``; None: of the only odometry.

        Raises:
            ValueError: there is no such topic, or there are several.
        """
        topic = self._chosen("odometry", self._topics(ODOMETRY), topic, "poses")
        poses = {time: read_pose(message) for time, message in self._messages(topic)}
        write_rows(path, ("seconds", "x", "y", "heading"), [(time, *poses[time]) for time in sorted(poses)])
        return path


def _raw(topic: str) -> str:
    return topic.removesuffix("/compressed")

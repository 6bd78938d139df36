"""``python -m eldenet.adapt``: tune weights to your own camera, with the data you have.

A few hundred depth frames from any sensor:
python -m eldenet.adapt data.root=my_frames 'intrinsics=[525,525,319.5,239.5]'
Or a drive with wheel odometry (seconds,x,y,heading):
python -m eldenet.adapt source=walk.mp4 poses=odometry.csv
Or a bag of ROS with such a drive, whose topics have pictures and Odometry:
python -m eldenet.adapt source=walk.mcap
Or the camera's height above the floor, which must be in view:
python -m eldenet.adapt source=walk.mp4 camera_height=0.8 'intrinsics=[525,525,319.5,239.5]'
"""

import math
import shutil
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.compose import REQUIRED, compose
from eldenet.data.bags import Bag, is_bag
from eldenet.data.drive_poses import Mount, read_poses
from eldenet.data.splits import check_folders
from eldenet.geometry import check_camera_height, four_numbers, intrinsic_matrix
from eldenet.system.checks import at_least
from eldenet.system.files import sole_writer
from eldenet.system.resources import choose_resources
from eldenet.weights import find_checkpoint

if TYPE_CHECKING:
    from eldenet.deploy.prediction import Source

USUAL_AHEAD = 0.2  # [m]
LEAST_PITCH = 0.5  # [degrees]; a smaller one is 0, or in radians


@dataclass(frozen=True)
class AdaptSettings:
    """What ``python -m eldenet.adapt`` reads."""

    data: dict[str, Any] = REQUIRED
    loss: dict[str, Any] = REQUIRED
    optimizer: dict[str, Any] = REQUIRED
    scheduler: dict[str, Any] = REQUIRED
    augmentation: dict[str, Any] = field(default_factory=dict)
    trainer: dict[str, Any] = REQUIRED
    runtime: dict[str, Any] = REQUIRED
    protocol: dict[str, Any] | None = None  # a name from configs/protocol; null: the data set's own
    weights: str = "eldenet_indoor"  # packaged weights, run folder, saved model or Hub id to start from
    # [fx, fy, cx, cy] of the pictures on disk [px]; without camera_height also a file, as data.intrinsics;
    # null: with poses, found by the drive
    intrinsics: Any = None
    # about how long the command may take; depth from a drive's motion is not cut short (fewer frames= are
    # faster), the training then gets what is left, at least a tenth
    minutes: float = 10
    # of the optical center above the floor [m]; without poses it only fits the scale; null: with poses of a
    # robot, found by the drive
    camera_height: float | None = None
    # of a camera at a fixed tilt: degrees below the horizon; null: fitted in each frame, or by the drive
    camera_pitch: float | None = None
    # with poses of a robot: of the optical center before the wheels' axle [m]; null: found by a drive with
    # curves, else 0.2
    camera_ahead: float | None = None
    source: str | None = None  # without depth frames: a folder of pictures, a video, or a bag of ROS
    # CSV of the source's drive: seconds,x,y,heading of the robot, or of the camera; or a bag's topic
    poses: str | None = None
    topic: str | None = None  # of a bag's pictures; null: the only one with colors
    frames: int = 200  # of source: largest number to use
    force: bool = False  # take a factor of the depth above 3 or below 1/3, which is nearly always a mistake
    seed: int = 0
    trusted_modules: Any = field(default_factory=list)  # packages whose classes foreign weights may name
    output: str = "runs/adapt-${now:%Y%m%d-%H%M%S}"  # folder for the results

    def __post_init__(self) -> None:
        height, pitch = self.camera_height, self.camera_pitch
        # as data.intrinsics
        in_files = height is None and not self.is_drive and isinstance(self.intrinsics, str | dict)
        if self.intrinsics is not None and not in_files:
            intrinsic_matrix(self.intrinsics)  # a mistake ends before torch is loaded
        if not 0 < self.minutes < math.inf:
            raise ValueError(f"minutes={self.minutes}: give a number above 0")
        at_least(1, frames=self.frames)
        if pitch is not None and not -90 < pitch < 90:
            raise ValueError(
                f"camera_pitch={pitch:g}: give degrees below the horizon, between -90 and 90, or null"
            )
        if pitch and abs(pitch) < LEAST_PITCH:
            raise ValueError(
                f"camera_pitch={pitch:g} looks like radians: give degrees, {math.degrees(pitch):.3g}, or 0"
            )
        if height is not None:
            check_camera_height(height)

    @property
    def bag(self) -> Path | None:
        """The source if it is a bag of ROS."""
        path = None if self.source is None else Path(self.source).expanduser()
        return path if path is not None and is_bag(path) else None

    @property
    def is_drive(self) -> bool:
        """Whether it is told where the camera was."""
        return self.poses is not None or self.bag is not None


def adapt(s: AdaptSettings) -> bool:
    """Tune on depth frames or a drive, or fit the scale to the camera's height; return whether it is better.

    ``s.output/model`` holds the weights, whichever are better.

    Raises:
        ValueError: a setting does not fit, frames are too few or prove nothing (copies, constant or inverse
            depth), or the factor of the depth is not plausible; another process writes into the folder.
        FileNotFoundError: there are no such weights, frames or pictures.
    """
    find_checkpoint(s.weights, "weights", trained=True)
    with sole_writer(Path(s.output)):
        if s.is_drive:
            return _tune(_label(s))
        return _tune(s) if s.camera_height is None else _calibrate(s)


def _tune(s: AdaptSettings) -> bool:
    if s.data.get("root") is None and s.data["name"] == "folder":
        raise ValueError(
            "give data.root=<folder with images/ and depths/>, or source= with poses= or camera_height= if "
            "you have no depth frames"
        )
    check_folders(s.data)
    from eldenet.training.adaptation import tune

    return tune(asdict(s), Path(s.output), choose_resources(**s.runtime))


def _label(s: AdaptSettings) -> AdaptSettings:
    """Write the depth that a drive's motion tells to ``s.output/labels``; return settings that tune on it."""
    started = time.monotonic()
    source: Source | Bag
    if s.bag is None:
        source, table, intrinsics = _pictures(s, "poses"), Path(str(s.poses)).expanduser(), s.intrinsics
    else:
        source = Bag(s.bag, s.topic, s.intrinsics)
        table, intrinsics = Path(s.poses or "").expanduser(), source.intrinsics if source.knows_lens else None
        if not table.is_file():
            table = source.write_odometry(s.poses, Path(s.output) / "odometry.csv")
    ahead = USUAL_AHEAD if s.camera_ahead is None else s.camera_ahead
    poses = read_poses(table, Mount(s.camera_height, math.radians(s.camera_pitch or 0.0), ahead))
    from eldenet.perception.drive_camera import settle_camera
    from eldenet.perception.drive_labels import label_drive
    from eldenet.results.run_log import RunLog

    labels = Path(s.output) / "labels"
    copied = labels / "poses.csv"
    if labels.exists() and not copied.exists():
        raise ValueError(f"{labels} exists and is not adapt's: give another output=")
    shutil.rmtree(labels, ignore_errors=True)  # of a run that was stopped
    labels.mkdir(parents=True)
    shutil.copyfile(poses.path, copied)
    log = RunLog(Path(s.output))
    lens, poses = settle_camera(
        source, poses, intrinsics, pitch=s.camera_pitch, ahead=s.camera_ahead, log=log
    )
    camera = label_drive(source, poses, lens, labels, s.frames, log)
    encoding = {"scale": 0.001, "dtype": "uint16"}  # not "mm", which refuses frames that end within 0.255 m
    read = {"root": str(labels), "intrinsics": camera, "ground_truth": "sparse", "encoding": encoding}
    data = {**s.data, **read, "protocol": {**s.data["protocol"], "ground_truth": "sparse"}}
    data |= {part: {**s.data[part], **read} for part in ("train", "val", "test")}
    at_points = compose(AdaptSettings, ["loss=l1_sparse", "loss.terms.l1.space=log"]).loss
    left = max(s.minutes - (time.monotonic() - started) / 60, s.minutes / 10)
    found = [round(number, 1) for number in four_numbers(lens)]
    return replace(s, data=data, loss=at_points, minutes=left, intrinsics=found)


def _calibrate(s: AdaptSettings) -> bool:
    source = _pictures(s, "camera_height")
    from eldenet.perception.camera_height import calibrate

    return calibrate(asdict(s), source, Path(s.output), choose_resources(**s.runtime))


def _pictures(s: AdaptSettings, reader: str) -> "Source":
    """The pictures or the video of ``source``, which a setting reads."""
    from eldenet.deploy.prediction import find_source

    if s.source is None:
        raise ValueError(f"give source=<folder of pictures, or video>: {reader} needs frames of your camera")
    if s.intrinsics is None and not s.is_drive:
        raise ValueError(f"give intrinsics=[fx,fy,cx,cy] of the source's pictures [px]: {reader} needs them")
    source = find_source(s.source, Path(s.output), None)
    if source.is_live:
        raise ValueError(f"source={s.source}: give a folder of pictures or a video file, not a camera")
    return source


@entry_point(AdaptSettings)
def main(s: AdaptSettings) -> None:
    """Refuse settings that the other kind of adaptation reads, then adapt."""
    if s.bag is None:
        refuse_unread(("topic",), "source= is no bag of ROS or does not exist; only bags have topics")
    if s.is_drive:
        frames = ("root", "images", "depths", "csv", "confidence", "encoding", "ground_truth", "intrinsics")
        unread = ("loss", "protocol", *(f"data.{name}" for name in frames))
        refuse_unread(unread, "poses= or a bag makes the frames, from source=")
    elif s.camera_height is None:
        refuse_unread(
            ("source", "frames", "camera_pitch", "camera_ahead"),
            "give poses= or camera_height=, too",
        )
    else:
        unread = ("data", "loss", "optimizer", "scheduler", "augmentation", "trainer", "protocol", "minutes")
        refuse_unread((*unread, "camera_ahead"), "camera_height fits the scale alone, from source=")
    adapt(s)


if __name__ == "__main__":
    main()

"""Video files, read by FFmpeg through PyAV: which files are videos, their frames, whether they are whole."""

from collections.abc import Generator, Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from eldenet.data.array_files import check_pixels
from eldenet.data.file_checks import FORMATS
from eldenet.data.io import IMAGE_ENDINGS

if TYPE_CHECKING:
    import av

VIDEO_ENDINGS = (
    ".mp4", ".m4v", ".mov", ".3gp", ".3g2", ".avi", ".mkv", ".webm", ".wmv", ".asf", ".flv", ".ogv", ".mpg",
    ".mpeg", ".vob", ".ts", ".mts", ".m2ts", ".h264", ".264", ".h265", ".265", ".hevc", ".mjpeg", ".mjpg",
)  # fmt: skip
LONGEST_STILL = 60.0  # [s]: a longer gap between two frames means that recordings were joined
SLACK = 1.0  # [s] by which a file may end early; Matroska states its length exactly
MATROSKA_SLACK = 0.1  # [s]


def is_video_file(path: Path) -> bool:
    """Return True for a video, False for a picture; the content decides where the ending does not.

    Raises:
        ValueError: the file is neither.
    """
    ending = path.suffix.lower()
    if ending in VIDEO_ENDINGS or ending in IMAGE_ENDINGS:
        return ending in VIDEO_ENDINGS
    if _has_two_frames(path):
        return True
    with path.open("rb") as file:
        start = file.read(4096)
    if any(start.startswith(magic) for magic, _ in FORMATS):
        return False
    raise ValueError(
        f"{path} is neither a picture ({', '.join(IMAGE_ENDINGS)}) nor a video that FFmpeg can read "
        f"({', '.join(VIDEO_ENDINGS)}, and others): convert it to one of these"
    )


def _has_two_frames(path: Path) -> bool:
    """Return whether FFmpeg decodes two frames: a picture has one, and text is a film of its letters."""
    import av

    try:
        with av.open(str(path)) as container:
            frames = islice(container.decode(video=0), 2)
            return container.format.name != "tty" and len(list(frames)) == 2
    except (av.error.FFmpegError, IndexError):
        return False


class VideoFile:
    """The frames of a video file, upright, at the times that the file states.

    Attributes:
        frames_per_second: 30 where the file states no plausible rate.
        announced: frames that the file states, or that its length suggests; 0 where it says neither.

    Raises:
        ValueError: the file holds no video.
    """

    def __init__(self, path: Path) -> None:
        import av

        try:
            self._container = av.open(str(path), metadata_errors="replace")
            self._stream = self._container.streams.video[0]
            size = self._stream.height, self._stream.width
        except (av.error.FFmpegError, IndexError, AttributeError) as error:  # no size: an unknown codec
            raise ValueError(
                f"{path} holds no frame that can be read: it is truncated, damaged or not a video"
            ) from error
        self._path = path
        check_pixels(size, path)
        self._stream.thread_type = "AUTO"
        rate = float(self._stream.guessed_rate or 0)
        self.frames_per_second = rate if 0 < rate <= 1000 else 30.0  # some state the clock's 90000
        self._seconds = (self._container.duration or 0) / 1e6
        if self._container.format.name == "avi" and rate:  # a truncated file suggests a shorter length
            self._seconds = max(self._seconds, self._stream.frames / rate)
        self._stated = self._stream.frames
        self._slack = MATROSKA_SLACK if "matroska" in self._container.format.name else SLACK
        self.announced = self._stated or round(self._seconds * self.frames_per_second)
        self._end = 0.0  # of the last packet of any stream, for sound outlasts pictures [s]
        self._broken = 0  # packets that are truncated or cannot be decoded

    def frames(self) -> Generator[tuple[np.ndarray, float], None, None]:
        """Yield each frame ``(H, W, 3)`` uint8 RGB and its time [s], the first at 0."""
        start = float((self._stream.start_time or 0) * (self._stream.time_base or 0))
        usual, previous, skipped = 1 / self.frames_per_second, -1.0, 0.0
        for frame in self._decoded():
            stated = previous + usual if frame.time is None else frame.time - start
            self._end = max(self._end, stated + usual)
            time = stated - skipped
            # where recordings were joined, the stated time leaps or goes back
            if previous >= 0 and not previous < time <= previous + LONGEST_STILL:
                skipped += max(0.0, time - previous - usual)
                time = previous + usual
            previous = time
            check_pixels((frame.height, frame.width), self._path)
            picture = frame.to_ndarray(format="rgb24", interpolation="BICUBIC")
            yield np.ascontiguousarray(np.rot90(picture, frame.rotation // 90)), time

    def _decoded(self) -> Iterator["av.VideoFrame"]:
        import av

        with self._container:
            try:
                for packet in self._container.demux():
                    self._broken += packet.is_corrupt
                    if packet.pts is not None and packet.time_base is not None:
                        self._end = max(
                            self._end, float((packet.pts + (packet.duration or 0)) * packet.time_base)
                        )
                    if packet.stream is not self._stream:
                        continue
                    try:
                        yield from cast("list[av.VideoFrame]", packet.decode())
                    except av.error.InvalidDataError:
                        self._broken += 1
            except av.error.FFmpegError:
                self._broken += 1

    def fault(self, frames: int) -> str:
        """Return what is wrong with a file that yielded ``frames`` frames; empty if it is complete.

        Fewer frames than announced are no fault by themselves: the index may count frames that were trimmed,
        and many formats state a length alone.
        """
        slack = max(self._slack, 1.5 / self.frames_per_second)
        ends_early = self._end + slack < self._seconds
        if frames >= self.announced or not (ends_early or (self._broken and frames < self._stated)):
            return ""
        return f"is truncated or damaged: {frames} of {self.announced} frames could be read"

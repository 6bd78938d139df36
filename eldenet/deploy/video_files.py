"""Video files, read and written by FFmpeg through PyAV: their frames, times, and whether they are whole."""

from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from eldenet.data.array_files import check_pixels
from eldenet.data.io import IMAGE_ENDINGS
from eldenet.data.picture_decoding import FORMATS
from eldenet.geometry import resize_image
from eldenet.system.errors import reading, writing
from eldenet.system.extras import require
from eldenet.system.files import part_path, remove_unfinished

if TYPE_CHECKING:
    import av

VIDEO_ENDINGS = (
    ".mp4", ".m4v", ".mov", ".3gp", ".3g2", ".avi", ".mkv", ".webm", ".wmv", ".asf", ".flv", ".ogv", ".mpg",
    ".mpeg", ".vob", ".ts", ".mts", ".m2ts", ".h264", ".264", ".h265", ".265", ".hevc", ".mjpeg", ".mjpg",
)  # fmt: skip
# FFmpeg's names
PLAYLISTS = {"hls", "applehttp", "dash", "concat", "sdp", "rtsp", "imf", "webm_dash_manifest"}
LONGEST_STILL = 60.0  # [s]: a longer gap between two frames means that recordings were joined
SLACK = 1.0  # [s] by which a source may end before its stated end
MATROSKA_SLACK = 0.1  # [s]: these files state it exactly
USUAL_RATE = 30.0  # frames per second of a source that states no plausible number
LARGEST_SIDE = 8190  # of a video that is written [px]: MPEG-4 has 13 bits for it
MOST_PIXEL_ASPECT = 4  # width of a pixel by its height, or the inverse
BITS_PER_PIXEL = 4  # of a video that is written: depth's colors stay as they are


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
    require(f"reading {path}", "av")
    import av

    try:
        with _open(path) as container:
            frames = islice(container.decode(video=0), 2)
            return container.format.name != "tty" and len(list(frames)) == 2
    except (av.error.FFmpegError, IndexError):
        return False


def _open(path: Path) -> Any:
    """Open a video file, which may not name other files or addresses.

    Raises:
        ValueError: it is a playlist.
    """
    import av

    # PyAV 19 takes metadata that are no UTF-8 without being told
    lenient: dict[str, Any] = (
        {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}
    )
    # as "file:", no name is read as an address
    container = av.open(f"file:{path}", options={"protocol_whitelist": "file"}, **lenient)
    if PLAYLISTS & set(container.format.name.split(",")):
        container.close()
        raise ValueError(f"{path} is a playlist ({container.format.name}), whose files it does not hold")
    return container


class VideoFile:
    """The frames of a video file as players show them, at the times that the file states.

    They are turned, mirrored and widened or narrowed to square pixels as the file says.

    Attributes:
        frames_per_second: 30 where the file states no plausible rate.
        announced: frames that the file states, or that its length suggests; 0 where it says neither.

    Raises:
        ValueError: the file holds no video.
    """

    def __init__(self, path: Path) -> None:
        with reading(path, "video", "fetch it again, or convert it to .mp4"):
            self._container = _open(path)
            if not self._container.streams.video:
                raise ValueError("it holds no pictures")
            self._stream = self._container.streams.video[0]
            size = self._stream.height, self._stream.width
        self._width = round(size[1] * _pixel_aspect(self._stream))
        check_pixels((size[0], max(size[1], self._width)), path)
        self._stream.thread_type = "AUTO"
        rate = float(self._stream.guessed_rate or 0)
        self.frames_per_second = plausible_rate(rate)
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
        usual = 1 / self.frames_per_second
        clock = JoinedTime(usual)
        for frame in self._decoded():
            stated = clock.latest + usual if frame.time is None else frame.time - start
            self._end = max(self._end, stated + usual)
            time = clock(stated)
            width = self._width if frame.width == self._stream.width else frame.width
            picture = frame.to_ndarray(width=width, format="rgb24", interpolation="BICUBIC")
            yield np.ascontiguousarray(_upright(picture, frame)), time

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

    def why_incomplete(self, frames: int) -> str:
        """Return what is wrong with a file that yielded ``frames`` frames; empty if it is complete.

        Fewer frames than announced are no damage by themselves: the index may count frames that were trimmed,
        and many formats state a length alone.
        """
        slack = max(self._slack, 1.5 / self.frames_per_second)
        ends_early = self._end + slack < self._seconds
        if frames >= self.announced or not (ends_early or (self._broken and frames < self._stated)):
            return ""
        return f"is truncated or damaged: {frames} of {self.announced} frames could be read"


def plausible_rate(stated: float) -> float:
    """Return the stated frames per second, or :data:`USUAL_RATE`: some sources state a clock's 90000."""
    return stated if 0 < stated <= 1000 else USUAL_RATE


class JoinedTime:
    """Stated times of frames [s] -> times without the leaps where recordings were joined or a clock was set.

    Args:
        usual: time from a frame to the next [s].
    """

    def __init__(self, usual: float) -> None:
        self.usual, self.latest, self._skipped = usual, -1.0, 0.0

    def __call__(self, stated: float) -> float:
        """Return the time of the next frame; the first is as stated."""
        time = stated - self._skipped
        if self.latest >= 0 and not self.latest < time <= self.latest + LONGEST_STILL:
            self._skipped += max(0.0, time - self.latest - self.usual)
            time = self.latest + self.usual
        self.latest = time
        return time


def _pixel_aspect(stream: "av.VideoStream") -> Fraction:
    """Width of a pixel by its height; 1 where the file states none, or none that a camera has."""
    aspect = stream.sample_aspect_ratio
    return aspect if aspect and 1 / MOST_PIXEL_ASPECT <= aspect <= MOST_PIXEL_ASPECT else Fraction(1)


def _upright(picture: np.ndarray, frame: "av.VideoFrame") -> np.ndarray:
    """Turn and mirror a frame ``(H, W, 3)`` as its display matrix says, in whole quarters of a turn."""
    stated: Any = frame.side_data.get("DISPLAYMATRIX")
    if stated is None:
        return picture
    # a point (x, y) is shown at (a x + c y, b x + d y)
    a, b, _, c, d = np.frombuffer(bytes(stated), np.int32, 5).astype(np.int64)
    right, down = a, d
    if abs(a) + abs(d) < abs(b) + abs(c):
        picture, right, down = picture.swapaxes(0, 1), c, b
    return picture[:: -1 if down < 0 else 1, :: -1 if right < 0 else 1]


@contextmanager
def open_video(path: Path, per_second: float) -> Iterator[Callable[[np.ndarray], None]]:
    """Give a function that adds a frame ``(h, w, 3)`` uint8 RGB; the .mp4 file appears at the end.

    An error or Ctrl-C keeps the video up to there, as what a camera showed does not come again. A video
    without frames leaves no file. Frames get the size of the first one, at most ``LARGEST_SIDE``.

    Raises:
        OSError: the file cannot be written.
    """
    import av

    unfinished = part_path(path)
    container: Any = None
    stream: Any = None

    def add(picture: np.ndarray) -> None:
        nonlocal container, stream
        height, width = picture.shape[:2]
        if container is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            remove_unfinished(path.parent)
            container = av.open(str(unfinished), "w")
            most = max(1, min(1001, int(65535 / per_second)))  # MPEG-4 has 16 bits for a numerator
            stream = container.add_stream("mpeg4", rate=Fraction(per_second).limit_denominator(most))
            scale = LARGEST_SIDE / max(height, width)
            sides = (round(side * scale / 2) * 2 if scale < 1 else side for side in (width, height))
            stream.width, stream.height = sides
            stream.pix_fmt = "yuv420p"
            stream.bit_rate = round(BITS_PER_PIXEL * stream.width * stream.height * per_second)
        picture = resize_image(picture, (stream.height, stream.width))
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), "rgb24")))

    def finish() -> None:
        nonlocal container
        if container is not None:
            open_container, container = container, None
            with open_container:
                open_container.mux(stream.encode())
            unfinished.replace(path)

    try:
        with writing(path.parent, path.name):
            yield add
            finish()
    except BaseException:
        with suppress(OSError):
            finish()
        raise
    finally:
        unfinished.unlink(missing_ok=True)


def in_time(add: Callable[[np.ndarray], None], per_second: float) -> Callable[[np.ndarray, float], None]:
    """Give a function that adds a frame at the time when it was taken [s], from any zero.

    A frame stays until the time of the next, so that the video of a camera that dropped frames plays in real
    time. Of two frames within one of the video's frames the first is shown.
    """
    latest: np.ndarray | None = None
    start, written = 0.0, 0

    def show(picture: np.ndarray, taken: float) -> None:
        nonlocal latest, start, written
        if latest is None:
            latest, start = picture, taken
        place = round((taken - start) * per_second)
        for number in range(written, place + 1):
            add(picture if number == place else latest)
        latest, written = picture, max(written, place + 1)

    return show

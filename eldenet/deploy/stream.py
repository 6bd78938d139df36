"""Depth from a running camera or a video: a bounded queue between reader and network."""

import functools
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from eldenet.data.bags import Bag
from eldenet.deploy.video_files import SLACK, USUAL_RATE, JoinedTime, VideoFile, plausible_rate
from eldenet.system.escaping import without_password

if TYPE_CHECKING:
    import cv2

RATE_OVER = 30  # frames that the live rate looks back on

TimedFrame = tuple[np.ndarray, float]  # and when it was taken [s]


class StreamFrame(NamedTuple):
    """One frame and its depth.

    Attributes:
        number: position in the source, from 0; dropped frames count.
        frame: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` float32 [m].
        time: when it was taken [s], from any zero: as a file or bag states; of a camera, an address, or an
            iterable whose frames may be dropped, when it came; of any other iterable, by the frame rate.
    """

    number: int
    frame: np.ndarray
    depth: np.ndarray
    time: float


class DepthStream:
    """Read frames in a thread and predict the newest: a slow network never delays the camera.

    ::

        with DepthStream("camera:0", predictor) as stream:
            for number, frame, depth, time in stream:
                print(f"{stream.fps:.0f} frames/s, {stream.dropped} dropped")
            print(stream.ended_too_soon)  # not empty if the camera was unplugged

    Args:
        source: a video file, "camera:0" (number of a camera) or "/dev/video0", an address ("rtsp://..."),
            a bag of ROS, or any iterable of frames ``(H, W, 3)`` uint8 RGB.
        predictor: frame -> depth ``(H, W)`` [m], such as :class:`~eldenet.deploy.predictor.DepthPredictor`.
        queue_size: frames that may wait; with ``drop``, a new frame replaces the oldest.
        drop: whether to drop frames that wait too long; None: only those of cameras and addresses.
        timeout: time without an answer or a new frame after which a camera or an address counts as lost [s];
            None: never. Files, and iterables whose frames are not dropped, may take any time.
        intrinsics: ``(fx, fy, cx, cy)`` or ``(3, 3)`` of the frames [px], which are passed to the predictor
            with each frame, so that its meters are right for this camera.

    Attributes:
        dropped: number of frames that were not predicted.
        frames_per_second: as stated by the source; 30 if it states none, or an implausible number.
        announced: number of frames that the source announces; 0 if it has no end or does not say. Many
            formats estimate the number from the length, so there may be fewer.
        ended_too_soon: why the source ended early ("stopped after 90 frames: ..."); empty while it runs,
            and if it is complete.

    Raises:
        ValueError: the source cannot be opened.
    """

    def __init__(
        self,
        source: str | Path | Bag | Iterable[np.ndarray],
        predictor: Callable[..., np.ndarray],
        *,
        queue_size: int = 2,
        drop: bool | None = None,
        timeout: float | None = 10.0,
        intrinsics: Sequence[float] | np.ndarray | None = None,
    ) -> None:
        camera = {} if intrinsics is None else {"intrinsics": intrinsics}
        self.predictor, self.queue_size = functools.partial(predictor, **camera), max(1, queue_size)
        self.dropped, self.announced, self.frames_per_second = 0, 0, USUAL_RATE
        self.ended_too_soon = ""
        self._why_incomplete: Callable[[int], str] = lambda frames: ""
        live = isinstance(source, str | Path) and is_live(source)
        self.drop = live if drop is None else drop
        self._by_clock = live  # a file is not read at the pace at which it plays
        if live:
            frames = self._open_live(str(source), timeout)
        elif isinstance(source, str | Path):
            frames = self._open_file(str(source))
        elif isinstance(source, Bag):
            self.announced = source.pictures
            frames = _of_bag(source, self.frames_per_second)
        else:
            self._by_clock = self.drop
            frames = _timed(source, self.frames_per_second)
        self.timeout = timeout if self._by_clock else None
        self._waiting: deque[tuple[int, np.ndarray, float]] = deque()
        self._changed = threading.Condition()
        self._ended = self._stop = False
        self._error: BaseException | None = None
        self._times: deque[float] = deque(maxlen=RATE_OVER)
        self._reader = threading.Thread(target=self._read, args=(frames,), daemon=True)
        self._reader.start()

    @property
    def fps(self) -> float:
        """Predicted frames per second over the last 30."""
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-9)

    def __iter__(self) -> Iterator[StreamFrame]:
        number = -1
        while True:
            with self._changed:
                if not self._changed.wait_for(
                    lambda: self._waiting or self._ended or self._stop, self.timeout
                ):
                    self.ended_too_soon = (
                        f"stopped after {number + 1} frames: no new one came for {self.timeout:g} s"
                    )
                    self._stop = True  # the reader ends too, should it wake up
                if not self._waiting or self._stop:
                    break
                number, frame, taken = self._waiting.popleft()
                self._changed.notify_all()
            depth = self.predictor(frame)
            self._times.append(time.monotonic())
            yield StreamFrame(number, frame, depth, taken)
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """End the iteration after the current frame; a signal handler may call it."""
        with self._changed:
            self._stop = True
            self._changed.notify_all()

    def close(self) -> None:
        """Stop reading and release the source."""
        self.stop()
        self._reader.join(timeout=5)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _read(self, frames: Generator[TimedFrame, None, None]) -> None:
        count = 0
        try:
            for frame, taken in frames:
                if not self._put(count, frame, time.monotonic() if self._by_clock else taken):
                    break
                count += 1
            else:
                self.ended_too_soon = self._why_incomplete(count)
        except BaseException as error:  # raised where the stream is read
            self._error = error
        finally:
            frames.close()
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _put(self, number: int, frame: np.ndarray, taken: float) -> bool:
        """Queue a frame; return False once no more frames are wanted."""
        with self._changed:
            if self.drop:
                while len(self._waiting) >= self.queue_size:
                    self._waiting.popleft()
                    self.dropped += 1
            else:
                self._changed.wait_for(lambda: len(self._waiting) < self.queue_size or self._stop)
            self._waiting.append((number, frame, taken))
            self._changed.notify_all()
            return not self._stop

    def _open_file(self, name: str) -> Generator[TimedFrame, None, None]:
        video = VideoFile(Path(name))
        self.frames_per_second, self.announced = video.frames_per_second, video.announced
        self._why_incomplete = video.why_incomplete
        return video.frames()

    def _open_live(self, name: str, timeout: float | None) -> Generator[TimedFrame, None, None]:
        import cv2

        camera = name.removeprefix("camera:")
        if name != camera and not camera.isdigit():
            raise ValueError(f"source={name}: give a camera's number, such as camera:0")
        asked, shown = time.monotonic(), without_password(name)
        capture = _opened(int(camera) if name != camera else name, timeout)
        if capture is None or not capture.isOpened():
            if timeout is not None and time.monotonic() - asked > 0.8 * timeout:  # FFmpeg gives up at 0.9
                raise ValueError(f"source={shown} did not answer within {timeout:g} s: is it on, in reach?")
            raise ValueError(
                f"source={shown} cannot be opened: no such camera, out of reach, or no permission"
            )
        self.frames_per_second = plausible_rate(float(capture.get(cv2.CAP_PROP_FPS)))
        self.announced = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))  # an address may be of a file

        def why_incomplete(frames: int) -> str:
            if not self.announced:
                return f"stopped after {frames} frames: the camera or its connection was lost"
            if frames + SLACK * self.frames_per_second < self.announced:
                return f"stopped early: {frames} of {self.announced} frames could be read"
            return ""

        self._why_incomplete = why_incomplete
        return _frames_of(capture)


def _opened(camera: int | str, timeout: float | None) -> "cv2.VideoCapture | None":
    """Open a camera or an address; None: it has not answered in time [s], whatever FFmpeg's limits are."""
    import cv2

    answer: queue.SimpleQueue[cv2.VideoCapture] = queue.SimpleQueue()

    def ask() -> None:
        if timeout is None or "://" not in str(camera):
            answer.put(cv2.VideoCapture(camera))
            return
        # this thread then ends before us: one that Python has to end may abort the process
        milliseconds = min(round(0.9 * timeout * 1000), 2**31 - 1)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, milliseconds, cv2.CAP_PROP_READ_TIMEOUT_MSEC, milliseconds]
        answer.put(cv2.VideoCapture(camera, cv2.CAP_ANY, limits))

    threading.Thread(target=ask, daemon=True).start()
    try:
        return answer.get(timeout=timeout)
    except queue.Empty:
        return None


def _of_bag(bag: Bag, rate: float) -> Generator[TimedFrame, None, None]:
    clock, start = JoinedTime(1 / rate), None
    for frame, stated in bag.frames():
        start = stated if start is None else start
        yield frame, clock(stated - start)


def _timed(source: Iterable[np.ndarray], rate: float) -> Generator[TimedFrame, None, None]:
    frames = iter(source)
    try:
        for number, frame in enumerate(frames):
            # a copy: many cameras' libraries fill one array again and again, and frames wait in the queue
            yield frame.copy() if isinstance(frame, np.ndarray) else frame, number / rate
    finally:
        close = getattr(frames, "close", None)  # of a generator
        if close is not None:
            close()


def _frames_of(capture: "cv2.VideoCapture") -> Generator[TimedFrame, None, None]:
    import cv2

    try:
        while True:
            complete, frame = capture.read()
            if not complete:
                return
            yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB), 0.0  # the clock gives the time
    finally:
        capture.release()


def is_live(source: str | Path) -> bool:
    """Return whether the source is a camera (by any name of its device) or an address."""
    name = str(source)
    return name.startswith(("camera:", "/dev/video")) or "://" in name or Path(name).is_char_device()


def refuse_missing_camera(source: str) -> None:
    """Raise FileNotFoundError if a camera has no device; only Linux has a file for each."""
    device = Path(source.replace("camera:", "/dev/video", 1))
    if sys.platform == "linux" and "://" not in source and not device.exists():
        raise FileNotFoundError(
            f"source={source}: there is no {device}; give a camera's number, such as camera:0, or its device"
        )

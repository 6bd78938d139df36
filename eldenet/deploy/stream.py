"""Depth of a camera or a video while it runs: a bounded queue between the one and the other."""

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from eldenet.deploy.video_files import is_cut, mp4_seconds

if TYPE_CHECKING:
    import cv2

RATE_OVER = 30  # frames that the live rate looks back on
LONGEST_STILL = 60.0  # [s]: a file whose time leaps farther from one frame to the next was joined of several
SLACK = 1.0  # [s] by which a film may end before its file does: sound outlasts pictures


class StreamFrame(NamedTuple):
    """One frame and its depth.

    Attributes:
        number: of the frame in the source, from 0; dropped ones count.
        frame: ``(H, W, 3)`` uint8 RGB.
        depth: ``(H, W)`` float32 [m].
        time: when it was taken [s], from any zero: a camera's frames by the clock, a file's as it says,
            others by the frame rate.
    """

    number: int
    frame: np.ndarray
    depth: np.ndarray
    time: float


class DepthStream:
    """Reads frames in a thread of its own and predicts the newest: a slow network never delays the camera.

    ::

        with DepthStream("camera:0", predictor) as stream:
            for number, frame, depth, time in stream:
                print(f"{stream.fps:.0f} frames/s, {stream.dropped} dropped")
            print(stream.ended_too_soon)  # a camera that is unplugged ends the loop too

    Args:
        source: a video file, "camera:0" (number of a camera) or "/dev/video0", an address ("rtsp://..."), or
            any iterable of frames ``(H, W, 3)`` uint8 RGB.
        predictor: frame -> depth ``(H, W)`` [m], such as :class:`~eldenet.deploy.predictor.DepthPredictor`.
        queue_size: frames that may wait; with ``drop``, the oldest goes when another comes.
        drop: None: drop frames of cameras and addresses, keep every frame of files and iterables (the reader
            then waits).

    Attributes:
        dropped: frames that were not predicted.
        frames_per_second: that the source announces, 30 where it does not.
        announced: frames that the source announces; 0 where it has no end of its own, or does not say. Many
            formats reckon them from the film's length, so there may be fewer.
        ended_too_soon: why the source's end is none, in words ("broke off after 90 frames: ..."); empty while
            it goes on, and where it ended as it should.

    Raises:
        ValueError: the source cannot be opened, or the queue holds none.
    """

    def __init__(
        self,
        source: str | Path | Iterable[np.ndarray],
        predictor: Callable[[np.ndarray], np.ndarray],
        *,
        queue_size: int = 2,
        drop: bool | None = None,
    ) -> None:
        if queue_size < 1:
            raise ValueError(f"queue_size={queue_size}: at least one frame must wait")
        self.predictor, self.queue_size = predictor, queue_size
        self.dropped, self.announced, self.frames_per_second = 0, 0, 30.0
        self.ended_too_soon = ""
        self._file: Path | None = None
        self._counted, self._seconds = 0, 0.0  # frames that the source counts, and its length [s]
        # what comes at its own pace has the clock's times; a file is read faster or slower than it plays
        if isinstance(source, str | Path):
            self._endless = self._by_clock = is_live(source)
            self.drop = self._endless if drop is None else drop
            frames = self._open(source)
        else:
            self._endless, self._by_clock = False, bool(drop)
            self.drop = bool(drop)
            frames = iter(source)
        self._position: float | None = None  # in a file [s], of the newest frame
        self._told = self._leapt = 0.0  # what a file says of it at most, and what is taken off that [s]
        self._waiting: deque[tuple[int, np.ndarray, float]] = deque()
        self._changed = threading.Condition()
        self._ended = self._stop = False
        self._error: BaseException | None = None
        self._times: deque[float] = deque(maxlen=RATE_OVER)
        self._reader = threading.Thread(target=self._read, args=(frames,), daemon=True)
        self._reader.start()

    @property
    def fps(self) -> float:
        """Predicted frames per second, over the last 30."""
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-9)

    def __iter__(self) -> Iterator[StreamFrame]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._ended or self._stop)
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
        """End the iteration after the frame that is being predicted; a signal handler may call it."""
        with self._changed:
            self._stop = True
            self._changed.notify_all()

    def close(self) -> None:
        """Stop reading; the source is released."""
        self.stop()
        self._reader.join(timeout=5)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _read(self, frames: Iterator[np.ndarray]) -> None:
        came = 0
        try:
            for number, frame in enumerate(frames):
                if not self._put(number, frame):
                    break
                came = number + 1
            else:
                self.ended_too_soon = self._fault(came)
        except BaseException as error:  # it is the consumer's to see
            self._error = error
        finally:
            close = getattr(frames, "close", None)
            if close is not None:
                close()
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _put(self, number: int, frame: np.ndarray) -> bool:
        """Queue a frame; False once nobody wants more."""
        taken = number / self.frames_per_second if self._position is None else self._position
        if self._by_clock:
            taken = time.monotonic()
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

    def _fault(self, came: int) -> str:
        """What is wrong with an end after so many frames.

        Fewer frames than announced are no fault by themselves: their number is often reckoned from the length
        and an even rate, and what was trimmed from a film may still be counted.
        """
        if came < self._counted:
            what = f"announces {self._counted} frames, {came} could be read"
            if self._file is not None and is_cut(self._file):
                return f"is cut: it {what}"
            frame = 1 / self.frames_per_second
            if self._told + frame + max(SLACK, 3 * frame) < self._seconds:
                return f"{what}, the last of {self._told:.1f} s (of {self._seconds:.1f} s): cut or damaged"
        elif self._endless and not self._counted:
            return f"broke off after {came} frames: the camera or its connection is lost"
        return ""

    def _open(self, source: str | Path) -> Iterator[np.ndarray]:
        import cv2

        name = str(source)
        camera = name.removeprefix("camera:")
        if name != camera and not camera.isdigit():
            raise ValueError(f"source={name}: give a camera's number, such as camera:0")
        capture = cv2.VideoCapture(int(camera)) if name != camera else cv2.VideoCapture(name)
        if not capture.isOpened():
            capture.release()
            if is_live(name):
                name = without_password(name)
                raise ValueError(f"source={name} cannot be opened: no such camera, out of reach, or no right")
            if not Path(name).exists():
                raise ValueError(f"source={name} does not exist: give a video, or a camera such as camera:0")
            raise ValueError(f"{name} holds no frame that can be read: it is cut, damaged or no video")
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        plausible = 0 < rate <= 1000  # not a clock's 90000
        self.frames_per_second = rate if plausible else 30.0
        self._file = Path(name) if not is_live(name) and Path(name).is_file() else None
        self._counted = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))  # an address may be of a file
        self._seconds = self._counted / rate if rate > 0 else 0.0
        if self._file is not None and (shown := mp4_seconds(self._file)):
            self._seconds = min(self._seconds, shown)
        self.announced = self._counted if plausible else round(self._seconds * self.frames_per_second)
        return self._frames_of(capture)

    def _frames_of(self, capture: "cv2.VideoCapture") -> Iterator[np.ndarray]:
        import cv2

        try:
            while True:
                complete, frame = capture.read()
                if not complete:
                    return
                # phones and loggers write frames at uneven times; not every format says them, or to the end
                told = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
                at, before = told - self._leapt, self._position
                if before is not None and not before < at <= before + LONGEST_STILL:
                    usual = 1 / self.frames_per_second
                    self._leapt += max(0.0, at - before - usual)
                    at = before + usual
                self._position, self._told = at, max(self._told, told)
                yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
        finally:
            capture.release()


def is_live(source: str | Path) -> bool:
    """Whether frames come whether or not anybody reads them: a camera, or an address.

    A camera goes by any name of its device, such as ``/dev/v4l/by-id/usb-...``.
    """
    name = str(source)
    return name.startswith(("camera:", "/dev/video")) or "://" in name or Path(name).is_char_device()


def without_password(source: str) -> str:
    """A source as it may be printed and written: an address without its ``user:password@``."""
    return re.sub(r"(?<=://)[^/]*@", "", source)

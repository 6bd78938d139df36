"""A slow network never delays a camera, and no frame of a file is lost."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.films import write_video
from support.networks import canonical_predictor

from eldenet import runtimes


def numbered(count: int) -> Iterator[np.ndarray]:
    for number in range(count):
        yield np.full((4, 6, 3), number, np.uint8)


def depth_of(frame: np.ndarray) -> np.ndarray:
    return frame[..., 0].astype(np.float32)


def test_a_stream_keeps_every_frame_of_a_file() -> None:
    with runtimes.DepthStream(numbered(20), depth_of, queue_size=2) as stream:
        seen = [(number, int(depth[0, 0])) for number, _, depth, _ in stream]
    assert seen == [(number, number) for number in range(20)]
    assert stream.dropped == 0
    assert stream.fps > 0


def test_frames_that_wait_stay_as_they_were_where_a_camera_fills_one_array_again_and_again() -> None:
    def camera() -> Iterator[np.ndarray]:
        array = np.empty((4, 6, 3), np.uint8)
        for number in range(5):
            array[:] = number
            yield array

    with runtimes.DepthStream(camera(), depth_of, queue_size=5) as stream:
        seen = [(number, int(frame[0, 0, 0]), int(depth[0, 0])) for number, frame, depth, _ in stream]
    assert seen == [(number, number, number) for number in range(5)]


@pytest.mark.parametrize("size", [(36, 64), (64, 36), (48, 64)])
def test_a_stream_tells_the_predictor_its_camera(size: tuple[int, int]) -> None:
    """So meters hold for the camera; frames of any aspect have depth of their own size."""
    predictor, frame = canonical_predictor(48, 64), np.full((*size, 3), 90, np.uint8)
    camera = (100.0, 100.0, 32.0, 24.0)
    with runtimes.DepthStream([frame], predictor, intrinsics=camera) as stream:
        (seen,) = stream
    assert seen.depth.shape == size
    np.testing.assert_array_equal(seen.depth, predictor(frame, intrinsics=camera))
    assert not np.allclose(seen.depth, predictor(frame))


def test_a_slow_network_never_delays_the_camera() -> None:
    given, all_given = [], threading.Event()

    def camera() -> Iterator[np.ndarray]:
        for number, frame in enumerate(numbered(50)):
            given.append(number)
            yield frame
        all_given.set()

    def slow(frame: np.ndarray) -> np.ndarray:
        assert all_given.wait(20)  # the whole camera ran while this one frame was being looked at
        return depth_of(frame)

    with runtimes.DepthStream(camera(), slow, queue_size=2, drop=True) as stream:
        seen = [number for number, *_ in stream]
    assert given == list(range(50))
    assert seen[-2:] == [48, 49]  # the newest
    assert len(seen) <= 3
    assert stream.dropped == 50 - len(seen)


def test_times_of_a_camera_are_those_of_arrival() -> None:
    def camera() -> Iterator[np.ndarray]:
        for frame in numbered(12):
            yield frame
            time.sleep(0.02)

    def slow(frame: np.ndarray) -> np.ndarray:
        time.sleep(0.1)
        return depth_of(frame)

    with runtimes.DepthStream(camera(), slow, queue_size=1, drop=True) as stream:
        seen = list(stream)
    assert stream.dropped > 2
    frames, seconds = seen[-1].number - seen[0].number, seen[-1].time - seen[0].time
    assert seconds >= 0.02 * frames  # a busy machine sleeps longer, never shorter


def test_a_stream_ends_when_it_is_closed_and_passes_errors_on() -> None:
    released = threading.Event()

    def endless() -> Iterator[np.ndarray]:
        try:
            while True:
                yield np.zeros((2, 2, 3), np.uint8)
        finally:
            released.set()

    with runtimes.DepthStream(endless(), depth_of) as stream:
        assert next(iter(stream)).depth.shape == (2, 2)
    assert released.wait(10)

    def broken() -> Iterator[np.ndarray]:
        yield np.zeros((2, 2, 3), np.uint8)
        raise OSError("unplugged")

    with pytest.raises(OSError, match="unplugged"), runtimes.DepthStream(broken(), depth_of) as stream:
        list(stream)


def test_a_stream_of_a_video_file(tmp_path: Path) -> None:
    path = write_video(tmp_path / "walk.mp4")
    with runtimes.DepthStream(path, depth_of) as stream:
        seen = list(stream)
    np.testing.assert_allclose([item.time for item in seen], np.arange(5) / 12)
    assert (stream.frames_per_second, stream.announced, len(seen)) == (12.0, 5, 5)
    (tmp_path / "text.mp4").write_text("no video at all")
    for wrong, message in (
        (tmp_path / "none.mp4", "none.mp4"),
        (tmp_path / "text.mp4", "not a valid video"),
        ("camera:x", "camera:0"),
        ("/dev/video99", "no such camera"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=message):
            runtimes.DepthStream(wrong, depth_of)


class Capture:
    """OpenCV's, of a source that announces some frames (0: it has no end) and gives five."""

    def __init__(self, announced: int) -> None:
        self.announced, self.left = announced, 5

    def isOpened(self) -> bool:
        return True

    def get(self, what: int) -> float:
        return self.announced if what == cv2.CAP_PROP_FRAME_COUNT else 10.0

    def read(self) -> tuple[bool, np.ndarray]:
        self.left -= 1
        return self.left >= 0, np.zeros((4, 6, 3), np.uint8)

    def release(self) -> None:
        pass


@pytest.mark.parametrize(
    ("source", "announced", "said"),
    [
        ("camera:0", -1, "stopped after 5 frames"),
        ("/dev/video0", -1, "stopped after 5 frames"),
        ("rtsp://host/street", 0, "stopped after 5 frames"),
        ("http://host/walk.mp4", 5, ""),
        ("http://host/walk.mp4", 90, "stopped early: 5 of 90 frames could be read"),
    ],
)
def test_a_live_source_that_breaks_off_is_reported(
    source: str, announced: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: Capture(announced))
    with runtimes.DepthStream(source, depth_of) as stream:
        list(stream)
        assert stream.ended_too_soon.startswith(said)
        assert bool(stream.ended_too_soon) == bool(said)


def test_a_camera_that_stalls_ends_the_stream_and_is_said() -> None:
    awake = threading.Event()

    def camera() -> Iterator[np.ndarray]:
        yield from numbered(3)
        awake.wait(60)
        yield from numbered(1)

    with runtimes.DepthStream(camera(), depth_of, queue_size=3, drop=True, timeout=0.2) as stream:
        seen = [number for number, *_ in stream]
        assert stream.ended_too_soon == "stopped after 3 frames: no new one came for 0.2 s"
        awake.set()
    assert seen == [0, 1, 2]


def test_a_slow_network_is_no_stall_and_a_slow_file_neither() -> None:
    def slow(frame: np.ndarray) -> np.ndarray:
        time.sleep(0.1)
        return depth_of(frame)

    def file() -> Iterator[np.ndarray]:
        for frame in numbered(3):
            time.sleep(0.1)
            yield frame

    for source, network, drop in ((numbered(3), slow, True), (file(), depth_of, False)):
        with runtimes.DepthStream(source, network, queue_size=3, drop=drop, timeout=0.05) as stream:
            assert len(list(stream)) == 3
        assert stream.ended_too_soon == ""

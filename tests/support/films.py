"""Small videos of every container that OpenCV writes, and what happens to videos on their way."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from support.predicting import photo

CODECS = {
    ".mp4": "mp4v", ".mov": "mp4v", ".3gp": "mp4v", ".mkv": "mp4v", ".webm": "VP80", ".avi": "MJPG",
    ".wmv": "WMV2", ".flv": "FLV1", ".ts": "mp4v", ".m2ts": "MPG2", ".mpeg": "MPG2", ".mjpeg": "MJPG",
}  # fmt: skip


def write_video(path: Path, frames: int = 5, rate: float = 12.0) -> Path:
    """Frames of 48 x 64 that move, every one different."""
    path.parent.mkdir(parents=True, exist_ok=True)
    codec = cv2.VideoWriter.fourcc(*CODECS[path.suffix])
    writer = cv2.VideoWriter(str(path), codec, rate, (64, 48))
    if not writer.isOpened():
        pytest.skip(f"this OpenCV writes no {path.suffix}")
    for number in range(frames):
        writer.write(np.roll(photo(), 3 * number, axis=1)[..., ::-1].copy())
    writer.release()
    return path


def read_video(path: Path) -> tuple[list[np.ndarray], float]:
    """Its frames ``(h, w, 3)`` uint8 BGR and its rate [1/s]."""
    capture, frames = cv2.VideoCapture(str(path)), []
    while True:
        complete, frame = capture.read()
        if not complete:
            return frames, capture.get(cv2.CAP_PROP_FPS)
        frames.append(frame)


def cut(path: Path, share: float) -> Path:
    """What a broken download or a card that was pulled out leaves."""
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    return path


def trim(path: Path, seconds: float) -> Path:
    """Take the beginning off an MP4 as phones and ``ffmpeg -c copy`` do: it stays there, and is not shown."""
    content = bytearray(path.read_bytes())

    def number(at: int) -> int:
        return int.from_bytes(content[at : at + 4], "big")

    movie, edits, media = (content.index(kind) + 8 for kind in (b"mvhd", b"elst", b"mdhd"))
    movie_scale, media_scale = number(movie + 8), number(media + 8)
    left = number(movie + 12) - round(seconds * movie_scale)
    for at, value in (
        (movie + 12, left),
        (edits + 4, left),
        (edits + 8, round(seconds * media_scale)),
    ):
        content[at : at + 4] = value.to_bytes(4, "big")
    path.write_bytes(content)
    return path


def turn(path: Path) -> Path:
    """Say in an MP4 that it is shown a quarter turn to the right, as a phone held upright does."""
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 44
    one, minus = (1 << 16).to_bytes(4, "big"), (-1 << 16).to_bytes(4, "big", signed=True)
    nothing, last = bytes(4), (1 << 30).to_bytes(4, "big")
    content[at : at + 36] = b"".join([nothing, one, nothing, minus, nothing, nothing, nothing, nothing, last])
    path.write_bytes(content)
    return path


def index_first(path: Path) -> Path:
    """Move an MP4's index before its frames, as for streaming."""
    content = path.read_bytes()
    start = content.index(b"moov") - 4
    index = bytearray(content[start:])
    at = index.index(b"stco") + 12
    first = content.index(b"mdat") - 4
    for place in range(at, at + 4 * int.from_bytes(index[at - 4 : at], "big"), 4):
        moved = int.from_bytes(index[place : place + 4], "big") + len(index)
        index[place : place + 4] = moved.to_bytes(4, "big")
    path.write_bytes(content[:first] + index + content[first:start])
    return path

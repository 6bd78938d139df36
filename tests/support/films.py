"""Small videos in every container that OpenCV writes, and damage to them."""

from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from support.predicting import photo

CODECS = {
    ".mp4": "mp4v", ".mov": "mp4v", ".3gp": "mp4v", ".mkv": "mp4v", ".webm": "VP80", ".avi": "MJPG",
    ".wmv": "WMV2", ".flv": "FLV1", ".ts": "mp4v", ".m2ts": "MPG2", ".mpeg": "MPG2", ".mjpeg": "MJPG",
}  # fmt: skip


def write_video(path: Path, frames: int = 5, rate: float = 12.0) -> Path:
    """Frames of 48 x 64, all different."""
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
    """Frames ``(h, w, 3)`` uint8 BGR, and the rate [1/s]."""
    capture, frames = cv2.VideoCapture(str(path)), []
    while True:
        complete, frame = capture.read()
        if not complete:
            return frames, capture.get(cv2.CAP_PROP_FPS)
        frames.append(frame)


def cut(path: Path, share: float) -> Path:
    """Cut a file, as a broken download or a card that is pulled out does."""
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    return path


def trim(path: Path, seconds: float) -> Path:
    """Trim the beginning of an MP4 as phones do: its frames stay in the file and are not shown."""
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


def copy_packets(path: Path, rotation: int = 0, **options: str) -> Path:
    """Write the same packets anew, as ``ffmpeg -c copy`` does, to be shown turned by ``rotation`` degrees."""
    new = path.with_name(f"new{path.suffix}")
    with av.open(str(path)) as source, av.open(str(new), "w", options=options) as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        stream.set_display_rotation(rotation)
        for packet in source.demux(video=0):
            if packet.dts is not None:  # not the last, which is empty
                packet.stream = stream
                target.mux(packet)
    return new.replace(path)

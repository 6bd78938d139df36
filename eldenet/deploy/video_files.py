"""Video files before they are played: is this one, and is it whole?"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from eldenet.data.file_checks import FORMATS
from eldenet.data.io import IMAGE_ENDINGS

VIDEO_ENDINGS = (
    ".mp4", ".m4v", ".mov", ".3gp", ".3g2", ".avi", ".mkv", ".webm", ".wmv", ".asf", ".flv", ".ogv", ".mpg",
    ".mpeg", ".vob", ".ts", ".mts", ".m2ts", ".h264", ".264", ".h265", ".265", ".hevc", ".mjpeg", ".mjpg",
)  # fmt: skip
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")  # what no text holds


def is_video_file(path: Path) -> bool:
    """Whether a file is a video; False: a picture. Where its ending does not say, its content does.

    Raises:
        ValueError: it is neither.
    """
    ending = path.suffix.lower()
    if ending in VIDEO_ENDINGS or ending in IMAGE_ENDINGS:
        return ending in VIDEO_ENDINGS
    with path.open("rb") as file:
        start = file.read(4096)
    if _BINARY.search(start) and _moves(path):  # of a text FFmpeg makes a film of its letters
        return True
    if any(start.startswith(magic) for magic, _ in FORMATS):
        return False
    raise ValueError(
        f"{path} is neither a picture ({', '.join(IMAGE_ENDINGS)}) nor a video that OpenCV can read "
        f"({', '.join(VIDEO_ENDINGS)}, and others): convert it to one of these"
    )


def _moves(path: Path) -> bool:
    """Whether OpenCV reads two frames from it: of a picture it reads one, and of a HEIC photo a part."""
    import cv2

    capture = cv2.VideoCapture(str(path))
    try:
        return capture.isOpened() and capture.read()[0] and capture.read()[0]
    finally:
        capture.release()


def is_cut(path: Path) -> bool:
    """Whether an MP4, AVI or Matroska file ends before its own parts do; of other kinds nobody can tell."""
    size = path.stat().st_size
    with path.open("rb") as file:
        start = file.read(12)
        if start[4:8] in (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"):
            return any(end > size for _, _, end in _mp4_boxes(file, 0, size))
        if start[:4] == b"RIFF" and start[8:] == b"AVI ":
            return _end_of_riff(file, size) > size
        if start[:4] == b"\x1a\x45\xdf\xa3":
            return _end_of_matroska(file) > size
    return False


def mp4_seconds(path: Path) -> float:
    """How long an MP4 file plays [s], without what was trimmed from it; 0: it does not say."""
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(8)[4:] != b"ftyp":
            return 0.0
        movies = [(start, end) for kind, start, end in _mp4_boxes(file, 0, size) if kind == b"moov"]
        for kind, start, _ in (box for movie in movies for box in _mp4_boxes(file, *movie)):
            if kind == b"mvhd":
                file.seek(start)
                content = file.read(32)
                wide = content[0] == 1  # version 1 has times of 64 bits
                scale, length = (content[20:24], content[24:32]) if wide else (content[12:16], content[16:20])
                unknown = not any(scale) or length == b"\xff" * len(length)
                return 0.0 if unknown else int.from_bytes(length, "big") / int.from_bytes(scale, "big")
    return 0.0


def _mp4_boxes(file: BinaryIO, at: int, stop: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, first byte of the content and end of the boxes from ``at`` on, one beside the other."""
    while at < stop:
        file.seek(at)
        header = file.read(16)
        length, kind, content = int.from_bytes(header[:4], "big"), header[4:8], at + 8
        if length == 1:
            length, content = int.from_bytes(header[8:], "big"), at + 16
        if length < content - at:  # 0: to the file's end; less: something that cameras put behind the film
            return
        at += length
        yield kind, content, at


def _end_of_riff(file: BinaryIO, size: int) -> int:
    """Where the last RIFF chunk says that it ends; an AVI beyond 1 GB has several."""
    at = 0
    while at < size:
        file.seek(at)
        header = file.read(8)
        length = int.from_bytes(header[4:], "little")
        if header[:4] != b"RIFF" or not length:  # 0: a recorder that was cut off never came to write it
            break
        at += 8 + length
    return at


def _end_of_matroska(file: BinaryIO) -> int:
    """Where the segment, which holds everything, says that it ends; 0 where it leaves that open."""
    return _end_of_element(file, _end_of_element(file, 0))  # behind the file's own header


def _end_of_element(file: BinaryIO, at: int) -> int:
    """Where a Matroska element with a name of four bytes ends; 0: it does not say."""
    file.seek(at + 4)
    number = file.read(8)
    if not number or not number[0]:
        return 0
    width = 9 - number[0].bit_length()  # the leading zeros say how many bytes the length has
    ones = (1 << 7 * width) - 1
    length = int.from_bytes(number[:width], "big") & ones
    return 0 if length == ones else at + 4 + width + length

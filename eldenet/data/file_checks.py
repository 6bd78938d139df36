"""Is a picture's file whole? One check per format, on its bytes: decoders pass over much in silence.

A check returns what is wrong, or "". A new format is one row in ``FORMATS``.
"""

import os
import re
import sys
import tempfile
import threading
import zlib
from collections.abc import Callable
from typing import Literal

import numpy as np

_JPEG_MARKER = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]")  # any marker that ends entropy-coded data


def _jpeg_fault(content: bytes) -> str:
    """Walk the segments to the end-of-image marker; what follows it (a camera's padding) does not matter."""
    if content.endswith(b"\xff\xd9"):
        return ""  # compressed data cannot hold this marker, so there is nothing to look for
    at = 2
    while found := _JPEG_MARKER.search(content, at):
        marker, at = content[found.end() - 1], found.end()
        if marker == 0xD9:
            return ""
        if marker not in (0x01, 0xD8):
            if at + 2 > len(content):
                break
            at += int.from_bytes(content[at : at + 2], "big")
    return "no end-of-image marker"


def _png_fault(content: bytes) -> str:
    """Walk the chunks to IEND, checking each check sum."""
    at = 8
    while at + 12 <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        end = at + 12 + length
        if end > len(content):
            return f"chunk at byte {at} is incomplete"
        if zlib.crc32(memoryview(content)[at + 4 : end - 4]) != int.from_bytes(content[end - 4 : end], "big"):
            return f"wrong check sum in the chunk at byte {at}"
        if content[at + 4 : at + 8] == b"IEND":
            return ""
        at = end
    return "no IEND chunk"


def _netpbm_fault(content: bytes) -> str:
    header = re.match(
        rb"P([56])(?:\s+|#[^\n]*\n)+(\d+)\s+(?:#[^\n]*\n)*(\d+)\s+(?:#[^\n]*\n)*(\d+)\s", content
    )
    if header is None:
        return "incomplete header"
    kind, width, height, peak = (int(g) for g in header.groups())
    wanted = width * height * (3 if kind == 6 else 1) * (2 if peak > 255 else 1)
    have = len(content) - header.end()
    return "" if have >= wanted else f"{have} of {wanted} bytes of pixels"


def _bmp_fault(content: bytes) -> str:
    wanted = int.from_bytes(content[2:6], "little")
    return "" if len(content) >= wanted else f"{len(content)} of {wanted} bytes"


def _tiff_fault(content: bytes) -> str:
    """Every strip or tile of every directory must lie within the file."""
    order: Literal["little", "big"] = "little" if content[:2] == b"II" else "big"

    def number(at: int, size: int) -> int:
        if at + size > len(content):
            raise EOFError
        return int.from_bytes(content[at : at + size], order)

    try:
        directory = number(4, 4)
        lists: dict[int, list[int]] = {}
        for entry in range(number(directory, 2)):
            at = directory + 2 + 12 * entry
            tag, kind, count = number(at, 2), number(at + 2, 2), number(at + 4, 4)
            if tag in (273, 279, 324, 325) and kind in (3, 4):  # where strips or tiles lie, and their lengths
                size = 2 if kind == 3 else 4
                first = at + 8 if size * count <= 4 else number(at + 8, 4)
                lists[tag] = [number(first + size * i, size) for i in range(count)]
        starts = lists.get(273, []) + lists.get(324, [])
        lengths = lists.get(279, []) + lists.get(325, [])
        ends = [start + length for start, length in zip(starts, lengths, strict=True)]
    except (EOFError, ValueError):
        return "incomplete directory"
    return "" if ends and max(ends) <= len(content) else "incomplete pixels"


FORMATS: tuple[tuple[bytes, Callable[[bytes], str]], ...] = (
    (b"\xff\xd8\xff", _jpeg_fault),
    (b"\x89PNG\r\n\x1a\n", _png_fault),
    (b"P5", _netpbm_fault),
    (b"P6", _netpbm_fault),
    (b"BM", _bmp_fault),
    (b"II*\0", _tiff_fault),
    (b"MM\0*", _tiff_fault),
)
"""First bytes of a file, and the check of its format; the one table."""


# libjpeg's words for damage that it paints over. One to nine bytes too many are a habit of webcams: harmless.
_COMPLAINT = re.compile(r"(?!.*: \d extraneous byte)(Corrupt JPEG data|Premature end of JPEG file).*")
_STANDARD_ERROR = threading.Lock()  # of this process: one decoder at a time is listened to


def decode_picture(content: bytes, flags: int) -> tuple[np.ndarray | None, str]:
    """The picture as OpenCV decodes it, and what is wrong with it, or ""."""
    if content.startswith(b"\xff\xd8"):
        return _decode_jpeg(content, flags)
    return _decode(content, flags)


def _decode(content: bytes, flags: int) -> tuple[np.ndarray | None, str]:
    import cv2

    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), flags), ""
    except cv2.error as error:  # such as a size that no memory holds
        return None, str(error).strip().splitlines()[0]


def _decode_jpeg(content: bytes, flags: int) -> tuple[np.ndarray | None, str]:
    """Libjpeg goes on past damaged pixels and only prints that it did, from below Python.

    So what it prints is read back from the standard error's file. Anybody else's words are written on.
    """
    with _STANDARD_ERROR, tempfile.TemporaryFile() as said:
        try:
            kept = os.dup(2)
        except OSError:  # a service without a standard error: nothing is printed
            return _decode(content, flags)
        try:
            os.dup2(said.fileno(), 2)
            picture, fault = _decode(content, flags)
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        said.seek(0)
        lines = said.read().decode(errors="replace").splitlines()
    complaints = [line for line in lines if "JPEG" in line]
    for line in lines:
        if line not in complaints:
            sys.stderr.write(f"{line}\n")
    return picture, fault or next((line for line in complaints if _COMPLAINT.fullmatch(line)), "")

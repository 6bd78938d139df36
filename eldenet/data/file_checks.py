"""Checks that a picture's file is whole: OpenCV returns a full-size picture from a third of a file.

One check per format, on its bytes, returns what is wrong or "". A new format is one row in ``FORMATS``.
"""

import re
import zlib
from collections.abc import Callable
from typing import Literal

import numpy as np


def _png_fault(content: bytes) -> str:
    """Check every chunk's checksum up to IEND."""
    at = 8
    while at + 12 <= len(content):
        length = int.from_bytes(content[at : at + 4], "big")
        end = at + 12 + length
        if end > len(content):
            return f"chunk at byte {at} is incomplete"
        if zlib.crc32(memoryview(content)[at + 4 : end - 4]) != int.from_bytes(content[end - 4 : end], "big"):
            return f"wrong checksum in the chunk at byte {at}"
        if content[at + 4 : at + 8] == b"IEND":
            return ""
        at = end
    return "no IEND chunk"


# a number of a header, after white space and comments; possessive, so that no input takes quadratic time
_NUMBER = rb"(?:\s|#[^\n]*+\n)++(\d{1,9}+)"
_NETPBM = re.compile(rb"P([56])" + 3 * _NUMBER + rb"\s")


def _netpbm_fault(content: bytes) -> str:
    header = _NETPBM.match(content)
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
    """Check that every strip or tile lies within the file."""
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
            if tag in (273, 279, 324, 325) and kind in (3, 4):  # places and lengths of strips or tiles
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
    (b"\xff\xd8\xff", lambda content: ""),  # its strict decoder, below, finds cuts and damage
    (b"\x89PNG\r\n\x1a\n", _png_fault),
    (b"P5", _netpbm_fault),
    (b"P6", _netpbm_fault),
    (b"BM", _bmp_fault),
    (b"II*\0", _tiff_fault),
    (b"MM\0*", _tiff_fault),
)
"""First bytes of a file, and the check of its format."""


# A warning of libjpeg that means no damage: webcams often write one to nine bytes too many.
_HARMLESS = re.compile(r".*: \d extraneous byte")


def decode_picture(content: bytes, flags: int) -> tuple[np.ndarray | None, str]:
    """Return the picture as OpenCV decodes it (BGR), and what is wrong with it, or "".

    Args:
        content: of the file.
        flags: of ``cv2.imdecode``.
    """
    import cv2

    if content.startswith(b"\xff\xd8"):
        picture, fault = _decode_jpeg(content)
        upright = not flags & cv2.IMREAD_IGNORE_ORIENTATION
        if fault or not (picture is None or upright):
            return picture, fault
    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), flags), ""
    except cv2.error as error:  # such as a size that no memory holds
        return None, str(error).strip().splitlines()[0]


def _decode_jpeg(content: bytes) -> tuple[np.ndarray | None, str]:
    """Decode with every warning of libjpeg as a fault: OpenCV and Pillow pass over damaged pixels in silence.

    The picture is None where OpenCV must decode it (CMYK).
    """
    import simplejpeg

    try:
        *_, colors, _ = simplejpeg.decode_jpeg_header(content)
        if colors not in ("Gray", "RGB", "YCbCr"):
            return None, ""
        channels = "Gray" if colors == "Gray" else "BGR"
        try:
            picture = simplejpeg.decode_jpeg(content, channels)
        except ValueError as error:
            if not _HARMLESS.match(str(error)):
                raise
            picture = simplejpeg.decode_jpeg(content, channels, strict=False)
    except (ValueError, MemoryError) as error:
        return None, str(error) or "more pixels than memory holds"
    return (picture[..., 0] if channels == "Gray" else picture), ""

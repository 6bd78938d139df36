"""Pictures from the bytes of their files: size, whether the file is whole, pixels.

OpenCV returns a full-size picture from a third of a file, so each format has a check of its bytes, which
returns what is wrong or "". A new format is a row in ``FORMATS`` and a branch in :func:`picture_size`.
"""

import io
import re
import struct
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from eldenet.data.array_files import MOST_CHANNELS
from eldenet.system.errors import first_line
from eldenet.system.extras import require

ORIENTATION = 0x112  # EXIF's and TIFF's tag
SUBFILE, PHOTOMETRIC, DNG_VERSION = 254, 262, 50706  # TIFF's tags
RAW_PHOTOMETRIC = (32803, 34892)  # color filter array, linear raw


def _png_fault(content: bytes) -> str:
    """Check every chunk's checksum up to IEND."""
    from PIL.PngImagePlugin import PngImageFile

    try:
        PngImageFile(io.BytesIO(content)).verify()
    except Exception as error:  # SyntaxError, OSError, struct.error ...
        return str(error)
    return ""


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


def _tiff_directory(content: bytes) -> Any:
    from PIL.TiffImagePlugin import ImageFileDirectory_v2

    file, directory = io.BytesIO(content), ImageFileDirectory_v2(content[:8])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of a cut directory
        file.seek(directory.next)
        directory.load(file)
    return directory


def _tiff_fault(content: bytes) -> str:
    """Check that every strip or tile lies within the file."""
    try:
        directory = _tiff_directory(content)
        starts = directory.get(273, ()) + directory.get(324, ())
        lengths = directory.get(279, ()) + directory.get(325, ())
        ends = [start + length for start, length in zip(starts, lengths, strict=True)]
    except Exception:  # SyntaxError, struct.error, TypeError ...
        return "incomplete directory"
    return "" if ends and max(ends) <= len(content) else "incomplete pixels"


def picture_size(content: bytes) -> tuple[int, int]:
    """Return ``(height, width)`` [px] from a picture's header, before anything is decoded; (0, 0) if damaged.

    The scans of a progressive JPEG above a hundred count as rows: each takes as long as a picture.
    """
    try:
        if content.startswith(b"\xff\xd8"):
            import simplejpeg

            height, width, *_ = simplejpeg.decode_jpeg_header(content)
            return height * max(1, _scans(content) // 100), width
        if content.startswith(b"\x89PNG"):
            width, height = struct.unpack(">II", content[16:24])
        elif content.startswith(b"BM"):
            kind = "<HH" if content[14:18] == b"\x0c\0\0\0" else "<ii"
            width, height = struct.unpack_from(kind, content, 18)
        elif content[:2] in (b"P5", b"P6"):
            header = _NETPBM.match(content)
            width, height = (int(header[2]), int(header[3])) if header else (0, 0)
        elif is_heif(content):
            width, height = _heif(content).size
        elif content.startswith(b"RIFF"):
            height, width = _webp_size(content)
        else:
            directory = _tiff_directory(content)
            width, height = directory[256], directory[257]
            height *= -(-directory.get(277, 1) // MOST_CHANNELS)  # samples per pixel: more count as rows
        return abs(int(height)), abs(int(width))
    except ImportError:
        raise
    except Exception:  # the check of the format, or the decoder, says what is wrong
        return 0, 0


# the next marker in a JPEG's compressed data, where FF 00 is a number and D0 to D7 restart the decoder
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xff\xd0-\xd7])", re.DOTALL)


def _scans(content: bytes) -> int:
    """Number of scans of a JPEG; what lies behind its end, as in a phone's motion photo, is no part of it."""
    count, at = 0, 2
    while (marker := _JPEG_MARKER.search(content, at)) and marker[1] != b"\xd9":
        count += marker[1] == b"\xda"
        at = marker.end() + int.from_bytes(content[marker.end() : marker.end() + 2])
    return count


def is_raw_photo(content: bytes) -> bool:
    """Whether a TIFF is a raw photo (DNG, NEF ...): it holds a small preview, or the sensor's numbers."""
    if content[:4] not in (b"II*\0", b"MM\0*"):
        return False
    try:
        directory = _tiff_directory(content)
        is_preview = DNG_VERSION in directory or directory.get(SUBFILE, 0) & 1
        return bool(is_preview or directory.get(PHOTOMETRIC) in RAW_PHOTOMETRIC)
    except Exception:  # the check of TIFF says what is wrong
        return False


def without_orientation(content: bytes) -> bytes:
    """Return a TIFF without its orientation, for decoders that always turn it; other files as they are."""
    if content[:4] not in (b"II*\0", b"MM\0*"):
        return content
    order = "<" if content[:1] == b"I" else ">"
    changed = bytearray(content)
    try:
        (start,) = struct.unpack_from(f"{order}I", content, 4)
        (count,) = struct.unpack_from(f"{order}H", content, start)
        for entry in range(start + 2, start + 2 + 12 * count, 12):
            (tag,) = struct.unpack_from(f"{order}H", content, entry)
            if tag == ORIENTATION:
                struct.pack_into(f"{order}HHIHH", changed, entry, ORIENTATION, 3, 1, 1, 0)  # a short: 1
    except struct.error:  # the check of TIFF says what is wrong
        return content
    return bytes(changed)


def is_heif(content: bytes) -> bool:
    """Whether the bytes are those of a HEIC or HEIF picture, as iPhones write them."""
    return content[4:12] in (b"ftypheic", b"ftypheix", b"ftypmif1", b"ftypmsf1", b"ftypheim", b"ftyphevc")


def _heif(content: bytes) -> Any:
    """Open a HEIC picture, of which only the header is read."""
    require("reading HEIC pictures", "pillow_heif")
    import pillow_heif

    return pillow_heif.open_heif(io.BytesIO(content))


def _webp_size(content: bytes) -> tuple[int, int]:
    """Return ``(height, width)`` [px] of a WebP picture: lossy, lossless, or an extended one's canvas."""
    kind, size = content[12:16], content[20:]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", size, 6)
        return height & 0x3FFF, width & 0x3FFF
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", size, 1)
        return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
    return int.from_bytes(size[7:10], "little") + 1, int.from_bytes(size[4:7], "little") + 1


def _webp_fault(content: bytes) -> str:
    """Compare the length that the header states with that of the file."""
    if content[8:12] != b"WEBP":
        return "it is no picture"
    stated = int.from_bytes(content[4:8], "little") + 8
    return f"it has {len(content)} bytes instead of {stated}" if len(content) < stated else ""


FORMATS: tuple[tuple[bytes, Callable[[bytes], str]], ...] = (
    (b"\xff\xd8\xff", lambda content: ""),  # its strict decoder, below, finds cuts and damage
    (b"\x89PNG\r\n\x1a\n", _png_fault),
    (b"P5", _netpbm_fault),
    (b"P6", _netpbm_fault),
    (b"BM", _bmp_fault),
    (b"II*\0", _tiff_fault),
    (b"MM\0*", _tiff_fault),
    (b"RIFF", _webp_fault),
)
"""First bytes of a file, and the check of its format."""


# A warning of libjpeg that means no damage: webcams often write one to nine bytes too many.
_HARMLESS = re.compile(r".*: \d extraneous byte")


def decode_picture(content: bytes, flags: int) -> tuple[np.ndarray | None, str]:
    """Return a file's picture as ``cv2.imdecode`` does with ``flags`` (BGR), and what is wrong, or ""."""
    import cv2

    if is_heif(content):
        try:  # libheif turns the picture upright
            return cv2.cvtColor(np.asarray(_heif(content).to_pillow().convert("RGB")), cv2.COLOR_RGB2BGR), ""
        except (ValueError, OSError, EOFError, RuntimeError) as error:
            return None, first_line(error) or type(error).__name__
    if content.startswith(b"\xff\xd8"):
        picture, fault = _decode_jpeg(content)
        upright = not flags & cv2.IMREAD_IGNORE_ORIENTATION
        if fault or (picture is not None and not upright):  # else OpenCV turns it, or decodes CMYK
            return picture, fault
    as_stored = flags == cv2.IMREAD_UNCHANGED or flags & cv2.IMREAD_IGNORE_ORIENTATION
    try:
        if as_stored:
            content = without_orientation(content)
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
        if flags != cv2.IMREAD_UNCHANGED and (header := _NETPBM.match(content)) and picture is not None:
            return _of_full_range(picture, int(header[4]))
        return picture, ""
    except cv2.error as error:  # such as a size that no memory holds
        return None, str(error).strip().splitlines()[0]


def _of_full_range(picture: np.ndarray, peak: int) -> tuple[np.ndarray, str]:
    """Scale a PPM or PGM of 8 bits, whose largest number may be any, to 255."""
    if not 0 < peak < 255:
        return picture, ""
    if picture.max(initial=0) > peak:
        return picture, f"numbers above its peak of {peak}"
    return ((picture.astype(np.uint32) * 510 + peak) // (2 * peak)).astype(np.uint8), ""


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

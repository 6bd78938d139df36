"""Read bytes and arrays (``.npy``, PFM, OpenEXR); a damaged file is an error that names it."""

import io
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eldenet.system.errors import reading
from eldenet.system.extras import require

PIXEL_VARIABLE, MOST_PIXELS = "ELDENET_MAX_PIXELS", 100_000_000
MOST_CHANNELS = 4  # for each of these pixels


def check_pixels(shape: Sequence[int], source: object) -> None:
    """Refuse a picture or array ``(H, W)``, ``(H, W, C)`` or ``(C, H, W)`` by the shape in its header.

    A file of 1 MB may hold a picture of several GB: the limit is 100 million pixels, or
    ``$ELDENET_MAX_PIXELS``, and four channels of so many.

    Raises:
        ValueError: there are more pixels or channels than that, or the variable is not a number.
    """
    given = os.environ.get(PIXEL_VARIABLE) or str(MOST_PIXELS)
    if not given.isdecimal():
        raise ValueError(f"{PIXEL_VARIABLE}={given!r}: give a whole number of pixels")
    sides = [int(side) for side in shape]
    channels = min(sides[0], sides[-1]) if len(sides) == 3 else 1
    pixels = math.prod(sides) // max(1, channels)
    if pixels > int(given) or math.prod(sides) > MOST_CHANNELS * int(given):
        size = " x ".join(map(str, sides))
        raise ValueError(
            f"{source} has {size} values, more than {int(given):,} pixels: if this is intended, set the "
            f"environment variable {PIXEL_VARIABLE} to a larger number"
        )


def read_bytes(path: Path) -> bytes:
    """Return a file's content.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is larger than 32 bytes for each of the pixels that :func:`check_pixels` allows.
    """
    if not path.is_file():
        advice = "check data.root, or fetch the file again"
        raise FileNotFoundError(f"{path} does not exist{' as a file' * path.exists()}: {advice}")
    check_pixels((path.stat().st_size // 32,), path)
    return path.read_bytes()


def read_array(path: Path) -> np.ndarray:
    """Read a plain ``.npy`` file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is truncated or damaged, or holds Python objects.
    """
    content = read_bytes(path)
    if content.startswith(b"PK"):
        raise ValueError(f"{path} is an .npz archive, not an .npy file: store its array with numpy.save")
    with reading(path, "plain .npy file"):
        # no pickles: a data file must not run code
        values = np.load(io.BytesIO(content), allow_pickle=False)
        if values.dtype.kind not in "biuf":
            raise TypeError(f"it holds {values.dtype}, not numbers")
    check_pixels(values.shape, path)
    return values


def read_pfm(path: Path) -> np.ndarray:
    """Read a portable float map, ``(H, W)`` or ``(H, W, 3)`` float32.

    Convention: rows are stored from the bottom up; the sign of the third line is the byte order, and its size
    is ignored, as in Middlebury's and MiDaS's readers.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is truncated or not a PFM.
    """
    content = read_bytes(path)
    header = re.match(rb"P([Ff])\s+(\d+)\s+(\d+)\s+([-+]?[\d.]+(?:[eE][-+]?\d+)?)[ \t\r]*\n", content)
    if header is None:
        raise ValueError(f"{path} is not a PFM file, or truncated in its header: fetch or write it again")
    shape = (int(header[3]), int(header[2]), 3 if header[1] == b"F" else 1)
    check_pixels(shape, path)
    wanted, have = 4 * math.prod(shape), len(content) - header.end()
    if have < wanted:
        raise ValueError(f"{path} is truncated ({have} of {wanted} bytes of pixels): fetch or copy it again")
    order = "<f4" if header[4].startswith(b"-") else ">f4"
    values = np.frombuffer(content, order, wanted // 4, header.end()).reshape(shape)[::-1].astype(np.float32)
    return values[..., 0] if shape[2] == 1 else values


def read_exr(path: Path) -> np.ndarray:
    """Read the one channel of an OpenEXR file, or any of several equal ones (gray), ``(H, W)``.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: OpenEXR is not installed (OpenCV's wheels do not include it).
        ValueError: the file is truncated or damaged, or its channels differ.
    """
    read_bytes(path)
    require("reading .exr files", "OpenEXR")
    import OpenEXR

    with reading(path, "OpenEXR file"), OpenEXR.File(str(path), header_only=True) as file:
        header = file.header()
        first, last = (np.array(corner, np.int64) for corner in header["dataWindow"])
        sides = (last - first + 1).tolist()
        channel_names = [channel.name for channel in header["channels"]]
    check_pixels(sides[::-1], path)
    if not 0 < len(channel_names) <= MOST_CHANNELS:
        raise ValueError(f"{path} has {len(channel_names)} channels: store only depth, as one channel")
    with reading(path, "OpenEXR file"), OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: np.array(channel.pixels) for name, channel in file.channels().items()}
    first, *others = channels.values()
    if not all(np.array_equal(first, other) for other in others):
        raise ValueError(f"{path} has the channels {', '.join(channels)}: store only depth, as one channel")
    return first

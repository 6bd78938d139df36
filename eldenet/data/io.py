"""Read images and depth maps from disk: a damaged file or a wrong unit is an error that names the file.

A new encoding is one row in ``ENCODINGS``; ``picture_decoding`` says what a new format of pictures takes.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from eldenet.data.array_files import check_pixels, read_array, read_bytes, read_exr, read_pfm
from eldenet.data.picture_decoding import (
    FORMATS,
    ORIENTATION,
    decode_picture,
    is_heif,
    is_raw_photo,
    picture_size,
)

HEIF_ENDINGS = (".heic", ".heif")
IMAGE_ENDINGS = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".ppm", ".pgm", ".webp", *HEIF_ENDINGS)


@dataclass(frozen=True)
class DepthEncoding:
    """How numbers in a depth file become meters: ``(v + offset) * scale``; 0, NaN and below 0 are unknown."""

    name: str  # in a config; of an own one, what was given
    scale: float = 1.0  # meters per step
    offset: float = 0.0  # added to the number before scaling [steps]
    # numpy type that the file must hold; "float" allows float16, float32 and float64, "uint16" wider integers
    # too, as numpy stores them by default
    dtype: str = "uint16"
    # replaces scale and offset if the encoding is not linear: raw numbers -> [m], pixel by pixel
    decode: Callable[[np.ndarray], np.ndarray] | None = None
    # a file whose largest number is below this cannot be in this encoding; 0 = no such check
    lowest_peak: int = 0

    @property
    def description(self) -> str:
        """Text that differs between encodings; ``decode`` is identified by the name."""
        return f"{self.name}: {self.scale!r}, {self.offset!r}, {self.dtype}"

    def to_meters(self, raw: np.ndarray) -> np.ndarray:
        """Convert ``(H, W)`` numbers of the file to float32 [m], 0 where unknown."""
        if raw.dtype in (np.uint8, np.uint16):
            return _table(self, raw.dtype.str)[raw]  # ten times faster than computing each pixel
        return self._meters_of(raw)

    def _meters_of(self, raw: np.ndarray) -> np.ndarray:
        known = np.isfinite(raw) & (raw > 0)
        if self.decode is not None:
            meters = self.decode(raw)
        else:
            # in double, rounded once: equal to the last digit to a plain division in numpy
            meters = (np.where(known, raw, 0).astype(np.float64) + self.offset) * self.scale
        return np.where(known, meters, 0.0).astype(np.float32)


@lru_cache(maxsize=8)
def _table(encoding: DepthEncoding, dtype: str) -> np.ndarray:
    """Meters [m] of every number that a small integer type can hold."""
    return encoding._meters_of(np.arange(np.iinfo(dtype).max + 1, dtype=dtype))


def _turned_bits(raw: np.ndarray) -> np.ndarray:
    return ((raw >> 3) | (raw << 13)) / 1000.0


ENCODINGS: dict[str, DepthEncoding] = {
    row.name: row
    for row in (
        DepthEncoding("meters", dtype="float"),
        DepthEncoding("mm", 1e-3, lowest_peak=255),
        DepthEncoding("kitti", 1 / 256, lowest_peak=256),
        DepthEncoding("tum", 1 / 5000, lowest_peak=255),
        # SUN RGB-D rotates the bits of its millimeters: (v >> 3) | (v << 13), as in its toolbox
        DepthEncoding("sunrgbd", 1e-3, decode=_turned_bits, lowest_peak=255),
        # DenseDepth's training pictures: 8 bits over 10 m
        DepthEncoding("nyu8", 10 / 255, dtype="uint8"),
        # the labeled frames in 8 bits: bin centers up to the set's largest depth
        DepthEncoding("nyu8_labelled", 9.99547 / 255, 0.5, dtype="uint8"),
    )
}
"""Depth encodings by name."""

Encoding = str | Mapping[str, object] | DepthEncoding


def depth_encoding(encoding: Encoding) -> DepthEncoding:
    """Look up an encoding by name, or build one from ``{scale: meters per step, offset: steps, dtype}``.

    Raises:
        ValueError: the name or a key does not exist, or a value is out of its range.
    """
    if isinstance(encoding, DepthEncoding):
        return encoding
    if isinstance(encoding, str):
        if encoding not in ENCODINGS:
            raise ValueError(
                f"encoding={encoding!r} is not known: give one of {sorted(ENCODINGS)}, or "
                "{scale: meters per step, offset: steps, dtype: uint8 | uint16 | int32 | float}"
            )
        return ENCODINGS[encoding]
    unknown = set(encoding) - {"scale", "offset", "dtype"}
    if unknown or "scale" not in encoding:
        raise ValueError(
            f"encoding={dict(encoding)}: give scale and, if needed, offset and dtype, nothing else"
        )
    dtype = str(encoding.get("dtype", "uint16"))
    if dtype not in ("uint8", "uint16", "int32", "float", "float32", "float64"):
        raise ValueError(f"encoding dtype={dtype!r}: give uint8, uint16, int32, float, float32 or float64")
    scale, offset = float(str(encoding["scale"])), float(str(encoding.get("offset", 0.0)))
    if not scale > 0:
        raise ValueError(f"encoding scale={scale}: meters per step must be above 0")
    given = ", ".join(f"{key}: {value}" for key, value in encoding.items())
    return DepthEncoding(f"{{{given}}}", scale, offset, dtype)


def read_image(path: str | Path, *, upright: bool = False, gray: bool = True) -> np.ndarray:
    """Read a picture as uint8 RGB, ``(H, W, 3)``.

    Args:
        path: a JPEG, PNG, BMP, TIFF, WebP, HEIC or binary PPM/PGM file; its content decides, not its ending.
        upright: rotate a photo as its EXIF tag says. False for data sets, whose depth is not rotated either.
        gray: whether a gray picture is allowed; in a data set in color it is probably a depth map.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is truncated or damaged, does not have 8 bits or, if required, color.
    """
    import cv2

    flags = cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH
    picture = _decode(Path(path), flags if upright else flags | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture.dtype != np.uint8:
        guess = "is it a depth map? If not, " if picture.ndim == 2 else ""
        raise ValueError(
            f"{path} holds {picture.dtype}, images must have 8 bits: {guess}convert it to 8 bits"
        )
    if picture.ndim == 2:
        if not gray:
            raise ValueError(f"{path} is gray, this data set has color images: is it a depth map?")
        return cv2.cvtColor(picture, cv2.COLOR_GRAY2RGB)
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def is_turned(path: str | Path) -> bool:
    """Return whether the EXIF tag of a photo says that it must be turned or mirrored to be upright."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as photo:
            return photo.getexif().get(ORIENTATION, 1) != 1
    except (UnidentifiedImageError, OSError, ValueError, TypeError, SyntaxError):
        return False  # what is wrong with a picture is said where it is read


def read_depth(path: str | Path, encoding: Encoding) -> np.ndarray:
    """Read a depth map in an encoding as float32 [m], ``(H, W)``, 0 where unknown.

    The file is a ``.npy``, ``.pfm`` or ``.exr``, or a picture with one channel.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is truncated, damaged or not in this encoding.
    """
    return decode_depth(read_raw_depth(path), encoding, path)


def read_raw_depth(path: str | Path) -> np.ndarray:
    """Return the raw numbers of a depth file, ``(H, W)``.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is truncated or damaged, or has several channels.
    """
    path = Path(path)
    reader = {".npy": read_array, ".pfm": read_pfm, ".exr": read_exr}.get(path.suffix.lower())
    raw = _decode(path, -1) if reader is None else reader(path)  # -1 is cv2.IMREAD_UNCHANGED
    if raw.ndim == 3 and 1 in (raw.shape[0], raw.shape[2]):
        raw = raw.squeeze(0 if raw.shape[0] == 1 else 2)
    if raw.ndim != 2:
        raise ValueError(
            f"{path} has shape {raw.shape}, a depth map has one channel: is it a color visualization?"
        )
    return raw


def decode_depth(raw: np.ndarray, encoding: Encoding, source: object) -> np.ndarray:
    """Convert raw numbers ``(H, W)`` to float32 [m] after checking that they can be in this encoding.

    Raises:
        ValueError: the type is wrong, or the numbers show that the unit is another; names ``source``.
    """
    row = depth_encoding(encoding)
    fits = raw.dtype.kind == "f" if row.dtype == "float" else raw.dtype == np.dtype(row.dtype)
    if row.dtype == "uint16" and row.decode is None:
        fits = raw.dtype.kind in "iu" and raw.dtype.itemsize > 1
    if not fits:
        raise ValueError(
            f"{source} holds {raw.dtype}, encoding {row.name!r} needs {row.dtype}: {_suggest(raw)}"
        )
    peak = raw.max(initial=0)
    if 0 < peak < row.lowest_peak:
        raise ValueError(
            f"{source}: the largest number is {peak}, {row.scale * float(peak):.3g} m as {row.name!r}: it "
            f"was probably written in meters or in 8 bits; if not, give encoding {{scale: {row.scale:g}}}"
        )
    meters = row.to_meters(raw)
    if raw.any() and not meters.any():
        raise ValueError(
            f"{source} holds no depth above 0 m, only negative, NaN, infinite or meaningless numbers: write "
            "it again with 0 where depth is unknown"
        )
    if row.name == "meters":
        known = meters[meters > 0]
        middle = float(np.median(known)) if known.size else 0.0
        if middle > 100.0:
            raise ValueError(
                f"{source}: the median depth would be {middle:.0f} m, so it is probably in mm: give encoding "
                "{scale: 0.001, dtype: float}; if it is in meters, {scale: 1.0, dtype: float}"
            )
    return meters


def _suggest(raw: np.ndarray) -> str:
    """Name the encodings that numbers of this type may have."""
    names = [r.name for r in ENCODINGS.values() if (r.dtype == "float") == (raw.dtype.kind == "f")]
    names = [n for n in names if ENCODINGS[n].dtype in ("float", str(raw.dtype))]
    return f"for {raw.dtype} give {', '.join([*names, '{scale, offset, dtype}'])}"


def _decode(path: Path, flags: int) -> np.ndarray:
    """The pixels of a whole picture, as ``cv2.imdecode`` gives them with ``flags`` (BGR)."""
    content = read_bytes(path)
    check = next((check for magic, check in FORMATS if content.startswith(magic)), None)
    if (check is None and not is_heif(content)) or is_raw_photo(content):
        raise ValueError(
            f"{path} ({len(content)} bytes) is not a JPEG, PNG, BMP, TIFF, WebP, HEIC or binary PPM/PGM, or "
            "it is a raw photo: convert it to JPEG or PNG"
        )
    check_pixels(picture_size(content), path)
    fault = check(content) if check is not None else ""
    if not fault:
        picture, fault = decode_picture(content, flags)
    if fault:
        raise ValueError(f"{path} is truncated or damaged ({fault}): fetch or copy it again")
    if picture is None:
        raise ValueError(f"{path} is complete but cannot be decoded: convert it to PNG")
    return picture

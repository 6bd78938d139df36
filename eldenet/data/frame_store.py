"""One file of decoded frames that any number of processes read and write at once.

The file consists of slots, a frame in each: a header, the image as uint8, the depth as float32. The header
is written after the pixels and holds their checksum, which every read checks. So a slot that a killed
process, a power cut or two writers left behind is whole, or counts as empty.

:mod:`eldenet.data.cache` keeps frames once they are read in such a file, :mod:`eldenet.data.scene_store`
rendered frames. A render process loads this module, so it must not load torch.
"""

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.system.digests import digest_of
from eldenet.types import Frame

# stamp, image and depth (height, width), has intrinsics, intrinsics; then the checksum of all
_FIELDS, _SUM = struct.Struct("<16s4ii9d"), struct.Struct("<I")
HEADER = _FIELDS.size + _SUM.size
PAGE = 4096


def make_stamp(*words: str) -> bytes:
    """Sixteen bytes that identify the content of a slot."""
    return bytes.fromhex(digest_of("\n".join(words)))[:16]


def slot_size(pixels: int) -> int:
    """Bytes of a slot, in whole pages, for a frame whose image and depth take ``pixels`` bytes."""
    return -(-(HEADER + pixels + 1) // PAGE) * PAGE  # the last byte stays unused: see FrameStore.__init__


class FrameStore:
    """``count`` slots of ``slot`` bytes in a file. A pickled store is the same store in a worker process.

    Args:
        path: of the file, which is created or made longer as needed.
        count: number of frames.
        slot: bytes of each slot, from :func:`slot_size`.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path, count: int, slot: int) -> None:
        self.path, self.count, self.slot = path, count, slot
        self.handle = _open(path)
        if os.fstat(self.handle).st_size < count * slot:
            # sparse: takes no room yet. Unlike ftruncate, this cannot cut what another process just added
            _write(self.handle, b"\0", count * slot - 1, path)

    def __del__(self) -> None:
        if hasattr(self, "handle"):
            os.close(self.handle)

    def __reduce__(self) -> Any:
        return type(self), (self.path, self.count, self.slot)

    def get(self, index: int, stamp: bytes, name: str) -> Frame | None:
        """Return a copy of the frame in a slot, or None if the slot holds no whole frame with this stamp."""
        start = index * self.slot
        # no memory map: on a full tmpfs, reading an empty slot through one would kill the process
        header = _read(self.handle, HEADER, start)
        if len(header) < HEADER or header[:16] != stamp:
            return None
        _, rows, cols, depth_rows, depth_cols, has_intrinsics, *camera = _FIELDS.unpack_from(header)
        pixels, points = rows * cols * 3, depth_rows * depth_cols
        if min(pixels, points) < 0 or HEADER + pixels + 4 * points > self.slot:
            return None
        content = bytearray(_read(self.handle, pixels + 4 * points, start + HEADER))
        if len(content) < pixels + 4 * points:
            return None
        image = np.frombuffer(content, np.uint8, pixels).reshape(rows, cols, 3)
        depth = np.frombuffer(content, np.uint8, 4 * points, pixels).copy().view(np.float32)
        # of the copy: another process may write to the slot meanwhile
        if _checksum(header[: _FIELDS.size], image, depth) != _SUM.unpack_from(header, _FIELDS.size)[0]:
            return None
        intrinsics = np.array(camera).reshape(3, 3) if has_intrinsics else None
        return Frame(image, depth.reshape(depth_rows, depth_cols), intrinsics, name)

    def put(self, index: int, stamp: bytes, frame: Frame) -> bool:
        """Write a frame into its slot, pixels first, header last; False if it is larger than a slot.

        Raises:
            ValueError: image or depth have another type than :class:`~eldenet.types.Frame` says, or the frame
                has labels, which a slot does not hold.
            OSError: the file cannot be written.
        """
        if frame.labels is not None:
            raise ValueError(f"{frame.name}: a cache stores no labels, set labels=false or cache=none")
        image, depth = np.ascontiguousarray(frame.image), np.ascontiguousarray(frame.depth)
        if image.dtype != np.uint8 or depth.dtype != np.float32:
            raise ValueError(
                f"{frame.name}: load_frame returned {image.dtype} image and {depth.dtype} depth, it must "
                "return uint8 and float32"
            )
        if HEADER + image.nbytes + depth.nbytes > self.slot:
            return False
        camera = np.zeros(9) if frame.intrinsics is None else np.asarray(frame.intrinsics).ravel()
        has_intrinsics = int(frame.intrinsics is not None)
        fields = _FIELDS.pack(stamp, *image.shape[:2], *depth.shape, has_intrinsics, *camera)
        header = fields + _SUM.pack(_checksum(fields, image, depth))
        _write(self.handle, image.tobytes() + depth.tobytes(), index * self.slot + HEADER, self.path)
        _write(self.handle, header, index * self.slot, self.path)
        return True


def _open(path: Path) -> int:
    binary = getattr(os, "O_BINARY", 0)  # of Windows
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | binary, 0o644)
    except OSError:
        return os.open(path, os.O_RDONLY | binary)  # a shared file that this user may only read


def _read(handle: int, size: int, start: int) -> bytes:
    if hasattr(os, "pread"):
        return os.pread(handle, size, start)
    os.lseek(handle, start, os.SEEK_SET)  # Windows: no two processes share a handle there
    return os.read(handle, size)


def _write(handle: int, content: bytes, start: int, path: Path) -> None:
    done = 0
    try:
        while done < len(content):
            if hasattr(os, "pwrite"):
                done += os.pwrite(handle, content[done:], start + done)
            else:
                os.lseek(handle, start + done, os.SEEK_SET)
                done += os.write(handle, content[done:])
    except OSError as error:  # name the file
        raise OSError(error.errno, error.strerror, str(path)) from None


def _checksum(fields: bytes, image: np.ndarray, depth: np.ndarray) -> int:
    return zlib.crc32(depth.data, zlib.crc32(image.data, zlib.crc32(fields)))

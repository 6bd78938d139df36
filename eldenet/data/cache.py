"""Decoded frames kept for the next epoch, on disk or in memory, shared by every process that reads them.

One store is one memory-mapped file of slots, a frame in each: a header, the image as uint8, the depth as
float32. The header is written after the pixels and holds their checksum, which every read checks. So whatever
a killed process, a lost power supply or two writers leave in a slot is whole, or is read again from the files
of the frame. "disk" is a file below the cache folder; "ram" is a file without a name that lives in memory and
ends with its processes.
"""

import hashlib
import inspect
import json
import logging
import mmap
import os
import shutil
import struct
import tempfile
import zlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from multiprocessing.context import get_spawning_popen
from multiprocessing.reduction import DupFd
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from eldenet.data.shards import default_cache
from eldenet.system.resources import available_memory
from eldenet.types import Frame

#: Of the slots, and of how eldenet's data sets read a frame: raise it when either changes.
VERSION = 2
# stamp, image and depth (height, width), has intrinsics, intrinsics; then the checksum of these and pixels
_FIELDS, _SUM = struct.Struct("<16s4ii9d"), struct.Struct("<I")
HEADER = _FIELDS.size + _SUM.size
PAGE = 4096
_LOG = logging.getLogger("eldenet")


class CachedFrames(Protocol):
    """What a store has to know of a data set (:class:`~eldenet.data.base.DepthDataset`)."""

    cache: str
    ground_truth: str
    load_size: tuple[int, int] | None
    resize_depth: bool

    @property
    def split_hash(self) -> str: ...  # noqa: D102

    def __len__(self) -> int: ...

    def frame_settings(self) -> Mapping[str, object]: ...  # noqa: D102

    def frame_files(self, index: int) -> Sequence[Path]: ...  # noqa: D102

    def size_group(self, index: int) -> Hashable: ...  # noqa: D102

    def read_ready(self, index: int) -> Frame: ...  # noqa: D102


def open_store(dataset: CachedFrames) -> "FrameStore | None":
    """The store of a data set whose ``cache`` is "ram" or "disk"; None where the disk does not take it.

    Raises:
        ValueError: the memory does not hold it, or a data set that no disk cache can watch.
    """
    slot = _slot_bytes(dataset)
    size = len(dataset) * slot
    if dataset.cache == "ram":
        free = available_memory() // int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
        if size > free:
            raise ValueError(
                f"cache=ram wants {_gigabytes(size)} for {len(dataset)} frames, {_gigabytes(free)} are free: "
                "take cache=disk, cache=none, or a smaller load_size"
            )
        _LOG.info("frame cache in memory: up to %s for %d frames", _gigabytes(size), len(dataset))
        return FrameStore(None, len(dataset), slot)
    folder = default_cache().expanduser() / "frames" / _folder_name(dataset, slot)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "about.json").write_text(json.dumps(_identity(dataset), indent=1))
        store = FrameStore(folder / "frames.bin", len(dataset), slot)
        held = (folder / "frames.bin").stat().st_blocks * 512
        free = shutil.disk_usage(folder).free
    except OSError as error:
        _LOG.warning("no frame cache in %s (%s): every frame is read from its files", folder, error)
        return None
    _LOG.info(
        "frame cache: %s, %s once all %d frames are in it (now %s); remove the folder to be rid of it",
        folder,
        _gigabytes(size),
        len(dataset),
        _gigabytes(held),
    )
    if size - held > free:
        _LOG.warning(
            "frame cache: %s are free there, %s are missing: frames that find no room are read from their "
            "files each time",
            _gigabytes(free),
            _gigabytes(size - held),
        )
    return store


class FrameStore:
    """``count`` slots of ``slot`` bytes in a file that any number of processes read and write at once.

    Args:
        path: of the file, made where it is not there; None for one in memory. Pickled to a worker process
            that is being started, either is the same store there.
        count: frames.
        slot: bytes of each, header included.
        handle: of an open file to use instead.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(self, path: Path | None, count: int, slot: int, handle: int | None = None) -> None:
        self.path, self.count, self.slot = path, count, slot
        self.handle = _open(path) if handle is None else handle
        if os.fstat(self.handle).st_size < count * slot:
            os.ftruncate(self.handle, count * slot)  # sparse: takes no room yet
        self._map = mmap.mmap(self.handle, count * slot, access=mmap.ACCESS_READ)
        self._stamps: dict[int, bytes] = {}
        self._warned: set[str] = set()

    def __del__(self) -> None:
        if hasattr(self, "handle"):
            os.close(self.handle)

    def __reduce__(self) -> Any:
        if self.path is None and get_spawning_popen() is None:
            return type(None), ()  # a copy that is no worker's gets a memory of its own
        shared = DupFd(self.handle) if self.path is None else None
        return _reopened, (self.path, self.count, self.slot, shared)

    def frame(
        self, index: int, name: str, files: Callable[[int], Sequence[Path]], read: Callable[[int], Frame]
    ) -> Frame:
        """Frame ``index`` from its slot, else from ``read(index)``, and into the slot.

        Args:
            index: of the frame.
            name: of the frame.
            files: the files that a frame is read from; asked for a store on disk, at the frame's first read.
            read: reads a frame.
        """
        stamp = self._stamps.get(index)
        if stamp is None:
            stamp = self._stamps[index] = self._stamp(name, files, index)
        frame = self.get(index, stamp, name)
        if frame is None:
            frame = read(index)
            # files that changed while they were read, or since: the next process looks again
            if "full" not in self._warned and self._stamp(name, files, index) == stamp:
                self.put(index, stamp, frame)
        return frame

    def get(self, index: int, stamp: bytes, name: str) -> Frame | None:
        """A copy of the frame in a slot, or None if there is no whole one with this stamp."""
        start = index * self.slot
        header = self._map[start : start + HEADER]
        if header[:16] != stamp:
            return None
        _, rows, cols, depth_rows, depth_cols, has_intrinsics, *camera = _FIELDS.unpack_from(header)
        pixels, points = rows * cols * 3, depth_rows * depth_cols
        if min(pixels, points) < 0 or HEADER + pixels + 4 * points > self.slot:
            return None
        image = np.frombuffer(self._map, np.uint8, pixels, start + HEADER).reshape(rows, cols, 3).copy()
        depth = np.frombuffer(self._map, np.float32, points, start + HEADER + pixels).copy()
        # of the copies: nobody writes to these any more
        if _checksum(header[: _FIELDS.size], image, depth) != _SUM.unpack_from(header, _FIELDS.size)[0]:
            return None
        intrinsics = np.array(camera).reshape(3, 3) if has_intrinsics else None
        return Frame(image, depth.reshape(depth_rows, depth_cols), intrinsics, name)

    def put(self, index: int, stamp: bytes, frame: Frame) -> None:
        """Write a frame into its slot: pixels first, header last.

        Raises:
            ValueError: image or depth are of another type than :class:`~eldenet.types.Frame` says, or it has
                labels, which a slot has no room for.
        """
        if frame.labels is not None:
            raise ValueError(f"{frame.name}: a cache keeps no labels, take labels=false or cache=none")
        image, depth = np.ascontiguousarray(frame.image), np.ascontiguousarray(frame.depth)
        if image.dtype != np.uint8 or depth.dtype != np.float32:
            raise ValueError(
                f"{frame.name}: load_frame gave {image.dtype} image and {depth.dtype} depth, a cache keeps "
                "uint8 and float32"
            )
        if HEADER + image.nbytes + depth.nbytes > self.slot:
            self._warn("large", f"{frame.name} is larger than the first frame: frames like it are not cached")
            return
        camera = np.zeros(9) if frame.intrinsics is None else np.asarray(frame.intrinsics).ravel()
        has_intrinsics = int(frame.intrinsics is not None)
        fields = _FIELDS.pack(stamp, *image.shape[:2], *depth.shape, has_intrinsics, *camera)
        header = fields + _SUM.pack(_checksum(fields, image, depth))
        start = index * self.slot
        try:
            # not through the map: a full disk would end the process there, and gives an error here
            _write(self.handle, image.tobytes() + depth.tobytes(), start + HEADER)
            _write(self.handle, header, start)
        except OSError as error:
            self._warn(
                "full",
                f"the frame cache takes no more frames ({error}): {self.path or 'memory'}. The work goes on, "
                "the others are read from their files; make room, or take another $ELDENET_CACHE",
            )

    def _stamp(self, name: str, files: Callable[[int], Sequence[Path]], index: int) -> bytes:
        """Sixteen bytes that change with the frame's files."""
        state = [name]
        if self.path is not None:
            for file in files(index):
                found = os.stat(file)
                state.append(f"{file}|{found.st_size}|{found.st_mtime_ns}|{found.st_ctime_ns}")
        return hashlib.sha256("\n".join(state).encode()).digest()[:16]

    def _warn(self, what: str, message: str) -> None:
        if what not in self._warned:
            self._warned.add(what)
            _LOG.warning("%s", message)


def _open(path: Path | None) -> int:
    if path is not None:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    if hasattr(os, "memfd_create"):
        return os.memfd_create("eldenet-frames")
    with tempfile.TemporaryFile() as file:  # no Linux: without a name, in memory if it fits
        return os.dup(file.fileno())


def _reopened(path: Path | None, count: int, slot: int, shared: Any) -> "FrameStore | None":
    try:
        return FrameStore(path, count, slot, None if shared is None else shared.detach())
    except OSError as error:
        _LOG.warning("no frame cache in %s (%s): every frame is read from its files", path, error)
        return None


def _write(handle: int, content: bytes, start: int) -> None:
    done = 0
    while done < len(content):
        done += os.pwrite(handle, content[done:], start + done)


def _checksum(fields: bytes, image: np.ndarray, depth: np.ndarray) -> int:
    return zlib.crc32(depth.data, zlib.crc32(image.data, zlib.crc32(fields)))


def _slot_bytes(dataset: CachedFrames) -> int:
    """Room for the largest frame, as far as the first one of every size group tells."""
    first = {dataset.size_group(index): index for index in reversed(range(len(dataset)))}
    frames = [dataset.read_ready(index) for index in first.values()]
    largest = max(frame.image.nbytes + frame.depth.nbytes for frame in frames)
    return -(-(HEADER + largest) // PAGE) * PAGE


def _identity(dataset: CachedFrames) -> dict[str, object]:
    """Everything that a store's frames depend on except the files: each slot has a stamp of its own."""
    import cv2

    kind = type(dataset)
    own = [
        base
        for base in kind.__mro__
        if hasattr(base, "load_frame") and base.__module__.split(".")[0] != "eldenet"
    ]
    try:
        sources = sorted({Path(inspect.getfile(base)) for base in own})
    except (TypeError, OSError) as error:
        raise ValueError(
            f"{kind.__name__} is defined in no file, so a disk cache cannot notice when its code changes: "
            "move it into a module, or use cache=ram"
        ) from error
    return {
        "version": VERSION,
        "data set": f"{kind.__module__}.{kind.__qualname__}",
        "settings": dataset.frame_settings(),
        "ground truth": dataset.ground_truth,
        "load_size": dataset.load_size,
        "resize_depth": dataset.resize_depth,
        "frames": dataset.split_hash,
        "first files": [str(file) for file in dataset.frame_files(0)],
        "code": [hashlib.sha256(file.read_bytes()).hexdigest() for file in sources],
        "opencv": cv2.__version__,
    }


def _folder_name(dataset: CachedFrames, slot: int) -> str:
    identity = json.dumps([_identity(dataset), slot], sort_keys=True)
    return f"{type(dataset).__name__}-{hashlib.sha256(identity.encode()).hexdigest()[:16]}"


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.2f} GB"

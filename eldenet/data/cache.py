"""The frame cache of a data set: frames as they are once read and resized, kept for the next epoch.

It is a file below the cache folder, for this run and later ones: one
:class:`~eldenet.data.frame_store.FrameStore` for all worker processes.
"""

import inspect
import json
import logging
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.data.frame_store import FrameStore, make_stamp, slot_size
from eldenet.data.paths import default_cache
from eldenet.system.digests import digest_of, file_digest
from eldenet.system.errors import warn_once
from eldenet.system.files import write_text
from eldenet.types import Frame

if TYPE_CHECKING:
    from eldenet.data.base import DepthDataset

#: Version of the slots and of how eldenet's data sets read a frame: raise it when either changes.
VERSION = 3
_LOG = logging.getLogger("eldenet")


def open_cache(dataset: "DepthDataset") -> "FrameCache | None":
    """Open the cache of a data set whose ``cache`` is "disk"; None if the folder cannot be written.

    Raises:
        ValueError: the cache cannot notice changes of this data set.
    """
    slot = _slot_bytes(dataset)
    size = len(dataset) * slot
    identity = _identity(dataset)
    digest = digest_of(json.dumps([identity, slot], sort_keys=True))[:16]
    folder = default_cache() / "frames" / f"{type(dataset).__name__}-{digest}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "about.json", json.dumps(identity, indent=1))
        cache = FrameCache(folder / "frames.bin", len(dataset), slot)
        found = (folder / "frames.bin").stat()
        held = found.st_blocks * 512 if hasattr(found, "st_blocks") else found.st_size  # Windows
        free = shutil.disk_usage(folder).free
    except OSError as error:
        _LOG.warning("no frame cache in %s (%s): every frame is read from its files", folder, error)
        return None
    _LOG.info(
        "frame cache: %s, %s once all %d frames are in it (now %s); to free the space, remove the folder",
        folder,
        _gigabytes(size),
        len(dataset),
        _gigabytes(held),
    )
    if size - held > free:
        _LOG.warning(
            "frame cache: it needs %s, but %s are free: frames that do not fit are read from their files",
            _gigabytes(size - held),
            _gigabytes(free),
        )
    return cache


class FrameCache(FrameStore):
    """The frames of a data set, each read from its files once and again when they change."""

    def __init__(self, path: Path, count: int, slot: int) -> None:
        super().__init__(path, count, slot)
        self._stamps: dict[int, bytes] = {}
        self._full = False

    def frame(
        self, index: int, name: str, files: Callable[[int], Sequence[Path]], read: Callable[[int], Frame]
    ) -> Frame:
        """Return frame ``index`` from its slot, else from ``read(index)``, which then fills the slot.

        ``files(index)`` are those that the frame is read from.
        """
        stamp = self._stamps.get(index)
        if stamp is None:
            stamp = self._stamps[index] = self._stamp(name, files, index)
        frame = self.get(index, stamp, name)
        if frame is None:
            frame = read(index)
            # if the files changed while they were read, or since, the next process reads them again
            if not self._full and self._stamp(name, files, index) == stamp:
                self._keep(index, stamp, frame)
        return frame

    def _keep(self, index: int, stamp: bytes, frame: Frame) -> None:
        try:
            if not self.put(index, stamp, frame):
                warn_once(f"{self.path}: frames that are larger than the first frame are not cached")
        except OSError as error:
            self._full = True
            _LOG.warning(
                "the frame cache %s is full (%s): all other frames are read from their files; free some "
                "space, or set $ELDENET_CACHE to another folder",
                self.path,
                error,
            )

    def _stamp(self, name: str, files: Callable[[int], Sequence[Path]], index: int) -> bytes:
        state = [name]
        for file in files(index):
            found = os.stat(file)
            state.append(f"{file}|{found.st_size}|{found.st_mtime_ns}|{found.st_ctime_ns}")
        return make_stamp(*state)


def _slot_bytes(dataset: "DepthDataset") -> int:
    """Bytes for the largest frame, judged by the first frame of every size group."""
    first = {dataset.size_group(index): index for index in reversed(range(len(dataset)))}
    frames = [dataset.read_ready(index) for index in first.values()]
    return slot_size(max(frame.image.nbytes + frame.depth.nbytes for frame in frames))


def _identity(dataset: "DepthDataset") -> dict[str, Any]:
    """Everything that the cached frames depend on except the files, which each slot has a stamp of."""
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
            f"{kind.__name__} is not defined in a file, so a disk cache cannot notice when its code changes: "
            "move it into a module, or set cache=none"
        ) from error
    return {
        "version": VERSION,
        "data set": f"{kind.__module__}.{kind.__qualname__}",
        "settings": dataset.frame_settings(),
        "ground truth": dataset.ground_truth,
        "resize_on_load": dataset.resize_on_load,
        "resize_depth": dataset.resize_depth,
        "frames": dataset.split_hash,
        "first files": [str(file) for file in dataset.frame_files(0)],
        "code": [file_digest(file) for file in sources],
        "opencv": cv2.__version__,
    }


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:.2f} GB"

"""Rendered frames on disk: shards of memory-mapped arrays, written whole or not at all.

A shard is a folder with ``image.npy`` (F, H, W, 3) uint8, ``depth.npy`` (F, H, W) uint16 in steps of 0.2 mm
(0 = unknown), ``intrinsics.npy`` (F, 3, 3) float64 [px] and ``shard.json`` with their checksums. It is
written under another name and renamed when complete: a killed render leaves whole shards only, and of two
processes that render the same shard one wins and the other drops its copy.

``python -m eldenet.data.shards`` is the worker process of a render; it loads neither torch nor the caller's
main module.
"""

import json
import os
import shutil
import sys
import uuid
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

#: Meters per step of the stored depth; uint16 then reaches 13.1 m.
DEPTH_STEP = 0.0002
#: Scenes per shard and frames per scene.
SHARD_SCENES, VIEWS = 8, 8

_ARRAYS = ("image", "depth", "intrinsics")


def default_cache() -> Path:
    """``$ELDENET_CACHE``, or ``~/.cache/eldenet``."""
    return Path(os.environ.get("ELDENET_CACHE") or Path.home() / ".cache" / "eldenet")


class Generator(NamedTuple):
    """A renderer of scenes and the version of its frames.

    Raise ``version`` whenever the frames change: stored results name their frames by it. The golden frames of
    ``tests/simulation/golden`` fail where frames change and the version does not.

    Attributes:
        name: of the data set.
        version: of its frames.
        renderer: ``package.module.function`` of ``(split, index, (height, width), views) ->``
            :class:`~eldenet.simulation.furnished_rooms.render.Views`, the frames of scene ``index``.
        digests: by ``(height, width)``, a suffix of the folder's name that results stored before the version
            counted alone know their frames by.
    """

    name: str
    version: int
    renderer: str
    digests: Mapping[tuple[int, int], str]

    def folder_name(self, size: tuple[int, int]) -> str:
        """Name of the folder that holds the frames of ``(height, width)`` [px]."""
        digest = self.digests.get(size)
        return f"{self.name}-v{self.version}-{size[0]}x{size[1]}" + (f"-{digest}" if digest else "")


def shard_folder(root: Path, split: str, shard: int) -> Path:
    """Where a shard lies."""
    return root / split / f"{shard:06d}"


def is_whole(folder: Path) -> bool:
    """Whether a shard is there, complete and unharmed (checksums over every byte, about 10 ms)."""
    try:
        sums = json.loads((folder / "shard.json").read_text())
        return all(zlib.crc32((folder / f"{name}.npy").read_bytes()) == sums[name] for name in _ARRAYS)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def write_shard(folder: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write a shard atomically; a broken one of that name is replaced, a whole one is kept."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = folder.with_name(f".{folder.name}-{os.getpid()}-{uuid.uuid4().hex[:8]}")
    scratch.mkdir()
    try:
        sums = {}
        for name in _ARRAYS:
            path = scratch / f"{name}.npy"
            np.save(path, arrays[name])
            sums[name] = zlib.crc32(path.read_bytes())
        (scratch / "shard.json").write_text(json.dumps(sums))
        if folder.exists() and not is_whole(folder):
            trash = scratch.with_name(scratch.name + "-broken")
            with suppress(FileNotFoundError):  # another process has put it away
                os.replace(folder, trash)
            shutil.rmtree(trash, ignore_errors=True)
        try:
            os.rename(scratch, folder)
        except OSError:
            if not is_whole(folder):  # not "another process was first" but a real failure
                raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def open_shard(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Memory maps of image, depth (steps) and intrinsics."""
    image, depth, intrinsics = (np.load(folder / f"{name}.npy", mmap_mode="r") for name in _ARRAYS)
    return image, depth, intrinsics


def encode_depth(depth: np.ndarray) -> np.ndarray:
    """Meters to steps; what does not fit is unknown."""
    steps = np.rint(np.asarray(depth, dtype=np.float64) / DEPTH_STEP)
    return np.where((steps > 0) & (steps < 65536), steps, 0).astype(np.uint16)


def render_shard(
    root: Path,
    renderer: str,
    split: str,
    shard: int,
    size: tuple[int, int],
    on_scene: Callable[[int], None] = lambda frames: None,
) -> None:
    """Render the scenes of one shard and write it; ``on_scene`` hears of every scene's frames."""
    module, _, function = renderer.rpartition(".")
    render: Callable[[str, int, tuple[int, int], int], Any] = getattr(import_module(module), function)
    columns: dict[str, list[np.ndarray]] = {name: [] for name in _ARRAYS}
    for index in range(shard * SHARD_SCENES, (shard + 1) * SHARD_SCENES):
        views = render(split, index, size, VIEWS)
        columns["image"].append(views.image)
        columns["depth"].append(encode_depth(views.depth))
        columns["intrinsics"].append(views.intrinsics)
        on_scene(len(views.image))
    write_shard(
        shard_folder(root, split, shard), {name: np.concatenate(parts) for name, parts in columns.items()}
    )


def _worker() -> None:
    """Render the shards of the job on stdin; print the number of frames after every scene."""
    job = json.loads(sys.stdin.readline())
    root, size = Path(job["root"]), tuple(job["size"])
    for shard in job["shards"]:
        if not is_whole(shard_folder(root, job["split"], shard)):
            render_shard(root, job["renderer"], job["split"], shard, size, _report)


def _report(frames: int) -> None:
    try:
        sys.stdout.write(f"{frames}\n")
        sys.stdout.flush()
    except BrokenPipeError:  # whoever asked is gone: stop without a word
        os._exit(1)


if __name__ == "__main__":
    _worker()

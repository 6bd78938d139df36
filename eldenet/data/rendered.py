"""Data sets that are rendered on this machine when first used: what ``rooms`` and ``arenas`` share."""

import hashlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import Queue

import numpy as np

from eldenet.data.base import DepthDataset, Transform
from eldenet.data.shards import (
    DEPTH_STEP,
    SHARD_SCENES,
    VIEWS,
    Generator,
    default_cache,
    is_whole,
    open_shard,
    render_shard,
    shard_folder,
)
from eldenet.types import Frame

SPLITS = ("train", "val", "test")
SHARD_FRAMES = SHARD_SCENES * VIEWS


class RenderedScenes(DepthDataset):
    """Rendered scenes with exact depth; frames are rendered once into a folder and reread from it.

    Frame ``i`` of a split is view ``i % 8`` of scene ``i // 8`` (named ``rooms/train/000123/4``) and depends
    on nothing else: more ``frames`` later keep the old ones and add to them. The splits hold different
    scenes. That folder is named after the generator's version, so that a changed generator never reads old
    frames.

    Args:
        split: "train", "val" or "test".
        frames: how many frames of the split to use.
        size: ``(height, width)`` of the rendered frames [px].
        root: folder for rendered frames; None takes ``$ELDENET_CACHE``, else ``~/.cache/eldenet``.
        workers: processes that render what is missing; None takes two (one on a single core), 0 renders here.
        min_depth: nearest depth that counts as known [m].
        max_depth: farthest depth that counts as known, at most 13 [m].
        input_size: as in :class:`DepthDataset`.
        transform: as in :class:`DepthDataset`.
        resize_depth: as in :class:`DepthDataset`.
        seed: of the augmentation; the scenes themselves are fixed.

    Attributes:
        generator: what renders them; a subclass names it.

    Raises:
        ValueError: an argument is out of its range.
        RuntimeError: a render process failed.
    """

    ground_truth = "dense"
    frame_lists = ("names", "places")
    generator: Generator

    def __init__(
        self,
        split: str = "train",
        frames: int = 2048,
        *,
        size: Sequence[int] = (128, 160),
        root: str | os.PathLike[str] | None = None,
        workers: int | None = None,
        min_depth: float = 0.1,
        max_depth: float = 10.0,
        input_size: Sequence[int] | None = None,
        transform: Transform | None = None,
        resize_depth: bool = True,
        seed: int = 0,
    ) -> None:
        name = self.generator.name
        _check(name, split, frames, size, workers, min_depth, max_depth)
        super().__init__(
            [f"{name}/{split}/{i // VIEWS:06d}/{i % VIEWS}" for i in range(frames)],
            min_depth=min_depth,
            max_depth=max_depth,
            input_size=input_size,
            transform=transform,
            resize_depth=resize_depth,
            seed=seed,
        )
        self.places = list(range(frames))  # a draw leaves gaps: where in the shards each frame lies
        self.split, self.size = split, (int(size[0]), int(size[1]))
        cache = default_cache() if root is None else Path(root)
        self.folder = cache.expanduser() / self.generator.folder_name(self.size)
        missing = self.missing_shards(split, frames)
        if missing:
            count = min(2, os.cpu_count() or 1) if workers is None else workers
            render_missing(self.folder, self.generator, split, missing, self.size, count)
        self._open: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def missing_shards(self, split: str, frames: int) -> list[int]:
        """Shards that would have to be rendered for so many frames of a split, of the same size and root."""
        shards = range(-(-frames // SHARD_FRAMES))
        return [shard for shard in shards if not is_whole(shard_folder(self.folder, split, shard))]

    @property
    def split_hash(self) -> str:
        """Names the split in reports: the frames, their size and the generator that rendered them."""
        return hashlib.sha256("\n".join([self.folder.name, *self.names]).encode()).hexdigest()[:16]

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_open": {}}  # a worker process opens its own memory maps

    def load_frame(self, index: int) -> Frame:
        """Read frame ``index`` from its shard."""
        shard, row = divmod(self.places[index], SHARD_FRAMES)
        if shard not in self._open:
            self._open[shard] = open_shard(shard_folder(self.folder, self.split, shard))
        image, depth, intrinsics = self._open[shard]
        meters = depth[row].astype(np.float32) * np.float32(DEPTH_STEP)
        return Frame(np.array(image[row]), meters, np.array(intrinsics[row]), self.names[index])


def _check(
    name: str,
    split: str,
    frames: int,
    size: Sequence[int],
    workers: int | None,
    min_depth: float,
    max_depth: float,
) -> None:
    if split not in SPLITS:
        raise ValueError(f"split={split!r}: {name} has the splits {list(SPLITS)}")
    if isinstance(frames, bool) or not isinstance(frames, int) or frames < 1:
        raise ValueError(f"frames={frames!r}: give a whole number of frames, at least 1")
    if len(size) != 2 or min(size) < 16 or max(size) > 2048:
        raise ValueError(f"size={tuple(size)}: give (height, width), each 16 to 2048 pixels")
    if workers is not None and workers < 0:
        raise ValueError(
            f"workers={workers}: give 0 (render in this process), a number of processes, or None"
        )
    if not 0 <= min_depth < max_depth <= 13.0:
        raise ValueError(
            f"min_depth={min_depth}, max_depth={max_depth}: give 0 <= min_depth < max_depth <= 13.0 [m], "
            "the farthest that a stored frame holds"
        )


def render_missing(
    root: Path, generator: Generator, split: str, shards: Sequence[int], size: tuple[int, int], workers: int
) -> None:
    """Render shards into ``root``, here or in worker processes, with a progress bar."""
    total = len(shards) * SHARD_FRAMES
    with _progress(f"rendering {generator.name}/{split} {size[1]}x{size[0]}", total) as advance:
        if workers == 0:
            for shard in shards:
                render_shard(root, generator.renderer, split, shard, size, advance)
        else:
            _render_in_processes(
                root, generator.renderer, split, shards, size, min(workers, len(shards)), advance
            )


def _render_in_processes(
    root: Path,
    renderer: str,
    split: str,
    shards: Sequence[int],
    size: tuple[int, int],
    workers: int,
    advance: Callable[[int], None],
) -> None:
    """Plain subprocesses: safe after torch is loaded, and the caller's script needs no ``__main__`` guard."""
    package = str(Path(__file__).resolve().parents[2])
    paths = [package, *filter(None, [os.environ.get("PYTHONPATH")])]
    env = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(paths),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    lines: Queue[tuple[int, str | None]] = Queue()
    processes = []
    try:
        for k in range(workers):
            process = subprocess.Popen(
                [sys.executable, "-m", "eldenet.data.shards"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env,
            )  # fmt: skip
            processes.append(process)
            assert process.stdin is not None
            job = {"root": str(root), "renderer": renderer, "split": split, "size": size}
            job["shards"] = list(shards[k::workers])
            process.stdin.write(json.dumps(job) + "\n")
            process.stdin.close()
            threading.Thread(target=_listen, args=(k, process, lines), daemon=True).start()
        running = workers
        while running:
            k, line = lines.get()
            if line is not None:
                advance(int(line))
            elif processes[k].wait() != 0:
                raise RuntimeError(
                    f"a render process ended with code {processes[k].returncode}: see its message above"
                )
            else:
                running -= 1
    finally:
        for process in processes:
            if process.poll() is None:
                process.terminate()
            process.wait()


def _listen(k: int, process: "subprocess.Popen[str]", lines: "Queue[tuple[int, str | None]]") -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put((k, line))
    lines.put((k, None))


@contextmanager
def _progress(title: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar on a terminal, a line every ten seconds elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if console.is_terminal:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(title, total=total)
            yield lambda frames: bar.advance(task, frames)
        return
    start, last, done = time.monotonic(), 0.0, 0

    def advance(frames: int) -> None:
        nonlocal last, done
        done += frames
        now = time.monotonic() - start
        if now - last > 10 or done == total:
            last = now
            console.print(
                f"{title}: {done}/{total} frames, {done / max(now, 1e-6):.0f} frames/s", highlight=False
            )

    yield advance

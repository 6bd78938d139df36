"""The stored frames of a rendered data set; missing ones are rendered here or in worker processes.

``python -m eldenet.data.scene_store`` is such a worker; it loads neither torch nor the caller's main module.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from eldenet.data.frame_store import FrameStore, make_stamp, slot_size
from eldenet.system.errors import DiskError, writing
from eldenet.types import Frame

#: Stored depth of rooms and arenas is a multiple of this [m]. Steps fit into 16 bits: up to 13.1 m.
DEPTH_STEP = 0.0002
#: Frames of each scene.
VIEWS = 8
FULL_DISK = 28  # exit code of a worker, as ENOSPC


class Generator(NamedTuple):
    """A renderer of scenes and the version of its frames.

    Raise ``version`` whenever the frames change: stored results name their frames by it. The golden frames of
    ``tests/simulation/golden`` fail if the frames change and the version does not.
    """

    name: str  # of the data set
    version: int  # of its frames
    # package.module.function of (split, index, (height, width), views) -> Views, the frames of scene index
    renderer: str
    # by (height, width), a suffix of the folder's name: results stored before versions existed know their
    # frames by it
    digests: Mapping[tuple[int, int], str]
    depth_step: float = DEPTH_STEP  # stored depth is a multiple of this [m]
    # keywords for the renderer: detail, near, down, plain, focal; their order is that of the folder's name
    options: Mapping[str, Any] = MappingProxyType({})

    @property
    def farthest(self) -> int:
        """The farthest depth that a stored frame holds, in whole meters."""
        return int(65535 * self.depth_step)

    def folder_name(self, size: tuple[int, int]) -> str:
        """Name of the folder that holds the frames of ``(height, width)`` [px]."""
        options = dict(self.options)
        focal = options.pop("focal", None)
        words = [name if value is True else f"{name}{value:g}" for name, value in options.items()]
        name = f"{'-'.join([self.name, *words])}-v{self.version}-{size[0]}x{size[1]}"
        if focal is not None:
            return f"{name}-focal-{focal[0]:g}-{focal[1]:g}"
        digest = self.digests.get(size)
        return f"{name}-{digest}" if digest else name


def encode_depth(depth: np.ndarray, depth_step: float = DEPTH_STEP) -> np.ndarray:
    """Depth [m] as uint16 steps of ``depth_step``, 0 where it is unknown or does not fit."""
    steps = np.rint(np.asarray(depth, dtype=np.float64) / depth_step)
    return np.where((steps > 0) & (steps < 65536), steps, 0).astype(np.uint16)


class SceneStore:
    """The rendered frames of one split: view ``i % 8`` of scene ``i // 8`` in slot ``i``.

    They lie in ``<folder>/<split>.frames``, which has room for ``scenes`` scenes of ``(height, width)`` [px].
    """

    def __init__(self, folder: Path, name: str, split: str, scenes: int, size: tuple[int, int]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name, self.split, self.scenes, self.size = name, split, scenes, size
        self.folder = folder
        path = folder / f"{split}.frames"
        self.frames = FrameStore(path, scenes * VIEWS, slot_size(7 * size[0] * size[1]))

    def frame(self, index: int) -> Frame | None:
        """Return a stored frame; None if it is missing or damaged."""
        name = frame_name(self.name, self.split, index)
        return self.frames.get(index, make_stamp(name), name)

    def has(self, scene: int) -> bool:
        """Whether every frame of a scene is stored and whole."""
        return all(self.frame(scene * VIEWS + view) is not None for view in range(VIEWS))

    def render(self, generator: Generator, scene: int) -> None:
        """Render and store one scene, unless it is there."""
        if self.has(scene):
            return
        with writing(self.folder, "a rendered frame"):
            self._render(generator, scene)

    def _render(self, generator: Generator, scene: int) -> None:
        module, _, function = generator.renderer.rpartition(".")
        render = getattr(import_module(module), function)
        views = render(self.split, scene, self.size, VIEWS, **generator.options)
        step = generator.depth_step
        meters = encode_depth(views.depth, step).astype(np.float32) * np.float32(step)
        for view in range(VIEWS):
            index = scene * VIEWS + view
            name = frame_name(self.name, self.split, index)
            frame = Frame(views.image[view], meters[view], views.intrinsics[view], name)
            self.frames.put(index, make_stamp(name), frame)


def frame_name(data: str, split: str, index: int) -> str:
    """Name of frame ``index`` of a split, such as ``rooms/train/000123/4``."""
    return f"{data}/{split}/{index // VIEWS:06d}/{index % VIEWS}"


def render_missing(
    folder: Path, generator: Generator, split: str, scenes: Sequence[int], size: tuple[int, int], workers: int
) -> None:
    """Render scenes into ``folder``, here (``workers=0``) or in worker processes, with a progress bar.

    Raises:
        RuntimeError: a worker process failed.
        DiskError: the disk is full.
    """
    from eldenet.system.progress import open_console, progress_bar

    title = f"rendering {generator.name}/{split} {size[0]} x {size[1]}"
    with progress_bar(open_console(stderr=True), title, len(scenes) * VIEWS, unit="frames") as bar:
        if workers == 0:
            store = SceneStore(folder, generator.name, split, max(scenes) + 1, size)
            for scene in scenes:
                store.render(generator, scene)
                bar.advance(VIEWS)
            return
        # JSON cannot hold the digests, which no renderer needs
        worker = generator._replace(digests={}, options=dict(generator.options))
        job = {"folder": str(folder), "generator": worker._asdict(), "split": split, "size": size}
        shares = [scenes[k::workers] for k in range(min(workers, len(scenes)))]
        _render_in_processes([{**job, "scenes": list(share)} for share in shares], bar.advance)


def _render_in_processes(jobs: Sequence[Mapping[str, object]], advance: Callable[[int], None]) -> None:
    """Run a worker for each job; call ``advance`` with the frames of each rendered scene.

    Plain subprocesses are safe after torch is loaded, and the caller's script needs no ``__main__`` guard.
    """
    package = str(Path(__file__).resolve().parents[2])
    paths = [package, *filter(None, [os.environ.get("PYTHONPATH")])]
    env = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(paths),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    done, report = os.pipe()  # all workers write to it: a line after each scene
    processes = []
    try:
        for job in jobs:
            process = subprocess.Popen(
                [sys.executable, "-m", "eldenet.data.scene_store"],
                stdin=subprocess.PIPE, stdout=report, text=True, env=env,
                start_new_session=True,  # a terminal's Ctrl-C is for this process, which ends them
            )  # fmt: skip
            processes.append(process)
            assert process.stdin is not None
            process.stdin.write(json.dumps(job))
            process.stdin.close()
        os.close(report)
        with os.fdopen(done) as lines:
            for line in lines:
                advance(int(line))
        for process in processes:
            if process.wait() == FULL_DISK:
                raise DiskError(
                    f"no space left on {jobs[0]['folder']}: not all frames were rendered; free some space "
                    "there, or set $ELDENET_CACHE to another folder, and start again"
                )
            if process.wait() != 0:
                raise RuntimeError(
                    f"a render process ended with code {process.returncode}: see its message above"
                )
    finally:
        for process in processes:
            if process.poll() is None:
                process.terminate()
            process.wait()


def _work() -> None:
    """Render the scenes of the job on stdin; after each, print how many frames it has."""
    job = json.load(sys.stdin)
    scenes, generator = job["scenes"], Generator(**job["generator"])
    size = (job["size"][0], job["size"][1])
    store = SceneStore(Path(job["folder"]), generator.name, job["split"], max(scenes) + 1, size)
    for scene in scenes:
        try:
            store.render(generator, scene)
        except DiskError:
            sys.exit(FULL_DISK)
        try:
            sys.stdout.write(f"{VIEWS}\n")
            sys.stdout.flush()
        except BrokenPipeError:  # the caller is gone: stop quietly
            os._exit(1)


if __name__ == "__main__":
    _work()

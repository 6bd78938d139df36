"""What ``rooms``, ``streets`` and ``arenas`` share: frames that are rendered when first used."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from eldenet.data.base import DepthDataset, SampleOptions
from eldenet.data.paths import default_cache
from eldenet.data.scene_store import VIEWS, Generator, SceneStore, frame_name, render_missing
from eldenet.data.splits import SPLITS
from eldenet.simulation.depth_camera import StereoArtifacts
from eldenet.system.checks import one_of
from eldenet.system.digests import digest_of
from eldenet.system.errors import DiskError
from eldenet.system.resources import available_cores
from eldenet.types import Frame


class RenderedScenes(DepthDataset):
    """Rendered scenes with exact depth; each frame is rendered once into a folder and read from there.

    Frame ``i`` of a split is view ``i % 8`` of scene ``i // 8`` (named ``rooms/train/000123/4``) and depends
    on nothing else: a larger ``frames`` keeps the frames that are there and adds to them. The splits hold
    different scenes. The folder is named after the generator's version, so a changed generator never reads
    old frames.

    Args:
        split: "train", "val" or "test".
        frames: how many frames of the split to use.
        size: ``(height, width)`` of the rendered frames [px]; None: ``default_size``.
        root: folder for rendered frames; None for ``$ELDENET_CACHE``, else ``~/.cache/eldenet``.
        workers: processes that render missing frames; None for one per core, 0 renders in this process.
        focal: range of focal lengths [widths], such as ``[0.4, 2.0]`` for networks that take any lens; None:
            those of the data set.
        detail: frames of ``detailed``: closer to real pictures.
        near: of rooms: share of frames of what is close, half of their pixels within 0.3 to 1.2 m.
        down: of rooms: share of frames that look down at the floor and what stands on it.
        plain: of rooms: share of rooms whose surfaces have no pattern.
        depth_camera: depth as a stereo depth camera measures it, with holes at edges, a dead column and noise
            (:class:`~eldenet.simulation.depth_camera.StereoArtifacts`); the same in every epoch.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 0.1 to 10 m unless given, and
            ``max_depth`` at most ``generator.farthest``.

    Raises:
        ValueError: a setting is out of its range, or this data set has no such frames.
        RuntimeError: a render process failed.
        OSError: the folder cannot store the frames.
    """

    ground_truth = "dense"
    depth_range = (0.1, 10.0)
    frame_lists = ("names", "places")
    default_size = (128, 160)  # (height, width) of the frames [px]
    any_lens = True  # whether focal may be given
    generator: Generator  # renders the frames
    detailed: Generator  # renders them with detail; it has its own versions

    def __init__(
        self,
        split: str = "train",
        frames: int = 2048,
        *,
        size: Sequence[int] | None = None,
        root: str | os.PathLike[str] | None = None,
        workers: int | None = None,
        focal: Sequence[float] | None = None,
        detail: bool = False,
        near: float = 0.0,
        down: float = 0.0,
        plain: float = 0.0,
        depth_camera: bool = False,
        **options: Unpack[SampleOptions],
    ) -> None:
        self.artifacts = StereoArtifacts() if depth_camera else None
        shares = {"near": near, "down": down, "plain": plain}
        extra: dict[str, Any] = {name: float(share) for name, share in shares.items() if share}
        given = ", ".join(f"{name}={share:g}" for name, share in extra.items())
        if given and self.generator.name != "rooms":
            raise ValueError(f"{given}: {self.generator.name} has no such frames; rooms has")
        if not (min(shares.values()) >= 0 and near + down <= 1 and plain <= 1):
            raise ValueError(f"{given}: give shares from 0 to 1, near and down together at most 1")
        if focal is not None:
            if not self.any_lens:
                raise ValueError(f"focal={list(focal)}: the camera of {self.generator.name} has one lens")
            if len(focal) != 2 or not 0.2 <= focal[0] <= focal[1] <= 5:
                raise ValueError(f"focal={list(focal)}: give [low, high] in widths, from 0.2 to 5")
            extra["focal"] = (float(focal[0]), float(focal[1]))
        chosen = self.detailed if detail else self.generator
        self.generator = chosen._replace(options={**chosen.options, **extra})
        size = self.default_size if size is None else size
        one_of("split", split, SPLITS)
        if len(size) != 2 or min(size) < 16 or max(size) > 2048:
            raise ValueError(f"size={tuple(size)}: give (height, width), each 16 to 2048 pixels")
        if workers is not None and workers < 0:
            raise ValueError(f"workers={workers}: give a number of processes, 0 for this process, or None")
        super().__init__([frame_name(self.generator.name, split, i) for i in range(frames)], **options)
        if not 0 <= self.min_depth < self.max_depth <= self.generator.farthest:
            raise ValueError(
                f"min_depth={self.min_depth}, max_depth={self.max_depth}: give 0 <= min_depth < max_depth <= "
                f"{self.generator.farthest} [m], the farthest depth that a stored frame can hold"
            )
        self.places = list(range(frames))  # where each frame is stored: a subset leaves gaps
        self.split, self.size = split, (int(size[0]), int(size[1]))
        cache = default_cache() if root is None else Path(root).expanduser()
        self.folder = cache / self.generator.folder_name(self.size)
        try:
            missing = self.missing_scenes(split, frames)
            if missing:
                count = available_cores() if workers is None else workers
                render_missing(self.folder, self.generator, split, missing, self.size, count)
            self.store = self._open(split, frames)
        except DiskError:  # says it already
            raise
        except OSError as error:
            raise type(error)(
                f"{self.folder} cannot store rendered frames ({error.strerror or error}): free some space "
                "there or give another folder ($ELDENET_CACHE or data.root); complete frames are kept"
            ) from error

    def _open(self, split: str, frames: int) -> SceneStore:
        return SceneStore(self.folder, self.generator.name, split, -(-frames // VIEWS), self.size)

    def missing_scenes(self, split: str, frames: int) -> list[int]:
        """Scenes still to be rendered for the first ``frames`` frames of a split of this size and root."""
        store = self._open(split, frames)
        return [scene for scene in range(store.scenes) if not store.has(scene)]

    @property
    def split_hash(self) -> str:
        """Names the split in reports: the frames, their size, depth and the version of their generator."""
        parts = [self.folder.name, *self.names, *(["depth_camera"] if self.artifacts else [])]
        return digest_of("\n".join(parts))[:16]

    def load_frame(self, index: int) -> Frame:
        """Read one frame."""
        frame = self.store.frame(self.places[index])
        if frame is None:
            raise ValueError(f"{self.folder}: {self.names[index]} is damaged: run again to render it again")
        if self.artifacts is None:
            return frame
        assert frame.intrinsics is not None  # rendered frames have them
        rng = np.random.default_rng((self.places[index], SPLITS.index(self.split)))
        dead = self.artifacts.draw_dead(self.size[1], rng)
        sky = frame.depth == 0
        depth = self.artifacts.apply(np.where(sky, 1e3, frame.depth), frame.intrinsics[0, 0], dead, rng)
        return frame._replace(depth=np.where(sky, 0, depth))

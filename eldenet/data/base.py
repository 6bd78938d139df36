"""What every data set shares: frames in, samples out, seeded per sample, split named by a hash."""

import hashlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from pathlib import Path
from typing import TypedDict

import numpy as np
import torch
from torch.utils.data import Dataset

from eldenet.data.cache import FrameStore, open_store
from eldenet.data.paths import check_files, missing_files
from eldenet.geometry import resize_image, resize_intrinsics, resize_sparse
from eldenet.system.checks import one_of
from eldenet.types import DepthSample, Frame

Transform = Callable[[Frame, np.random.Generator], Frame]
SampleKey = int | tuple[int, int]
SPARSE = ("sparse", "improved")
"""Kinds of ground truth that are single points: a resize moves them, and never mixes or multiplies them."""


class SampleOptions(TypedDict, total=False):
    """The keyword arguments that every data set takes and hands on to :class:`DepthDataset`."""

    min_depth: float
    max_depth: float
    input_size: Sequence[int] | None
    transform: Transform | None
    resize_depth: bool
    seed: int
    load_size: Sequence[int] | None
    cache: str
    on_error: str


class DepthDataset(Dataset[DepthSample]):
    """A list of frames with depth. An adapter fills ``names`` and implements :meth:`load_frame`.

    An index may be ``i`` or ``(epoch, i)``: the augmentation of a sample is drawn from
    ``(seed, epoch, i)`` alone, so neither the number of workers nor a resumed run changes it.

    Args:
        names: the frames of this split, in a fixed order.
        min_depth: nearest depth that counts as known [m].
        max_depth: farthest depth that counts as known [m].
        input_size: ``(height, width)`` of the image that leaves the data set [px]; None keeps the frame's.
        transform: augmentation or protocol geometry, ``(frame, generator) -> frame``.
        resize_depth: True brings depth to ``input_size`` too (training); False keeps the ground truth's
            own resolution (evaluation).
        seed: of the augmentation.
        load_size: ``(height, width)`` a frame is resized to as soon as it is read, before the transform [px]:
            an augmentation at the training size costs a tenth of one at the camera's. None keeps the frame's.
        cache: keep the frames once read (and resized): "disk" for this run and later ones, "ram" for this
            run alone, one copy for all workers; or "none". See :mod:`eldenet.data.cache`.
        on_error: "stop" at a frame whose files are missing or cannot be read, or "skip": leave it out of
            ``names`` and list it in ``skipped``. Missing files are found at once, the others by
            :meth:`leave_out_unreadable`, which :func:`eldenet.config.build_split` calls.

    Attributes:
        names: the frames, in order.
        skipped: name -> reason of the frames that were left out.

    Raises:
        ValueError: there are no frames, or a size is none.
    """

    ground_truth = "raw"
    frame_lists: tuple[str, ...] = ("names",)  # the lists that hold one entry per frame
    class_names: tuple[str, ...] = ()  # of the semantic labels, by their number; none where they are not read

    def __init__(
        self,
        names: Sequence[str],
        *,
        min_depth: float,
        max_depth: float,
        input_size: Sequence[int] | None = None,
        transform: Transform | None = None,
        resize_depth: bool = True,
        seed: int = 0,
        load_size: Sequence[int] | None = None,
        cache: str = "none",
        on_error: str = "stop",
    ) -> None:
        if not names:
            raise ValueError(f"{type(self).__name__} found no frames: check root and split")
        one_of("on_error", on_error, ("stop", "skip"))
        one_of("cache", cache, ("none", "ram", "disk"))
        self.on_error = on_error
        self.skipped: dict[str, str] = {}
        self.names = list(names)
        self.min_depth, self.max_depth = min_depth, max_depth
        if input_size is not None and (not isinstance(input_size, Sequence) or len(input_size) != 2):
            raise ValueError(f"input_size={input_size}: give [height, width] in pixels, or null")
        self.input_size = None if input_size is None else (int(input_size[0]), int(input_size[1]))
        self.transform = transform
        self.resize_depth = resize_depth
        self.seed = seed
        self.load_size = None if load_size is None else (int(load_size[0]), int(load_size[1]))
        self.cache = cache
        self._store: FrameStore | None = None

    def load_frame(self, index: int) -> Frame:
        """Read frame ``index`` from disk, decoded to RGB and meters."""
        raise NotImplementedError

    def frame_files(self, index: int) -> Sequence[Path]:
        """The files that frame ``index`` is read from: where one changes, a disk cache reads it again."""
        raise ValueError(
            f"{type(self).__name__} does not say which files a frame is read from, so a disk cache would not "
            "notice when they change: write its frame_files, or take cache=ram"
        )

    def frame_settings(self) -> dict[str, object]:
        """The adapter's own settings that :meth:`load_frame` depends on, as plain values: for a cache."""
        return {}

    def check_frames(self, root: Path, files: Sequence[Sequence[str]]) -> None:
        """Stop at frames whose files are not there, or leave them out; an adapter's constructor ends with it.

        Args:
            root: of the data set.
            files: of every frame, relative to ``root``.

        Raises:
            FileNotFoundError: naming the missing files, where ``on_error`` is "stop".
        """
        every = [file for frame in files for file in frame]
        if self.on_error == "stop":
            check_files(root, every)
            return
        missing = set(missing_files(root, every))
        reasons = {i: [str(root / f) for f in frame if f in missing] for i, frame in enumerate(files)}
        self.leave_out({i: f"missing: {', '.join(lost)}" for i, lost in reasons.items() if lost})

    def leave_out(self, reasons: Mapping[int, str]) -> None:
        """Drop the frames of these indices and remember why.

        Raises:
            ValueError: no frame would be left.
        """
        if not reasons:
            return
        self.skipped |= {self.names[index]: reason for index, reason in reasons.items()}
        if len(reasons) == len(self):
            some = "; ".join(list(reasons.values())[:3])
            raise ValueError(f"all {len(self)} frames were left out, such as: {some}")
        self._keep([index for index in range(len(self)) if index not in reasons])

    def draw_subset(self, places: int | Sequence[int], seed: int) -> None:
        """Keep a draw of the frames, in their order: the same ones on every machine.

        Args:
            places: how many, or ``(first, end)``: these places of the frames shuffled by ``seed``. Ranges
                that do not overlap share no frame.
            seed: of the draw.

        Raises:
            ValueError: there are fewer.
        """
        span = [0, places] if isinstance(places, int) else list(places)
        if len(span) != 2 or not 0 <= span[0] < span[1] <= len(self):
            raise ValueError(
                f"subset={places}: {type(self).__name__} found {len(self)} frames in this split, give 1 to "
                f"{len(self)}, a range [first, end] within 0 to {len(self)}, or null"
            )
        self._keep(sorted(np.random.default_rng(seed).permutation(len(self))[slice(*span)].tolist()))

    def _keep(self, indices: Sequence[int]) -> None:
        for name in self.frame_lists:
            entries = getattr(self, name)
            setattr(self, name, [entries[index] for index in indices])
        self._store = None

    def leave_out_unreadable(self) -> None:
        """Read every frame once and leave out those that cannot be read."""
        reasons = {}
        for index in range(len(self)):
            try:
                self.load_frame(index)
            except (ValueError, OSError) as error:
                reasons[index] = str(error)
        self.leave_out(reasons)

    @property
    def split_hash(self) -> str:
        """First 16 hex digits of the SHA-256 over the frame names in order: names the split in reports."""
        return hashlib.sha256("\n".join(self.names).encode()).hexdigest()[:16]

    def size_group(self, index: int) -> Hashable:
        """Frames of one group have one size, which a cache makes room for; by default all are of one."""
        return None

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, key: SampleKey) -> DepthSample:
        epoch, index = key if isinstance(key, tuple) else (0, key)
        frame = self._ready_frame(index)
        if self.transform is not None:
            frame = self.transform(frame, np.random.default_rng((self.seed, epoch, index)))
        if self.input_size is not None:
            frame = self._resized(frame, self.input_size)
        return to_sample(frame, self.min_depth, self.max_depth)

    def open_cache(self) -> None:
        """Open the frame cache, if there is to be one: once, before worker processes that shall share it.

        Raises:
            ValueError: cache=ram and too little memory, or cache=disk and no ``frame_files``.
        """
        if self.cache != "none" and self._store is None:
            self._store = open_store(self)
            if self._store is None:
                self.cache = "none"

    def _ready_frame(self, index: int) -> Frame:
        self.open_cache()
        if self._store is None:
            return self.read_ready(index)
        return self._store.frame(index, self.names[index], self.frame_files, self.read_ready)

    def read_ready(self, index: int) -> Frame:
        """Frame ``index`` read from its files and brought to ``load_size``; what a cache keeps."""
        frame = self.load_frame(index)
        return frame if self.load_size is None else self._resized(frame, self.load_size)

    def _resized(self, frame: Frame, size: tuple[int, int]) -> Frame:
        sparse = self.ground_truth in SPARSE
        return resize_frame(frame, size, resize_depth=self.resize_depth, sparse=sparse)


def resize_frame(
    frame: Frame, size: tuple[int, int], *, resize_depth: bool = True, sparse: bool = False
) -> Frame:
    """Resize image (area or bilinear) and, if asked, depth (nearest: meters of two surfaces do not mix).

    Sparse depth keeps its points instead (:func:`~eldenet.geometry.resize_sparse`): nearest would lose most.
    """
    import cv2

    image, depth, intrinsics, name, labels = frame
    if image.shape[:2] != size:
        if intrinsics is not None:
            intrinsics = resize_intrinsics(intrinsics, (image.shape[0], image.shape[1]), size)
        image = resize_image(image, size)
    if resize_depth and depth.shape != size:
        if labels is not None:
            labels = cv2.resize(labels, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        if sparse:
            depth = resize_sparse(depth, size)
        else:
            depth = cv2.resize(depth, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    return Frame(image, depth, intrinsics, name, labels)


def to_sample(frame: Frame, min_depth: float, max_depth: float) -> DepthSample:
    """Turn a camera frame into tensors; depth outside the range is unknown from here on."""
    known = np.isfinite(frame.depth) & (frame.depth >= min_depth) & (frame.depth <= max_depth)
    depth = np.where(known, frame.depth, 0.0).astype(np.float32)
    intrinsics = np.zeros((3, 3)) if frame.intrinsics is None else frame.intrinsics
    sample: DepthSample = {
        "image": torch.from_numpy(np.ascontiguousarray(frame.image.transpose(2, 0, 1))).float().div_(255.0),
        "depth": torch.from_numpy(depth)[None],
        "mask": torch.from_numpy(known)[None],
        "intrinsics": torch.from_numpy(np.array(intrinsics, dtype=np.float32)),
        "name": frame.name,
    }
    if frame.labels is not None:
        sample["labels"] = torch.from_numpy(np.ascontiguousarray(frame.labels))[None]
    return sample


class Chain:
    """Several transforms one after the other, drawing from one generator."""

    def __init__(self, steps: Sequence[Transform]) -> None:
        self.steps = list(steps)

    def __call__(self, frame: Frame, generator: np.random.Generator) -> Frame:
        """Apply every step."""
        for step in self.steps:
            frame = step(frame, generator)
        return frame

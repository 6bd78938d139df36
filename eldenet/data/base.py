"""The base classes of all data sets: frames in, samples out, seeded per sample."""

from collections.abc import Callable, Hashable, Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any, Self, TypedDict, Unpack, cast

import numpy as np
import torch
from torch.utils.data import Dataset

from eldenet.data.cache import FrameCache, open_cache
from eldenet.data.paths import check_files, missing_files
from eldenet.geometry import (
    check_intrinsics,
    crop_intrinsics,
    resize_image,
    resize_intrinsics,
    resize_sparse,
    size_of_aspect,
)
from eldenet.system.checks import check_size, one_of
from eldenet.system.digests import digest_of
from eldenet.types import DepthSample, Frame

Transform = Callable[[Frame, np.random.Generator], Frame]
SampleKey = int | tuple[int, int] | tuple[int, int, float]
Size = tuple[int, int]
MakeSample = Callable[[Any, Frame, np.random.Generator, Size | None], DepthSample]
SPARSE = ("sparse", "improved")
"""Kinds of ground truth that consist of single points: a resize moves each one and never mixes two."""


class SampleOptions(TypedDict, total=False):
    """The keyword arguments that every data set passes on to :class:`DepthDataset`."""

    min_depth: float
    max_depth: float
    input_size: Sequence[int] | None
    transform: Transform | None
    resize_depth: bool
    seed: int
    resize_on_load: Sequence[int] | None
    cache: str
    on_error: str


class DepthDataset(Dataset[DepthSample]):
    """A list of frames with depth. An adapter passes ``names`` and implements :meth:`load_frame`.

    An index is ``i`` or ``(epoch, i)``: the augmentation of a sample is drawn from ``(seed, epoch, i)``
    alone, so neither the number of workers nor a resumed run changes it. ``(epoch, i, aspect)`` shows a part
    of the frame whose width is ``aspect`` times its height, as large as the frame allows, at the size that
    :func:`~eldenet.geometry.size_of_aspect` gives it.

    Args:
        names: the frames of this split, in a fixed order.
        min_depth: nearest depth that counts as known [m]; None for the adapter's usual one.
        max_depth: farthest depth that counts as known [m]; None for the adapter's usual one.
        input_size: ``(height, width)`` of a sample's image [px]; None keeps the frame's.
        transform: augmentation or protocol geometry, ``(frame, generator) -> frame``.
        resize_depth: True resizes depth to ``input_size`` too (training); False keeps the ground truth's own
            resolution (evaluation).
        seed: of the augmentation.
        resize_on_load: ``(height, width)`` to which a frame is resized as soon as it is read, before the
            transform [px]: augmenting at the training size costs a tenth of augmenting at the camera's. None
            keeps the frame's.
        cache: "disk" keeps frames once they are read (and resized), for this run and later ones; or "none".
            See :mod:`eldenet.data.cache`.
        on_error: what to do about a frame whose files are missing or cannot be read: "stop", or "skip", which
            leaves it out of ``names`` and lists it in ``skipped``. Missing files are found at once, the
            others by :meth:`leave_out_unreadable`, which :func:`eldenet.evaluation.splits.open_split` calls.

    Attributes:
        names: the frames, in order.
        skipped: name -> reason of the frames that were left out.
        stretch: not None: images keep their frame's shape, with widths times this, and ``input_size`` is for
            their number of pixels (:func:`~eldenet.geometry.size_of_aspect`).

    Raises:
        ValueError: there are no frames, or an argument is out of its range.
    """

    # kind of depth, which a protocol must accept: raw, inpainted, dense, sparse, improved
    ground_truth = "raw"
    depth_range: tuple[float | None, float | None] = (None, None)  # usual min_depth and max_depth [m]
    frame_lists: tuple[str, ...] = ("names",)  # the lists that hold one entry per frame
    make_sample: MakeSample | None = None  # set by with_samples
    stretch: float | None = None
    class_names: tuple[str, ...] = ()  # of the semantic labels, by number; empty if none are read

    def __init__(
        self,
        names: Sequence[str],
        *,
        min_depth: float | None = None,
        max_depth: float | None = None,
        input_size: Sequence[int] | None = None,
        transform: Transform | None = None,
        resize_depth: bool = True,
        seed: int = 0,
        resize_on_load: Sequence[int] | None = None,
        cache: str = "none",
        on_error: str = "stop",
    ) -> None:
        if not names:
            raise ValueError(f"{type(self).__name__} found no frames: check data.root and the split")
        one_of("on_error", on_error, ("stop", "skip"))
        one_of("cache", cache, ("none", "disk"))
        nearest = self.depth_range[0] if min_depth is None else min_depth
        farthest = self.depth_range[1] if max_depth is None else max_depth
        if nearest is None or farthest is None:
            raise ValueError("min_depth or max_depth is missing: give the range of known depth [m]")
        self.min_depth, self.max_depth = nearest, farthest
        self.names = list(names)
        self.skipped: dict[str, str] = {}
        self.input_size = check_size("input_size", input_size)
        self.resize_on_load = check_size("resize_on_load", resize_on_load)
        self.transform, self.seed, self.resize_depth = transform, seed, resize_depth
        self.cache, self.on_error = cache, on_error
        self._cache: FrameCache | None = None

    def load_frame(self, index: int) -> Frame:
        """Read frame ``index`` from disk, decoded to RGB and meters."""
        raise NotImplementedError

    def read_frame(self, index: int) -> Frame:
        """Read frame ``index`` from disk and check that its intrinsics are those of a camera.

        Raises:
            ValueError: a file is damaged, or no camera with pictures of this size has such intrinsics.
        """
        frame = self.load_frame(index)
        if frame.intrinsics is not None:
            try:
                height, width = frame.image.shape[:2]
                check_intrinsics(frame.intrinsics, (height, width), inside=False)
            except ValueError as error:
                raise ValueError(f"{frame.name}: {error}") from error
        return frame

    def frame_files(self, index: int) -> Sequence[Path]:
        """Return the files that frame ``index`` is read from; a disk cache watches them for changes."""
        raise ValueError(
            f"{type(self).__name__} has no frame_files method, so a disk cache cannot notice when files "
            "change: add one, or set cache=none"
        )

    def frame_settings(self) -> dict[str, object]:
        """Return the adapter's settings that :meth:`load_frame` depends on, as plain values for a cache."""
        return {}

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

    def leave_out_unreadable(self) -> None:
        """Read every frame once and leave out those that cannot be read."""
        reasons = {}
        for index in range(len(self)):
            try:
                self.read_frame(index)
            except (ValueError, OSError) as error:
                reasons[index] = str(error)
        self.leave_out(reasons)

    def draw_subset(self, places: int | Sequence[int], seed: int) -> None:
        """Keep a random subset of the frames, in their order: the same one on every machine.

        Args:
            places: how many, or ``(first, end)``: this range of the frames shuffled by ``seed``. Ranges that
                do not overlap share no frame.
            seed: of the shuffle.

        Raises:
            ValueError: there are fewer frames.
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
        self._cache = None

    @property
    def split_hash(self) -> str:
        """First 16 hex digits of the SHA-256 over the frame names in order; names the split in reports."""
        return digest_of("\n".join(self.names))[:16]

    def size_group(self, index: int) -> Hashable:
        """Return a key that frames of one size share, for a cache's slots; by default all have one size."""
        return None

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, key: SampleKey) -> DepthSample:
        epoch, index, *aspect = key if isinstance(key, tuple) else (0, key)
        self.open_cache()
        if self._cache is None:
            frame = self.read_ready(index)
        else:
            frame = self._cache.frame(index, self.names[index], self.frame_files, self.read_ready)
        generator, size = np.random.default_rng((self.seed, epoch, index)), self.input_size
        if aspect and size is not None:
            frame, size = cut_to_aspect(frame, aspect[0], generator), size_of_aspect(size, (1.0, aspect[0]))
        if self.make_sample is not None:
            return self.make_sample(self, frame, generator, size)
        if self.transform is not None:
            frame = self.transform(frame, generator)
        if size is not None:
            if self.stretch is not None:
                height, width = frame.image.shape[:2]
                size = size_of_aspect(size, (height, width * self.stretch))
            frame = self.resized(frame, size)
        return to_sample(frame, self.min_depth, self.max_depth)

    def with_samples(self, make_sample: MakeSample) -> Self:
        """Return the same data set; ``make_sample(dataset, frame, generator, size)`` makes its samples."""
        other = copy(self)
        other.make_sample = make_sample
        return other

    def open_cache(self) -> None:
        """Open the frame cache, if ``cache`` asks for one; call it before starting workers that share it.

        Raises:
            ValueError: the data set has no ``frame_files``.
        """
        if self.cache != "none" and self._cache is None:
            self._cache = open_cache(self)
            if self._cache is None:
                self.cache = "none"

    def read_ready(self, index: int) -> Frame:
        """Read frame ``index`` from its files and resize it to ``resize_on_load``: what a cache stores."""
        frame = self.read_frame(index)
        return frame if self.resize_on_load is None else self.resized(frame, self.resize_on_load)

    def resized(self, frame: Frame, size: tuple[int, int]) -> Frame:
        """Resize a frame to ``(height, width)`` [px] as its ground truth needs it."""
        sparse = self.ground_truth in SPARSE
        return resize_frame(frame, size, resize_depth=self.resize_depth, sparse=sparse)


class FileDataset(DepthDataset):
    """Frames of a few files each, such as a picture and a depth map.

    Args:
        root: of the data set.
        names: of the frames.
        files: of each frame, relative to ``root``.
        **options: see :class:`DepthDataset`.

    Raises:
        FileNotFoundError: files are missing, and ``on_error`` is "stop".
        ValueError: there are no frames, or a split, setting, list or file name of the data set is wrong.
    """

    frame_lists: tuple[str, ...] = ("names", "files")
    where_files_are = ""  # added to the error about missing files

    def __init__(
        self,
        root: Path,
        names: Sequence[str],
        files: Sequence[Sequence[str]],
        **options: Unpack[SampleOptions],
    ) -> None:
        super().__init__(names, **options)
        self.root, self.files = root, list(files)
        every = [file for frame in files for file in frame]
        if self.on_error == "stop":
            check_files(root, every, self.where_files_are)
            return
        missing = set(missing_files(root, every))
        reasons = {i: [str(root / f) for f in frame if f in missing] for i, frame in enumerate(files)}
        self.leave_out(
            {i: f"missing: {', '.join(lost)}{self.where_files_are}" for i, lost in reasons.items() if lost}
        )

    def frame_files(self, index: int) -> Sequence[Path]:
        """Return every file of the frame."""
        return [self.root / file for file in self.files[index]]


def check_pair(one: tuple[int, ...], file: Path, other: tuple[int, ...], other_file: Path) -> None:
    """Raise ``ValueError`` if two files of a frame, of shapes ``(height, width, ...)``, differ in size."""
    if one[:2] != other[:2]:
        hint = ""
        if one[:2] == other[1::-1]:  # a phone's portrait
            hint = ", and EXIF does not turn pictures here: store them upright (mogrify -auto-orient)"
        raise ValueError(
            f"{file} is {one[0]}x{one[1]}, {other_file} is {other[0]}x{other[1]} (height x "
            f"width): the files of a frame must have one size{hint}"
        )


def resize_frame(
    frame: Frame, size: tuple[int, int], *, resize_depth: bool = True, sparse: bool = False, area: bool = True
) -> Frame:
    """Resize the image and, if asked, depth and labels (nearest, so that no two surfaces mix).

    Sparse depth keeps its points (:func:`~eldenet.geometry.resize_sparse`); nearest would lose most of them.

    Args:
        frame: to resize.
        size: ``(height, width)`` [px].
        resize_depth: whether depth and labels are resized too.
        sparse: whether depth consists of single points.
        area: shrink the image by averaging areas; False takes bilinear interpolation for that too.
    """
    import cv2

    image, depth, intrinsics, name, labels = frame
    if image.shape[:2] != size:
        if intrinsics is not None:
            intrinsics = resize_intrinsics(intrinsics, (image.shape[0], image.shape[1]), size)
        image = resize_image(image, size, area=area)
    if resize_depth and depth.shape != size:
        if labels is not None:
            labels = cv2.resize(labels, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
        if sparse:
            depth = resize_sparse(depth, size)
        else:
            depth = cv2.resize(depth, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    return Frame(image, depth, intrinsics, name, labels)


def cut_frame(frame: Frame, top: int, bottom: int, left: int, right: int) -> Frame:
    """Cut a box [px] out of a frame, ends excluded; the intrinsics move with it."""
    image, depth, intrinsics, name, labels = frame
    window = slice(top, bottom), slice(left, right)
    if intrinsics is not None:
        intrinsics = crop_intrinsics(intrinsics, top, left)
    return Frame(image[window], depth[window], intrinsics, name, None if labels is None else labels[window])


def cut_to_aspect(frame: Frame, aspect: float, generator: np.random.Generator) -> Frame:
    """Cut the largest part of width / height ``aspect`` out of a frame, anywhere in it."""
    height, width = frame.depth.shape
    rows, cols = min(height, round(width / aspect)), min(width, round(height * aspect))
    top, left = (int(generator.integers(side + 1)) for side in (height - rows, width - cols))
    return cut_frame(frame, top, top + rows, left, left + cols)


def frame_tensors(frame: Frame) -> dict[str, Any]:
    """Return a frame as tensors: image ``(3, H, W)`` uint8, depth and labels ``(1, H, W)``, intrinsics."""
    intrinsics = np.zeros((3, 3)) if frame.intrinsics is None else frame.intrinsics
    tensors: dict[str, Any] = {
        "image": torch.from_numpy(np.ascontiguousarray(frame.image.transpose(2, 0, 1))),
        "depth": torch.from_numpy(np.ascontiguousarray(frame.depth))[None],
        "intrinsics": torch.from_numpy(np.array(intrinsics, dtype=np.float32)),
        "name": frame.name,
    }
    if frame.labels is not None:
        tensors["labels"] = torch.from_numpy(np.ascontiguousarray(frame.labels))[None]
    return tensors


def to_sample(frame: Frame, min_depth: float, max_depth: float) -> DepthSample:
    """Turn a frame into a sample; depth outside the range becomes unknown."""
    known = np.isfinite(frame.depth) & (frame.depth >= min_depth) & (frame.depth <= max_depth)
    sample = frame_tensors(frame._replace(depth=np.where(known, frame.depth, 0.0).astype(np.float32)))
    sample |= {"image": sample["image"].float().div_(255.0), "mask": torch.from_numpy(known)[None]}
    return cast(DepthSample, sample)


class Compose:
    """Several transforms one after the other, which draw from one generator."""

    def __init__(self, steps: Sequence[Transform]) -> None:
        self.steps = list(steps)

    def __call__(self, frame: Frame, generator: np.random.Generator) -> Frame:
        """Apply every step."""
        for step in self.steps:
            frame = step(frame, generator)
        return frame

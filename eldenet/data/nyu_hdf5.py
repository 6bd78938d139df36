"""NYU Depth V2 in its HDF5 layouts: a file per frame (sparse-to-dense, FastDepth), and the labeled .mat."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from eldenet.data.array_files import check_pixels
from eldenet.data.base import DepthDataset, FileDataset, SampleOptions
from eldenet.data.io import decode_depth
from eldenet.data.nyu import NYU_RANGE, nyu_intrinsics
from eldenet.data.nyu_scenes import labeled_part
from eldenet.data.paths import find_root
from eldenet.data.splits import hold_out
from eldenet.system.checks import one_of
from eldenet.system.errors import reading
from eldenet.system.extras import require
from eldenet.types import Frame

HDF5_TREE = """
train/<scene>/00001.h5 ...     (47,584 frames)      keys: rgb (3, 480, 640) uint8, depth (480, 640) float32 m
val/official/00001.h5 ...      (654 frames)
"""
MOST_CHUNKS = 65536  # of an array: one of 100 million pixels has fewer, unless they are tiny
MOST_NUMBERS = 1_000_000  # of frames, in a list of them
MAT_TREE = """
nyu_depth_v2_labeled.mat       (1,449 frames, 2.8 GB, MATLAB 7.3 = HDF5)
splits.mat                     (the official split: trainNdxs, testNdxs)
"""


class NYUHDF5(FileDataset):
    """One HDF5 file per frame, as sparse-to-dense and FastDepth share it; depth is in-painted.

    Ma and Karaman, "Sparse-to-Dense", ICRA 2018: depth is projected into the color picture and in-painted
    with the official toolbox's cross-bilateral filter.

    Convention: there, ``val/official`` (the 654 official test frames) also chooses the best epoch. Here it is
    "test" and nothing else, and "val" is held out of the training frames.

    Args:
        root: the folder with ``train`` and ``val``; None for ``$ELDENET_DATA/nyudepthv2``.
        split: "train" and "val", parts of ``train`` that share no scene
            (:func:`~eldenet.data.splits.hold_out`), "trainval" for both, or "test" for ``val/official``.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: there is no such folder.
        ValueError: the split is unknown; on reading: a file is truncated, or a key is missing.
    """

    ground_truth = "inpainted"
    depth_range = NYU_RANGE

    def __init__(
        self, root: str | Path | None = None, *, split: str = "train", **options: Unpack[SampleOptions]
    ) -> None:
        one_of("split", split, ("train", "val", "trainval", "test"))
        part, scenes = ("val", "official") if split == "test" else ("train", "*")
        folder = find_root(root, "nyudepthv2", [part], HDF5_TREE)
        files = sorted(path.relative_to(folder) for path in (folder / part).glob(f"{scenes}/*.h5"))
        names = [file.with_suffix("").as_posix() for file in files]
        names = [names[i] for i in hold_out(names, split)]
        super().__init__(folder, names, [(f"{name}.h5",) for name in names], **options)

    def load_frame(self, index: int) -> Frame:
        """Read one file."""
        (path,) = self.frame_files(index)
        with open_hdf5(path) as file:
            image, depth = (_read(_take(file, key, path), (), path) for key in ("rgb", "depth"))
        if depth.ndim != 2 or image.shape != (3, *depth.shape) or image.dtype != np.uint8:
            raise ValueError(
                f"{path}: rgb is {image.shape} {image.dtype} and depth {depth.shape}, expected (3, H, W) "
                "uint8 and (H, W)"
            )
        return _frame(image.transpose(1, 2, 0), depth, path, self.names[index])


class NYUMat(DepthDataset):
    """The original ``nyu_depth_v2_labeled.mat``.

    Convention: MATLAB writes the axes in reverse, so images come as ``(N, 3, 640, 480)`` and depth as
    ``(N, 640, 480)``; frame numbers, here and in ``splits.mat``, start at 1.

    Args:
        root: the folder with the files; None for ``$ELDENET_DATA/nyu_depth_v2/labeled``.
        split: "train" and "val", our parts of the 795 official training frames, which share no scene
            (``VAL_FRAMES`` in ``nyu_scenes.py``), "trainval" for the 795, "test" for the 654, or "all", which
            needs no ``splits.mat``.
        ground_truth: "inpainted" for ``depths``, "raw" for ``rawDepths`` with its holes.
        file: name of the .mat.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: the split or ground truth is unknown, or the .mat lacks it or has too few frames.
    """

    depth_range = NYU_RANGE
    frame_lists = ("names", "numbers")

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        split: str = "train",
        ground_truth: str = "inpainted",
        file: str = "nyu_depth_v2_labeled.mat",
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "trainval", "test", "all"))
        one_of("ground_truth", ground_truth, ("raw", "inpainted"))
        needed = [file] if split == "all" else [file, "splits.mat"]
        folder = find_root(root, "nyu_depth_v2/labeled", needed, MAT_TREE)
        self.path, self.ground_truth = folder / file, ground_truth
        self.depth_key = {"raw": "rawDepths", "inpainted": "depths"}[ground_truth]
        with open_hdf5(self.path) as mat:
            count = _mat_frames(mat, self.path, self.depth_key)
        self.numbers: Sequence[int] = range(1, count + 1)
        if split != "all":
            self.numbers = _split_numbers(folder / "splits.mat", split)
        if max(self.numbers, default=0) > count:
            raise ValueError(
                f"{self.path} has {count} frames, not {max(self.numbers)} as {split!r} needs: fetch it again"
            )
        super().__init__([f"{number:04d}" for number in self.numbers], **options)

    def frame_files(self, index: int) -> Sequence[Path]:
        """Return the .mat file."""
        return [self.path]

    def frame_settings(self) -> dict[str, object]:
        """Return which depth is read."""
        return {"depth": self.depth_key}

    def load_frame(self, index: int) -> Frame:
        """Read one frame."""
        at = self.numbers[index] - 1
        source = f"{self.path}, frame {at + 1}"
        with open_hdf5(self.path) as mat:
            image, depth = (
                _read(_take(mat, key, source), at, source).T for key in ("images", self.depth_key)
            )
        return _frame(image, depth, source, self.names[index])


def _frame(image: np.ndarray, depth: np.ndarray, source: object, name: str) -> Frame:
    depth = decode_depth(np.ascontiguousarray(depth), "meters", source)
    return Frame(np.ascontiguousarray(image), depth, nyu_intrinsics((depth.shape[0], depth.shape[1])), name)


def open_hdf5(path: Path) -> Any:
    """Open an HDF5 file.

    Raises:
        FileNotFoundError: there is no such file.
        ImportError: h5py is not installed.
        ValueError: the file is truncated or not an HDF5 file.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist: check root, or fetch the file again")
    require("reading NYU's HDF5 files", "h5py")
    import h5py

    with reading(path, "HDF5 file"):
        return h5py.File(path, "r")


def _take(file: Any, key: str, source: object) -> Any:
    """Return the array of that key in an open file, not yet read; it must lie in the file itself."""
    import h5py

    with reading(source, "HDF5 file"):
        keys = sorted(file)
        elsewhere = key in keys and not isinstance(file.get(key, getlink=True), h5py.HardLink)
        found = file[key] if key in keys and not elsewhere else None
        if getattr(found, "external", None) or getattr(found, "is_virtual", False):
            elsewhere = True
    if elsewhere:
        raise ValueError(
            f"{source}: {key!r} is a link or lies in another file, which eldenet does not follow: store "
            "the array in the file itself"
        )
    if found is None:
        raise ValueError(f"{source} has no {key!r}, only {', '.join(keys)}: is it the right file?")
    if not hasattr(found, "shape"):
        raise ValueError(f"{source}: {key!r} is a group, not an array: is it the right file?")
    return found


def _read(dataset: Any, part: int | tuple[()], source: object) -> np.ndarray:
    """Read an array, or frame ``part`` of it, unless its size or its chunks' size or number are too large."""
    shape, chunks = dataset.shape, dataset.chunks or dataset.shape
    check_pixels(chunks, source)
    if part != ():
        shape, chunks = shape[1:], chunks[1:]
    check_pixels(shape, source)
    count = math.prod(-(-side // step) for side, step in zip(shape, chunks, strict=True))
    if count > MOST_CHUNKS:
        raise ValueError(f"{source}: its array lies in {count} chunks: store it in {MOST_CHUNKS} at most")
    with reading(source, "HDF5 file"):
        return np.asarray(dataset[part])


def _mat_frames(mat: Any, path: Path, depth_key: str) -> int:
    images, depths = _take(mat, "images", path), _take(mat, depth_key, path)
    fit = images.ndim == 4 and images.shape[1] == 3 and images.dtype == np.uint8
    if not fit or depths.shape != (images.shape[0], *images.shape[2:]):
        raise ValueError(
            f"{path}: images {images.shape} {images.dtype} and {depth_key} {depths.shape}, expected "
            "(N, 3, 640, 480) uint8 and (N, 640, 480)"
        )
    return int(images.shape[0])


def _split_numbers(path: Path, split: str) -> Sequence[int]:
    """Return the frame numbers, from 1, of a part of the official split."""
    from scipy.io import loadmat, whosmat

    names = ("trainNdxs", "testNdxs")
    with reading(path, "official split with trainNdxs and testNdxs"):
        for name, shape, kind in whosmat(path):
            if name in names and (math.prod(shape) > MOST_NUMBERS or kind in ("cell", "struct", "object")):
                raise ValueError(f"{name} is a {kind} of {shape}, not a list of numbers")
        found = loadmat(path, variable_names=names)
        parts = {key: [int(number) for number in found[key].ravel()] for key in names}
    every = parts["trainNdxs"] + parts["testNdxs"]
    if not every or min(every) < 1 or len(set(every)) < len(every):
        raise ValueError(f"{path}: its frame numbers must start at 1 and not repeat: fetch it again")
    numbers = parts["testNdxs" if split == "test" else "trainNdxs"]
    if split in ("train", "val"):
        numbers = [n for n in numbers if (labeled_part(n) == "val") == (split == "val")]
    return numbers

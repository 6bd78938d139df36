"""NYU Depth V2 in the layouts in use, one class per layout.

Silberman et al., "Indoor Segmentation and Support Inference from RGBD Images", ECCV 2012. The official split
is 795 training and 654 test frames of the 1,449 labeled ones. Which ground truth a test uses (in-painted
``depths`` or ``rawDepths`` with holes) changes every number, so each class states it in ``ground_truth``.
"""

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Unpack

import numpy as np

from eldenet.data.base import FileDataset, SampleOptions, check_pair
from eldenet.data.io import Encoding, depth_encoding, read_depth, read_image
from eldenet.data.nyu_scenes import labeled_part
from eldenet.data.paths import check_inside, csv_pairs, find_root
from eldenet.data.splits import hold_out
from eldenet.geometry import pinhole, resize_intrinsics
from eldenet.system.checks import one_of
from eldenet.system.files import read_text
from eldenet.types import Frame

NYU_SIZE = (480, 640)
NYU_FOCAL = 518.8579
NYU_RANGE = (1e-3, 10.0)  # [m], of the field's tables

LABELED_SPLITS = {"all": ("fit", "dev", "val"), "train": ("fit", "dev")}
LABELED_SPLITS |= {part: (part,) for part in ("val", "fit", "dev")}


def nyu_intrinsics(size: tuple[int, int] = NYU_SIZE) -> np.ndarray:
    """Return the intrinsics ``(3, 3)`` [px] of the color camera for a picture of ``(height, width)``."""
    return resize_intrinsics(pinhole(NYU_FOCAL, 519.4696, 325.5824, 253.7362), NYU_SIZE, size)


class _NYUPairs(FileDataset):
    """Frames of one picture and one depth file each; ``split`` "train" and "val" share no scene."""

    depth_range = NYU_RANGE

    def __init__(
        self,
        root: Path,
        pairs: Sequence[tuple[str, str]],
        split: str,
        encoding: Encoding,
        prefix: str = "",  # of pictures, which is left out of the frames' names
        **options: Unpack[SampleOptions],
    ) -> None:
        self.encoding = depth_encoding(encoding)
        names = [image.removeprefix(prefix).rsplit(".", 1)[0] for image, _ in pairs]
        chosen = hold_out(names, split)
        super().__init__(root, [names[i] for i in chosen], [pairs[i] for i in chosen], **options)

    def frame_settings(self) -> dict[str, object]:
        """Return the encoding."""
        return {"encoding": self.encoding.description}

    def load_frame(self, index: int) -> Frame:
        """Read one picture and its depth."""
        image_file, depth_file = self.frame_files(index)
        image, depth = read_image(image_file, gray=False), read_depth(depth_file, self.encoding)
        check_pair(image.shape, image_file, depth.shape, depth_file)
        return Frame(image, depth, nyu_intrinsics((image.shape[0], image.shape[1])), self.names[index])


DENSEDEPTH_TREE = """
data/nyu2_train.csv      no header: data/nyu2_train/<scene>_out/1.jpg,data/nyu2_train/<scene>_out/1.png
data/nyu2_train/<scene>_out/1.jpg, 1.png                            (color, depth)
data/nyu2_test.csv, data/nyu2_test/00000_colors.png, 00000_depth.png
"""


class NYUDenseDepth(_NYUPairs):
    """DenseDepth's zip (also on Kaggle): a CSV of pairs, in-painted depth.

    Convention: training depth is 8 bits over 10 m (``nyu8``), so known to 4 cm; test depth is 16 bits, mm.

    Args:
        root: the folder with ``data/``; None for ``$ELDENET_DATA/nyu_depth_v2/densedepth``.
        split: "train" and "val", parts of the training frames that share no scene
            (:func:`~eldenet.data.splits.hold_out`), "trainval" for both, or "test" for the 654.
        encoding: of the depth files; None for DenseDepth's.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: files are missing.
        ValueError: the split is unknown, or a line of the CSV is not a pair or leaves the folder.
    """

    ground_truth = "inpainted"

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        split: str = "train",
        encoding: Encoding | None = None,
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "trainval", "test"))
        part = "test" if split == "test" else "train"
        table = f"data/nyu2_{part}.csv"
        folder = find_root(root, "nyu_depth_v2/densedepth", [table], DENSEDEPTH_TREE)
        encoding = encoding or {"train": "nyu8", "test": "mm"}[part]
        pairs = _inside(csv_pairs(folder / table), folder / table)
        super().__init__(folder, pairs, split, encoding, f"data/nyu2_{part}/", **options)


class NYULabelled(_NYUPairs):
    """The 795 official training frames of the labeled set, in DenseDepth's layout, split in two.

    Args:
        root: the folder with ``data/``; None for ``$ELDENET_DATA/nyu_depth_v2/labeled``. The file names are
            the frame numbers of the labeled .mat (1-based).
        split: "train" or "val", which share no scene (``VAL_FRAMES`` in ``nyu_scenes.py``), or "all" for the
            795; "fit" or "dev", parts of "train" that share no scene either, for choosing a recipe before
            "val" scores it.
        encoding: of the depth files.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: files are missing.
        ValueError: the split is unknown, a line of the CSV is not a pair or leaves the folder, or a
            file name is not a frame number.
    """

    ground_truth = "inpainted"

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        split: str = "train",
        encoding: Encoding = "nyu8_labelled",
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, tuple(LABELED_SPLITS))
        table = "data/nyu2_train.csv"
        folder = find_root(root, "nyu_depth_v2/labeled", [table], DENSEDEPTH_TREE)
        pairs = _inside(csv_pairs(folder / table), folder / table)
        pairs = [pair for pair in pairs if labeled_part(_frame_number(pair[0])) in LABELED_SPLITS[split]]
        super().__init__(folder, pairs, "all", encoding, "data/nyu2_train/", **options)


SYNC_TREE = """
<scene>/rgb_00000.jpg, sync_depth_00000.png           (BTS's sync folder; depth 16 bits, mm, 0 = unknown)
"""


class NYUSync(_NYUPairs):
    """BTS's extraction of the raw set: color and depth registered to it, with its holes.

    BTS, AdaBins and GLPDepth read the test frames the same way, from ``official_splits/test`` and its list.

    Args:
        root: the folder with the scenes; None for ``$ELDENET_DATA/nyu_depth_v2/sync``, or
            ``$ELDENET_DATA/nyu_depth_v2/official_splits/test`` if ``split`` is "test".
        split: "train" and "val", parts that share no scene (:func:`~eldenet.data.splits.hold_out`); "all" and
            "test" take every frame.
        list_file: list of ``image depth [focal]`` lines, relative to ``root`` even if they start with "/", as
            BTS's do; None takes every pair below ``root``.
        encoding: of the depth files.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: files are missing, or a picture has no depth.
        ValueError: the split is unknown, or a line of the list is not a pair or leaves the folder.
    """

    ground_truth = "raw"

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        split: str = "all",
        list_file: str | Path | None = None,
        encoding: Encoding = "mm",
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "all", "test"))
        usual, setting = "nyu_depth_v2/sync", "data.root"
        if split == "test":
            usual, setting = "nyu_depth_v2/official_splits/test", "data.test_root"
        folder = find_root(root, usual, [], SYNC_TREE, setting)
        pairs = _sync_pairs(folder) if list_file is None else _list_pairs(Path(list_file).expanduser())
        super().__init__(folder, pairs, split, encoding, **options)


def _sync_pairs(folder: Path) -> list[tuple[str, str]]:
    """Every ``rgb_*`` or ``sync_depth_*`` file below ``folder`` with the partner that it needs."""
    stems = set()
    for kind, ending in (("rgb_", ".jpg"), ("sync_depth_", ".png")):
        for path in folder.rglob(f"{kind}*{ending}"):
            stems.add((path.parent.relative_to(folder), path.stem.removeprefix(kind)))
    return [
        ((d / f"rgb_{n}.jpg").as_posix(), (d / f"sync_depth_{n}.png").as_posix()) for d, n in sorted(stems)
    ]


def _list_pairs(list_file: Path) -> list[tuple[str, str]]:
    pairs = []
    text = read_text(list_file, "list_file must name the list of frames")
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.split()
        if not cells:
            continue
        if len(cells) not in (2, 3):
            raise ValueError(f"{list_file}, line {number}: expected 'image depth [focal]', found {line!r}")
        # joined to the root, a path that starts with "/" would replace it
        pairs.append((cells[0].lstrip("/"), cells[1].lstrip("/")))
    if not pairs:
        raise ValueError(f"{list_file} is empty: set list_file to a list of frames")
    return _inside(pairs, list_file)


def _inside(pairs: list[tuple[str, str]], source: Path) -> list[tuple[str, str]]:
    """Return the pairs of a list, all of whose files lie in the data set's folder."""
    check_inside(chain.from_iterable(pairs), source, "write the list with paths below that folder")
    return pairs


def _frame_number(file: str) -> int:
    stem = Path(file).stem
    if not stem.isdecimal():
        raise ValueError(f"{file}: a labeled frame must be named by its number in the .mat, such as 0003.jpg")
    return int(stem)

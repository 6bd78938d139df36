"""NYU Depth V2 in the layouts people have on disk, one class per layout.

Silberman et al., "Indoor Segmentation and Support Inference from RGBD Images", ECCV 2012. The official split
is 795 training and 654 test frames of the 1,449 labelled ones. Which ground truth a test uses (in-painted
``depths`` or ``rawDepths`` with holes) changes every number, so each class says it in ``ground_truth``.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

import numpy as np

from eldenet.data.array_files import read_text
from eldenet.data.base import DepthDataset, SampleOptions
from eldenet.data.io import Encoding, depth_encoding, read_depth, read_image
from eldenet.data.paths import csv_pairs, find_root
from eldenet.data.splits import hold_out
from eldenet.geometry import pinhole, resize_intrinsics
from eldenet.system.checks import one_of
from eldenet.types import Frame

NYU_SIZE = (480, 640)
NYU_FOCAL = 518.8579
NYU_MIN_DEPTH, NYU_MAX_DEPTH = 1e-3, 10.0

# Own validation part of the 795 official training frames: first and last frame number (1-based, of the
# labelled .mat), 130 frames. Frames of a scene follow each other in the .mat, and the official split never
# cuts a scene, so training frames between two test frames hold whole scenes. The blocks below are such runs,
# taken whole, spread so that every kind of room of which there are several is met (office, classroom, study,
# bath, kitchen, bedroom, living and dining room ...). Checked on the pictures: of all pairs across the border
# none has more than 12 SIFT inliers, which is chance; within the runs hundreds do.
VAL_FRAMES: tuple[tuple[int, int], ...] = (
    *((22, 27), (80, 83), (120, 124), (203, 206), (265, 270), (303, 309), (391, 394), (436, 440)),
    *((584, 590), (614, 616), (639, 643), (665, 667), (719, 723), (805, 809), (824, 832), (909, 916)),
    *((1005, 1009), (1110, 1116), (1185, 1191), (1221, 1225), (1266, 1274), (1341, 1346), (1402, 1406)),
)

# 112 of the other training frames, whole scenes again: recipes are chosen on them, and scored on those above.
DEV_FRAMES: tuple[tuple[int, int], ...] = (
    *((3, 8), (286, 295), (527, 530), (534, 536), (608, 611), (652, 655), (682, 685), (700, 705), (735, 742)),
    *((863, 868), (929, 931), (948, 958), (1024, 1031), (1040, 1047), (1132, 1134), (1137, 1143)),
    *((1213, 1215), (1251, 1253), (1415, 1420), (1425, 1429)),
)
LABELLED_SPLITS = {
    "all": ("fit", "dev", "val"),
    "train": ("fit", "dev"),
    "val": ("val",),
    "fit": ("fit",),
    "dev": ("dev",),
}


def nyu_intrinsics(size: tuple[int, int] = NYU_SIZE) -> np.ndarray:
    """Intrinsics ``(3, 3)`` [px] of the color camera for a picture of ``size`` ``(height, width)``."""
    return resize_intrinsics(pinhole(NYU_FOCAL, 519.4696, 325.5824, 253.7362), NYU_SIZE, size)


def is_val_frame(number: int) -> bool:
    """Whether the labelled frame ``number`` (1-based) belongs to the own validation part."""
    return _part(number) == "val"


def _part(number: int) -> str:
    for name, blocks in (("val", VAL_FRAMES), ("dev", DEV_FRAMES)):
        if any(first <= number <= last for first, last in blocks):
            return name
    return "fit"


class NYUFrames(DepthDataset):
    """What the layouts share: the depth range of the field's tables, unless the caller gives another."""

    def __init__(self, names: Sequence[str], **options: Unpack[SampleOptions]) -> None:
        options.setdefault("min_depth", NYU_MIN_DEPTH)
        options.setdefault("max_depth", NYU_MAX_DEPTH)
        super().__init__(names, **options)


class _NYUPairs(NYUFrames):
    """Frames that are one picture and one depth file each."""

    frame_lists = ("names", "pairs")

    def __init__(
        self,
        root: Path,
        pairs: Sequence[tuple[str, str]],
        names: Sequence[str],
        encoding: Encoding,
        **options: Unpack[SampleOptions],
    ) -> None:
        super().__init__(names, **options)
        self.root, self.pairs, self.encoding = root, list(pairs), depth_encoding(encoding)
        self.check_frames(root, pairs)

    def frame_files(self, index: int) -> Sequence[Path]:
        """Picture and depth."""
        return [self.root / file for file in self.pairs[index]]

    def frame_settings(self) -> dict[str, object]:
        """The encoding."""
        return {"encoding": self.encoding.description}

    def load_frame(self, index: int) -> Frame:
        """Read one picture and its depth."""
        image_file, depth_file = self.pairs[index]
        image = read_image(self.root / image_file, gray=False)
        depth = read_depth(self.root / depth_file, self.encoding)
        if image.shape[:2] != depth.shape:
            raise ValueError(
                f"{self.root / image_file} is {image.shape[:2]}, {self.root / depth_file} is {depth.shape} "
                "(height, width): they are no pair"
            )
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
        root: the folder that holds ``data/``; None for ``$ELDENET_DATA/nyu_depth_v2/densedepth``.
        split: "train" and "val", parts of the training frames that share no scene
            (:func:`~eldenet.data.splits.hold_out`), "trainval" for all of these, or "test" for the 654.
        encoding: of the depth files; None for DenseDepth's own.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: naming what is missing.
        ValueError: for an unknown split or a line of the CSV that is no pair.
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
        pairs = csv_pairs(folder / table)
        names = [_stem(image, f"data/nyu2_{part}/") for image, _ in pairs]
        if split in ("train", "val"):
            chosen = hold_out(names, split)
            pairs, names = [pairs[i] for i in chosen], [names[i] for i in chosen]
        super().__init__(folder, pairs, names, encoding or {"train": "nyu8", "test": "mm"}[part], **options)


class NYULabelled(_NYUPairs):
    """The 795 official training frames of the labelled set, in DenseDepth's layout, split in two.

    Args:
        root: the folder that holds ``data/``; None for ``$ELDENET_DATA/nyu_depth_v2/labeled``. The file names
            are the frame numbers of the labelled .mat (1-based).
        split: "train" or "val", which share no scene (see ``VAL_FRAMES``), or "all" for the 795; "fit" or
            "dev", parts of "train" that share none either: to choose a recipe on, before "val" scores it.
        encoding: of the depth files.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: naming what is missing.
        ValueError: for an unknown split or a file name that is no frame number.
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
        one_of("split", split, tuple(LABELLED_SPLITS))
        table = "data/nyu2_train.csv"
        folder = find_root(root, "nyu_depth_v2/labeled", [table], DENSEDEPTH_TREE)
        pairs = csv_pairs(folder / table)
        pairs = [pair for pair in pairs if _part(_frame_number(pair[0])) in LABELLED_SPLITS[split]]
        names = [_stem(image, "data/nyu2_train/") for image, _ in pairs]
        super().__init__(folder, pairs, names, encoding, **options)


SYNC_TREE = """
<scene>/rgb_00000.jpg, sync_depth_00000.png           (BTS's sync folder; depth 16 bits, mm, 0 = unknown)
"""


class NYUSync(_NYUPairs):
    """BTS's extraction of the raw set: color with depth brought into its view, holes left as they are.

    BTS, AdaBins and GLPDepth read the test frames the same way, from ``official_splits/test`` and its list.

    Args:
        root: the folder that holds the scenes; None for ``$ELDENET_DATA/nyu_depth_v2/sync``, or
            ``$ELDENET_DATA/nyu_depth_v2/official_splits/test`` where ``split`` is "test".
        split: "train" and "val", parts that share no scene (:func:`~eldenet.data.splits.hold_out`); "all" and
            "test" take every frame.
        list_file: list of ``image depth [focal]`` lines, relative to ``root`` even where they start with "/"
            (BTS's do); None takes every pair below ``root``.
        encoding: of the depth files.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: naming what is missing, a picture without depth included.
        ValueError: for a line of the list that is no pair, or another camera's focal length.
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
        usual = "nyu_depth_v2/official_splits/test" if split == "test" else "nyu_depth_v2/sync"
        folder = find_root(root, usual, [], SYNC_TREE)
        pairs = _sync_pairs(folder) if list_file is None else _list_pairs(Path(list_file))
        names = [_stem(image, "") for image, _ in pairs]
        if split in ("train", "val"):
            chosen = hold_out(names, split)
            pairs, names = [pairs[i] for i in chosen], [names[i] for i in chosen]
        super().__init__(folder, pairs, names, encoding, **options)


def _sync_pairs(folder: Path) -> list[tuple[str, str]]:
    """Every ``rgb_*`` or ``sync_depth_*`` file below ``folder`` with the partner it must have."""
    stems = set()
    for kind, ending in (("rgb_", ".jpg"), ("sync_depth_", ".png")):
        for path in folder.rglob(f"{kind}*{ending}"):
            stems.add((path.parent.relative_to(folder), path.stem.removeprefix(kind)))
    return [
        ((d / f"rgb_{n}.jpg").as_posix(), (d / f"sync_depth_{n}.png").as_posix()) for d, n in sorted(stems)
    ]


def _list_pairs(list_file: Path) -> list[tuple[str, str]]:
    pairs = []
    text = read_text(list_file, "list_file names the list of frames")
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.split()
        if not cells:
            continue
        if len(cells) not in (2, 3):
            raise ValueError(f"{list_file}, line {number}: wants 'image depth [focal]' but holds {line!r}")
        if len(cells) == 3 and not _is_focal(cells[2]):
            raise ValueError(
                f"{list_file}, line {number}: focal length {cells[2]} px, NYU's camera has {NYU_FOCAL}: is "
                "it another data set's list?"
            )
        # Joined as it stands, a path that starts with "/" would drop the root.
        pairs.append((cells[0].lstrip("/"), cells[1].lstrip("/")))
    if not pairs:
        raise ValueError(f"{list_file} is empty: list_file names the list of frames")
    return pairs


def _is_focal(cell: str) -> bool:
    try:
        return abs(float(cell) - NYU_FOCAL) <= 1.0
    except ValueError:
        return False


def _stem(file: str, prefix: str) -> str:
    return file.removeprefix(prefix).rsplit(".", 1)[0]


def _frame_number(file: str) -> int:
    stem = Path(file).stem
    if not stem.isdecimal():
        raise ValueError(
            f"{file}: the labelled frames are named by their number in the .mat, such as 0003.jpg"
        )
    return int(stem)

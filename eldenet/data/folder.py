"""Your own pictures with depth: two folders, or a CSV of pairs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from eldenet.data.base import FileDataset, SampleOptions, check_pair
from eldenet.data.io import IMAGE_ENDINGS, Encoding, depth_encoding, read_depth, read_image
from eldenet.data.paths import csv_pairs, find_root, natural_order, visible_files
from eldenet.geometry import check_intrinsics, intrinsic_matrix
from eldenet.system.checks import one_of
from eldenet.system.files import read_text
from eldenet.types import Frame

DEPTH_ENDINGS = (".png", ".npy", ".tif", ".tiff", ".pgm", ".pfm", ".exr")
FOLDER_TREE = """
images/a.jpg, images/b.jpg ...       depths/a.png, depths/b.png ...     (or a CSV with lines image,depth)
"""


class FolderDataset(FileDataset):
    """Pictures and depth maps matched by name, or paired by a CSV.

    The split is by blocks of frames that follow each other in the order of their names (2 before 10):
    neighboring frames of a recording look nearly the same, so a frame-by-frame split would test on what was
    trained. Better still, name validation frames of other places in ``val_names``.

    Args:
        root: the data set's folder.
        images: folder of pictures below ``root``.
        depths: folder of depth maps below ``root``, with the same names except for the ending.
        csv: CSV below ``root`` without a header, one ``image,depth`` per line, relative to ``root``; replaces
            ``images`` and ``depths``.
        allow_outside: let the CSV name files outside ``root`` (``../`` or absolute paths).
        encoding: of the depth files: a name in :data:`eldenet.data.io.ENCODINGS`, or
            ``{scale: meters per step, offset: steps, dtype: uint8 | uint16 | float}``.
        intrinsics: ``[fx, fy, cx, cy]`` or ``(3, 3)`` of the pictures on disk [px], which must then have one
            size, with the principal point inside; None if unknown.
        split: "train", "val" or "all".
        val_fraction: share of the blocks for validation.
        blocks: how many blocks the frames are cut into.
        gap: frames left out of both parts on each side of a validation block.
        split_seed: decides which blocks are for validation.
        val_names: validation frames, instead of blocks: a list of names, or a text file with one per line.
        ground_truth: "raw", "inpainted" or "sparse": what the depth is, for reports.
        **options: see :class:`~eldenet.data.base.DepthDataset`; ``max_depth`` has no default here.

    Raises:
        FileNotFoundError: a picture has no depth, depth has no picture, or files are missing.
        ValueError: settings are out of range or do not fit together.
    """

    depth_range = (1e-3, None)

    def __init__(
        self,
        root: str | Path,
        *,
        images: str = "images",
        depths: str = "depths",
        csv: str | None = None,
        allow_outside: bool = False,
        encoding: Encoding = "mm",
        intrinsics: Sequence[Any] | None = None,
        split: str = "all",
        val_fraction: float = 0.1,
        blocks: int = 10,
        gap: int = 0,
        split_seed: int = 0,
        val_names: Sequence[str] | str | Path | None = None,
        ground_truth: str = "raw",
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "all"))
        one_of("ground_truth", ground_truth, ("raw", "inpainted", "sparse"))
        self.encoding, self.ground_truth = depth_encoding(encoding), ground_truth
        self.intrinsics = None if intrinsics is None else intrinsic_matrix(intrinsics)

        folder = find_root(root, None, [csv] if csv else [images, depths], FOLDER_TREE)
        if csv:
            pairs = _csv_frames(folder, csv, allow_outside)
        else:
            pairs = _folder_frames(folder, images, depths, strict=options.get("on_error") != "skip")
        every = names = sorted(pairs, key=natural_order)
        if split != "all" and val_names is not None:
            names = _named(names, val_names, wanted=split == "val")
        elif split != "all":
            val, left_out = val_blocks(len(names), val_fraction, blocks, gap, split_seed)
            chosen = val if split == "val" else sorted(set(range(len(names))) - set(val) - set(left_out))
            names = [names[i] for i in chosen]
        super().__init__(folder, names, [pairs[name] for name in names], **options)
        self.calibrated: tuple[Path, tuple[int, int]] | None = None  # the picture that sets the size
        if self.intrinsics is not None:  # the folder's first one: the same for all splits
            self.calibrated = _first_size([folder / pairs[name][0] for name in every])
            if self.calibrated is not None:
                check_intrinsics(self.intrinsics, self.calibrated[1])

    def frame_settings(self) -> dict[str, object]:
        """Return encoding and camera."""
        camera = None if self.intrinsics is None else self.intrinsics.tolist()
        size = None if self.calibrated is None else self.calibrated[1]
        return {"encoding": self.encoding.description, "intrinsics": camera, "size": size}

    def load_frame(self, index: int) -> Frame:
        """Read one picture and its depth."""
        image_file, depth_file = self.frame_files(index)
        image, depth = read_image(image_file), read_depth(depth_file, self.encoding)
        check_pair(image.shape, image_file, depth.shape, depth_file)
        if self.calibrated is not None and image.shape[:2] != self.calibrated[1]:
            first, size = self.calibrated
            raise ValueError(
                f"{image_file} is {image.shape[:2]}, {first} is {size} (height, width), but intrinsics "
                "describe "
                "one camera: resize the pictures to one size, put each size into its own folder, or "
                "leave intrinsics out (null)"
            )
        return Frame(image, depth, self.intrinsics, self.names[index])


def _first_size(pictures: Sequence[Path]) -> tuple[Path, tuple[int, int]] | None:
    """Return the first picture that can be read, and its ``(height, width)`` [px]."""
    for picture in pictures:
        try:
            height, width = read_image(picture).shape[:2]
            return picture, (height, width)
        except (ValueError, OSError):  # reported when its frame is read
            continue
    return None


def _csv_frames(root: Path, table: str, allow_outside: bool) -> dict[str, tuple[str, str]]:
    pairs = csv_pairs(root / table, allow_outside=allow_outside)
    frames = {image.rsplit(".", 1)[0]: (image, depth) for image, depth in pairs}
    if len(frames) != len(pairs):
        raise ValueError(f"{root / table} has {len(pairs)} lines but only {len(frames)} different pictures")
    return frames


def _folder_frames(root: Path, images: str, depths: str, *, strict: bool) -> dict[str, tuple[str, str]]:
    """Pairs by their path below the folder, without the ending; a missing partner is named ``name.*``."""
    pictures = _files(root, images, IMAGE_ENDINGS)
    maps = _files(root, depths, DEPTH_ENDINGS)
    for kind, setting, folder, found, endings in (
        ("pictures", "images", images, pictures, IMAGE_ENDINGS),
        ("depth maps", "depths", depths, maps, DEPTH_ENDINGS),
    ):
        if not found:
            raise FileNotFoundError(
                f"{root / folder} holds no {kind} ({', '.join(endings)}): put them there, or give another "
                f"data.root or data.{setting}"
            )
    lonely = [f"{pictures[n]} (no depth in {depths})" for n in sorted(set(pictures) - set(maps))]
    lonely += [f"{maps[n]} (no picture in {images})" for n in sorted(set(maps) - set(pictures))]
    if lonely and strict:
        more = f" and {len(lonely) - 10} more" if len(lonely) > 10 else ""
        raise FileNotFoundError(
            f"{len(lonely)} files in {root} have no partner: {', '.join(lonely[:10])}{more}. Add them, "
            "list pairs of different names in a CSV (csv=...), or leave these frames out (on_error: skip)"
        )
    both = set(pictures) | set(maps)
    return {n: (pictures.get(n, f"{images}/{n}.*"), maps.get(n, f"{depths}/{n}.*")) for n in both}


def _files(root: Path, folder: str, endings: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for path in sorted(visible_files(root / folder, endings)):
        name = path.relative_to(root / folder).with_suffix("").as_posix()
        file = path.relative_to(root).as_posix()
        if name in found:
            raise ValueError(f"{root}: {found[name]} and {file} have the same name: remove one of them")
        found[name] = file
    return found


def val_blocks(count: int, fraction: float, blocks: int, gap: int, seed: int) -> tuple[list[int], list[int]]:
    """Return the numbers of frames for validation, and of those beside them that belong to neither part.

    Args:
        count: of all frames, in the order of time.
        fraction: share of the blocks for validation.
        blocks: into which the frames are cut.
        gap: frames left out on each side of a validation block.
        seed: decides which blocks are for validation.

    Raises:
        ValueError: the settings are out of range, or there is one frame.
    """
    if not 0.0 < fraction < 1.0 or blocks < 2 or gap < 0:
        raise ValueError(
            f"val_fraction={fraction}, blocks={blocks}, gap={gap}: give a fraction between 0 and 1, at least "
            "2 blocks and a gap of at least 0"
        )
    if count < 2:
        raise ValueError(f"{count} frame cannot be split: use split='all'")
    parts = np.array_split(np.arange(count), min(blocks, count))
    chosen = np.random.default_rng(seed).permutation(len(parts))
    chosen = np.sort(chosen[: min(max(1, round(fraction * len(parts))), len(parts) - 1)])
    val = {int(i) for part in chosen for i in parts[part]}
    beside = {i + step for i in val for step in range(-gap, gap + 1)} - val
    return sorted(val), sorted(i for i in beside if 0 <= i < count)


def _named(names: Sequence[str], val_names: Sequence[str] | str | Path, *, wanted: bool) -> list[str]:
    if isinstance(val_names, str | Path):
        text = read_text(Path(val_names), "val_names must be a list of names, or a text file")
        val_names = [line.strip() for line in text.splitlines() if line.strip()]
    wanted_names = set(val_names)
    unknown = sorted(wanted_names - set(names))
    if unknown:
        raise ValueError(
            f"{len(unknown)} of val_names are not in the data set: {', '.join(unknown[:10])}: give names "
            f"such as {names[0]!r}"
        )
    return [name for name in names if (name in wanted_names) == wanted]

"""NYU Depth V2 in tar shards of HDF5 files, as in the Hugging Face Hub's ``sayakpaul/nyu_depth_v2``."""

import hashlib
import io
import json
import logging
import tarfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple, Unpack

from eldenet.data.base import DepthDataset, SampleOptions
from eldenet.data.nyu import NYU_RANGE
from eldenet.data.nyu_hdf5 import open_hdf5, read_hdf5_frame
from eldenet.data.paths import default_cache, find_root, incomplete
from eldenet.data.splits import hold_out
from eldenet.system.checks import one_of
from eldenet.system.files import part_file, read_json
from eldenet.types import Frame

TAR_TREE = """
data/train-000000.tar ... train-000011.tar     (47,584 frames: <scene>/00001.h5, sparse-to-dense's files)
data/val-000000.tar, val-000001.tar            (the official 654)
"""


class Member(NamedTuple):
    """Place of one file in its shard: bytes ``start`` to ``start + size``."""

    shard: str
    name: str
    start: int
    size: int


class NYUTar(DepthDataset):
    """The Hub's tar shards, read in place: each frame by its place in its shard, in any order.

    The places are found once, by reading the shards' headers, and stored in the cache folder with the shard's
    path, size and time of change: a shard that was fetched again is indexed again.

    Convention: as in :class:`~eldenet.data.nyu_hdf5.NYUHDF5`, "val" is held out of the training frames and
    the official test frames (the Hub's ``val``) are "test".

    Args:
        root: the folder with ``data``; None for ``$ELDENET_DATA/nyu_depth_v2_hub``.
        split: "train" and "val", parts of the training frames that share no scene
            (:func:`~eldenet.data.splits.hold_out`), "trainval" for both, or "test".
        index: folder for the places; None for ``$ELDENET_CACHE``, else ``~/.cache/eldenet``.
        **options: see :class:`~eldenet.data.base.DepthDataset`; depth range 1e-3 to 10 m unless given.

    Raises:
        FileNotFoundError: there are no shards.
        ValueError: the split is unknown, or a shard is truncated (with ``on_error: skip`` its whole frames
            are used, and ``skipped`` names the shard); on reading: a frame is damaged.
    """

    ground_truth = "inpainted"
    depth_range = NYU_RANGE
    frame_lists = ("names", "members")

    def __init__(
        self,
        root: str | Path | None = None,
        *,
        split: str = "train",
        index: str | Path | None = None,
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "trainval", "test"))
        self.root = find_root(root, "nyu_depth_v2_hub", ["data"], TAR_TREE)
        part = "val" if split == "test" else "train"
        shards = sorted((self.root / "data").glob(f"{part}-*.tar"))
        if not shards:
            raise incomplete(f"{self.root / 'data'} has no {part}-*.tar", TAR_TREE)
        cache = (default_cache() if index is None else Path(index)).expanduser() / "tar_index"
        members: list[Member] = []
        cut: dict[str, str] = {}
        for shard in shards:
            found, fault = shard_members(shard, cache)
            if fault and options.get("on_error") != "skip":
                raise ValueError(
                    f"{shard} is truncated ({fault}): fetch it again, or use what is whole (on_error: skip)"
                )
            if fault:
                cut[f"data/{shard.name}"] = f"{shard} is truncated ({fault})"
            members += found
        by_name = {_frame_name(part, member.name): member for member in members}
        if len(by_name) < len(members):
            raise ValueError(f"{self.root / 'data'} contains some frames twice: remove the repeated shards")
        names = sorted(by_name)
        names = [names[i] for i in hold_out(names, split)]
        super().__init__(names, **options)
        self.members = [by_name[name] for name in names]
        self.skipped |= cut

    def frame_files(self, index: int) -> Sequence[Path]:
        """Return the frame's shard."""
        return [self.root / self.members[index].shard]

    def load_frame(self, index: int) -> Frame:
        """Read one frame."""
        member = self.members[index]
        source = f"{self.root / member.shard}, {member.name}"
        with (self.root / member.shard).open("rb") as shard:
            shard.seek(member.start)
            content = shard.read(member.size)
        if len(content) < member.size:
            raise ValueError(
                f"{source} is truncated ({len(content)} of {member.size} bytes): fetch the shard again"
            )
        with open_hdf5(io.BytesIO(content), source) as file:
            return read_hdf5_frame(file, source, self.names[index])


def shard_members(shard: Path, cache: Path) -> tuple[Sequence[Member], str]:
    """Return the ``.h5`` files of a shard and how it is truncated, if it is; cached per shard."""
    state = shard.stat()
    path = str(shard.resolve())
    key = [path, state.st_size, state.st_mtime_ns]
    file = cache / f"{hashlib.sha256(path.encode()).hexdigest()[:16]}.json"
    try:
        known = read_json(file)
        if known["shard"] == key:
            # under the name that was asked for: the path may be a link
            return [Member(f"data/{shard.name}", *entry[1:]) for entry in known["members"]], known["fault"]
    except (OSError, ValueError, KeyError, TypeError):
        pass  # no index, or not ours: walk the shard
    members, fault = _walk(shard)
    try:
        with part_file(file) as unfinished:
            unfinished.write_text(json.dumps({"shard": key, "members": members, "fault": fault}))
    except OSError as error:
        logging.getLogger("eldenet").warning(
            "the index of %s cannot be stored in %s: %s", shard, cache, error
        )
    return members, fault


def _walk(shard: Path) -> tuple[list[Member], str]:
    """Read all headers; tarfile alone would take the end of a truncated file for the end of the archive."""
    members: list[Member] = []
    length, end = shard.stat().st_size, 0
    try:
        with tarfile.open(shard, "r:") as archive:
            for entry in archive:
                end = entry.offset_data + -(-entry.size // 512) * 512
                if entry.offset_data + entry.size > length:
                    return members, f"{entry.name} is incomplete"
                if entry.size < 0:
                    return members, f"{entry.name} has a size below 0"
                if entry.name.endswith(".h5") and not entry.isdir():
                    outside = entry.name.startswith("/") or ".." in PurePosixPath(entry.name).parts
                    if outside or not entry.isfile() or entry.issparse():
                        return members, f"{entry.name} is a link, or lies outside the archive: not followed"
                    members.append(Member(f"data/{shard.name}", entry.name, entry.offset_data, entry.size))
    except Exception as error:  # tarfile raises many kinds
        return members, f"no tar header at byte {end}: {error}"
    with shard.open("rb") as file:
        file.seek(end)
        closing = file.read(512)
        if len(closing) < 512 or any(closing):
            return members, f"no end of archive at byte {end}"
        while block := file.read(1 << 20):
            if any(block):  # a header of zeros looks like the end
                return members, f"more files after the end of archive at byte {end}"
    return members, ""


def _frame_name(part: str, member: str) -> str:
    """Name of a frame as in NYUHDF5, ``train/<scene>/00001``, whatever folders precede the scene."""
    path = PurePosixPath(member).with_suffix("")
    return f"{part}/{path.parent.name}/{path.name}"

"""The Hub's tar shards: the same frames as the unpacked files, from their places in the shards."""

import json
import os
import tarfile
from pathlib import Path

import numpy as np
import pytest
from support import layouts

from eldenet.data import nyu_tar
from eldenet.data.nyu_hdf5 import NYUHDF5
from eldenet.data.nyu_tar import NYUTar


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ELDENET_CACHE", str(tmp_path / "cache"))
    return layouts.tar(tmp_path / "hub")


def test_the_same_frames_as_unpacked(root: Path, tmp_path: Path) -> None:
    unpacked = layouts.hdf5(tmp_path / "unpacked")
    for split in ("train", "val", "trainval", "test"):
        one, other = NYUTar(root, split=split), NYUHDF5(unpacked, split=split)
        assert one.names == other.names
        assert one.split_hash == other.split_hash
        assert one.ground_truth == other.ground_truth
        for index in reversed(range(len(one))):
            a, b = one.load_frame(index), other.load_frame(index)
            np.testing.assert_array_equal(a.image, b.image)
            np.testing.assert_array_equal(a.depth, b.depth)
            np.testing.assert_array_equal(a.intrinsics, b.intrinsics)


def test_links_to_shards_keep_their_own_names(root: Path, tmp_path: Path) -> None:
    """As the Hub's cache lays them out: another folder may call the same file differently."""
    whole = NYUTar(root, split="trainval")
    shards = sorted((root / "data").glob("train-*.tar"))
    linked = tmp_path / "linked" / "data"
    linked.mkdir(parents=True)
    for shard, target in zip(shards, reversed(shards), strict=True):
        (linked / shard.name).symlink_to(target.resolve())
    again = NYUTar(linked.parent, split="trainval")
    assert again.names == whole.names
    for index in range(len(whole)):
        np.testing.assert_array_equal(again.load_frame(index).depth, whole.load_frame(index).depth)


def test_places_are_kept_until_the_shard_changes(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    walked: list[str] = []
    walk = nyu_tar._walk

    def counting(shard: Path):
        walked.append(shard.name)
        return walk(shard)

    monkeypatch.setattr(nyu_tar, "_walk", counting)
    names = NYUTar(root, split="trainval").names
    assert walked == ["train-000000.tar", "train-000001.tar"]
    assert NYUTar(root, split="trainval").names == names
    assert len(walked) == 2
    with tarfile.open(root / "data/train-000001.tar", "a") as archive:
        with tarfile.open(root / "data/val-000000.tar") as other:
            other.extractall(root / "more", filter="data")
        archive.add(root / "more/official/00002.h5", arcname="study_0003/00007.h5")
    more = NYUTar(root, split="trainval")
    assert walked[2:] == ["train-000001.tar"]
    assert more.names == [*names, "train/study_0003/00007"]
    np.testing.assert_array_equal(more.load_frame(2).depth, layouts.SMALL.meters)
    shard = root / "data/train-000000.tar"  # the same bytes, another time: walked again
    os.utime(shard, ns=(1, 1))
    NYUTar(root, split="trainval")
    assert walked[3:] == ["train-000000.tar"]
    for file in Path(os.environ["ELDENET_CACHE"]).rglob("*.json"):
        file.write_text(json.dumps({"shard": 1}) if "0" in file.name else "{")
    assert NYUTar(root, split="trainval").names == more.names  # a damaged list is made again


@pytest.mark.parametrize("kept", [0, 100, 600, 5000, -512, -10240])
def test_a_cut_shard_is_named(root: Path, kept: int) -> None:
    shard = root / "data/train-000001.tar"
    content = shard.read_bytes()
    end = content.rstrip(b"\0")
    kept = len(end) // 512 * 512 + kept if kept < 0 else kept
    shard.write_bytes(content[:kept])
    with pytest.raises(ValueError, match=r"train-000001\.tar is truncated"):
        NYUTar(root, split="trainval")
    data = NYUTar(root, split="trainval", on_error="skip")
    assert data.names == ["train/kitchen_0001/00001"]
    assert list(data.skipped) == ["data/train-000001.tar"]


def test_frames_that_are_there_twice_are_named(root: Path) -> None:
    (root / "data/train-000002.tar").write_bytes((root / "data/train-000000.tar").read_bytes())
    with pytest.raises(ValueError, match="contains some frames twice"):
        NYUTar(root)

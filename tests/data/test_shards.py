"""Shards of rendered frames with several processes at one of them."""

import numpy as np

from eldenet.data import shards
from eldenet.data.shards import is_whole, open_shard, write_shard

ARRAYS = {
    "image": np.zeros((1, 2, 2, 3), np.uint8),
    "depth": np.zeros((1, 2, 2), np.uint16),
    "intrinsics": np.eye(3)[None],
}


def test_the_second_writer_drops_its_copy(tmp_path):
    write_shard(tmp_path / "s", ARRAYS)
    write_shard(tmp_path / "s", {**ARRAYS, "image": ARRAYS["image"] + 1})
    assert open_shard(tmp_path / "s")[0].max() == 0
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_two_writers_replace_one_broken_shard(tmp_path, monkeypatch):
    (tmp_path / "s").mkdir()
    whole = shards.is_whole

    def slow(folder):
        found = whole(folder)
        monkeypatch.setattr(shards, "is_whole", whole)
        (tmp_path / "s").rename(tmp_path / "put away")  # by the other one, in between
        return found

    monkeypatch.setattr(shards, "is_whole", slow)
    write_shard(tmp_path / "s", ARRAYS)
    assert is_whole(tmp_path / "s")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["put away", "s"]

"""A frame cache under kills, races, damage and full disks."""

import logging
import multiprocessing
import os
import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from support import layouts
from support.frame_caches import reads_of, same

from eldenet.data import frame_store
from eldenet.data.frame_store import HEADER, FrameStore
from eldenet.data.nyu import NYULabelled
from eldenet.types import Frame

pytestmark = pytest.mark.usefixtures("store_folder")


SIDE = 300


def write_forever(path: Path, value: int, die_at: int | None = None) -> None:
    """Fill the four slots again and again; a process to be killed, or to kill itself half way in a write."""
    store = FrameStore(path, 4, HEADER + 7 * SIDE**2)
    write, calls = frame_store._write, 0

    def dying(handle: int, content: bytes, start: int, path: Path | None) -> None:
        nonlocal calls
        calls += 1  # every second one is a header
        if calls == die_at:
            write(handle, content[: len(content) // 2], start, path)
            os.kill(os.getpid(), signal.SIGKILL)
        write(handle, content, start, path)

    frame_store._write = dying
    while True:
        value = value % 200 + 1
        image = np.full((SIDE, SIDE, 3), value, np.uint8)
        depth = np.full((SIDE, SIDE), value, np.float32)
        store.put(value % 4, bytes([value % 2] * 16), Frame(image, depth, None, "x"))


def writer(*arguments) -> multiprocessing.Process:
    process = multiprocessing.get_context("fork").Process(target=write_forever, args=arguments)
    process.start()
    return process


def whole_frames(store: FrameStore) -> int:
    """Check every slot: what is there is one writer's frame, all of it, of the stamp that was asked for."""
    found = 0
    for index in range(store.count):
        for parity in range(2):
            frame = store.get(index, bytes([parity] * 16), "x")
            if frame is not None:
                value = int(frame.image[0, 0, 0])
                assert value % 4 == index
                assert value % 2 == parity
                assert (frame.image == value).all()
                assert (frame.depth == value).all()
                found += 1
    return found


@pytest.mark.parametrize("die_at", [1, 2, 5, 6, 11, 12])
def test_a_writer_killed_half_way_leaves_no_wrong_frame(tmp_path: Path, die_at: int) -> None:
    path = tmp_path / "frames.bin"
    process = writer(path, 0, die_at)
    process.join(timeout=60)
    assert process.exitcode == -signal.SIGKILL
    store = FrameStore(path, 4, HEADER + 7 * SIDE**2)
    assert whole_frames(store) == min((die_at - 1) // 2, 3 if die_at > 8 else 4)
    frame = Frame(np.ones((5, 4, 3), np.uint8), np.ones((5, 4), np.float32), np.eye(3), "again")
    for index in range(4):  # and the slot can be used again
        store.put(index, b"0123456789abcdef", frame)
        read = store.get(index, b"0123456789abcdef", "again")
        assert read is not None
        assert all((mine == theirs).all() for mine, theirs in zip(read[:3], frame[:3], strict=True))


def test_writers_killed_at_random_while_others_write_and_read(tmp_path: Path) -> None:
    path = tmp_path / "frames.bin"
    generator, found = random.Random(0), 0
    store = FrameStore(path, 4, HEADER + 7 * SIDE**2)
    for attempt in range(3):
        processes = [writer(path, seed) for seed in (attempt, attempt + 3)]
        try:
            end = time.monotonic() + generator.uniform(0.2, 0.6)
            while time.monotonic() < end:
                found += whole_frames(store)
        finally:
            for process in processes:
                process.kill()
                process.join()
        found += whole_frames(store)
    assert found > 0


def test_a_damaged_slot_is_read_again(tmp_path: Path, store_folder: Path) -> None:
    root = layouts.labeled(tmp_path)
    assert len(reads_of(NYULabelled(root, cache="disk"))) == 2
    (file,) = store_folder.rglob("frames.bin")
    content = bytearray(file.read_bytes())
    content[HEADER + 1234] ^= 1
    file.write_bytes(content)
    assert reads_of(NYULabelled(root, cache="disk")) == [0]
    assert reads_of(NYULabelled(root, cache="disk")) == []
    file.write_bytes(content[:5000])  # cut
    assert len(reads_of(NYULabelled(root, cache="disk"))) == 2


def test_a_full_disk_is_said_once_and_the_work_goes_on(tmp_path: Path, caplog) -> None:
    plain, cached = (NYULabelled(layouts.labeled(tmp_path), cache=kind) for kind in ("none", "disk"))
    cached.open_cache()
    store = cached._cache
    full = os.open("/dev/full", os.O_RDWR)  # says "no space left on device" to every write
    os.dup2(full, store.handle)
    os.close(full)
    for _ in range(2):
        assert all(same(cached[index], plain[index]) for index in range(len(plain)))
    assert caplog.text.count("No space left on device") == 1
    assert "ELDENET_CACHE" in caplog.text


def test_a_folder_that_cannot_be_written_is_said(tmp_path: Path, monkeypatch, caplog) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("ELDENET_CACHE", str(tmp_path / "file"))
    plain, cached = (NYULabelled(layouts.labeled(tmp_path), cache=kind) for kind in ("none", "disk"))
    assert all(same(cached[0], plain[0]) for _ in range(2))
    assert caplog.text.count("no frame cache in") == 1


def test_the_log_says_where_and_how_large(tmp_path: Path, store_folder: Path, caplog) -> None:
    with caplog.at_level(logging.INFO, "eldenet"):
        NYULabelled(layouts.labeled(tmp_path), cache="disk")[0]
    assert str(store_folder) in caplog.text
    assert "0.00 GB once all 2 frames are in it" in caplog.text
    assert "remove the folder" in caplog.text

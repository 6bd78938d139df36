"""Cached frames are the frames: to the last digit, after any change, kill or race; one copy serves all."""

import copy
import logging
import multiprocessing
import os
import pickle
import random
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import layouts
import numpy as np
import pytest
import torch
from synthetic import SyntheticDepth
from test_trainer import digest, make_trainer

import eldenet
from eldenet.data import cache as cache_module
from eldenet.data.base import DepthDataset
from eldenet.data.cache import HEADER, FrameStore
from eldenet.data.cityscapes import Cityscapes, CityscapesMTAN
from eldenet.data.folder import FolderDataset
from eldenet.data.io import ENCODINGS
from eldenet.data.kitti import KITTIDepth, KITTIRaw, KITTISelection
from eldenet.data.loading import EpochSampler, training_loader
from eldenet.data.nyu import NYUDenseDepth, NYULabelled, NYUSync
from eldenet.data.nyu_hdf5 import NYUHDF5, NYUMat
from eldenet.data.nyu_tar import NYUTar
from eldenet.data.transforms import Augmentation
from eldenet.evaluation import ConstantPredictor, evaluate
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.metrics import EvalProtocol
from eldenet.resources import Resources, seed_everything
from eldenet.trainer import Trainer
from eldenet.types import Frame

PROTOCOL = EvalProtocol("synthetic", min_depth=0.1, ground_truth="dense")


@pytest.fixture(autouse=True)
def store_folder(tmp_path_factory, monkeypatch) -> Path:
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("ELDENET_CACHE", str(folder))
    return folder / "frames"


Builder = Callable[..., DepthDataset]
ADAPTERS: dict[str, Callable[[Path], Builder]] = {
    "labelled": lambda root: lambda **o: NYULabelled(_once(layouts.labelled, root), **o),
    "densedepth": lambda root: (
        lambda **o: NYUDenseDepth(_once(layouts.densedepth, root), split="trainval", **o)
    ),
    "sync": lambda root: lambda **o: NYUSync(_once(layouts.sync, root), **o),
    "hdf5": lambda root: lambda **o: NYUHDF5(_once(layouts.hdf5, root), split="trainval", **o),
    "mat": lambda root: lambda **o: NYUMat(_once(layouts.mat, root), split="all", **o),
    "tar": lambda root: lambda **o: NYUTar(_once(layouts.tar, root), split="trainval", **o),
    "folder": lambda root: lambda **o: FolderDataset(_once(layouts.folder, root), max_depth=10, **o),
    "cityscapes": lambda root: lambda **o: Cityscapes(_once(layouts.cityscapes, root), split="trainval", **o),
    "mtan": lambda root: (
        lambda **o: CityscapesMTAN(_once(layouts.cityscapes_mtan, root), split="trainval", **o)
    ),
    "kitti": lambda root: (
        lambda **o: KITTIDepth(_once(layouts.kitti_depth, root) / "depth", split="all", **o)
    ),
    "kitti_raw": lambda root: lambda **o: KITTIRaw(_once(layouts.kitti_raw, root), split="all", **o),
    "selection": lambda root: (
        lambda **o: KITTISelection(_once(layouts.kitti_selection, root), frames=None, **o)
    ),
}


def _once(write: Callable[[Path], Path], root: Path) -> Path:
    if not any(root.iterdir()):
        write(root)
    return root


def same(one, other) -> bool:
    tensors = ("image", "depth", "mask", "intrinsics")
    return one["name"] == other["name"] and all(torch.equal(one[key], other[key]) for key in tensors)


def count_reads(data: DepthDataset) -> list[int]:
    """The indices that ``data`` reads from its files from now on."""
    reads: list[int] = []
    load = data.load_frame
    data.load_frame = lambda index: (reads.append(index), load(index))[1]  # type: ignore[method-assign]
    return reads


@pytest.mark.parametrize("kind", ["ram", "disk"])
@pytest.mark.parametrize("name", sorted(ADAPTERS))
def test_cached_samples_are_the_samples(name: str, kind: str, tmp_path: Path) -> None:
    build = ADAPTERS[name](tmp_path)
    # frames of their own sizes, as KITTI's, and frames made small
    for load_size in (None, (30, 40)):
        options = {"transform": Augmentation(), "input_size": (24, 32), "load_size": load_size}
        plain, cached = build(**options), build(cache=kind, **options)
        expected = [plain[3, index] for index in range(len(plain))]
        assert all(same(cached[3, index], expected[index]) for index in range(len(plain)))
        reads = count_reads(cached)
        assert all(same(cached[3, index], expected[index]) for index in range(len(plain)))
        assert reads == []
        if kind == "disk":
            later = build(cache=kind, **options)
            later.open_cache()
            reads = count_reads(later)
            assert all(same(later[3, index], expected[index]) for index in range(len(plain)))
            assert reads == []


def test_ground_truth_keeps_its_own_size(tmp_path: Path) -> None:
    options = {"load_size": (12, 16), "resize_depth": False}
    plain = NYULabelled(layouts.labelled(tmp_path), **options)
    for kind in ("ram", "disk"):
        cached = NYULabelled(tmp_path, cache=kind, **options)
        assert all(same(cached[0], plain[0]) for _ in range(2))
        assert cached[0]["depth"].shape == (1, 48, 64)


def test_a_frame_that_is_too_large_is_read_each_time(tmp_path: Path, caplog) -> None:
    layouts.folder(tmp_path, count=3)
    large = layouts.content((60, 80))
    layouts.picture(tmp_path / "images/f002.png", large.rgb)
    layouts.picture(tmp_path / "depths/f002.png", large.millimetres)
    plain, cached = (FolderDataset(tmp_path, max_depth=10, cache=kind) for kind in ("none", "disk"))
    for _ in range(2):
        assert all(same(cached[index], plain[index]) for index in range(3))
    assert caplog.text.count("larger than the first frame") == 1


# --- what makes a frame be read again -----------------------------------------------------------------------


def reads_of(data: DepthDataset) -> list[int]:
    """What is read from files, but for the frame that tells the size."""
    data.open_cache()
    reads = count_reads(data)
    _ = [data[index] for index in range(len(data))]
    return reads


def test_changed_settings_read_everything_again(tmp_path: Path, monkeypatch) -> None:
    root = layouts.labelled(tmp_path)
    usual = {"cache": "disk", "load_size": (12, 16)}
    every = list(range(len(NYULabelled(root))))
    assert reads_of(NYULabelled(root, **usual)) == every
    assert reads_of(NYULabelled(root, **usual, max_depth=5.0, seed=7, input_size=(6, 8))) == []  # come later
    for changes in (
        {"load_size": (13, 16)},
        {"encoding": "nyu8"},
        {"resize_depth": False},
        {"load_size": None},
    ):
        assert reads_of(NYULabelled(root, **(usual | changes))) == every, changes
    assert reads_of(NYULabelled(root, **usual, split="val")) == [0, 1]
    drawn = NYULabelled(root, **usual)
    drawn.draw_subset(1, seed=0)
    assert reads_of(drawn) == [0]
    assert reads_of(NYULabelled(root, **usual)) == []
    monkeypatch.setattr(cache_module, "VERSION", cache_module.VERSION + 1)
    assert reads_of(NYULabelled(root, **usual)) == every
    import cv2

    monkeypatch.setattr(cv2, "__version__", "99")
    assert reads_of(NYULabelled(root, **usual)) == every


def test_every_adapter_names_its_settings(tmp_path: Path) -> None:
    def pair(build: Builder, **change) -> None:
        one, other = build().frame_settings(), build(**change).frame_settings()
        assert one != other, change

    layouts.folder(tmp_path / "folder")
    pair(lambda **o: FolderDataset(tmp_path / "folder", max_depth=10, **o), intrinsics=[9, 9, 3, 4])
    pair(lambda **o: FolderDataset(tmp_path / "folder", max_depth=10, **o), encoding="tum")
    layouts.mat(tmp_path / "mat")
    pair(lambda **o: NYUMat(tmp_path / "mat", split="all", **o), ground_truth="raw")
    layouts.cityscapes_mtan(tmp_path / "mtan")
    pair(lambda **o: CityscapesMTAN(tmp_path / "mtan", val_frames=1, **o), inverse_scale=2.5)
    layouts.kitti_raw(tmp_path / "raw")
    raw = lambda **o: KITTIRaw(tmp_path / "raw", split="all", **o)  # noqa: E731
    pair(raw, projection="eigen")
    before = raw().frame_settings()
    file = tmp_path / "raw/2011_09_26/calib_velo_to_cam.txt"
    file.write_text(file.read_text().replace("-0.0763", "-0.0764"))
    assert raw().frame_settings() != before
    descriptions = {encoding.description for encoding in ENCODINGS.values()}
    assert len(descriptions) == len(ENCODINGS)


def test_a_changed_file_is_read_again_alone(tmp_path: Path) -> None:
    root, options = layouts.labelled(tmp_path), {"cache": "disk", "load_size": (12, 16)}
    assert len(reads_of(NYULabelled(root, **options))) == 2
    path = root / "data/nyu2_train/labeled_out/0030.png"
    old = path.stat()
    content = np.random.default_rng(1).integers(1, 255, (48, 64)).astype(np.uint8)
    while True:  # another picture of the same number of bytes, with the old time of change
        layouts.picture(path, content)
        size = path.stat().st_size
        if size <= old.st_size:
            path.write_bytes(path.read_bytes() + bytes(old.st_size - size))
            break
        content[np.random.default_rng(0).integers(0, 48)] = 90
        content[: content.shape[0] // 2] = 90
    os.utime(path, ns=(old.st_atime_ns, old.st_mtime_ns))
    again = NYULabelled(root, **options)
    index = again.names.index("labeled_out/0030")
    assert reads_of(again) == [index]
    assert same(again[index], NYULabelled(root, load_size=(12, 16))[index])
    assert reads_of(NYULabelled(root, **options)) == []


def test_changed_code_of_an_adapter_is_noticed(tmp_path: Path, monkeypatch) -> None:
    root = layouts.labelled(tmp_path / "data")
    module = tmp_path / "adapter_of_a_user.py"
    monkeypatch.syspath_prepend(str(tmp_path))
    base = "from eldenet.data.nyu import NYULabelled\n\n\nclass Mine(NYULabelled):\n    pass\n"
    counts = []
    for text in (base, base, base + "# a change\n"):
        module.write_text(text)
        sys.modules.pop("adapter_of_a_user", None)
        import adapter_of_a_user

        counts.append(len(reads_of(adapter_of_a_user.Mine(root, cache="disk"))))
    assert counts == [2, 0, 2]


def test_an_adapter_without_files_is_told_so() -> None:
    with pytest.raises(ValueError, match=r"SyntheticDepth does not say which files.*cache=ram"):
        SyntheticDepth(3, cache="disk")[0]


@pytest.mark.parametrize("wrong", [True, False, "memory"])
def test_an_unknown_cache_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match=f"cache={wrong!r}: give one of none, ram, disk"):
        SyntheticDepth(3, cache=wrong)


# --- kills, races, damage, no room --------------------------------------------------------------------------

SIDE = 300


def write_forever(path: Path, value: int, die_at: int | None = None) -> None:
    """Fill the four slots again and again; a process to be killed, or to kill itself half way in a write."""
    store = FrameStore(path, 4, HEADER + 7 * SIDE**2)
    write, calls = cache_module._write, 0

    def dying(handle: int, content: bytes, start: int) -> None:
        nonlocal calls
        calls += 1  # every second one is a header
        if calls == die_at:
            write(handle, content[: len(content) // 2], start)
            os.kill(os.getpid(), signal.SIGKILL)
        write(handle, content, start)

    cache_module._write = dying
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
    root = layouts.labelled(tmp_path)
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
    plain, cached = (NYULabelled(layouts.labelled(tmp_path), cache=kind) for kind in ("none", "disk"))
    cached.open_cache()
    store = cached._store
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
    plain, cached = (NYULabelled(layouts.labelled(tmp_path), cache=kind) for kind in ("none", "disk"))
    assert all(same(cached[0], plain[0]) for _ in range(2))
    assert caplog.text.count("no frame cache in") == 1


def test_the_log_says_where_and_how_large(tmp_path: Path, store_folder: Path, caplog) -> None:
    with caplog.at_level(logging.INFO, "eldenet"):
        NYULabelled(layouts.labelled(tmp_path), cache="disk")[0]
    assert str(store_folder) in caplog.text
    assert "0.00 GB once all 2 frames are in it" in caplog.text
    assert "remove the folder" in caplog.text


def test_memory_that_is_too_small_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(cache_module, "available_memory", lambda: 10_000)
    with pytest.raises(ValueError, match=r"cache=ram wants 0\.00 GB for 30 frames.*cache=disk"):
        SyntheticDepth(30, cache="ram")[0]


# --- many processes -----------------------------------------------------------------------------------------


class Counted(SyntheticDepth):
    """Notes every read of a frame in a file, whichever process reads it."""

    def __init__(self, notes: Path, frames: int, **options) -> None:
        super().__init__(frames, **options)
        self.notes = notes

    def frame_files(self, index: int) -> list[Path]:
        return [Path(__file__)]

    def load_frame(self, index: int) -> Frame:
        with self.notes.open("a") as file:
            file.write(f"{index}\n")
        return super().load_frame(index)

    def reads(self) -> int:
        return len(self.notes.read_text().splitlines())


@pytest.mark.parametrize("kind", ["ram", "disk"])
def test_workers_share_one_copy(kind: str, tmp_path: Path) -> None:
    frames = 24
    data = Counted(tmp_path / "notes", frames, cache=kind, transform=Augmentation(affine=0.0))
    plain = SyntheticDepth(frames, transform=Augmentation(affine=0.0))
    sampler = EpochSampler(frames, 4, seed=0)
    loader = training_loader(data, sampler, workers=2)
    for epoch in range(3):
        sampler.epoch = epoch
        seen = 0
        for batch in loader:
            for row, name in enumerate(batch["name"]):
                expected = plain[epoch, int(name.split("/")[1])]
                assert torch.equal(batch["image"][row], expected["image"])
                assert torch.equal(batch["depth"][row], expected["depth"])
                seen += 1
        assert seen == frames
        # one more told the size; which worker has which frame changes with every epoch
        assert data.reads() == frames + 1
    assert all(same(data[5, index], plain[5, index]) for index in range(frames))  # and so does this process
    assert data.reads() == frames + 1


def test_a_copy_has_a_memory_of_its_own(tmp_path: Path) -> None:
    data = Counted(tmp_path / "notes", 3, cache="ram")
    first = data[0]
    other = copy.deepcopy(data)
    assert same(other[0], first)
    assert same(data[0], first)


def test_no_worker_outlives_its_loader(tmp_path: Path) -> None:
    data = SyntheticDepth(6)
    model = ConstantPredictor(torch.full((1, 1, 32, 48), 4.0))
    alone = evaluate(model, data, PROTOCOL, batch_size=4)
    assert evaluate(model, data, PROTOCOL, batch_size=4, workers=2) == alone
    assert multiprocessing.active_children() == []
    train(tmp_path, workers=1)
    assert multiprocessing.active_children() == []


def train(folder: Path, *, cache: str = "none", workers: int = 0, epochs: int = 2, **options):
    seed_everything(0)
    folder.mkdir(exist_ok=True)
    resources = Resources(device="cpu", precision="fp32", threads=1, workers=workers, cores=2)
    data = Counted(folder / "notes", 12, cache=cache, transform=Augmentation())
    loss = WeightedSum({"l1": WeightedTerm(L1Loss())})
    trainer = make_trainer(epochs=epochs, checkpoint_every=1)
    model = eldenet.load("eldenet_s").train()
    return trainer.fit(model, data, SyntheticDepth(4), loss, PROTOCOL, folder, resources, **options)


def test_cached_training_is_the_training_resumed_too(tmp_path: Path, monkeypatch) -> None:
    train(tmp_path / "plain")
    train(tmp_path / "ram", cache="ram", workers=1)
    assert digest(tmp_path / "ram") == digest(tmp_path / "plain")

    class Stopped(Exception):
        pass

    def stop(self, batch, *, update, count=[0]):  # noqa: B006
        count[0] += 1
        if count[0] == 5:
            raise Stopped
        return original(self, batch, update=update)

    original = Trainer.train_step
    monkeypatch.setattr(Trainer, "train_step", stop)
    with pytest.raises(Stopped):
        train(tmp_path / "disk", cache="disk")
    monkeypatch.setattr(Trainer, "train_step", original)
    train(tmp_path / "disk", cache="disk", workers=1, ckpt_path=tmp_path / "disk")
    assert digest(tmp_path / "disk") == digest(tmp_path / "plain")


def test_the_wait_for_data_is_counted(tmp_path: Path) -> None:
    class Slow(SyntheticDepth):
        def load_frame(self, index: int) -> Frame:
            time.sleep(0.05)
            return super().load_frame(index)

    loss = WeightedSum({"l1": WeightedTerm(L1Loss())})
    resources = Resources(device="cpu", precision="fp32", threads=1, workers=0, cores=2)
    model = eldenet.load("eldenet_s").train()
    progress = make_trainer(epochs=1).fit(
        model, Slow(8), SyntheticDepth(2), loss, PROTOCOL, tmp_path, resources
    )
    assert 0.4 <= progress.waited < 5


def test_encodings_travel_to_workers() -> None:
    for encoding in ENCODINGS.values():
        assert pickle.loads(pickle.dumps(encoding)) == encoding

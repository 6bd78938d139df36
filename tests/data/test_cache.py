"""Cached frames are the frames: to the last digit, after any change, kill or race; one copy serves all."""

import os
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support import layouts
from support.damaged_layouts import LAYOUTS
from support.frame_caches import count_reads, reads_of, same
from support.synthetic import SyntheticDepth

from eldenet.compose import compose
from eldenet.data import cache as cache_module
from eldenet.data.base import DepthDataset
from eldenet.data.cityscapes import CityscapesMTAN
from eldenet.data.folder import FolderDataset
from eldenet.data.frame_store import HEADER
from eldenet.data.io import ENCODINGS
from eldenet.data.kitti import KITTIRaw
from eldenet.data.nyu import NYULabelled
from eldenet.data.nyu_hdf5 import NYUMat
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.train import TrainSettings

pytestmark = pytest.mark.usefixtures("store_folder")


@pytest.mark.parametrize("name", sorted({layout.data: name for name, layout in LAYOUTS.items()}.values()))
def test_cached_samples_are_the_samples(name: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(layouts, "KITTI_SIZES", {"2011_09_26": (60, 80), "2011_09_28": (56, 84)})
    layout = LAYOUTS[name]
    config = compose(TrainSettings, layout.given(tmp_path))
    part = config.data[layout.split]

    def build(cache: str, resize_on_load: tuple[int, int] | None) -> DepthDataset:
        part.update(cache=cache, resize_on_load=resize_on_load)
        return open_split(
            config.data,
            layout.split,
            chosen_protocol(config.data, config.protocol),
            augmentation=config.augmentation if layout.split == "train" else None,
        )

    # frames of their own sizes, as KITTI's, and frames made small
    for size in (None, (30, 40)):
        plain, cached = build("none", size), build("disk", size)
        expected = [plain[3, index] for index in range(len(plain))]
        assert all(same(cached[3, index], expected[index]) for index in range(len(plain)))
        later = build("disk", size)
        later.open_cache()
        reads = count_reads(later)
        assert all(same(later[3, index], expected[index]) for index in range(len(plain)))
        assert reads == []


def test_ground_truth_keeps_its_own_size(tmp_path: Path) -> None:
    options = {"resize_on_load": (12, 16), "resize_depth": False}
    plain = NYULabelled(layouts.labeled(tmp_path), **options)
    cached = NYULabelled(tmp_path, cache="disk", **options)
    assert all(same(cached[0], plain[0]) for _ in range(2))
    assert cached[0]["depth"].shape == (1, 48, 64)


def test_a_frame_that_is_too_large_is_read_each_time(tmp_path: Path, caplog) -> None:
    layouts.folder(tmp_path, count=3)
    large = layouts.content((60, 80))
    layouts.picture(tmp_path / "images/f002.png", large.rgb)
    layouts.picture(tmp_path / "depths/f002.png", large.millimeters)
    plain, cached = (FolderDataset(tmp_path, max_depth=10, cache=cache) for cache in ("none", "disk"))
    for _ in range(2):
        assert all(same(cached[index], plain[index]) for index in range(3))
    assert caplog.text.count("larger than the first frame") == 1


# --- what makes a frame be read again -----------------------------------------------------------------------


def test_changed_settings_read_everything_again(tmp_path: Path, monkeypatch) -> None:
    root = layouts.labeled(tmp_path)
    usual = {"cache": "disk", "resize_on_load": (12, 16)}
    every = list(range(len(NYULabelled(root))))
    assert reads_of(NYULabelled(root, **usual)) == every
    assert reads_of(NYULabelled(root, **usual, max_depth=5.0, seed=7, input_size=(6, 8))) == []  # come later
    for changes in (
        {"resize_on_load": (13, 16)},
        {"encoding": "nyu8"},
        {"resize_depth": False},
        {"resize_on_load": None},
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
    def pair(build: Callable[..., DepthDataset], **change) -> None:
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
    root, options = layouts.labeled(tmp_path), {"cache": "disk", "resize_on_load": (12, 16)}
    assert len(reads_of(NYULabelled(root, **options))) == 2
    path = root / "data/nyu2_train/labeled_out/0030.png"
    old = path.stat()
    layouts.picture(path, np.full((48, 64), 90, np.uint8))
    path.write_bytes(path.read_bytes().ljust(old.st_size, b"\0"))  # as many bytes as before, at the old time
    os.utime(path, ns=(old.st_atime_ns, old.st_mtime_ns))
    again = NYULabelled(root, **options)
    index = again.names.index("labeled_out/0030")
    assert reads_of(again) == [index]
    assert same(again[index], NYULabelled(root, resize_on_load=(12, 16))[index])
    assert reads_of(NYULabelled(root, **options)) == []


def test_frames_are_cached_without_the_calls_that_windows_lacks(tmp_path: Path, monkeypatch) -> None:
    for name in ("pread", "pwrite", "O_CLOEXEC"):
        monkeypatch.delattr(os, name)
    root, options = layouts.labeled(tmp_path), {"cache": "disk", "resize_on_load": (12, 16)}
    assert len(reads_of(NYULabelled(root, **options))) == 2
    again = NYULabelled(root, **options)
    assert reads_of(again) == []
    assert same(again[0], NYULabelled(root, resize_on_load=(12, 16))[0])


def test_changed_code_of_an_adapter_is_noticed(tmp_path: Path, monkeypatch) -> None:
    root = layouts.labeled(tmp_path / "data")
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
    with pytest.raises(ValueError, match=r"SyntheticDepth has no frame_files method.*cache=none"):
        SyntheticDepth(3, cache="disk")[0]


@pytest.mark.parametrize("wrong", [True, False, "ram"])
def test_an_unknown_cache_is_refused(wrong) -> None:
    with pytest.raises(ValueError, match=f"cache={wrong!r}: give one of none, disk"):
        SyntheticDepth(3, cache=wrong)


# --- damage and full disks ----------------------------------------------------------------------------------


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

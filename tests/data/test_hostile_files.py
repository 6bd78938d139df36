"""Files made to hang, to fill the memory or to lead elsewhere end at once, in one line that names them."""

import errno
import os
import struct
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from support import layouts

from eldenet.data.array_files import PIXEL_VARIABLE, read_array
from eldenet.data.folder import FolderDataset
from eldenet.data.io import read_depth, read_image
from eldenet.data.nyu import NYUSync
from eldenet.data.nyu_hdf5 import NYUHDF5
from eldenet.data.rooms import Rooms
from eldenet.perception.kitti_object import read_labels


def png_header(side: int) -> bytes:
    """Of a picture of ``side`` x ``side``, with one row of zeros as all of its pixels."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(bytes(side))) + chunk(b"IEND", b"")


@pytest.mark.parametrize("ending", [".png", ".bmp", ".ppm", ".tif", ".jpg", ".npy", ".pfm", ".exr"])
def test_pixels_are_counted_before_they_are_read(ending: str, tmp_path: Path, monkeypatch) -> None:
    path = tmp_path / f"a{ending}"
    if ending == ".npy":
        np.save(path, np.ones((37, 53), np.float32))
    elif ending == ".pfm":
        path.write_bytes(b"Pf\n53 37\n-1\n" + np.ones((37, 53), "<f4").tobytes())
    elif ending == ".exr":
        OpenEXR = pytest.importorskip("OpenEXR")
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Z": np.ones((37, 53), np.float32)}).write(str(path))
    else:
        layouts.picture(path, np.full((37, 53, 3), 90, np.uint8))
    read = read_image if ending in (".png", ".bmp", ".ppm", ".tif", ".jpg") else read_depth
    more = () if read is read_image else ("meters",)
    monkeypatch.setenv(PIXEL_VARIABLE, str(37 * 53))
    assert read(path, *more).shape[:2] == (37, 53)
    monkeypatch.setenv(PIXEL_VARIABLE, str(37 * 53 - 1))
    with pytest.raises(ValueError, match=rf"a\{ending} has .*37 x 53.*{PIXEL_VARIABLE}"):
        read(path, *more)


def test_a_small_file_of_a_huge_picture_is_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png_header(30_000))
    start = time.process_time()
    with pytest.raises(ValueError, match=r"a\.png has 30000 x 30000 values, more than 100,000,000 pixels"):
        read_image(tmp_path / "a.png")
    assert time.process_time() - start < 1


def test_a_header_of_spaces_does_not_hang(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5" + b" " * 100_000)
    with pytest.raises(ValueError, match="incomplete header"):
        read_image(tmp_path / "a.pgm")


def test_arrays_hold_numbers(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array(["a", "b"]))
    with pytest.raises(ValueError, match=r"a\.npy .*not numbers"):
        read_array(tmp_path / "a.npy")


@pytest.mark.parametrize("kind", ["external link", "soft link", "external storage"])
def test_hdf5_files_lead_nowhere_else(kind: str, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    root = layouts.hdf5(tmp_path / "data")
    path = sorted((root / "train").rglob("*.h5"))[0]
    (tmp_path / "secret").write_bytes(bytes(100_000))
    with h5py.File(path, "a") as file:
        depth = file["depth"][()]
        del file["depth"]
        if kind == "external link":
            file["depth"] = h5py.ExternalLink(str(tmp_path / "secret"), "/depth")
        elif kind == "soft link":
            file["depth"] = h5py.SoftLink("/rgb")
        else:
            file.create_dataset(
                "depth", depth.shape, "f4", external=[(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
            )
    data = NYUHDF5(root, split="trainval")
    with pytest.raises(ValueError, match=rf"{path.name}.*'depth' is a link or lies in another file"):
        data.load_frame(data.names.index(path.relative_to(root).with_suffix("").as_posix()))


@pytest.mark.parametrize("file", ["../other/f000.png", "depths/../../x.png", "/etc/x.png"])
def test_lists_stay_in_the_data_sets_folder_unless_allowed(file: str, tmp_path: Path) -> None:
    root = layouts.folder(tmp_path / "data")
    (root / "list.csv").write_text(f"images/f000.png,{file}\n")
    with pytest.raises(ValueError, match=r"list\.csv: .* is outside .*allow_outside=true"):
        FolderDataset(root, csv="list.csv", max_depth=10.0)
    with pytest.raises(FileNotFoundError, match="files are missing"):
        FolderDataset(root, csv="list.csv", max_depth=10.0, allow_outside=True)
    (root / "list.txt").write_text(f"a/../../rgb.jpg {file}\n")
    with pytest.raises(ValueError, match=r"list\.txt: .* is outside"):
        NYUSync(root, list_file=root / "list.txt")


def test_damaged_labels_are_named(tmp_path: Path) -> None:
    label = tmp_path / "000000.txt"
    for content in (b"\xff\xfe\0", b"Car" + b" 1" * 13, b"Car" + b" nan" * 14):
        label.write_bytes(content)
        with pytest.raises(ValueError, match=r"000000\.txt"):
            read_labels(label)


def test_a_full_disk_is_one_line_of_the_rooms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OSError, match=r"rooms-v\S+ cannot store rendered frames \(No space left on device\)"):
        Rooms("train", 8, size=(16, 16), root=tmp_path, workers=0)

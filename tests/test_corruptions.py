"""Five hundred seeded corruptions: one clear error naming the file, or a counted skip; never a wrong sample.

What cannot be told from a good file is left out: numbers changed within pixels that carry no check sum.
"""

import json
import shutil
import struct
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import h5py
import layouts
import numpy as np
import pytest
from scipy.io import loadmat, savemat

from eldenet.config import build_protocol, build_split, compose

CASES = 500
RNG = np.random.default_rng

Damage = Callable[[Path, np.random.Generator], None]


class Target(NamedTuple):
    """A file, what may happen to it, and the frames that are lost then; None: the whole data set."""

    file: str
    damages: Sequence[Damage]
    lost: tuple[str, ...] | None
    named: str | None = None  # what the message says, where it is not the file's stem


class Layout(NamedTuple):
    data: str
    write: Callable[[Path], list[str]]
    targets: Sequence[Target]
    split: str = "train"


# --- what may happen to any file ---------------------------------------------------------------------------


def cut(path: Path, generator: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: generator.integers(1, len(content) - 2)])


def empty(path: Path, _: np.random.Generator) -> None:
    path.write_bytes(b"")


def gone(path: Path, _: np.random.Generator) -> None:
    path.unlink()


def folder_instead(path: Path, _: np.random.Generator) -> None:
    path.unlink()
    path.mkdir()


def web_page(path: Path, _: np.random.Generator) -> None:
    path.write_bytes(b"<!DOCTYPE html><html><body>404: you are not logged in</body></html>\n" * 16)


def wrong_start(path: Path, generator: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(generator.bytes(8).replace(b"\xff", b"\0") + content[8:])


def zeros_at(path: Path, generator: np.random.Generator, first: int, last: int) -> None:
    content = bytearray(path.read_bytes())
    at = int(generator.integers(first, max(first + 1, last)))
    content[at : at + 64] = bytes(len(content[at : at + 64]))
    path.write_bytes(content)


def zeros(path: Path, generator: np.random.Generator) -> None:
    zeros_at(path, generator, 0, path.stat().st_size - 64)


def flipped_bit(path: Path, generator: np.random.Generator) -> None:
    """Of a file under a check sum (PNG)."""
    content = bytearray(path.read_bytes())
    content[generator.integers(len(content))] ^= 1 << int(generator.integers(8))
    path.write_bytes(content)


ANY = (cut, empty, gone, folder_instead, web_page, wrong_start)


# --- to pictures --------------------------------------------------------------------------------------------


def picture(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def write(path: Path, array: np.ndarray, kind: str | None = None) -> None:
    ok, content = cv2.imencode(kind or path.suffix, array)
    assert ok
    path.write_bytes(content.tobytes())


def other_depth(path: Path, _: np.random.Generator) -> None:
    """Sixteen bits where eight are due, and the other way round."""
    old = picture(path)
    new = old.astype(np.uint16) * 257 if old.dtype == np.uint8 else (old // 257).astype(np.uint8)
    write(path, new, ".png")


def more_channels(path: Path, _: np.random.Generator) -> None:
    old = picture(path)
    eight = old if old.dtype == np.uint8 else (old // 257 + 1).astype(np.uint8)
    write(path, cv2.applyColorMap(eight, cv2.COLORMAP_JET))


def grey(path: Path, _: np.random.Generator) -> None:
    write(path, cv2.cvtColor(picture(path), cv2.COLOR_BGR2GRAY))


def turned(path: Path, _: np.random.Generator) -> None:
    write(path, np.ascontiguousarray(picture(path).swapaxes(0, 1)))


def halved(path: Path, _: np.random.Generator) -> None:
    write(path, np.ascontiguousarray(picture(path)[::2, ::2]))


PNG = (*ANY, cut, zeros, flipped_bit)
DEPTH_PNG = (*PNG, other_depth, more_channels, turned, halved)
COLOUR_PNG = (*PNG, other_depth, grey, turned, halved)


def zeros_in_pixels(path: Path, generator: np.random.Generator) -> None:
    """Of a JPEG: after its tables, which are as good with a zero."""
    content = path.read_bytes()
    zeros_at(path, generator, content.index(b"\xff\xda") + 14, len(content) - 80)


COLOUR_JPG = (*ANY, cut, zeros_in_pixels, other_depth, grey, turned, halved)


# --- to arrays ----------------------------------------------------------------------------------------------


def array(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        np.save(path, change(np.load(path)))

    return damage


def as_npz(path: Path, _: np.random.Generator) -> None:
    values = np.load(path)
    with path.open("wb") as file:
        np.savez(file, depth=values)


def as_objects(path: Path, _: np.random.Generator) -> None:
    np.save(path, np.array([{"depth": 1}], dtype=object), allow_pickle=True)


def zeros_in_header(path: Path, generator: np.random.Generator) -> None:
    zeros_at(path, generator, 0, 50)


NPY = (
    *ANY,
    cut,
    as_npz,
    as_objects,
    zeros_in_header,
    array(lambda a: a[:-1]),
    array(lambda a: a[None, None]),
)
NAN = array(lambda a: np.full_like(a, np.nan))
NEGATIVE = array(lambda a: -a)
INFINITE = array(lambda a: np.full_like(a, np.inf))
DEPTH_NPY = (*NPY, NAN, NEGATIVE, INFINITE, array(lambda a: (a * 1000).astype(np.uint16)))
MTAN_IMAGE = (*NPY, NAN, array(lambda a: a * 255), array(lambda a: a[..., 0]), array(lambda a: a - 0.5))
MTAN_DEPTH = (*NPY, NAN, NEGATIVE, INFINITE, array(lambda a: a * 80))


def pfm(path: Path, metres: np.ndarray) -> None:
    height, width = metres.shape
    path.write_bytes(b"Pf\n%d %d\n-1.0\n" % (width, height) + metres[::-1].astype("<f4").tobytes())


def pfm_header(text: bytes) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        content = path.read_bytes()
        path.write_bytes(text + content[content.index(b"-1.0\n") + 5 :])

    return damage


PFM = (
    *ANY,
    cut,
    *map(pfm_header, (b"Pf\n64 48\n", b"PF\n64 48\n-1\n", b"Pf\n64 48\n--\n", b"Pf\n48 64\n-1\n")),
)


def exr(path: Path, metres: np.ndarray) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": metres.astype(np.float32)}).write(str(path))


# --- to HDF5, .mat and tar ----------------------------------------------------------------------------------


def hdf5(change: Callable[[h5py.File], None]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        with h5py.File(path, "r+") as file:
            change(file)

    return damage


def replaced(key: str, change: Callable[[np.ndarray], Any]) -> Damage:
    def damage(file: h5py.File) -> None:
        new = change(file[key][()])
        del file[key]
        file[key] = new

    return hdf5(damage)


def without(key: str) -> Damage:
    def damage(file: h5py.File) -> None:
        del file[key]

    return hdf5(damage)


def group(key: str) -> Damage:
    def damage(file: h5py.File) -> None:
        del file[key]
        file.create_group(key)

    return hdf5(damage)


def zeros_in_tables(path: Path, generator: np.random.Generator) -> None:
    """Over the superblock of an HDF5 file."""
    zeros_at(path, generator, 0, 8)


H5 = (
    *(*ANY, cut, cut, zeros_in_tables, without("rgb"), without("depth"), group("rgb"), group("depth")),
    *(replaced("rgb", lambda a: a.astype(np.uint16)), replaced("rgb", lambda a: a.transpose(1, 2, 0))),
    *(
        replaced("rgb", lambda a: a[0]),
        replaced("depth", lambda a: a.T),
        replaced("depth", lambda a: a[None]),
    ),
    *(replaced("depth", lambda a: -a), replaced("depth", lambda a: a * np.nan)),
    *(replaced("depth", lambda a: a * 1000), replaced("depth", lambda a: (a * 1000).astype(np.uint16))),
)
MAT = (
    *(
        *ANY,
        cut,
        cut,
        zeros_in_tables,
        without("images"),
        without("depths"),
        group("images"),
        group("depths"),
    ),
    *(replaced("images", lambda a: a.astype(np.float32)), replaced("images", lambda a: a[:, 0])),
    *(replaced("depths", lambda a: a.swapaxes(1, 2)), replaced("depths", lambda a: a[1:])),
    *(replaced("images", lambda a: a[:3]), replaced("depths", lambda a: a[0])),
)


def in_frame(number: int, change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(file: h5py.File) -> None:
        file["depths"][number - 1] = change(file["depths"][number - 1])

    return hdf5(damage)


def split(change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        savemat(path, change({key: loadmat(path)[key] for key in ("trainNdxs", "testNdxs")}))

    return damage


SPLITS_MAT = (
    *(empty, gone, folder_instead, web_page),
    split(lambda s: {"trainNdxs": s["trainNdxs"]}),
    split(lambda s: {"testNdxs": s["testNdxs"]}),
    split(lambda s: s | {"trainNdxs": s["trainNdxs"] * 0}),
    split(lambda s: s | {"trainNdxs": s["testNdxs"]}),
    split(lambda s: s | {"testNdxs": np.array([["a"]])}),
)


def cut_split(path: Path, generator: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: generator.integers(130, len(content) - 60)])  # before the second list ends


def tar_header(path: Path, _: np.random.Generator) -> None:
    """The header of the file in it is zeros: that looks like the end of an archive."""
    content = bytearray(path.read_bytes())
    start = content.index(b"\x89HDF") - 512
    content[start : start + 512] = bytes(512)
    path.write_bytes(content)


def tar_cut(path: Path, generator: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: generator.integers(600, len(content) - 12000)])


TAR = (empty, web_page, folder_instead, tar_header, tar_cut, tar_cut, tar_cut)


def member(change: Damage) -> Damage:
    """The one HDF5 file within a shard, damaged without changing its length."""

    def damage(path: Path, generator: np.random.Generator) -> None:
        content = bytearray(path.read_bytes())
        start = content.index(b"\x89HDF")
        size = int(content[start - 512 + 124 : start - 512 + 135], 8)
        part = path.with_name("member.h5")
        part.write_bytes(content[start : start + size])
        change(part, generator)
        new = part.read_bytes()
        part.unlink()
        content[start : start + size] = new[:size].ljust(size, b"\0")
        path.write_bytes(content)

    return damage


# --- to text ------------------------------------------------------------------------------------------------


def text(change: Callable[[str], str]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        path.write_text(change(path.read_text()))

    return damage


def binary(path: Path, generator: np.random.Generator) -> None:
    path.write_bytes(b"\xff\xfe\x00" + generator.bytes(200))


def keys(change: Callable[[dict], None]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return damage


def cut_before(mark: str) -> Damage:
    """Cut at a random place before the last number (or bracket) that is needed, which follows ``mark``."""

    def damage(path: Path, generator: np.random.Generator) -> None:
        content = path.read_text()
        path.write_text(content[: generator.integers(1, content.index(mark))])

    return damage


def cut_in_line(path: Path, generator: np.random.Generator) -> None:
    """Cut a list within its last line."""
    content = path.read_text().rstrip("\n")
    path.write_text(content[: generator.integers(content.rindex("\n") + 2, len(content) - 1)])


TEXT = (empty, gone, folder_instead, web_page, binary, zeros)
LIST = (*TEXT, cut_in_line, cut_in_line, text(lambda t: t.replace(",", ";")), text(lambda t: t + "a,b,c\n"))
CAMERA = (
    *(*TEXT, cut_before("}}"), cut_before("}}"), keys(lambda c: c["extrinsic"].pop("baseline"))),
    *(keys(lambda c: c["intrinsic"].pop("fx")), keys(lambda c: c.pop("extrinsic"))),
    *(keys(lambda c: c["intrinsic"].update(fx=-1)), keys(lambda c: c["intrinsic"].update(u0=float("nan")))),
    *(keys(lambda c: c["extrinsic"].update(baseline=0)), keys(lambda c: c["intrinsic"].update(fy=None))),
    keys(lambda c: c["extrinsic"].update(baseline=float("inf"))),
)
CAM_TO_CAM = (
    *(
        *TEXT[:-1],
        cut_before("0.2163791"),
        cut_before("0.2163791"),
        text(lambda t: t.replace("P_rect_02", "P")),
    ),
    *(text(lambda t: t.replace("721.5377", "x", 1)), text(lambda t: t.replace("721.5377", "nan"))),
    *(text(lambda t: t.replace("721.5377", "0")), text(lambda t: t.replace(" 1 0.0027", " 0.0027"))),
)
VELO_TO_CAM = (
    *(
        *TEXT,
        cut_before("-0.0763"),
        text(lambda t: t.replace("R:", "S:")),
        text(lambda t: t.replace("T:", "U:")),
    ),
    *(text(lambda t: t.replace("-0.0763", "inf")), text(lambda t: t.replace("T: 0 ", "T: "))),
)
INTRINSICS = (
    *(empty, folder_instead, web_page, binary, zeros, cut_before("149.854"), cut_before("0 0 1")),
    *(text(lambda t: t.replace("721", "-721")), text(lambda t: t.replace("149.854", "nan"))),
)


# --- to LiDAR scans -----------------------------------------------------------------------------------------


def scan(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        change(np.fromfile(path, "<f4").reshape(-1, 4)).tofile(path)

    return damage


def scan_cut(path: Path, generator: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: 16 * generator.integers(len(content) // 16) + generator.integers(1, 16)])


def spaces(path: Path, _: np.random.Generator) -> None:
    path.write_bytes(b" " * 1600)  # as floats: points within a nanometre


SCAN = (
    *(
        empty,
        folder_instead,
        web_page,
        spaces,
        scan_cut,
        scan_cut,
        scan_cut,
        scan(lambda p: p * np.float32("nan")),
    ),
    *(scan(lambda p: p.byteswap()), scan(lambda p: p.astype(np.float64)), scan(lambda p: p * 1e6)),
    scan(lambda p: np.vstack([p, [[np.inf, 0, 0, 0]]]).astype(np.float32)),
)


def without_gone(damages: Sequence[Damage]) -> Sequence[Damage]:
    """Where the files make the list of frames, none is missed."""
    return [damage for damage in damages if damage is not gone]


# --- the layouts, with small frames -------------------------------------------------------------------------

NYU_FRAME = layouts.SMALL
DRIVE = layouts.DRIVES[0]
DEVKIT = f"depth/train/{DRIVE}/proj_depth/groundtruth/image_02/0000000005.png"
RAW_PICTURE = "raw/2011_09_26/{}/image_02/data/{:010d}.png"
KITTI_NAME = f"{DRIVE}/image_02/{{:010d}}"
CITY = "train/aachen/aachen_000000_000019"


def folder_of(ending: str, encoding: str) -> Callable[[Path], list[str]]:
    """Pictures with depth in files of another kind."""
    writers = {".npy": np.save, ".pfm": pfm, ".exr": exr, ".tiff": layouts.picture}

    def make(root: Path) -> list[str]:
        for i in range(3):
            layouts.picture(root / f"images/f{i}.png", NYU_FRAME.rgb)
            (root / "depths").mkdir(exist_ok=True)
            writers[ending](root / f"depths/f{i}{ending}", NYU_FRAME.metres)
        return [f"data.root={root}", f"data.encoding={encoding}", "data.train.split=all"]

    return make


def csv_folder(root: Path) -> list[str]:
    layouts.folder(root, count=3)
    (root / "pairs.csv").write_text("".join(f"images/f{i:03d}.png,depths/f{i:03d}.png\n" for i in range(3)))
    return [f"data.root={root}", "data.csv=pairs.csv", "data.train.split=all"]


def sync_list(root: Path) -> list[str]:
    layouts.sync(root)
    frames = [
        f"/{scene}/rgb_{n}.jpg /{scene}/sync_depth_{n}.png 518.8579" for scene, n in layouts.SYNC_FRAMES
    ]
    (root / "list.txt").write_text("\n".join(frames) + "\n")
    return [f"data.root={root}", "data.train.split=all", f"+data.train.list_file={root / 'list.txt'}"]


def mat(root: Path) -> list[str]:
    layouts.mat(root)
    return [f"data.root={root}", "data.train.split=trainval", "data.ground_truth=inpainted"]


def eigen(root: Path) -> list[str]:
    layouts.kitti_depth(root)
    listed = layouts.eigen_list(root / "frames.txt", layouts.DRIVES)
    return [f"data.root={root / 'depth'}", "data.train.split=all", f"+data.train.list_file={listed}"]


def kitti(root: Path) -> list[str]:
    return [f"data.root={layouts.kitti_depth(root)}", "data.train.split=trainval"]


def kitti_raw(root: Path) -> list[str]:
    return [f"data.root={layouts.kitti_raw(root / 'raw')}", "data.train.split=all"]


def kitti_selection(root: Path) -> list[str]:
    selection = layouts.kitti_selection(root)
    return [f"data.selection_root={selection}", "data.frames=null", "+data.ground_truth=improved"]


def densedepth(root: Path) -> list[str]:
    return [f"data.root={layouts.densedepth(root)}", "data.train.split=trainval"]


def labelled(root: Path) -> list[str]:
    return [f"data.root={layouts.labelled(root)}", "data.train.split=all"]


def sync(root: Path) -> list[str]:
    return [f"data.root={layouts.sync(root)}", "data.train.split=all"]


def h5_frames(root: Path) -> list[str]:
    return [f"data.root={layouts.hdf5(root)}", "data.train.split=trainval"]


def tar(root: Path) -> list[str]:
    return [f"data.root={layouts.tar(root)}", "data.train.split=trainval", f"data.index={root / 'index'}"]


def folder(root: Path) -> list[str]:
    return [f"data.root={layouts.folder(root, count=3)}", "data.train.split=all"]


def cityscapes(root: Path) -> list[str]:
    return [f"data.root={layouts.cityscapes(root)}", "data.train.split=trainval"]


def mtan(root: Path) -> list[str]:
    return [f"data.root={layouts.cityscapes_mtan(root, (48, 64))}", "data.train.split=trainval"]


EXTRA_FLOAT = (turned, halved)
LAYOUTS = {
    "densedepth": Layout(
        "nyu_densedepth",
        densedepth,
        (
            Target("data/nyu2_train/office_0002_out/1.jpg", COLOUR_JPG, ("office_0002_out/1",)),
            Target("data/nyu2_train/office_0002_out/1.png", DEPTH_PNG, ("office_0002_out/1",)),
            Target("data/nyu2_train.csv", LIST, None, "nyu2_train|office_0002|data set/dat"),
        ),
    ),
    "labelled": Layout(
        "nyu_labelled",
        labelled,
        (
            Target("data/nyu2_train/labeled_out/0022.jpg", COLOUR_JPG, ("labeled_out/0022",)),
            Target("data/nyu2_train/labeled_out/0022.png", DEPTH_PNG, ("labeled_out/0022",)),
        ),
    ),
    "sync": Layout(
        "nyu_sync",
        sync,
        (
            Target("office_0002/rgb_00041.jpg", COLOUR_JPG, ("office_0002/rgb_00041",)),
            Target("office_0002/sync_depth_00041.png", DEPTH_PNG, ("office_0002/rgb_00041",)),
        ),
    ),
    "sync_list": Layout(
        "nyu_sync",
        sync_list,
        (Target("list.txt", (*TEXT, text(lambda t: t.replace("518", "x"))), None, "list.txt|/html"),),
    ),
    "hdf5": Layout(
        "nyu_hdf5",
        h5_frames,
        (Target("train/office_0002/00001.h5", without_gone(H5), ("train/office_0002/00001",)),),
    ),
    "mat": Layout(
        "nyu_mat",
        mat,
        (
            Target("nyu_depth_v2_labeled.mat", MAT, None),
            Target("splits.mat", (*SPLITS_MAT, cut_split, cut_split), None),
            Target(
                "nyu_depth_v2_labeled.mat",
                (
                    in_frame(3, np.negative),
                    in_frame(3, lambda a: a * np.nan),
                    in_frame(3, lambda a: a * 1000),
                ),
                ("0003",),
            ),
        ),
    ),
    "tar": Layout(
        "nyu_tar",
        tar,
        (
            Target("data/train-000001.tar", TAR, ("data/train-000001.tar",)),
            Target(
                "data/train-000001.tar",
                (member(empty), member(web_page), member(zeros_in_tables), member(wrong_start), member(cut)),
                ("train/office_0002/00001",),
            ),
        ),
    ),
    "folder": Layout(
        "folder",
        folder,
        (
            Target("images/f001.png", [d for d in COLOUR_PNG if d is not grey], ("f001",)),
            Target("depths/f001.png", DEPTH_PNG, ("f001",)),
        ),
    ),
    "folder_csv": Layout("folder", csv_folder, (Target("pairs.csv", LIST, None, "pairs.csv|f002|depths"),)),
    "folder_npy": Layout(
        "folder", folder_of(".npy", "metres"), (Target("depths/f1.npy", DEPTH_NPY, ("f1",)),)
    ),
    "folder_pfm": Layout("folder", folder_of(".pfm", "metres"), (Target("depths/f1.pfm", PFM, ("f1",)),)),
    "folder_exr": Layout("folder", folder_of(".exr", "metres"), (Target("depths/f1.exr", ANY, ("f1",)),)),
    "folder_tiff": Layout(
        "folder",
        folder_of(".tiff", "metres"),
        (Target("depths/f1.tiff", (*ANY, *EXTRA_FLOAT), ("f1",)),),
    ),
    "kitti": Layout(
        "kitti",
        kitti,
        (
            Target(DEVKIT, without_gone(DEPTH_PNG), (KITTI_NAME.format(5),)),
            Target(
                RAW_PICTURE.format(DRIVE, 5),
                without_gone(COLOUR_PNG),
                (KITTI_NAME.format(5),),
            ),
            Target("raw/2011_09_26/calib_cam_to_cam.txt", CAM_TO_CAM, None),
        ),
    ),
    "kitti_list": Layout(
        "kitti",
        eigen,
        (
            Target(
                "frames.txt",
                (*TEXT, text(lambda t: t + t), text(lambda t: t.replace("image_02", "image_99"))),
                None,
            ),
        ),
    ),
    "kitti_raw": Layout(
        "kitti_raw",
        kitti_raw,
        (
            Target(
                f"raw/2011_09_26/{DRIVE}/velodyne_points/data/0000000069.bin", SCAN, (KITTI_NAME.format(69),)
            ),
            Target(
                RAW_PICTURE.format(DRIVE, 69),
                [d for d in COLOUR_PNG if d not in (turned, halved)],
                (KITTI_NAME.format(69),),
            ),
            Target("raw/2011_09_26/calib_velo_to_cam.txt", VELO_TO_CAM, None),
            Target("raw/2011_09_26/calib_cam_to_cam.txt", CAM_TO_CAM, None),
        ),
    ),
    "kitti_selection": Layout(
        "kitti_selection",
        kitti_selection,
        (
            Target(
                f"val_selection_cropped/intrinsics/{layouts.VAL_DRIVE}_image_0000000008_image_02.txt",
                INTRINSICS,
                (f"{layouts.VAL_DRIVE}/image_02/0000000008",),
            ),
            Target(
                f"val_selection_cropped/groundtruth_depth/{layouts.VAL_DRIVE}_groundtruth_depth_0000000008"
                "_image_02.png",
                DEPTH_PNG,
                (f"{layouts.VAL_DRIVE}/image_02/0000000008",),
                "0000000008",
            ),
        ),
        "test",
    ),
    "cityscapes": Layout(
        "cityscapes",
        cityscapes,
        (
            Target(f"leftImg8bit/{CITY}_leftImg8bit.png", COLOUR_PNG, (CITY,)),
            Target(f"disparity/{CITY}_disparity.png", DEPTH_PNG, (CITY,)),
            Target(f"camera/{CITY}_camera.json", CAMERA, (CITY,)),
        ),
    ),
    "mtan": Layout(
        "cityscapes_mtan",
        mtan,
        (
            Target("train/image/2.npy", MTAN_IMAGE, ("train/2",)),
            Target("train/depth/2.npy", MTAN_DEPTH, ("train/2",)),
        ),
    ),
}


# --- the cases ----------------------------------------------------------------------------------------------


def plan() -> dict[str, list[tuple[Target, Damage, int]]]:
    """Every damage of every target once, then those again, in turn, with other seeds, up to ``CASES``."""
    every = [(name, t, d) for name, layout in LAYOUTS.items() for t in layout.targets for d in t.damages]
    drawn = {cut, zeros, flipped_bit, zeros_in_pixels, scan_cut, tar_cut, cut_split, cut_in_line, wrong_start}
    again = [case for case in every if case[2] in drawn]
    cases: dict[str, list[tuple[Target, Damage, int]]] = {name: [] for name in LAYOUTS}
    for seed in range(CASES):
        name, target, damage = every[seed] if seed < len(every) else again[(seed - len(every)) % len(again)]
        cases[name].append((target, damage, seed))
    return cases


PLAN = plan()


def test_five_hundred_cases_over_every_data_set() -> None:
    assert sum(map(len, PLAN.values())) == CASES
    assert min(map(len, PLAN.values())) >= 6
    per_target = [len(target.damages) for layout in LAYOUTS.values() for target in layout.targets]
    assert sum(per_target) <= CASES  # each of them at least once


def samples(config: Any, split: str = "train") -> tuple[Any, list[dict[str, Any]]]:
    """A split as a command builds it, and everything in it."""
    data = build_split(config, split, build_protocol(config))
    return data, [data[index] for index in range(len(data))]


def equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one["name"] == other["name"] and all(
        bool((one[key] == other[key]).all()) for key in ("image", "depth", "mask", "intrinsics")
    )


def is_clear(error: Exception, target: Target) -> bool:
    """One line that names the file, of a kind that a command shows without a traceback."""
    names = (target.named or Path(target.file).stem).split("|")
    message = str(error)
    return (
        type(error) in (ValueError, FileNotFoundError)
        and any(name in message for name in names)
        and 40 < len(message) < 1200
        and "Traceback" not in message
    )


@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_damage_is_named_or_counted(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(layouts, "KITTI_SIZES", {"2011_09_26": (60, 80), "2011_09_28": (56, 84)})
    layout = LAYOUTS[name]
    root = tmp_path / "data set"
    given = layout.write(root)
    given = [f"data={layout.data}", "protocol=folder", "data.input_size=[24,32]", *given]
    stop, skip = (compose("train", [*given, f"data.on_error={how}"]) for how in ("stop", "skip"))
    data, whole = samples(skip, layout.split)
    assert data.skipped == {}
    names = data.names
    del data
    wrong = []
    for target, damage, seed in PLAN[name]:
        path, kept = root / target.file, (root / target.file).read_bytes()
        path.unlink()  # another file, as after a fetch: HDF5 knows open files by their inode
        path.write_bytes(kept)
        capfd.readouterr()
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            damage(path, RNG(seed))
            fault = check(stop, skip, layout.split, target, names, whole)
        said = "".join(capfd.readouterr())
        if path.suffix == ".exr":  # OpenEXR prints as well; the error is there all the same
            said = ""
        if not fault and (warned or said):
            fault = f"printed {said!r}, warned of {[str(w.message) for w in warned]}"
        if fault:
            wrong.append(f"{target.file}, {getattr(damage, '__qualname__', damage)}, seed {seed}: {fault}")
        if path.is_dir():
            shutil.rmtree(path)
        path.write_bytes(kept)
    assert not wrong, f"{len(wrong)} of {len(PLAN[name])}:\n" + "\n".join(wrong)


def check(
    stop: Any, skip: Any, split: str, target: Target, names: Sequence[str], whole: Sequence[dict[str, Any]]
) -> str:
    """What is wrong with how this damage is met, or ""."""
    try:
        samples(stop, split)
    except Exception as error:
        if not is_clear(error, target):
            return f"unclear {type(error).__name__}: {error}"
    else:
        return "on_error=stop did not stop"
    try:
        data, left = samples(skip, split)
    except Exception as error:
        return (
            ""
            if target.lost is None and is_clear(error, target)
            else f"skip: {type(error).__name__}: {error}"
        )
    if target.lost is None and not data.skipped:
        return "on_error=skip noticed nothing"
    if target.lost is not None and tuple(data.skipped) != target.lost:
        return f"skipped {data.skipped}"
    expected = [sample for sample in whole if sample["name"] in data.names]
    if target.lost is not None and len(expected) != len(names) - 1:
        return f"{len(left)} of {len(names)} frames are left"
    if not (len(left) == len(expected) and all(map(equal, left, expected))):
        return "the other frames are not what they were"
    return ""


def test_numbers_that_are_no_depth_are_unknown(tmp_path: Path) -> None:
    """Among good ones NaN, infinity and negative numbers are holes, in every format that can hold them."""
    values = NYU_FRAME.metres.copy()
    bad = RNG(0).random(values.shape) < 0.2
    values[bad] = RNG(1).choice([np.nan, np.inf, -np.inf, -1.0, 0.0], bad.sum())
    layouts.hdf5(tmp_path / "h5", NYU_FRAME._replace(metres=values))
    for ending, writer in ((".npy", np.save), (".pfm", pfm), (".exr", exr), (".tiff", layouts.picture)):
        root = tmp_path / ending
        given = folder_of(ending, "metres")(root)
        writer(root / f"depths/f1{ending}", values)
        config = compose("train", ["data=folder", "data.input_size=null", "data.load_size=null", *given])
        _, (_, sample, _) = samples(config)
        np.testing.assert_array_equal(sample["mask"][0], ~bad)
        np.testing.assert_array_equal(sample["depth"][0], np.where(bad, 0, NYU_FRAME.metres))
    given = [f"data.root={tmp_path / 'h5'}", "data.train.split=trainval", "data.input_size=null"]
    config = compose("train", ["data=nyu_hdf5", "protocol=folder", "data.train.load_size=null", *given])
    np.testing.assert_array_equal(samples(config)[1][0]["mask"][0], ~bad)


def test_a_webcams_extra_byte_is_no_damage(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    from eldenet.data.io import read_image

    file = tmp_path / "frame.jpg"
    layouts.picture(file, NYU_FRAME.rgb)
    whole, content = read_image(file), file.read_bytes()
    file.write_bytes(content[:-2] + b"\0\0\0" + content[-2:])
    np.testing.assert_array_equal(read_image(file), whole)
    assert capfd.readouterr().err == ""
    size = struct.pack(">HH", 60000, 60000)  # a frame that no memory holds
    at = content.index(b"\xff\xc0") + 5
    file.write_bytes(content[:at] + size + content[at + 4 :])
    with pytest.raises(ValueError, match=r"frame\.jpg"):
        read_image(file)

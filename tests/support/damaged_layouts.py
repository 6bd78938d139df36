"""Every layout a data set may have, and what may happen to its files."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from support import layouts
from support.damaged_containers import H5, MAT, SPLITS_MAT, TAR, cut_split, in_frame, member, zeros_in_tables
from support.damages import (
    ANY,
    CAM_TO_CAM,
    CAMERA,
    COLOR_JPG,
    COLOR_PNG,
    DEPTH_NPY,
    DEPTH_PNG,
    INTRINSICS,
    LIST,
    MTAN_DEPTH,
    MTAN_IMAGE,
    PFM,
    SCAN,
    TEXT,
    VELO_TO_CAM,
    Damage,
    cut,
    empty,
    exr,
    gray,
    halved,
    pfm,
    text,
    turned,
    web_page,
    without_gone,
    wrong_start,
)


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
            writers[ending](root / f"depths/f{i}{ending}", NYU_FRAME.meters)
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
            Target("data/nyu2_train/office_0002_out/1.jpg", COLOR_JPG, ("office_0002_out/1",)),
            Target("data/nyu2_train/office_0002_out/1.png", DEPTH_PNG, ("office_0002_out/1",)),
            Target("data/nyu2_train.csv", LIST, None, "nyu2_train|office_0002|data set/dat"),
        ),
    ),
    "labelled": Layout(
        "nyu_labelled",
        labelled,
        (
            Target("data/nyu2_train/labeled_out/0022.jpg", COLOR_JPG, ("labeled_out/0022",)),
            Target("data/nyu2_train/labeled_out/0022.png", DEPTH_PNG, ("labeled_out/0022",)),
        ),
    ),
    "sync": Layout(
        "nyu_sync",
        sync,
        (
            Target("office_0002/rgb_00041.jpg", COLOR_JPG, ("office_0002/rgb_00041",)),
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
            Target("images/f001.png", [d for d in COLOR_PNG if d is not gray], ("f001",)),
            Target("depths/f001.png", DEPTH_PNG, ("f001",)),
        ),
    ),
    "folder_csv": Layout("folder", csv_folder, (Target("pairs.csv", LIST, None, "pairs.csv|f002|depths"),)),
    "folder_npy": Layout(
        "folder", folder_of(".npy", "meters"), (Target("depths/f1.npy", DEPTH_NPY, ("f1",)),)
    ),
    "folder_pfm": Layout("folder", folder_of(".pfm", "meters"), (Target("depths/f1.pfm", PFM, ("f1",)),)),
    "folder_exr": Layout("folder", folder_of(".exr", "meters"), (Target("depths/f1.exr", ANY, ("f1",)),)),
    "folder_tiff": Layout(
        "folder",
        folder_of(".tiff", "meters"),
        (Target("depths/f1.tiff", (*ANY, *EXTRA_FLOAT), ("f1",)),),
    ),
    "kitti": Layout(
        "kitti",
        kitti,
        (
            Target(DEVKIT, without_gone(DEPTH_PNG), (KITTI_NAME.format(5),)),
            Target(
                RAW_PICTURE.format(DRIVE, 5),
                without_gone(COLOR_PNG),
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
                [d for d in COLOR_PNG if d not in (turned, halved)],
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
            Target(f"leftImg8bit/{CITY}_leftImg8bit.png", COLOR_PNG, (CITY,)),
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

"""Every layout a data set may have, and what may happen to its files."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from support import layouts
from support.damages import (
    ANY,
    COLOR,
    DEPTH,
    Damage,
    array,
    cut,
    exr,
    folder_instead,
    gray,
    halved,
    keys,
    pfm,
    text,
    turned,
    web_page,
    without,
)


class Target(NamedTuple):
    """A file, what may happen to it, and the frame that is lost then; None: the whole data set."""

    file: str
    damages: Sequence[Damage]
    lost: str | None
    named: str | None = None  # what the message says, where it is not the file's stem


class Layout(NamedTuple):
    """A data set's YAML, what writes its files, and the overrides for a folder ``{root}`` of them."""

    data: str
    write: Callable[[Path], object]
    overrides: Sequence[str]
    targets: Sequence[Target]
    split: str = "train"

    def given(self, root: Path) -> list[str]:
        """Write the files and return the overrides of a training on them, at a small input size."""
        self.write(root)
        small = [f"data={self.data}", "protocol=folder", "data.input_size=[24,32]"]
        return [*small, *(override.format(root=root) for override in self.overrides)]


NYU_FRAME = layouts.SMALL
DRIVE, VAL_DRIVE = layouts.DRIVES[0], layouts.VAL_DRIVE
KITTI_FRAME = f"{DRIVE}/image_02/{{:010d}}"
KITTI_PICTURE = f"raw/2011_09_26/{DRIVE}/image_02/data/{{:010d}}.png"
KITTI_DEPTH = f"depth/train/{DRIVE}/proj_depth/groundtruth/image_02/0000000005.png"
DATE = "raw/2011_09_26"
SELECTED = f"{VAL_DRIVE}/image_02/0000000008"
SELECTION = "val_selection_cropped"
CITY = "train/aachen/aachen_000000_000019"
LIST = (web_page, text(lambda t: t.replace(",", ";")), text(lambda t: t + "a,b,c\n"))
CALIBRATION = (
    web_page,
    folder_instead,
    text(lambda t: t.replace("P_rect", "P").replace("R:", "S:")),
    text(lambda t: t.replace("7", "x")),
)
INTRINSICS = (web_page, text(lambda t: t.replace("721", "-721")), text(lambda t: t.replace("149.854", "nan")))
CAMERA = (
    web_page,
    cut,
    keys(lambda c: c["extrinsic"].pop("baseline")),
    keys(lambda c: c["intrinsic"].update(fx=-1)),
    keys(lambda c: c["extrinsic"].update(baseline=float("inf"))),
)
MTAN_IMAGE = (*ANY, array(lambda a: a * 255), array(lambda a: a[..., 0]))
MTAN_DEPTH = (*ANY, array(lambda a: a * np.nan), array(lambda a: a * 80))
ALL = ("data.root={root}", "data.train.split=all")
TRAINVAL = ("data.root={root}", "data.train.split=trainval")


def arrays(root: Path, ending: str) -> None:
    """Write pictures with depth in files of another kind."""
    writers = {".npy": np.save, ".pfm": pfm, ".exr": exr, ".tiff": layouts.picture}
    for i in range(3):
        layouts.picture(root / f"images/f{i}.png", NYU_FRAME.rgb)
        (root / "depths").mkdir(exist_ok=True)
        writers[ending](root / f"depths/f{i}{ending}", NYU_FRAME.meters)


def folder_of(ending: str, damages: Sequence[Damage]) -> Layout:
    overrides = (*ALL, "data.encoding=meters")
    return Layout(
        "folder", partial(arrays, ending=ending), overrides, (Target(f"depths/f1{ending}", damages, "f1"),)
    )


def csv_folder(root: Path) -> None:
    layouts.folder(root, count=3)
    (root / "pairs.csv").write_text("".join(f"images/f{i:03d}.png,depths/f{i:03d}.png\n" for i in range(3)))


def sync_list(root: Path) -> None:
    layouts.sync(root)
    lines = [
        f"/{scene}/rgb_{n}.jpg /{scene}/sync_depth_{n}.png 518.8579\n" for scene, n in layouts.SYNC_FRAMES
    ]
    (root / "list.txt").write_text("".join(lines))


def eigen(root: Path) -> None:
    layouts.kitti_depth(root)
    layouts.eigen_list(root / "frames.txt", layouts.DRIVES)


LAYOUTS = {
    "densedepth": Layout(
        "nyu_densedepth",
        layouts.densedepth,
        TRAINVAL,
        (
            Target("data/nyu2_train/office_0002_out/1.jpg", COLOR, "office_0002_out/1"),
            Target("data/nyu2_train/office_0002_out/1.png", DEPTH, "office_0002_out/1"),
            Target("data/nyu2_train.csv", LIST, None, "nyu2_train|office_0002|data set/dat"),
        ),
    ),
    "labeled": Layout(
        "nyu_labelled",
        layouts.labeled,
        ALL,
        (
            Target("data/nyu2_train/labeled_out/0022.jpg", COLOR, "labeled_out/0022"),
            Target("data/nyu2_train/labeled_out/0022.png", DEPTH, "labeled_out/0022"),
        ),
    ),
    "sync": Layout(
        "nyu_sync",
        layouts.sync,
        ALL,
        (
            Target("office_0002/rgb_00041.jpg", COLOR, "office_0002/rgb_00041"),
            Target("office_0002/sync_depth_00041.png", DEPTH, "office_0002/rgb_00041"),
        ),
    ),
    "sync_list": Layout(
        "nyu_sync",
        sync_list,
        (*ALL, "+data.train.list_file={root}/list.txt"),
        (Target("list.txt", (web_page, text(lambda t: t.replace(" ", " x "))), None, "list.txt|/html"),),
    ),
    "hdf5": Layout(
        "nyu_hdf5",
        layouts.hdf5,
        TRAINVAL,
        (Target("train/office_0002/00001.h5", ANY, "train/office_0002/00001"),),
    ),
    "mat": Layout(
        "nyu_mat",
        layouts.mat,
        (*TRAINVAL, "data.ground_truth=inpainted"),
        (
            Target("nyu_depth_v2_labeled.mat", ANY, None),
            Target("splits.mat", ANY, None),
        ),
    ),
    "folder": Layout(
        "folder",
        partial(layouts.folder, count=3),
        ALL,
        (
            # phones keep depth at a fraction of the picture's size, so half of it is no damage
            Target("images/f001.png", without(COLOR, gray, halved), "f001"),
            Target("depths/f001.png", without(DEPTH, halved), "f001"),
        ),
    ),
    "folder_csv": Layout(
        "folder",
        csv_folder,
        (*ALL, "data.csv=pairs.csv"),
        (Target("pairs.csv", LIST, None, "pairs.csv|f002|depths"),),
    ),
    "folder_npy": folder_of(
        ".npy", (*ANY, array(lambda a: a * np.nan), array(lambda a: a.astype("u2")), array(str))
    ),
    "folder_pfm": folder_of(".pfm", ANY),
    "folder_exr": folder_of(".exr", ANY),
    "folder_tiff": folder_of(".tiff", (*ANY, turned)),
    "kitti": Layout(
        "kitti",
        layouts.kitti_depth,
        ("data.root={root}/depth", "data.train.split=trainval"),
        (
            Target(KITTI_DEPTH, DEPTH, KITTI_FRAME.format(5)),
            Target(KITTI_PICTURE.format(5), COLOR, KITTI_FRAME.format(5)),
            Target(f"{DATE}/calib_cam_to_cam.txt", CALIBRATION, None),
        ),
    ),
    "kitti_list": Layout(
        "kitti",
        eigen,
        ("data.root={root}/depth", "data.train.split=all", "+data.train.list_file={root}/frames.txt"),
        (
            Target(
                "frames.txt",
                (web_page, text(lambda t: t + t), text(lambda t: t.replace("image_02", "image_99"))),
                None,
            ),
        ),
    ),
    "kitti_raw": Layout(
        "kitti_raw",
        lambda root: layouts.kitti_raw(root / "raw"),
        ("data.root={root}/raw", "data.train.split=all"),
        (
            Target(f"{DATE}/{DRIVE}/velodyne_points/data/0000000069.bin", ANY, KITTI_FRAME.format(69)),
            Target(
                KITTI_PICTURE.format(69),
                without(COLOR, turned, halved),
                KITTI_FRAME.format(69),
            ),
            Target(f"{DATE}/calib_velo_to_cam.txt", CALIBRATION, None),
            Target(f"{DATE}/calib_cam_to_cam.txt", CALIBRATION, None),
        ),
    ),
    "kitti_selection": Layout(
        "kitti_selection",
        layouts.kitti_selection,
        ("data.selection_root={root}", "data.frames=null", "+data.ground_truth=improved"),
        (
            Target(f"{SELECTION}/intrinsics/{VAL_DRIVE}_image_0000000008_image_02.txt", INTRINSICS, SELECTED),
            Target(
                f"{SELECTION}/groundtruth_depth/{VAL_DRIVE}_groundtruth_depth_0000000008_image_02.png",
                DEPTH,
                SELECTED,
                "0000000008",
            ),
        ),
        "test",
    ),
    "cityscapes": Layout(
        "cityscapes",
        layouts.cityscapes,
        TRAINVAL,
        (
            Target(f"leftImg8bit/{CITY}_leftImg8bit.png", COLOR, CITY),
            Target(f"disparity/{CITY}_disparity.png", DEPTH, CITY),
            Target(f"camera/{CITY}_camera.json", CAMERA, CITY),
        ),
    ),
    "mtan": Layout(
        "cityscapes_mtan",
        partial(layouts.cityscapes_mtan, size=(48, 64)),
        TRAINVAL,
        (
            Target("train/image/2.npy", MTAN_IMAGE, "train/2"),
            Target("train/depth/2.npy", MTAN_DEPTH, "train/2"),
        ),
    ),
}

"""The layouts that can be read, each with its tree and what tells it from the others."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from eldenet.data.cityscapes import CITYSCAPES_TREE, MTAN_TREE
from eldenet.data.kitti_files import DEPTH_TREE, RAW_TREE, SELECTION_TREE, is_drive
from eldenet.data.nyu import DENSEDEPTH_TREE, SYNC_TREE
from eldenet.data.nyu_hdf5 import HDF5_TREE, MAT_TREE

LABELED_TREE = "data/nyu2_train.csv, data/nyu2_train/labeled_out/0001.jpg, 0001.png"
OBJECT_TREE = "training/image_2/000000.png, calib/000000.txt       (for AP: label_2/000000.txt)"
RECORDING_TREES = """
rgb/0.jpg, depth/0.exr, metadata.json                                   Record3D, exported as EXR
rgb/000000.jpg, depth/000000.png, confidence/000000.png                 Stray Scanner and other ARKit apps
frame_00000.jpg, depth_00000.png, conf_00000.png, frame_00000.json      3D Scanner App
keyframes/{images,depth,confidence,cameras}/<time>.*                    Polycam
transforms.json, images/*.jpg, depths/*.png                             Nerfstudio
rgb.txt, depth.txt, rgb/<time>.png, depth/<time>.png                    TUM (associations.txt too)
color/00000.jpg, depth/00000.png, camera_intrinsic.json                 RealSense, Azure Kinect (Open3D)
color_0001.png, depth_0001.png; or 0001_color.png, 0001_depth.png       prefix or suffix
<scene>/color/0.jpg, <scene>/depth/0.png                                a folder per scene
pairs.csv: image,depth[,confidence,fx,fy,cx,cy,scene]                   a list
"""


class KnownLayout(NamedTuple):
    """A data set in one layout."""

    title: str
    tree: str  # of its files
    fits: Callable[[Path], bool]  # whether a folder looks like it
    settings: tuple[str, ...]  # that read it, of the command line; {root} stands for the folder


def _holds(*patterns: str) -> Callable[[Path], bool]:
    return lambda folder: all(next(folder.glob(pattern), None) is not None for pattern in patterns)


def _is_raw(folder: Path) -> bool:
    return any(is_drive(scans.parent.name) for scans in folder.glob("????_??_??/*_sync/velodyne_points"))


def _is_depth_devkit(folder: Path) -> bool:
    parts = ("train/", "val/", "")
    places = (f"{base}{part}*_sync/proj_depth" for base in ("", "data_depth_*/") for part in parts)
    return any(next(folder.glob(place), None) is not None for place in places)


def _root(data: str, setting: str = "root") -> tuple[str, ...]:
    return f"data={data}", f"data.{setting}={{root}}"


KNOWN_LAYOUTS = (
    KnownLayout(
        "NYU Depth V2, labeled frames", MAT_TREE, _holds("nyu_depth_v2_labeled.mat"), _root("nyu_mat")
    ),
    KnownLayout(
        "NYU Depth V2, sparse-to-dense's files", HDF5_TREE, _holds("train/*/*.h5"), _root("nyu_hdf5")
    ),
    KnownLayout(
        "NYU Depth V2, DenseDepth's files",
        DENSEDEPTH_TREE,
        _holds("data/nyu2_train.csv", "data/nyu2_test.csv"),
        _root("nyu_densedepth"),
    ),
    KnownLayout(
        "NYU Depth V2, labeled training frames in 8 bits",
        LABELED_TREE,
        lambda folder: _holds("data/nyu2_train.csv")(folder) and not _holds("data/nyu2_test.csv")(folder),
        _root("nyu_labelled"),
    ),
    KnownLayout("NYU Depth V2, BTS's files", SYNC_TREE, _holds("*/sync_depth_*.png"), _root("nyu_sync")),
    KnownLayout("KITTI raw", RAW_TREE, _is_raw, _root("kitti_raw")),
    KnownLayout("KITTI raw, Eigen's split", RAW_TREE, _is_raw, _root("kitti_eigen_raw")),
    KnownLayout("KITTI's depth devkit", DEPTH_TREE, _is_depth_devkit, _root("kitti")),
    KnownLayout(
        "KITTI's val_selection_cropped",
        SELECTION_TREE,
        _holds("val_selection_cropped"),
        _root("kitti_selection", "selection_root"),
    ),
    KnownLayout(
        "KITTI's object benchmark, for eldenet predict with checkpoint= and a detector",
        OBJECT_TREE,
        _holds("training/image_2", "training/calib"),
        ("source={root}/training", "boxes=true"),
    ),
    KnownLayout(
        "Cityscapes", CITYSCAPES_TREE, _holds("**/leftImg8bit/*/*", "**/disparity/*/*"), _root("cityscapes")
    ),
    KnownLayout(
        "Cityscapes, MTAN's files",
        MTAN_TREE,
        _holds("train/image/*.npy", "train/depth/*.npy"),
        _root("cityscapes_mtan"),
    ),
)


def tree_lines() -> list[str]:
    """Return what can be read, with the tree of each layout."""
    lines = ["recordings (data=folder):", *_indented(RECORDING_TREES)]
    shown = {layout.tree: layout for layout in reversed(KNOWN_LAYOUTS)}
    for layout in reversed(shown.values()):
        lines += [f"{layout.title}:", *_indented(layout.tree)]
    return lines


def _indented(tree: str) -> list[str]:
    return [f"  {line}" for line in tree.strip().splitlines()]

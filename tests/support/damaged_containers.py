"""What may happen to files that hold many frames: HDF5 and MATLAB's .mat."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat, savemat

from support.damages import ANY, Damage, cut, empty, folder_instead, gone, web_page, zeros_at


def hdf5(change: Callable[[h5py.File], None]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        with h5py.File(path, "r+") as file:
            change(file)

    return damage


def replaced(key: str, *changes: Callable[[np.ndarray], Any]) -> list[Damage]:
    def damage(file: h5py.File, change: Callable[[np.ndarray], Any]) -> None:
        new = change(file[key][()])
        del file[key]
        file[key] = new

    return [hdf5(partial(damage, change=change)) for change in changes]


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
    *replaced("rgb", lambda a: a.astype(np.uint16), lambda a: a.transpose(1, 2, 0), lambda a: a[0]),
    *replaced("depth", lambda a: a.T, lambda a: a[None], lambda a: -a, lambda a: a * np.nan),
    *replaced("depth", lambda a: a * 1000, lambda a: (a * 1000).astype(np.uint16)),
)
MAT = (
    *(*ANY, cut, cut, zeros_in_tables),
    *(without("images"), without("depths"), group("images"), group("depths")),
    *replaced("images", lambda a: a.astype(np.float32), lambda a: a[:, 0], lambda a: a[:3]),
    *replaced("depths", lambda a: a.swapaxes(1, 2), lambda a: a[1:], lambda a: a[0]),
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
    *(split(lambda s: {"trainNdxs": s["trainNdxs"]}), split(lambda s: {"testNdxs": s["testNdxs"]})),
    split(lambda s: s | {"trainNdxs": s["trainNdxs"] * 0}),
    split(lambda s: s | {"trainNdxs": s["testNdxs"]}),
    split(lambda s: s | {"testNdxs": np.array([["a"]])}),
)


def cut_split(path: Path, generator: np.random.Generator) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: generator.integers(130, len(content) - 60)])  # before the second list ends

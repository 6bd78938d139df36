"""What may happen to a file of a data set: cut, another file in its place, other numbers."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

Damage = Callable[[Path], None]


def refusal(read: Callable[[], object]) -> str | None:
    """Message of the ``ValueError`` that a reader raises; None: it took the file."""
    try:
        read()
    except ValueError as error:
        return str(error)
    return None


def flips_and_cuts(content: bytes, flips: int = 40, cuts: int = 10) -> list[bytes]:
    """Copies with one changed bit each, then copies that end early."""
    generator, found = np.random.default_rng(0), []
    for _ in range(flips):
        copy = bytearray(content)
        copy[generator.integers(len(copy))] ^= 1 << int(generator.integers(8))
        found.append(bytes(copy))
    return found + [content[:end] for end in generator.integers(0, len(content), cuts)]


def cut(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: 2 * len(content) // 3 - 1])


def web_page(path: Path) -> None:
    path.write_bytes(b"<!DOCTYPE html><html><body>404: you are not logged in</body></html>\n" * 16)


def folder_instead(path: Path) -> None:
    path.unlink()
    path.mkdir()


def write(path: Path, array: np.ndarray) -> None:
    ok, content = cv2.imencode(path.suffix, array)
    assert ok
    path.write_bytes(content.tobytes())


def pixels(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Other pixels in a picture."""

    def damage(path: Path) -> None:
        write(path, np.ascontiguousarray(change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED))))

    return damage


def array(change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Other numbers in an ``.npy`` file."""

    def damage(path: Path) -> None:
        np.save(path, change(np.load(path)), allow_pickle=True)

    return damage


def text(change: Callable[[str], str]) -> Damage:
    """Another text."""

    def damage(path: Path) -> None:
        path.write_text(change(path.read_text()))

    return damage


def keys(change: Callable[[dict[str, Any]], object]) -> Damage:
    """Other entries in a JSON file."""

    def damage(path: Path) -> None:
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))

    return damage


ANY = (cut, web_page, folder_instead)
turned = pixels(lambda a: a.swapaxes(0, 1))
halved = pixels(lambda a: a[::2, ::2])
gray = pixels(lambda a: cv2.cvtColor(a, cv2.COLOR_BGR2GRAY))
other_bits = pixels(lambda a: a.astype(np.uint16) * 257 if a.dtype == np.uint8 else (a // 257).astype("u1"))
COLOR = (*ANY, gray, turned, halved)
DEPTH = (*ANY, other_bits, turned, halved)


def pfm(path: Path, meters: np.ndarray) -> None:
    height, width = meters.shape
    path.write_bytes(b"Pf\n%d %d\n-1.0\n" % (width, height) + meters[::-1].astype("<f4").tobytes())


def exr(path: Path, meters: np.ndarray) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": meters.astype(np.float32)}).write(str(path))


def without(damages: Sequence[Damage], *others: Damage) -> list[Damage]:
    """The damages without ``others``, which do this file no harm."""
    return [damage for damage in damages if damage not in others]

"""What may happen to a file of a data set: cut, emptied, flipped bits, other contents, ..."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

RNG = np.random.default_rng

Damage = Callable[[Path, np.random.Generator], None]


def refusal(read: Callable[[], object]) -> str | None:
    """Message of the ``ValueError`` that a reader raises; None: it took the file."""
    try:
        read()
    except ValueError as error:
        return str(error)
    return None


def flips_and_cuts(content: bytes, flips: int = 40, cuts: int = 10) -> list[bytes]:
    """Copies with one changed bit each, then copies that end early."""
    generator, found = RNG(0), []
    for _ in range(flips):
        copy = bytearray(content)
        copy[generator.integers(len(copy))] ^= 1 << int(generator.integers(8))
        found.append(bytes(copy))
    return found + [content[:end] for end in generator.integers(0, len(content), cuts)]


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
    """Of a file under a checksum (PNG)."""
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


def gray(path: Path, _: np.random.Generator) -> None:
    write(path, cv2.cvtColor(picture(path), cv2.COLOR_BGR2GRAY))


def turned(path: Path, _: np.random.Generator) -> None:
    write(path, np.ascontiguousarray(picture(path).swapaxes(0, 1)))


def halved(path: Path, _: np.random.Generator) -> None:
    write(path, np.ascontiguousarray(picture(path)[::2, ::2]))


PNG = (*ANY, cut, zeros, flipped_bit)
DEPTH_PNG = (*PNG, other_depth, more_channels, turned, halved)
COLOR_PNG = (*PNG, other_depth, gray, turned, halved)


def zeros_in_pixels(path: Path, generator: np.random.Generator) -> None:
    """Of a JPEG: after its tables, which are as good with a zero."""
    content = path.read_bytes()
    zeros_at(path, generator, content.index(b"\xff\xda") + 14, len(content) - 80)


COLOR_JPG = (*ANY, cut, zeros_in_pixels, other_depth, gray, turned, halved)


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
    *(*ANY, cut, as_npz, as_objects, zeros_in_header),
    *(array(lambda a: a[:-1]), array(lambda a: a[None, None])),
)
NAN = array(lambda a: np.full_like(a, np.nan))
NEGATIVE = array(lambda a: -a)
INFINITE = array(lambda a: np.full_like(a, np.inf))
DEPTH_NPY = (*NPY, NAN, NEGATIVE, INFINITE, array(lambda a: (a * 1000).astype(np.uint16)))
MTAN_IMAGE = (*NPY, NAN, array(lambda a: a * 255), array(lambda a: a[..., 0]), array(lambda a: a - 0.5))
MTAN_DEPTH = (*NPY, NAN, NEGATIVE, INFINITE, array(lambda a: a * 80))


def pfm(path: Path, meters: np.ndarray) -> None:
    height, width = meters.shape
    path.write_bytes(b"Pf\n%d %d\n-1.0\n" % (width, height) + meters[::-1].astype("<f4").tobytes())


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


def exr(path: Path, meters: np.ndarray) -> None:
    OpenEXR = pytest.importorskip("OpenEXR")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": meters.astype(np.float32)}).write(str(path))


# --- to text ------------------------------------------------------------------------------------------------


def text(change: Callable[[str], str]) -> Damage:
    def damage(path: Path, _: np.random.Generator) -> None:
        path.write_text(change(path.read_text()))

    return damage


def with_text(old: str, *new: str) -> list[Damage]:
    """Another text in place of ``old``."""
    return [text(lambda content, other=other: content.replace(old, other)) for other in new]


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
    *(*TEXT[:-1], cut_before("0.2163791"), cut_before("0.2163791"), *with_text("P_rect_02", "P")),
    *(*with_text("721.5377", "x", "nan", "0"), *with_text(" 1 0.0027", " 0.0027")),
)
VELO_TO_CAM = (
    *(*TEXT, cut_before("-0.0763"), *with_text("R:", "S:"), *with_text("T:", "U:")),
    *(*with_text("-0.0763", "inf"), *with_text("T: 0 ", "T: ")),
)
INTRINSICS = (
    *(empty, folder_instead, web_page, binary, zeros, cut_before("149.854"), cut_before("0 0 1")),
    *(*with_text("721", "-721"), *with_text("149.854", "nan")),
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
    path.write_bytes(b" " * 1600)  # as floats: points within a nanometer


SCAN = (
    *(empty, folder_instead, web_page, spaces, scan_cut, scan_cut, scan_cut),
    scan(lambda p: p * np.float32("nan")),
    *(scan(lambda p: p.byteswap()), scan(lambda p: p.astype(np.float64)), scan(lambda p: p * 1e6)),
    scan(lambda p: np.vstack([p, [[np.inf, 0, 0, 0]]]).astype(np.float32)),
)


def without_gone(damages: Sequence[Damage]) -> Sequence[Damage]:
    """Where the files make the list of frames, none is missed."""
    return [damage for damage in damages if damage is not gone]

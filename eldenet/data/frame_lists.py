"""Lists of frames: a CSV with or without a header, TUM's associations, Nerfstudio's ``transforms.json``."""

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from eldenet.data.camera_files import Camera, camera_of
from eldenet.data.frame_files import seconds_of
from eldenet.data.paths import check_inside, csv_pairs
from eldenet.geometry import pinhole
from eldenet.system.errors import reading
from eldenet.system.files import read_json, read_text

# a column's name, with what people add to it: rgb_path, depth_mm
_COLUMN = re.compile(r"(image|rgb|color|depth|confidence)(_(path|file|filename|mm|m))?")
_MEANINGS = {"rgb": "image", "color": "image"}
_NUMBERS = ("fx", "fy", "cx", "cy")


class ListedFrame(NamedTuple):
    """One frame of a list; files are relative to the data set's folder."""

    image: str
    depth: str
    confidence: str | None = None  # of the depth; None: not listed
    camera: Camera | None = None  # intrinsics and pose; None: not listed
    scene: str = ""  # where it was recorded; "": not listed


def read_frame_list(path: Path, *, allow_outside: bool, tolerance: float) -> list[ListedFrame]:
    """Read a list of frames in any of the formats; ``.json`` is Nerfstudio's ``transforms.json``.

    ``allow_outside`` lets files lie outside the data set's folder; ``tolerance`` is the largest difference
    of the two times in TUM's ``associations.txt`` [s].

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: a line is wrong or leaves the folder, or the list is empty.
    """
    if path.suffix.lower() == ".json":
        frames = _transforms(path)
    else:
        text = read_text(path, "fetch or write the list of frames again")
        with reading(path, "CSV"):
            rows = list(csv.reader(text.splitlines()))
        header = [cell.strip().lower() for cell in rows[0]] if rows else []
        columns = {_meaning(cell): place for place, cell in reversed(list(enumerate(header)))}
        if "image" in columns and "depth" in columns:
            frames = [_row(path, number, row, columns) for number, row in enumerate(rows[1:], 2) if any(row)]
        elif _is_association(text):
            frames = _associations(path, text, tolerance)
        else:
            frames = [ListedFrame(image, depth) for image, depth in csv_pairs(path)]
    if not frames:
        raise ValueError(f"{path} lists no frames: fetch or write it again")
    if not allow_outside:
        files = [file for one in frames for file in (one.image, one.depth, one.confidence) if file]
        setting = "set data.allow_outside=true if you trust the list"
        check_inside(files, path, f"write the list with paths below that folder, or {setting}")
    return frames


def _meaning(cell: str) -> str:
    found = _COLUMN.fullmatch(cell)
    return cell if found is None else _MEANINGS.get(found[1], found[1])


def _row(path: Path, number: int, row: list[str], columns: Mapping[str, int]) -> ListedFrame:
    cells = {name: row[place].strip() for name, place in columns.items() if place < len(row)}
    if not (cells.get("image") and cells.get("depth")):
        raise ValueError(f"{path}, line {number}: no image or no depth in {str(row)[:200]}")
    camera = None
    if set(_NUMBERS) & set(columns):
        with reading(f"{path}, line {number}", "row with fx, fy, cx, cy"):
            camera = Camera(pinhole(*(float(cells[name]) for name in _NUMBERS)))
    return ListedFrame(
        cells["image"], cells["depth"], cells.get("confidence") or None, camera, cells.get("scene", "")
    )


def _is_association(text: str) -> bool:
    first = next((line.split() for line in text.splitlines() if line.strip() and line[0] != "#"), [])
    return len(first) == 4 and None not in (seconds_of(first[0]), seconds_of(first[2]))


def _associations(path: Path, text: str, tolerance: float) -> list[ListedFrame]:
    """Lines ``time file time file``, picture and depth in either order (``depth`` in a path tells)."""
    frames = []
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        times = [seconds_of(cell) for cell in cells[::2]]
        if len(cells) != 4 or times[0] is None or times[1] is None:
            raise ValueError(f"{path}, line {number}: expected time, file, time, file, found {line[:200]!r}")
        if abs(times[0] - times[1]) > tolerance + 1e-6:
            raise ValueError(
                f"{path}, line {number}: {abs(times[0] - times[1]):.3g} s lie between the picture and its "
                f"depth, more than data.tolerance={tolerance:g}: remove the line, or allow more"
            )
        image, depth = cells[1], cells[3]
        if "depth" in image.lower() and "depth" not in depth.lower():
            image, depth = depth, image
        frames.append(ListedFrame(image, depth))
    return frames


def _transforms(path: Path) -> list[ListedFrame]:
    """Nerfstudio's file; a frame's own numbers come before those of the file."""
    stored: Any = read_json(path)
    records = stored.get("frames") if isinstance(stored, Mapping) else None
    if not isinstance(records, list) or not all(isinstance(record, Mapping) for record in records):
        raise ValueError(f"{path} has no list of frames: give Nerfstudio's transforms.json")
    shared = {key: value for key, value in stored.items() if key != "frames"}
    frames = []
    for number, record in enumerate(records):
        where = f"{path}, frame {number}"
        image, depth = record.get("file_path"), record.get("depth_file_path") or record.get("depth_path")
        if not (isinstance(image, str) and isinstance(depth, str)):
            raise ValueError(f"{where} has no file_path or no depth_file_path: export it with depth")
        image, depth = (Path(file).as_posix() for file in (image, depth))
        image += "" if Path(image).suffix else ".png"  # as instant-ngp completes it
        frames.append(ListedFrame(image, depth, None, camera_of({**shared, **record}, where)))
    return frames


def stated_scale(path: Path) -> float | None:
    """Return the meters per step that ``transforms.json`` states for its depth files; None: it does not."""
    if path.suffix.lower() != ".json":
        return None
    stored: Any = read_json(path)
    for key in ("integer_depth_scale", "depth_unit_scale_factor"):
        if isinstance(stored, Mapping) and isinstance(stored.get(key), int | float):
            return float(stored[key])
    return None

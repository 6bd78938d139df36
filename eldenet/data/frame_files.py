"""Find the files of a recording and put those of one frame together: by name, by time, or by order."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eldenet.data.io import HEIF_ENDINGS
from eldenet.data.paths import as_on_disk, composed, natural_order, visible_files
from eldenet.system.files import read_text

Key = tuple[str, ...]
"""A file's scene, part by part, if any, and its name or time: no other file of its kind has the same."""
PAIR_BY = ("name", "time", "order")
# seconds, milliseconds, microseconds or nanoseconds since 1970: 2001 is above the first, 2286 below the next
_EPOCHS = ((1e18, 1e9), (1e15, 1e6), (1e12, 1e3), (1e9, 1.0))
_WILDCARDS = re.compile(r"\*\*/|\*")


def find_frame_files(root: Path, place: str, endings: Sequence[str]) -> dict[Key, str]:
    """Return the files of one kind below ``root``, by their keys.

    Args:
        root: the data set's folder.
        place: a folder (``rgb``), a pattern of folders (``*/rgb``: one per scene) or of files
            (``*_color.png``), or a list in TUM's format (``rgb.txt``: time and file in each line). What the
            wildcards of a pattern stand for is the key.
        endings: of the files.

    Raises:
        ValueError: two files have one key, or a line of a list is wrong.
    """
    if is_list(place):
        return _listed(root, place)
    fixed = place.split("*")[0].rpartition("/")[0] if "*" in place else place
    as_file, as_folder = _expressions(place.removeprefix("./").strip("/"))
    found: dict[Key, str] = {}
    # no warning about HEIC pictures that lie beside the depth maps: they are read as pictures
    shown = visible_files(root / fixed, (*endings, *HEIF_ENDINGS))
    below = len(root.parts)
    for parts in sorted(path.parts[below:] for path in shown if path.suffix.lower() in endings):
        file = "/".join(parts)
        match = as_file.fullmatch(file) or as_folder.fullmatch(file)
        if match is None:
            continue
        key = tuple(composed(part) for part in match.groups() if part)
        if key in found:
            raise ValueError(f"{root}: {found[key]} and {file} have the same name: remove one of them")
        found[key] = file
    return found


def _expressions(place: str) -> tuple[re.Pattern[str], re.Pattern[str]]:
    """Expressions for the path of a file that a pattern names, and of one in a folder that it names."""
    ending = r"\.[^./]+" if place.endswith(".*") else ""
    place = place.removesuffix(".*") if ending else place
    parts, start = [], 0
    for wildcard in _WILDCARDS.finditer(place):
        parts.append(re.escape(place[start : wildcard.start()]))
        parts.append("(?:(.*)/)?" if wildcard[0] == "**/" else "([^/]*)")
        start = wildcard.end()
    text = "".join(parts) + re.escape(place[start:])
    inside = "" if place in ("", ".") else f"{text}/"
    return re.compile(text + ending), re.compile(rf"{inside}(.+)\.[^./]+")


def _listed(root: Path, place: str) -> dict[Key, str]:
    found: dict[Key, str] = {}
    text = read_text(root / place, "give a folder, a pattern, or a list of times and files")
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.split(maxsplit=1)
        if not cells or cells[0].startswith("#"):
            continue
        if len(cells) != 2 or seconds_of(cells[0]) is None:
            raise ValueError(
                f"{root / place}, line {number}: expected a time [s] and a file, found {line[:200]!r}"
            )
        found[(cells[0],)] = as_on_disk(root, cells[1].strip())
    return found


def is_list(place: str) -> bool:
    """Whether a setting names a list of times and files instead of a folder or pattern."""
    return place.endswith(".txt") and "*" not in place


def name_of(key: Key) -> str:
    """Return the name of a frame in reports."""
    return "/".join(key)


def expected_file(place: str, key: Key) -> str:
    """Return what the file of a key would be called, for messages."""
    if is_list(place):
        return f"{place} ({key[-1]})"
    parts = iter(key)
    filled = _WILDCARDS.sub(lambda found: next(parts, "*") + "/" * (found[0] == "**/"), place)
    left = list(parts)
    return f"{filled}/{'/'.join(left)}.*" if left else filled


def seconds_of(name: str) -> float | None:
    """Return the time [s] that a name ends with, or None.

    Seconds with a fraction, or seconds, milliseconds, microseconds or nanoseconds since 1970. A number of
    less than ten digits without a fraction is that of a frame.
    """
    number = re.search(r"\d+(\.\d+)?$", name)
    if number is None:
        return None
    value = float(number[0])
    unit = next((per_second for least, per_second in _EPOCHS if value >= least), 1.0)
    return value / unit if number[1] or value >= 1e9 else None


def partners(ones: Sequence[Key], others: Sequence[Key], by: str, tolerance: float) -> dict[Key, Key]:
    """Return the partner of each key that has one, of the same scene.

    Args:
        ones: of the files to find partners for.
        others: the files to choose from; each is taken once.
        by: "name" (equal keys), "time" (nearest, at most ``tolerance`` apart) or "order" (in natural order).
        tolerance: largest difference of time [s].

    Raises:
        ValueError: a name holds no time, or by order the numbers of files differ.
    """
    if by == "name":
        return {key: key for key in set(ones) & set(others)}
    pairs: dict[Key, Key] = {}
    right = _by_scene(others)
    for scene, left in _by_scene(ones).items():
        if by == "time":
            pairs |= _nearest(left, right.get(scene, []), tolerance)
        elif len(left) == len(right.get(scene, [])):
            pairs |= dict(zip(left, right[scene], strict=True))
        else:
            place = f" in {'/'.join(scene)}" if scene else ""
            raise ValueError(
                f"{len(left)} and {len(right.get(scene, []))} files{place} cannot be paired by order: remove "
                "those without a partner, or pair by name or time (data.pair_by)"
            )
    return pairs


def _by_scene(keys: Sequence[Key]) -> dict[Key, list[Key]]:
    scenes: dict[Key, list[Key]] = {}
    for key in sorted(keys, key=lambda key: natural_order(name_of(key))):
        scenes.setdefault(key[:-1], []).append(key)
    return scenes


def _times(keys: Sequence[Key]) -> np.ndarray:
    times = [seconds_of(key[-1]) for key in keys]
    if None in times:
        raise ValueError(
            f"{name_of(keys[times.index(None)])} does not end with a time (seconds with a fraction, or since "
            "1970), so files cannot be paired by time: pair them by name or order (data.pair_by)"
        )
    return np.array(times, np.float64)


def _nearest(left: Sequence[Key], right: Sequence[Key], tolerance: float) -> dict[Key, Key]:
    """Pairs of nearest times, the nearest pair first, as TUM's ``associate.py`` forms them."""
    ones, others = _times(left), _times(right)
    order = np.argsort(others)
    slack = 4 * float(np.spacing(others.max(initial=1.0)))  # of a double that holds a time since 1970
    candidates = []
    for i, time in enumerate(ones):
        first, end = np.searchsorted(others[order], (time - tolerance - slack, time + tolerance + slack))
        candidates += [(abs(others[j] - time), i, int(j)) for j in order[first:end]]
    pairs: dict[Key, Key] = {}
    taken: set[int] = set()
    for _, i, j in sorted(candidates):
        if left[i] not in pairs and j not in taken:
            pairs[left[i]] = right[j]
            taken.add(j)
    return pairs


def smallest_gap(ones: Sequence[Key], others: Sequence[Key]) -> float:
    """Return the least difference of time [s] between two files of one scene; infinite if there are none."""
    right = _by_scene(others)
    gaps = [math.inf]
    for scene, left in _by_scene(ones).items():
        if scene in right:
            gaps.append(float(np.abs(_times(left)[:, None] - _times(right[scene])[None]).min()))
    return min(gaps)


def frames_by_pairing(ones: Sequence[Key], others: Sequence[Key], tolerance: float) -> dict[str, int]:
    """Return how many frames pairing by "name", "time" and "order" would find, where it finds any."""
    found: dict[str, int] = {}
    for by in PAIR_BY:
        try:
            found[by] = len(partners(ones, others, by, tolerance))
        except ValueError:
            continue
    return {by: count for by, count in found.items() if count}

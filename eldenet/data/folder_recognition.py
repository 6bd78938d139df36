"""What a folder of pictures and depth seems to be, and each group of settings that may read it."""

import math
import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from eldenet.data.camera_files import CAMERA_ENDINGS, Camera, read_camera
from eldenet.data.folder import PARTS, FolderDataset, named_parts
from eldenet.data.frame_files import Key, find_frame_files, frames_by_pairing, partners
from eldenet.data.frame_lists import read_frame_list, stated_scale
from eldenet.data.inspection import PLAUSIBLE, inverse_doubt, is_farther_below
from eldenet.data.io import ENCODINGS, IMAGE_ENDINGS, is_turned, read_image, read_raw_depth
from eldenet.data.known_layouts import KNOWN_LAYOUTS
from eldenet.data.paths import files_below
from eldenet.data.recording_layout import DEPTH_ENDINGS, TOLERANCE, Layout, RecordedFrame
from eldenet.data.splits import evenly_spaced
from eldenet.geometry import same_aspect, size_of_aspect

MOST_FILES = 200_000  # below a folder that are looked at
MOST_CAMERAS = 20  # files beside the frames that are read as a camera
SAMPLES = 8  # frames whose pictures and depth maps are looked at
INPUT_SIZE, MAX_DEPTH = (240, 320), 10.0  # of data=folder
SPARSE_SHARE = 0.2  # of the pixels: points of a LiDAR rather than a depth camera's map
_DIGITS = re.compile(r"\d+(?:\.\d+)?")
_SERIES = 2  # so many files are one


class Reading(NamedTuple):
    """One way to read a folder."""

    note: str  # what it would mean, such as the median depth in a unit
    settings: tuple[str, ...]  # of the command line: data=folder, data.images=rgb ...

    @property
    def line(self) -> str:
        """The settings as a shell takes them."""
        return " ".join(shlex.quote(word) for word in self.settings)


@dataclass
class Recognized:
    """What a folder may be."""

    title: str  # what it seems to be
    facts: list[str] = field(default_factory=list)  # files, sizes, numbers, lens and pairs, one line each
    # the ways to read it; several where its files allow several
    readings: list[Reading] = field(default_factory=list)


class _Series(NamedTuple):
    """Files of one kind in one folder or pattern."""

    place: str  # the setting that finds them
    kind: str  # picture, depth, confidence or camera
    first: str  # of the files


def recognize(folder: Path) -> list[Recognized]:
    """Return what a folder may be; nothing if it is unknown.

    Raises:
        FileNotFoundError: there is no such folder.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is not a folder: give the folder of your recordings")
    beside = sorted(path for path in folder.iterdir() if path.is_dir() and path.name[0] != ".")
    return _known(folder) or [one for below in beside for one in _known(below)] or _recordings(folder)


def _known(folder: Path) -> list[Recognized]:
    """The data sets that a folder may be."""
    found = []
    for layout in KNOWN_LAYOUTS:
        if layout.fits(folder):
            settings = tuple(word.format(root=folder) for word in layout.settings)
            found.append(Recognized(layout.title, readings=[Reading("", settings)]))
    return found


def _recordings(folder: Path) -> list[Recognized]:
    """The recordings that a folder may be: one for each set of pairs that a list or a pairing finds."""
    visible = (path for path in files_below(folder) if path.is_file())
    files = sorted(path.relative_to(folder).as_posix() for path in islice(visible, MOST_FILES))
    series = _series(folder, files)
    candidates = list(_lists(folder, files)) or list(_pairs(folder, series))
    if not candidates and (refused := _refused(folder, files)):
        return [Recognized("files that are not read as they are", refused)]
    found: dict[frozenset[tuple[str, ...]], Recognized] = {}
    for title, settings in candidates:
        try:
            frames = list(Layout(**settings).frames(folder, strict=False).values())
        except (ValueError, OSError) as error:
            found[frozenset({(title,)})] = Recognized(f"a recording: {title}", [f"not read so yet: {error}"])
            continue
        pairs = frozenset(frame.files for frame in frames)
        if pairs not in found:  # by time and by order may be the same
            found[pairs] = _describe(folder, title, settings, frames, series, files)
    return list(found.values())


def _refused(folder: Path, files: Sequence[str]) -> list[str]:
    """What the reader says about the first picture or depth map of a folder, where it refuses it."""
    firsts: dict[str, str] = {}
    for file in files:
        if Path(file).suffix.lower() in {*IMAGE_ENDINGS, *DEPTH_ENDINGS}:
            firsts.setdefault(file.rpartition("/")[0], file)
    lines = []
    for file in list(firsts.values())[:SAMPLES]:
        if not _kind(folder, file):
            try:
                (read_raw_depth if "depth" in file.lower() else read_image)(folder / file)
            except (ValueError, OSError) as error:
                lines.append(str(error))
    return lines


def _lists(folder: Path, files: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Lists of frames at the top of the folder, with the settings that read them."""
    for file in files:
        if "/" in file or Path(file).suffix not in (".json", ".txt", ".csv"):
            continue
        try:
            frames = read_frame_list(folder / file, allow_outside=False, tolerance=math.inf)
        except (ValueError, OSError):
            continue
        if all((folder / name).is_file() for name in (frames[0].image, frames[0].depth)):
            yield f"a list of frames ({file})", {"csv": file}
    listed = {}
    for file in (name for name in files if "/" not in name and name.endswith(".txt")):
        try:
            entries = find_frame_files(folder, file, ())
        except (ValueError, OSError):
            continue
        first = next(iter(entries.values()), "")
        if (folder / first).is_file() and (kind := _kind(folder, first)):
            listed[kind] = file
    if "picture" in listed and "depth" in listed:
        settings = {"images": listed["picture"], "depths": listed["depth"]}
        yield "lists of times and files, as TUM's", settings


def _series(folder: Path, files: Sequence[str]) -> list[_Series]:
    """Group files by folder and by name without numbers; scenes of one structure become one series."""
    groups: dict[tuple[str, str], list[str]] = {}
    for file in files:
        parent, _, name = file.rpartition("/")
        if Path(name).suffix.lower() in {*IMAGE_ENDINGS, *DEPTH_ENDINGS, *CAMERA_ENDINGS}:
            groups.setdefault((parent, _DIGITS.sub("*", name)), []).append(file)
    single = Counter(parent for (parent, _), members in groups.items() if len(members) == 1)
    merged: dict[tuple[str, str], list[str]] = {}
    for (parent, template), members in groups.items():
        if single[parent] >= _SERIES and len(members) == 1:  # names without numbers: a.jpg, b.jpg
            template = f"*{Path(template).suffix}"
        merged.setdefault((parent, template), []).extend(members)
    kinds = {group: _kind(folder, members[len(members) // 2]) for group, members in merged.items()}
    found: dict[tuple[str, str], list[str]] = {}
    for (parent, template), members in merged.items():
        kind = kinds[parent, template]
        if kind:
            found.setdefault((_place(parent, template, kinds), kind), []).extend(members)
    # one picture and its depth are a recording; one file of another kind is no series
    return [
        _Series(place, kind, members[0])
        for (place, kind), members in found.items()
        if len(members) >= _SERIES or kind in ("picture", "depth")
    ]


def _place(parent: str, template: str, kinds: Mapping[tuple[str, str], str]) -> str:
    """The setting that finds a group of files: their folder where it holds nothing else, else a pattern.

    ``kinds`` are those of all groups, each a folder and a template of names. A folder's name becomes ``*``
    where others in its place hold files of this kind too: scenes, or the parts train, val and test.
    """
    kind = kinds[parent, template]
    # notes beside pictures are not read as pictures
    read = [
        group for group in kinds if group[0] == parent and Path(group[1]).suffix.lower() in _endings(kind)
    ]
    alone = parent and all(kinds[group] == kind for group in read)
    parts = parent.split("/")
    folders = [one.split("/") for (one, _), other in kinds.items() if other == kind]
    for place in range(len(parts)):
        pattern = [*parts[:place], "*", *parts[place + 1 :]]
        others = {
            names[place].lower()
            for names in folders
            if len(names) == len(parts)
            and all(part in (name, "*") for name, part in zip(names, pattern, strict=True))
        }
        is_last = place == len(parts) - 1
        are_parts = others <= PARTS.keys()
        if len(others) >= _SERIES and (are_parts or not is_last or not alone):  # rgb and depth are no scenes
            parts[place] = "*"
            if not are_parts:
                break
    parent = "/".join(parts)
    return parent if alone else f"{parent}/{template}".lstrip("/")


def _kind(folder: Path, file: str) -> str:
    """What a file holds: picture, depth, confidence, camera, or "" for anything else."""
    path, ending = folder / file, Path(file).suffix.lower()
    if ending in CAMERA_ENDINGS:
        return "camera" if _is_camera(path) else ""
    if ending in IMAGE_ENDINGS and ending not in DEPTH_ENDINGS:
        return "picture"
    try:
        raw = read_raw_depth(path)
    except (ValueError, OSError):
        try:
            read_image(path)
        except (ValueError, OSError):
            return ""
        return "" if "depth" in file.lower() else "picture"  # in color, depth is drawn, not stored
    if raw.dtype != np.uint8:
        return "depth"
    if "conf" in file.lower() or raw.max(initial=0) <= 2:
        return "confidence"
    return "depth" if "depth" in file.lower() else "picture"


def _is_camera(path: Path) -> bool:
    try:
        camera = read_camera(path)
    except (ValueError, OSError):
        return False
    return bool(camera.matrix[0, 0] > 10 and camera.matrix[1, 1] > 10 and (camera.matrix[:2, 2] > 0).all())


def _pairs(folder: Path, series: Sequence[_Series]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Series of pictures and of depth maps that pair, by name or else in any way, with their settings."""
    ways = {}
    colored_first = sorted(_of("picture", series), key=lambda one: _is_gray(folder / one.first))
    for pictures, maps in product(colored_first, _of("depth", series)):
        ones, others = _keys(folder, pictures), _keys(folder, maps)
        found = frames_by_pairing(ones, others, TOLERANCE)
        least = min(len(ones), len(others)) / 2
        ways[pictures.place, maps.place] = {
            by: count
            for by, count in found.items()
            if count >= max(least, 1 if by == "name" else _SERIES)  # one file each pair by name alone
        }
    by_name = {places for places, found in ways.items() if "name" in found}
    for (images, depths), found in ways.items():
        taken = any(images == one or depths == other for one, other in by_name)
        chosen = ["name"] if "name" in found else [] if taken else list(found)
        for by in chosen:
            how = {} if by == "name" else {"pair_by": by}
            yield f"pictures and depth maps, paired by {by}", {"images": images, "depths": depths, **how}


def _of(kind: str, series: Sequence[_Series]) -> list[_Series]:
    return [one for one in series if one.kind == kind]


def _is_gray(path: Path) -> bool:
    """Whether a picture has no color, as a mask; False if it cannot be read."""
    try:
        image = read_image(path)
    except (ValueError, OSError):
        return False
    return bool((image == image[..., :1]).all())


def _keys(folder: Path, series: _Series) -> list[Key]:
    try:
        return [key for key in find_frame_files(folder, series.place, _endings(series.kind)) if key]
    except ValueError:  # two files of one name
        return []


def _endings(kind: str) -> tuple[str, ...]:
    return {"picture": IMAGE_ENDINGS, "camera": CAMERA_ENDINGS}.get(kind, DEPTH_ENDINGS)


def _describe(
    folder: Path,
    title: str,
    settings: Mapping[str, Any],
    frames: Sequence[RecordedFrame],
    series: Sequence[_Series],
    files: Sequence[str],
) -> Recognized:
    """Look at a recording through its own reader, and work out the remaining settings."""
    settings = {"data": "folder", "root": str(folder), **settings}
    found = Recognized(f"a recording: {title}")
    whole = [frame for frame in frames if all((folder / file).is_file() for file in frame.files)]
    lost = len(frames) - len(whole)
    skip = f"; frames that lack a file: {lost}: add it, or data.on_error=skip to these settings" * bool(lost)
    found.facts.append(f"frames: {len(whole)}{skip}")
    found.facts += _unpaired(folder, settings, whole)
    if not whole:
        return found
    if parts := named_parts(whole):
        counts = ", ".join(f"{part} {count}" for part, count in Counter(parts).items())
        found.facts.append(f"parts, by the names of folders: {counts}")
        settings |= {"test_split": "test"} if {"val", "test"} <= set(parts) else {}
    settings |= _confidence(folder, whole, series, found.facts)
    stored = next((frame.camera for frame in whole if isinstance(frame.camera, Camera)), None)
    if stored is not None:
        found.facts.append(f"lens: in the list (fx {stored.matrix[0, 0]:.1f}, cx {stored.matrix[0, 2]:.1f})")
    else:
        settings |= _lens(folder, whole, series, files, found.facts)
    looked_at = _samples(folder, whole, found.facts)
    if not looked_at:
        return found
    picture, size, raw = looked_at[0]
    raws = [raw for *_, raw in looked_at]
    sizes = f"{size[1]}x{size[0]}, depth maps {raw.shape[1]}x{raw.shape[0]} {raw.dtype}"
    if len({(size, raw.shape) for _, size, raw in looked_at}) > 1:
        sizes += ", others differ"
    found.facts.insert(1, f"pictures {sizes} (width x height)")
    known = sum(_known_numbers(one).size for one in raws) / sum(one.size for one in raws)
    points = "; of a LiDAR? Then add data.ground_truth=sparse loss=l1_sparse" if known < SPARSE_SHARE else ""
    found.facts.append(f"pixels with depth: {known:.0%}{points}")
    turns: list[dict[str, Any]] = [{}]
    if not same_aspect(size, raw.shape) and same_aspect(size[::-1], raw.shape):
        if is_turned(picture):
            size = size[::-1]  # the reader turns the picture upright
        else:
            turns = [{"rotate_depth": 90}, {"rotate_depth": 270}]
            found.facts.append("depth is turned by 90 degrees; which way, the contact sheet shows")
    seen = size_of_aspect(INPUT_SIZE, (size[0], size[1]))
    if seen != INPUT_SIZE or seen[0] > size[0]:
        settings["input_size"] = "[{},{}]".format(*_in_tiles(seen, (size[0], size[1])))
    stated = stated_scale(folder / settings["csv"]) if "csv" in settings else None
    units = _units(raws, stated)
    if known and stated is None:
        found.facts.append(
            "unit: guessed from the numbers; where a distance that you know disagrees, give another, such as "
            f"'data.encoding={{scale: 0.01, dtype: {_encoding_dtype(raw)}}}' (centimeters)"
        )
    farther = Counter(is_farther_below(one) for one in raws)
    if line := inverse_doubt(farther[True], farther[False]):
        found.facts.append(line)
    for (note, unit), turn in product(units, turns):
        chosen = settings | unit | turn
        words = [
            f"{'' if key == 'data' else 'data.'}{key}={_written(value)}" for key, value in chosen.items()
        ]
        found.readings.append(Reading(note, tuple(words)))
    found.facts += _refusal(folder, chosen)
    return found


def _samples(
    folder: Path, frames: Sequence[RecordedFrame], facts: list[str]
) -> list[tuple[Path, tuple[int, int], np.ndarray]]:
    """Picture, its size and the raw numbers ``(h, w)`` of its depth, of a few frames that can be read."""
    found, faults = [], []
    for index in evenly_spaced(len(frames), SAMPLES):
        try:
            picture, depth = (folder / file for file in frames[index].files[:2])
            image, raw = read_image(picture), read_raw_depth(depth)
        except (ValueError, OSError) as error:
            faults.append(str(error))
        else:
            found.append((picture, (image.shape[0], image.shape[1]), raw))
    facts += faults[:1]
    return found


def _refusal(folder: Path, settings: Mapping[str, Any]) -> list[str]:
    """Why the settings do not read the first frame; nothing if they do."""
    given = {key: settings[key] for key in settings.keys() - {"data", "root", "input_size", "test_split"}}
    try:
        FolderDataset(folder, on_error="skip", **{"max_depth": MAX_DEPTH, **given}).load_frame(0)
    except (ValueError, OSError) as error:
        return [f"not read so yet: {error}"]
    return []


def _written(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key}: {entry}" for key, entry in value.items()) + "}"
    return str(value)


def _unpaired(folder: Path, settings: Mapping[str, Any], frames: Sequence[RecordedFrame]) -> list[str]:
    """A line each on the pictures and depth maps that have no partner."""
    lines = []
    used = {file for frame in frames for file in frame.files}
    for setting, kind, endings in (
        ("images", "pictures", IMAGE_ENDINGS),
        ("depths", "depth maps", DEPTH_ENDINGS),
    ):
        if setting in settings:
            alone = sorted(set(find_frame_files(folder, settings[setting], endings).values()) - used)
            if alone:
                lines.append(f"{len(alone)} {kind} have no partner, such as {alone[0]}")
    return lines


def _confidence(
    folder: Path, frames: Sequence[RecordedFrame], series: Sequence[_Series], facts: list[str]
) -> dict[str, Any]:
    """The one series of confidence maps named as the frames; several are told to choose from."""
    names = {Path(frame.files[1]).stem for frame in frames} | {frame.key[-1] for frame in frames}
    found = [one for one in _of("confidence", series) if {key[-1] for key in _keys(folder, one)} & names]
    if len(found) > 1:
        facts.append(f"confidence maps in {', '.join(one.place for one in found)}: add data.confidence=")
    if len(found) != 1:
        return {}
    values = read_raw_depth(folder / found[0].first)
    facts.append(f"confidence maps in {found[0].place}, {values.min()} to {values.max()}")
    return {"confidence": found[0].place}


def _lens(
    folder: Path,
    frames: Sequence[RecordedFrame],
    series: Sequence[_Series],
    files: Sequence[str],
    facts: list[str],
) -> dict[str, Any]:
    """The one file, or series of files, that hold the intrinsics; several are told to choose from."""
    keys = [frame.key for frame in frames]
    first_files = {
        one.place: one.first
        for one in _of("camera", series)
        if len(partners(keys, _keys(folder, one), "name", 0)) == len(keys)
    }
    if not first_files:
        beside = [file for file in files if file.count("/") <= 1 and Path(file).suffix in CAMERA_ENDINGS]
        first_files = {file: file for file in beside[:MOST_CAMERAS] if _is_camera(folder / file)}
    if not first_files:
        facts.append("lens: not found; give data.intrinsics=[fx,fy,cx,cy] if you know it")
        return {}
    matrices = {place: read_camera(folder / file).matrix for place, file in first_files.items()}
    described = [f"{place} (fx {m[0, 0]:.1f}, cx {m[0, 2]:.1f})" for place, m in matrices.items()]
    choose = "; add one as data.intrinsics=" if len(described) > 1 else ""
    facts.append(f"lens: {', '.join(described)}{choose}")
    return {} if choose else {"intrinsics": next(iter(matrices))}


def _known_numbers(raw: np.ndarray) -> np.ndarray:
    """The numbers ``(N,)`` that may be depth; the largest of 16 bits often says that it is unknown."""
    most = np.float64(np.iinfo(np.uint16).max)  # in float16 it would be infinite
    return np.asarray(raw[np.isfinite(raw) & (raw > 0) & (raw != most)])


def _encoding_dtype(raw: np.ndarray) -> str:
    """The dtype of an encoding that such numbers may have."""
    return "float" if raw.dtype.kind == "f" else "uint8" if raw.dtype == np.uint8 else "uint16"


def _in_tiles(seen: tuple[int, int], most: tuple[int, int]) -> tuple[int, int]:
    """``(height, width)`` [px] of whole tiles of 32, with about the shape and the pixels of ``seen``.

    Pictures smaller than that, ``most``, are not enlarged.
    """
    rows, columns = (range(32, max(side, 32) + 1, 32) for side in most)
    wanted = min(seen, most, key=math.prod)

    def cost(size: tuple[int, int]) -> float:
        high, wide = (math.log(new / old) for new, old in zip(size, wanted, strict=True))
        return abs(wide - high) + 0.1 * abs(wide + high)

    return min(product(rows, columns), key=cost)


def _units(raws: Sequence[np.ndarray], stated: float | None) -> list[tuple[str, dict[str, Any]]]:
    """Each encoding with a plausible median depth: a note of the median, and the settings of the encoding.

    ``stated`` are the meters per step that a file states, if one does.
    """
    values = np.concatenate([_known_numbers(raw) for raw in raws])
    if not values.size:
        return [("no depth above 0 in the files looked at", {})]
    dtype = _encoding_dtype(values)
    given: dict[str, Any] = {"scale": stated or 0.001, "dtype": dtype}
    rows: list[tuple[Any, float]] = [(given, given["scale"])]
    if stated is None or np.isclose(stated, 0.001):
        named = [
            row for row in ENCODINGS.values() if row.dtype == dtype and row.decode is None and not row.offset
        ]
        rows = [(row.name, row.scale) for row in named if stated is None or np.isclose(row.scale, stated)]
        if stated is None and values.dtype == np.uint16 and not (values % 8).any():  # turned by three bits
            rows.append(("sunrgbd", ENCODINGS["sunrgbd"].scale / 8))
        if dtype == "float":
            rows.append((given, 0.001))
    found: list[tuple[str, dict[str, Any]]] = []
    for encoding, scale in rows:
        median, farthest = (float(np.percentile(values, q)) * scale for q in (50, 99))
        if PLAUSIBLE[0] <= median <= PLAUSIBLE[1]:
            setting = {} if encoding == "mm" else {"encoding": encoding}
            most = {"max_depth": math.ceil(farthest)} if farthest > MAX_DEPTH else {}
            found.append(
                (f"half of all depth nearer than {median:.3g} m, as {_written(encoding)}", setting | most)
            )
    if not found:
        found.append((f"half of the numbers below {np.median(values):g}: in no known unit a depth", {}))
    return found

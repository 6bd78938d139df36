"""The frames of a recording: which picture, depth map, confidence map and camera belong together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from eldenet.data.camera_files import CAMERA_ENDINGS, Camera, given_camera, read_camera
from eldenet.data.frame_files import (
    PAIR_BY,
    Key,
    expected_file,
    find_frame_files,
    frames_by_pairing,
    is_list,
    name_of,
    partners,
    smallest_gap,
)
from eldenet.data.frame_lists import read_frame_list
from eldenet.data.io import IMAGE_ENDINGS
from eldenet.data.paths import as_on_disk, composed
from eldenet.system.checks import one_of
from eldenet.system.errors import some_of, warn_once

TOLERANCE = 0.02  # of data.tolerance, unless given [s]
DEPTH_ENDINGS = (".png", ".npy", ".tif", ".tiff", ".pgm", ".pfm", ".exr")


class RecordedFrame(NamedTuple):
    """The files of a frame, relative to the data set's folder, and what a list says of it."""

    key: Key  # what tells the frame from the others
    files: tuple[str, ...]  # picture, depth map and, if there is one, confidence map
    scene: str = ""  # where it was recorded; "": not known
    camera: Camera | str | None = None  # intrinsics and pose, or the file that holds them; None: not known


@dataclass(frozen=True)
class Layout:
    """How a recording lies on disk; :class:`~eldenet.data.folder.FolderDataset` explains the settings."""

    images: str = "images"
    depths: str = "depths"
    csv: str | None = None
    allow_outside: bool = False
    confidence: str | None = None
    pair_by: str | None = None
    tolerance: float = TOLERANCE
    intrinsics: Sequence[Any] | Mapping[str, Any] | str | None = None

    def __post_init__(self) -> None:
        one_of("pair_by", self.pair_by, (None, *PAIR_BY))

    @property
    def by(self) -> str:
        """How files are put together: "name", "time" or "order"."""
        lists = is_list(self.images) and is_list(self.depths) and not self.csv
        return self.pair_by or ("time" if lists else "name")

    @property
    def needed(self) -> list[str]:
        """Files and folders that the data set's folder must contain."""
        return [self.csv] if self.csv else [p for p in (self.images, self.depths) if "*" not in p]

    def camera_file(self, root: Path) -> Path | None:
        """Return the file of the one camera of all frames, None if there is none."""
        if not isinstance(self.intrinsics, str) or not (root / self.intrinsics).is_file():
            return None
        return root / self.intrinsics

    def camera(self, root: Path) -> Camera | None:
        """Return the one camera of all frames, None if there is none."""
        if isinstance(self.intrinsics, str):
            file = self.camera_file(root)
            return None if file is None else read_camera(file)
        return None if self.intrinsics is None else given_camera(self.intrinsics)

    def frames(self, root: Path, *, strict: bool) -> dict[str, RecordedFrame]:
        """Find all frames: name -> frame.

        Where a file is missing, ``strict`` raises; else the frame has ``name.*`` in its place, a file that
        does not exist, so :class:`~eldenet.data.base.FileDataset` leaves the frame out.

        Raises:
            FileNotFoundError: files are missing, or have no partner.
            ValueError: names or lines are wrong.
        """
        frames = self._listed(root) if self.csv else self._found(root, strict=strict)
        if self.confidence is not None:
            keys = {name: frame.key for name, frame in frames.items()}
            maps = self._beside(root, "confidence", self.confidence, DEPTH_ENDINGS, keys, strict=strict)
            frames = {n: f._replace(files=(*f.files[:2], maps[n])) for n, f in frames.items()}
        if isinstance(self.intrinsics, str) and self.camera_file(root) is None:
            keys = {name: frame.key for name, frame in frames.items()}
            files = self._beside(root, "intrinsics", self.intrinsics, CAMERA_ENDINGS, keys, strict=strict)
            frames = {name: frame._replace(camera=files[name]) for name, frame in frames.items()}
        return frames

    def _listed(self, root: Path) -> dict[str, RecordedFrame]:
        path = root / str(self.csv)
        listed = read_frame_list(path, allow_outside=self.allow_outside, tolerance=self.tolerance)
        frames = {}
        for frame in listed:
            name = composed(frame.image.rsplit(".", 1)[0])
            listed_files = (frame.image, frame.depth, *([frame.confidence] if frame.confidence else []))
            files = tuple(as_on_disk(root, file) for file in listed_files)
            frames[name] = RecordedFrame((Path(name).name,), files, frame.scene, frame.camera)
        if len(frames) != len(listed):
            raise ValueError(f"{path} has {len(listed)} lines but only {len(frames)} different pictures")
        return frames

    def _found(self, root: Path, *, strict: bool) -> dict[str, RecordedFrame]:
        pictures = find_frame_files(root, self.images, IMAGE_ENDINGS)
        maps = find_frame_files(root, self.depths, DEPTH_ENDINGS)
        both = set(pictures.values()) & set(maps.values())  # *.png finds a_depth.png beside a.png, too
        if len(pictures) > len(both):
            pictures = {key: file for key, file in pictures.items() if file not in both}
        elif len(maps) > len(both):
            maps = {key: file for key, file in maps.items() if file not in both}
        for kind, setting, place, found, endings in (
            ("pictures", "images", self.images, pictures, IMAGE_ENDINGS),
            ("depth maps", "depths", self.depths, maps, DEPTH_ENDINGS),
        ):
            if not found:
                raise FileNotFoundError(
                    f"{root / place} holds no {kind} ({', '.join(endings)}): put them there, or give another "
                    f"data.root or data.{setting}"
                )
        pairs = partners(list(pictures), list(maps), self.by, self.tolerance)
        if not pairs:
            raise FileNotFoundError(self._nothing_pairs(root, pictures, maps))
        if self.by == "time":
            self._say_left_out(root, pictures, maps, pairs)
            named = list(pairs)
        else:
            lonely = [
                f"{pictures[k]} (no depth in {self.depths})" for k in sorted(set(pictures) - set(pairs))
            ]
            alone = sorted(set(maps) - set(pairs.values()))
            lonely += [f"{maps[k]} (no picture in {self.images})" for k in alone]
            if lonely and strict:
                raise FileNotFoundError(
                    f"{len(lonely)} files in {root} have no partner: {some_of(lonely)}. Add them, list "
                    "pairs of different names in a CSV (data.csv=...), or leave these frames out "
                    "(data.on_error=skip)"
                )
            named = [*pictures, *alone]
        frames = {}
        for key in named:
            picture = pictures.get(key) or expected_file(self.images, key)
            depth_key = pairs.get(key, key)
            depth = maps.get(depth_key) or expected_file(self.depths, depth_key)
            frames[name_of(key)] = RecordedFrame(key, (picture, depth), "/".join(key[:-1]))
        return frames

    def _nothing_pairs(self, root: Path, pictures: Mapping[Key, str], maps: Mapping[Key, str]) -> str:
        ones, others = list(pictures), list(maps)
        text = (
            f"no picture in {root / self.images} has a depth map in {self.depths} by {self.by}, such as "
            f"{pictures[min(ones)]} and {maps[min(others)]}"
        )
        if self.by == "time":
            gap = smallest_gap(ones, others)
            text += f" (the nearest are {gap:.3g} s apart, data.tolerance={self.tolerance:g})"
        ways = frames_by_pairing(ones, others, self.tolerance)
        named = [f"data.pair_by={by} finds {count} frames" for by, count in ways.items()]
        return f"{text}: " + (", ".join(named) or "list the pairs in a CSV (data.csv=...)")

    def _say_left_out(
        self, root: Path, pictures: Mapping[Key, str], maps: Mapping[Key, str], pairs: Mapping[Key, Key]
    ) -> None:
        alone = sorted(set(pictures) - set(pairs))
        unused = len(set(maps) - set(pairs.values()))
        if alone or unused:
            warn_once(
                f"{root}: {len(pairs)} pictures have a depth map within {self.tolerance:g} s; {len(alone)} "
                f"pictures and {unused} depth maps have none"
                + (f", such as {pictures[alone[0]]}" if alone else "")
            )

    def _beside(
        self,
        root: Path,
        setting: str,
        place: str,
        endings: Sequence[str],
        keys: Mapping[str, Key],
        *,
        strict: bool,
    ) -> dict[str, str]:
        """The file of each frame in another place: by the frame's name, else as depth was paired."""
        found = find_frame_files(root, place, endings)
        if not found:
            raise FileNotFoundError(
                f"{root / place} holds no files for data.{setting} ({', '.join(endings)}): give their "
                "folder or pattern"
            )
        pairs = partners(list(keys.values()), list(found), "name", self.tolerance)
        if not pairs and self.by != "name":
            pairs = partners(list(keys.values()), list(found), self.by, self.tolerance)
        files = {name: found[pairs[key]] for name, key in keys.items() if key in pairs}
        lonely = [name for name in keys if name not in files]
        unused = sorted(set(found) - set(pairs.values()))
        if lonely and strict:
            raise FileNotFoundError(
                f"{len(lonely)} of {len(keys)} frames have no {setting} in {root / place}: "
                f"{some_of(lonely)}. Add them, or leave these frames out (data.on_error=skip)"
            )
        if unused and strict and setting == "confidence" and self.by == "name" and not self.csv:
            files_alone = [found[key] for key in unused]
            raise FileNotFoundError(
                f"{len(unused)} confidence maps in {root} have no depth map: {some_of(files_alone)}. Add the "
                "depth maps, or remove these"
            )
        return files | {name: expected_file(place, keys[name]) for name in lonely}

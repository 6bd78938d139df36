"""What ``eldenet.predict`` writes: names that do not collide, pictures, point clouds, a video."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldenet.data.io import IMAGE_ENDINGS
from eldenet.deploy.manifest import Written
from eldenet.deploy.pointcloud import write_ply
from eldenet.deploy.predictor import to_millimeters
from eldenet.geometry import back_project, check_intrinsics
from eldenet.visualization import photo_beside_depth, visible_range, write_picture

if TYPE_CHECKING:
    from eldenet.results.run_log import RunLog
    from eldenet.system.signals import GracefulStop

ENDING = {"depth": "_depth.png", "color": "_color.png", "ply": ".ply"}


@dataclass
class Results:
    """Where results go, in which formats, and a count of what was written.

    Attributes:
        folder: of all results.
        formats: some of "depth", "color", "ply".
        intrinsics: ``(3, 3)`` of the source's pictures [px], for point clouds and 3D boxes.
        depth_range: (near, far) of the colors [m]; None: each picture's own.
        overwrite: replace files that are there.
        images: pictures or frames written so far.
        skipped: what could not be read.
        too_far: pixels beyond what 16 bits of millimeters hold.
        size: ``(height, width)`` of the first picture [px]; intrinsics hold for this size alone.
        frames_per_second: of a video, once it is open.
        video: its results' name; empty for pictures.
        also: is given the name, photo, depth and time of each picture too.
        written: the list of what was written; with ``overwrite``, what earlier calls' lists name goes first.
        removed: files of earlier calls that went.
        changed: files of earlier calls that somebody changed since: they stay.
    """

    folder: Path
    formats: tuple[str, ...]
    intrinsics: np.ndarray | None = None
    depth_range: tuple[float, float] | None = None
    overwrite: bool = False
    images: int = 0
    skipped: list[str] = field(default_factory=list)
    too_far: int = 0
    size: tuple[int, int] | None = None
    frames_per_second: float = 30.0
    video: str = ""
    also: Callable[[str, np.ndarray, np.ndarray, float | None], None] | None = None
    written: Written | None = None
    removed: int = 0
    changed: list[Path] = field(default_factory=list)

    def files(self, name: str, *, is_video: bool = False) -> list[Path]:
        """Where the results of the picture or video ``name`` go; a folder stands for what it will hold."""
        if is_video:
            files = [self.folder / f"{name}_depth.mp4"] if "color" in self.formats else []
            return files + [self.folder / name] * bool(set(self.formats) - {"color"})
        return [self.folder / f"{name}{ENDING[kind]}" for kind in self.formats]

    def refuse_to_overwrite(self, sources: Sequence[Path], files: Sequence[Path]) -> None:
        """Raise ValueError if a result would replace a source, or (unless that is wanted) an older result."""
        there = [file for file in files if file.exists()]
        own = {path.resolve() for path in sources}
        lost = [file for file in there if file.resolve() in own]
        if lost:
            raise ValueError(f"{lost[0]} is a source and would be overwritten: give another output=")
        if there and not self.overwrite:
            raise ValueError(
                f"{len(there)} results are there already ({there[0]}{', ...' if there[1:] else ''}): give "
                "another output=, or overwrite=true"
            )

    def write(
        self,
        name: str,
        photo: np.ndarray,
        depth: np.ndarray,
        formats: Sequence[str],
        *,
        time: float | None = None,
    ) -> None:
        """Write one picture's results: ``photo (H, W, 3)`` uint8 RGB, ``depth (H, W)`` [m].

        ``time`` is when a frame of a video was taken [s], from any zero.

        Raises:
            ValueError: intrinsics were given, and they or the pictures before it are of another size.
        """
        height, width = depth.shape
        self.size = self.size or (height, width)
        if self.intrinsics is not None and self.size != (height, width):
            raise ValueError(
                f"{name} is {height} x {width}, the pictures before it {self.size[0]} x {self.size[1]}: "
                "one set of intrinsics fits one size, so predict them in separate folders"
            )
        if self.intrinsics is not None:
            check_intrinsics(self.intrinsics, self.size)
        if not self.images and self.overwrite and self.written is not None:
            self.removed, self.changed = self.written.remove_earlier()
        place = {kind: self.folder / f"{name}{ENDING[kind]}" for kind in formats}
        if "ply" in formats and self.intrinsics is not None:
            write_ply(place["ply"], back_project(depth, self.intrinsics), photo)
        if "depth" in formats:
            steps = to_millimeters(depth)
            self.too_far += int(((steps == 0) & (depth > 1)).sum())
            _write_png(place["depth"], steps)
        if "color" in formats:
            near, far = self.depth_range or visible_range(depth)
            write_picture(place["color"], photo_beside_depth(photo, depth, near, far))
        for file in place.values():
            self.note(file, name)
        if self.also is not None:
            self.also(name, photo, depth, time)
        self.images += 1

    def note(self, file: Path, name: str) -> None:
        """Put a file that was written, of the picture or frame ``name``, on the list."""
        if self.written is not None:
            self.written.add(file, self.video or name)

    def say(self, log: "RunLog", what: str, rate: float, stop: "GracefulStop") -> None:
        """Say what was written, how fast, where, and what was not."""
        if stop and not self.images:
            log.say(f"stopped by {stop} before the first result: nothing is written")
            return
        ended = f"stopped by {stop}: " if stop else ""
        written = " + ".join(self.formats)
        log.say(
            f"{ended}{what}: {written} in {self.folder} ({rate:.1f} images/s, reading and writing included)"
        )
        if self.skipped:
            log.say(f"skipped {len(self.skipped)}:")
            for line in self.skipped:
                log.say(f"  {line}")
        if self.too_far:
            log.say(f"{self.too_far} pixels are farther than 65.535 m: 0 (unknown) in the depth files")
        if self.removed:
            log.say(f"removed {self.removed} file{'s' * (self.removed != 1)} of earlier calls")
        if self.changed:
            others = f" and {len(self.changed) - 1} others" if self.changed[1:] else ""
            log.say(f"kept, as it was changed since an earlier call wrote it: {self.changed[0]}{others}")


@contextmanager
def open_video(
    path: Path, per_second: float, finished: Callable[[Path], None] = lambda path: None
) -> Iterator[Callable[[np.ndarray], None]]:
    """Give a function that adds a frame ``(h, w, 3)`` uint8 RGB; the file appears at the end.

    So it does where an error or Ctrl-C ends it, for what a camera showed does not come again; a film without
    a frame leaves no file. ``finished`` is told of the file.

    Raises:
        ValueError: the film cannot be begun, or a frame is of another size than those before it.
        OSError: the film does not hold all that was added.
    """
    import cv2

    unfinished = path.with_name(f".{path.stem}.part.mp4")
    writer = None
    size, count = (0, 0), 0

    def add(picture: np.ndarray) -> None:
        nonlocal writer, size, count
        given = (picture.shape[1], picture.shape[0])
        if writer is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            size = given
            writer = cv2.VideoWriter(str(unfinished), cv2.VideoWriter.fourcc(*"mp4v"), per_second, size)
            if not writer.isOpened():
                raise ValueError(f"could not write {path}: no permission, or OpenCV without mp4v")
        if given != size:  # OpenCV would leave it out without a word
            raise ValueError(f"{path} shows {size} pixels (width, height), the next frame has {given}")
        writer.write(np.ascontiguousarray(picture[..., ::-1]))
        count += 1

    def finish() -> None:
        if writer is None:
            return
        writer.release()
        film = cv2.VideoCapture(str(unfinished))
        written = int(film.get(cv2.CAP_PROP_FRAME_COUNT)) if film.isOpened() else 0
        film.release()
        if written < count:  # OpenCV says nothing of that either
            unfinished.unlink(missing_ok=True)
            raise OSError(f"{path} would hold {written} of {count} frames: is the disk full?")
        unfinished.replace(path)
        finished(path)

    try:
        yield add
    except BaseException:
        with suppress(OSError):
            finish()
        raise
    finish()


def in_time(add: Callable[[np.ndarray], None], per_second: float) -> Callable[[np.ndarray, float], None]:
    """Give a function that adds a frame at the time when it was taken [s], from any zero.

    A frame stays until the next one's time, so that a film of a camera whose frames were dropped runs as fast
    as what it shows did. Of two frames within one of the film's the first is shown.

    Args:
        add: from :func:`open_video`.
        per_second: frames of the film.
    """
    latest: np.ndarray | None = None
    start, written = 0.0, 0

    def show(picture: np.ndarray, taken: float) -> None:
        nonlocal latest, start, written
        if latest is None:
            latest, start = picture, taken
        place = round((taken - start) * per_second)
        for number in range(written, place + 1):
            add(picture if number == place else latest)
        latest, written = picture, max(written, place + 1)

    return show


def name_results(source: Path, output: Path) -> dict[Path, str]:
    """Each picture's results by name, relative to the output folder; no two share one.

    A name is the picture's path below ``source`` without its ending; where two pictures of a folder differ
    in nothing but their ending, that becomes part of the name (``a_jpg``, ``a_png``).

    Raises:
        FileNotFoundError: there is no such source.
        ValueError: the folder holds no pictures, or names that cannot be told apart.
    """
    if source.is_file():
        return {source: source.stem}
    if not source.is_dir():
        raise FileNotFoundError(f"source={source} does not exist: give a picture, folder, video or camera:0")
    own = output.resolve()
    paths = [
        path
        for path in sorted(source.rglob("*"))
        if path.suffix.lower() in IMAGE_ENDINGS
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(source).parts)
        and (own == source.resolve() or own not in path.resolve().parents)  # results of earlier calls
    ]
    if not paths:
        raise ValueError(f"{source} holds no pictures ({', '.join(IMAGE_ENDINGS)})")
    names = {path: path.relative_to(source).with_suffix("").as_posix() for path in paths}
    often = Counter(name.casefold() for name in names.values())
    for path, name in names.items():
        if often[name.casefold()] > 1:
            names[path] = f"{name}_{path.suffix[1:]}"
    if len({name.casefold() for name in names.values()}) < len(names):
        raise ValueError(f"{source} holds pictures whose names differ too little: rename some of them")
    return names


def _write_png(path: Path, picture: np.ndarray) -> None:
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), picture):
        raise ValueError(f"could not write {path}")

"""What ``eldenet.predict`` writes: pictures, point clouds, videos. Files appear when they are complete."""

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.data.io import IMAGE_ENDINGS
from eldenet.data.paths import composed, natural_order, visible_files
from eldenet.deploy.video_files import USUAL_RATE, VIDEO_ENDINGS
from eldenet.geometry import PinholeCamera, back_project, check_intrinsics
from eldenet.system.errors import warn_once
from eldenet.system.files import read_json, write_bytes, write_text
from eldenet.uncertainty import UNSURE, DepthEstimate, as_estimate
from eldenet.visualization import photo_beside_depth, photo_beside_sigma, visible_range, write_picture

if TYPE_CHECKING:
    from eldenet.deploy.viewer import RerunViewer
    from eldenet.results.run_log import RunLog
    from eldenet.system.signals import GracefulStop

ENDING = {"depth": "_depth.png", "color": "_color.png", "ply": ".ply", "sigma": "_sigma.png"}
SIGMA_PICTURE = "_sigma_color.png"
UNFINISHED = ".unfinished.json"  # in the folder of results that are not complete
DEEPEST = 65.535  # [m] that a 16-bit PNG of millimeters holds
_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
_PLY_NAMES = {"<f4": "float", "|u1": "uchar"}


@dataclass
class Results:
    """Write results into a folder, and count them.

    Attributes:
        folder: of all results.
        formats: some of "depth", "color", "ply", "sigma".
        depth_range: (near, far) of the colors [m]; None: each picture's own.
        overwrite: replace files of the same name.
        one_size: refuse pictures of another size than the first, since intrinsics were given.
        images: pictures or frames written so far.
        skipped: reasons why pictures could not be read.
        too_far: pixels beyond :data:`DEEPEST`, which the depth files cannot hold.
        unsure: pixels where the network is unsure, and ``pixels`` all of them.
        size: ``(height, width)`` of the first picture [px].
        frames_per_second: of a video, once it is open.
        settings: all that decide what the results are. They are noted in ``folder`` until all results are
            written, so that the same command goes on after it was stopped. None: it starts again.
        viewer: shows each picture too, or None.
        also: receives the name, photo, depth, time and camera of each picture too.
    """

    folder: Path
    formats: tuple[str, ...]
    depth_range: tuple[float, float] | None = None
    overwrite: bool = False
    one_size: bool = False
    images: int = 0
    skipped: list[str] = field(default_factory=list)
    too_far: int = 0
    unsure: int = 0
    pixels: int = 0
    size: tuple[int, int] | None = None
    frames_per_second: float = USUAL_RATE
    settings: dict[str, Any] | None = None
    viewer: "RerunViewer | None" = None
    also: Callable[[str, np.ndarray, Any, float | None, PinholeCamera | None], None] | None = None

    def files(self, name: str, *, is_video: bool = False) -> list[Path]:
        """Files of the picture or video ``name``; the folder of a video's frames stands for its files."""
        if is_video:
            files = [self.folder / f"{name}_depth.mp4"] if "color" in self.formats else []
            return files + [self.folder / name] * bool(set(self.formats) - {"color"})
        endings = [ENDING[kind] for kind in self.formats] + [SIGMA_PICTURE] * ("sigma" in self.formats)
        return [self.folder / f"{name}{ending}" for ending in endings]

    @property
    def goes_on(self) -> bool:
        """Whether the same command was stopped here before all results were written."""
        try:
            noted = read_json(self.folder / UNFINISHED)
        except (ValueError, OSError):
            return False
        return not self.overwrite and self.settings is not None and noted == self.settings

    def begin(self) -> None:
        """Note the settings until :meth:`end`.

        Without settings, or with ``overwrite``, forget an earlier note: the folder may then hold results of
        other settings too.
        """
        if self.settings is not None and not self.overwrite:
            write_text(self.folder / UNFINISHED, json.dumps(self.settings))
        else:
            self.end()

    def end(self) -> None:
        """Forget the settings: all results are written."""
        (self.folder / UNFINISHED).unlink(missing_ok=True)

    def has(self, name: str, source: Path) -> bool:
        """Whether the results of a picture are there and newer than the picture."""
        files = self.files(name)
        return all(file.is_file() and file.stat().st_mtime > source.stat().st_mtime for file in files)

    def refuse_to_overwrite(self, sources: Sequence[Path], files: Sequence[Path]) -> None:
        """Raise ValueError if a result would replace a source, or an older result without ``overwrite``."""
        existing = [file for file in files if file.exists()]
        own = {path.resolve() for path in sources}
        lost = [file for file in existing if file.resolve() in own]
        if lost:
            raise ValueError(f"{lost[0]} is a source and would be overwritten: give another output=")
        if existing and not self.overwrite and not self.goes_on:
            raise ValueError(
                f"{len(existing)} results already exist, such as {existing[0]}: give another output=, or "
                "overwrite=true"
            )

    def write(
        self,
        name: str,
        photo: np.ndarray,
        depth: np.ndarray | DepthEstimate,
        formats: Sequence[str],
        *,
        time: float | None = None,
        camera: PinholeCamera | None = None,
    ) -> None:
        """Write, count and show the results of one picture.

        Args:
            name: its files begin with it.
            photo: ``(H, W, 3)`` uint8 RGB.
            depth: ``(H, W)`` [m].
            formats: the files to write; with "sigma" in the formats of all results, the colors are pale where
                the network is unsure.
            time: when a video's frame was taken [s], from any zero.
            camera: for the points and boxes.

        Raises:
            ValueError: the intrinsics do not fit the picture, or it has another size than the first one, with
                ``one_size``.
        """
        if not self.images:
            self.begin()
        estimate = as_estimate(depth)
        height, width = estimate.depth.shape
        self.size = self.size or (height, width)
        if self.one_size and self.size != (height, width):
            raise ValueError(
                f"{name} is {height} x {width}, but the previous pictures are {self.size[0]} x "
                f"{self.size[1]}: one set of intrinsics fits one size, so predict them in separate folders"
            )
        if camera is not None:
            check_intrinsics(camera.intrinsics, (height, width))
        if self.viewer is not None:
            self.viewer.show(name, photo, estimate, time, camera)
        if self.also is not None:
            self.also(name, photo, depth, time, camera)
        # last: a picture whose files are there is done, its boxes too
        file = {kind: self.folder / f"{name}{ENDING[kind]}" for kind in formats}
        if "ply" in formats and camera is not None:
            write_ply(file["ply"], back_project(estimate.depth, camera.intrinsics), photo)
        if "depth" in formats:
            steps = to_millimeters(estimate.depth)
            self.too_far += int(((steps == 0) & (estimate.depth > 1)).sum())
            write_picture(file["depth"], steps)
        if "color" in formats:
            near, far = self.depth_range or visible_range(estimate.depth)
            unsure = self.shown_unsure(estimate)
            write_picture(file["color"], photo_beside_depth(photo, estimate.depth, near, far, unsure=unsure))
        if "sigma" in formats:
            write_picture(file["sigma"], to_millimeters(estimate.sigma))
            beside = photo_beside_sigma(photo, estimate.depth, estimate.sigma)
            write_picture(self.folder / f"{name}{SIGMA_PICTURE}", beside)
        if estimate.sigma is not None:
            self.unsure += int(estimate.unsure.sum())
            self.pixels += estimate.depth.size
        self.images += 1

    def shown_unsure(self, estimate: DepthEstimate) -> np.ndarray | None:
        """Return the pixels that pictures show in pale colors: none without the format "sigma"."""
        return estimate.unsure if "sigma" in self.formats else None

    def summarize(self, log: "RunLog", what: str, rate: float, stop: "GracefulStop") -> None:
        """Print what was written, where and how fast, and what was not."""
        if stop and not self.images:
            log.say(f"stopped by {stop} before the first result: nothing was written")
            return
        ended = f"stopped by {stop}: " if stop else ""
        written = " + ".join(self.formats)
        log.say(
            f"{ended}{what}: {written} in {self.folder} ({rate:.1f} images/s, reading and writing included)"
        )
        if self.pixels:
            share = 100 * self.unsure / self.pixels
            marked = "in pale colors" if "sigma" in self.formats else "formats=[color,sigma] shows where"
            log.say(
                f"the network is unsure of {share:.1f} % of the pixels "
                f"(sigma above {100 * UNSURE:.0f} % of the depth): {marked}"
            )
        if self.skipped:
            log.say(f"skipped {len(self.skipped)}:")
            for line in self.skipped:
                log.say(f"  {line}")
        if self.too_far:
            log.say(f"{self.too_far} pixels are farther than {DEEPEST} m: stored as 0 (unknown)")


def to_millimeters(depth: np.ndarray) -> np.ndarray:
    """Depth ``(H, W)`` [m] -> uint16 [mm]; 0 (unknown) where it is unknown or beyond :data:`DEEPEST`.

    :func:`eldenet.data.io.read_depth` with encoding "mm" reads it back.
    """
    millimeters = np.rint(np.nan_to_num(depth.astype(np.float64), nan=0.0, posinf=0.0, neginf=0.0) * 1000)
    fits = (millimeters > 0) & (millimeters <= 1000 * DEEPEST)
    return np.where(fits, millimeters, 0).astype(np.uint16)


def write_ply(path: Path, points: np.ndarray, colors: np.ndarray) -> int:
    """Write colored points as binary PLY, which MeshLab, CloudCompare, Blender and Open3D open.

    Args:
        path: of the file; its folder is created.
        points: ``(..., 3)`` camera coordinates [m]: x right, y down, z forward. Points that are not finite or
            not in front of the camera are left out.
        colors: ``(..., 3)`` uint8 RGB, one per point.

    Returns:
        Number of points written.
    """
    points, colors = points.reshape(-1, 3), colors.reshape(-1, 3)
    seen = np.isfinite(points).all(1) & (points[:, 2] > 0)
    vertices = np.empty(int(seen.sum()), _VERTEX)
    for column, name in enumerate(("x", "y", "z")):
        vertices[name] = points[seen, column]
    for column, name in enumerate(("red", "green", "blue")):
        vertices[name] = colors[seen, column]
    properties = "".join(
        f"property {_PLY_NAMES[kind]} {name}\n" for name, kind in (d[:2] for d in _VERTEX.descr)
    )
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment camera frame, meters: x right, y down, z forward\n"
        f"element vertex {len(vertices)}\n{properties}end_header\n"
    )
    write_bytes(path, header.encode("ascii") + vertices.tobytes())
    return len(vertices)


def name_results(source: Path, output: Path) -> dict[Path, str]:
    """Name the results of each picture in the order of time; relative to the output, no two share a name.

    A name is the picture's path below ``source`` without its ending. Pictures that differ only in their
    ending keep it in the name (``a_jpg``, ``a_png``).

    Raises:
        FileNotFoundError: there is no such source.
        ValueError: the folder holds no pictures, or names that are too similar.
    """
    if source.is_file():
        return {source: source.stem}
    if not source.is_dir():
        raise FileNotFoundError(f"source={source} does not exist: give a picture, folder, video or camera:0")
    own = output.resolve()
    found = [
        path
        for path in visible_files(source, (*IMAGE_ENDINGS, *VIDEO_ENDINGS))
        if path.is_file()
        and (own == source.resolve() or own not in path.resolve().parents)  # earlier results
    ]
    found.sort(key=lambda path: natural_order(path.as_posix()))
    paths = [path for path in found if path.suffix.lower() in IMAGE_ENDINGS]
    if videos := [path for path in found if path.suffix.lower() in VIDEO_ENDINGS]:
        warn_once(
            f"{source}: videos are passed over ({len(videos)}): give each by itself, source={videos[0]}"
        )
    if not paths:
        raise ValueError(f"{source} holds no pictures ({', '.join(IMAGE_ENDINGS)})")
    names = {path: path.relative_to(source).with_suffix("").as_posix() for path in paths}
    often = Counter(composed(name).casefold() for name in names.values())
    for path, name in names.items():
        if often[composed(name).casefold()] > 1:
            names[path] = f"{name}_{path.suffix[1:]}"
    if len({composed(name).casefold() for name in names.values()}) < len(names):
        raise ValueError(f"{source} holds pictures whose names differ too little: rename some of them")
    return names

"""``eldenet.estimate``: the depth of pictures in one call, as ``eldenet predict`` computes it."""

import threading
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps

from eldenet.data.io import read_image
from eldenet.deploy.lens import UNKNOWN_LENS, Lens
from eldenet.deploy.outputs import ENDING, Results, name_results
from eldenet.deploy.predictor import DepthPredictor, check_frame
from eldenet.deploy.stream import is_live, without_password
from eldenet.deploy.video_files import is_video_file
from eldenet.geometry import PinholeCamera, back_project, check_intrinsics, focal_length
from eldenet.system.checks import one_of
from eldenet.uncertainty import NO_SIGMA, DepthEstimate, as_estimate
from eldenet.visualization import photo_beside_depth, visible_range
from eldenet.weights import BEST, WEIGHT_FILES, find_checkpoint

Picture = str | Path | Image.Image | np.ndarray
_loading = threading.Lock()


@dataclass(frozen=True, eq=False, repr=False)
class PictureDepth:
    """Depth of one picture, at its own size.

    Attributes:
        name: of the picture, without its ending; its files begin with it.
        photo: the picture, turned upright: ``(H, W, 3)`` uint8 RGB.
        estimate: depth [m], sigma [m] and intervals.
        camera: the lens; None: not known, so all distances may be off by one factor.
    """

    name: str
    photo: np.ndarray
    estimate: DepthEstimate
    camera: PinholeCamera | None

    def __repr__(self) -> str:
        height, width = self.depth.shape
        near, far = visible_range(self.depth)
        lens = "lens unknown" if self.camera is None else f"fx {self.camera.intrinsics[0, 0]:.0f} px"
        return f"PictureDepth({self.name!r}, {height} x {width}, {near:.2f} to {far:.2f} m, {lens})"

    @property
    def depth(self) -> np.ndarray:
        """``(H, W)`` float32 [m]."""
        return np.asarray(self.estimate.depth)

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of the depth, ``(H, W)`` float32 [m]; None: the network predicts none."""
        return None if self.estimate.sigma is None else np.asarray(self.estimate.sigma)

    def points(self) -> np.ndarray:
        """Return every pixel in camera coordinates, ``(H, W, 3)`` [m]: x right, y down, z forward.

        Raises:
            ValueError: the lens is not known.
        """
        if self.camera is None:
            raise ValueError(
                f"{self.name}: points need the lens, which the picture does not say: give estimate "
                "fov=degrees, focal=pixels or intrinsics=(fx, fy, cx, cy)"
            )
        return back_project(self.depth, self.camera.intrinsics)

    def plot(self, near: float | None = None, far: float | None = None) -> Image.Image:
        """Return photo, colored depth and scale as one PIL picture, which notebooks display.

        The colors run from ``near`` to ``far`` [m]; None: the 2nd and 98th percentile of the depth.

        Raises:
            ValueError: not ``0 <= near < far``.
        """
        nearest, farthest = visible_range(self.depth)
        near, far = nearest if near is None else near, farthest if far is None else far
        if not 0 <= near < far:
            raise ValueError(f"near={near:g}, far={far:g}: give 0 <= near < far [m]")
        return Image.fromarray(photo_beside_depth(self.photo, self.depth, near, far))

    def save(self, folder: str | Path = ".", formats: Sequence[str] = ("depth", "color")) -> list[Path]:
        """Write the files that ``eldenet predict`` writes, and return them. Older ones are replaced.

        Args:
            formats: any of "depth" (16-bit PNG [mm], 0 = unknown), "color" (as :meth:`plot`), "ply" (a point
                cloud [m]) and "sigma".

        Raises:
            ValueError: the folder is a file's name, there is no such format, or the lens or sigma is unknown.
        """
        folder, formats = Path(folder).expanduser(), (formats,) if isinstance(formats, str) else formats
        if folder.suffix.lower() in (".png", ".jpg", ".jpeg", ".ply", ".npy", ".npz"):
            raise ValueError(
                f"folder={folder} is the name of a file: give a folder, or use result.plot().save(file) for "
                "a picture and numpy.save(file, result.depth) for meters"
            )
        for name in formats:
            one_of("formats", name, tuple(ENDING))
        if "ply" in formats:
            self.points()
        if "sigma" in formats and self.sigma is None:
            raise ValueError(f"formats has sigma: {NO_SIGMA}")
        results = Results(folder, tuple(formats))
        results.write(self.name, self.photo, self.estimate, formats, camera=self.camera)
        return results.files(self.name)


def estimate(
    source: Picture | Sequence[Picture],
    checkpoint: str | Path = BEST,
    *,
    fov: float | None = None,
    focal: float | None = None,
    intrinsics: Sequence[float] | np.ndarray | None = None,
) -> Any:
    """Estimate the depth of a picture: ``eldenet.estimate("photo.jpg", fov=66).depth`` is in meters.

    The network is loaded once and kept; several threads may call this function. It computes on a GPU if torch
    sees one. Results stay in memory, so give the pictures of a large folder one by one.

    Args:
        source: a picture: a file, a PIL picture or an array ``(H, W, 3)`` RGB, uint8 or float in [0, 1]; or a
            folder or a list of pictures.
        checkpoint: packaged weights, a run folder, a saved model, a Hub id or an exported file.
        fov: horizontal field of view [degrees] of the lens that took the pictures.
        focal: its focal length instead, fx [px].
        intrinsics: ``(fx, fy, cx, cy)`` or ``(3, 3)`` instead [px]. Without any of them: each photo's EXIF,
            else the network's canonical camera.

    Returns:
        A :class:`PictureDepth`; a list of them for a folder or a list.

    Raises:
        ValueError: a picture cannot be read, the lens is given twice or out of range, or the network is not
            trained.
        FileNotFoundError: there is no such picture or checkpoint.
        TypeError: the checkpoint is neither a name nor a path.

    Warns:
        UserWarning: the lens of a picture is not known.
    """
    focal_length(intrinsics, fov, None, focal)  # refuses what does not fit before anything heavy is loaded
    pictures = _named(source)
    predictor = _predictor(checkpoint)
    lens = Lens(
        predictor.canonical_px, known_fov=predictor.known_fov, intrinsics=intrinsics, focal=focal, fov=fov
    )
    results = []
    for name, picture in pictures:
        frame, photo = _read(picture)
        camera = lens.camera_of(frame.shape, photo)
        if camera is not None:
            check_intrinsics(camera.intrinsics, (frame.shape[0], frame.shape[1]))
        found = as_estimate(predictor(frame, focal=lens.focal_of(frame.shape, photo)))
        results.append(PictureDepth(name, frame, found, camera))
    if predictor.canonical_px is not None and any(result.camera is None for result in results):
        warnings.warn(f"focal length {UNKNOWN_LENS}", stacklevel=2)
    return results if _is_many(source) else results[0]


def _is_many(source: Any) -> bool:
    if isinstance(source, str | Path):
        return Path(source).expanduser().is_dir()
    return isinstance(source, list | tuple)


def _named(source: Any) -> list[tuple[str, Any]]:
    """The name and the picture of each picture, before anything heavy is loaded."""
    if isinstance(source, str | Path):
        path = Path(source).expanduser()
        if is_live(str(source)) or (path.is_file() and is_video_file(path)):
            shown = without_password(str(source))
            raise ValueError(
                f"source={shown} is no picture: for videos and cameras use eldenet predict source={shown}, "
                "or eldenet.runtimes.DepthStream in Python; download a picture from an address first"
            )
        return [(name, picture) for picture, name in name_results(path, path).items()]
    if not isinstance(source, list | tuple):
        file = getattr(source, "filename", "")  # of a PIL picture
        return [(Path(file).stem if isinstance(file, str) and file else "picture", source)]
    named = [pair for each in source for pair in _named(each)]
    alike = len({name for name, _ in named}) < len(named)
    return [(f"{name}_{number}" if alike else name, each) for number, (name, each) in enumerate(named)]


def _read(picture: Any) -> tuple[np.ndarray, Path | Image.Image | None]:
    """The frame ``(H, W, 3)`` uint8 RGB of a picture, upright, and the photo whose EXIF may know its lens.

    An array has none.
    """
    if isinstance(picture, Path):
        return read_image(picture, upright=True), picture
    if isinstance(picture, Image.Image):
        if picture.mode[0] in "IF":
            raise ValueError(f"the picture has mode {picture.mode}: convert it to 8 bits first")
        return np.asarray(ImageOps.exif_transpose(picture).convert("RGB")), picture
    if not isinstance(picture, np.ndarray) or picture.ndim != 3:
        what = f"array {picture.shape}" if isinstance(picture, np.ndarray) else type(picture).__name__
        raise ValueError(
            f"source is {what}: give a file, a folder, a PIL picture, an array (H, W, 3) RGB, or a list of "
            "them"
        )
    if picture.dtype.kind == "f":
        if not (picture.size and picture.min() >= 0 and picture.max() <= 1):
            raise ValueError("source is a float array outside [0, 1]: divide it by 255, or give uint8")
        picture = np.rint(picture * 255).astype(np.uint8)
    check_frame(picture)
    return picture.copy(), None  # a camera may fill its array again before the result is drawn


def _predictor(checkpoint: str | Path) -> DepthPredictor:
    """The predictor of a checkpoint, kept until its weights change."""
    if not isinstance(checkpoint, str | Path):
        raise TypeError(
            f"checkpoint is a {type(checkpoint).__name__}: give a name or a path; for a loaded network, "
            "eldenet.DepthPredictor(network)(frame)"
        )
    found = find_checkpoint(checkpoint, "checkpoint", trained=True)
    files = (found.path, *(found.path / name for name in WEIGHT_FILES))
    written = tuple(file.stat().st_mtime_ns for file in files if file.is_file())
    with _loading:
        return _load(str(checkpoint), written, exported=found.kind == "exported")


@lru_cache(maxsize=2)
def _load(checkpoint: str, _written: tuple[int, ...], *, exported: bool) -> DepthPredictor:
    device = None
    if exported:
        from eldenet.deploy.runtimes import load as load_file

        network: Any = load_file(checkpoint)
    else:
        import torch

        from eldenet.zoo import load

        network = load(checkpoint)
        device = "cuda" if torch.cuda.is_available() else "cpu"
    has_sigma = network.distribution is not None
    return DepthPredictor(network, device=device, steady=False, sharp=True, uncertainty=has_sigma)

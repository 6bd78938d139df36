"""Which lens ``eldenet.predict`` and ``eldenet.estimate`` assume.

The one given; otherwise that of KITTI's calibration or of the EXIF; otherwise the canonical one.
"""

import logging
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Union

import numpy as np

from eldenet.data.kitti_calibration import object_camera
from eldenet.deploy.predictor import NO_FOCAL
from eldenet.deploy.runtimes.base import check_known_lens
from eldenet.geometry import (
    PinholeCamera,
    check_focal,
    check_intrinsics,
    focal_length,
    focal_of_film,
    focal_of_fov,
    intrinsic_matrix,
    pinhole,
    same_aspect,
)
from eldenet.system.errors import warn_once
from eldenet.system.extras import installed

if TYPE_CHECKING:
    from PIL.Image import Image

Photo = Union[Path, "Image"]  # a file, or a PIL picture that was not turned yet
EXIF_BLOCK, FOCAL_35MM, EXIF_WIDTH, EXIF_HEIGHT = 0x8769, 0xA405, 0xA002, 0xA003
ROUNDED_EXIF = 0.1  # relative: EXIF rounds the focal length, and 35 mm film has no one width
UNKNOWN_LENS = "unknown, so all distances may be off by one factor: give fov=, focal= or intrinsics="


class Lens:
    """The camera of every picture, and where it comes from.

    Args:
        canonical_px: of the network; None: it ignores focal lengths.
        known_fov: horizontal field of view of the one camera that the file is for [degrees]; None: any.
        intrinsics: ``(fx, fy, cx, cy)`` or ``(3, 3)`` of all pictures [px], or None.
        focal: fx of all pictures [px], or None.
        fov: horizontal field of view of all pictures [degrees], or None.
        origin: where the given one of these three comes from.

    Attributes:
        found: where the focal length of the last picture comes from.
        origins: number of predicted pictures by where their focal length comes from.
        centered: whether :meth:`camera_of` had to assume square pixels and a principal point in the center.

    Raises:
        ValueError: the intrinsics are those of no camera.
    """

    def __init__(
        self,
        canonical_px: float | None,
        *,
        known_fov: float | None = None,
        intrinsics: Sequence[float] | np.ndarray | None = None,
        focal: float | None = None,
        fov: float | None = None,
        origin: str = "given",
    ) -> None:
        self.canonical_px, self.known_fov, self.fov, self.origin = canonical_px, known_fov, fov, origin
        self.intrinsics = None if intrinsics is None else intrinsic_matrix(intrinsics)
        self.focal = focal if self.intrinsics is None else float(self.intrinsics[0, 0])
        self.given = self.focal is not None or fov is not None
        self.found = ""
        self.origins: Counter[str] = Counter()
        self.centered = False
        self._sizes: set[tuple[int, int]] = set()

    def focal_of(self, size: Sequence[int], photo: "Photo | None" = None) -> float | None:
        """Fx [px] of a picture of ``(height, width, ...)``; None: the canonical camera's.

        Raises:
            ValueError: no picture of this size has such a lens, or the network is for another one.
        """
        if self.canonical_px is None and self.known_fov is None:
            return None
        focal, origin = self._find(size, photo)
        if self.known_fov is not None:
            if self.given and focal is not None:
                check_known_lens(self.known_fov, focal, size[1])
            elif focal is not None and abs(focal / focal_of_fov(self.known_fov, size[1]) - 1) > ROUNDED_EXIF:
                warn_once(
                    f"fx {focal:.0f} px ({origin}) of a picture {size[1]} px wide is not the lens that the "
                    f"file was exported for, fov={self.known_fov:g}: its distances may be wrong"
                )
            return None
        self.found = (
            UNKNOWN_LENS if focal is None else f"fx {focal:.0f} px ({origin}), pictures {size[1]} px wide"
        )
        return focal

    def camera_of(self, size: Sequence[int], photo: "Photo | None" = None) -> PinholeCamera | None:
        """Camera of a picture of ``(height, width, ...)``, for points and boxes; None: not known.

        Only intrinsics and KITTI's calibration have a principal point; else it is the picture's center.

        Raises:
            ValueError: no camera with pictures of this size has such a lens.
        """
        camera = None if self.intrinsics is None else PinholeCamera(self.intrinsics)
        if not self.given and isinstance(photo, Path):
            camera = object_camera(photo)
        if camera is not None:
            check_intrinsics(camera.intrinsics, (size[0], size[1]), inside=False)
            return camera
        focal, _ = self._find(size, photo)
        if focal is None:
            return None
        self.centered = True
        return PinholeCamera(pinhole(focal, focal, (size[1] - 1) / 2, (size[0] - 1) / 2))

    def _find(self, size: Sequence[int], photo: "Photo | None") -> tuple[float | None, str]:
        """Fx [px] of a picture, and where it comes from."""
        if self.given:
            self._sizes.add((size[0], size[1]))
            if self.fov is not None and size[0] != size[1] and (size[1], size[0]) in self._sizes:
                focal = focal_of_fov(self.fov, max(size[:2]))
                warn_once(
                    f"fov={self.fov:g} counts across each picture's width, and some are upright, some not: "
                    f"if one camera took them, give focal={focal:.0f} (fov across the long side)"
                )
            return focal_length(None, self.fov, (size[0], size[1]), self.focal), self.origin
        if isinstance(photo, Path) and (camera := object_camera(photo)) is not None:
            return float(camera.intrinsics[0, 0]), "from calib/"
        return None if photo is None else exif_focal(photo, (size[0], size[1])), "from EXIF"

    def describe(self, *, points: bool = False) -> str:
        """Return one line that says which cameras were assumed, with ``points`` also for points and boxes."""
        lines = []
        if self.canonical_px is not None:
            often = self.origins.most_common(3)
            counted = len(self.origins) > 1
            parts = [
                what + (f" ({count} picture{'s' * (count > 1)})" if counted else "") for what, count in often
            ]
            more = len(self.origins) - len(often)
            lines.append(f"camera: {'; '.join(parts)}" + (f"; {more} more" if more else ""))
        elif self.known_fov is not None:
            lines.append(f"camera: fov {self.known_fov:g} degrees, which the file was exported for")
        else:
            lines.append(f"note: {NO_FOCAL}")
        if points and self.centered:
            lines.append("points and boxes assume fy = fx and the principal point in the picture's center")
        return "; ".join(lines)


def require_lens(what: str, sources: Sequence[Path | str], *, is_video: bool) -> None:
    """Raise ValueError for the first picture, or the video, that does not say its lens itself.

    ``what`` needs it: "boxes" or "point clouds".
    """
    for path in sources:
        known = not is_video and (object_camera(Path(path)) or exif_focal(Path(path), (1, 1)))
        if not known:
            raise ValueError(
                f"{path}: {what} need the lens, which this file does not say: give fov=degrees, focal=pixels "
                "or intrinsics=[fx,fy,cx,cy], or KITTI's image_2/000001.png with calib/000001.txt"
            )


def exif_focal(photo: Photo, size: tuple[int, int]) -> float | None:
    """Return fx [px] of a photo of ``(height, width)`` from its EXIF's focal length in 35 mm; None without.

    Turning a photo upright does not change the result: it has the same diagonal and square pixels. A crop of
    another shape than the photo's, which keeps its EXIF, has another diagonal: None.
    """
    from PIL import Image, UnidentifiedImageError

    if installed("pillow_heif"):
        from pillow_heif import register_heif_opener

        register_heif_opener()
    try:
        with Image.open(photo) if isinstance(photo, Path) else nullcontext(photo) as opened:
            exif, shape = opened.getexif().get_ifd(EXIF_BLOCK), (opened.height, opened.width)
            millimeters = float(exif.get(FOCAL_35MM, 0))
            taken = float(exif.get(EXIF_HEIGHT, 0)), float(exif.get(EXIF_WIDTH, 0))
    except (UnidentifiedImageError, OSError, ValueError, TypeError, SyntaxError):
        return None  # the picture itself was read; what its EXIF holds is not worth an error
    if not millimeters > 0:
        return None
    if min(taken) > 0 and not (same_aspect(taken, shape) or same_aspect(taken[::-1], shape)):
        warn_once(
            f"photo was cropped or stretched from {taken[0]:g} x {taken[1]:g} to {shape[0]} x {shape[1]} px "
            "(height, width): the lens that its EXIF states is not used"
        )
        return None
    focal = focal_of_film(millimeters, size)
    try:
        check_focal(focal, size, f"the EXIF's {millimeters:g} mm", ", which no lens has")
    except ValueError as error:
        logging.getLogger("eldenet").warning("%s: %s; the EXIF's lens is not used", photo, error)
        return None
    return focal

"""Which lens ``eldenet.predict`` assumes.

The one given; otherwise that of KITTI's calibration or of the EXIF; otherwise the canonical one.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from eldenet.data.kitti_calibration import object_camera
from eldenet.deploy.predictor import NO_FOCAL
from eldenet.geometry import focal_of_film, focal_of_fov

EXIF_BLOCK, FOCAL_35MM = 0x8769, 0xA405


class Lens:
    """The focal length of every picture, and where it comes from.

    Args:
        canonical_px: of the network; None: it ignores focal lengths, so none is used.
        intrinsics: ``(fx, fy, cx, cy)`` of all pictures [px], or None.
        focal: fx of all pictures [px], or None.
        fov: horizontal field of view of all pictures [degrees], or None.

    Attributes:
        origins: number of pictures by where their focal length comes from.
    """

    def __init__(
        self,
        canonical_px: float | None,
        *,
        intrinsics: Sequence[float] | None = None,
        focal: float | None = None,
        fov: float | None = None,
    ) -> None:
        self.canonical_px, self.fov = canonical_px, fov
        self.focal = focal if intrinsics is None else float(intrinsics[0])
        self.origins: Counter[str] = Counter()

    def focal_of(self, size: tuple[int, int], path: Path | None = None) -> float | None:
        """Fx [px] of a picture of ``(height, width)``; None: the canonical camera's."""
        if self.canonical_px is None:
            return None
        focal, origin = self.focal, "given"
        if focal is None and self.fov is not None:
            focal = focal_of_fov(self.fov, size[1])
        if focal is None and path is not None and (camera := object_camera(path)) is not None:
            focal, origin = float(camera.intrinsics[0, 0]), "from calib/"
        if focal is None and path is not None:
            focal, origin = exif_focal(path, size), "from EXIF"
        shown = "unknown, so all distances may be off by one factor: give fov=, focal= or intrinsics="
        self.origins[
            shown if focal is None else f"fx {focal:.0f} px ({origin}), pictures {size[1]} px wide"
        ] += 1
        return focal

    def describe(self) -> str:
        """Return one line that says which cameras were assumed."""
        if self.canonical_px is None:
            given = self.focal is not None or self.fov is not None
            return f"note: {NO_FOCAL}" if given else ""
        often = self.origins.most_common(3)
        parts = [what + (f" ({count} pictures)" if len(self.origins) > 1 else "") for what, count in often]
        more = len(self.origins) - len(often)
        return f"camera: {'; '.join(parts)}" + (f"; {more} more" if more else "")


def exif_focal(path: Path, size: tuple[int, int]) -> float | None:
    """Return fx [px] of a photo of ``(height, width)`` from its EXIF's focal length in 35 mm; None without.

    Turning a photo upright does not change the result: it has the same diagonal and square pixels.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(path) as photo:
            millimeters = float(photo.getexif().get_ifd(EXIF_BLOCK).get(FOCAL_35MM, 0))
    except (UnidentifiedImageError, OSError, ValueError, TypeError, SyntaxError):
        return None  # the picture itself was read; what its EXIF holds is not worth an error
    return focal_of_film(millimeters, size) if millimeters > 0 else None

"""Pinhole geometry: intrinsics under image operations, back-projection, disparity, depth by focal length.

Convention: pixel centers are whole numbers (the center of the first pixel is (0, 0)), x right, y down,
z forward, as in OpenCV. So a resize by s moves a point u to (u + 0.5) * s - 0.5.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.system.errors import warn_once

if TYPE_CHECKING:
    from torch import Tensor

GRID = 16  # [px]: networks round other sides of frames up, which makes the depth of the last rows wrong
SAME_ASPECT = 0.02  # share by which a resize may stretch one side: what rounding to whole pixels does
SAME_SURFACE = 0.05  # share by which the depth of neighboring pixels of one surface may differ
BORDER_COLOR = (124, 116, 104)  # ImageNet's mean: 0 once a network has normalized it
FILM_DIAGONAL = 43.27  # of 35 mm film [mm]
ANY_LENS = "ELDENET_ANY_LENS"  # environment variable: 1 lets any lens through
DEGREES, ALL_DEGREES = (4.0, 150.0), (0.01, 179.9)  # horizontal fields of view, and with ANY_LENS
MAX_SKEW, MAX_STRETCH = 0.01, 2.0  # relative to fx; fx / fy or fy / fx
MOST_SENSOR = 55.0  # side of an image sensor [mm]
CENTRAL = (0.3, 0.7)  # where principal points lie, in widths and heights of the picture
MOST_SQUARE = 1.2  # aspect up to which a picture and itself turned by 90 degrees have much the same middle
TURNED = 0.02  # so near to the middle of the picture turned by 90 degrees, they are taken for that one's
_OR_ANY_LENS = f"; {ANY_LENS}=1 allows any lens"
LARGEST = 100.0  # of depth in meters: a camera also sees something near
MOSTLY = 0.9  # share of the known depth above it that shows another unit


def pinhole(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """Intrinsic matrix ``(3, 3)`` [px]."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def four_numbers(intrinsics: np.ndarray) -> list[float]:
    """``[fx, fy, cx, cy]`` of a matrix ``(3, 3)`` [px]: the inverse of :func:`pinhole`."""
    return [float(intrinsics[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]


def intrinsic_matrix(intrinsics: Sequence[Any] | np.ndarray, *, check: bool = True) -> np.ndarray:
    """Return intrinsics given as ``(fx, fy, cx, cy)`` or ``(3, 3)`` [px] as the matrix ``(3, 3)`` float64.

    Args:
        intrinsics: either of the two, as array, list or tuple.
        check: False takes any numbers, for callers that deal with them themselves.

    Raises:
        ValueError: they are neither; or, with ``check``, no matrix of a camera: not finite, a focal length
            not above 0, another last row than 0 0 1, a skew, or pixels that are far from square.
    """
    try:
        given = np.asarray(intrinsics, dtype=object)
        matrix = given.astype(np.float64)
        if any(isinstance(value, bool | np.bool_) for value in given.flat):
            matrix = np.empty(0)
    except (TypeError, ValueError):  # no numbers, or rows of several lengths
        matrix = np.empty(0)
    if matrix.shape == (4,):
        matrix = pinhole(*matrix.tolist())
    is_camera = matrix.shape == (3, 3) and (
        not check or (np.isfinite(matrix).all() and matrix[0, 0] > 0 and matrix[1, 1] > 0)
    )
    if not is_camera:
        raise ValueError(
            f"intrinsics={_shown(intrinsics)}: give [fx, fy, cx, cy] of a calibrated camera in pixels, fx "
            "and fy above 0, or the (3, 3) matrix"
        )
    if check and (fault := _fault_of(matrix)):
        raise ValueError(f"intrinsics={_shown(intrinsics)}: {fault}")
    return matrix


def _shown(intrinsics: Any) -> Any:
    """Intrinsics in one line."""
    return np.asarray(intrinsics, dtype=object).tolist()


def _fault_of(matrix: np.ndarray) -> str:
    """What makes finite numbers ``(3, 3)`` no matrix of a camera, whatever the pictures' size; else ""."""
    fx, skew, fy = matrix[0, 0], matrix[0, 1], matrix[1, 1]
    if np.abs(matrix[2] - (0, 0, 1)).max() > 1e-6:  # for every frame: np.allclose is slow
        if np.allclose(matrix[:2, 2], 0):
            return (
                "the last row is not 0 0 1, but the last column is: give the transpose (as MATLAB stores it)"
            )
        return "the last row is not 0 0 1: give the matrix in pixels, not divided or multiplied by anything"
    if any_lens():
        return ""
    if abs(matrix[1, 0]) > MAX_SKEW * fx or abs(skew) > MAX_SKEW * fx:
        return "the numbers beside fx and fy are not 0: give the matrix of rectified pictures, without skew"
    if not 1 / MAX_STRETCH <= fx / fy <= MAX_STRETCH:
        normal = max(matrix[:2, 2]) <= 1 and ": numbers divided by width and height? multiply them"
        return f"fx is {fx / fy:.2g} times fy{normal or ': give fx, fy, cx, cy in this order'}{_OR_ANY_LENS}"
    return ""


def any_lens() -> bool:
    """Whether ``$ELDENET_ANY_LENS`` lets lenses through that look like a wrong unit."""
    return os.environ.get(ANY_LENS, "0") not in ("", "0")


def check_intrinsics(intrinsics: np.ndarray, size: tuple[int, int], *, inside: bool = True) -> None:
    """Refuse intrinsics ``(3, 3)`` [px] that no camera with pictures of ``(height, width)`` [px] has.

    A principal point far from the middle is only warned of, once: a picture may be cut from a larger one.

    Args:
        intrinsics: as :func:`intrinsic_matrix` returns them.
        inside: whether the principal point must lie in the picture; False where it does not count.

    Raises:
        ValueError: :func:`intrinsic_matrix` refuses them; or, unless ``ELDENET_ANY_LENS=1``, the horizontal
            field of view is not 4 to 150 degrees, or the principal point lies outside the picture.
    """
    matrix = intrinsic_matrix(intrinsics)
    fx, column, row = (float(matrix[at]) for at in ((0, 0), (0, 2), (1, 2)))
    height, width = size[0], size[1]
    middle = f"{max(1, 2 * column + 1):.0f} x {max(1, 2 * row + 1):.0f}"  # of which it is the middle
    at = f"the principal point ({column:g}, {row:g})"
    shares = (column + 0.5) / width, (row + 0.5) / height
    turned = max(abs(shares[0] * width / height - 0.5), abs(shares[1] * height / width - 0.5)) < TURNED
    turned &= not 1 / MOST_SQUARE < width / height < MOST_SQUARE
    centered = not turned and all(CENTRAL[0] <= share <= CENTRAL[1] for share in shares)
    hint = ""
    if max(column, row) <= 1 and not centered:
        pixels = f"{fx * width:g}, {matrix[1, 1] * height:g}, {column * width:g}, {row * height:g}"
        hint = f": numbers divided by the picture's size? in pixels they are {pixels}"
    elif not centered:
        of_sensor = ", or in mm of the sensor" * (column <= MOST_SENSOR / 2)
        hint = f", and {at} is the middle of a picture of about {middle}: of another size{of_sensor}?"
    if inside and not any_lens() and not (0 <= column < width and 0 <= row < height):
        raise ValueError(
            f"{at} lies outside the picture, which is {width} x {height}: give the intrinsics of pictures of "
            f"this size; these would be right at about {middle}"
        )
    check_focal(fx, size, f"fx={fx:g} of the intrinsics", hint)
    if not centered and not any_lens():
        warn_once(
            f"{at} of the intrinsics is far from the middle of a picture of {width} x {height}: they would "
            f"be right at about {middle}; if that is the size of the calibration, scale all four to this one"
        )


def check_focal(focal: float, size: tuple[int, int], name: str, hint: str = "") -> None:
    """Refuse fx [px] of a lens that no picture of ``(height, width)`` [px] has.

    Args:
        focal: finite and above 0.
        name: of what was given, for the message.
        hint: what else may be wrong, instead of the unit.

    Raises:
        ValueError: the field of view is not 4 to 150 degrees, and ``ELDENET_ANY_LENS`` does not allow any.
    """
    width = size[1]
    degrees = 2 * math.degrees(math.atan(width / 2 / focal))
    least, most = ALL_DEGREES if any_lens() else DEGREES
    if least <= degrees <= most:
        return
    if not hint and degrees < least:
        hint = ": a focal length in micrometers, or of a larger picture?"
    elif not hint and focal < 0.1:
        hint = ": a focal length in meters?"
    elif not hint and focal <= 3:
        hint = f": a focal length divided by the width? then it is {focal * width:g} px"
    elif not hint:
        film = focal_of_film(focal, size)
        hint = f": a focal length in mm? of 35 mm film it would be {film:.0f} px"
    raise ValueError(
        f"{name} is a horizontal field of view of {degrees:.3g} degrees in a picture {width} px wide{hint}; "
        f"give fx in pixels, or fov= in degrees, {least:g} to {most:g}{_OR_ANY_LENS}"
    )


def resize_intrinsics(
    intrinsics: np.ndarray, size_from: tuple[int, int], size_to: tuple[int, int]
) -> np.ndarray:
    """Intrinsics after a resize, which leaves depth unchanged. Sizes are ``(height, width)`` [px]."""
    sy, sx = size_to[0] / size_from[0], size_to[1] / size_from[1]
    matrix = np.array([[sx, 0.0, 0.5 * sx - 0.5], [0.0, sy, 0.5 * sy - 0.5], [0.0, 0.0, 1.0]])
    return matrix @ intrinsics


def focal_of_fov(degrees: float, width: int) -> float:
    """Return fx [px] of a picture ``width`` pixels wide with a horizontal field of view in degrees.

    Raises:
        ValueError: it is no number from 4 to 150 (``ELDENET_ANY_LENS=1`` allows any).
    """
    least, most = ALL_DEGREES if any_lens() else DEGREES
    given = as_number(degrees)
    if not least <= given <= most:
        looks = least <= math.degrees(given) <= most
        hint = f" ({given:g} radians are {math.degrees(given):.4g} degrees)" * looks
        raise ValueError(
            f"fov={degrees!r}: give the horizontal field of view as a number of degrees, {least:g} to "
            f"{most:g}{hint}{_OR_ANY_LENS}"
        )
    return width / 2 / math.tan(math.radians(given) / 2)


def focal_length(
    intrinsics: Sequence[float] | np.ndarray | None,
    fov: float | None,
    size: tuple[int, int] | None,
    focal: float | None = None,
) -> float | None:
    """Return fx [px] of a frame of ``(height, width)`` [px]; None if nothing is given.

    Without a size, it only checks what can be checked without.

    Raises:
        ValueError: several are given, or one is out of its range.
    """
    given = {"intrinsics": intrinsics, "focal": focal, "fov": fov}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise ValueError(f"{' and '.join(names)} are given: give only one of them")
    if fov is not None:
        return focal_of_fov(fov, 1 if size is None else size[1])
    if focal is not None:
        fx = as_number(focal)
        if not 0 < fx < math.inf:
            raise ValueError(f"focal={focal!r}: give fx of the frame in pixels, a number above 0")
        if size is not None:
            check_focal(fx, size, f"focal={fx:g}")
        return fx
    if intrinsics is None:
        return None
    matrix = intrinsic_matrix(intrinsics)
    if size is not None:
        check_intrinsics(matrix, size, inside=False)
    return float(matrix[0, 0])


def as_number(value: Any) -> float:
    """Return a number as float; NaN of anything else, also of True and of text."""
    try:
        return math.nan if isinstance(value, str | bool | np.bool_) else float(value)
    except (TypeError, ValueError):
        return math.nan


def focal_of_film(millimeters: float, size: tuple[int, int]) -> float:
    """Return fx [px] of a picture of ``(height, width)`` from its focal length in terms of 35 mm film [mm].

    Convention: equal diagonals (CIPA DCG-001), as cameras write it into EXIF.
    """
    return millimeters * math.hypot(*size) / FILM_DIAGONAL


def size_of_aspect(size: tuple[int, int], frame: tuple[float, float]) -> tuple[int, int]:
    """Return the ``(height, width)`` [px] for a ``frame`` of another aspect than ``size``.

    It is ``size`` itself if the two aspects are alike up to rounding. A wider frame gets as many pixels. A
    narrower one gets fewer, between as many and as high: with as many, a network reads portrait pictures too
    far (``experiments/bench``).
    """
    if same_aspect(size, frame):
        return size
    narrower = size[1] * frame[0] / (size[0] * frame[1])
    height = size[0] * (narrower**0.25 if narrower > 1 else math.sqrt(narrower))
    return max(1, round(height)), max(1, round(height * frame[1] / frame[0]))


def grid_margins(size: Sequence[int]) -> tuple[int, int, int, int]:
    """Return ``(top, bottom, left, right)`` [px] that extend ``(height, width)`` to multiples of ``GRID``.

    They lie on both sides, so the lens stays in the center.
    """
    down, across = (-side % GRID for side in size)
    return down // 2, down - down // 2, across // 2, across - across // 2


def same_aspect(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether ``(height, width)`` of both have one aspect up to rounding."""
    return abs(math.log(one[0] * other[1] / (one[1] * other[0]))) <= SAME_ASPECT


def fit_into(size: tuple[int, int], frame: tuple[float, float]) -> tuple[int, int, int, int]:
    """Return the box ``(top, bottom, left, right)`` [px] of a ``frame`` centered in ``size``, aspect kept."""
    if same_aspect(size, frame):
        return 0, size[0], 0, size[1]
    scale = min(size[0] / frame[0], size[1] / frame[1])
    height, width = (max(1, round(side * scale)) for side in frame)
    top, left = (size[0] - height) // 2, (size[1] - width) // 2
    return top, top + height, left, left + width


def crop_intrinsics(intrinsics: np.ndarray, top: int, left: int) -> np.ndarray:
    """Intrinsics ``(3, 3)`` after the crop ``image[top:, left:]``, which leaves depth unchanged."""
    shifted = np.array(intrinsics, dtype=np.float64)
    shifted[0, 2] -= left
    shifted[1, 2] -= top
    return shifted


def from_corner(pixels: np.ndarray) -> np.ndarray:
    """Convert points ``(..., 2)`` or boxes ``(..., 4)`` [px] counted from the image corner (COCO, YOLO).

    There the first pixel reaches from 0 to 1, here from -0.5 to 0.5.
    """
    return np.asarray(pixels, np.float64) - 0.5


def to_corner(pixels: np.ndarray) -> np.ndarray:
    """Convert this module's points ``(..., 2)`` or boxes ``(..., 4)`` [px] to corner counts."""
    return np.asarray(pixels, np.float64) + 0.5


def extent_of(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Left, top, right, bottom ``(4,)`` of one or more whole pixels, from border to border."""
    return np.array([columns.min() - 0.5, rows.min() - 0.5, columns.max() + 0.5, rows.max() + 0.5])


def disparity_to_depth(disparity: np.ndarray, focal: float, baseline: float) -> np.ndarray:
    """Depth ``baseline * focal / disparity`` ``(H, W)`` float32 [m]; 0 = unknown, in both.

    Args:
        disparity: ``(H, W)`` [px of the image that ``focal`` belongs to, even if it was resized since].
        focal: fx [px].
        baseline: distance of the two cameras [m].
    """
    known = disparity > 0  # 0 would be infinitely far
    depth = baseline * focal / np.where(known, disparity, 1.0).astype(np.float64)
    return np.where(known, depth, 0.0).astype(np.float32)


def crop_corner(size: tuple[int, int], crop: tuple[int, int], anchor: str) -> tuple[int, int]:
    """Top and left [px] of a crop ``(height, width)`` of a frame of ``size``.

    Convention: "center" rounds half to even, like torchvision's center crop; "bottom" is the KB crop of BTS:
    the lowest rows, ``(width - crop width) // 2`` from the left.
    """
    if anchor == "bottom":
        return size[0] - crop[0], (size[1] - crop[1]) // 2
    return round((size[0] - crop[0]) / 2), round((size[1] - crop[1]) / 2)


def resize_image(image: np.ndarray, size: tuple[int, int], *, area: bool = True) -> np.ndarray:
    """Image ``(H, W, 3)`` at ``size`` (height, width) [px]: bilinear; averaged by area if it shrinks."""
    import cv2

    shrinks = area and image.shape[:2] > tuple(size)  # in height; in width if the height stays
    if image.shape[:2] == tuple(size):
        return image
    return cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def resample_depth(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Depth ``(H, W)`` [m] at ``size`` [px], without depth that lies between two surfaces; 0 is unknown.

    Enlarged: where the four nearest pixels lie on one surface (within 5 %), their 1 / depth, which is linear
    on a plane, is interpolated; elsewhere, and where the map shrinks, the nearest pixel is taken.
    """
    import cv2

    nearest = cv2.resize(depth, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT)
    if size[0] < depth.shape[0] or size[1] < depth.shape[1]:
        return nearest
    padded = np.pad(depth, 1, mode="edge")
    corners = np.stack([padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]])
    one_surface = (corners.min(0) > 0) & (corners.max(0) <= corners.min(0) * (1 + SAME_SURFACE))
    # the upper left of the four pixels around a target pixel, counted in the padded map
    rows = np.floor((np.arange(size[0]) + 0.5) * depth.shape[0] / size[0] - 0.5).astype(np.int64) + 1
    cols = np.floor((np.arange(size[1]) + 0.5) * depth.shape[1] / size[1] - 0.5).astype(np.int64) + 1
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    inverse = cv2.resize(inverse, size[::-1], interpolation=cv2.INTER_LINEAR)
    between = one_surface[rows[:, None], cols[None]]
    return np.divide(1.0, inverse, out=nearest, where=between)


def resize_sparse(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Move every known point of ``depth (H, W)`` [m] to its pixel in a map of ``size`` [px]; 0 is unknown.

    Nothing is interpolated or repeated. Of several points in a pixel the nearest stays, as it hides the
    others.
    """
    rows, cols = np.nonzero(depth)
    # counted from the image corner, a pixel center u + 0.5 moves to (u + 0.5) * s: pixel floor((u + 0.5) * s)
    to_rows = (2 * rows + 1) * size[0] // (2 * depth.shape[0])
    to_cols = (2 * cols + 1) * size[1] // (2 * depth.shape[1])
    return nearest_points(to_rows, to_cols, depth[rows, cols], size)


def nearest_points(
    rows: np.ndarray, cols: np.ndarray, depth: np.ndarray, size: tuple[int, int]
) -> np.ndarray:
    """Depth map of ``size`` [m] from points ``(N,)`` at whole pixels: the nearest wins, 0 is unknown."""
    points = np.full(size, np.inf, depth.dtype)
    np.minimum.at(points, (rows, cols), depth)
    points[np.isinf(points)] = 0
    return points


def back_project(depth: np.ndarray, intrinsics: np.ndarray) -> np.ndarray:
    """Camera points ``(H, W, 3)`` [m] of a depth map ``(H, W)`` [m]: z is the depth.

    Raises:
        ValueError: the intrinsics ``(3, 3)`` [px] are those of no camera, see :func:`intrinsic_matrix`.
    """
    intrinsics = intrinsic_matrix(intrinsics)
    rows, cols = np.indices(depth.shape, dtype=np.float64)
    x = (cols - intrinsics[0, 2]) / intrinsics[0, 0] * depth
    y = (rows - intrinsics[1, 2]) / intrinsics[1, 1] * depth
    return np.stack([x, y, depth], axis=-1)


def level_rotation(pitch: float, roll: float = 0.0) -> np.ndarray:
    """Level from camera ``(3, 3)``.

    Args:
        pitch: of the optical axis below the horizon [rad].
        roll: of the camera about that axis, clockwise as it looks [rad].
    """
    (c, s), (a, b) = ((np.cos(angle), np.sin(angle)) for angle in (pitch, roll))
    down = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    return down @ np.array([[a, -b, 0.0], [b, a, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class PinholeCamera:
    """A camera in a level frame: ``X = h H [j, i, 1]^T + t`` with ``H = R K^-1``.

    It is our reading of the paper's equation 1.

    ``H`` is the infinite homography (Hartley and Zisserman, section 13.4), ``h`` the depth of the pixel in
    row i, column j. The level frame has x right, y down along gravity, z forward; by default it is the
    camera's own frame.

    Attributes:
        intrinsics: ``(3, 3)`` K [px].
        rotation: ``(3, 3)`` R, level from camera.
        translation: ``(3,)`` t, the optical center in the level frame [m].

    Raises:
        ValueError: an array has another shape, or the intrinsics are those of no camera, see
            :func:`intrinsic_matrix`.
    """

    intrinsics: np.ndarray
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        shapes = tuple(np.shape(part) for part in (self.intrinsics, self.rotation, self.translation))
        if shapes != ((3, 3), (3, 3), (3,)):
            raise ValueError(
                f"intrinsics, rotation, translation are {shapes}: give (3, 3), (3, 3), (3,); "
                "eldenet.geometry.pinhole makes the first"
            )
        intrinsic_matrix(self.intrinsics)

    @classmethod
    def from_projection(cls, projection: np.ndarray) -> "PinholeCamera":
        """The camera of a rectified projection ``K [I | K^-1 p4]`` ``(3, 4)``, such as KITTI's P2.

        Raises:
            ValueError: ``K`` is not that of a camera, see :func:`intrinsic_matrix`.
        """
        intrinsics = intrinsic_matrix(projection[:, :3])
        return cls(intrinsics, translation=-np.linalg.solve(intrinsics, projection[:, 3]))

    @property
    def homography(self) -> np.ndarray:
        """``H = R K^-1`` ``(3, 3)``."""
        return self.rotation @ np.linalg.inv(self.intrinsics)

    def back_project(self, columns: np.ndarray, rows: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Level points ``(..., 3)`` [m] of pixels at ``depth`` [m] (equation 1)."""
        pixels = np.stack([columns, rows, np.ones_like(rows)], axis=-1).astype(np.float64)
        return np.asarray(depth)[..., None] * (pixels @ self.homography.T) + self.translation

    def to_camera(self, points: np.ndarray) -> np.ndarray:
        """Camera coordinates ``(..., 3)`` of level points [m]."""
        return np.asarray((points - self.translation) @ self.rotation)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels ``(..., 2)`` (column, row) of level points ``(..., 3)``; NaN for those not in front."""
        seen = self.to_camera(points)
        z = np.where(seen[..., 2:] > 1e-6, seen[..., 2:], np.nan)
        return np.asarray((seen / z) @ self.intrinsics.T)[..., :2]


#: A camera, or its intrinsics [px] as :func:`intrinsic_matrix` takes them.
CameraLike = PinholeCamera | Sequence[float] | np.ndarray


def as_camera(camera: CameraLike) -> PinholeCamera:
    """Return the camera that is given, or the level one of the intrinsics that are."""
    return camera if isinstance(camera, PinholeCamera) else PinholeCamera(intrinsic_matrix(camera))


def check_meters(depth: np.ndarray) -> None:
    """Raise ``ValueError`` for millimeters in ``depth`` of any shape: as meters, all would seem far.

    These are whole numbers, and floats of which nearly all known ones are above ``LARGEST``. Infinite depth,
    which means nothing in range, does not count.
    """
    if depth.dtype.kind in "iub":
        raise ValueError(f"depth is of type {depth.dtype}: give meters as floats; divide millimeters by 1000")
    known = np.count_nonzero((depth > 0) & (depth < np.inf))
    large = np.count_nonzero((depth > LARGEST) & (depth < np.inf))
    if known and large >= MOSTLY * known:
        raise ValueError(
            f"{large / known:.0%} of the known depth is above {LARGEST:g}: give meters, inf where nothing "
            "is in range; divide millimeters by 1000"
        )


def check_camera_height(height: float, least: float = 0.05, most: float = 5.0) -> None:
    """Raise ``ValueError`` unless the height of a camera above the floor is ``least`` to ``most`` [m]."""
    if isinstance(height, bool) or not least <= height <= most:
        looks = f"; {height:g} looks like centimeters: give {height / 100:g}"
        raise ValueError(
            f"camera_height={height:g}: give it in meters, from the floor to the lens, {least:g} to {most:g}"
            + looks * (most < height <= 500)
        )


def in_meters(depth: "Tensor", focal: "float | Tensor | None", canonical_px: float | None) -> "Tensor":
    """Return meters of canonical depth ``(B, 1, H, W)``: times ``focal / canonical_px``.

    Args:
        focal: fx [px of the network's image], a number or ``(B,)``; 0, NaN and None: the canonical camera's.
        canonical_px: focal length of the canonical camera [px]; None: ``depth`` is in meters already.

    Raises:
        ValueError: ``focal`` is neither one number nor one per image.
    """
    if focal is None or canonical_px is None:
        return depth
    import torch

    focal = torch.as_tensor(focal, device=depth.device)
    if not torch.compiler.is_compiling():  # an export of any number of images would keep that of its example
        check_one_per_image(focal, len(depth))
    return depth * focal_ratio(focal, canonical_px)


def check_one_per_image(focal: "float | np.ndarray | Tensor", images: int) -> None:
    """Raise ``ValueError`` unless ``focal`` is one number, or one for each of the images."""
    shape = tuple(getattr(focal, "shape", ()))
    if math.prod(shape) not in (1, images):  # such as all intrinsics: depth would become a batch of maps
        raise ValueError(f"focal has shape {shape}: give fx [px], a number or ({images},)")


def focal_ratio(focal: "Tensor", canonical_px: float) -> "Tensor":
    """Return meters per canonical meter ``(B, 1, 1, 1)`` for ``focal (B,)`` [px]; 1 where it is 0 or NaN."""
    ratio = focal.float().reshape(-1, 1, 1, 1) / canonical_px
    return ratio.where(ratio > 0, ratio.new_ones(ratio.shape))

"""Lift 2D boxes to 3D boxes [m] with a depth map: four methods side by side."""

import warnings
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D, wrap_half
from eldenet.geometry import CameraLike, as_camera, check_intrinsics, check_meters
from eldenet.perception.box_methods import ObjectEvidence, RawBoxes, fitted_boxes, lshape_boxes, paper_boxes
from eldenet.perception.foreground import border_cuts, gather, trusted_edges
from eldenet.perception.ground import GroundPlane, fit_ground, flat_ground
from eldenet.perception.priors import PRIORS, ClassPrior, prior_of
from eldenet.system.checks import one_of
from eldenet.uncertainty import DepthEstimate, as_estimate

Method = Literal["refine", "lshape", "paper", "no_depth"]
METHODS = get_args(Method)
DISTANCE_LEVEL = 0.9  # of a box's distance interval
SIGMA_RANGE = (0.01, 0.5)  # of an object, relative
SMALL_SIDE, LARGE_SIDE = 10.0, 100.0  # [px]: shorter sides of 2D boxes
#: Relative errors of objects of ``LARGE_SIDE`` and ``SMALL_SIDE`` pixels by what the depth comes from.
#: experiments/table4_centres/defaults.md: chosen on rendered streets.
NETWORK_SIGMA, SENSOR_SIGMA = (0.15, 0.5), (0.01, 0.01)
DOUBTFUL_COST = 6.0  # of a fit whose cues contradict each other
_SPARSE = 0.25  # of the pixels: a map of which fewer are known is a LiDAR's
MOST_BEYOND = 1.5  # of the picture's width or height: boxes that reach farther are another picture's
_MAX_MEDIAN_DEPTH = 100.0  # [m]: beyond, the depth is probably in millimeters


@dataclass(eq=False)
class BoxLifter:
    """``(depth, detections, camera) -> Boxes3D``.

    Methods:
        paper: equations 1 to 3 as we read the prose: back-project the pixels around the box's median depth;
            the box encloses them along the camera's axes; its center is the mean of the eight vertices.
        lshape: remove the ground, keep the foreground around the likely depth, take the heading from the two
            visible sides and the size from the class, and anchor the box at those sides.
        refine: starting there, one least-squares fit of position, heading, size and a factor on the depth to
            the points, the 2D box, the ground and the class. Where the depth of people and small things is
            unsure, their points hardly count.
        no_depth: the same fit without depth, from the 2D box, the class and ``camera_height``: the baseline
            that shows what depth adds.

    Fall-backs, marked in ``quality["fallback"]``: an object with fewer than ``MIN_POINTS`` pixels is fitted
    without the L-shape's heading (or, without any pixel, without depth); one of an unknown class keeps the
    extents of its points along the L-shape's heading. Edges of the 2D box that the image border or a nearer
    box cuts are bounds only.

    Args:
        method: see above.
        priors: sizes by class name.
        ground: "fit" it to the depth, a known plane, or None for no ground.
        camera_height: of the camera above the ground [m], if known: "no_depth" needs it, and "refine" weighs
            it against the fitted plane.
        depth_sigma: relative depth error of whole objects; with ``small_sigma``, of objects whose shorter
            side is ``LARGE_SIDE`` pixels or more. None: both are those of the depth's source: of a sparse map
            ``SENSOR_SIGMA``, for it is a LiDAR's, else ``NETWORK_SIGMA``.
        small_sigma: the same of objects whose shorter side is ``SMALL_SIDE`` pixels, 0.5 at most; in
            between, a power law. Networks blur depth at edges, so thin and distant objects have larger
            errors. None: the same for all. Both are for depth without sigma: where the network predicts
            sigma, that of an object is the median in the middle of its 2D box.
        occlusion_mask: leave out pixels in nearer boxes; "paper" never does.

    Raises:
        ValueError: unknown method, or a number out of range.
    """

    method: Method = "refine"
    _: KW_ONLY
    priors: Mapping[str, ClassPrior] = field(default_factory=lambda: PRIORS)
    ground: Literal["fit"] | GroundPlane | None = "fit"
    camera_height: float | None = None
    depth_sigma: float | None = None
    small_sigma: float | None = None
    occlusion_mask: bool = True

    def __post_init__(self) -> None:
        one_of("method", self.method, METHODS)
        if isinstance(self.ground, str) and self.ground != "fit":
            raise ValueError(f"ground={self.ground!r}: give fit, or null for no ground")
        if self.camera_height is not None:
            flat_ground(self.camera_height)  # refuses another unit
        for name, sigma in (("depth_sigma", self.depth_sigma), ("small_sigma", self.small_sigma)):
            if sigma is not None and not 0 < sigma < 1:
                raise ValueError(f"{name}={sigma}: give a relative error above 0 and below 1, such as 0.08")
        if self.small_sigma is not None and self.depth_sigma is None:
            raise ValueError(
                f"small_sigma={self.small_sigma} without depth_sigma: give both, the errors of objects of "
                f"{SMALL_SIDE:g} and of {LARGE_SIDE:g} pixels"
            )

    def sigma_of(self, depth: np.ndarray) -> tuple[float, float | None]:
        """``depth_sigma`` and ``small_sigma`` for a map ``(H, W)`` [m] without sigma."""
        if self.depth_sigma is not None:
            return self.depth_sigma, self.small_sigma
        known = np.isfinite(depth) & (depth > 0)
        return SENSOR_SIGMA if known.mean() < _SPARSE else NETWORK_SIGMA

    def __call__(
        self, depth: np.ndarray | DepthEstimate, detections: Detections2D, camera: CameraLike
    ) -> Boxes3D:
        """Lift all objects of one image.

        ``quality["doubtful"]`` is 1 where points, 2D box, ground and class contradict each other, or where
        nothing says the distance: no depth, no ground, and no size of the class.
        With sigma, certain pixels weigh more, and ``quality`` has ``distance_low`` and ``distance_high`` [m],
        the interval of ``DISTANCE_LEVEL`` of each box's distance.

        Args:
            depth: ``(H, W)`` [m]; 0, negative and not finite are unknown. Or depth with its sigma.
            detections: in pixels of the depth map; boxes are cut to it.
            camera: of the image, or its intrinsics, ``(3, 3)`` or ``(fx, fy, cx, cy)`` [px].

        Raises:
            ValueError: the depth is not a map, the detections do not fit it, or the camera is that of no lens
                (:func:`eldenet.geometry.check_intrinsics`).

        Warns:
            UserWarning: no pixel is known, half of the depth is beyond 100 m, as in millimeters, or
                ``depth_sigma`` is given for depth with sigma.
        """
        estimate, camera = as_estimate(depth), as_camera(camera)
        depth = np.asarray(estimate.depth)
        estimate = estimate._replace(depth=depth)  # from a tensor, too
        if depth.ndim != 2:
            raise ValueError(f"depth of shape {depth.shape}: give (H, W) in meters")
        if depth.dtype.kind in "iub":
            check_meters(depth)
        if not len(detections):
            return Boxes3D.empty(detections.names)
        height, width = depth.shape
        detections = _inside(detections, height, width)
        check_intrinsics(camera.intrinsics, (height, width))
        _warn_of_odd_depth(depth)
        priors = [prior_of(name, self.priors) for name in detections.classes]
        nominal = None if self.camera_height is None else flat_ground(self.camera_height, camera)
        plane = self.ground if isinstance(self.ground, GroundPlane) else nominal
        if self.ground == "fit" and self.method in ("refine", "lshape"):
            plane = fit_ground(depth, camera) or nominal
        whole, small = self.sigma_of(depth)
        if estimate.sigma is None:
            sigma = sigma_by_side(detections.xyxy, whole, small)
        else:
            if self.depth_sigma is not None:
                own = "this depth comes with its own sigma"
                warnings.warn(f"depth_sigma={self.depth_sigma} is not used: {own}", stacklevel=2)
            with np.errstate(divide="ignore", invalid="ignore"):  # where the depth is unknown
                spread = np.where(depth > 0, estimate.spread, np.nan)
            whole = float(np.nanmedian(spread)) if (depth > 0).any() else whole
            sigma = sigma_in_boxes(spread, detections.xyxy, whole)
        foreground = gather(
            estimate,
            detections,
            camera,
            plane,
            priors,
            select="median" if self.method == "paper" else "core",
            occlusion_mask=self.occlusion_mask and self.method != "paper",
            depth_sigma=sigma,
        )
        if self.method == "no_depth":
            foreground = foreground.without_points()
        trusted, hidden = trusted_edges(detections, (height, width))
        other = nominal if plane is not None and plane.fitted else None
        evidence = ObjectEvidence(foreground, detections, camera, priors, plane, other, trusted, sigma, whole)
        raw = {"paper": paper_boxes, "lshape": lshape_boxes}.get(self.method, fitted_boxes)(evidence)
        raw = _use_fallbacks(raw, evidence, self.method)
        guessed = (foreground.count < 1) & (plane is None) & np.isnan(evidence.size[:, 0])
        quality = {
            "points": foreground.count,
            "depth_scale": raw.depth_scale,
            "cost": raw.cost,
            "doubtful": ((raw.cost > DOUBTFUL_COST) | guessed).astype(float),
            "fallback": raw.fallback.astype(float) * (self.method != "no_depth"),
            "occluded": hidden,
            "truncated": border_cuts(detections.xyxy, (height, width)).any(1).astype(float),
        }
        if estimate.distribution is not None and self.method != "no_depth":
            factors = DepthEstimate(np.ones(len(raw.yaw)), sigma, estimate.distribution)
            low, high = _distances(raw.center, camera.translation, factors.interval(DISTANCE_LEVEL))
            quality |= {"distance_low": low, "distance_high": high}
        return Boxes3D(
            raw.center, raw.size, wrap_half(raw.yaw), detections.score, detections.label, detections.names,
            quality, detections.track_id,
        )  # fmt: skip


def _inside(detections: Detections2D, height: int, width: int) -> Detections2D:
    """Cut the boxes to a depth map; ValueError if they or their masks are those of another image."""
    mask, wanted = detections.mask, (len(detections), height, width)
    if mask is not None and (mask.shape != wanted or mask.dtype != bool):
        raise ValueError(
            f"mask of shape {mask.shape} and type {mask.dtype}: give bool {wanted}, one map a box in the "
            "size of the depth"
        )
    xyxy, ends = detections.xyxy, np.array([width - 0.5, height - 0.5])
    reach = xyxy[:, 2:].max(0)
    outside = np.flatnonzero(((xyxy[:, 2:] < -0.5) | (xyxy[:, :2] > ends)).any(1))
    if outside.size or reach[0] > MOST_BEYOND * width or reach[1] > MOST_BEYOND * height:
        wrong = xyxy[outside[0] if outside.size else xyxy[:, 2:].max(1).argmax()]
        raise ValueError(
            f"box {wrong.round(1).tolist()}, but the depth is {height} x {width}: give both for the same "
            "image, boxes as left, top, right, bottom"
        )
    if reach.max() <= 1:
        raise ValueError("no box reaches beyond the first pixel: give pixels, not shares of the picture")
    return replace(detections, xyxy=np.clip(xyxy, -0.5, np.tile(ends, 2)))


def _distances(
    center: np.ndarray, eye: np.ndarray, factors: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest distance ``(N,)`` [m] of centers ``(N, 3)`` whose depth is off by some factor.

    Depth moves a box along its line of sight from the ``eye (3,)``, which may pass the origin. ``factors``
    are the least and the greatest one ``(N,)``.
    """
    sight, eye = (center - eye)[:, [0, 2]], eye[[0, 2]]
    nearest = np.clip(-(sight @ eye) / np.maximum((sight**2).sum(1), 1e-9), *factors)
    low, *ends = (np.linalg.norm(eye + at[:, None] * sight, axis=1) for at in (nearest, *factors))
    return low, np.maximum(*ends)


def _warn_of_odd_depth(depth: np.ndarray) -> None:
    """Warn if no pixel of ``(H, W)`` is known, or the values look like millimeters."""
    if not (np.isfinite(depth) & (depth > 0)).any():
        warnings.warn("no pixel of the depth is known: the boxes use class sizes instead", stacklevel=3)
    known = depth[::8, ::8]
    known = known[np.isfinite(known) & (known > 0)]
    if len(known) and np.median(known) > _MAX_MEDIAN_DEPTH:
        warnings.warn(
            f"half of the depth is beyond {_MAX_MEDIAN_DEPTH:.0f} m: give meters, not millimeters",
            stacklevel=3,
        )


def sigma_by_side(xyxy: np.ndarray, large: float, small: float | None) -> np.ndarray:
    """Relative depth error ``(N,)`` by the shorter side of 2D boxes ``(N, 4)``; see :class:`BoxLifter`."""
    if small is None:
        return np.full(len(xyxy), large)
    side = np.minimum(xyxy[:, 2] - xyxy[:, 0], xyxy[:, 3] - xyxy[:, 1])
    share = np.log(LARGE_SIDE / np.clip(side, SMALL_SIDE / 2, LARGE_SIDE)) / np.log(LARGE_SIDE / SMALL_SIDE)
    return np.asarray(np.minimum(large * (small / large) ** share, SIGMA_RANGE[1]))


def sigma_in_boxes(spread: np.ndarray, xyxy: np.ndarray, default: float) -> np.ndarray:
    """Relative depth error ``(N,)`` of objects: the median of ``spread (H, W)`` in the middle of each 2D box.

    The errors of one object's pixels are nearly the same error, so it does not shrink with their number. NaN
    is unknown; ``default`` is for a box without a known pixel.
    """
    height, width = spread.shape
    quarter = (xyxy[:, 2:] - xyxy[:, :2]) / 4
    low = np.clip(np.floor(xyxy[:, :2] + quarter), 0, (width - 1, height - 1)).astype(int)
    high = np.maximum(np.ceil(xyxy[:, 2:] - quarter).astype(int), low + 1)
    parts = [spread[y1:y2, x1:x2] for (x1, y1), (x2, y2) in zip(low, high, strict=True)]
    known = [part[np.isfinite(part)] for part in parts]
    return np.clip([float(np.median(part)) if part.size else default for part in known], *SIGMA_RANGE)


def _use_fallbacks(raw: RawBoxes, evidence: ObjectEvidence, method: str) -> RawBoxes:
    """Use no_depth's boxes for objects without pixels, and lshape's for objects of unknown classes."""
    seen = evidence.foreground.count >= 1
    unknown = np.array([prior is None for prior in evidence.priors])
    if method != "no_depth" and not seen.all():
        blind = fitted_boxes(replace(evidence, foreground=evidence.foreground.without_points()))
        raw = raw.where(~seen, blind)
    if method == "refine" and (unknown & seen).any():
        raw = raw.where(unknown & seen, lshape_boxes(evidence))
    return raw

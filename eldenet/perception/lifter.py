"""From 2D boxes and depth to boxes in meters: four methods side by side."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from eldenet.boxes import Boxes3D, Detections2D, wrap_half
from eldenet.geometry import PinholeCamera
from eldenet.perception.foreground import border_cuts, gather, trusted_edges
from eldenet.perception.ground import GroundPlane, fit_ground, flat_ground
from eldenet.perception.priors import PRIORS, ClassPrior, prior_of
from eldenet.perception.solvers import Known, RawBoxes, fitted_boxes, lshape_boxes, paper_boxes

Method = Literal["refine", "lshape", "paper", "no_depth"]
METHODS = ("refine", "lshape", "paper", "no_depth")
SMALL, LARGE = 10.0, 100.0  # [px] shorter sides of 2D boxes
_FARTHEST = 500.0  # [m]: no camera's median depth is beyond


class BoxLifter:
    """``(depth, detections, camera) -> Boxes3D``.

    Methods:
        paper: equations 1 to 3 as read: pixels around the box's median depth, back-projected; the box that
            holds them along the camera's axes; its center the mean of the eight vertices.
        lshape: ground removed, foreground around the core's median depth, heading from the two sides that are
            seen, size of the class, anchored at those sides.
        refine: from there, one least-squares fit of position, heading, size and a factor on the depth to the
            points, the 2D box, the ground and the class.
        no_depth: the same fit without depth, from the 2D box, the class and ``camera_height``: the baseline
            that says what depth is worth.

    Fall-backs, noted in ``quality["fallback"]``: an object with fewer than ``FEWEST_POINTS`` pixels is fitted
    without its sides (or, without any, without depth); one of an unknown class keeps the extents of its
    points along the L-shape's heading; edges of the 2D box that the picture's border or a nearer box cuts are
    bounds only.

    Args:
        method: see above.
        priors: sizes by class name.
        ground: "fit" it to the depth, a plane that is known, or None for none.
        camera_height: above the ground [m], if it is known: "no_depth" rests on it, and "refine" weighs it
            against the plane that it fits.
        depth_sigma: relative error of the depth of whole objects, as measured on validation data; of those
            whose shorter side is ``LARGE`` pixels or more, where ``small_sigma`` is given.
        small_sigma: of objects whose shorter side is ``SMALL`` pixels: networks blur depth at edges, so thin
            and distant objects fare worse. Between and below it follows a power law. None: the same for all.
        occlusion_mask: leave out pixels in boxes that stand nearer.

    Raises:
        ValueError: unknown method, or a number out of range.
    """

    def __init__(
        self,
        method: Method = "refine",
        *,
        priors: Mapping[str, ClassPrior] = PRIORS,
        ground: Literal["fit"] | GroundPlane | None = "fit",
        camera_height: float | None = None,
        depth_sigma: float = 0.08,
        small_sigma: float | None = None,
        occlusion_mask: bool = True,
    ) -> None:
        if method not in METHODS:
            raise ValueError(f"method={method!r}: give one of {', '.join(METHODS)}")
        if not (ground is None or ground == "fit" or isinstance(ground, GroundPlane)):
            raise ValueError(f"ground={ground!r}: give 'fit', a GroundPlane or None")
        if camera_height is not None and camera_height <= 0:
            raise ValueError(f"camera_height={camera_height}: give meters above 0, or None")
        for name, sigma in (("depth_sigma", depth_sigma), ("small_sigma", small_sigma)):
            if sigma is not None and not 0 < sigma < 1:
                raise ValueError(f"{name}={sigma}: give a relative error above 0 and below 1, such as 0.08")
        self.method, self.priors, self.ground = method, priors, ground
        self.camera_height, self.depth_sigma, self.small_sigma = camera_height, depth_sigma, small_sigma
        self.occlusion_mask = occlusion_mask

    def __call__(self, depth: np.ndarray, detections: Detections2D, camera: PinholeCamera) -> Boxes3D:
        """Lift all objects of one picture.

        Args:
            depth: ``(H, W)`` [m] of the picture; 0, negative and not finite are unknown.
            detections: in pixels of the picture.
            camera: of the picture.

        Raises:
            ValueError: the depth is no map, or the detections or their masks are of another picture.
        """
        if depth.ndim != 2 or 0 in depth.shape:
            raise ValueError(f"depth of shape {depth.shape}: give (H, W) in meters")
        height, width = depth.shape
        count = len(detections)
        if not count:
            return Boxes3D.empty(detections.names)
        reach = detections.xyxy[:, 2:].max(0)
        if reach[0] > width + 4 or reach[1] > height + 4:
            raise ValueError(
                f"boxes reach column {reach[0]:.0f} and row {reach[1]:.0f}, but depth is {height} x {width}: "
                "both must be of one picture"
            )
        if detections.mask is not None and detections.mask.shape[1:] != depth.shape:
            raise ValueError(
                f"masks are {detections.mask.shape[1:]}, depth is {depth.shape}: both must be of one picture"
            )
        _warn_of_odd_depth(depth)
        priors = [prior_of(name, self.priors) for name in detections.classes]
        plane = self._plane(depth, camera)
        sigma = sigma_by_side(detections.xyxy, self.depth_sigma, self.small_sigma)
        found = gather(
            depth,
            detections,
            camera,
            plane,
            priors,
            select="median" if self.method == "paper" else "core",
            occlusion_mask=self.occlusion_mask and self.method != "paper",
            depth_sigma=sigma,
        )
        if self.method == "no_depth":
            found = found.without_points()
        trusted, hidden = trusted_edges(detections, (height, width))
        nominal = self._nominal if plane is not None and plane.fitted else None
        known = Known(found, detections, camera, priors, plane, nominal, trusted, sigma, self.depth_sigma)
        raw = {"paper": paper_boxes, "lshape": lshape_boxes}.get(self.method, fitted_boxes)(known)
        raw = _use_fallbacks(raw, known, self.method)
        quality = {
            "points": found.count,
            "depth_scale": raw.depth_scale,
            "cost": raw.cost,
            "fallback": raw.fallback.astype(float) * (self.method != "no_depth"),
            "occluded": hidden,
            "truncated": border_cuts(detections.xyxy, (height, width)).any(1).astype(float),
        }
        return Boxes3D(
            raw.center,
            raw.size,
            wrap_half(raw.yaw),
            detections.score,
            detections.label,
            detections.names,
            quality,
            detections.track_id,
        )

    @property
    def _nominal(self) -> GroundPlane | None:
        return None if self.camera_height is None else flat_ground(self.camera_height)

    def _plane(self, depth: np.ndarray, camera: PinholeCamera) -> GroundPlane | None:
        if isinstance(self.ground, GroundPlane):
            return self.ground
        if self.ground is None or self.method in ("no_depth", "paper"):
            return self._nominal
        return fit_ground(depth, camera) or self._nominal


def _warn_of_odd_depth(depth: np.ndarray) -> None:
    known = depth[::8, ::8]
    known = known[np.isfinite(known) & (known > 0)]
    if depth.size and not (np.isfinite(depth) & (depth > 0)).any():
        warnings.warn("no pixel of the depth is known: boxes follow from their classes' sizes", stacklevel=3)
    if len(known) and np.median(known) > _FARTHEST:
        warnings.warn(
            f"half of the depth is beyond {_FARTHEST:.0f} m: is it in millimeters? meters are needed",
            stacklevel=3,
        )


def sigma_by_side(xyxy: np.ndarray, large: float, small: float | None) -> np.ndarray:
    """Relative depth error ``(N,)`` of objects by the shorter side of their 2D boxes; see BoxLifter."""
    side = np.minimum(xyxy[:, 2] - xyxy[:, 0], xyxy[:, 3] - xyxy[:, 1])
    share = np.log(LARGE / np.clip(side, SMALL / 2, LARGE)) / np.log(LARGE / SMALL)
    return np.asarray(np.minimum(large * ((small or large) / large) ** share, 0.5 if small else 1.0))


def _use_fallbacks(raw: RawBoxes, known: Known, method: str) -> RawBoxes:
    """Replace what a method cannot know: nothing seen -> no depth; unknown class -> the points' extents."""
    seen = known.found.count >= 1
    unknown = np.array([prior is None for prior in known.priors])
    if method != "no_depth" and not seen.all():
        blind = fitted_boxes(replace(known, found=known.found.without_points()))
        raw = raw.where(~seen, blind)
    if method == "refine" and (unknown & seen).any():
        raw = raw.where(unknown & seen, lshape_boxes(known))
    return raw

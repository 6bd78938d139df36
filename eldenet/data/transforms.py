"""Augmentation of a camera frame: the only file that knows albumentations."""

import os
import random
from collections.abc import Sequence
from typing import Any

import numpy as np

from eldenet.data.resize_crop import check_same_size
from eldenet.system.checks import one_of
from eldenet.types import Frame

BORDER_COLOR = (124, 116, 104)  # ImageNet's mean: 0 once the network has normalized it


class Augmentation:
    """Randomly flip, zoom, shift, rotate and recolor a frame, with depth and intrinsics to match.

    Every probability is 0 for "off". The generator of a call alone decides what happens to a frame: neither
    earlier calls nor the worker matter. Pixels from beyond the border get one color and unknown depth (0), as
    a mirrored border would invent depth.

    A zoom by s is a longer lens (``zoom="focal"``: the focal lengths grow by s, depth stays), or it shows the
    scene from s times nearer (``zoom="depth"``: depth is divided by s, the focal lengths stay, and X and Y of
    every point in the camera frame stay; as in sparse-to-dense and FastDepth). To a network that predicts
    canonical depth both are the same. The depth of frames without intrinsics is always divided. Flip, rotation
    and shift keep depth. The principal point moves with the image. Rotating with unequal focal lengths (0.1 %
    apart for NYU) shears the scene by that difference times the sine of the angle, which is not corrected.

    Args:
        flip: probability of mirroring left and right.
        affine: probability of zoom, shift and rotation together.
        scale: range of the zoom factor s.
        zoom: what a zoom changes, "depth" or "focal".
        shift: largest shift, as a fraction of width and height.
        rotate: largest rotation [deg].
        brightness_contrast: probability of a change of brightness and contrast by up to ``brightness`` and
            ``contrast`` (fractions).
        brightness: see ``brightness_contrast``.
        contrast: see ``brightness_contrast``.
        color_jitter: probability of torchvision-like jitter of brightness, contrast, saturation by up to
            ``jitter`` (fraction) and of hue by up to ``jitter_hue`` (fraction of the circle).
        jitter: see ``color_jitter``.
        jitter_hue: see ``color_jitter``.
        hue_saturation: probability of a change of hue by up to ``hue`` (OpenCV's half degrees), of saturation
            and value by up to ``saturation`` and ``value`` (of 255).
        hue: see ``hue_saturation``.
        saturation: see ``hue_saturation``.
        value: see ``hue_saturation``.

    Raises:
        ValueError: a probability or range is out of its bounds.
    """

    def __init__(
        self,
        *,
        flip: float = 0.5,
        affine: float = 0.5,
        scale: Sequence[float] = (1.0, 1.3),
        zoom: str = "depth",
        shift: float = 0.05,
        rotate: float = 5.0,
        brightness_contrast: float = 0.3,
        brightness: float = 0.2,
        contrast: float = 0.2,
        color_jitter: float = 0.3,
        jitter: float = 0.2,
        jitter_hue: float = 0.0,
        hue_saturation: float = 0.3,
        hue: float = 10.0,
        saturation: float = 20.0,
        value: float = 10.0,
    ) -> None:
        fractions = {"flip": flip, "affine": affine, "brightness_contrast": brightness_contrast}
        fractions |= {"color_jitter": color_jitter, "hue_saturation": hue_saturation, "shift": shift}
        fractions |= {"brightness": brightness, "contrast": contrast, "jitter": jitter}
        for name, fraction in fractions.items():
            if not 0.0 <= fraction <= 1.0:
                raise ValueError(f"{name}={fraction}: give a number from 0 to 1")
        one_of("zoom", zoom, ("depth", "focal"))
        self.zoom = zoom
        low, high = (float(s) for s in scale)
        if not 0.1 <= low <= high:
            raise ValueError(
                f"scale={list(scale)}: give a range of zoom factors [low, high], 0.1 <= low <= high"
            )

        A = _albumentations()
        geometry: list[Any] = [A.HorizontalFlip(p=flip)] if flip else []
        if affine:
            geometry.append(
                A.Affine(
                    scale=(low, high),
                    keep_ratio=True,
                    translate_percent=(-shift, shift),
                    rotate=(-rotate, rotate),
                    border_mode=0,  # cv2.BORDER_CONSTANT; reflecting modes would multiply the keypoints
                    fill=BORDER_COLOR,
                    fill_mask=0,
                    p=affine,
                )
            )
        color: list[Any] = []
        if brightness_contrast:
            color.append(
                A.RandomBrightnessContrast(
                    brightness_limit=brightness, contrast_limit=contrast, p=brightness_contrast
                )
            )
        if color_jitter:
            spread = (1.0 - jitter, 1.0 + jitter)
            color.append(A.ColorJitter(spread, spread, spread, hue=(-jitter_hue, jitter_hue), p=color_jitter))
        if hue_saturation:
            color.append(A.HueSaturationValue(hue, saturation, value, p=hue_saturation))
        points = A.KeypointParams(format="xy", remove_invisible=False)
        # two passes: the keypoints that carry the geometry need not go through the color changes
        along: dict[str, Any] = {"keypoint_params": points, "additional_targets": {"labels": "mask"}}
        self.geometry = A.Compose(geometry, **along) if geometry else None
        self.color = A.Compose(color) if color else None

    def __call__(self, frame: Frame, generator: np.random.Generator) -> Frame:
        """Augment one frame; see :class:`Augmentation`.

        Raises:
            ValueError: image and depth differ in size.
        """
        image, depth, intrinsics, name, labels = frame
        check_same_size(frame)
        # a shared state, as Compose.set_random_seed would seed all transforms alike, so that one draw
        # would decide on flip, affine and color alike
        chance = random.Random(int(generator.integers(2**63)))
        if self.geometry is not None:
            self.geometry.set_random_state(generator, chance)
            height, width = depth.shape
            corners = np.array([[0, 0], [width, 0], [0, height]], dtype=np.float32)
            # class 255 becomes 0 meanwhile, which is also the value from beyond the border
            classes = {} if labels is None else {"labels": labels + np.uint8(1)}
            moved = self.geometry(image=image, mask=depth, keypoints=corners, **classes)
            image, depth = moved["image"], moved["mask"]
            if labels is not None:
                labels = moved["labels"] - np.uint8(1)
            matrix = _affine_through(corners, np.asarray(moved["keypoints"], dtype=np.float64))
            depth, intrinsics = self._move_camera(depth, intrinsics, matrix)
        if self.color is not None:
            self.color.set_random_state(generator, chance)
            image = self.color(image=image)["image"]
        return Frame(image, depth, intrinsics, name, labels)

    def _move_camera(
        self, depth: np.ndarray, intrinsics: np.ndarray | None, matrix: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Return depth and intrinsics of a picture moved by ``matrix (2, 3)`` [px]."""
        zoom = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
        zoom = zoom if abs(zoom - 1.0) > 1e-5 else 1.0  # below that, it is rounding of float32 keypoints
        longer = zoom if self.zoom == "focal" and intrinsics is not None else 1.0
        if zoom != longer:
            depth = depth / np.float32(zoom)
        if intrinsics is not None:
            moved = np.array(intrinsics, dtype=np.float64)
            moved[:2, :2] *= longer
            moved[:2, 2] = matrix @ np.array([intrinsics[0, 2], intrinsics[1, 2], 1.0])
            intrinsics = moved
        return depth, intrinsics


def _albumentations() -> Any:
    """Import albumentations without its network request for a newer version."""
    os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")
    import albumentations

    return albumentations


def _affine_through(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return the ``(2, 3)`` matrix [px] that maps three points ``(3, 2)`` to their new places."""
    homogeneous = np.column_stack([before.astype(np.float64), np.ones(3)])
    return np.linalg.solve(homogeneous, after).T

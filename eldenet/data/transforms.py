"""Augmentation of a camera frame: the only file that imports albumentations."""

import random
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from eldenet.data.resize_crop import check_same_size
from eldenet.geometry import BORDER_COLOR
from eldenet.system.checks import one_of
from eldenet.system.resources import prepare_environment
from eldenet.types import Frame

IDENTITY = np.eye(2, 3)
Drawn = tuple[Any, dict[str, Any]]

#: How strongly colors change, in albumentations' units and no more than its defaults: our choice, as are the
#: probabilities. Brightness and contrast by a fifth; torchvision's jitter of brightness, contrast and
#: saturation by a fifth, not of hue; hue [2 degrees], saturation and value [255ths] by these amounts.
BRIGHTNESS_CONTRAST = 0.2
JITTER = (0.8, 1.2)
HUE_SATURATION_VALUE = (10.0, 20.0, 10.0)


class Change(NamedTuple):
    """What an :class:`Augmentation` drew for a frame; by default nothing."""

    intrinsics: np.ndarray | None  # (3, 3) of the moved picture [px], None if unknown
    matrix: np.ndarray = IDENTITY  # (2, 3), how the picture moves [px]
    nearer: float = 1.0  # depth is divided by it
    geometry: Sequence[Drawn] = ()  # transforms of albumentations that move the picture, and what each drew
    color: Sequence[Drawn] = ()  # the same, of those that recolor it


class Augmentation:
    """Randomly flip, zoom, shift, rotate and recolor a frame, with depth and intrinsics to match.

    Every probability is 0 for "off". The generator of a call alone decides what happens to a frame: neither
    earlier calls nor the worker matter. Pixels from beyond the border get one color and unknown depth (0), as
    a mirrored border would invent depth.

    A zoom by s is a longer lens (``zoom="focal"``: the focal lengths grow by s, depth stays), or it shows the
    scene from s times nearer (``zoom="depth"``: depth is divided by s, the focal lengths stay, and X and Y of
    every point in the camera frame stay; as in sparse-to-dense and FastDepth). To a network that predicts
    canonical depth both are the same. Frames without intrinsics have their depth divided in any case. Flip,
    rotation and shift keep depth. The principal point moves with the image. Rotating with unequal focal
    lengths (0.1 % apart for NYU) shears the scene by that difference times the sine of the angle, which is
    not corrected.

    Args:
        flip: probability of mirroring left and right.
        affine: probability of zoom, shift and rotation together.
        scale: range of the zoom factor s.
        zoom: what a zoom changes, "depth" or "focal".
        shift: largest shift, as a fraction of width and height.
        rotate: largest rotation [deg].
        brightness_contrast: probability of another brightness and contrast.
        color_jitter: probability of torchvision-like jitter of brightness, contrast and saturation.
        hue_saturation: probability of another hue, saturation and value.
        covered: probability that all of the picture gets one gray, as of a covered lens, a bare wall or the
            dark. Its depth stays, so a network learns how little such a picture tells.
        camera: probability of a picture as of another, worse camera: with other gamma and white balance,
            fewer pixels, blur, sharpening, noise and JPEG's artifacts, each by chance.
        random_convolution: probability that a random filter mixes colors and neighbors, so that shapes stay
            and textures do not: for rendered pictures (Xu et al., "Robust and Generalizable Visual
            Representation Learning via Random Convolutions", ICLR 2021).

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
        color_jitter: float = 0.3,
        hue_saturation: float = 0.3,
        covered: float = 0.0,
        camera: float = 0.0,
        random_convolution: float = 0.0,
    ) -> None:
        fractions = {"flip": flip, "affine": affine, "brightness_contrast": brightness_contrast}
        fractions |= {"covered": covered, "camera": camera, "random_convolution": random_convolution}
        fractions |= {"color_jitter": color_jitter, "hue_saturation": hue_saturation, "shift": shift}
        for name, fraction in fractions.items():
            if not 0.0 <= fraction <= 1.0:
                raise ValueError(f"{name}={fraction}: give a number from 0 to 1")
        one_of("zoom", zoom, ("depth", "focal"))
        self.zoom, self.camera, self.random_convolution = zoom, camera, random_convolution
        low, high = (float(s) for s in scale)
        if not 0.1 <= low <= high:
            raise ValueError(
                f"scale={list(scale)}: give a range of zoom factors [low, high], 0.1 <= low <= high"
            )

        prepare_environment()  # without it, albumentations asks the network for a newer version
        import albumentations as A
        import cv2

        self.geometry: list[Any] = [A.HorizontalFlip(p=flip)] if flip else []
        if affine:
            self.geometry.append(
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
        self.color: list[Any] = []
        if covered:  # without contrast, one gray of any brightness is left
            self.color.append(
                A.RandomBrightnessContrast(
                    brightness_limit=(0, 1), contrast_limit=(-1, -1), ensure_safe_range=False, p=covered
                )
            )
        if brightness_contrast:
            self.color.append(
                A.RandomBrightnessContrast(BRIGHTNESS_CONTRAST, BRIGHTNESS_CONTRAST, p=brightness_contrast)
            )
        if color_jitter:
            self.color.append(A.ColorJitter(JITTER, JITTER, JITTER, hue=(0, 0), p=color_jitter))
        if hue_saturation:
            self.color.append(A.HueSaturationValue(*HUE_SATURATION_VALUE, p=hue_saturation))
        averaged = {"downscale": cv2.INTER_AREA, "upscale": cv2.INTER_LINEAR}
        self.flaws: list[Any] = [
            A.RandomGamma((60, 165), p=0.7),
            A.MultiplicativeNoise((0.85, 1.15), per_channel=True, p=0.7),  # white balance
            A.Downscale((0.4, 0.9), interpolation_pair=averaged, p=0.2),
            A.GaussianBlur(sigma_limit=(0.4, 1.6), p=0.4),
            A.UnsharpMask(p=0.15),
            A.GaussNoise((0.0, 0.06), p=0.5),
            A.ImageCompression(quality_range=(20, 90), p=0.4),
        ]

    def __call__(self, frame: Frame, generator: np.random.Generator) -> Frame:
        """Augment one frame; see :class:`Augmentation`.

        Raises:
            ValueError: image and depth differ in size.
        """
        frame = self.as_of_another_camera(frame, generator)
        change = self.draw(frame, generator)
        image, depth, _, name, labels = frame
        for transform, drawn in change.geometry:
            image = np.ascontiguousarray(transform.apply(image, **drawn))
            depth = np.ascontiguousarray(transform.apply_to_mask(depth, **drawn))
            if labels is not None:
                # class 255 becomes 0 meanwhile, which is also the value from beyond the border
                moved = transform.apply_to_mask(labels + np.uint8(1), **drawn)
                labels = np.ascontiguousarray(moved) - np.uint8(1)
        for transform, drawn in change.color:
            image = transform.apply(image, **drawn)
        if change.nearer != 1:
            depth = depth / np.float32(change.nearer)
        return Frame(image, depth, change.intrinsics, name, labels)

    def as_of_another_camera(self, frame: Frame, generator: np.random.Generator) -> Frame:
        """Return the frame after ``random_convolution`` and ``camera``, which come before all else."""
        image = frame.image
        if self.random_convolution and generator.random() < self.random_convolution:
            image = randomly_convolved(image, generator)
        if self.camera and generator.random() < self.camera:
            chance = random.Random(int(generator.integers(2**63)))
            for transform, drawn in _drawn(self.flaws, image.shape[:2], generator, chance):
                image = transform.apply(image, **drawn)
        return frame._replace(image=image)

    def draw(self, frame: Frame, generator: np.random.Generator) -> Change:
        """Draw what else happens to a frame.

        Raises:
            ValueError: image and depth differ in size.
        """
        import cv2

        check_same_size(frame)
        # a shared state, as Compose.set_random_seed would seed all transforms alike, so that one draw
        # would decide on flip, affine and color alike
        chance = random.Random(int(generator.integers(2**63)))
        height, width = frame.depth.shape
        geometry = _drawn(self.geometry, (height, width), generator, chance)
        color = _drawn(self.color, (height, width), generator, chance)
        if not geometry:
            return Change(frame.intrinsics, color=color)
        corners = np.array([[0, 0], [width, 0], [0, height]], np.float32)
        points = np.pad(corners, [(0, 0), (0, 3)])  # albumentations' keypoints have three more columns
        for transform, drawn in geometry:
            points = transform.apply_to_keypoints(points, **drawn)
        matrix = cv2.getAffineTransform(corners, points[:, :2].astype(np.float32))
        nearer, intrinsics = self._move_camera(frame.intrinsics, matrix)
        return Change(intrinsics, matrix, nearer, geometry, color)

    def _move_camera(
        self, intrinsics: np.ndarray | None, matrix: np.ndarray
    ) -> tuple[float, np.ndarray | None]:
        """Return how much nearer a picture moved by ``matrix (2, 3)`` [px] is, and its intrinsics."""
        zoom = float(np.sqrt(abs(np.linalg.det(matrix[:, :2]))))
        zoom = zoom if abs(zoom - 1.0) > 1e-5 else 1.0  # below that, it is rounding of float32 keypoints
        longer = zoom if self.zoom == "focal" and intrinsics is not None else 1.0
        if intrinsics is not None:
            moved = np.array(intrinsics, dtype=np.float64)
            moved[:2, :2] *= longer
            moved[:2, 2] = matrix @ np.array([intrinsics[0, 2], intrinsics[1, 2], 1.0])
            intrinsics = moved
        return zoom / longer, intrinsics


def randomly_convolved(image: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """An RGB image ``(H, W, 3)`` uint8, mixed with itself after a random filter of 1 to 7 pixels.

    Mean and spread of each channel stay about the same.
    """
    import cv2

    side = int(generator.choice([1, 3, 5, 7]))
    filters = generator.normal(0, 1, (3, 3, side, side)).astype(np.float32)
    picture = image.astype(np.float32)
    filtered = np.stack(
        [
            sum(cv2.filter2D(picture[..., i], -1, one[i], borderType=cv2.BORDER_REFLECT) for i in range(3))
            for one in filters
        ],
        axis=-1,
    )
    centered = (filtered - filtered.mean((0, 1))) / (filtered.std((0, 1)) + 1e-3)
    filtered = centered * picture.std((0, 1)) + picture.mean((0, 1))
    share = np.float32(generator.random())
    return np.rint(share * picture + (1 - share) * filtered).clip(0, 255).astype(np.uint8)


def _drawn(
    transforms: Sequence[Any], size: tuple[int, int], generator: np.random.Generator, chance: random.Random
) -> list[Drawn]:
    """Return those of albumentations' transforms that take place, and the parameters that each draws."""
    if transforms:
        chance.random()  # albumentations' Compose, which earlier versions called, drew it too
    any_image = {"image": np.broadcast_to(np.uint8(0), (*size, 3))}
    drawn = []
    for transform in transforms:
        transform.set_random_state(generator, chance)
        if transform.should_apply():
            parameters = transform.update_transform_params(transform.get_params(), any_image)
            parameters |= transform.get_params_dependent_on_data(parameters, any_image)
            drawn.append((transform, parameters))
    return drawn

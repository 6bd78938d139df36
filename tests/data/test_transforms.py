"""Augmentation keeps the geometry true and depends on its generator alone; protocol geometry by hand."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
from torch.utils.data import DataLoader

from eldenet.data.base import DepthDataset
from eldenet.data.resize_crop import ResizeCrop
from eldenet.data.transforms import BORDER_COLOR, Augmentation
from eldenet.geometry import back_project, pinhole
from eldenet.types import Frame

OFF = {"flip": 0, "affine": 0, "brightness_contrast": 0, "color_jitter": 0, "hue_saturation": 0}
HEIGHT, WIDTH = 48, 62
FOCAL, CX, CY = 60.0, 27.3, 25.1


def depth_at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 2.0 + 0.01 * x + 0.02 * y


def ramp_frame() -> Frame:
    """A slanted wall whose color says which pixel it was: red = 4 x, green = 5 y."""
    y, x = np.indices((HEIGHT, WIDTH))
    image = np.stack([4 * x, 5 * y, np.full_like(x, 77)], axis=-1).astype(np.uint8)
    return Frame(image, depth_at(x, y).astype(np.float32), pinhole(FOCAL, FOCAL, CX, CY), "wall")


def source_pixels(moved: Frame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where each pixel of a moved ramp came from, to 1/8 pixel; the mask leaves out the mixed border."""
    inside = (moved.depth > 0) & (moved.image[..., 2] == 77)
    return moved.image[..., 0] / 4.0, moved.image[..., 1] / 5.0, inside


CASES = {
    "flip": {"flip": 1},
    "zoom": {"affine": 1, "scale": (1.2, 1.4), "shift": 0, "rotate": 0},
    "away": {"affine": 1, "scale": (0.7, 0.8), "shift": 0, "rotate": 0},
    "shift": {"affine": 1, "scale": (1, 1), "shift": 0.2, "rotate": 0},
    "rotate": {"affine": 1, "scale": (1, 1), "shift": 0, "rotate": 20},
    "all": {"flip": 1, "affine": 1, "scale": (0.8, 1.4), "shift": 0.1, "rotate": 15},
}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("case", CASES)
def test_augmented_points_agree_with_the_camera(case: str, seed: int) -> None:
    """P' = (R (X, Y), Z / s) with R a rotation or reflection about the optical axis, and no offset."""
    settings = {**OFF, **CASES[case]}
    frame = ramp_frame()
    moved = Augmentation(**settings)(frame, np.random.default_rng(seed))
    assert moved.image.dtype == np.uint8
    assert moved.depth.dtype == np.float32
    x, y, inside = source_pixels(moved)
    assert inside.mean() > 0.3

    # The map back to source pixels, read off the picture itself: it must take the new principal point to the
    # old one to a tenth of a pixel, which a wrong pixel center would miss by half a pixel. OpenCV before 5
    # rounds positions to 1/32.
    rows, cols = np.nonzero(inside)
    grid = np.column_stack([cols, rows, np.ones(len(rows))])
    back, *_ = np.linalg.lstsq(grid, np.column_stack([x[inside], y[inside]]), rcond=None)
    center = np.append(moved.intrinsics[:2, 2], 1.0)
    np.testing.assert_allclose(center @ back, [CX, CY], atol=0.1)
    zoom = 1 / np.sqrt(abs(np.linalg.det(back[:2])))
    low, high = settings.get("scale", (1, 1)) if settings["affine"] else (1, 1)
    assert low - 5e-3 <= zoom <= high + 5e-3
    assert np.sign(np.linalg.det(back[:2])) == (-1 if settings["flip"] else 1)

    # The points: X' and Y' are X and Y turned by that map, Z' is Z / s; depth is that of the nearest pixel.
    depth = depth_at(x, y)[inside]
    before = np.stack([(x[inside] - CX) / FOCAL * depth, (y[inside] - CY) / FOCAL * depth], axis=-1)
    after = back_project(moved.depth, moved.intrinsics)[inside]
    turn = np.linalg.inv(back[:2]) / zoom
    np.testing.assert_allclose(turn.T @ turn, np.eye(2), atol=0.015)  # the ramp has eight bits
    pixel = 3.0 / FOCAL
    np.testing.assert_allclose(after[:, :2], before @ turn, atol=pixel)
    np.testing.assert_allclose((after[:, :2] - before @ turn).mean(axis=0), 0.0, atol=0.05 * pixel)
    np.testing.assert_allclose(after[:, 2] * zoom, depth, atol=0.025)
    tight = (
        0.015 if high != low else 0.003
    )  # half a pixel between image and depth would be 0.01 m without zoom
    np.testing.assert_allclose((after[:, 2] * zoom - depth).mean(), 0.0, atol=tight)
    np.testing.assert_array_equal(moved.intrinsics[:2, :2], frame.intrinsics[:2, :2])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("case", CASES)
def test_points_reproject_to_where_a_longer_lens_shows_them(case: str, seed: int) -> None:
    """``zoom="focal"``: depth stays, so a point seen before projects, turned, to where it is seen after."""
    settings = {**OFF, **CASES[case]}
    frame = ramp_frame()
    moved = Augmentation(**settings, zoom="focal")(frame, np.random.default_rng(seed))
    x, y, inside = source_pixels(moved)
    rows, cols = np.nonzero(inside)
    grid = np.column_stack([cols, rows, np.ones(len(rows))])
    back, *_ = np.linalg.lstsq(grid, np.column_stack([x[inside], y[inside]]), rcond=None)
    zoom = 1 / np.sqrt(abs(np.linalg.det(back[:2])))
    assert moved.intrinsics[0, 0] == pytest.approx(FOCAL * zoom, rel=0.01)  # the ramp has eight bits
    assert moved.intrinsics[1, 1] == pytest.approx(moved.intrinsics[0, 0])
    np.testing.assert_allclose(moved.depth[inside], depth_at(x, y)[inside], atol=0.025)
    # the points, turned about the optical axis as the picture was, seen by the new camera
    z = depth_at(x, y)[inside]
    before = np.stack([(x[inside] - CX) / FOCAL * z, (y[inside] - CY) / FOCAL * z], axis=-1)
    turned = before @ (np.linalg.inv(back[:2]) / zoom)
    seen = np.column_stack([turned / z[:, None], np.ones(len(z))]) @ moved.intrinsics.T
    np.testing.assert_allclose(seen, grid, atol=0.6)
    np.testing.assert_allclose((seen - grid).mean(axis=0), 0, atol=0.1)


def test_flip_is_exact() -> None:
    frame = ramp_frame()
    moved = Augmentation(**{**OFF, "flip": 1})(frame, np.random.default_rng(0))
    np.testing.assert_array_equal(moved.image, frame.image[:, ::-1])
    np.testing.assert_array_equal(moved.depth, frame.depth[:, ::-1])
    np.testing.assert_allclose(moved.intrinsics[0, 2], WIDTH - 1 - CX, atol=1e-5)


def test_what_comes_from_outside_is_unknown() -> None:
    settings = {**OFF, "affine": 1, "scale": (0.5, 0.5), "shift": 0, "rotate": 0}
    moved = Augmentation(**settings)(ramp_frame(), np.random.default_rng(0))
    known = moved.depth > 0
    assert known[14:34, 18:44].all()
    assert not known[:11].any()
    assert not known[:, :14].any()
    assert not known[-11:].any()
    np.testing.assert_array_equal(moved.image[0, 0], BORDER_COLOR)


def test_unknown_stays_unknown() -> None:
    frame = ramp_frame()
    frame.depth[10:30, 20:40] = 0
    moved = Augmentation(**{**OFF, "flip": 1, "affine": 1, "rotate": 5})(frame, np.random.default_rng(3))
    x, y, inside = source_pixels(moved)
    deep_in_the_hole = (x > 21) & (x < 38) & (y > 11) & (y < 28) & (moved.image[..., 2] == 77)
    assert deep_in_the_hole.any()
    assert not moved.depth[deep_in_the_hole].any()
    assert moved.depth[inside].min() > 1.0  # nothing between known and unknown is invented


def test_color_leaves_depth_alone() -> None:
    frame = ramp_frame()
    colors = {"brightness_contrast": 1, "color_jitter": 1, "hue_saturation": 1}
    for one in ("brightness_contrast", "color_jitter", "hue_saturation", "camera", "random_convolution"):
        moved = Augmentation(**{**OFF, one: 1})(frame, np.random.default_rng(1))
        assert not np.array_equal(moved.image, frame.image), one
    moved = Augmentation(**{**OFF, **colors})(frame, np.random.default_rng(1))
    assert moved.image.dtype == np.uint8
    np.testing.assert_array_equal(moved.depth, frame.depth)
    np.testing.assert_array_equal(moved.intrinsics, frame.intrinsics)


def test_a_covered_picture_is_one_gray_and_keeps_its_depth() -> None:
    frame, grays = ramp_frame(), set()
    for seed in range(20):
        covered = Augmentation(**{**OFF, "covered": 1})(frame, np.random.default_rng(seed))
        assert (covered.image == covered.image[0, 0, 0]).all()
        grays.add(int(covered.image[0, 0, 0]))
        np.testing.assert_array_equal(covered.depth, frame.depth)
    assert len(grays) > 10
    assert min(grays) < 50
    assert max(grays) > 200


def test_another_camera_and_a_random_filter_keep_shapes() -> None:
    """A step of brightness stays at its place; each seed sees another picture, as bright on the whole."""
    image = np.full((48, 64, 3), 60, np.uint8)
    image[:, 32:] = 180
    frame = ramp_frame()._replace(image=image, depth=np.ones((48, 64), np.float32))
    for name in ("camera", "random_convolution"):
        seen = [Augmentation(**{**OFF, name: 1})(frame, np.random.default_rng(i)).image for i in range(12)]
        assert len({one.tobytes() for one in seen}) == 12
        places = []
        for one in seen:
            assert one.shape == image.shape
            assert 60 < one.mean() < 180
            steps = np.abs(np.diff(one.astype(float).mean(0), axis=0)).sum(-1)
            places.append(int(steps.argmax()))
        assert np.median(np.abs(np.array(places) - 31)) <= 2, name


def test_off_is_identity_and_input_is_not_changed() -> None:
    frame, copy = ramp_frame(), ramp_frame()
    same = Augmentation(**OFF)(frame, np.random.default_rng(0))
    np.testing.assert_array_equal(same.image, copy.image)
    np.testing.assert_array_equal(same.depth, copy.depth)
    Augmentation(flip=1, affine=1, color_jitter=1, hue_saturation=1)(frame, np.random.default_rng(0))
    for one, other in zip(frame, copy, strict=True):
        np.testing.assert_array_equal(one, other)


def test_frame_without_intrinsics() -> None:
    moved = Augmentation(flip=1, affine=1)(ramp_frame()._replace(intrinsics=None), np.random.default_rng(0))
    assert moved.intrinsics is None


def equal(one: Frame, other: Frame) -> bool:
    return np.array_equal(one.image, other.image) and np.array_equal(one.depth, other.depth)


def test_depends_on_the_generator_alone() -> None:
    frame, augment = ramp_frame(), Augmentation()
    first = augment(frame, np.random.default_rng((1, 2, 3)))
    for seed in range(5):
        augment(frame, np.random.default_rng(seed))
    assert equal(augment(frame, np.random.default_rng((1, 2, 3))), first)
    assert equal(pickle.loads(pickle.dumps(augment))(frame, np.random.default_rng((1, 2, 3))), first)
    assert equal(Augmentation()(frame, np.random.default_rng((1, 2, 3))), first)
    others = [augment(frame, np.random.default_rng((1, 2, k))) for k in range(4, 12)]
    assert not any(equal(a, b) for i, a in enumerate(others) for b in others[:i])


def test_choices_are_independent() -> None:
    """One throw of the dice per transform: seeding each with the same number would couple flip and affine."""
    augment = Augmentation(**{**OFF, "flip": 0.5, "affine": 0.5, "brightness_contrast": 0.5})
    frame, seen = ramp_frame(), np.zeros((2, 2, 2))
    for seed in range(240):
        moved = augment(frame, np.random.default_rng((7, 0, seed)))
        flipped = int(moved.image[24, -5, 0] < moved.image[24, 5, 0])
        affine = int(not np.isclose(moved.depth[24], frame.depth[24, :: -1 if flipped else 1]).all())
        recolored = int(moved.image[24, 31, 2] != 77)
        seen[flipped, affine, recolored] += 1
    assert seen.min() > 10  # 30 expected in each of the eight cells


class Walls(DepthDataset):
    def __init__(self, **options: object) -> None:
        super().__init__([f"wall{i}" for i in range(6)], min_depth=0.1, max_depth=10, **options)  # type: ignore[arg-type]

    def load_frame(self, index: int) -> Frame:
        return ramp_frame()


def test_the_number_of_workers_does_not_matter() -> None:
    walls = Walls(transform=Augmentation(), seed=5)
    keys = [(epoch, i) for epoch in range(2) for i in range(6)]
    alone = [walls[key] for key in keys]
    for workers in (0, 2):
        loader = DataLoader(walls, batch_size=2, sampler=keys, num_workers=workers)  # type: ignore[arg-type]
        images = [image for batch in loader for image in batch["image"]]
        assert all((a["image"] == b).all() for a, b in zip(alone, images, strict=True))
    assert not (alone[0]["image"] == alone[6]["image"]).all()  # another epoch
    assert not (alone[0]["image"] == alone[1]["image"]).all()  # another index of the same picture
    assert not (Walls(transform=Augmentation(), seed=6)[0]["image"] == alone[0]["image"]).all()


@pytest.mark.parametrize(
    "bad",
    [{"flip": 1.5}, {"affine": -0.1}, {"scale": (1.3, 1.0)}, {"scale": (0, 1)}, {"shift": -1}, {"camera": 2}],
)
def test_settings_out_of_range_are_refused(bad: dict) -> None:
    with pytest.raises(ValueError, match=next(iter(bad))):
        Augmentation(**bad)


def test_unequal_sizes_are_refused() -> None:
    frame = ramp_frame()._replace(depth=np.ones((4, 4), np.float32))
    for transform in (Augmentation(), ResizeCrop(crop=(2, 2))):
        with pytest.raises(ValueError, match=r"wall.*differ in size"):
            transform(frame, np.random.default_rng(0))


def test_importing_transforms_loads_no_albumentations() -> None:
    code = (
        "import sys, eldenet.data.transforms; sys.exit(not {'albumentations', 'cv2'}.isdisjoint(sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- protocol geometry ------------------------------------------------------------------------------------


def numbered(height: int, width: int) -> Frame:
    depth = np.arange(1, height * width + 1, dtype=np.float32).reshape(height, width)
    image = np.repeat((depth % 251).astype(np.uint8)[..., None], 3, axis=-1)
    return Frame(image, depth, pinhole(500.0, 400.0, 319.5, 239.5), "numbers")


def test_resize_and_crop_take_the_right_pixels() -> None:
    frame = numbered(4, 8)
    half = ResizeCrop(resize=0.5)(frame)
    np.testing.assert_array_equal(half.depth, frame.depth[1::2, 1::2])
    np.testing.assert_allclose(half.intrinsics, pinhole(250, 200, 159.5, 119.5))
    cropped = ResizeCrop(crop=(2, 4))(frame)
    np.testing.assert_array_equal(cropped.depth, frame.depth[1:3, 2:6])
    np.testing.assert_array_equal(cropped.image, frame.image[1:3, 2:6])
    np.testing.assert_allclose(cropped.intrinsics, pinhole(500, 400, 317.5, 238.5))


def test_sparse_to_denses_protocol_takes_the_right_pixels() -> None:
    """480x640, halved to 240x320, middle 228x304: rows 6:234, columns 8:312."""
    frame = numbered(480, 640)
    scored = ResizeCrop(resize=240 / 480, crop=(228, 304))(frame)
    np.testing.assert_array_equal(scored.depth, frame.depth[1::2, 1::2][6:234, 8:312])
    np.testing.assert_allclose(scored.intrinsics, pinhole(250, 200, 159.5 - 8, 119.5 - 6))


def test_fastdepths_protocol_moves_the_principal_point() -> None:
    """480x640 to 250x333 (rounded down), 228x304 from row 11 and column 14 (14.5, half to even), 224x224."""
    frame = numbered(480, 640)
    scored = ResizeCrop(resize=250 / 480, crop=(228, 304), size=(224, 224))(frame)
    assert scored.depth.shape == scored.image.shape[:2] == (224, 224)
    center = (319.5 + 0.5) * 333 / 640 - 0.5 - 14
    expected_cx = (center + 0.5) * 224 / 304 - 0.5
    expected_cy = ((239.5 + 0.5) * 250 / 480 - 0.5 - 11 + 0.5) * 224 / 228 - 0.5
    np.testing.assert_allclose(scored.intrinsics[:2, 2], [expected_cx, expected_cy])
    np.testing.assert_allclose(scored.intrinsics[0, 0], 500 * 333 / 640 * 224 / 304)


def test_a_frame_can_be_resized_to_a_size() -> None:
    assert ResizeCrop(resize=(30, 50))(ramp_frame()).depth.shape == (30, 50)
    assert ResizeCrop()(ramp_frame()).image.shape == (HEIGHT, WIDTH, 3)


def test_crop_must_fit() -> None:
    with pytest.raises(ValueError, match="does not fit"):
        ResizeCrop(crop=(49, 10))(ramp_frame())

"""Metrics against an independent reference and numbers worked out by hand; protocols pixel by pixel."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_erosion, gaussian_filter, zoom
from synthetic import SyntheticDepth
from torch import Tensor, nn

from eldenet.config import compose, instantiate
from eldenet.evaluation import ConstantPredictor, evaluate, fit_constant_predictor, predict_depth
from eldenet.metrics import LOWER_IS_BETTER, METRICS, UNITS, DepthMetrics, EvalProtocol, metrics_of

pytestmark = [
    pytest.mark.filterwarnings("ignore:Mean of empty slice"),  # the reference's NaN of images without SSIM
    pytest.mark.filterwarnings("ignore:The ``compute`` method of metric"),  # on purpose: nothing was added
]
FOLDER = Path(__file__).parents[1] / "configs" / "protocol"
NAMES = sorted(path.stem for path in FOLDER.glob("*.yaml"))


def from_yaml(name: str) -> EvalProtocol:
    return instantiate(compose("train", [f"protocol={name}"]).protocol)


def batch(seed: int, images: int = 3, size: tuple[int, int] = (14, 18), known: float = 0.7):
    generator = torch.Generator().manual_seed(seed)
    shape = (images, 1, *size)
    depth = 0.2 + 11 * torch.rand(shape, generator=generator)
    prediction = depth * (0.6 + 0.8 * torch.rand(shape, generator=generator))
    return prediction, depth, torch.rand(shape, generator=generator) < known


def scores(protocol: EvalProtocol, *batches: tuple[Tensor, Tensor, Tensor]) -> dict[str, float]:
    metrics = DepthMetrics(protocol)
    for one in batches:
        metrics.update(*one)
    return metrics.compute()


def assert_same(ours: dict[str, float], expected: dict[str, float], rel: float = 1e-5) -> None:
    assert ours == {
        name: pytest.approx(value, rel=rel, abs=1e-9, nan_ok=True) for name, value in expected.items()
    }


# --- the reference: NumPy in double precision, written from the papers' formulas ---


def one_image(p: np.ndarray, g: np.ndarray, counts: np.ndarray, value_range: float) -> dict[str, np.ndarray]:
    """Per-pixel values whose mean is the metric; ``ssim`` over the pixels with a whole window."""
    blur = lambda values: gaussian_filter(values, 1.5, truncate=3.5, mode="mirror")  # noqa: E731
    a, b = np.where(counts, p, 1.0), np.where(counts, g, 1.0)
    ma, mb = blur(a), blur(b)
    va, vb, cov = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    c1, c2 = (0.01 * value_range) ** 2, (0.03 * value_range) ** 2
    ssim = (2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))
    p, g = p[counts], g[counts]
    ratio = np.maximum(p / g, g / p)
    return {
        "mse": (p - g) ** 2,
        "mae": np.abs(p - g),
        "abs_rel": np.abs(p - g) / g,
        **{f"delta{i}": (ratio < 1.25**i).astype(float) for i in (1, 2, 3)},
        "log10": np.abs(np.log10(p) - np.log10(g)),
        "log": np.log(p) - np.log(g),
        "ssim": ssim[binary_erosion(counts, np.ones((11, 11)), border_value=1)],
    }


def summary(pixels: dict[str, np.ndarray]) -> dict[str, float]:
    mean = {name: values.mean() if len(values) else math.nan for name, values in pixels.items()}
    mean |= {
        "rmse": math.sqrt(mean["mse"]),
        "silog": 100 * (pixels["log"].std() if len(pixels["log"]) else math.nan),
    }
    return {name: mean[name] for name in METRICS}


def reference(protocol: EvalProtocol, prediction: Tensor, depth: Tensor, mask: Tensor) -> dict[str, float]:
    images = []
    for p, g, m in zip(
        prediction.double().numpy()[:, 0], depth.double().numpy()[:, 0], mask.numpy()[:, 0], strict=True
    ):
        counts = m & (g >= protocol.min_depth) & (g <= protocol.max_depth)
        if counts.any():
            p = p * np.median(g[counts]) / np.median(p[counts]) if protocol.scale == "median" else p
            p = p.clip(protocol.min_depth, protocol.max_depth) if protocol.clamp else p
            images.append(one_image(p, g, counts, protocol.max_depth))
    if protocol.average == "pixel":
        result = summary({name: np.concatenate([image[name] for image in images]) for name in images[0]})
    else:
        rows = [summary(image) for image in images]
        result = {name: float(np.nanmean([row[name] for row in rows])) for name in METRICS}
    return result | {"images": len(images), "pixels": sum(len(image["log"]) for image in images)}


@given(
    seed=st.integers(0, 2**31),
    known=st.sampled_from([0.1, 0.7, 0.995, 1.0]),
    average=st.sampled_from(["image", "pixel"]),
    scale=st.sampled_from(["metric", "median"]),
    clamp=st.booleans(),
)
@settings(max_examples=40, deadline=None)
def test_equals_the_reference(seed: int, known: float, average: str, scale: str, clamp: bool) -> None:
    protocol = EvalProtocol("p", average=average, scale=scale, clamp=clamp)
    data = batch(seed, known=known)
    assert_same(scores(protocol, data), reference(protocol, *data), rel=1e-4)


@pytest.mark.parametrize("average", ["image", "pixel"])
def test_by_hand(average: str) -> None:
    """Four known pixels: truth 1, 2, 4, 5 m; prediction 1, 2.5, 3, 10 m."""
    depth, prediction = torch.full((1, 1, 12, 12), 7.0), torch.full((1, 1, 12, 12), 3.0)
    mask = torch.zeros_like(depth, dtype=torch.bool)
    depth[..., 4:6, 4:6] = torch.tensor([[1.0, 2.0], [4.0, 5.0]])
    prediction[..., 4:6, 4:6] = torch.tensor([[1.0, 2.5], [3.0, 10.0]])
    mask[..., 4:6, 4:6] = True
    expected = {
        "mse": (0 + 0.25 + 1 + 25) / 4,  # errors 0, 0.5, 1, 5
        "rmse": 2.5617377,
        "mae": 1.625,
        "abs_rel": (0 + 0.25 + 0.25 + 1) / 4,
        "delta1": 0.25,  # ratios 1, 1.25, 1.333, 2: 1.25 itself is not below 1.25
        "delta2": 0.75,
        "delta3": 0.75,
        "log10": (0 + 0.0969100 + 0.1249387 + 0.3010300) / 4,
        "silog": 35.85462,  # ln: 0, 0.223144, -0.287682, 0.693147
        "ssim": math.nan,  # no window is wholly known
        "images": 1,
        "pixels": 4,
    }
    assert_same(scores(EvalProtocol("hand", average=average), (prediction, depth, mask)), expected)


def test_image_and_pixel_averages_differ_as_computed() -> None:
    """Image a: 1 pixel, 1 m off; image b: 3 pixels, 3 m off. Per image (1 + 3) / 2, pooled (1 + 9) / 4."""
    depth = torch.full((2, 1, 8, 8), 4.0)
    prediction = depth + torch.tensor([1.0, 3.0]).view(2, 1, 1, 1)
    mask = torch.zeros_like(depth, dtype=torch.bool)
    mask[0, 0, 0, :1] = mask[1, 0, 0, :3] = True
    per_image = scores(EvalProtocol("p", average="image"), (prediction, depth, mask))
    pooled = scores(EvalProtocol("p", average="pixel"), (prediction, depth, mask))
    assert (per_image["mae"], pooled["mae"]) == (2.0, 2.5)
    assert per_image["rmse"] == pytest.approx((1 + 3) / 2)
    assert pooled["rmse"] == pytest.approx(math.sqrt((1 + 9 + 9 + 9) / 4))


@pytest.mark.parametrize("average", ["image", "pixel"])
def test_batches_add_up(average: str) -> None:
    prediction, depth, mask = batch(1, images=7)
    protocol = EvalProtocol("p", average=average)
    whole = scores(protocol, (prediction, depth, mask))
    parts = [tuple(tensor[a:b] for tensor in (prediction, depth, mask)) for a, b in ((0, 1), (1, 5), (5, 7))]
    assert_same(scores(protocol, *parts), whole, rel=1e-12)


@pytest.mark.parametrize("average", ["image", "pixel"])
def test_processes_add_up(average: str) -> None:
    prediction, depth, mask = batch(2, images=5)
    protocol = EvalProtocol("p", average=average)
    first, second = DepthMetrics(protocol), DepthMetrics(protocol)
    first.update(prediction[:2], depth[:2], mask[:2])
    second.update(prediction[2:], depth[2:], mask[2:])
    assert all(how is torch.sum or how.__name__ == "dim_zero_sum" for how in first._reductions.values())
    for name in first._reductions:
        setattr(first, name, getattr(first, name) + getattr(second, name))
    first._computed = None
    assert_same(first.compute(), scores(protocol, (prediction, depth, mask)), rel=1e-12)
    second.reset()
    assert second.compute()["pixels"] == 0


def test_images_without_a_known_pixel_are_left_out() -> None:
    prediction, depth, mask = batch(3)
    mask[1] = False
    depth[2] = 20.0  # beyond the protocol's range
    result = scores(EvalProtocol("p"), (prediction, depth, mask))
    assert_same(result, reference(EvalProtocol("p"), prediction[:1], depth[:1], mask[:1]))
    assert result["images"] == 1
    mask[:] = False
    for average in ("image", "pixel"):
        nothing = scores(EvalProtocol("p", average=average), (prediction, depth, mask))
        assert (nothing.pop("images"), nothing.pop("pixels")) == (0, 0)
        assert all(math.isnan(value) for value in nothing.values())


def test_rows_are_the_images_of_the_last_batch() -> None:
    protocol = EvalProtocol("p")
    prediction, depth, mask = batch(4)
    metrics = DepthMetrics(protocol)
    metrics.update(prediction, depth, mask)
    for i, row in enumerate(metrics.rows.tolist()):
        expected = reference(protocol, prediction[i : i + 1], depth[i : i + 1], mask[i : i + 1])
        assert row == pytest.approx([expected[name] for name in METRICS], rel=1e-4, nan_ok=True)


def test_a_perfect_prediction_is_perfect() -> None:
    _, depth, mask = batch(5, known=1.0)
    result = scores(EvalProtocol("p", max_depth=12.0), (depth, depth, mask))
    for name in METRICS:
        assert result[name] == pytest.approx(0.0 if name in LOWER_IS_BETTER else 1.0, abs=1e-6), name
    assert set(UNITS) <= set(METRICS)


def test_sums_of_many_pixels_keep_their_digits() -> None:
    # 3e8 pixels of 0.1 m: single precision would have stopped counting at 2^24
    sums = torch.zeros(12, dtype=torch.float64)
    sums[0], sums[2] = 3e8, 3e8 * 0.1
    assert metrics_of(sums)[METRICS.index("mae")].item() == pytest.approx(0.1, rel=1e-12)


# --- what is scored ---


def box(counts: Tensor) -> tuple[int, int, int, int]:
    rows, cols = counts.any(dim=1).nonzero(), counts.any(dim=0).nonzero()
    return int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1


BOXES = {
    "nyu_bts": (45, 471, 41, 601),
    "nyu_inpainted_eigen": (45, 471, 41, 601),
    "nyu_densedepth": (20, 460, 24, 616),
    "nyu_paper": (0, 228, 0, 304),
    "nyu_sparse_to_dense": (0, 228, 0, 304),
    "kitti_depth": (0, 352, 0, 1216),
    "kitti_sparse": (0, 352, 0, 1216),
    "kitti_paper": (0, 228, 0, 912),
    "kitti_s2d_912x228": (0, 228, 0, 912),
    "kitti_eigen_garg_raw": (153, 371, 44, 1197),  # of 375 x 1242
    "kitti_eigen_garg_improved": (153, 371, 44, 1197),
    "kitti_eigen_eigen": (124, 342, 44, 1197),
}


@pytest.mark.parametrize("name", NAMES)
def test_crop_of_every_protocol(name: str) -> None:
    protocol = from_yaml(name)
    size = protocol.size or ((375, 1242) if name.startswith("kitti") else (30, 40))
    depth = torch.ones(1, 1, *size)
    counts = protocol.scored(depth, torch.ones_like(depth, dtype=torch.bool))[0, 0]
    top, bottom, left, right = box(counts)
    assert (top, bottom, left, right) == BOXES.get(name, (0, size[0], 0, size[1]))
    assert counts.sum() == (bottom - top) * (right - left)
    assert protocol.name == name
    assert EvalProtocol(**protocol.as_dict()) == protocol


@pytest.mark.parametrize(
    ("name", "size", "expected"),
    [  # by hand, 0.40810811 x 375 = 153.04, 0.99189189 x 375 = 371.96, 0.03594771 x 1242 = 44.6 ...
        ("kitti_eigen_garg_raw", (375, 1242), (153, 371, 44, 1197)),
        ("kitti_eigen_garg_raw", (352, 1216), (143, 349, 43, 1172)),
        ("kitti_eigen_garg_raw", (370, 1224), (151, 366, 43, 1180)),  # 366.99999 and 43.999997 are cut off
        ("kitti_eigen_eigen", (375, 1242), (124, 342, 44, 1197)),
        ("kitti_eigen_eigen", (352, 1216), (117, 321, 43, 1172)),
    ],
)
def test_fractions_are_of_the_truths_own_size(
    name: str, size: tuple[int, int], expected: tuple[int, ...]
) -> None:
    protocol = from_yaml(name)
    depth = torch.ones(2, 1, *size)
    counts = protocol.scored(depth, torch.ones_like(depth, dtype=torch.bool))
    assert box(counts[1, 0]) == protocol.crop_box(*size) == expected
    assert (protocol.min_depth, protocol.max_depth, protocol.average) == (1e-3, 80.0, "image")


def test_pasted_predictions_lie_where_the_image_was_cut_out() -> None:
    protocol = EvalProtocol("p", frame_crop=(4, 6), frame_anchor="bottom", paste=True)
    depth = torch.full((1, 1, 9, 11), 5.0)
    mask = torch.ones_like(depth, dtype=torch.bool)
    counts = protocol.scored(depth, mask)
    assert (
        box(counts[0, 0]) == protocol.pasted_box(9, 11) == (5, 9, 2, 8)
    )  # 11 - 6 is odd: one more on the right
    prediction = torch.arange(1.0, 25).view(1, 1, 4, 6).clamp(max=9)
    ready = protocol.prepare(prediction, depth, counts)
    torch.testing.assert_close(ready[..., 5:9, 2:8], prediction)
    assert (ready[..., :5, :] == protocol.min_depth).all()
    small = protocol.placed(prediction[..., ::2, ::2], (9, 11))
    assert small.shape == depth.shape
    assert (small[~counts] == 0).all()
    centred = EvalProtocol("p", frame_crop=(4, 6), paste=True)
    assert centred.pasted_box(9, 11) == (2, 6, 2, 8)
    with pytest.raises(ValueError, match="does not fit into ground truth of 3x11"):
        protocol.scored(depth[..., :3, :], mask[..., :3, :])


def test_protocols_are_the_literatures() -> None:
    bts, dense, sparse = (from_yaml(f"nyu_{name}") for name in ("bts", "densedepth", "sparse_to_dense"))
    assert (bts.ground_truth, bts.min_depth, bts.max_depth, bts.average, bts.clamp, bts.flip) == (
        "raw", 1e-3, 10.0, "image", True, "none",
    )  # fmt: skip
    assert (dense.ground_truth, dense.min_depth, dense.max_depth, dense.average, dense.flip) == (
        "inpainted", 0.1, 10.0, "pixel", "mean",
    )  # fmt: skip
    assert (sparse.resize, sparse.frame_crop, sparse.clamp, sparse.average) == (
        0.5,
        (228, 304),
        False,
        "image",
    )


def test_pixels_outside_the_crop_do_not_matter() -> None:
    protocol = EvalProtocol("p", size=(14, 18), crop=(2, 9, 3, 15))
    prediction, depth, mask = batch(6, known=1.0)
    inside = tuple(tensor[..., 2:9, 3:15] for tensor in (prediction, depth, mask))
    outside = torch.ones_like(mask)
    outside[..., 2:9, 3:15] = False
    result = scores(
        protocol, (prediction.masked_fill(outside, math.nan), depth.masked_fill(outside, 3.0), mask)
    )
    result.pop("ssim")  # needs whole windows
    expected = scores(EvalProtocol("p"), inside)
    assert_same(result, {name: expected[name] for name in result})


def test_range_is_strict_and_holes_do_not_count() -> None:
    protocol = EvalProtocol("p", min_depth=0.5, max_depth=4.0)
    depth = torch.tensor([0.0, 0.49, 0.5, 2.0, 4.0, 4.01, math.nan, math.inf]).view(1, 1, 1, 8)
    mask = torch.ones_like(depth, dtype=torch.bool)
    assert protocol.scored(depth, mask).flatten().tolist() == [
        False,
        False,
        False,
        True,
        False,
        False,
        False,
        False,
    ]
    mask[..., 3] = False
    assert protocol.scored(depth, mask).sum() == 0


def test_clamp() -> None:
    depth = torch.full((1, 1, 8, 8), 5.0)
    prediction = torch.full((1, 1, 8, 8), 50.0)
    mask = torch.ones_like(depth, dtype=torch.bool)
    assert scores(EvalProtocol("p", clamp=True), (prediction, depth, mask))["mae"] == 5.0
    assert scores(EvalProtocol("p", clamp=False), (prediction, depth, mask))["mae"] == 45.0
    assert scores(EvalProtocol("p", clamp=True), (-prediction, depth, mask))["mae"] == pytest.approx(4.999)


@pytest.mark.parametrize("value", [0.0, -5.0])
def test_unclamped_nonsense_never_counts_as_right(value: float) -> None:
    depth = torch.full((2, 1, 8, 8), 5.0)
    prediction = depth.clone()
    prediction[0] = value
    mask = torch.ones_like(depth, dtype=torch.bool)
    for average in ("image", "pixel"):
        result = scores(EvalProtocol("p", clamp=False, average=average), (prediction, depth, mask))
        assert result["delta1"] == result["delta3"] == 0.5
        assert not math.isfinite(result["log10"])  # undefined, and not that of the other image alone
        assert not math.isfinite(result["silog"])


def test_median_scale_forgives_a_factor_per_image() -> None:
    _, depth, mask = batch(7, images=2)
    factors = torch.tensor([0.5, 3.0]).view(2, 1, 1, 1)
    protocol = EvalProtocol("p", scale="median", max_depth=12.0)
    assert scores(protocol, (depth * factors, depth, mask))["abs_rel"] == pytest.approx(0, abs=1e-6)


def test_median_of_an_even_number_is_numpys() -> None:
    depth, prediction = torch.full((1, 1, 8, 8), 1.0), torch.full((1, 1, 8, 8), 1.0)
    depth[..., 0, :2] = torch.tensor([2.0, 4.0])
    prediction[..., 0, :2] = torch.tensor([1.0, 2.0])
    mask = torch.zeros_like(depth, dtype=torch.bool)
    mask[..., 0, :2] = True
    ready = EvalProtocol("p", scale="median").prepare(prediction, depth, mask)
    torch.testing.assert_close(ready[..., 0, :2].flatten(), torch.tensor([1.0, 2.0]) * 3.0 / 1.5)


@pytest.mark.parametrize("interpolation", ["bilinear", "nearest"])
def test_predictions_come_to_the_truths_size(interpolation: str) -> None:
    depth = torch.full((1, 1, 16, 24), 2.0)
    small = 1 + torch.rand(1, 1, 8, 12, generator=torch.Generator().manual_seed(0))
    mask = torch.ones_like(depth, dtype=torch.bool)
    ready = EvalProtocol("p", interpolation=interpolation).prepare(small, depth, mask)
    order = {"bilinear": 1, "nearest": 0}[interpolation]
    expected = zoom(small[0, 0].numpy(), 2, order=order, mode="nearest", grid_mode=True)
    np.testing.assert_allclose(ready[0, 0].numpy(), expected, atol=1e-6)


# --- what goes wrong ---


def test_size_of_another_data_set_is_an_error() -> None:
    prediction, depth, mask = batch(8)
    with pytest.raises(
        ValueError, match=r"nyu_bts is defined on ground truth of \(480, 640\) pixels.*\(14, 18\)"
    ):
        scores(from_yaml("nyu_bts"), (prediction, depth, mask))


@pytest.mark.parametrize("wrong", [lambda p: p[:1], lambda p: p[:, 0], lambda p: p.expand(-1, 3, -1, -1)])
def test_one_prediction_per_truth(wrong: Any) -> None:
    prediction, depth, mask = batch(9)
    with pytest.raises(ValueError, match=r"does not match ground truth \(3, 1, 14, 18\)"):
        scores(EvalProtocol("p"), (wrong(prediction), depth, mask))


@pytest.mark.parametrize("clamp", [True, False])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_prediction_that_is_not_finite_is_an_error(value: float, clamp: bool) -> None:
    prediction, depth, mask = batch(10)
    metrics = DepthMetrics(EvalProtocol("p", clamp=clamp, max_depth=12.0))
    mask[1, 0, 2, 3], mask[1, 0, 4, 5] = False, True
    prediction[1, 0, 2, 3] = value
    metrics.update(prediction, depth, mask)  # nothing is known there
    before = metrics.pooled.clone()
    prediction[1, 0, 4, 5] = value
    with pytest.raises(ValueError, match="not finite: NaN or infinity"):
        metrics.update(prediction, depth, mask)
    assert torch.equal(metrics.pooled, before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"average": "batch"}, "average='batch', choose one of"),
        ({"ground_truth": "dens"}, "ground_truth='dens'"),
        ({"min_depth": 0.0}, "0 < min_depth < max_depth"),
        ({"crop": (0, 5, 0, 5)}, "needs size"),
        ({"crop": (0, 5, 0, 25), "size": (20, 20)}, "within size"),
        ({"crop": (5, 5, 0, 5), "size": (20, 20)}, "within size"),
        ({"crop": (0, 5, 0), "size": (20, 20)}, "give 4 numbers"),
        ({"frame_crop": (352,)}, "give 2 numbers"),
        ({"crop_fractions": (0.5, 0.4, 0.0, 1.0)}, "crop_fractions=.* between 0 and 1"),
        ({"crop_fractions": (0.1, 0.4, 0.0)}, "crop_fractions=.* between 0 and 1"),
        ({"crop_fractions": (0, 1, 0, 1), "crop": (0, 5, 0, 5), "size": (9, 9)}, "takes the place of crop"),
        ({"frame_box": (0, 5, 9, 5)}, "frame_box=.* must be"),
        ({"frame_anchor": "top"}, "frame_anchor='top', choose one of"),
        ({"paste": True}, "paste=True .* give frame_crop"),
        ({"paste": True, "frame_crop": (4, 4), "frame_size": (2, 2)}, "no frame_box, resize or frame_size"),
    ],
)
def test_rules_that_make_no_sense(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"protocol p: .*{message}"):
        EvalProtocol("p", **options)


def test_yaml_lists_and_tuples_are_one_protocol() -> None:
    listed = EvalProtocol("p", size=[20, 20], crop=[0, 5, 0, 5], resize=[40, 40], frame_crop=[20, 20])
    assert listed == EvalProtocol("p", size=(20, 20), crop=(0, 5, 0, 5), resize=(40, 40), frame_crop=(20, 20))
    assert hash(listed) == hash(EvalProtocol(**listed.as_dict()))


# --- whole evaluations ---


class Leaning(nn.Module):
    """Depth grows to the right, so that the mirror image's prediction differs."""

    def __init__(self) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(()))

    def forward(self, image: Tensor) -> Tensor:
        ramp = torch.linspace(1, 9, image.shape[-1]).expand(len(image), 1, image.shape[-2], -1)
        return ramp * self.scale + image.mean(dim=1, keepdim=True)


def test_flip_averages_with_the_mirror_image() -> None:
    image = torch.rand(2, 3, 6, 8)
    model = Leaning()
    plain = model(image)
    torch.testing.assert_close(predict_depth(model, image), plain)
    both = predict_depth(model, image, flip="mean")
    # the ramp's mean with its own mirror image is flat; the image's part comes back to its place
    torch.testing.assert_close(both, 5.0 + image.mean(dim=1, keepdim=True))
    dataset = SyntheticDepth(4)
    flipped = evaluate(model, dataset, EvalProtocol("f", ground_truth="dense", flip="mean"))
    straight = evaluate(model, dataset, EvalProtocol("s", ground_truth="dense"))
    assert flipped.metrics["rmse"] != pytest.approx(straight.metrics["rmse"], rel=0.01)


def test_evaluation_scores_each_frame_once_at_the_truths_size() -> None:
    dataset = SyntheticDepth(5, input_size=(16, 24), resize_depth=False)
    protocol = EvalProtocol("p", ground_truth="dense", size=(32, 48))
    model = Leaning().train()
    result = evaluate(model, dataset, protocol, batch_size=2)
    again = evaluate(model, dataset, protocol, batch_size=5)
    assert_same(result.metrics, again.metrics, rel=1e-6)
    assert [row[0] for row in result.rows] == dataset.names
    assert result.metrics["images"] == 5
    assert result.metrics["pixels"] == 5 * 32 * 48
    mean_of_rows = np.mean([row[1:] for row in result.rows], axis=0)
    assert mean_of_rows.tolist() == pytest.approx([result.metrics[name] for name in METRICS])
    assert model.training


def test_evaluation_refuses_another_kind_of_truth() -> None:
    with pytest.raises(ValueError, match="scores raw ground truth, this data set has dense"):
        evaluate(Leaning(), SyntheticDepth(2), EvalProtocol("p"))


def test_constant_predictor_is_the_mean_of_known_depth() -> None:
    dataset = SyntheticDepth(4)
    model = fit_constant_predictor(dataset)
    expected = torch.stack([dataset[i]["depth"] for i in range(4)]).double().mean(0)
    torch.testing.assert_close(model.mean_depth[0].double(), expected, rtol=1e-6, atol=0)
    assert model(torch.rand(3, 3, 8, 8)).shape == (3, 1, 32, 48)
    assert isinstance(model, ConstantPredictor)


def test_constant_predictor_reads_no_more_frames_than_told(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset, read = SyntheticDepth(7), []
    load = dataset.load_frame
    monkeypatch.setattr(dataset, "load_frame", lambda index: read.append(index) or load(index))
    fit_constant_predictor(dataset, frames=4)
    assert read == [0, 2, 4, 6]

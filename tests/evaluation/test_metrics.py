"""Metrics against an independent reference and numbers worked out by hand; protocols pixel by pixel."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_erosion, gaussian_filter
from support.scoring import assert_same, batch, from_yaml, scores
from torch import Tensor

from eldenet.evaluation.metric_names import METRICS
from eldenet.evaluation.metrics import DepthMetrics, metrics_of
from eldenet.evaluation.protocol import EvalProtocol

pytestmark = [
    pytest.mark.filterwarnings("ignore:Mean of empty slice"),  # the reference's NaN of images without SSIM
    pytest.mark.filterwarnings("ignore:The ``compute`` method of metric"),  # on purpose: nothing was added
]
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


@pytest.mark.parametrize("average", ["image", "pixel"])
def test_batches_add_up(average: str) -> None:
    prediction, depth, mask = batch(1, images=7)
    protocol = EvalProtocol("p", average=average)
    whole = scores(protocol, (prediction, depth, mask))
    parts = [tuple(tensor[a:b] for tensor in (prediction, depth, mask)) for a, b in ((0, 1), (1, 5), (5, 7))]
    assert_same(scores(protocol, *parts), whole, rel=1e-12)


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


def test_sums_of_many_pixels_keep_their_digits() -> None:
    # 3e8 pixels of 0.1 m: single precision would have stopped counting at 2^24
    sums = torch.zeros(12, dtype=torch.float64)
    sums[0], sums[2] = 3e8, 3e8 * 0.1
    assert metrics_of(sums)[METRICS.index("mae")].item() == pytest.approx(0.1, rel=1e-12)


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
    with pytest.raises(ValueError, match="not finite: it is NaN or infinite"):
        metrics.update(prediction, depth, mask)
    assert torch.equal(metrics.pooled, before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"average": "batch"}, "average='batch', choose one of"),
        ({"ground_truth": "dens"}, "ground_truth='dens'"),
        ({"min_depth": 0.0}, "0 < min < max"),
        ({"crop": (0, 5, 0, 5)}, "needs size"),
        ({"crop": (0, 5, 0, 25), "size": (20, 20)}, "within size"),
        ({"crop": (5, 5, 0, 5), "size": (20, 20)}, "within size"),
        ({"crop": (0, 5, 0), "size": (20, 20)}, "give 4 numbers"),
        ({"frame_crop": (352,)}, "give 2 numbers"),
        ({"crop_fractions": (0.5, 0.4, 0.0, 1.0)}, "crop_fractions=.* between 0 and 1"),
        ({"crop_fractions": (0.1, 0.4, 0.0)}, "crop_fractions=.* between 0 and 1"),
        ({"crop": (0, 1, 0, 1), "size": (2, 2), "crop_fractions": (0, 1, 0, 1)}, "give one of them"),
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

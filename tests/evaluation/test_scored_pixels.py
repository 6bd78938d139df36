"""Which pixels a protocol scores, pixel by pixel; range, clamp, scale."""

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import zoom
from support.scoring import assert_same, batch, from_yaml, scores
from torch import Tensor

from eldenet.evaluation.protocol import EvalProtocol

pytestmark = pytest.mark.filterwarnings("ignore:Mean of empty slice")  # images without SSIM


def box(counts: Tensor) -> tuple[int, int, int, int]:
    rows, cols = counts.any(dim=1).nonzero(), counts.any(dim=0).nonzero()
    return int(rows[0]), int(rows[-1]) + 1, int(cols[0]), int(cols[-1]) + 1


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
    counts = protocol.valid_mask(depth, torch.ones_like(depth, dtype=torch.bool))
    assert box(counts[1, 0]) == protocol.crop_box(*size) == expected
    assert (protocol.min_depth, protocol.max_depth, protocol.average) == (1e-3, 80.0, "image")


def test_pasted_predictions_lie_where_the_image_was_cut_out() -> None:
    protocol = EvalProtocol("p", frame_crop=(4, 6), frame_anchor="bottom", paste=True)
    depth = torch.full((1, 1, 9, 11), 5.0)
    mask = torch.ones_like(depth, dtype=torch.bool)
    counts = protocol.valid_mask(depth, mask)
    assert (
        box(counts[0, 0]) == protocol.pasted_box(9, 11) == (5, 9, 2, 8)
    )  # 11 - 6 is odd: one more on the right
    prediction = torch.arange(1.0, 25).view(1, 1, 4, 6).clamp(max=9)
    ready = protocol.align(prediction, depth, counts)
    torch.testing.assert_close(ready[..., 5:9, 2:8], prediction)
    assert (ready[..., :5, :] == protocol.min_depth).all()
    small = protocol.resize_to_gt(prediction[..., ::2, ::2], (9, 11))
    assert small.shape == depth.shape
    assert (small[~counts] == 0).all()
    centered = EvalProtocol("p", frame_crop=(4, 6), paste=True)
    assert centered.pasted_box(9, 11) == (2, 6, 2, 8)
    with pytest.raises(ValueError, match="does not fit into ground truth of 3x11"):
        protocol.valid_mask(depth[..., :3, :], mask[..., :3, :])


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
    assert protocol.valid_mask(depth, mask).flatten().nonzero().tolist() == [[3]]
    mask[..., 3] = False
    assert protocol.valid_mask(depth, mask).sum() == 0


@pytest.mark.parametrize("value", [0.0, -5.0])
def test_predictions_of_0_or_less_are_never_right(value: float) -> None:
    depth = torch.full((2, 1, 8, 8), 5.0)
    prediction = depth.clone()
    prediction[0] = value
    mask = torch.ones_like(depth, dtype=torch.bool)
    for average in ("image", "pixel"):
        result = scores(EvalProtocol("p", clamp=False, average=average), (prediction, depth, mask))
        assert result["delta1"] == result["delta3"] == 0.5
        assert not math.isfinite(result["log10"])  # undefined, and not that of the other image alone
        assert not math.isfinite(result["silog"])


@pytest.mark.parametrize("size", [(16, 24), (19, 31), (5, 7)])
def test_nearest_is_that_of_the_pixels_centers(size: tuple[int, int]) -> None:
    depth, small = torch.full((1, 1, *size), 2.0), 1 + torch.arange(96.0).view(1, 1, 8, 12) / 96
    protocol = EvalProtocol("p", interpolation="nearest")
    ready = protocol.align(small, depth, torch.ones_like(depth, dtype=torch.bool))
    rows, cols = ((2 * np.arange(to) + 1) * of // (2 * to) for to, of in zip(size, (8, 12), strict=True))
    np.testing.assert_array_equal(ready[0, 0].numpy(), small[0, 0].numpy()[rows][:, cols])


def test_predictions_come_to_the_truths_size() -> None:
    depth = torch.full((1, 1, 16, 24), 2.0)
    small = 1 + torch.rand(1, 1, 8, 12, generator=torch.Generator().manual_seed(0))
    mask = torch.ones_like(depth, dtype=torch.bool)
    ready = EvalProtocol("p").align(small, depth, mask)
    expected = zoom(small[0, 0].numpy(), 2, order=1, mode="nearest", grid_mode=True)
    np.testing.assert_allclose(ready[0, 0].numpy(), expected, atol=1e-6)

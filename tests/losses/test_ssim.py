"""SSIM as a loss: equal to two other implementations, over whole windows only, in full precision."""

import kornia.metrics
import numpy as np
import pytest
import torch
from scipy.ndimage import binary_erosion
from skimage.metrics import structural_similarity
from support.depth_maps import maps, patchy, value_and_gradient

from eldenet.losses.ssim import SSIMLoss, eroded, ssim_map


@pytest.mark.parametrize("window", [5, 7, 11])
@pytest.mark.parametrize("size", [(11, 14), (24, 31)])
def test_the_map_equals_kornias(size: tuple[int, int], window: int) -> None:
    prediction, target = maps(5, size=size, dtype=torch.float64)
    ours = ssim_map(prediction, target, window=window, value_range=10.0)
    theirs = kornia.metrics.ssim(prediction, target, window, max_val=10.0, eps=0.0)
    torch.testing.assert_close(ours, theirs, atol=1e-12, rtol=0)
    single = ssim_map(prediction.float(), target.float(), window=window, value_range=10.0)
    torch.testing.assert_close(single.double(), theirs, atol=1e-5, rtol=0)


def test_map_and_loss_equal_scikit_images() -> None:
    prediction, target = maps(6, size=(32, 40), batch=1, dtype=torch.float64)
    mean, full = structural_similarity(
        prediction[0, 0].numpy(),
        target[0, 0].numpy(),
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=10.0,
        full=True,
    )
    inside = np.s_[5:-5, 5:-5]
    ours = ssim_map(prediction, target, window=11, value_range=10.0)[0, 0].numpy()
    np.testing.assert_allclose(ours[inside], full[inside], atol=1e-10)
    assert abs(ours - full).max() > 1e-3  # at the borders, which are kornia's
    assert ours[inside].mean() == pytest.approx(mean)
    loss = SSIMLoss()(prediction, target, torch.ones_like(target, dtype=torch.bool))
    assert loss.item() == pytest.approx((1 - ours.mean()) / 2)


@pytest.mark.parametrize("window", [3, 7, 11])
@pytest.mark.parametrize("share", [0.0, 0.005, 0.05, 1.0])
def test_mask_erosion_equals_scipys(window: int, share: float) -> None:
    mask = patchy(7, (3, 1, 30, 40), share)
    ours = eroded(mask, window).numpy()
    expected = [
        binary_erosion(one, structure=np.ones((window, window)), border_value=1) for one in mask[:, 0].numpy()
    ]
    np.testing.assert_array_equal(ours[:, 0], expected)


def test_only_windows_without_unknown_pixels_count() -> None:
    prediction, target = maps(8, size=(30, 40), batch=1, dtype=torch.float64)
    mask = torch.ones_like(target, dtype=torch.bool)
    mask[..., 15, 20] = False
    similarity = ssim_map(prediction, target, window=11, value_range=10.0)
    keep = np.ones((30, 40), dtype=bool)
    keep[10:21, 15:26] = False
    expected = ((1 - similarity[0, 0].numpy()) / 2)[keep].mean()
    assert SSIMLoss()(prediction, target, mask).item() == pytest.approx(expected)


def test_autocast_does_not_lower_the_precision() -> None:
    prediction, target = maps(9)
    target = prediction + 0.05 * target
    exact = ssim_map(prediction.double(), target.double(), window=11, value_range=10.0)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        mixed = ssim_map(prediction, target, window=11, value_range=10.0)
    torch.testing.assert_close(mixed.double(), exact, atol=1e-5, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_training_works_after_an_evaluation_at_the_same_size(dtype: torch.dtype) -> None:
    size = (13, 17)  # used by no other test, so its blur is cached here, in inference mode
    prediction, target = maps(10, size=size, dtype=dtype)
    with torch.inference_mode():
        ssim_map(prediction, target, window=11, value_range=10.0)
    mask = torch.ones_like(target, dtype=torch.bool)
    loss = SSIMLoss()
    with torch.inference_mode():
        loss(prediction, target, mask)  # it keeps its blur too
    _, gradient = value_and_gradient(loss, prediction, target, mask)
    assert gradient.abs().sum() > 0


def test_even_windows_and_maps_smaller_than_the_window_are_refused() -> None:
    with pytest.raises(ValueError, match="window=4: give an odd number"):
        SSIMLoss(window=4)
    small = torch.ones(1, 1, 5, 50)
    with pytest.raises(ValueError, match=r"maps of \(1, 1, 5, 50\) are too small for SSIM's window of 11"):
        ssim_map(small, small, window=11, value_range=10.0)

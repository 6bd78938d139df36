"""Structural dissimilarity of depth maps."""

from functools import lru_cache

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from eldenet.losses.base import Loss, fill_masked, masked_mean

SIGMA = 1.5  # [px], Wang et al. 2004


@lru_cache(maxsize=32)
@torch.inference_mode(False)  # cached: training may use one that an evaluation made
def _blur_matrix(length: int, window: int) -> Tensor:
    """Return the Gaussian blur of pixels in a row, ends reflected, as ``(length, length)`` float64."""
    radius = window // 2
    kernel = torch.exp(-((torch.arange(window, dtype=torch.float64) - radius) ** 2) / (2 * SIGMA**2))
    kernel /= kernel.sum()
    matrix = torch.zeros(length, length, dtype=torch.float64)
    rows = torch.arange(length)
    for tap in range(window):
        columns = (rows + tap - radius).abs()
        columns = torch.where(columns >= length, 2 * (length - 1) - columns, columns)
        matrix.index_put_((rows, columns), kernel[tap].expand(length), accumulate=True)
    return matrix


class GaussianBlur(nn.Module):
    """Blur of maps ``(B, 1, H, W)`` that keeps its matrices on their device: a step copies nothing there.

    Args:
        window: side of the Gaussian window [px], odd.
    """

    def __init__(self, window: int) -> None:
        super().__init__()
        self.window = window

    def forward(self, maps: Tensor) -> Tensor:
        """Blurred maps ``(B, 1, H, W)``."""
        down, across = (self._matrix(length, maps) for length in maps.shape[-2:])
        return down @ maps @ across.T

    def _matrix(self, length: int, maps: Tensor) -> Tensor:
        name = f"of_{length}"
        kept = self._buffers.get(name)
        if kept is None or kept.dtype != maps.dtype or kept.device != maps.device:
            with torch.inference_mode(False):  # kept: training may use one that an evaluation made
                kept = _blur_matrix(length, self.window).to(maps.device, maps.dtype)
            self.register_buffer(name, kept, persistent=False)
        return kept


def ssim_map(
    prediction: Tensor,
    target: Tensor,
    *,
    window: int,
    value_range: float,
    blur: nn.Module | None = None,
) -> Tensor:
    """Return the SSIM of two maps per pixel, ``(B, 1, H, W)`` in [-1, 1] (Wang et al. 2004).

    The values equal those of ``kornia.metrics.ssim``. The blur is two matrix products, because CPUs are
    slowest at one-channel 11 x 11 convolutions: training spent most of its time in them.

    Convention: Gaussian window with sigma 1.5, population (not sample) covariance, and kornia's borders,
    which are reflected without repeating the edge. scikit-image's
    ``structural_similarity(gaussian_weights=True, use_sample_covariance=False)`` repeats it: the same values
    but within half a window of the border.

    Args:
        prediction: ``(B, 1, H, W)`` [m].
        target: the same.
        window: side of the Gaussian window [px], odd.
        value_range: L of the SSIM constants.
        blur: a :class:`GaussianBlur` of ``window``; None: a new one.

    Raises:
        ValueError: a map is not larger than the window's radius, as reflection needs.
    """
    if min(prediction.shape[-2:]) <= window // 2:
        raise ValueError(
            f"maps of {tuple(prediction.shape)} are too small for SSIM's window of {window} pixels: "
            f"height and width must exceed {window // 2}"
        )
    blur = blur or GaussianBlur(window)
    # a variance is a small difference of large means: bf16 autocast would lose it
    with torch.autocast(prediction.device.type, enabled=False):
        dtype = torch.promote_types(torch.promote_types(prediction.dtype, target.dtype), torch.float32)
        prediction, target = prediction.to(dtype), target.to(dtype)
        # separate, so that no gradient is computed for the target's own moments
        mean_t, square_t = blur(torch.cat([target, target**2])).chunk(2)
        moments = torch.cat([prediction, prediction**2, prediction * target])
        mean_p, square_p, product = blur(moments).chunk(3)
    c1, c2 = (0.01 * value_range) ** 2, (0.03 * value_range) ** 2
    means, squares = mean_p * mean_t, mean_p**2 + mean_t**2
    covariance, variances = product - means, square_p + square_t - squares
    return (2 * means + c1) * (2 * covariance + c2) / ((squares + c1) * (variances + c2))


class SSIMLoss(Loss):
    """``(1 - SSIM) / 2``, averaged where the whole window is known.

    This is the usual form of the paper's SSIM term; its own formula is missing from our copy of the text.

    A pixel counts only if its window holds no unknown pixel: the mask is eroded by the window's radius.
    The image border does not erode it, so a full mask stays full.

    Args:
        window: side of the Gaussian window [px], odd.
        value_range: L of the SSIM constants: the largest depth [m] (or its value in the term's space).

    Raises:
        ValueError: an even window.
    """

    def __init__(self, window: int = 11, value_range: float = 10.0) -> None:
        super().__init__()
        if window % 2 == 0:
            raise ValueError(f"window={window}: give an odd number of pixels")
        self.window, self.value_range = window, value_range
        self.blur = GaussianBlur(window)

    def forward(self, prediction: Tensor, target: Tensor, mask: Tensor) -> Tensor:
        """``(B, 1, H, W)`` [m] each, mask bool -> scalar in [0, 1]."""
        prediction, target = fill_masked(prediction, target, mask)
        similarity = ssim_map(
            prediction, target, window=self.window, value_range=self.value_range, blur=self.blur
        )
        return masked_mean((1 - similarity) / 2, eroded(mask, self.window))


def eroded(mask: Tensor, window: int) -> Tensor:
    """Return the pixels ``(B, 1, H, W)`` whose ``window`` is known wherever it lies inside the image."""
    if _known_everywhere(mask):
        return mask
    unknown, radius = (~mask).float(), window // 2
    unknown = F.max_pool2d(unknown, (window, 1), stride=1, padding=(radius, 0))
    return F.max_pool2d(unknown, (1, window), stride=1, padding=(0, radius)) == 0


def _known_everywhere(mask: Tensor) -> bool:
    """Whether a mask is known to be full; False on a GPU, which would have to be waited for."""
    return mask.device.type == "cpu" and not torch.compiler.is_compiling() and bool(mask.all())

"""Every protocol from end to end against its definition in the literature, written out in plain NumPy."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.data.base import DepthDataset
from eldenet.evaluation.evaluator import evaluate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.train import TrainSettings
from eldenet.types import Frame

FOLDER = Path(__file__).parents[2] / "configs" / "protocol"


class Rules(NamedTuple):
    """A definition as papers and their code give it, for ground truth of ``size``."""

    size: tuple[int, int]
    crop: tuple[slice, slice] = (slice(None), slice(None))  # of the ground truth
    low: float = 1e-3
    cap: float = 80.0
    clamp: bool = True
    pooled: bool = False
    mirrored: bool = False
    pasted: tuple[slice, slice] | None = None  # where the network's picture lies
    inverse: float | None = None
    scale: str = "metric"


EIGEN_BTS = (slice(45, 471), slice(41, 601))
GARG = (
    slice(153, 371),
    slice(44, 1197),
)  # of 375 x 1242: 0.40810811 x 375 = 153.04, 0.99189189 x 375 = 371.96
GARG_IN_KB = (slice(143, 349), slice(43, 1172))  # the fractions of 352 x 1216
EIGEN = (slice(124, 342), slice(44, 1197))  # 0.3324324 x 375 = 124.66, 0.91351351 x 375 = 342.57
KB = (slice(23, 375), slice(13, 1229))  # 375 - 352 = 23, (1242 - 1216) / 2 = 13
LITERATURE = {
    "rooms": Rules((30, 40), low=0.1, cap=10),
    "arenas": Rules((30, 40), low=0.1, cap=10),
    "streets": Rules((30, 40), low=1.0, cap=80),
    "folder": Rules((30, 40), low=0.1, cap=10),  # the range of the data set, here the default one
    "nyu_bts": Rules((480, 640), EIGEN_BTS, cap=10),
    **{
        f"nyu_bts_{scale}": Rules((480, 640), EIGEN_BTS, cap=10, scale=scale)
        for scale in ("median", "affine_depth", "affine_disparity")
    },
    "nyu_adabins": Rules((480, 640), EIGEN_BTS, cap=10, mirrored=True),
    "nyu_inpainted_eigen": Rules((480, 640), EIGEN_BTS, cap=10),
    "nyu_densedepth": Rules(
        (480, 640), (slice(20, 460), slice(24, 616)), low=0.1, cap=10, pooled=True, mirrored=True
    ),
    "nyu_sparse_to_dense": Rules((228, 304), cap=100, clamp=False),
    "nyu_paper": Rules((228, 304), cap=10),
    "kitti_eigen_garg_raw": Rules((375, 1242), GARG),
    "kitti_eigen_eigen": Rules((375, 1242), EIGEN),
    "kitti_eigen_garg_improved": Rules((375, 1242), GARG, pasted=KB),
    **{
        f"kitti_eigen_garg_improved_{scale}": Rules((375, 1242), GARG, pasted=KB, scale=scale)
        for scale in ("median", "affine_depth", "affine_disparity")
    },
    "kitti_adabins": Rules((352, 1216), GARG_IN_KB, mirrored=True),
    "kitti_depth": Rules((352, 1216)),
    "kitti_sparse": Rules((352, 1216)),
    "kitti_paper": Rules((228, 912)),
    "kitti_s2d_912x228": Rules((228, 912), cap=120, clamp=False),
    "cityscapes_metric": Rules((1024, 2048)),
    "cityscapes_paper": Rules((128, 256)),
    "cityscapes_mtan": Rules((128, 256), low=0.5, cap=1e6, clamp=False, inverse=0.22 * 2262.52 * 256 / 65535),
}


class Frames(DepthDataset):
    """Two frames whose depth goes past the cap, with holes (more of them in the second)."""

    def __init__(self, rules: Rules, kind: str) -> None:
        super().__init__(["a", "b"], min_depth=1e-6, max_depth=1e9)
        self.rules, self.ground_truth = rules, kind

    def load_frame(self, index: int) -> Frame:
        generator = np.random.default_rng(index)
        depth = generator.uniform(0, 1.2 * min(self.rules.cap, 200), self.rules.size).astype(np.float32)
        depth[generator.random(self.rules.size) < (0.2, 0.7)[index]] = 0
        image = generator.integers(0, 256, (*self.rules.size, 3)).astype(np.uint8)
        if self.rules.pasted is not None:
            image = image[self.rules.pasted]
        return Frame(image, depth, None, self.names[index])


class Slanted(nn.Module):
    """Grows from left to right, and follows the picture; from below the range to above it."""

    def __init__(self, cap: float) -> None:
        super().__init__()
        self.cap = cap

    def forward(self, image: Tensor) -> Tensor:
        ramp = torch.linspace(0.0, 1.1, image.shape[-1]).expand(len(image), 1, image.shape[-2], -1)
        return self.cap * (ramp + 0.2 * image[:, :1]) + 1e-4


def fitted(guess: np.ndarray, truth: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Factor and shift by NumPy's least squares over the pixels that count."""
    columns = np.stack([guess[counts], np.ones(counts.sum())], axis=1)
    factor, shift = np.linalg.lstsq(columns, truth[counts], rcond=None)[0]
    return factor * guess + shift


def aligned(guess: np.ndarray, truth: np.ndarray, counts: np.ndarray, rules: Rules) -> np.ndarray:
    if rules.scale == "median":
        return guess * np.median(truth[counts]) / np.median(guess[counts])
    if rules.scale == "affine_depth":
        return fitted(guess, truth, counts)
    if rules.scale == "affine_disparity":
        with np.errstate(divide="ignore"):
            disparity = fitted(1 / guess.clip(rules.low), 1 / truth, counts)
        return 1 / disparity.clip(1 / rules.cap)
    return guess


def by_hand(rules: Rules, data: Frames) -> dict[str, float]:
    images: list[dict[str, np.ndarray]] = []
    cap = min(rules.cap, 200)
    for index in range(2):
        frame = data.load_frame(index)
        red = (frame.image[..., 0] / np.float32(255)).astype(np.float64)
        ramp = np.linspace(0.0, 1.1, red.shape[1])[None]
        seen = cap * (ramp + 0.2 * red) + 1e-4
        if rules.mirrored:  # the mirror image's prediction, mirrored back
            seen = (seen + cap * (ramp[:, ::-1] + 0.2 * red) + 1e-4) / 2
        guess = np.zeros(rules.size)
        guess[rules.pasted or (slice(None), slice(None))] = seen
        truth = frame.depth.astype(np.float64)
        counts = np.zeros(rules.size, bool)
        counts[rules.crop] = True
        counts &= (truth > rules.low) & (truth < rules.cap)
        guess = aligned(guess, truth, counts, rules)
        if rules.clamp:
            guess = guess.clip(rules.low, rules.cap)
        p, g = guess[counts], truth[counts]
        if rules.inverse is not None:
            p, g = rules.inverse / np.maximum(p, rules.low), rules.inverse / g
        ratio = np.maximum(p / g, g / p)
        images.append(
            {"mse": (p - g) ** 2, "abs_rel": abs(p - g) / g, "delta1": ratio < 1.25, "mae": abs(p - g)}
        )

    def mean(name: str, change: Any = lambda value: value) -> float:
        if rules.pooled:
            return float(change(np.concatenate([image[name] for image in images]).mean()))
        return float(np.mean([change(image[name].mean()) for image in images]))

    counted = sum(len(image["mae"]) for image in images)
    result = {name: mean(name) for name in ("mse", "mae", "abs_rel", "delta1")}
    return result | {"rmse": mean("mse", np.sqrt), "pixels": counted}


def test_every_protocol_is_here() -> None:
    assert set(LITERATURE) == {path.stem for path in FOLDER.glob("*.yaml")}


ALIGNED = ("nyu_paper", "kitti_sparse", "nyu_densedepth", "cityscapes_mtan")  # of each kind of rule


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        *((name, rules.scale) for name, rules in sorted(LITERATURE.items())),
        *((name, scale) for name in ALIGNED for scale in ("median", "affine_depth", "affine_disparity")),
    ],
)
def test_scores_are_the_definitions(name: str, scale: str) -> None:
    rules = LITERATURE[name]
    protocol: EvalProtocol = instantiate(compose(TrainSettings, [f"protocol={name}"]).protocol)
    assert (protocol.name, protocol.scale) == (name, rules.scale)
    assert EvalProtocol(**protocol.as_dict()) == protocol
    protocol, rules = EvalProtocol(**{**protocol.as_dict(), "scale": scale}), rules._replace(scale=scale)
    data = Frames(rules, protocol.ground_truth)
    model = Slanted(min(rules.cap, 200))
    result = evaluate(model, data, protocol, batch_size=1 + (rules.size[0] < 400)).metrics
    expected = by_hand(rules, data)
    assert result["pixels"] == expected["pixels"]
    for metric, value in expected.items():
        tolerance = 1e-3 if metric == "delta1" or rules.inverse else 1e-4  # single precision at a threshold
        assert result[metric] == pytest.approx(value, rel=tolerance), metric


@pytest.mark.parametrize("scale", ["median", "affine_depth", "affine_disparity"])
def test_alignment_undoes_what_it_fits(scale: str) -> None:
    """A prediction that is wrong by a factor (and a shift) alone scores no error."""
    protocol = EvalProtocol("any", scale=scale, clamp=False)
    truth = torch.rand(2, 1, 12, 16, dtype=torch.float64) * 5 + 1
    valid = torch.rand(2, 1, 12, 16) > 0.3
    wrong = {
        "median": 0.3 * truth,
        "affine_depth": 0.3 * truth + 2,
        "affine_disparity": 1 / (0.3 / truth + 0.02),
    }[scale]
    found = protocol.align(wrong.masked_fill(~valid, 7.0), truth, valid)
    torch.testing.assert_close(found[valid], truth[valid])
    constant = torch.full_like(truth, 2.0)
    means = {"median": truth.new_zeros(0), "affine_depth": truth, "affine_disparity": 1 / truth}[scale]
    if len(means):  # a constant becomes the mean of what is fitted
        fitted_to = protocol.align(constant, truth, valid)[0].mean()
        fitted_to = 1 / fitted_to if scale == "affine_disparity" else fitted_to
        torch.testing.assert_close(fitted_to, means[0][valid[0]].mean())
    nothing = torch.zeros_like(valid)
    assert protocol.align(constant, truth, nothing).isfinite().all()


def test_corners_are_aligned_where_the_protocol_says_so() -> None:
    values = torch.rand(1, 1, 1, 7).expand(1, 1, 3, 7)
    large = EvalProtocol("any", interpolation="bilinear_corners").resize_to_gt(values, (3, 20))
    expected = np.interp(np.linspace(0, 6, 20), np.arange(7), values[0, 0, 0].numpy())
    np.testing.assert_allclose(large[0, 0, 0], expected, atol=1e-6)
    plain = EvalProtocol("any").resize_to_gt(values, (3, 20))
    assert not np.allclose(plain[0, 0, 0], expected, atol=1e-3)

"""The constant predictor: the mean depth map of the training frames, which any network has to beat."""

import torch
from torch import Tensor, nn

from eldenet.data.base import DepthDataset


class ConstantPredictor(nn.Module):
    """Predicts one depth map for every image."""

    mean_depth: Tensor  # (1, 1, H, W) [m]

    def __init__(self, mean_depth: Tensor) -> None:
        super().__init__()
        self.register_buffer("mean_depth", mean_depth)

    def forward(self, image: Tensor) -> Tensor:
        """``(B, 3, h, w)`` -> ``(B, 1, H, W)`` [m]."""
        return self.mean_depth.expand(len(image), -1, -1, -1)


def fit_constant_predictor(dataset: DepthDataset, *, frames: int = 512) -> ConstantPredictor:
    """Average the known depth, pixel by pixel, of up to ``frames`` training frames spread over the set.

    The data set must not augment.

    Raises:
        ValueError: the depth maps differ in size.
    """
    total, count = torch.zeros((), dtype=torch.float64), torch.zeros((), dtype=torch.long)
    for index in range(0, len(dataset), -(-len(dataset) // frames)):
        sample = dataset[index]
        depth, known = sample["depth"].double(), sample["mask"]
        if total.ndim and total.shape != depth.shape:
            raise ValueError(
                f"the depth of {sample['name']} is {tuple(depth.shape[-2:])}, that of {dataset.names[0]} "
                f"{tuple(total.shape[-2:])} (height, width): a mean depth map needs one size, set "
                "data.input_size"
            )
        total, count = total + depth * known, count + known
    overall = total.sum() / count.sum().clamp(min=1)
    mean = torch.where(count > 0, total / count.clamp(min=1), overall)
    return ConstantPredictor(mean.float()[None])

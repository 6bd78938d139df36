"""A data set made on the spot whose depth can be read off the image: darker is farther."""

import numpy as np

from eldenet.data.base import DepthDataset
from eldenet.types import Frame


class SyntheticDepth(DepthDataset):
    ground_truth = "dense"

    def __init__(self, frames: int = 16, size: tuple[int, int] = (32, 48), **options) -> None:
        options = {"min_depth": 0.1, "max_depth": 10.0} | options
        super().__init__([f"synthetic/{index}" for index in range(frames)], **options)
        self.size = size

    def load_frame(self, index: int) -> Frame:
        generator = np.random.default_rng(index)
        height, width = self.size
        corners = generator.uniform(1, 9, 3)
        rows, cols = np.linspace(0, 1, height)[:, None], np.linspace(0, 1, width)[None]
        depth = corners[0] + (corners[1] - corners[0]) * rows + 0.5 * (corners[2] - corners[0]) * cols
        depth = depth.clip(0.5, 9.5).astype(np.float32)
        gray = (255 * (1 - depth / 10)).astype(np.uint8)
        image = np.stack([gray, gray, gray], axis=-1)
        intrinsics = np.array([[40.0, 0, width / 2], [0, 40.0, height / 2], [0, 0, 1]])
        return Frame(image, depth, intrinsics, self.names[index])

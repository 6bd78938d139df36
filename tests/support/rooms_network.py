"""A trained network, pictures for it and its meters by torch: what the tests of runtimes share."""

import cv2
import numpy as np
import torch

import eldenet
from eldenet.model import DepthNet

SIZE, CAMERA = (32, 64), (72, 144)
ROUNDING, HALF, INT8 = 1e-5, 0.02, 0.05  # relative to torch's fp32: fp32 largest, bf16 and int8 median


def trained() -> DepthNet:
    """A trained network: untrained depth is so steep that rounding changes it much."""
    model = eldenet.load("eldenet_rooms").eval()
    model.info = {"input_size": list(SIZE), "model_name": "eldenet_s", "data": "rooms"}
    return model


def smooth_pictures() -> np.ndarray:
    """Smooth pictures: noise would be no test of a depth network's lower precisions."""
    generator = np.random.default_rng(0)
    coarse = generator.random((3, 4, 8, 3), dtype=np.float32)
    return np.stack([cv2.resize(each, SIZE[::-1]).transpose(2, 0, 1) for each in coarse])


def meters(model: DepthNet, images: np.ndarray) -> np.ndarray:
    """Depth ``(B, 1, H, W)`` [m] by torch, in full precision."""
    with torch.inference_mode():
        return model(torch.from_numpy(images)).numpy()

"""A stereo depth camera's view of true depth: unknown edges, dead columns, noise that grows with distance."""

from typing import NamedTuple

import numpy as np


class StereoArtifacts(NamedTuple):
    """Errors of a stereo depth camera; the defaults are about those of an Intel RealSense D435."""

    baseline: float = 0.05  # between the two cameras [m]; what only the left one sees has no depth
    nearest: float = 0.28  # depth below it is unknown [m]
    # standard deviation of the disparity, relative to the width of the frame: 0.1 px of 848
    noise: float = 0.1 / 848
    mixed: float = 0.3  # share of the pixels at edges whose depth lies between that of front and back
    dead_columns: int = 1  # pixel columns without depth, drawn once per episode

    def draw_dead(self, width: int, rng: np.random.Generator) -> np.ndarray:
        """Draw the numbers ``(dead_columns,)`` of the dead columns of a frame of ``width`` pixels."""
        return rng.choice(width, self.dead_columns, replace=False)

    def apply(
        self, depth: np.ndarray, focal: float, dead: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Return true depth ``(H, W)`` [m] as the camera would measure it; 0 is unknown.

        ``focal`` is fx [px], ``dead`` the columns without depth; ``rng`` draws noise and mixed pixels.
        """
        _, width = depth.shape
        disparity = focal * self.baseline / depth
        unseen = occluded(disparity)
        back = np.maximum(depth, np.roll(depth, 1, axis=1))
        front = np.minimum(depth, np.roll(depth, 1, axis=1))
        edge = (back > 1.1 * front) & (rng.random(depth.shape) < self.mixed)
        edge[:, 0] = False  # its left neighbor is at the other border
        measured = focal * self.baseline / np.where(edge, rng.uniform(front, back), depth)
        measured += rng.normal(0, self.noise * width, depth.shape)
        out = focal * self.baseline / np.maximum(measured, 1e-6)
        out[unseen | (depth < self.nearest)] = 0
        out[:, dead] = 0
        return out.astype(np.float32)


def occluded(disparity: np.ndarray) -> np.ndarray:
    """Pixels ``(H, W)`` of the left camera that the right one does not see.

    Column ``x`` of the left picture is column ``x - disparity`` of the right; ``disparity (H, W)`` [px].
    """
    at = np.arange(disparity.shape[1]) - disparity
    # leftmost of this pixel and those right of it
    ahead = np.minimum.accumulate(at[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(disparity.shape, bool)
    hidden[:, :-1] = ahead[:, 1:] < at[:, :-1]
    return hidden

"""Pictures show what they say."""

import numpy as np
import torch

from eldenet.visualization import GAP, UNKNOWN, WIDEST_PANEL, depth_row, depth_scale


def test_wide_rows_fit_a_screen_and_keep_their_points() -> None:
    height, width = 352, 1216
    generator = np.random.default_rng(0)
    mask = torch.from_numpy(generator.random((1, height, width)) < 0.04)
    depth = torch.where(mask, torch.full(mask.shape, 20.0), torch.zeros(()))
    image = torch.rand(3, 176, 608, generator=torch.Generator().manual_seed(0))
    row = depth_row(image, depth, mask, torch.full(mask.shape, 20.0))
    assert row.shape[1] == 4 * WIDEST_PANEL + 5 * GAP + 2 * depth_scale(0, 1, row.shape[0]).shape[1]
    assert abs(row.shape[0] / WIDEST_PANEL - height / width) < 0.01
    truth = row[:, WIDEST_PANEL + GAP :][:, :WIDEST_PANEL]
    shown = (truth != UNKNOWN).any(-1).mean()
    # 6.4 pixels fall into one: it is known unless all of them are unknown
    assert abs(shown - (1 - 0.96 ** (height * width / row.shape[0] / WIDEST_PANEL))) < 0.03


def test_small_rows_are_enlarged_pixel_by_pixel() -> None:
    mask = torch.ones(1, 60, 80, dtype=torch.bool)
    row = depth_row(torch.rand(3, 60, 80), torch.rand(1, 60, 80) + 1, mask, torch.rand(1, 60, 80) + 1)
    assert row.shape == (180, 4 * 240 + 5 * GAP + 2 * depth_scale(0, 1, 180).shape[1], 3)
    panels = row[:, : 4 * 240 + 3 * GAP]
    assert (panels[:180:3] == panels[1:180:3]).all()

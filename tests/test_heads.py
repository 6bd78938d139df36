"""Heads map a raw map to meters."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eldenet.configurable import build
from eldenet.heads import Head, InverseHead, LinearHead, LogHead, ScaledHead

HEADS = [LinearHead, InverseHead, LogHead]


@pytest.mark.parametrize("head", HEADS)
@given(raw=st.floats(-1e4, 1e4, width=32), near=st.floats(0.01, 2), factor=st.floats(1.5, 800))
@settings(deadline=None, max_examples=60)
def test_any_raw_value_gives_depth_within_the_range(
    head: type[Head], raw: float, near: float, factor: float
) -> None:
    made = head(near, near * factor)
    depth = made(torch.tensor(raw)).item()
    assert made.min_depth * (1 - 1e-6) <= depth <= made.max_depth * (1 + 1e-6)


def test_heads_follow_their_formulas() -> None:
    raw = torch.tensor([-50.0, 0.0, math.log(3), 50.0])  # with sigmoids of 0, 1/2, 3/4 and 1
    torch.testing.assert_close(LinearHead(0.1, 10)(raw), torch.tensor([0.1, 5.05, 7.525, 10.0]))
    torch.testing.assert_close(InverseHead(0.1, 10)(raw), torch.tensor([10.0, 1 / 5.05, 1 / 7.525, 0.1]))
    torch.testing.assert_close(LogHead(0.1, 10)(raw), torch.tensor([0.1, 1.0, 10**0.5, 10.0]))


def test_the_scaled_head_multiplies_and_clamps() -> None:
    head = ScaledHead(0.01, 0.5, 8.0)
    raw = torch.tensor([-5.0, 100.0, 250.0, 900.0])
    torch.testing.assert_close(head(raw), torch.tensor([0.5, 1.0, 2.5, 8.0]))
    assert build(head.config).config == head.config


@pytest.mark.parametrize("limits", [(0, 10), (-1, 10), (5, 5), (5, 1)])
def test_impossible_ranges_are_refused(limits: tuple[float, float]) -> None:
    for head in HEADS:
        with pytest.raises(ValueError, match="0 < min_depth < max_depth"):
            head(*limits)

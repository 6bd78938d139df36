"""From a raw map to metres and back."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from eldenet.heads import Head, InverseHead, LinearHead, LogHead

HEADS = [LinearHead, InverseHead, LogHead]


@pytest.mark.parametrize("head", HEADS)
@given(raw=st.floats(-1e4, 1e4, width=32), near=st.floats(0.01, 2), factor=st.floats(1.5, 800))
@settings(deadline=None, max_examples=60)
def test_any_number_is_within_range(head: type[Head], raw: float, near: float, factor: float) -> None:
    made = head(near, near * factor)
    depth = made(torch.tensor(raw)).item()
    assert made.min_depth * (1 - 1e-6) <= depth <= made.max_depth * (1 + 1e-6)


@pytest.mark.parametrize("head", HEADS)
@given(share=st.floats(0.001, 0.999), near=st.floats(0.01, 2), factor=st.floats(1.5, 800))
@settings(deadline=None, max_examples=60)
def test_heads_invert(head: type[Head], share: float, near: float, factor: float) -> None:
    made = head(near, near * factor)
    depth = torch.tensor(near + share * (near * factor - near), dtype=torch.float64)
    torch.testing.assert_close(made.to_metres(made.from_metres(depth)), depth, rtol=3e-3, atol=0)
    raw = torch.tensor(4 * share - 2, dtype=torch.float64)
    torch.testing.assert_close(made.from_metres(made.to_metres(raw)), raw, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("head", HEADS)
def test_metres_outside_the_range_are_clamped(head: type[Head]) -> None:
    made = head(0.5, 8.0)
    raw = made.from_metres(torch.tensor([-1.0, 0.0, 0.4, 0.5, 8.0, 9.0, torch.inf]))
    assert torch.isfinite(raw).all()
    torch.testing.assert_close(made(raw), torch.tensor([0.5] * 4 + [8.0] * 3), rtol=1e-4, atol=0)


def test_head_formulas() -> None:
    raw = torch.tensor([-50.0, 0.0, 50.0])
    torch.testing.assert_close(LinearHead(0.1, 10)(raw), torch.tensor([0.1, 5.05, 10.0]))
    torch.testing.assert_close(InverseHead(0.1, 10)(raw), torch.tensor([10.0, 1 / 5.05, 0.1]))
    torch.testing.assert_close(LogHead(0.1, 10)(raw), torch.tensor([0.1, 1.0, 10.0]))


@pytest.mark.parametrize("limits", [(0, 10), (-1, 10), (5, 5), (5, 1)])
def test_heads_refuse_impossible_ranges(limits: tuple[float, float]) -> None:
    for head in HEADS:
        with pytest.raises(ValueError, match="0 < min_depth < max_depth"):
            head(*limits)

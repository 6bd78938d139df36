"""Costs: multiply-adds of layers worked out by hand; a report says what it was measured on."""

import time
from dataclasses import asdict

import pytest
import torch
from torch import Tensor, nn

from eldenet.evaluation.cost import CostReport, count_macs, measure_cost
from eldenet.system.timing import Waiting


class Flat(nn.Module):
    """A linear layer over the whole image."""

    def __init__(self, pixels: int) -> None:
        super().__init__()
        self.linear = nn.Linear(3 * pixels, 5)

    def forward(self, image: Tensor) -> Tensor:
        return self.linear(image.flatten(1))


@pytest.mark.parametrize(
    ("layer", "macs"),
    [
        (nn.Conv2d(3, 8, 3, padding=1), 10 * 12 * 8 * 3 * 9),  # the bias does not count
        (nn.Conv2d(3, 8, 3, padding=1, stride=2, bias=False), 5 * 6 * 8 * 3 * 9),
        (
            nn.Conv2d(3, 6, 5, padding=2, groups=3),
            10 * 12 * 6 * 25,
        ),  # depthwise: one input channel per output
        (nn.Conv2d(3, 8, 1), 10 * 12 * 8 * 3),
        (nn.ConvTranspose2d(3, 8, 2, stride=2), 10 * 12 * 8 * 3 * 4),
        (Flat(120), 5 * 360),
        (nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4), nn.ReLU()), 10 * 12 * 4 * 3),
    ],
)
def test_macs_by_hand(layer: nn.Module, macs: int) -> None:
    assert count_macs(layer, (10, 12)) == macs


def test_counting_leaves_the_model_as_it_was() -> None:
    model = nn.Sequential(nn.Conv2d(3, 4, 1), nn.BatchNorm2d(4)).train()
    before = {name: value.clone() for name, value in model.state_dict().items()}
    count_macs(model, (8, 8))
    measure_cost(model, (8, 8), batch=2, seconds=0.0)
    assert model.training
    for name, value in model.state_dict().items():
        assert torch.equal(value, before[name]), name
    assert count_macs(model.eval(), (8, 8)) > 0
    assert not model.training


def test_report_says_what_it_was_measured_on() -> None:
    model = nn.Sequential(nn.Conv2d(3, 4, 3, padding=1), nn.BatchNorm2d(4))
    report = measure_cost(model, (16, 24), batch=3, seconds=0.0)
    assert (report.device, report.runtime, report.precision) == ("cpu", "torch", "fp32")
    assert report.threads == torch.get_num_threads()
    assert (report.height, report.width, report.batch) == (16, 24, 3)
    assert report.params == 3 * 4 * 9 + 4 + 2 * 4
    assert report.gmacs == 16 * 24 * 4 * 27 / 1e9
    assert report.gflops == 2 * report.gmacs
    assert 0 < report.latency_ms_p50 <= report.latency_ms_p95
    assert report.throughput_img_s > 0
    assert report.peak_memory_mb > 10
    assert CostReport(**asdict(report)) == report


def test_time_without_work_is_waiting() -> None:
    with Waiting() as waiting:
        time.sleep(0.05)
    assert waiting.ratio > 3

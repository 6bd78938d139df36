"""experiments/table5_success/fit_range_errors.py: what it fits is what sensor=noisy draws."""

import sys

import numpy as np
import pytest
from support.scripts import load_scripts

from eldenet.navigation.noisy_ranges import NoisyRanges
from eldenet.navigation.policy import Navigator
from eldenet.navigation.range_errors import RangeErrors
from eldenet.navigation.tasks import frozen_arenas

(fit,) = load_scripts("table5_success", "fit_range_errors")


@pytest.fixture(scope="module")
def put_in() -> RangeErrors:
    return RangeErrors(
        fit.EDGES,
        bias=(0.1, 0.05, 0.0, 0.0, -0.05, -0.1),
        spread=(0.08, 0.08, 0.1, 0.12, 0.15, 0.18),
        miss=(0.0, 0.0, 0.2, 0.3, 0.3, 0.3),
        scale=0.5, smooth=0.7, column=0.65, memory=0.7, far=(-0.2, 0.1),
    )  # fmt: skip


@pytest.fixture(scope="module")
def drawn(put_in) -> fit.Scans:
    arenas = [arena for density in (20, 60) for arena in frozen_arenas(density, 8, split="val")]
    return fit.scan_along(arenas, NoisyRanges(errors=put_in), Navigator.load())


@pytest.fixture(scope="module")
def measured(drawn) -> RangeErrors:
    return fit.fit_errors(drawn, note="a test")


@pytest.mark.slow
def test_fitted_errors_are_the_drawn_ones(put_in, measured):
    assert measured.bias[1:5] == pytest.approx(np.interp(measured.middles[1:5], put_in.middles, put_in.bias),
                                               abs=0.04)  # fmt: skip
    assert measured.spread[1:5] == pytest.approx(put_in.spread[1:5], rel=0.25)
    assert measured.scale == pytest.approx(put_in.scale, abs=0.15)
    assert measured.smooth == pytest.approx(put_in.smooth, abs=0.15)
    assert measured.column == pytest.approx(put_in.column, abs=0.15)
    assert measured.memory == pytest.approx(put_in.memory, abs=0.25)
    assert measured.far == pytest.approx(put_in.far, abs=0.04)
    # near the wall or another obstacle a miss is less than 1.5 times as far: fewer count
    assert measured.miss[0] == 0
    assert 0.02 < measured.miss[2] < 0.25
    assert measured.measured["note"] == "a test"
    missed = [row["missed"] for row in measured.sectors]
    assert missed[0] == 0
    assert missed[3] > 0.03
    assert sum(row["count"] for row in measured.sectors) > 1000


def test_scans_near_obstacles_are_near(put_in, drawn):
    arenas = list(frozen_arenas(80, 3, split="val"))
    scans = fit.scan_near(arenas, NoisyRanges(errors=put_in), scans=20)
    assert scans.ranges.shape == scans.true.shape == (60, 40)
    assert len(np.unique(scans.episode)) == 60
    close, along = scans.true < 0.8, drawn.true < 0.8
    assert close.mean() > 0.05 > 0.02 > along.mean()
    again = fit.scan_near(arenas, NoisyRanges(errors=put_in), scans=20)
    np.testing.assert_array_equal(again.ranges, scans.ranges)
    with pytest.raises(ValueError, match="scans=0"):
        fit.scan_near(arenas, NoisyRanges(errors=put_in), scans=0)


def test_exact_ranges_have_no_errors():
    true = np.clip(np.random.default_rng(0).uniform(0.5, 10, (200, 5)).repeat(8, axis=1), 0.3, 9.5)
    errors = fit.fit_errors(fit.Scans(true, true, np.zeros(200, int)))
    assert errors.bias == errors.spread == errors.miss == (0.0,) * 6
    with pytest.raises(ValueError, match="scan in more arenas"):
        fit.fit_errors(fit.Scans(true[:3], true[:3], np.zeros(3, int)))


def test_the_script_writes_errors_that_noisy_reads(tmp_path, monkeypatch, capsys):
    words = ["sensor.checkpoint=null", "sensor.size=[60,80]", "density=40", "episodes=2", "time_limit=6"]
    monkeypatch.setattr(sys, "argv", ["fit", *words, f"output={tmp_path}"])
    fit.main()
    errors = NoisyRanges(errors=str(tmp_path / "range_errors.json")).errors
    assert errors.measured["split"] == "val"
    assert errors.measured["sensor"]["size"] == [60, 80]
    assert abs(errors.bias[2]) < 0.05  # true depth from the renderer
    assert max(errors.miss[:4]) < 0.02
    assert "bias" in capsys.readouterr().out

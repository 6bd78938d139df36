"""The statistics behind the tables of studies: intervals, fronts, speed and fluctuation of curves."""

import numpy as np
import pytest
import scipy.stats

from eldenet.studies import convergence, statistics
from eldenet.studies.plots import _label_places, pareto_front


def test_the_interval_is_that_of_scipys_bootstrap():
    generator = np.random.default_rng(3)
    theirs = {str(i): value for i, value in enumerate(generator.uniform(0.3, 0.9, 130))}
    ours = {name: value + 0.03 + 0.1 * generator.normal() for name, value in theirs.items()}
    mean, low, high = statistics.paired_interval(ours, theirs)
    difference = np.array([ours[name] - theirs[name] for name in ours])
    expected = scipy.stats.bootstrap(
        (difference,), np.mean, n_resamples=20_000, method="percentile", random_state=1
    ).confidence_interval
    assert mean == pytest.approx(difference.mean(), abs=1e-12)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1.5e-3)
    assert statistics.paired_interval(ours, theirs) == (mean, low, high)  # the same every time
    with pytest.raises(ValueError, match="different images"):
        statistics.paired_interval(ours, {"x": 1.0})


def test_the_front_holds_what_nothing_beats():
    points = [(5.0, 0.5), (1.0, 0.3), (2.0, 0.6), (4.0, 0.6), (2.0, 0.4), (9.0, 0.7)]
    assert pareto_front(points) == [1, 2, 5]


def test_speed_and_fluctuation_of_known_curves():
    epochs = list(range(1, 11))
    falling = [10.0 - epoch for epoch in epochs]  # 9 ... 0
    assert convergence.own_descent(epochs, falling) == 10.0  # 0.9 is first reached at 0
    assert convergence.own_descent(epochs, [9, 1, 0.5, 0, 0, 0, 0, 0, 0, 0]) == 3
    assert convergence.first_epoch(epochs, falling, 4.5) == 6
    assert convergence.first_epoch(epochs, falling, -1.0) is None
    assert convergence.fluctuation([1.0] * 10) == 0.0
    assert convergence.fluctuation(falling) == pytest.approx(0.0, abs=1e-12)  # a descent is none
    # places 5 to 7 of ten have a whole window; a zigzag of 2 and 1 lies 0.4 off its means 1.6 and 1.4 there
    assert convergence.fluctuation([9, 9, 9, 2, 1, 2, 1, 2, 1, 2]) == pytest.approx(0.4 / (5 / 3))
    assert convergence.fluctuation([1.0, 2.0]) is None
    run = {"config": {"loss": {"terms": {"ssim": {"weight": 1.0}, "l1": {"weight": 0.5}}}}}
    assert convergence.validation_loss(run, {"val_ssim": 0.8, "val_mae": 0.4}) == pytest.approx(0.3)
    run["config"]["loss"]["terms"]["berhu"] = {"weight": 1.0}
    assert convergence.validation_loss(run, {"val_ssim": 0.8, "val_mae": 0.4}) is None


def test_names_in_the_plot_keep_clear_of_each_other():
    """Two points nearly in one place: the upper name goes above, the lower below; far ones stay above."""
    rows = [("upper", 4.3, 0.705), ("lower", 4.6, 0.700), ("alone", 1.0, 0.5), ("level", 20.0, 0.702)]
    below = {name: low for name, _, _, low in _label_places(rows)}
    assert below == {"upper": False, "lower": True, "alone": False, "level": False}

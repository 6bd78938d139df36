"""Bootstrap intervals: the short way for means gives what the general one gives."""

import numpy as np
import pytest

from eldenet.evaluation.bootstrap import bootstrap_interval, mean_interval


@pytest.mark.parametrize("scenes", [None, 1, 7, 60])
def test_the_interval_of_a_mean_is_the_general_one(scenes: int | None) -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(0.7, 0.1, 60)
    groups = None if scenes is None else rng.integers(0, scenes, 60) * 3  # of unequal size, numbers left out
    general = bootstrap_interval(lambda drawn: float(values[drawn].mean()), 60 if scenes is None else groups)
    np.testing.assert_allclose(mean_interval(values, groups), general, rtol=1e-12)


def test_nothing_has_no_interval() -> None:
    assert np.isnan(mean_interval(np.zeros(0))).all()
    assert np.isnan(bootstrap_interval(lambda drawn: 1.0, 0)).all()


def test_a_missing_value_does_not_narrow_the_interval_of_a_mean() -> None:
    values = np.array([0.3, np.nan, 0.5, 0.9])
    with pytest.raises(ValueError, match="1 of 4 values are NaN or infinite: leave them out"):
        mean_interval(values)


def test_groups_that_are_alike_within_make_it_wider() -> None:
    groups = np.repeat(np.arange(20), 50)
    values = np.random.default_rng(0).normal(size=20)[groups]
    (low, high), (narrow, wide) = mean_interval(values, groups), mean_interval(values)
    assert high - low > 3 * (wide - narrow)

"""The statistics behind the tables of studies: intervals, fronts, speed and fluctuation of curves."""

import numpy as np
import pytest
import scipy.stats

from eldenet import config as cfg
from eldenet.results import statistics
from eldenet.results.plots import name_points, pareto_front
from eldenet.results.studies import convergence


def scores(values: np.ndarray, **changes: tuple[str, ...]) -> statistics.Scores:
    return statistics.Scores(changes.get("images", tuple(map(str, range(values.shape[1])))), values)


def test_the_interval_is_that_of_scipys_bootstrap():
    generator = np.random.default_rng(3)
    theirs = generator.uniform(0.3, 0.9, (1, 130))
    ours = theirs + 0.03 + 0.1 * generator.normal(size=(1, 130))
    mean, low, high = statistics.paired_interval(scores(ours), scores(theirs), draw_seeds=False)
    expected = scipy.stats.bootstrap(
        (ours[0] - theirs[0],), np.mean, n_resamples=20_000, method="percentile", random_state=1
    ).confidence_interval
    assert mean == pytest.approx((ours - theirs).mean(), abs=1e-12)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1.5e-3)
    again = statistics.paired_interval(scores(ours), scores(theirs), draw_seeds=False)
    assert again == (mean, low, high)  # the same every time
    with pytest.raises(ValueError, match="different images"):
        statistics.paired_interval(
            scores(ours), scores(theirs, images=tuple(map(str, range(1, 131)))), draw_seeds=False
        )


def test_the_interval_over_seeds_and_images_is_that_of_plain_draws():
    """Beside a loop that draws runs and images by their places, one after the other."""
    generator = np.random.default_rng(5)
    hard = generator.uniform(0.3, 0.9, 60)
    theirs = hard + generator.normal(0, 0.02, (3, 1)) + generator.normal(0, 0.05, (3, 60))
    ours = hard + 0.03 + generator.normal(0, 0.03, (4, 1)) + generator.normal(0, 0.05, (4, 60))
    draws = []
    for _ in range(20_000):
        images = generator.choice(60, 60)
        one, two = generator.choice(4, 4), generator.choice(3, 3)
        draws.append(ours[one][:, images].mean() - theirs[two][:, images].mean())
    mean, low, high = statistics.paired_interval(scores(ours), scores(theirs), draw_seeds=True)
    assert mean == pytest.approx(ours.mean() - theirs.mean(), abs=1e-12)
    assert (low, high) == pytest.approx(tuple(np.quantile(draws, (0.025, 0.975))), abs=1.5e-3)
    assert statistics.paired_interval(scores(ours), scores(theirs), draw_seeds=True) == (mean, low, high)
    _, low_of_images, high_of_images = statistics.paired_interval(
        scores(ours), scores(theirs), draw_seeds=False
    )
    assert low < low_of_images < mean < high_of_images < high


def test_an_image_without_a_score_is_left_out_of_both():
    ours, theirs = np.full((3, 4), 0.6), np.full((3, 4), 0.5)
    ours[1, 2] = np.nan
    theirs[:, 2] = 9.0
    for draw_seeds in (True, False):
        found = statistics.paired_interval(scores(ours), scores(theirs), draw_seeds=draw_seeds)
        assert found == pytest.approx((0.1, 0.1, 0.1))
    unknown = statistics.Difference(np.nan, np.nan, np.nan, seeds=True, lower_is_better=False)
    assert unknown.verdict == ""


def test_the_front_holds_what_nothing_beats():
    points = [(5.0, 0.5), (1.0, 0.3), (2.0, 0.6), (4.0, 0.6), (2.0, 0.4), (9.0, 0.7)]
    assert pareto_front(points) == [1, 2, 5]
    errors = [(cost, 1 - accuracy) for cost, accuracy in points]  # compare: rmse
    assert pareto_front(errors, lower_is_better=True) == [1, 2, 5]


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


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["loss.terms.l1.weight=0.5"], 0.3),
        (["loss=l1"], 0.4),
        (["loss=berhu"], None),
        (["loss.terms.l1.space=log"], None),
        (["loss.terms.l1.loss._target_=eldenet.losses.pointwise.BerHuLoss"], None),
    ],
)
def test_the_validation_loss_is_the_trainings_or_none(overrides, expected):
    config = cfg.compose("train", ["model_name=a", "run_dir=b", *overrides])
    run = {"config": {"loss": cfg.plain(config.loss)}}
    assert convergence.validation_loss(run, {"val_ssim": 0.8, "val_mae": 0.4}) == pytest.approx(expected)


def test_names_in_the_plot_keep_clear_of_each_other_and_within_the_axes():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    points = {"upper": [(4.3, 0.705)], "lower": [(4.6, 0.700)], "alone": [(1.0, 0.5)]}
    points |= {"a_long_name_far_right": [(20.0, 0.702)], "of_two_runtimes": [(2.0, 0.6), (3.0, 0.6)]}
    figure, axes = pyplot.subplots(figsize=(5, 4))
    for own in points.values():
        axes.plot(*zip(*own, strict=True), "o")
    axes.set_xscale("log")
    name_points(axes, points)
    boxes = {note.get_text(): note.get_window_extent() for note in axes.texts}
    assert set(boxes) == set(points)
    for name, box in boxes.items():
        assert not any(box.overlaps(other) for there, other in boxes.items() if there != name)
        assert box.x1 <= axes.get_window_extent().x1
    pyplot.close(figure)

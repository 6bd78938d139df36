"""Intervals of differences, Pareto fronts, and names in plots."""

import numpy as np
import pytest
import scipy.stats

from eldenet.evaluation.bootstrap import scenes_of
from eldenet.results import paired_intervals
from eldenet.results.plots import name_points, pareto_front


def scores(values: np.ndarray, **changes: tuple[str, ...]) -> paired_intervals.Scores:
    return paired_intervals.Scores(changes.get("images", tuple(map(str, range(values.shape[1])))), values)


def test_the_interval_is_that_of_scipys_bootstrap():
    generator = np.random.default_rng(3)
    theirs = generator.uniform(0.3, 0.9, (1, 130))
    ours = theirs + 0.03 + 0.1 * generator.normal(size=(1, 130))
    mean, low, high = paired_intervals.paired_interval(scores(ours), scores(theirs), draw_seeds=False)
    expected = scipy.stats.bootstrap(
        (ours[0] - theirs[0],), np.mean, n_resamples=20_000, method="percentile", random_state=1
    ).confidence_interval
    assert mean == pytest.approx((ours - theirs).mean(), abs=1e-12)
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1.5e-3)
    again = paired_intervals.paired_interval(scores(ours), scores(theirs), draw_seeds=False)
    assert again == (mean, low, high)  # the same every time
    with pytest.raises(ValueError, match="different images"):
        paired_intervals.paired_interval(
            scores(ours), scores(theirs, images=tuple(map(str, range(1, 131)))), draw_seeds=False
        )


def test_the_interval_over_seeds_and_images_is_that_of_plain_draws():
    """Compared with a loop that draws runs and images by index."""
    generator = np.random.default_rng(5)
    hard = generator.uniform(0.3, 0.9, 60)
    theirs = hard + generator.normal(0, 0.02, (3, 1)) + generator.normal(0, 0.05, (3, 60))
    ours = hard + 0.03 + generator.normal(0, 0.03, (4, 1)) + generator.normal(0, 0.05, (4, 60))
    draws = []
    for _ in range(20_000):
        images = generator.choice(60, 60)
        one, two = generator.choice(4, 4), generator.choice(3, 3)
        draws.append(ours[one][:, images].mean() - theirs[two][:, images].mean())
    mean, low, high = paired_intervals.paired_interval(scores(ours), scores(theirs), draw_seeds=True)
    assert mean == pytest.approx(ours.mean() - theirs.mean(), abs=1e-12)
    assert (low, high) == pytest.approx(tuple(np.quantile(draws, (0.025, 0.975))), abs=1.5e-3)
    assert paired_intervals.paired_interval(scores(ours), scores(theirs), draw_seeds=True) == (
        mean,
        low,
        high,
    )
    _, low_of_images, high_of_images = paired_intervals.paired_interval(
        scores(ours), scores(theirs), draw_seeds=False
    )
    assert low < low_of_images < mean < high_of_images < high


def test_frames_of_a_scene_are_drawn_together():
    """Compared with a loop that draws scenes, and wider than drawn frames where a scene's frames agree."""
    generator = np.random.default_rng(7)
    scene = np.repeat(np.arange(12), generator.integers(2, 9, 12))
    names = tuple(f"scene_{number:04d}/{index:05d}" for index, number in enumerate(scene))
    theirs = np.full((3, len(scene)), 0.5) + generator.normal(0, 0.01, (3, len(scene)))
    ours = theirs + 0.03 + generator.normal(0, 0.05, 12)[scene]
    for draw_seeds in (False, True):
        draws = []
        for _ in range(20_000):
            images = np.concatenate([np.flatnonzero(scene == one) for one in generator.choice(12, 12)])
            one, two = (generator.choice(3, 3) if draw_seeds else np.arange(3) for _ in range(2))
            draws.append(ours[one][:, images].mean() - theirs[two][:, images].mean())
        _, low, high = paired_intervals.paired_interval(
            scores(ours, images=names), scores(theirs, images=names), draw_seeds=draw_seeds
        )
        assert (low, high) == pytest.approx(tuple(np.quantile(draws, (0.025, 0.975))), abs=1.5e-3)
        _, *alone = paired_intervals.paired_interval(scores(ours), scores(theirs), draw_seeds=draw_seeds)
        assert high - low > 1.5 * (alone[1] - alone[0])


@pytest.mark.parametrize(
    ("names", "groups"),
    [
        (["labeled_out/0022", "labeled_out/0027", "labeled_out/0080", "labeled_out/0001"], [1, 1, 2, 0]),
        (["rooms/test/000000/0", "rooms/test/000000/1", "rooms/test/000001/0"], [0, 0, 1]),
        (
            [f"2011_09_26_drive_{n}_sync/image_0{c}/01" for n in ("0002", "0009") for c in (2, 3)],
            [0, 0, 1, 1],
        ),
        (["kitchen_0001a/1", "kitchen_0001b/1", "office_0001/1"], [0, 0, 1]),
        (
            [
                "2011_09_26_drive_0002_sync/image_02/data/01",
                "2011_09_26_drive_0002_sync/image_03/data/01",
                "a/1",
            ],
            [0, 0, 1],
        ),
        (["hall/rgb/000", "hall/rgb/001", "kitchen/rgb/000"], [0, 0, 1]),
        (["1", "2", "3"], [0, 1, 2]),
        ([], []),
    ],
)
def test_a_frame_is_of_the_scene_that_its_name_says(names, groups):
    assert scenes_of(names).tolist() == groups


def test_an_image_without_a_score_in_one_row_is_left_out_of_both():
    ours, theirs = np.full((3, 4), 0.6), np.full((3, 4), 0.5)
    ours[1, 2] = np.nan
    theirs[:, 2] = 9.0
    for draw_seeds in (True, False):
        found = paired_intervals.paired_interval(scores(ours), scores(theirs), draw_seeds=draw_seeds)
        assert found == pytest.approx((0.1, 0.1, 0.1))
    unknown = paired_intervals.Difference(np.nan, np.nan, np.nan, seeds=True, lower_is_better=False)
    assert unknown.verdict == ""


def test_the_front_holds_the_points_that_no_other_beats():
    points = [(5.0, 0.5), (1.0, 0.3), (2.0, 0.6), (4.0, 0.6), (2.0, 0.4), (9.0, 0.7)]
    assert pareto_front(points) == [1, 2, 5]
    errors = [(cost, 1 - accuracy) for cost, accuracy in points]  # compare: rmse
    assert pareto_front(errors, lower_is_better=True) == [1, 2, 5]


def test_names_in_a_plot_do_not_overlap_and_stay_within_the_axes():
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

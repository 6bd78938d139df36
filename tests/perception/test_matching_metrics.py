"""Metrics of box pairs by hand, and their intervals over frames."""

import numpy as np
import pytest

from eldenet.boxes import Boxes3D
from eldenet.perception.matching_metrics import Pairs, bootstrap, by_distance, compare, pair_up, summary


def boxes_at(z: list[float], yaw: float = 0.0) -> Boxes3D:
    count = len(z)
    center, size = np.array([[0.0, 0.0, depth] for depth in z]), np.tile([4.0, 2.0, 1.5], (count, 1))
    return Boxes3D(center, size, np.full(count, yaw), np.ones(count), np.zeros(count, int), ("car",))


def test_pairs_are_one_to_one_and_the_largest_overlap_wins():
    truth = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [50, 50, 60, 60.0]])
    found = np.array([[1, 0, 11, 10], [0, 0, 10, 9.0]])
    rows, columns = pair_up(truth, found)
    assert sorted(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 1), (1, 0)]
    assert len(pair_up(truth, np.zeros((0, 4)))[0]) == 0


def test_metrics_by_hand():
    truth, found = boxes_at([10.0, 20.0, 50.0]), boxes_at([11.0, 20.0], yaw=np.pi)
    pairs = compare(truth, found, np.array([0, 1]), np.array([0, 1]))
    np.testing.assert_allclose(pairs.accuracy, [0.9, 1.0])
    np.testing.assert_allclose(pairs.bev, [1 / 3, 1.0])  # widths of 2 m lie along z: 1 m shared of 3
    figures = summary(pairs)
    assert figures["accuracy"] == pytest.approx(0.95)
    assert (figures["bev>0.25"], figures["bev>0.5"]) == (1.0, 0.5)
    assert figures["recall bev>0.5"] == pytest.approx(1 / 3)
    assert (figures["within 0.5 m"], figures["within 1 m"]) == (0.5, 1.0)
    assert figures["median_yaw"] == pytest.approx(0)
    bins = by_distance(pairs)
    assert [part["pairs"] for _, _, part in bins] == [0, 1, 1, 0]
    assert [part.get("bev>0.5") for _, _, part in bins] == [None, 0.0, 1.0, None]
    assert not any("recall" in key or key == "truths" for _, _, part in bins for key in part)
    assert summary(Pairs.join([pairs.select(np.zeros(2, bool))]))["pairs"] == 0


def test_no_frames_have_no_pairs():
    assert summary(Pairs.join([])) == {"pairs": 0.0, "truths": 0.0}


def test_the_interval_resamples_whole_frames():
    rng = np.random.default_rng(0)
    frames = np.repeat(np.arange(50), 8)
    shared = rng.normal(0, 1, 50)[frames]  # all objects of a frame share its error
    low, high = bootstrap(shared, frames)
    naive = bootstrap(shared, np.arange(400))
    assert high - low > 2 * (naive[1] - naive[0])
    assert low < shared.mean() < high
    assert all(np.isnan(bootstrap(np.zeros(0), np.zeros(0))))

"""What KITTI's average precision counts, forgives and ignores."""

import numpy as np
import pytest

from eldenet.perception.kitti_ap import average_precision, kitti_table
from eldenet.perception.kitti_object import KittiLabels


def changed(given: KittiLabels, **arrays) -> KittiLabels:
    return KittiLabels(**{**vars(given), **arrays})


def joined(*parts: KittiLabels) -> KittiLabels:
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0])}
    return KittiLabels(**{**arrays, "types": tuple(arrays["types"])})


def labels(
    count: int, kind: str = "Car", *, score=None, top: float = 60, shift: float = 0.0, **more
) -> KittiLabels:
    """Objects beside each other, ``top`` pixels high, 10 m apart."""
    left = 100.0 * np.arange(count)
    xyxy = np.stack([left, np.full(count, 100.0), left + 50, np.full(count, 100.0 + top)], 1)
    location = np.stack([10.0 * np.arange(count) + shift, np.full(count, 1.6), np.full(count, 20.0)], 1)
    values = {
        "truncated": np.zeros(count), "occluded": np.zeros(count, int), "alpha": np.zeros(count),
        "xyxy": xyxy,
        "size": np.tile([4.0, 1.6, 1.5], (count, 1)), "location": location, "yaw": np.zeros(count),
        "score": np.ones(count) if score is None else np.asarray(score, float),
    }  # fmt: skip
    return KittiLabels((kind,) * count, **(values | more))


def ap(truth: KittiLabels, found: KittiLabels, **options) -> float:
    return average_precision([truth], [found], **options)["R40"]


@pytest.mark.parametrize("metric", ["2d", "bev", "3d"])
def test_all_found_is_all_and_nothing_found_is_nothing(metric):
    truth = labels(60)
    found = labels(60, score=np.linspace(0.1, 0.9, 60))
    assert average_precision([truth], [found], metric=metric) == {"R40": 100, "R11": 100}
    assert ap(truth, labels(0), metric=metric) == 0
    assert np.isnan(ap(labels(0), found, metric=metric))


def test_half_found_by_hand():
    """40 of 80 objects found, nothing wrong: precision 1 up to recall 1/2, so 19 or 20 of 40 points."""
    truth = labels(80)
    found = labels(80, score=np.linspace(0.9, 0.1, 80)).select(np.arange(80) < 40)
    value = ap(truth, found, metric="3d")
    assert value == pytest.approx(100 * 20 / 40, abs=2.6)


def test_few_objects_leave_points_at_nothing():
    """A trap of the protocol: 4 finds of 4 objects fill 4 thresholds, of which R40 drops the first."""
    value = ap(labels(4), labels(4, score=[0.9, 0.8, 0.7, 0.6]), metric="3d")
    assert value == pytest.approx(100 * 3 / 40)


def test_wrong_detections_cost_precision():
    truth = labels(50)
    wrong = labels(50, score=np.full(50, 0.9), shift=1000.0)
    both = joined(labels(50, score=np.full(50, 0.5)), changed(wrong, xyxy=wrong.xyxy + 9000))
    for metric in ("2d", "3d"):
        assert ap(truth, both, metric=metric) == pytest.approx(50, abs=0.01)


def test_boxes_off_by_a_meter_fit_the_loose_overlap_alone():
    truth, found = labels(60), labels(60, score=np.linspace(0.1, 0.9, 60), shift=1.0)  # BEV IoU 3 / 5
    assert ap(truth, found, metric="bev") == 0
    assert ap(truth, found, metric="bev", min_overlap=0.5) == 100


@pytest.mark.parametrize(
    ("change", "easy", "moderate", "hard"),
    [
        ({}, True, True, True),
        ({"top": 40.0}, False, True, True),  # the height must be more than the least
        ({"top": 25.0}, False, False, False),
        ({"occluded": np.full(50, 1)}, False, True, True),
        ({"occluded": np.full(50, 2)}, False, False, True),
        ({"occluded": np.full(50, 3)}, False, False, False),
        ({"truncated": np.full(50, 0.2)}, False, True, True),
        ({"truncated": np.full(50, 0.45)}, False, False, True),
        ({"truncated": np.full(50, 0.6)}, False, False, False),
    ],
)
def test_difficulties(change, easy, moderate, hard):
    truth = labels(50, **change)
    found = labels(50, score=np.linspace(0.1, 0.9, 50), top=change.get("top", 60))
    for name, counts in (("easy", easy), ("moderate", moderate), ("hard", hard)):
        assert np.isnan(ap(truth, found, difficulty=name)) != counts


def test_vans_are_no_cars_but_no_mistakes_either():
    vans = labels(50, "Van")
    vans = changed(vans, xyxy=vans.xyxy + 7000, location=vans.location + np.array([0, 0, 40.0]))
    truth = joined(labels(50), vans)
    found = changed(truth, types=("Car",) * 100, score=np.linspace(0.9, 0.1, 100))
    for metric in ("2d", "bev", "3d"):
        assert ap(truth, found, metric=metric) == 100


def test_dont_care_areas_forgive_in_2d_alone():
    area = changed(labels(1, "DontCare"), xyxy=np.array([[0, 300.0, 9000, 900]]))
    truth = joined(labels(50), area)
    extra = labels(50, score=np.full(50, 0.95), shift=5000.0)
    extra = changed(extra, xyxy=extra.xyxy + np.array([0, 400.0, 0, 400]))
    found = joined(labels(50, score=np.full(50, 0.5)), extra)
    assert ap(truth, found, metric="2d") == 100
    assert ap(truth, found, metric="3d") == pytest.approx(50, abs=0.01)


def test_small_detections_are_ignored():
    small = labels(50, score=np.full(50, 0.9), top=24.0, shift=500.0)
    found = joined(labels(50, score=np.full(50, 0.5)), small)
    assert ap(labels(50), found, metric="3d") == 100


def test_the_table_has_every_row_and_words_are_checked():
    rows = kitti_table([labels(50)], [labels(50, score=np.linspace(0, 1, 50))])
    assert len(rows) == 3 * 3 * 3
    with pytest.raises(ValueError, match="difficulty"):
        ap(labels(1), labels(1), difficulty="medium")
    with pytest.raises(ValueError, match="frames"):
        average_precision([labels(1)], [])
    with pytest.raises(ValueError, match="min_overlap"):
        ap(labels(1), labels(1), kind="Tram")

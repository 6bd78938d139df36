"""KITTI's average precision against results by hand, and against a slow, literal implementation."""

import numpy as np
import pytest
from shapely.geometry import Polygon

from eldenet.perception.kitti_ap import (
    DIFFICULTIES,
    LOOSE,
    METRICS,
    STRICT,
    average_precision,
    precision_rows,
)
from eldenet.perception.kitti_object import KittiLabels, write_labels

# --- by hand ---


def frame(*rows) -> KittiLabels:
    types, truncated, occluded, xyxy, location, score = zip(*rows, strict=True) if rows else ((),) * 6
    count = len(rows)
    return KittiLabels(
        types, np.array(truncated, float), np.array(occluded, int), np.zeros(count),
        np.array(xyxy, float).reshape(-1, 4), np.tile([4.0, 1.6, 1.5], (count, 1)),
        np.array(location, float).reshape(-1, 3), np.zeros(count), np.array(score, float),
    )  # fmt: skip


def cars(count: int, scores=(1.0, 1.0)) -> list:
    """Cars in the places 0, 1, 2 ..., which do not overlap, with scores from the first to the last."""
    return [
        ("Car", 0.0, 0, [100 * place, 100, 100 * place + 50, 160], [10 * place, 1.6, 20], score)
        for place, score in enumerate(np.linspace(*scores, count))
    ]


def ap(truth: list, found: list, **options) -> dict[str, float]:
    return average_precision([frame(*truth)], [frame(*found)], **options)


@pytest.mark.parametrize("metric", METRICS)
def test_ap_is_100_if_all_are_found_0_if_none_and_nan_without_objects(metric):
    found = cars(60, (0.1, 0.9))
    assert ap(cars(60), found, metric=metric) == {"R40": 100, "R11": 100}
    assert ap(cars(60), [], metric=metric)["R40"] == 0
    assert np.isnan(ap([], found, metric=metric)["R40"])


def test_result_files_are_scored_by_the_labels_beside_the_pictures(tmp_path):
    """Half of eighty cars; a picture without labels does not count."""
    write_labels(tmp_path / "label_2/000000.txt", frame(*cars(80)))
    write_labels(tmp_path / "found.txt", frame(*cars(40, (0.9, 0.51))))
    pictures = (tmp_path / "image_2/000000.png", tmp_path / "image_2/000001.png", tmp_path / "000000.png")
    rows = precision_rows(dict.fromkeys(pictures, tmp_path / "found.txt"))
    assert rows[2] == ["Car, 3d over 0.7", "50.0", "50.0", "50.0"]
    assert rows[-1] == ["Cyclist, 3d over 0.5", "-", "-", "-"]
    assert precision_rows(dict.fromkeys(pictures[1:], tmp_path / "found.txt")) == []


@pytest.mark.parametrize(("found", "cell"), [(3, "5.0 of 5.0"), (2, "2.5 of 5.0"), (0, "0.0 of 5.0")])
def test_the_most_that_few_objects_allow_is_said(tmp_path, found, cell):
    """Three cars have three thresholds, at the points 0 to 2 of 40."""
    write_labels(tmp_path / "label_2/000000.txt", frame(*cars(3)))
    write_labels(tmp_path / "found.txt", frame(*cars(found, (0.9, 0.5))))
    rows = precision_rows({tmp_path / "image_2/000000.png": tmp_path / "found.txt"})
    assert rows[0] == ["Car, 2d over 0.7", cell, cell, cell]
    assert rows[2] == ["Car, 3d over 0.7", cell, cell, cell]


def test_half_of_eighty_objects_found_give_an_r40_of_50():
    """Thresholds at the finds 1, 2, 4, 6 ... 40 of 80: precision is 1 at the points 0 to 20."""
    assert ap(cars(80), cars(40, (0.9, 0.51))) == pytest.approx({"R40": 50, "R11": 100 * 6 / 11})


# --- a literal implementation, rule by rule ---


def overlap_2d(a, b, of_first=False) -> float:
    wide, tall = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    if wide <= 0 or tall <= 0:
        return 0.0
    area = [(box[2] - box[0]) * (box[3] - box[1]) for box in (a, b)]
    return wide * tall / (area[0] if of_first else area[0] + area[1] - wide * tall)


def footprint(labels: KittiLabels, i: int) -> Polygon:
    length, width, _ = labels.size[i]
    c, s = np.cos(labels.yaw[i]), np.sin(labels.yaw[i])
    corners = [(a * length / 2, b * width / 2) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    x, _, z = labels.location[i]
    return Polygon([(x + u * c + v * s, z - u * s + v * c) for u, v in corners])


def overlap(truth: KittiLabels, i: int, found: KittiLabels, j: int, metric: str) -> float:
    if metric == "2d":
        return overlap_2d(truth.xyxy[i], found.xyxy[j])
    first, second = footprint(truth, i), footprint(found, j)
    shared = first.intersection(second).area
    if metric == "bev":
        return shared / (first.area + second.area - shared)
    bottom = min(truth.location[i, 1], found.location[j, 1])
    top = max(truth.location[i, 1] - truth.size[i, 2], found.location[j, 1] - found.size[j, 2])
    shared *= max(bottom - top, 0.0)
    return shared / (np.prod(truth.size[i]) + np.prod(found.size[j]) - shared)


def slow_statistics(truth, found, kind, rules, metric, least, threshold):
    """Scores of the finds at a threshold (None: all, the best score first), and the number of mistakes."""
    neighbor = {"Car": "Van", "Pedestrian": "Person_sitting"}.get(kind)
    state = {}  # of detections: "counts" or "ignored"
    for j in range(len(found)):
        if found.xyxy[j, 3] - found.xyxy[j, 1] < rules.height:
            state[j] = "ignored"  # whatever its class
        elif found.types[j] == kind:
            state[j] = "counts"
    if threshold is not None:
        state = {j: what for j, what in state.items() if found.score[j] >= threshold}
    taken, scores = set(), []
    for i in range(len(truth)):
        if truth.types[i] not in (kind, neighbor):
            continue
        tall = truth.xyxy[i, 3] - truth.xyxy[i, 1]
        counts = truth.types[i] == kind and not (
            tall <= rules.height or truth.occluded[i] > rules.occluded or truth.truncated[i] > rules.truncated
        )
        fits = {j: overlap(truth, i, found, j, metric) for j in state if j not in taken}
        fits = {j: share for j, share in fits.items() if share > least}
        if not fits:
            continue
        if threshold is None:
            best = max(fits, key=lambda j: (found.score[j], -j))
        else:
            sure = [j for j in fits if state[j] == "counts"]
            best = max(sure, key=lambda j: (fits[j], -j)) if sure else min(fits)
        taken.add(best)
        if counts and state[best] == "counts":
            scores.append(found.score[best])
    mistakes = [j for j, what in state.items() if what == "counts" and j not in taken]
    if metric == "2d":
        areas = [truth.xyxy[i] for i in range(len(truth)) if truth.types[i] == "DontCare"]
        mistakes = [j for j in mistakes if all(overlap_2d(found.xyxy[j], a, True) <= least for a in areas)]
    return scores, len(mistakes)


def slow_ap(truths, detections, kind, difficulty, metric, least):
    rules = DIFFICULTIES[difficulty]
    total = sum(
        truth.types[i] == kind
        and truth.xyxy[i, 3] - truth.xyxy[i, 1] > rules.height
        and truth.occluded[i] <= rules.occluded
        and truth.truncated[i] <= rules.truncated
        for truth in truths
        for i in range(len(truth))
    )
    if total == 0:
        return None
    pairs = list(zip(truths, detections, strict=True))
    scores = sorted(
        (s for t, f in pairs for s in slow_statistics(t, f, kind, rules, metric, least, None)[0])
    )[::-1]
    precision, recall = [], 0.0
    for number, score in enumerate(scores, 1):
        last = number == len(scores)
        if not last and (number + 1) / total - recall < recall - number / total:
            continue
        recall += 1 / 40
        parts = [slow_statistics(t, f, kind, rules, metric, least, score) for t, f in pairs]
        right, wrong = sum(len(p[0]) for p in parts), sum(p[1] for p in parts)
        precision.append(right / (right + wrong) if right + wrong else 0.0)
    precision += [0.0] * (41 - len(precision))
    best = [max(precision[k:]) for k in range(41)]
    return {"R40": 100 * sum(best[1:]) / 40, "R11": 100 * sum(best[::4]) / 11}


def random_frames(seed: int, count: int):
    """Frames with objects of all classes and states, and detections near them, beside them and twice."""
    rng = np.random.default_rng(seed)
    kinds = ("Car", "Van", "Truck", "Pedestrian", "Person_sitting", "Cyclist", "DontCare")
    sizes = {"Pedestrian": (0.7, 0.6, 1.7), "Person_sitting": (0.8, 0.6, 1.3), "Cyclist": (1.8, 0.6, 1.7)}
    truths, detections = [], []
    for _ in range(count):
        n = int(rng.integers(4, 11))
        types = rng.choice(kinds, n, p=(0.35, 0.1, 0.05, 0.2, 0.08, 0.12, 0.1))
        left, top = rng.uniform(0, 1000, n), rng.uniform(100, 200, n)
        tall = np.where(rng.random(n) < 0.15, rng.choice([25.0, 40.0], n), rng.uniform(15, 90, n))
        xyxy = np.stack([left, top, left + tall * rng.uniform(0.6, 2, n), top + tall], 1)
        size = np.array([sizes.get(kind, (4.0, 1.7, 1.5)) for kind in types]) * rng.uniform(0.9, 1.1, (n, 3))
        location = np.stack([rng.uniform(-8, 8, n), rng.uniform(1.4, 1.9, n), rng.uniform(8, 40, n)], 1)
        care = types == "DontCare"
        truth = KittiLabels(
            tuple(types), np.where(care, -1, rng.choice([0, 0, 0.15, 0.2, 0.4, 0.6], n)),
            np.where(care, -1, rng.choice([0, 0, 1, 2, 3], n)), np.zeros(n), xyxy,
            np.where(care[:, None], -1.0, size), np.where(care[:, None], -1000.0, location),
            rng.uniform(-np.pi, np.pi, n), np.ones(n),
        )  # fmt: skip
        truths.append(truth)
        chosen = np.repeat(np.arange(n), rng.choice([0, 1, 1, 2], n))
        m = len(chosen)
        renamed = {"Van": "Car", "Person_sitting": "Pedestrian", "DontCare": "Car", "Truck": "Car"}
        wrong = rng.random(m) < 0.1
        found_types = [
            str(rng.choice(kinds[:6])) if bad else renamed.get(str(types[i]), str(types[i]))
            for i, bad in zip(chosen, wrong, strict=True)
        ]
        spread = (xyxy[chosen, 3] - xyxy[chosen, 1])[:, None]
        lost = care[chosen]
        detections.append(
            KittiLabels(
                tuple(found_types), np.full(m, -1.0), np.full(m, -1), np.zeros(m),
                xyxy[chosen] + rng.normal(0, 0.05, (m, 4)) * spread,
                np.where(lost[:, None], (4.0, 1.7, 1.5), size[chosen]) * rng.uniform(0.93, 1.07, (m, 3)),
                np.where(
                    lost[:, None], rng.uniform(1, 30, (m, 3)), location[chosen] + rng.normal(0, 0.12, (m, 3))
                ),
                truth.yaw[chosen] + rng.normal(0, 0.05, m) + np.pi * rng.integers(0, 2, m),
                np.round(rng.random(m), 2),  # equal scores happen
            )
        )  # fmt: skip
    return truths, detections


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", sorted(STRICT))
def test_ap_equals_the_literal_implementation(kind, seed):
    truths, detections = random_frames(seed, 14)
    seen = 0
    for metric in METRICS:
        for least in (STRICT[kind], LOOSE[kind]):
            for difficulty in DIFFICULTIES:
                fast = average_precision(
                    truths, detections, kind=kind, difficulty=difficulty, metric=metric, min_overlap=least
                )
                slow = slow_ap(truths, detections, kind, difficulty, metric, least)
                if slow is None:
                    assert np.isnan(fast["R40"])
                    continue
                assert fast == pytest.approx(slow, abs=1e-9), (metric, least, difficulty)
                seen += slow["R11"] > 0
    assert seen >= 6  # figures, not zeros

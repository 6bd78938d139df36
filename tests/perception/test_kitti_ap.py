"""KITTI's average precision against figures by hand, and against a slow one written down rule by rule."""

import numpy as np
import pytest
from shapely.geometry import Polygon

from eldenet.perception.kitti_ap import DIFFICULTIES, LOOSE, METRICS, STRICT, average_precision
from eldenet.perception.kitti_object import KittiLabels

# --- by hand ---


def row(
    kind: str, score: float, place: float, *, tall: float = 60, occluded: int = 0, truncated: float = 0.0
):
    """One object; those of another ``place`` share nothing, in the picture or in space."""
    return (
        kind,
        truncated,
        occluded,
        [100 * place, 100, 100 * place + 50, 100 + tall],
        [10 * place, 1.6, 20],
        score,
    )


def frame(*rows) -> KittiLabels:
    count = len(rows)
    return KittiLabels(
        tuple(r[0] for r in rows), np.array([r[1] for r in rows], float), np.array([r[2] for r in rows], int),
        np.zeros(count), np.array([r[3] for r in rows], float).reshape(-1, 4),
        np.tile([4.0, 1.6, 1.5], (count, 1)), np.array([r[4] for r in rows], float).reshape(-1, 3),
        np.zeros(count), np.array([r[5] for r in rows], float),
    )  # fmt: skip


@pytest.mark.parametrize("metric", METRICS)
def test_a_mistake_between_two_finds(metric):
    """Two objects: thresholds .9 and .7; precision 1 and 2/3 at points 0 and 1, nothing beyond."""
    truth = frame(row("Car", 1, 0), row("Car", 1, 1))
    found = frame(row("Car", 0.9, 0), row("Car", 0.8, 7), row("Car", 0.7, 1))
    value = average_precision([truth], [found], metric=metric)
    assert value["R40"] == pytest.approx(100 * (2 / 3) / 40)
    assert value["R11"] == pytest.approx(100 * 1 / 11)


def test_precision_is_made_monotone_from_the_right():
    """Finds and mistakes of four objects: precision 1/2, 2/3, 3/4, 4/5 in raw, so 4/5 everywhere."""
    truth = frame(*(row("Car", 1, place) for place in range(4)))
    found = frame(row("Car", 0.95, 9), *(row("Car", 0.9 - 0.1 * place, place) for place in range(4)))
    value = average_precision([truth], [found], metric="3d")
    assert value["R40"] == pytest.approx(100 * 3 * 0.8 / 40)
    assert value["R11"] == pytest.approx(100 * 0.8 / 11)


def test_half_of_eighty_found():
    """Thresholds at the finds 1, 2, 4, 6 ... 40 of 80: points 0 to 20 hold precision 1."""
    truth = frame(*(row("Car", 1, place) for place in range(80)))
    found = frame(*(row("Car", 0.9 - 0.01 * place, place) for place in range(40)))
    value = average_precision([truth], [found], metric="3d")
    assert value["R40"] == pytest.approx(50)
    assert value["R11"] == pytest.approx(100 * 6 / 11)  # points 0, 4, ... 20


def test_two_detections_of_one_object():
    """The better score sets the threshold; the second is a mistake only below it."""
    truth = frame(row("Car", 1, 0), row("Car", 1, 1))
    found = frame(row("Car", 0.6, 0), row("Car", 0.9, 0), row("Car", 0.5, 1))
    value = average_precision([truth], [found], metric="3d")
    assert value["R40"] == pytest.approx(100 * (2 / 3) / 40)


def test_a_small_detection_takes_an_object_for_nothing():
    """24 of 25 pixels: ignored, and its object is neither found nor a cause of mistakes."""
    truth = frame(row("Car", 1, 0, tall=26), row("Car", 1, 1))
    found = frame(row("Car", 0.9, 0, tall=24), row("Car", 0.5, 1))
    value = average_precision([truth], [found], metric="3d")
    assert value["R11"] == pytest.approx(100 / 11)
    assert value["R40"] == 0  # one threshold: point 0 alone


@pytest.mark.parametrize(("kind", "expected"), [("Van", 1.0), ("Truck", 0.5)])
def test_a_neighbors_detection_is_no_mistake(kind, expected):
    truth = frame(row("Car", 1, 0), row(kind, 1, 1))
    found = frame(row("Car", 0.5, 0), row("Car", 0.9, 1))
    assert average_precision([truth], [found], metric="3d")["R11"] == pytest.approx(100 * expected / 11)


# --- rule by rule ---


def overlap_2d(a, b, of_first=False) -> float:
    wide, tall = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    if wide <= 0 or tall <= 0:
        return 0.0
    area = [(box[2] - box[0]) * (box[3] - box[1]) for box in (a, b)]
    return wide * tall / (area[0] if of_first else area[0] + area[1] - wide * tall)


def footprint(labels: KittiLabels, i: int) -> Polygon:
    length, width, _ = labels.size[i]
    c, s = np.cos(labels.yaw[i]), np.sin(labels.yaw[i])
    corners = [
        (length / 2, width / 2),
        (length / 2, -width / 2),
        (-length / 2, -width / 2),
        (-length / 2, width / 2),
    ]
    return Polygon(
        [(labels.location[i, 0] + u * c + v * s, labels.location[i, 2] - u * s + v * c) for u, v in corners]
    )


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
def test_the_fast_one_equals_the_slow_one(kind, seed):
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

"""KITTI's files, its average precision by hand, and the figures of the study."""

from pathlib import Path

import numpy as np
import pytest

from eldenet.boxes import Boxes3D
from eldenet.geometry import PinholeCamera
from eldenet.perception.kitti_ap import average_precision, kitti_table
from eldenet.perception.kitti_object import KittiLabels, KittiObjects, read_labels, to_labels, write_labels
from eldenet.perception.scores import Pairs, bootstrap, by_distance, compare, pair_up, summary

CAR = "Car 0.00 0 1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 1.62"


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


# --- files ---


def test_labels_are_read_and_written(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(CAR + "\nDontCare -1 -1 -10 5 229 214 367 -1 -1 -1 -1000 -1000 -1000 -10\n")
    read = read_labels(path)
    assert read.types == ("Car", "DontCare")
    np.testing.assert_allclose(read.size[0], [4.15, 1.73, 1.57])
    np.testing.assert_allclose(read.boxes.bottom_center[0], [1.00, 1.75, 13.22])
    write_labels(tmp_path / "b.txt", read, with_score=False)
    again = read_labels(tmp_path / "b.txt")
    for name in ("xyxy", "size", "location", "yaw", "occluded"):
        np.testing.assert_allclose(getattr(again, name), getattr(read, name), atol=1e-4)


def test_boxes_become_results_and_come_back(tmp_path):
    rng = np.random.default_rng(0)
    boxes = Boxes3D(
        rng.uniform([-5, 0, 5], [5, 2, 30], (6, 3)), rng.uniform(1, 4, (6, 3)), rng.uniform(-3, 3, 6),
        rng.random(6), np.arange(6) % 2, ("car", "person"),
    )  # fmt: skip
    write_labels(tmp_path / "r.txt", to_labels(boxes, np.zeros((6, 4))))
    back = read_labels(tmp_path / "r.txt")
    assert set(back.types) == {"Car", "Pedestrian"}
    np.testing.assert_allclose(back.boxes.center, boxes.center, atol=2e-4)
    np.testing.assert_allclose(back.score, boxes.score, atol=1e-4)
    assert (tmp_path / "r.txt").read_text().splitlines()[0].count(" ") == 15


def test_results_have_the_axes_of_the_camera():
    """Of a camera that looks down by 0.12 rad: by hand, and as the benchmark projects them."""
    c, s = np.cos(0.12), np.sin(0.12)
    camera = PinholeCamera(
        np.array([[400.0, 0, 320], [0, 400, 100], [0, 0, 1]]), np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
    )
    boxes = Boxes3D(
        np.array([[-2.0, 0.85, 12.0]]), np.array([[4.0, 1.6, 1.5]]), np.array([0.4]), np.ones(1),
        np.zeros(1, int), ("car",),
    )  # fmt: skip
    given = to_labels(boxes, np.zeros((1, 4)), camera.rotation)
    np.testing.assert_allclose(given.location[0], [-2, 1.6 * c - 12 * s, 1.6 * s + 12 * c], atol=1e-9)
    projected = np.append(given.location[0], 1) @ np.column_stack([camera.intrinsics, np.zeros(3)]).T
    np.testing.assert_allclose(projected[:2] / projected[2], camera.project(boxes.bottom_center)[0])
    front = camera.rotation.T @ np.array([np.cos(0.4), 0, -np.sin(0.4)])
    assert given.yaw[0] == pytest.approx(np.arctan2(-front[2], front[0]))
    np.testing.assert_allclose(given.alpha, given.yaw - np.arctan2(*given.location[0, [0, 2]]))


def test_the_observation_angle_is_that_of_the_labels():
    """A label of KITTI's far to the side: alpha = rotation_y - atan2(x, z)."""
    boxes = Boxes3D(
        np.array([[10.0, 1.0, 10.0]]),
        np.ones((1, 3)),
        np.array([1.0]),
        np.ones(1),
        np.zeros(1, int),
        ("car",),
    )
    assert to_labels(boxes, np.zeros((1, 4))).alpha[0] == pytest.approx(1.0 - np.pi / 4)


@pytest.mark.parametrize("line", ["Car 1 2 3", CAR.replace("13.22", "far"), CAR + " 1 2"])
def test_lines_that_are_none_are_named(line, tmp_path):
    (tmp_path / "a.txt").write_text(f"{CAR}\n{line}\n")
    with pytest.raises(ValueError, match="line 2"):
        read_labels(tmp_path / "a.txt")


def test_empty_and_missing_files(tmp_path):
    (tmp_path / "a.txt").write_text("")
    assert len(read_labels(tmp_path / "a.txt")) == 0
    with pytest.raises(FileNotFoundError):
        read_labels(tmp_path / "b.txt")
    with pytest.raises(FileNotFoundError, match="image_2"):
        KittiObjects(tmp_path)


def test_a_scan_lands_where_the_calibration_says(tmp_path):
    import cv2

    for name in ("image_2", "calib", "label_2", "velodyne"):
        (tmp_path / name).mkdir()
    cv2.imwrite(str(tmp_path / "image_2/000000.png"), np.zeros((100, 200, 3), np.uint8))
    (tmp_path / "label_2/000000.txt").write_text(CAR + "\n")
    calibration = tmp_path / "calib/000000.txt"
    calibration.write_text(
        "P2: 100 0 100 0 0 100 50 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
        "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
    )
    scan = np.array([[10, 0, 0, 1], [5, 0, 0, 1], [10, 2, -1, 1], [-5, 0, 0, 1]], np.float32)  # x forward
    scan.tofile(tmp_path / "velodyne/000000.bin")
    kitti = KittiObjects(tmp_path)
    depth = kitti.lidar_depth("000000", (100, 200))
    assert depth is not None
    assert depth[50, 100] == 5  # the nearer of two on one pixel
    assert depth[60, 80] == 10  # 2 m left, 1 m below
    assert np.count_nonzero(depth) == 2
    (tmp_path / "velodyne/000000.bin").unlink()
    assert kitti.lidar_depth("000000", (100, 200)) is None
    calibration.write_text("P0: 1 2 3\n")
    with pytest.raises(ValueError, match="P2"):
        kitti.camera("000000")
    with pytest.raises(FileNotFoundError, match="000001"):
        KittiObjects(tmp_path, ["000001"])


# --- average precision ---


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


def test_boxes_off_by_a_metre_fit_the_loose_overlap_alone():
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


# --- pairs ---


def boxes_at(z: list[float], yaw: float = 0.0) -> Boxes3D:
    count = len(z)
    center = np.stack([np.zeros(count), np.zeros(count), np.array(z)], 1)
    return Boxes3D(
        center,
        np.tile([4.0, 2.0, 1.5], (count, 1)),
        np.full(count, yaw),
        np.ones(count),
        np.zeros(count, int),
        ("car",),
    )


def test_pairs_are_one_to_one_and_the_largest_overlap_wins():
    truth = np.array([[0, 0, 10, 10], [1, 0, 11, 10], [50, 50, 60, 60.0]])
    found = np.array([[1, 0, 11, 10], [0, 0, 10, 9.0]])
    rows, columns = pair_up(truth, found)
    assert sorted(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 1), (1, 0)]
    assert len(pair_up(truth, np.zeros((0, 4)))[0]) == 0


def test_figures_by_hand():
    truth, found = boxes_at([10.0, 20.0, 50.0]), boxes_at([11.0, 20.0], yaw=np.pi)
    pairs = compare(truth, found, np.array([0, 1]), np.array([0, 1]))
    np.testing.assert_allclose(pairs.accuracy, [0.9, 1.0])
    np.testing.assert_allclose(pairs.bev, [1 / 3, 1.0])  # widths of 2 m lie along z: 1 m shared of 3
    figures = summary(pairs)
    assert figures["accuracy"] == pytest.approx(0.95)
    assert (figures["bev>0.25"], figures["bev>0.5"]) == (1.0, 0.5)
    assert figures["recall bev>0.5"] == pytest.approx(1 / 3)
    assert (figures["within 0.5 m"], figures["within 1 m"], figures["median_yaw"]) == (
        0.5,
        1.0,
        pytest.approx(0),
    )
    bins = by_distance(pairs)
    assert [part["pairs"] for _, _, part in bins] == [0, 1, 1, 0]
    assert [part.get("bev>0.5") for _, _, part in bins] == [None, 0.0, 1.0, None]
    assert not any("recall" in key or key == "truths" for _, _, part in bins for key in part)
    assert summary(Pairs.join([pairs.select(np.zeros(2, bool))]))["pairs"] == 0


def test_no_frames_have_no_pairs():
    assert summary(Pairs.join([])) == {"pairs": 0.0, "truths": 0.0}


def test_the_interval_draws_frames():
    rng = np.random.default_rng(0)
    frames = np.repeat(np.arange(50), 8)
    shared = rng.normal(0, 1, 50)[frames]  # all objects of a frame share its error
    low, high = bootstrap(shared, frames)
    naive = bootstrap(shared, np.arange(400))
    assert high - low > 2 * (naive[1] - naive[0])
    assert low < shared.mean() < high
    assert all(np.isnan(bootstrap(np.zeros(0), np.zeros(0))))


def test_kittis_own_frames():
    import os

    if not os.environ.get("ELDENET_DATA") or not (Path(os.environ["ELDENET_DATA"]) / "kitti/object").is_dir():
        pytest.skip("set ELDENET_DATA: KITTI's object frames")
    kitti = KittiObjects()
    assert "000008" in kitti.names
    for name in kitti.names:
        truth = kitti.labels(name)
        truth = truth.select(np.array([kind in ("Car", "Van", "Pedestrian") for kind in truth.types]))
        whole = truth.select((truth.truncated == 0) & (truth.occluded <= 1))
        if not len(whole):
            continue
        # the labels' 2D boxes are projections of their 3D boxes
        projected = whole.boxes.project(kitti.camera(name), kitti.image(name).shape[:2])
        np.testing.assert_allclose(projected, whole.xyxy, atol=12)
        assert np.median(np.abs(projected - whole.xyxy)) < 2.5

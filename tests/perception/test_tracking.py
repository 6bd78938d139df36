"""Tracks over time: identities, velocities, begin and end."""

from dataclasses import replace

import numpy as np
import pytest
from support.standing_boxes import boxes

from eldenet.boxes import Boxes3D
from eldenet.perception.tracking import BoxTracker


def test_two_cars_keep_their_identities_and_get_their_velocities():
    rng = np.random.default_rng(0)
    tracker = BoxTracker(still_camera=True)
    start, speed = np.array([[-4.0, 0.8, 15], [4.0, 0.8, 30]]), np.array([[0, 0, 3.0], [0, 0, -6.0]])
    for frame in range(25):
        order = rng.permutation(2)
        center = (start + speed * frame * 0.1 + rng.normal(0, 0.1, (2, 3)))[order]
        found = tracker(boxes(center, yaw=np.pi / 2 * rng.choice([-1, 1])), 0.1)
    by_number = {int(number): row for row, number in enumerate(found.track_id)}
    assert set(by_number) == {1, 2}
    first = by_number[1] if found.center[by_number[1], 0] < 0 else by_number[2]
    second = 1 - first
    assert found.velocity[first, 2] == pytest.approx(3.0, abs=0.5)
    assert found.velocity[second, 2] == pytest.approx(-6.0, abs=0.5)
    heading = np.stack([np.cos(found.yaw), -np.sin(found.yaw)], 1)  # x, z of the fronts
    assert heading[first, 1] > 0.95
    assert heading[second, 1] < -0.95


@pytest.mark.parametrize(("length", "width"), [(1.02, 1.0), (4.0, 1.6)])
def test_quarter_turns_of_a_square_box_are_not_averaged(length, width):
    """Which side of a crate counts as its length changes from frame to frame; a car's does not."""
    tracker = BoxTracker()
    for frame in range(20):
        turn = frame % 2 if length < 2 else 0
        seen = boxes([0.0, 0.5, 8.0], yaw=0.1 + turn * np.pi / 2)
        found = tracker(replace(seen, size=np.array([[length, width, 1.0]])), 0.1)
    assert found.yaw[0] == pytest.approx(0.1, abs=0.02)
    wrong = replace(seen, yaw=np.array([0.1 + np.pi / 2]), size=np.array([[length, width, 1.0]]))
    assert tracker(wrong, 0.1).size[0, 0] == pytest.approx(length, abs=0.03)


@pytest.mark.parametrize("still_camera", [False, True])
def test_a_parked_car_is_not_turned_round_by_a_camera_that_drives(still_camera):
    """It faces away from the camera (yaw -pi/2) and comes closer by 10 m/s."""
    tracker = BoxTracker(still_camera=still_camera)
    for frame in range(10):
        found = tracker(boxes([3.0, 0.8, 30.0 - frame], yaw=-np.pi / 2), 0.1)
    assert found.velocity[0, 2] == pytest.approx(-10, abs=0.3)
    assert np.cos(found.yaw[0] + np.pi / 2) == pytest.approx(-1 if still_camera else 1)
    assert found.quality["heading"][0] == still_camera


def test_tracks_are_closer_to_the_truth_than_measurements():
    rng = np.random.default_rng(1)
    tracker, raw, smooth = BoxTracker(), [], []
    for frame in range(60):
        truth = np.array([2.0, 0.8, 10 + 0.2 * frame])
        center = truth + rng.normal(0, 0.4, 3)
        found = tracker(boxes(center), 0.1)
        raw.append(np.linalg.norm(center - truth))
        smooth.append(np.linalg.norm(found.center[0] - truth))
    assert np.mean(smooth[20:]) < 0.8 * np.mean(raw[20:])


def test_tracks_begin_survive_gaps_keep_their_class_and_end():
    tracker = BoxTracker(min_hits=3, max_age=3)
    here = [0.0, 0.8, 10.0]
    for _ in range(3):
        tracker(Boxes3D.empty(("car", "person")), 0.1)
    shown = [len(tracker(boxes(here), 0.1)) for _ in range(4)]
    assert shown == [0, 0, 1, 1]
    number = tracker(boxes(here), 0.1).track_id[0]
    tracker(Boxes3D.empty(("car", "person")), 0.1)
    assert tracker(boxes(here), 0.1).track_id[0] == number  # it survives a gap
    assert len(tracker(boxes(here, label=1), 0.1)) == 0  # a person is no car
    for _ in range(3):
        tracker(Boxes3D.empty(("car", "person")), 0.1)
    assert not tracker.tracks
    for wrong in (0.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=f"seconds={wrong}: give"):
            tracker(boxes(here), wrong)


def test_a_track_keeps_its_class_when_frames_number_theirs_differently():
    tracker = BoxTracker(min_hits=1, report_unseen=True)
    for frame in range(6):
        # a person and a car beside it are seen in turn, each as class 0 of its frame
        name, x = ("car", 0.0) if frame % 2 else ("person", 0.5)
        out = tracker(replace(boxes([x, 0.8, 10.0]), names=(name,)), 0.1)
        if frame:
            assert dict(zip(out.track_id.tolist(), out.classes, strict=True)) == {1: "person", 2: "car"}


def test_an_unseen_track_keeps_the_quality_of_its_last_detection():
    tracker = BoxTracker(min_hits=1, report_unseen=True)
    tracker(replace(boxes([0.0, 0.8, 10.0]), quality={"doubtful": np.ones(1)}), 0.1)
    assert tracker(Boxes3D.empty(("car",)), 0.1).doubtful.tolist() == [True]


def test_2d_boxes_keep_identities_apart_where_the_depth_jumps():
    """Two cars side by side in the image, each frame with depths that are off by up to a fourth."""
    rng = np.random.default_rng(2)
    flat = np.array([[50.0, 60, 90, 100], [100, 60, 140, 100]])
    seen: dict[bool, set[tuple[int, ...]]] = {False: set(), True: set()}
    for given in seen:
        tracker = BoxTracker()
        for frame in range(30):
            center = np.array([[-2.0, 0.8, 20], [0.0, 0.8, 20]]) * rng.uniform(0.75, 1.25, (2, 1))
            found = tracker(boxes(center), 0.1, flat + frame if given else None)
            seen[given].update(map(int, found.track_id))
    assert seen[True] == {1, 2}
    assert len(seen[False]) > 2


def test_the_distance_keeps_identities_apart_where_2d_boxes_overlap():
    """A car drives past a parked one that stands farther away, and hides it for a while."""
    tracker = BoxTracker()
    numbers: dict[bool, set[int]] = {True: set(), False: set()}  # of the near car and the far one
    for frame in range(41):
        x = -4.0 + 0.2 * frame
        flat = np.array([[120 + 30 * x, 50, 200 + 30 * x, 100], [140, 55, 180, 80.0]])
        center = np.array([[x, 0.8, 10], [0.0, 0.8, 25]])
        order = [[0, 1], [1, 0]][frame % 2] if abs(x) > 0.3 else [0]
        found = tracker(boxes(center[order]), 0.1, flat[order])
        for number, place in zip(found.track_id, found.center, strict=True):
            numbers[place[2] < 15].add(int(number))
    assert [len(seen) for seen in numbers.values()] == [1, 1]
    assert numbers[True] != numbers[False]

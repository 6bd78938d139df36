"""A drive with odometry tunes weights as depth frames do, or is refused in one line."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from support.bags import lens, odometry, picture, write_bag

import eldenet
from eldenet.adapt import AdaptSettings, adapt
from eldenet.compose import compose
from eldenet.data.drive_poses import Mount, read_poses
from eldenet.data.io import read_depth
from eldenet.deploy.prediction import find_source
from eldenet.deploy.video_files import open_video
from eldenet.geometry import pinhole
from eldenet.perception.drive_labels import place_frames
from eldenet.visualization import write_picture

SIZE, LENS = (96, 128), (100.0, 100.0, 63.5, 47.5)
MOUNT = Mount(0.4, 0.15, 0.1)
PER_SECOND, SPEED = 10, 0.4  # pictures per second, [m/s]
TEXTURE = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
TEXTURE = np.tile(cv2.resize(TEXTURE, (512, 512), interpolation=cv2.INTER_CUBIC), (2, 2, 1))
#: normal and offset of floor, walls and the end of a corridor: ``normal @ point = offset``
PLANES = (((0, 0, 1), 0.0), ((0, 1, 0), 0.8), ((0, 1, 0), -0.9), ((1, 0, 0), 9.0))


def corridor(camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Picture ``(H, W, 3)`` and depth ``(H, W)`` [m] of a camera ``(4, 4)`` in a corridor along x."""
    columns, rows = np.meshgrid(np.arange(SIZE[1]), np.arange(SIZE[0]))
    rays = np.stack([columns, rows, np.ones(SIZE)], -1) @ np.linalg.inv(pinhole(*LENS)).T
    rays = rays @ camera[:3, :3].T
    depth, image = np.full(SIZE, np.inf), np.zeros((*SIZE, 3), np.uint8)
    for number, (normal, offset) in enumerate(PLANES):
        toward = rays @ np.array(normal)
        hit = (offset - camera[:3, 3] @ normal) / np.where(toward == 0, 1e-9, toward)
        world = rays * hit[..., None] + camera[:3, 3]
        u, v = [axis for axis in range(3) if not normal[axis]]
        at = ((world[..., [u, v]] * 110 + 70 * number) % 900).astype(np.float32)
        nearer = (hit > 0) & (hit < depth)
        image[nearer] = cv2.remap(TEXTURE, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[nearer]
        depth = np.where(nearer, hit, depth)
    return image, depth


def drive(folder: Path, seconds: float) -> np.ndarray:
    """Write ``odometry.csv`` and ``walk.mp4`` of a robot in the corridor; return the cameras."""
    times = np.arange(0, seconds, 1 / PER_SECOND)
    heading = 0.3 * np.sin(times)
    steps = SPEED / PER_SECOND * np.column_stack([np.cos(heading), np.sin(heading)])
    places = np.cumsum(steps, axis=0) - steps[0]
    rows = np.column_stack([times, places, heading]).round(5)
    lines = ["seconds,x,y,heading", *(",".join(map(str, row)) for row in rows)]
    (folder / "odometry.csv").write_text("\n".join(lines))
    cameras = read_poses(folder / "odometry.csv", MOUNT).cameras
    with open_video(folder / "walk.mp4", PER_SECOND) as add:
        for camera in cameras:
            add(corridor(camera)[0])
    return cameras


def setup(folder: Path, *overrides: str) -> AdaptSettings:
    torch.manual_seed(0)
    model = eldenet.load("eldenet_s", overrides=["model/head=linear", "model.head.max_depth=12"])
    model.info = {"input_size": [48, 64]}
    model.save_pretrained(folder / "start")
    given = [f"source={folder / 'walk.mp4'}", f"poses={folder / 'odometry.csv'}", "camera_height=0.4"]
    given += ["camera_pitch=8.6", "camera_ahead=0.1", f"intrinsics={list(LENS)}", "force=true"]
    given += [f"weights={folder / 'start'}", "runtime.threads=1", "runtime.workers=0", "trainer.epochs=2"]
    return compose(AdaptSettings, [*given, *overrides, f"output={folder / 'run'}"])


@pytest.mark.slow
def test_a_video_with_odometry_tunes_weights_on_the_depth_of_its_motion(tmp_path, capsys):
    cameras = drive(tmp_path, seconds=10.0)
    table = tmp_path / "odometry.csv"
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    rows[:, 0] += 0.3  # of another clock
    rest = [(t / 4, t, 0, 0) for t in range(42, 80)]  # it goes on after the video
    np.savetxt(table, [*rows, *rest], fmt="%.5f", delimiter=",", header="seconds,x,y,heading", comments="")
    kept = adapt(setup(tmp_path, "frames=45", "intrinsics=null", "camera_height=null", "camera_pitch=null"))
    record = json.loads((tmp_path / "run/run.json").read_text())
    assert record["kept"] is kept
    assert "held_out" in record
    said = capsys.readouterr().out
    lens = record["config"]["data"]["intrinsics"]
    assert lens == pytest.approx(LENS, rel=0.03)
    assert f"by the drive, intrinsics=[{lens[0]:.1f},{lens[1]:.1f},63.5,47.5]" in said
    assert re.search(r"by the drive, camera_pitch=(8.[1-9]|9.[01])", said)
    assert re.search(r"by the drive, the poses are \+0.(29|3|31) s late for the pictures: corrected", said)
    assert re.search(r"by the drive, camera_height=0.(39|40|41)", said)
    assert "corners of known depth" in said
    assert kept is (f"'intrinsics=[{lens[0]:.1f},{lens[1]:.1f},63.5,47.5]'" in said)  # ready to be copied
    maps = sorted((tmp_path / "run/labels/depths").iterdir())
    assert len(maps) >= 35
    shown = [corridor(camera) for camera in cameras]
    errors = []
    for path in maps[::5]:
        image = cv2.imread(str(tmp_path / "run/labels/images" / path.name))[..., ::-1].astype(float)
        alike = [np.abs(image - picture).mean() for picture, _ in shown]
        found, truth = read_depth(path, "mm"), shown[int(np.argmin(alike))][1]
        known = found > 0
        errors.append(np.abs(np.log(found[known] / truth[known])))
    assert np.median(np.concatenate(errors)) < 0.05
    assert np.percentile(np.concatenate(errors), 90) < 0.2


@pytest.mark.slow
def test_a_bag_of_ros_gives_the_labels_of_its_pictures_and_odometry(tmp_path, monkeypatch):
    tuned: list[dict] = []
    monkeypatch.setattr("eldenet.training.adaptation.tune", lambda s, *_: tuned.append(s) or True)
    monkeypatch.setattr("eldenet.perception.drive_labels.LEAST_FRAMES", 6)
    cameras = drive(tmp_path, seconds=3.0)
    table = tmp_path / "odometry.csv"
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    rows[:, 0] += 1.7e9  # ROS counts from 1970
    np.savetxt(table, rows, fmt="%.6f", delimiter=",", header="seconds,x,y,heading", comments="")
    messages = [lens(1.7e9, pinhole(*LENS), SIZE)]
    for row, camera in zip(rows, cameras, strict=True):
        image = corridor(camera)[0]
        write_picture(tmp_path / f"pictures/{row[0]:.2f}.png", image)
        messages += [picture(row[0], image), odometry(*row)]
    bag = write_bag(tmp_path, messages)
    given = {"pictures": [f"source={tmp_path / 'pictures'}"]}
    given["bag"] = [f"source={bag}", "poses=null", "intrinsics=null"]
    labels = {}
    for name in given:
        assert adapt(replace(setup(tmp_path, *given[name], "frames=8"), output=str(tmp_path / name)))
        for kind in ("images", "depths"):
            files = sorted((tmp_path / name / "labels" / kind).iterdir())[:8]  # rounding decides on a ninth
            labels[name, kind] = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files]
    assert len(labels["bag", "depths"]) >= 6
    for kind in ("images", "depths"):
        np.testing.assert_array_equal(labels["bag", kind], labels["pictures", kind])
    of_pictures, of_bag = tuned
    assert of_bag["data"]["intrinsics"] == of_pictures["data"]["intrinsics"] == list(LENS)


@pytest.mark.slow
def test_pictures_are_chosen_along_their_own_way_not_all_poses(tmp_path, monkeypatch):
    monkeypatch.setattr("eldenet.training.adaptation.tune", lambda *_: True)
    monkeypatch.setattr("eldenet.perception.drive_labels.LEAST_FRAMES", 6)
    for number, camera in enumerate(drive(tmp_path, seconds=3.0)):
        write_picture(tmp_path / f"pictures/{number / PER_SECOND:.1f}.png", corridor(camera)[0])
    with (tmp_path / "odometry.csv").open("a") as file:  # which goes on after the pictures
        file.writelines(f"\n{t / 4},{t},0,0" for t in range(13, 80))
    assert adapt(setup(tmp_path, f"source={tmp_path / 'pictures'}", "frames=12"))
    assert len(list((tmp_path / "run/labels/images").iterdir())) >= 9


def test_pictures_named_by_times_without_last_zeros_are_in_the_order_of_time(tmp_path):
    times = [0.05 * number for number in range(40)]
    for time in times:
        write_picture(tmp_path / f"pictures/{round(time, 2)}.png", np.zeros((8, 8, 3), np.uint8))
    rows = [f"{time:.2f},{time:.2f},0,0" for time in times]
    (tmp_path / "odometry.csv").write_text("\n".join(["seconds,x,y,heading", *rows]))
    source = find_source(str(tmp_path / "pictures"), tmp_path / "run", None)
    placed = list(place_frames(source, read_poses(tmp_path / "odometry.csv", MOUNT)))
    assert [time for *_, time in placed] == pytest.approx(times)
    assert [pose[0, 3] - MOUNT.ahead for _, _, pose, _ in placed] == pytest.approx(times)


@pytest.mark.slow
def test_a_bag_of_a_camera_that_nobody_calibrated_has_its_lens_found(tmp_path, monkeypatch):
    found: list[np.ndarray] = []
    monkeypatch.setattr("eldenet.perception.drive_labels.label_drive", lambda *s: found.append(s[2]) or LENS)
    monkeypatch.setattr("eldenet.training.adaptation.tune", lambda *_: True)
    drive(tmp_path, seconds=6.0)
    rows = np.loadtxt(tmp_path / "odometry.csv", delimiter=",", skiprows=1)
    messages = [lens(1.7e9, 0 * pinhole(*LENS), SIZE)]
    for row, camera in zip(rows, read_poses(tmp_path / "odometry.csv", MOUNT).cameras, strict=True):
        time = 1.7e9 + row[0]
        messages += [picture(time, corridor(camera)[0]), odometry(time, *row[1:])]
    adapt(setup(tmp_path, f"source={write_bag(tmp_path, messages)}", "poses=null", "intrinsics=null"))
    np.testing.assert_allclose(found[0], pinhole(*LENS), rtol=0.03)


def test_a_bag_whose_odometry_has_another_clock_is_refused(tmp_path):
    image = np.zeros((*SIZE, 3), np.uint8)
    messages = [lens(1.7e9, pinhole(*LENS), SIZE)]
    for step in range(20):
        messages += [picture(1.7e9 + step / 8, image), odometry(50 + step / 8, step / 10, 0.0, 0.0)]
    given = [f"source={write_bag(tmp_path, messages)}", "poses=null", "intrinsics=null"]
    with pytest.raises(ValueError, match=r"poses from 50.00 to 52.38 s, .* from 1700000000.00 to"):
        adapt(setup(tmp_path, *given))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "heading", "said"),
    [
        (
            ["intrinsics=[130,130,63.5,47.5]"],
            0.0,
            r"fx=130, but .* 128 x 96, move as with fx=(9|10)\d: give",
        ),
        (["camera_pitch=0"], 0.0, r"camera_pitch=0, but .* a camera [89].\d degrees below the horizon: give"),
        (["camera_height=0.5"], 0.0, r"camera_height=0.5, but .* the floor lies 0.(39|40|41) m below the"),
        ([], 0.15, r"the camera looks [78].\d degrees to the right of the way: mount it straight ahead"),
    ],
)
def test_a_lens_or_a_mount_that_the_pictures_contradict_is_refused(tmp_path, given, heading, said):
    drive(tmp_path, seconds=6.0)
    table = tmp_path / "odometry.csv"
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    rows[:, 3] += heading
    np.savetxt(table, rows, fmt="%.6f", delimiter=",", header="seconds,x,y,heading", comments="")
    with pytest.raises(ValueError, match=said):
        adapt(setup(tmp_path, *given))
    assert not (tmp_path / "run/model").exists()


def test_labels_of_somebody_else_are_not_replaced(tmp_path):
    drive(tmp_path, seconds=4.0)
    (tmp_path / "run/labels").mkdir(parents=True)
    (tmp_path / "run/labels/mine.png").write_text("mine")
    with pytest.raises(ValueError, match="labels exists and is not adapt's: give another output="):
        adapt(setup(tmp_path))
    assert (tmp_path / "run/labels/mine.png").read_text() == "mine"


@pytest.mark.parametrize(
    ("unit", "sign", "later", "said"),
    [
        (1000, 1, 0.0, r"poses from 0.00 to 5\d+.00 s, one each \d+ s, the pictures are from 0.00 to 5.90 s"),
        (
            1,
            1,
            1.7e9,
            r"poses from 1700000000.00 to .* pictures are from 0.00 to 5.90 s: give seconds of one",
        ),
        (1, -1, 0.0, r"odometry.csv turns the other way than the pictures: give heading in radians"),
    ],
)
def test_poses_of_another_clock_or_another_hand_are_refused(tmp_path, unit, sign, later, said):
    drive(tmp_path, seconds=6.0)
    path = tmp_path / "odometry.csv"
    rows = np.loadtxt(path, delimiter=",", skiprows=1) * (unit, 1, sign, sign) + (later, 0, 0, 0)
    np.savetxt(path, rows, fmt="%.6f", delimiter=",", header="seconds,x,y,heading", comments="")
    with pytest.raises(ValueError, match=said):
        adapt(setup(tmp_path))
    assert not (tmp_path / "run/model").exists()

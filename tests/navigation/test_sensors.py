"""Camera sensors: source of each sector, boxes of objects, measured errors and noise drawn from them."""

import json

import numpy as np
import pytest
from support.networks import canonical_predictor

from eldenet.backbones.pplcnet import PPLCNet
from eldenet.boxes import Boxes3D, Detections2D
from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.geometry import to_corner
from eldenet.heads import LinearHead
from eldenet.model import DepthNet
from eldenet.navigate import NavigateSettings
from eldenet.navigation.cameras import (
    Camera,
    CameraInstance,
    camera,
    depth_camera,
    near_faces,
    objects,
)
from eldenet.navigation.noisy_ranges import NoisyRanges, without_missed
from eldenet.navigation.range_errors import RangeErrors, segments
from eldenet.navigation.ranges import CAUTION, depth_to_ranges
from eldenet.navigation.sensors import Centers, Ranges
from eldenet.perception.detectors import CallableDetector
from eldenet.perception.lifter import BoxLifter
from eldenet.simulation.arena_view import ArenaView, simulated_detections
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena, generate_arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT
from eldenet.uncertainty import DepthEstimate

BOX = Obstacle("box", 3.0, 0.4, 0.3, (0.4, 0.3), 1.0)
PILLAR = Obstacle("cylinder", 2.5, -0.9, 0.0, (0.25, 0.25), 1.2)
ARENA = Arena("", 2, 0, (BOX, PILLAR), (0.0, 0.0, 0.0), ((5.0, 0.0),))


def instance_of(sensor: Camera, arena: Arena = ARENA) -> CameraInstance:
    instance = sensor.begin(ArenaWorld(arena), np.random.default_rng(0))
    assert isinstance(instance, CameraInstance)
    return instance


def test_centers_are_those_of_objects_in_view():
    hidden = Obstacle("cylinder", 4.5, -1.62, 0.0, (0.2, 0.2), 1.2)  # behind the pillar
    arena = Arena("", 3, 0, (BOX, PILLAR, hidden), (0.0, 0.0, 0.0), ((5.0, 0.0),))
    sectors = Centers().begin(ArenaWorld(arena), np.random.default_rng(0)).scan().sectors
    far = ROBOT.far  # the arena's wall is nearer, but is no object
    to = [np.hypot(one.x - ROBOT.camera_ahead, one.y) for one in (PILLAR, BOX)]
    assert sectors == pytest.approx([to[0], far, far, to[1], far])


# --- boxes ---


def test_each_sector_names_its_source():
    arena = generate_arena("val", 20, 0)
    seen = instance_of(objects(size=(60, 80)), arena).scan()
    assert set(seen.sectors_fed_by) <= {"box", "depth"}
    assert seen.image.shape == (60, 80, 3)
    seen = instance_of(objects()).scan()
    # right to left: pillar, pillar, gap, box, wall
    assert seen.sectors_fed_by[0] == seen.sectors_fed_by[3] == "box"
    assert seen.sectors_fed_by[4] == "depth"
    assert seen.sectors[4] == ROBOT.far or seen.sectors[4] > 8
    assert instance_of(camera()).scan().sectors_fed_by == ("depth",) * 5


def test_near_faces_agree_with_rays():
    instance = instance_of(objects())
    seen, true = instance.scan(), ArenaWorld(ARENA).ranges()
    by_box = seen.fed_by == 2
    shows = (true < 4) & by_box
    assert shows.sum() > 12
    assert np.abs(np.log(seen.ranges[shows] / true[shows])).mean() < 0.06


@pytest.mark.parametrize("yaw", [0.5, -0.5, 1.0, -1.0])
def test_the_near_face_of_a_long_box_lies_on_its_own_side(yaw):
    """A truck that stands askew is nearer at one end, and must not be mirrored."""
    truck = Obstacle("box", 3.5, 0.3, yaw, (1.0, 0.25), 0.8)
    arena = Arena("", 1, 0, (truck,), (0.0, 0.0, 0.0), ((9.0, 0.0),))
    instance = instance_of(objects(), arena)
    instance.scan()
    found = simulated_detections(instance.photo, arena)
    askew = Boxes3D(
        np.array([[-truck.y, 0.0, truck.x - ROBOT.camera_ahead]]), np.array([[2.0, 0.5, 0.8]]),
        np.array([np.pi / 2 - yaw]), np.ones(1), np.zeros(1, np.int64), ("box",),
    )  # fmt: skip
    faces, true = near_faces(askew, found, instance.camera), ArenaWorld(arena).ranges()
    shows = (faces < ROBOT.far) & (true < ROBOT.far)
    assert shows.sum() > 6
    assert faces[shows] == pytest.approx(true[shows], rel=0.01)


def test_the_simulator_s_detections_enclose_visible_pixels():
    view = ArenaView(ARENA, (120, 160))
    photo = view.photo(ARENA.start)
    found = simulated_detections(photo, ARENA)
    assert sorted(found.classes) == ["box", "cylinder"]
    for xyxy, kind in zip(to_corner(found.xyxy).astype(int), found.classes, strict=True):
        mine = photo.obstacle == [o.kind for o in ARENA.obstacles].index(kind)
        left, top, right, bottom = xyxy
        assert mine[top:bottom, left:right].sum() == mine.sum()
        assert mine[top].any()
        assert mine[bottom - 1].any()
        assert mine[:, left].any()
        assert mine[:, right - 1].any()
    empty = Arena("", 0, 0, (), ARENA.start, ARENA.waypoints)
    assert len(simulated_detections(ArenaView(empty, (60, 80)).photo(ARENA.start), empty)) == 0
    assert set(instance_of(objects(size=(60, 80)), empty).scan().sectors_fed_by) == {"depth"}


def pillar_columns() -> tuple[np.ndarray, np.ndarray]:
    true = ArenaWorld(ARENA).ranges()
    pillar = (true < 2.6) & (np.arange(ROBOT.columns) < 16)
    assert pillar.sum() > 5
    return pillar, true


def test_a_camera_that_looks_down_sees_the_same_ranges():
    level, down = (instance_of(Camera(pitch=pitch)) for pitch in (0.0, 15.0))
    assert level.scan().ranges == pytest.approx(down.scan().ranges, rel=0.1)
    assert (level.photo.image != down.photo.image).any()
    with pytest.raises(ValueError, match=r"sensor\.pitch=40: give degrees from -28.6 to 28.6"):
        Camera(pitch=40)


@pytest.mark.parametrize("pitch", [0.0, 10.0, 20.0, 28.0])
def test_boxes_are_the_same_for_a_camera_that_looks_down(pitch):
    seen = instance_of(Camera(lifter=objects().lifter, pitch=pitch)).scan()
    for one in (BOX, PILLAR):
        where = (-one.y, one.x - ROBOT.camera_ahead)
        assert np.hypot(*(seen.boxes.center[:, [0, 2]] - where).T).min() < 0.15, one
        column = np.abs(np.array(ROBOT.column_angles) + np.arctan2(*where)).argmin()
        assert seen.fed_by[column] == 2  # its face counts where it is


def test_undetected_obstacles_come_from_depth():
    pillar, true = pillar_columns()
    found = simulated_detections(ArenaView(ARENA, (120, 160)).photo(ARENA.start), ARENA)
    box = found.xyxy[found.classes.index("box")]
    detector = CallableDetector(lambda frame: (to_corner(box[None]), [0.9], [0]), ("box",))
    seen = instance_of(objects(detector=detector)).scan()
    assert (seen.fed_by[pillar] == 1).all()
    assert np.abs(seen.ranges[pillar] / true[pillar] - 1).max() < 0.1
    assert seen.sectors_fed_by[3] == "box"


def test_a_box_does_not_hide_an_obstacle_in_front_of_it():
    pillar, true = pillar_columns()
    behind = Boxes3D(
        np.array([[0.8, -0.1, 6.0]]), np.array([[4.0, 1.0, 1.0]]), np.zeros(1), np.ones(1),
        np.zeros(1, np.int64), ("box",),
    )  # fmt: skip
    wide = CallableDetector(lambda frame: (np.array([[0.0, 0.0, 160.0, 120.0]]), [0.9], [0]), ("box",))
    sensor = Camera(None, lambda depth, detections, camera: behind, wide)
    seen = instance_of(sensor).scan()
    assert (seen.fed_by[pillar] == 1).all()
    assert np.abs(seen.ranges[pillar] / true[pillar] - 1).max() < 0.1
    assert seen.ranges[seen.fed_by == 2] == pytest.approx(5.5, rel=0.15)


def test_a_box_only_counts_where_its_detection_is():
    instance = instance_of(objects())
    instance.scan()
    found = simulated_detections(instance.photo, ARENA)
    boxes = BoxLifter("lshape", ground=None)(instance.photo.depth, found, instance.camera)
    whole = near_faces(boxes, found, instance.camera)
    half = Detections2D(found.xyxy.copy(), found.score, found.label, found.names)
    half.xyxy[:, 2] = half.xyxy[:, [0, 2]].mean(axis=1)
    fewer = near_faces(boxes, half, instance.camera)
    assert 0 < (fewer < ROBOT.far).sum() < (whole < ROBOT.far).sum()


def test_any_trained_network_can_feed_a_camera(tmp_path):
    model = DepthNet.from_parts(PPLCNet(0.25), FastUpConvDecoder, LinearHead())
    model.save_pretrained(tmp_path / "run" / "model", info={"input_size": [48, 64]})
    for source in (tmp_path / "run", tmp_path / "run" / "model"):
        sensor = camera(str(source), size=(60, 80))
        seen = instance_of(sensor).scan()
        assert seen.depth.shape == (60, 80)
        intrinsics = ArenaView(ARENA, (60, 80)).intrinsics
        np.testing.assert_allclose(seen.ranges, depth_to_ranges(seen.depth, intrinsics))
    with pytest.raises(ValueError, match="unknown model 'no-such-run'"):
        camera("no-such-run")
    for make in (camera, objects):
        with pytest.raises(
            ValueError, match=r"=eldenet is a network without trained weights: give one of el"
        ):
            make("eldenet")  # random weights drove


def test_a_detectors_file_replaces_the_ideal_detector(tmp_path):
    from support.detector_files import FILES, WANTED, save

    path = save(tmp_path / "d.onnx", *FILES["yolov9"])
    config = compose(
        NavigateSettings, ["sensor=objects", "sensor.checkpoint=null", f"sensor.detector={path}"]
    )
    sensor = instantiate(config.sensor)
    assert sensor.sources["detector"] == (str(path), path)
    scan = instance_of(sensor).scan()
    assert len(scan.boxes) == len(WANTED)  # those of the file, whatever the frame shows


def test_the_network_of_a_camera_is_told_the_robots_lens():
    predictor, size = canonical_predictor(60, 80), (60, 80)
    seen = instance_of(Camera(predictor, size=size)).scan()
    intrinsics = ArenaView(ARENA, size).intrinsics
    np.testing.assert_array_equal(seen.depth, predictor(seen.image, intrinsics=intrinsics))
    assert not np.allclose(seen.depth, predictor(seen.image))


@pytest.mark.parametrize(
    "sensor", ["ranges", "objects", "depth_camera"]
)  # tests of the modes use noisy and camera
def test_sensors_of_the_configs_scan(sensor):
    config = compose(NavigateSettings, [f"sensor={sensor}"])
    instance = instantiate(config.sensor).begin(ArenaWorld(ARENA), np.random.default_rng(0))
    assert instance.scan().ranges.shape == (ROBOT.columns,)


@pytest.mark.parametrize("light", [0.0, -1.0, np.nan, np.inf, 1000.0])
def test_a_light_that_no_lamp_has_is_refused(light):
    for make in (camera, objects, depth_camera):
        with pytest.raises(ValueError, match=f"sensor.light={light}: give a factor above 0, up to 10"):
            make(light=light)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -0.1])
@pytest.mark.parametrize("make", [Ranges, NoisyRanges, camera])
def test_a_drift_that_is_no_deviation_is_refused(make, wrong):
    for name in ("distance", "heading"):
        with pytest.raises(
            ValueError, match=f"sensor.drift.{name}={wrong}: give a finite standard deviation"
        ):
            make(drift={name: wrong})


def test_the_environment_s_info_names_each_sector_s_source():
    pytest.importorskip("gymnasium")
    from eldenet.navigation.env import ArenaNavVectorEnv

    many = ArenaNavVectorEnv(2, sensor=objects(size=(36, 48)))
    many.reset(seed=0)
    assert many.step(np.array([2, 2]))[4]["fed_by"].shape == (2, 5)
    plain = ArenaNavVectorEnv(2)
    plain.reset(seed=0)
    assert "fed_by" not in plain.step(np.array([2, 2]))[4]


# --- errors ---


@pytest.fixture
def put_in() -> RangeErrors:
    return RangeErrors(
        (0.3, 1.0, 2.0, 3.0, 4.5, 6.5, 10.0),
        bias=(0.1, 0.05, 0.0, 0.0, -0.05, -0.1),
        spread=(0.08, 0.08, 0.1, 0.12, 0.15, 0.18),
        miss=(0.0, 0.0, 0.2, 0.3, 0.3, 0.3),
        scale=0.5, smooth=0.7, column=0.65, memory=0.7, far=(-0.2, 0.1),
    )  # fmt: skip


def test_errors_are_stored_in_a_small_file(tmp_path, put_in):
    path = tmp_path / "errors.json"
    put_in.write(path)
    assert path.stat().st_size < 4000
    assert RangeErrors.read(path) == put_in
    assert NoisyRanges(errors=str(path)).errors == put_in
    with pytest.raises(FileNotFoundError, match="no range errors"):
        RangeErrors.read(tmp_path / "none.json")
    path.write_text(json.dumps({"edges": [1]}))
    with pytest.raises(ValueError, match="not a valid file of range errors"):
        RangeErrors.read(path)


def test_a_missed_segment_is_replaced_by_its_farther_neighbor(put_in):
    ranges = np.concatenate([np.full(10, 5.0), np.full(6, 2.5), np.full(24, ROBOT.far)])
    assert segments(ranges).tolist() == [0] * 10 + [1] * 6 + [2] * 24
    rng, outcomes = np.random.default_rng(0), []
    for _ in range(600):
        out = without_missed(ranges, put_in, rng)
        assert (out[10:16] == 2.5).all() or (out[10:16] == ROBOT.far).all()
        assert (out >= ranges).all()
        outcomes.append(out[12] > 3)
    assert np.mean(outcomes) == pytest.approx(0.2, abs=0.04)


def test_sigma_says_how_near_things_may_be():
    exact = instance_of(Camera()).scan()
    assert exact.cautious is None
    photo = instance_of(Camera()).view.photo((0.0, 0.0, 0.0), 0.0, 0)
    doubtful = Camera(lambda _: DepthEstimate(photo.depth, 0.2 * photo.depth, "laplace"))
    scan = instance_of(doubtful).scan()
    seen = scan.ranges < ROBOT.far
    assert seen.any()
    low, _ = DepthEstimate(scan.ranges, 0.2 * scan.ranges, "laplace").interval(CAUTION)
    np.testing.assert_allclose(scan.cautious[seen], np.maximum(low[seen], ROBOT.near), rtol=1e-6)
    assert (scan.cautious[~seen] > 7).all()  # the floor stays the floor

"""From 2D boxes and depth to 3D boxes, in scenes whose boxes are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from eldenet.boxes import Detections2D, wrap_half
from eldenet.geometry import PinholeCamera, pinhole
from eldenet.perception import fit
from eldenet.perception.foreground import trusted_edges
from eldenet.perception.ground import GroundHomography, GroundPlane, fit_ground, flat_ground
from eldenet.perception.lifter import METHODS, BoxLifter, sigma_by_side
from eldenet.perception.priors import PRIORS, prior_of, silhouette
from eldenet.perception.scores import compare
from eldenet.simulation.street_views import render_street
from eldenet.simulation.streets import generate_scene

CAMERA = PinholeCamera(pinhole(400.0, 400.0, 320.0, 100.0))


@pytest.fixture(scope="module")
def views():
    return [render_street("test", index, (192, 624)) for index in range(4)]


def clear(view) -> np.ndarray:
    tall = view.detections.xyxy[:, 3] - view.detections.xyxy[:, 1]
    return np.nonzero((view.visible > 0.6) & ~view.truncated & (tall > 15))[0]


def block(center, size=(3.9, 1.6, 1.5), yaw=0.4, camera=CAMERA, shape=(240, 640), height=1.6):
    """Depth and 2D box of one block on flat ground, by slabs: no renderer of ours."""
    rows, columns = np.indices(shape)
    rays = camera.back_project(columns, rows, np.ones(shape)) - camera.translation
    with np.errstate(divide="ignore"):
        depth = np.where(rays[..., 1] > 1e-6, height / rays[..., 1], 0.0)
    depth[depth > 80] = 0
    along, across = np.array([np.cos(yaw), 0, -np.sin(yaw)]), np.array([np.sin(yaw), 0, np.cos(yaw)])
    axes, half = np.stack([along, across, [0, 1.0, 0]]), np.array(size) / 2
    start, way = -axes @ np.array(center), rays @ axes.T
    with np.errstate(divide="ignore", invalid="ignore"):
        enter = np.minimum((half - start) / way, (-half - start) / way).max(-1)
        leave = np.maximum((half - start) / way, (-half - start) / way).min(-1)
    hit = (enter < leave) & (enter > 0)
    depth[hit] = enter[hit]
    r, c = np.nonzero(hit)
    xyxy = np.array([[c.min(), r.min(), c.max(), r.max()]], float)
    return depth, xyxy


def detection(xyxy, name="car", style="projected") -> Detections2D:
    return Detections2D(xyxy, np.ones(len(xyxy)), np.zeros(len(xyxy), np.int64), (name,), style)


# --- scenes ---


def test_scenes_are_the_same_every_time_and_differ_by_split():
    first, again, other = (generate_scene(split, 0) for split in ("train", "train", "val"))
    assert first.room.text == again.room.text != other.room.text
    with pytest.raises(ValueError, match="split"):
        generate_scene("all", 0)


def test_known_boxes_hold_their_pixels(views):
    """Every pixel of an object lies in its box, and the box is no larger than needed."""
    for view in views:
        rows, columns = np.indices(view.depth.shape)
        points = view.camera.back_project(columns, rows, view.depth)
        for number in clear(view)[:6]:
            mine = points[view.instance == number]
            box = view.boxes[int(number)]
            turn = np.array(
                [[np.cos(box.yaw), 0, -np.sin(box.yaw)], [np.sin(box.yaw), 0, np.cos(box.yaw)], [0, 1, 0]]
            )
            inside = np.abs((mine - box.center) @ turn.T) - box.size / 2
            # boxes stand upright in a camera frame that is tilted by up to a degree
            assert inside.max() < 0.02 + 0.018 * box.size.max()
            xyxy = view.detections.xyxy[number]
            drawn = np.nonzero(view.instance == number)
            np.testing.assert_allclose(xyxy, [drawn[1].min(), drawn[0].min(), drawn[1].max(), drawn[0].max()])


def neighbours(view, number: int) -> set[int]:
    """Objects that stand nearer right beside the pixels of one."""
    mine = view.instance == number
    beside = cv2.dilate(mine.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool) & (view.instance >= 0)
    near = view.depth < np.median(view.depth[mine])
    return set(view.instance[beside & near & ~mine].tolist())


def test_visibility_is_one_for_what_stands_free():
    free, hidden, touching, inside = [], [], [], []
    for index in range(6):
        view = render_street("val", index, (120, 160), "hall")
        for number in range(len(view.boxes)):
            rows, columns = np.nonzero(view.instance == number)
            if len(rows) < 300:  # visibility counts every 16th pixel
                continue
            at_border = bool(
                rows.min() == 0 or columns.min() == 0 or rows.max() == 119 or columns.max() == 159
            )
            alone = not neighbours(view, number)
            if alone:
                (touching if at_border else inside).append(view.truncated[number])
            if not view.truncated[number]:
                (free if alone else hidden).append(view.visible[number])
    assert min(len(free), len(inside), len(touching)) > 3
    assert min(free) > 0.85
    assert max(free) <= 1
    assert min(hidden) < 0.6
    assert np.mean(touching) > 0.8
    assert not any(inside)


# --- what the methods reach ---


def test_refine_finds_most_boxes_and_beats_the_others(views):
    pairs = {}
    for method in METHODS:
        lifter = BoxLifter(method, depth_sigma=0.02, camera_height=1.65)
        parts = []
        for view in views:
            boxes = lifter(view.depth, view.detections, view.camera)
            numbers = clear(view)
            parts.append(compare(view.boxes, boxes, numbers, numbers))
        pairs[method] = type(parts[0]).join(parts)
    assert len(pairs["refine"]) > 20
    accuracy = {method: part.accuracy.mean() for method, part in pairs.items()}
    assert accuracy["refine"] > 0.97
    assert (pairs["refine"].iou > 0.5).mean() > 0.8
    assert accuracy["refine"] > accuracy["paper"]
    assert accuracy["refine"] > accuracy["no_depth"] > 0.7


@pytest.mark.parametrize("yaw", [-1.2, -0.4, 0.0, 0.3, 0.8, 1.5])
@pytest.mark.parametrize("center", [(-3.0, 0.85, 9.0), (1.5, 0.85, 14.0)])
def test_a_block_is_found_exactly(center, yaw):
    depth, xyxy = block(center, yaw=yaw)
    priors = PRIORS | {"car": replace(PRIORS["car"], shape="box")}
    boxes = BoxLifter("refine", depth_sigma=0.01, priors=priors)(depth, detection(xyxy), CAMERA)
    assert np.linalg.norm(boxes.center[0] - center) < 0.15
    assert abs(wrap_half(boxes.yaw[0] - yaw)) < np.radians(3)
    assert boxes.quality["depth_scale"][0] == pytest.approx(1, abs=0.01)


def test_a_wrong_depth_scale_is_seen_and_mended():
    center = (-2.0, 0.85, 12.0)
    depth, xyxy = block(center)
    priors = PRIORS | {"car": replace(PRIORS["car"], shape="box")}
    wrong = {
        method: BoxLifter(method, depth_sigma=0.1, priors=priors, ground=flat_ground(1.6))(
            depth * 1.1, detection(xyxy), CAMERA
        )
        for method in ("refine", "lshape")
    }
    error = {name: np.linalg.norm(boxes.center[0] - center) for name, boxes in wrong.items()}
    assert error["refine"] < 0.6 * error["lshape"]
    assert wrong["refine"].quality["depth_scale"][0] < 0.96


def test_small_objects_trust_their_depth_less():
    """30 pixels wide, its own depth a fifth too far: with ``small_sigma`` ground and size win."""
    center = (-2.0, 0.85, 45.0)
    depth, xyxy = block(center)
    near = (slice(int(xyxy[0, 1]), int(xyxy[0, 3]) + 1), slice(int(xyxy[0, 0]), int(xyxy[0, 2]) + 1))
    depth[near] = np.where(np.abs(depth[near] - 45) < 4, depth[near] * 1.2, depth[near])
    options = {"depth_sigma": 0.02, "ground": flat_ground(1.6)}
    trusting, careful = (
        BoxLifter(small_sigma=small, **options)(depth, detection(xyxy), CAMERA) for small in (None, 0.4)
    )
    assert abs(careful.center[0, 2] - 45) < 0.6 * abs(trusting.center[0, 2] - 45)


def test_the_cameras_height_mends_a_depth_map_of_wrong_scale():
    """Ground and object are both too far by 15 %: only the height that is known tells."""
    center = (-2.0, 0.85, 12.0)
    depth, xyxy = block(center)
    errors = []
    for height in (None, 1.6):
        boxes = BoxLifter(depth_sigma=0.1, camera_height=height)(depth * 1.15, detection(xyxy), CAMERA)
        errors.append(np.linalg.norm(boxes.center[0] - center))
    assert errors[1] < 0.95 * errors[0]  # equal if the height were not used


def test_a_mirrored_picture_gives_mirrored_boxes():
    center = (-2.0, 0.85, 12.0)
    depth, xyxy = block(center)
    mirrored = xyxy.copy()
    mirrored[:, [0, 2]] = 639 - xyxy[:, [2, 0]]
    flipped = pinhole(400.0, 400.0, 639 - 320.0, 100.0)
    lifter = BoxLifter(depth_sigma=0.02)
    plain = lifter(depth, detection(xyxy), CAMERA)
    other = lifter(depth[:, ::-1].copy(), detection(mirrored), PinholeCamera(flipped))
    np.testing.assert_allclose(other.center[0] * [-1, 1, 1], plain.center[0], atol=0.08)
    assert abs(wrap_half(other.yaw[0] + plain.yaw[0])) < np.radians(3)


def test_a_tilted_camera_in_a_level_frame_gives_the_same_box():
    center, pitch = (-2.0, 0.85, 12.0), 0.12
    c, s = np.cos(pitch), np.sin(pitch)
    camera = PinholeCamera(CAMERA.intrinsics, np.array([[1, 0, 0], [0, c, -s], [0, s, c]]).T)
    depth, xyxy = block(center, camera=camera)
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy), camera)
    assert np.linalg.norm(boxes.center[0] - center) < 0.25


def test_paper_is_the_mean_of_the_extents():
    """Equations 1 to 3 by hand."""
    depth = np.zeros((60, 80))
    depth[20:40, 30:50] = 5.0
    camera = PinholeCamera(pinhole(100, 100, 40, 30))
    boxes = BoxLifter("paper", ground=None)(depth, detection(np.array([[30, 20, 49, 39.0]])), camera)
    x, y = (np.array([30, 49]) - 40) / 100 * 5, (np.array([20, 39]) - 30) / 100 * 5
    np.testing.assert_allclose(boxes.center[0], [x.mean(), y.mean(), 5.0], atol=0.06)
    np.testing.assert_allclose(boxes.size[0, [0, 2]], [np.ptp(x), np.ptp(y)], atol=0.06)
    assert boxes.yaw[0] == 0


# --- two cars, one before the other ---


def test_the_hidden_car_is_not_taken_for_the_one_before_it():
    near, box_near = block((0.3, 0.85, 9.0), yaw=1.5)
    far, box_far = block((1.6, 0.85, 17.0), yaw=1.5)
    depth = np.where((near > 0) & ((near < far) | (far == 0)), near, far)
    found = detection(np.concatenate([box_near, box_far]))
    boxes = BoxLifter(depth_sigma=0.02)(depth, found, CAMERA)
    assert boxes.center[1, 2] == pytest.approx(17, abs=1.0)
    blind = BoxLifter("lshape", depth_sigma=0.02, occlusion_mask=False)(depth, found, CAMERA)
    assert abs(boxes.center[1, 2] - 17) <= abs(blind.center[1, 2] - 17)
    assert boxes.quality["occluded"][1] > 0.1 > boxes.quality["occluded"][0]


def test_an_edge_where_a_nearer_box_begins_is_no_edge():
    """A pillar behind a car: its box ends where the roof begins, and the boxes share no pixel."""
    boxes = np.array([[300.0, 60, 312, 149], [250, 150, 380, 210]])
    found = Detections2D(boxes, np.ones(2), np.array([1, 0]), ("car", "pillar"))
    trusted, hidden = trusted_edges(found, (240, 640))
    np.testing.assert_array_equal(trusted, [[True, True, True, False], [True] * 4])
    assert hidden[0] == 0
    apart = replace(found, xyxy=boxes + np.array([[0, 0, 0, -10.0], [0, 0, 0, 0]]))
    assert trusted_edges(apart, (240, 640))[0].all()
    projected = replace(found, box_style="projected")
    assert trusted_edges(projected, (240, 640))[0].all()


def test_the_depth_error_grows_as_objects_shrink():
    boxes = np.array(
        [[0, 0, 300, 100.0], [0, 0, 10, 50], [0, 0, 32, 31.622777], [0, 0, 1, 1], [0, 0, 9e3, 9e3]]
    )
    sigma = sigma_by_side(boxes, 0.06, 0.24)
    np.testing.assert_allclose(sigma[:3], [0.06, 0.24, 0.12], rtol=1e-6)
    np.testing.assert_allclose(sigma[3:], [0.24 * 2**0.60206, 0.06], rtol=1e-3)  # below half of SMALL alike
    np.testing.assert_allclose(sigma_by_side(boxes, 0.06, None), 0.06)


@pytest.mark.parametrize("size", [(8.5, 2.5, 3.1), (5.2, 1.9, 1.9)])
def test_a_truck_is_a_lorry_or_a_pick_up(size):
    depth, xyxy = block((-2.0, 1.6 - size[2] / 2, 18.0), size=size, yaw=1.3)
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy, "truck"), CAMERA)
    np.testing.assert_allclose(boxes.size[0], size, rtol=0.2)
    assert len(boxes) == 1


@pytest.mark.parametrize("cut", ["left", "right", "bottom"])
def test_a_car_cut_by_the_border(cut):
    center = {"left": (-4.6, 0.85, 7.0), "right": (4.6, 0.85, 7.0), "bottom": (0.4, 0.85, 4.2)}[cut]
    depth, xyxy = block(center, yaw=1.4)
    limit = {"left": xyxy[0, 0] <= 1, "right": xyxy[0, 2] >= 638, "bottom": xyxy[0, 3] >= 238}[cut]
    assert limit
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy), CAMERA)
    assert boxes.quality["truncated"][0] == 1
    assert np.linalg.norm(boxes.center[0] - center) < 1.0
    assert np.linalg.norm(boxes.size[0] - [3.9, 1.6, 1.5]) < 1.2


# --- what may go wrong ---


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("fill", [0.0, np.nan, -1.0, np.inf])
def test_without_depth_a_box_still_comes_out(method, fill):
    _, xyxy = block((-2.0, 0.85, 12.0))
    depth = np.full((240, 640), fill)
    boxes = BoxLifter(method, camera_height=1.6)(depth, detection(xyxy), CAMERA)
    assert np.isfinite(boxes.corners).all()
    assert boxes.center[0, 2] == pytest.approx(12, rel=0.2)
    assert boxes.quality["points"][0] == 0
    assert boxes.quality["fallback"][0] == 1


@pytest.mark.parametrize("method", METHODS)
def test_holes_in_the_depth_are_unknown_whatever_they_hold(method):
    depth, xyxy = block((-2.0, 0.85, 12.0))
    results = []
    for fill in (0.0, np.nan, -3.0, np.inf):
        holed = depth.copy()
        holed[::3] = fill
        results.append(BoxLifter(method, camera_height=1.6)(holed, detection(xyxy), CAMERA))
    for other in results[1:]:
        np.testing.assert_allclose(other.corners, results[0].corners)


@pytest.mark.parametrize("method", METHODS)
def test_no_boxes_five_hundred_boxes_and_tiny_ones(method):
    depth, _ = block((-2.0, 0.85, 12.0))
    lifter = BoxLifter(method)
    none = lifter(depth, Detections2D.empty(("car",)), CAMERA)
    assert len(none) == 0
    assert none.corners.shape == (0, 8, 3)
    rng = np.random.default_rng(0)
    corner = rng.uniform(0, [600, 200], (500, 2))
    many = detection(np.concatenate([corner, corner + rng.uniform(0, 40, (500, 2))], 1))
    boxes = lifter(depth, many, CAMERA)
    assert len(boxes) == 500
    assert np.isfinite(boxes.corners).all()
    assert (boxes.size > 0).all()


def test_an_unknown_class_keeps_the_extents_of_its_points():
    depth, xyxy = block((-2.0, 0.85, 12.0), size=(2.0, 2.0, 1.4), yaw=0.7)
    boxes = BoxLifter()(depth, detection(xyxy, "gizmo"), CAMERA)
    assert boxes.quality["fallback"][0] == 1
    assert 1.2 < boxes.size[0, 0] < 2.3
    assert 1.0 < boxes.size[0, 2] < 1.8
    assert np.linalg.norm(boxes.center[0] - (-2.0, 0.85, 12.0)) < 0.9


def test_masks_are_used_instead_of_boxes():
    near, _ = block((0.3, 0.85, 9.0), yaw=1.5)
    far, box_far = block((1.2, 0.85, 17.0), yaw=1.5)
    depth = np.where((near > 0) & ((near < far) | (far == 0)), near, far)
    hidden = replace(detection(box_far), mask=(depth == far)[None] & (far < 25)[None] & (far > 14)[None])
    boxes = BoxLifter(depth_sigma=0.02)(depth, hidden, CAMERA)
    assert boxes.center[0, 2] == pytest.approx(17, abs=1.2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "method"),
        ({"ground": 3}, "ground"),
        ({"camera_height": 0}, "camera_height"),
        ({"depth_sigma": 0}, "depth_sigma"),
        ({"small_sigma": 1.5}, "small_sigma"),
    ],
)
def test_settings_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        BoxLifter(**options)


def test_boxes_of_a_larger_picture_are_refused():
    _, xyxy = block((-2.0, 0.85, 12.0))
    with pytest.raises(ValueError, match="one picture"):
        BoxLifter()(np.ones((60, 160)), detection(xyxy), CAMERA)
    with pytest.raises(ValueError, match="shape"):
        BoxLifter()(np.ones((1, 60, 160)), detection(xyxy), CAMERA)


def test_masks_of_another_size_are_refused_and_millimetres_noticed():
    depth, xyxy = block((-2.0, 0.85, 12.0))
    masked = replace(detection(xyxy), mask=np.ones((1, 120, 320), bool))
    with pytest.raises(ValueError, match="masks"):
        BoxLifter()(depth, masked, CAMERA)
    with pytest.warns(UserWarning, match="millimetres"):
        BoxLifter()(depth * 1000, detection(xyxy), CAMERA)


# --- the fit's derivatives ---


def test_gradients_are_those_of_the_cost():
    rng = np.random.default_rng(0)
    count, points = 6, 40
    direction = np.concatenate([rng.uniform(-0.4, 0.4, (count, points, 2)), np.ones((count, points, 1))], -1)
    problem = fit.Problem(
        direction, rng.uniform(8, 14, (count, points)), np.ones((count, points)), np.full((count, 2), 0.4),
        np.linspace(0.6, 1, count), np.tile([250.0, 80, 330, 140], (count, 1)), np.full((count, 4), 4.0),
        rng.random((count, 4)) > 0.4, np.tile(silhouette("vehicle", "tight"), (count, 1, 1)),
        np.log(np.tile([3.9, 1.6, 1.5], (count, 1))), np.full((count, 3), 0.1),
        np.tile([1.6, 0.01, -0.02], (count, 1)),
        np.full(count, 0.1), np.full(count, 0.08),
    )  # fmt: skip
    state = np.tile([0.3, 10.0, 1.5, 0.4, *np.log([3.9, 1.6, 1.5]), 0.02], (count, 1)) + rng.normal(
        0, 0.05, (count, 8)
    )
    camera = PinholeCamera(CAMERA.intrinsics, np.eye(3), np.array([0.05, 0.02, 0.01]))
    model = fit.linearise(problem, camera, state)
    for unknown in range(fit.UNKNOWNS):
        step = np.zeros(fit.UNKNOWNS)
        step[unknown] = 1e-6
        high, low = (fit.linearise(problem, camera, state + sign * step).cost for sign in (1, -1))
        np.testing.assert_allclose(model.gradient[:, unknown], (high - low) / 2e-6, rtol=2e-3, atol=2e-3)


# --- ground ---


def test_ground_is_found_beside_walls_and_objects(views):
    for view in views:
        plane = fit_ground(view.depth, view.camera)
        assert plane is not None
        assert plane.offset == pytest.approx(view.height, abs=0.05)
        assert plane.normal[1] > 0.999


@pytest.mark.parametrize("turn", [np.pi, np.pi / 2])
def test_ground_is_found_whatever_way_the_camera_looks(turn):
    depth, _ = block((30.0, 0.85, 70.0))
    c, s = np.cos(turn), np.sin(turn)
    camera = PinholeCamera(CAMERA.intrinsics, np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]))
    plane = fit_ground(depth, camera)
    assert plane is not None
    assert plane.offset == pytest.approx(1.6, abs=0.02)


def test_no_ground_where_there_is_none():
    wall = np.full((100, 100), 3.0)
    assert fit_ground(wall, PinholeCamera(pinhole(90, 90, 50, 50))) is None
    assert fit_ground(np.zeros((100, 100)), CAMERA) is None
    with pytest.raises(ValueError, match="no ground"):
        GroundHomography.from_depth(wall, PinholeCamera(pinhole(90, 90, 50, 50)))


def test_the_plane_homography_is_back_projection_with_the_planes_depth():
    normal = np.array([0.03, 1.0, -0.05])
    plane = GroundPlane(normal / np.linalg.norm(normal), 1.6)
    camera = PinholeCamera(CAMERA.intrinsics, np.eye(3), np.array([0.06, 0.01, -0.02]))
    ground = GroundHomography(camera, plane)
    columns, rows = np.meshgrid(np.arange(0.0, 640, 40), np.arange(140.0, 240, 20))
    points = camera.back_project(columns, rows, ground.depth(columns, rows))
    np.testing.assert_allclose(plane.below(points), 0, atol=1e-12)
    np.testing.assert_allclose(ground.to_ground(columns, rows), points[..., [0, 2]], atol=1e-9)


def test_from_calibration_and_from_depth_agree():
    depth, _ = block((30.0, 0.85, 70.0))
    fitted = GroundHomography.from_depth(depth, CAMERA)
    known = GroundHomography.from_camera(CAMERA, 1.6)
    columns, rows = np.array([100.0, 320, 500]), np.array([150.0, 180, 220])
    np.testing.assert_allclose(
        fitted.to_ground(columns, rows), known.to_ground(columns, rows), rtol=1e-3, atol=1e-3
    )
    assert np.isnan(known.to_ground(np.array([320.0]), np.array([50.0]))).all()


def test_the_view_from_above_puts_a_mark_where_it_lies():
    camera = CAMERA
    image = np.zeros((240, 640, 3), np.uint8)
    spot = camera.project(np.array([[1.0, 1.6, 10.0]]))[0]
    column, row = np.rint(spot).astype(int)
    image[row - 1 : row + 2, column - 2 : column + 3] = 255
    above = GroundHomography.from_camera(camera, 1.6).warp(image, across=(-5, 5), ahead=(5, 15), cell=0.05)
    assert above.shape == (200, 200, 3)
    rows, columns = np.nonzero(above[..., 0] > 100)
    assert columns.mean() * 0.05 - 5 == pytest.approx(1.0, abs=0.1)
    assert 15 - rows.mean() * 0.05 == pytest.approx(10.0, abs=0.35)


def test_the_ground_behind_the_camera_is_not_seen_from_above():
    image = np.full((240, 640, 3), 200, np.uint8)
    known = GroundHomography.from_camera(CAMERA, 1.6)
    above = known.warp(image, across=(-5, 5), ahead=(-15, 15), cell=0.1)
    assert (above[:100] == 200).any()
    assert not above[150:].any()


# --- priors ---


def test_priors_go_by_name():
    assert prior_of("Car") is prior_of("car") is PRIORS["car"]
    assert prior_of("gizmo") is None
    for shape in ("vehicle", "upright", "box", None):
        for style in ("tight", "projected"):
            assert np.abs(silhouette(shape, style)).max() == 0.5

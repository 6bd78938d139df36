"""From 2D boxes and depth to 3D boxes, in scenes with known boxes."""

from dataclasses import replace

import numpy as np
import pytest
from support.blocks import CAMERA, block, clear, detection

from eldenet.boxes import Detections2D, wrap_half
from eldenet.geometry import PinholeCamera, pinhole
from eldenet.perception.ground import flat_ground
from eldenet.perception.lifter import METHODS, NETWORK_SIGMA, SENSOR_SIGMA, BoxLifter
from eldenet.perception.matching_metrics import compare
from eldenet.perception.priors import PRIORS
from eldenet.uncertainty import DepthEstimate, deviations


def test_refine_finds_most_boxes_and_beats_the_other_methods(views):
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
def test_the_box_of_a_block_is_found_exactly(center, yaw):
    depth, xyxy = block(center, yaw=yaw)
    priors = PRIORS | {"car": replace(PRIORS["car"], shape="box")}
    boxes = BoxLifter("refine", depth_sigma=0.01, priors=priors)(depth, detection(xyxy), CAMERA)
    assert np.linalg.norm(boxes.center[0] - center) < 0.15
    assert abs(wrap_half(boxes.yaw[0] - yaw)) < np.radians(3)
    assert boxes.quality["depth_scale"][0] == pytest.approx(1, abs=0.01)


def test_refine_corrects_a_wrong_depth_scale():
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


def test_the_depth_of_small_objects_weighs_less_with_small_sigma():
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


@pytest.mark.parametrize(("sigma", "follows"), [(0.1, True), (0.15, False)])
def test_the_unsure_depth_of_a_person_is_not_followed(sigma, follows):
    """Its pixels show the background 40 % farther: only a depth that claims to be sure moves the box."""
    size = PRIORS["person"].size
    depth, xyxy = block((0.0, 1.6 - size[2] / 2, 15.0), size=size)
    rows, columns = np.indices(depth.shape)
    inside = (rows > xyxy[0, 1]) & (rows < xyxy[0, 3]) & (columns > xyxy[0, 0]) & (columns < xyxy[0, 2])
    behind = np.where(inside & (np.abs(depth - 15) < 1), depth * 1.4, depth)
    estimate = DepthEstimate(behind, sigma * behind, "laplace")
    boxes = BoxLifter(ground=flat_ground(1.6))(estimate, detection(xyxy, "person"), CAMERA)
    assert (boxes.center[0, 2] > 15.5) == follows


def test_the_camera_height_corrects_a_depth_map_of_wrong_scale():
    """Ground and object are both 15 % too far: only the known height shows it."""
    center = (-2.0, 0.85, 12.0)
    depth, xyxy = block(center)
    errors = []
    for height in (None, 1.6):
        boxes = BoxLifter(depth_sigma=0.1, camera_height=height)(depth * 1.15, detection(xyxy), CAMERA)
        errors.append(np.linalg.norm(boxes.center[0] - center))
    assert errors[1] < 0.95 * errors[0]  # equal if the height were not used


def test_a_mirrored_image_gives_mirrored_boxes():
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


@pytest.mark.parametrize("method", METHODS)
def test_a_camera_elsewhere_in_the_level_frame_moves_the_boxes_by_as_much(method):
    depth, xyxy = block((0.0, 0.85, 14.0), yaw=1.5)
    place = np.array([-12.0, 0.0, -30.0])
    here, there = (
        BoxLifter(method, depth_sigma=0.02, ground=flat_ground(1.6))(depth, detection(xyxy), camera)
        for camera in (CAMERA, PinholeCamera(CAMERA.intrinsics, translation=place))
    )
    np.testing.assert_allclose(there.center[0] - place, here.center[0], atol=0.05)
    assert abs(wrap_half(there.yaw[0] - here.yaw[0])) < np.radians(1)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("height", [None, 1.6])
@pytest.mark.parametrize("up", [1.6, 3.0, -3.0])
def test_a_camera_above_the_origin_of_the_level_frame_finds_the_same_ground(method, height, up):
    """With the origin on the ground (1.6), below it (3.0), or high above (-3.0); y points down."""
    if method == "no_depth" and height is None:
        pytest.skip("nothing tells the ground")
    depth, xyxy = block((-2.0, 0.85, 12.0), yaw=0.4)
    place = np.array([0.0, -up, 1.5])
    here, there = (
        BoxLifter(method, depth_sigma=0.1, camera_height=height)(depth, detection(xyxy), camera)
        for camera in (CAMERA, PinholeCamera(CAMERA.intrinsics, translation=place))
    )
    np.testing.assert_allclose(there.center[0] - place, here.center[0], atol=1e-3)
    np.testing.assert_allclose(there.quality["cost"], here.quality["cost"], atol=1e-3)


def test_the_paper_method_is_the_mean_of_the_extents():
    """Equations 1 to 3 by hand."""
    depth = np.zeros((60, 80))
    depth[20:40, 30:50] = 5.0
    camera = PinholeCamera(pinhole(100, 100, 40, 30))
    boxes = BoxLifter("paper", ground=None)(depth, detection(np.array([[30, 20, 49, 39.0]])), camera)
    x, y = (np.array([30, 49]) - 40) / 100 * 5, (np.array([20, 39]) - 30) / 100 * 5
    np.testing.assert_allclose(boxes.center[0], [x.mean(), y.mean(), 5.0], atol=0.06)
    np.testing.assert_allclose(boxes.size[0, [0, 2]], [np.ptp(x), np.ptp(y)], atol=0.06)
    assert boxes.yaw[0] == 0


# --- missing, cut, hidden, unknown and wrong inputs ---


def two_cars(x: float):
    """Depth with a car and one behind it at ``x``; their boxes; the visible pixels of the second."""
    near, box_near = block((0.3, 0.85, 9.0), yaw=1.5)
    far, box_far = block((x, 0.85, 17.0), yaw=1.5)
    depth = np.where((near > 0) & ((near < far) | (far == 0)), near, far)
    return depth, box_near, box_far, (depth == far) & (far < 25) & (far > 14)


def test_a_hidden_car_is_not_mistaken_for_the_one_in_front():
    depth, box_near, box_far, _ = two_cars(1.6)
    found = detection(np.concatenate([box_near, box_far]))
    boxes = BoxLifter(depth_sigma=0.02)(depth, found, CAMERA)
    assert boxes.center[1, 2] == pytest.approx(17, abs=1.0)
    blind = BoxLifter("lshape", depth_sigma=0.02, occlusion_mask=False)(depth, found, CAMERA)
    assert abs(boxes.center[1, 2] - 17) <= abs(blind.center[1, 2] - 17)
    assert boxes.quality["occluded"][1] > 0.1 > boxes.quality["occluded"][0]


@pytest.mark.parametrize("size", [(8.5, 2.5, 3.1), (5.2, 1.9, 1.9)])
def test_a_truck_is_fitted_as_a_box_truck_or_a_pick_up(size):
    depth, xyxy = block((-2.0, 1.6 - size[2] / 2, 18.0), size=size, yaw=1.3)
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy, "truck"), CAMERA)
    np.testing.assert_allclose(boxes.size[0], size, rtol=0.2)
    assert len(boxes) == 1


@pytest.mark.parametrize("cut", ["left", "right", "bottom"])
def test_a_car_cut_by_the_image_border_keeps_its_size_and_place(cut):
    center = {"left": (-4.6, 0.85, 7.0), "right": (4.6, 0.85, 7.0), "bottom": (0.4, 0.85, 4.2)}[cut]
    depth, xyxy = block(center, yaw=1.4)
    assert {"left": xyxy[0, 0] <= 1, "right": xyxy[0, 2] >= 638, "bottom": xyxy[0, 3] >= 238}[cut]
    boxes = BoxLifter(depth_sigma=0.02)(depth, detection(xyxy), CAMERA)
    assert boxes.quality["truncated"][0] == 1
    assert np.linalg.norm(boxes.center[0] - center) < 1.0
    assert np.linalg.norm(boxes.size[0] - [3.9, 1.6, 1.5]) < 1.2


@pytest.mark.parametrize("method", METHODS)
def test_boxes_without_known_depth_come_from_class_sizes(method):
    _, xyxy = block((-2.0, 0.85, 12.0))
    depth = np.zeros((240, 640))
    with pytest.warns(UserWarning, match="no pixel of the depth is known"):
        boxes = BoxLifter(method, camera_height=1.6)(depth, detection(xyxy), CAMERA)
    assert np.isfinite(boxes.corners).all()
    assert boxes.center[0, 2] == pytest.approx(12, rel=0.2)
    assert boxes.quality["points"][0] == 0
    assert boxes.quality["fallback"][0] == (method != "no_depth")


@pytest.mark.parametrize("xyxy", [(452, 86, 639, 479), (309, 100, 639, 479), (0, 129, 222, 479)])
@pytest.mark.parametrize("method", ["refine", "no_depth"])
def test_what_is_close_and_cut_by_the_border_is_not_put_behind_the_camera(method, xyxy):
    """A cyclist 1.5 m away: three of the four edges of such a box are bounds only."""
    camera = PinholeCamera(pinhole(500.0, 500.0, 319.5, 239.5))
    found = detection(np.array([xyxy], float), "cyclist", "tight")
    with pytest.warns(UserWarning, match="no pixel of the depth is known"):
        boxes = BoxLifter(method, camera_height=1.5)(np.zeros((480, 640)), found, camera)
    assert 0.5 < boxes.center[0, 2] < 3.0


def test_a_box_whose_distance_nothing_tells_is_doubtful():
    depth, xyxy = block((-2.0, 0.85, 12.0))
    boxes = [
        BoxLifter(method)(depth, detection(xyxy, name), CAMERA)
        for method, name in (("no_depth", "pallet"), ("no_depth", "car"), ("refine", "pallet"))
    ]
    assert [bool(one.doubtful[0]) for one in boxes] == [True, False, False]


@pytest.mark.parametrize("method", METHODS)
def test_zero_nan_negative_and_infinite_depth_are_all_unknown(method):
    depth, xyxy = block((-2.0, 0.85, 12.0))
    results = []
    for fill in (0.0, np.nan, -3.0, np.inf):
        holed = depth.copy()
        holed[::3] = fill
        results.append(BoxLifter(method, camera_height=1.6)(holed, detection(xyxy), CAMERA))
    for other in results[1:]:
        np.testing.assert_allclose(other.corners, results[0].corners)


def known_at(depth, xyxy, count: int, seed: int = 0):
    """The same depth map, but only ``count`` pixels of the box are known in it."""
    rng = np.random.default_rng(seed)
    left, top, right, bottom = np.round(xyxy[0]).astype(int)
    rows, columns = np.nonzero(np.abs(depth[top:bottom, left:right] - 40) < 4)
    chosen = rng.permutation(len(rows))[:count]
    sparse = depth.copy()
    sparse[top - 1 : bottom + 1, left - 1 : right + 1] = 0
    sparse[rows[chosen] + top, columns[chosen] + left] = depth[rows[chosen] + top, columns[chosen] + left]
    return sparse


@pytest.mark.parametrize("count", [1, 2, 6, 20, 39])
def test_depth_of_few_pixels_is_weighed_like_that_of_many(count):
    """A car 40 m away, its own depth 12 % too far: height and size pull it back, few points or many."""
    depth, xyxy = block((-2.0, 0.85, 40.0))
    found = []
    for known in (count, 10**6):
        sparse = known_at(depth, xyxy, known)
        wrong = np.where(np.abs(sparse - 40) < 4, sparse * 1.12, sparse)
        lifter = BoxLifter(depth_sigma=0.12, ground=flat_ground(1.6))
        found.append(lifter(wrong, detection(xyxy), CAMERA))
    few, many = found
    assert 0 < few.quality["points"][0] <= count < 40 < many.quality["points"][0]
    assert abs(many.center[0, 2] - 40) < 1.6  # a third of the error
    assert abs(few.center[0, 2] - 40) < 1.6


@pytest.mark.parametrize("method", METHODS)
def test_no_boxes_many_boxes_and_tiny_boxes_are_lifted(method):
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
    boxes = BoxLifter(depth_sigma=0.05)(depth, detection(xyxy, "gizmo"), CAMERA)
    assert boxes.quality["fallback"][0] == 1
    assert 1.2 < boxes.size[0, 0] < 2.3
    assert 1.0 < boxes.size[0, 2] < 1.8
    assert np.linalg.norm(boxes.center[0] - (-2.0, 0.85, 12.0)) < 0.9


def test_a_hanging_object_is_not_stretched_to_the_ground():
    depth, xyxy = block((-2.0, -1.0, 12.0), size=(0.5, 0.5, 1.0), height=1.6)
    boxes = BoxLifter(camera_height=1.6)(depth, detection(xyxy, "traffic light"), CAMERA)
    assert boxes.size[0, 2] == pytest.approx(1.0, abs=0.2)
    assert boxes.center[0, 1] == pytest.approx(-1.0, abs=0.2)


def test_masks_are_used_instead_of_boxes():
    depth, _, box_far, visible = two_cars(1.2)
    hidden = replace(detection(box_far), mask=visible[None])
    boxes = BoxLifter(depth_sigma=0.02)(depth, hidden, CAMERA)
    assert boxes.center[0, 2] == pytest.approx(17, abs=1.2)
    twice = visible.repeat(2, axis=0).repeat(2, axis=1)
    for wrong in (twice[None], visible[None, ::2, ::2], visible[None].astype(np.float32)):
        with pytest.raises(ValueError, match=r"mask of .*: give bool .*size of the depth"):
            BoxLifter()(depth, replace(hidden, mask=wrong), CAMERA)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "method"),
        ({"camera_height": 0}, "camera_height"),
        ({"depth_sigma": 0}, "depth_sigma"),
        ({"small_sigma": 1.5}, "small_sigma"),
        ({"small_sigma": 0.3}, "small_sigma=0.3 without depth_sigma: give both"),
    ],
)
def test_settings_out_of_range_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        BoxLifter(**options)


def test_depth_and_boxes_of_different_images_or_units_are_refused():
    depth, xyxy = block((-2.0, 0.85, 12.0))
    for given, found, message in (
        (depth[:60, :160], xyxy, "box .*, but the depth is 60 x 160: .* for the same image"),
        (depth, xyxy - (2000, 0, 2000, 0), "box .*-.* for the same image"),
        ((1000 * depth).astype(np.uint16), xyxy, "type uint16: give meters"),
        (depth[None], xyxy, "shape"),
        (depth, xyxy / np.tile(depth.shape[::-1], 2), "give pixels, not shares of the picture"),
    ):
        with pytest.raises(ValueError, match=message):
            BoxLifter()(given, detection(found), CAMERA)
    with pytest.warns(UserWarning, match="millimeters"):
        BoxLifter()(depth * 1000, detection(xyxy), CAMERA)


def test_a_box_that_reaches_beyond_the_picture_counts_up_to_its_border():
    depth, xyxy = block((-2.0, 0.85, 12.0))
    width = depth.shape[1]
    cut, beyond = xyxy.copy(), xyxy.copy()
    cut[:, 2], beyond[:, 2] = width - 0.5, 1.2 * width
    first, second = (BoxLifter()(depth, detection(each), CAMERA) for each in (cut, beyond))
    np.testing.assert_array_equal(first.center, second.center)
    assert second.quality["truncated"].tolist() == [1.0]


def test_sigma_sets_the_interval_of_a_distance():
    depth, xyxy = block((0.0, 0.85, 12.0))
    found = {}
    for share in (0.05, 0.2):
        estimate = DepthEstimate(depth, share * depth, "laplace")
        found[share] = BoxLifter(ground=flat_ground(1.6))(estimate, detection(xyxy), CAMERA)[0]
    for share, box in found.items():
        factor = np.exp(deviations("laplace", 0.9) * share)
        assert box.interval == pytest.approx((box.distance / factor, box.distance * factor))
    assert BoxLifter()(depth, detection(xyxy), CAMERA)[0].interval is None
    blind = BoxLifter("no_depth", camera_height=1.6)(estimate, detection(xyxy), CAMERA)
    assert blind[0].interval is None  # sigma says nothing of a distance without depth
    with pytest.warns(UserWarning, match=r"depth_sigma=0\.1 is not used"):
        BoxLifter(depth_sigma=0.1)(estimate, detection(xyxy), CAMERA)


def test_the_interval_is_of_the_depth_from_the_camera_not_from_the_origin():
    depth, xyxy = block((0.0, 0.85, 12.0))
    estimate = DepthEstimate(depth, 0.1 * depth, "laplace")
    here, there = (
        BoxLifter()(estimate, detection(xyxy), PinholeCamera(CAMERA.intrinsics, translation=np.array(place)))
        for place in ((0.0, 0.0, 0.0), (0.0, -1.6, -6.0))
    )
    assert there[0].interval == pytest.approx(np.array(here[0].interval) - 6, abs=0.05)
    (near, far), own = here[0].interval, here[0].distance
    for back in (
        own - 0.01,
        own + 1,
        far + 3,
    ):  # the origin lies at the box or beyond, as seen from the camera
        camera = PinholeCamera(CAMERA.intrinsics, translation=np.array([0.0, -1.6, -back]))
        (box,) = BoxLifter()(estimate, detection(xyxy), camera)
        assert box.interval[0] <= box.distance <= box.interval[1]
        ends = sorted(abs(end - back) for end in (near, far))
        assert box.interval == pytest.approx((0.0 if near < back < far else ends[0], ends[1]), abs=0.05)


def test_intervals_of_distances_hold_their_share_of_objects():
    """The depth of each object is wrong by one factor, drawn from the distribution that sigma states."""
    center, spread, rng = (0.0, 0.85, 12.0), 0.15, np.random.default_rng(0)
    depth, xyxy = block(center)
    inside = []
    for error in rng.laplace(0, spread / np.sqrt(2), 60):
        wrong = depth * np.exp(error)
        estimate = DepthEstimate(wrong, spread * wrong, "laplace")
        box = BoxLifter("lshape", ground=flat_ground(1.6))(estimate, detection(xyxy), CAMERA)[0]
        low, high = box.interval
        inside.append(low <= np.hypot(center[0], center[2]) <= high)
    assert 0.8 <= np.mean(inside) <= 1.0


def test_certain_pixels_weigh_more():
    """The left half of the block shows a wrong depth, and sigma knows it."""
    depth, xyxy = block((0.0, 0.85, 10.0))
    wrong, spread = depth.copy(), np.full(depth.shape, 0.03)
    left = np.zeros(depth.shape, bool)
    left[:, : int(xyxy.ravel()[[0, 2]].mean())] = True
    wrong[left] *= 1.1
    errors = []
    for doubt in (0.03, 0.3):
        sigma = np.where(left, doubt, spread) * wrong
        boxes = BoxLifter(ground=flat_ground(1.6))(
            DepthEstimate(wrong, sigma, "laplace"), detection(xyxy), CAMERA
        )
        errors.append(abs(boxes[0].center[2] - 10.0))
    assert errors[1] < errors[0]


def test_the_depth_error_comes_from_the_depth():
    """A sparse map is a LiDAR's, a dense one a network's; what is given counts for both."""
    dense = np.ones((20, 30))
    sparse = np.where(np.arange(600).reshape(20, 30) % 9, 0, dense)
    assert BoxLifter().sigma_of(sparse) == SENSOR_SIGMA
    assert BoxLifter().sigma_of(dense) == NETWORK_SIGMA
    assert BoxLifter(depth_sigma=0.03, small_sigma=0.2).sigma_of(sparse) == (0.03, 0.2)


def test_a_box_whose_cues_contradict_each_other_is_doubtful():
    """The scan says 12 m, size and ground say 24 m."""
    center = (-2.0, 0.85, 24.0)
    depth, xyxy = block(center)
    lifter = BoxLifter(depth_sigma=0.01, ground=flat_ground(1.6))
    assert not lifter(depth, detection(xyxy), CAMERA).doubtful[0]
    assert lifter(depth / 2, detection(xyxy), CAMERA).doubtful[0]

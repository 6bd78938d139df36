"""Bags of ROS give pictures, their lens and odometry, or say in one line what is missing."""

import csv

import cv2
import numpy as np
import pytest
from support.bags import FORMATS, lens, odometry, picture, write_bag

from eldenet.data.bags import Bag, is_bag
from eldenet.geometry import pinhole

K = pinhole(110.0, 112.0, 31.5, 23.5)
SIZE = (48, 64)
IMAGES = np.random.default_rng(0).integers(0, 255, (3, *SIZE, 3), np.uint8)
START = 1_700_000_000.5


def walk(*more, topic: str = "/camera/image_raw") -> list:
    """Three pictures, their lens and as many poses."""
    messages = [lens(START, K, SIZE), *more]
    for number, image in enumerate(IMAGES):
        messages.append(picture(START + number / 8, image, topic))
        messages.append(odometry(START + number / 8, number, 0.5, 0.25))
    return messages


def compressed(when: float, image: np.ndarray, topic: str):
    fields = {"format": "rgb8; png compressed bgr8", "data": cv2.imencode(".png", image[..., ::-1])[1]}
    return when, topic, "sensor_msgs/msg/CompressedImage", fields


@pytest.mark.parametrize("form", FORMATS)
def test_a_bag_of_each_format_gives_pictures_lens_and_odometry(tmp_path, form):
    path = write_bag(tmp_path, walk(), form)
    assert is_bag(path)
    bag = Bag(path)
    assert bag.intrinsics == [110.0, 112.0, 31.5, 23.5]
    frames = list(bag.frames())
    assert [time for _, time in frames] == pytest.approx([START, START + 0.125, START + 0.25], abs=1e-6)
    assert (np.stack([image for image, _ in frames]) == IMAGES).all()
    with bag.write_odometry(None, tmp_path / "o.csv").open() as file:
        rows = [[float(cell) for cell in row.values()] for row in csv.DictReader(file)]
    assert rows == [pytest.approx([START + number / 8, number, 0.5, 0.25]) for number in range(3)]


def test_one_file_of_a_bag_is_a_bag(tmp_path):
    (file,) = write_bag(tmp_path, walk()).glob("*.mcap")
    assert is_bag(file)
    assert len(list(Bag(file).frames())) == 3


def test_compressed_pictures_and_those_beside_depth_are_found(tmp_path):
    small = IMAGES[0, ..., 0].astype(np.uint16)
    depth = [picture(START, small, "/camera/depth/image_rect_raw", "16UC1")]
    messages = [lens(START, K, SIZE), *depth, compressed(START, IMAGES[0], "/camera/image_raw/compressed")]
    bag = Bag(write_bag(tmp_path, messages))
    ((image, _),) = bag.frames()
    assert (image == IMAGES[0]).all()


def test_a_raw_topic_goes_before_its_compressed_copy(tmp_path):
    bag = Bag(write_bag(tmp_path, walk(compressed(START, 255 - IMAGES[0], "/camera/image_raw/compressed"))))
    assert (next(bag.frames())[0] == IMAGES[0]).all()


def test_pictures_of_a_bent_lens_are_straightened(tmp_path):
    """A grid that the lens bends comes back as a grid; rectified pictures stay as they are."""
    bend = (-0.3, 0.1, 0.0, 0.0, 0.0)
    columns, rows = np.meshgrid(np.arange(64, dtype=np.float32), np.arange(48, dtype=np.float32))
    seen = np.stack([columns, rows], -1).reshape(-1, 1, 2)
    at = cv2.undistortPoints(seen, K, np.array(bend), P=K).reshape(*SIZE, 2)
    bent = np.dstack([at[..., 0] * 3, at[..., 1] * 4, 0 * columns]).clip(0, 255).astype(np.uint8)
    messages = [lens(START, K, SIZE, bend=bend), picture(START, bent)]
    image = next(Bag(write_bag(tmp_path, messages)).frames())[0].astype(float)
    inside = (slice(6, -6), slice(6, -6))
    assert np.abs(image[..., 0] / 3 - columns)[inside].max() < 0.7
    assert np.abs(image[..., 1] / 4 - rows)[inside].max() < 0.7
    kept = [lens(START, K, SIZE, bend=bend), picture(START, bent, "/camera/image_rect")]
    (tmp_path / "rect").mkdir()
    assert (next(Bag(write_bag(tmp_path / "rect", kept)).frames())[0] == bent).all()


@pytest.mark.parametrize(
    ("messages", "said"),
    [
        ([odometry(START, 0, 0, 0)], r"walk has no topic of pictures: record one beside /odom \(nav_msgs/"),
        (
            walk(picture(START, IMAGES[0], "/rear/image_raw")),
            "walk has pictures in /rear/image_raw, /camera/image_raw: give topic= one of them",
        ),
        (
            walk()[1:],
            "CameraInfo of a calibrated camera beside /camera/image_raw, and has none: give intr",
        ),
        (
            walk(lens(START, K, SIZE, "/b/camera_info"), topic="/front/image"),
            r"has /camera/camera_info, /b/camera_info: give intrinsics=",
        ),
        (
            [lens(START, K, (96, 128)), *walk()[1:]],
            "camera_info is for 96 x 128, the picture has 48 x 64",
        ),
        (
            [lens(START, 0 * K, SIZE), *walk()[1:]],
            "of a calibrated camera .* has /camera/camera_info: give intr",
        ),
        (
            [lens(START, K, SIZE, bend=(0.1, 0, 0, 0), model="equidistant"), *walk()[1:]],
            "walk: a lens of the model equidistant: record rectified pictures",
        ),
        (
            [lens(START, K, SIZE), picture(START, IMAGES[0, ..., 0].copy(), encoding="bayer_rggb8")],
            "walk, /camera/image_raw: image has encoding 'bayer_rggb8'",
        ),
    ],
)
def test_what_a_bag_lacks_is_said_in_one_line(tmp_path, messages, said):
    with pytest.raises(ValueError, match=said) as caught:
        assert Bag(write_bag(tmp_path, messages)).intrinsics
    assert "\n" not in str(caught.value)


def test_odometry_that_is_missing_or_not_the_only_one_is_named(tmp_path):
    bag = Bag(write_bag(tmp_path, walk(odometry(START, 0, 0, 0, "/visual/odom"))))
    with pytest.raises(ValueError, match=r"has odometry in /visual/odom, /odom: give poses= one of them"):
        bag.write_odometry(None, tmp_path / "o.csv")
    with pytest.raises(ValueError, match=r"has odometry in /visual/odom, /odom, not /wheel: give poses= one"):
        bag.write_odometry("/wheel", tmp_path / "o.csv")
    assert bag.write_odometry("/odom", tmp_path / "o.csv").read_text().count("\n") == 4


def test_the_lens_may_be_given_and_the_topic_named(tmp_path):
    path = write_bag(tmp_path, walk(picture(START, 255 - IMAGES[0], "/rear/image_raw"))[1:])
    bag = Bag(path, "/rear/image_raw", [100, 100, 31.5, 23.5])
    assert bag.intrinsics == [100, 100, 31.5, 23.5]
    assert (next(bag.frames())[0] == 255 - IMAGES[0]).all()


def test_a_damaged_or_missing_bag_is_one_line(tmp_path):
    (file,) = write_bag(tmp_path, walk()).glob("*.mcap")
    file.write_bytes(file.read_bytes()[:-900])
    with pytest.raises(ValueError, match=r"\.mcap is truncated or not a valid bag .*ros2 bag reindex"):
        list(Bag(file).frames())
    with pytest.raises(FileNotFoundError, match=r"none.mcap does not exist"):
        Bag(tmp_path / "none.mcap")

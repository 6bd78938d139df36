"""Photographs without depth: labeled once by a teacher, stored in millimeters, read like any data set."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from onnx import TensorProto, checker, helper, save
from PIL import Image

from eldenet.data import teacher_labels
from eldenet.data.teacher_labels import TeacherLabels, centered_box
from eldenet.deploy.onnx_teacher import OnnxTeacher


class Brightness:
    """Depth [m] is 1 + 4 x red, 8 x 16 pixels; counts its calls."""

    input_size = (8, 16)

    def __init__(self, name: str = "brightness") -> None:
        self.name, self.calls = name, 0

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        assert image.shape[1:] == (3, 8, 16)
        self.calls += 1
        return 1 + 4 * image[:, :1]

    @property
    def signature(self) -> dict[str, object]:
        return {"source": self.name}


@pytest.fixture
def photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ELDENET_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "photos"
    (folder / "more").mkdir(parents=True)
    ramp = np.zeros((16, 32, 3), np.uint8)
    ramp[..., 2] = np.linspace(0, 255, 32).astype(np.uint8)  # red, in OpenCV's order
    cv2.imwrite(str(folder / "wide.png"), ramp)
    cv2.imwrite(str(folder / "more/tall.png"), ramp.transpose(1, 0, 2))
    (folder / "notes.txt").write_text("no picture")
    return folder


def test_labels_are_the_teachers_depth_of_the_part_it_saw(photos: Path) -> None:
    frames = TeacherLabels(photos, teacher=Brightness())
    assert frames.names == ["more/tall.png", "wide.png"]
    wide = frames.load_frame(1)
    assert wide.image.shape == (16, 32, 3)
    red = wide.image[..., 0].astype(float) / 255
    assert np.abs(wide.depth - (1 + 4 * red)).max() < 0.15  # resized twice
    tall = frames.load_frame(0)  # 32 x 16: the middle 8 rows have the teacher's shape
    assert tall.image.shape == (8, 16, 3)
    assert tall.depth.shape == (8, 16)
    stored = cv2.imread(str(frames.label_file(0)), cv2.IMREAD_UNCHANGED)
    assert stored.shape == (32, 16)
    assert stored.dtype == np.uint16
    assert (stored[:12] == 0).all()
    assert (stored[12:20] > 0).all()
    assert (stored[20:] == 0).all()


def test_labels_of_close_ups_are_read(photos: Path) -> None:
    """Nothing in these pictures is farther than 0.15 m."""

    class Near(Brightness):
        def __call__(self, image: torch.Tensor) -> torch.Tensor:
            return 0.03 * super().__call__(image)

    frame = TeacherLabels(photos, teacher=Near("near")).load_frame(1)
    seen = 0.03 * (1 + 4 * frame.image[..., 0].astype(float) / 255)
    assert np.abs(frame.depth - seen).max() < 0.005  # resized twice


def test_pictures_are_labeled_once_and_again_for_another_teacher(photos: Path) -> None:
    first = Brightness()
    frames = TeacherLabels(photos, teacher=first)
    assert first.calls == 2  # the pictures and their mirror images
    again = Brightness()
    TeacherLabels(photos, teacher=again)
    assert again.calls == 0
    other = Brightness("another")
    assert TeacherLabels(photos, teacher=other, mirror=False).folder != frames.folder
    assert other.calls == 1
    note = json.loads((frames.folder / "teacher.json").read_text())
    assert note["teacher"] == {"source": "brightness"}
    assert note["mirror"] is True


@pytest.mark.parametrize("older", [False, True])
def test_a_replaced_picture_is_labeled_again(photos: Path, older: bool) -> None:
    """Also by an older file, such as one that was moved there."""
    TeacherLabels(photos, teacher=Brightness())
    cv2.imwrite(str(photos / "wide.png"), np.full((16, 32, 3), 255, np.uint8))
    if older:
        os.utime(photos / "wide.png", (1e9, 1e9))
    teacher = Brightness()
    frames = TeacherLabels(photos, teacher=teacher, mirror=True)
    assert teacher.calls == 2  # one batch and its mirror image
    assert (frames.load_frame(1).depth == 5).all()
    TeacherLabels(photos, teacher=teacher)
    assert teacher.calls == 2


def sideways(path: Path) -> None:
    """A photo of 8 x 16 pixels, red on its left, as a phone stores it that was held upright: 16 x 8."""
    photo = np.zeros((8, 16, 3), np.uint8)
    photo[:, :8, 0] = 255
    tag = Image.Exif()
    tag[0x112] = 6  # to be turned by 90 degrees clockwise
    Image.fromarray(np.ascontiguousarray(np.rot90(photo))).save(path, exif=tag, quality=95)


def test_photos_are_turned_upright(photos: Path) -> None:
    sideways(photos / "phone.jpg")
    frames = TeacherLabels(photos, teacher=Brightness())
    frame = frames.load_frame(frames.names.index("phone.jpg"))
    assert frame.image.shape == (8, 16, 3)
    assert frame.image[:, :6, 0].min() > 200
    assert frame.depth[:, :6].min() > 4
    assert frame.depth[:, 10:].max() < 2


def test_the_version_of_labels_counts(photos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = TeacherLabels(photos, teacher=Brightness())
    assert json.loads((frames.folder / "teacher.json").read_text())["version"] == teacher_labels.VERSION
    monkeypatch.setattr(teacher_labels, "VERSION", teacher_labels.VERSION + 1)
    teacher = Brightness()
    assert TeacherLabels(photos, teacher=teacher).folder == frames.folder
    assert teacher.calls == 2
    note = json.loads((frames.folder / "teacher.json").read_text())
    assert note["version"] == teacher_labels.VERSION


def test_damaged_pictures_are_left_out_if_asked(photos: Path) -> None:
    (photos / "broken.jpg").write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"broken\.jpg"):
        TeacherLabels(photos, teacher=Brightness())
    frames = TeacherLabels(photos, teacher=Brightness(), on_error="skip")
    assert frames.names == ["more/tall.png", "wide.png"]
    assert list(frames.skipped) == ["broken.jpg"]
    assert frames.load_frame(1).image.shape == (16, 32, 3)
    cv2.imwrite(str(photos / "broken.jpg"), np.zeros((8, 16, 3), np.uint8))
    assert len(TeacherLabels(photos, teacher=Brightness())) == 3


def test_a_teacher_of_metric_depth_lends_its_camera(photos: Path) -> None:
    assert TeacherLabels(photos, teacher=Brightness()).load_frame(1).intrinsics is None
    intrinsics = TeacherLabels(photos, teacher=Brightness(), focal=0.5).load_frame(0).intrinsics
    assert intrinsics is not None
    assert intrinsics[0].tolist() == [8.0, 0.0, 7.5]


@pytest.mark.parametrize(
    ("size", "box"),
    [((240, 320), (0, 0, 240, 320)), ((200, 400), (0, 66, 200, 267)), ((400, 200), (125, 0, 150, 200))],
)
def test_the_largest_centered_part_of_a_shape(size: tuple[int, int], box: tuple[int, ...]) -> None:
    assert centered_box(size, (192, 256)) == box


def test_hidden_files_and_folders_are_no_photographs(photos: Path) -> None:
    """Such as macOS's ._a.jpg beside a.jpg, and thumbnails of a picture browser."""
    (photos / ".thumbnails/small").mkdir(parents=True)
    for hidden in (".thumbnails/small/wide.png", "more/._tall.png"):
        cv2.imwrite(str(photos / hidden), np.zeros((8, 16, 3), np.uint8))
    assert TeacherLabels(photos, teacher=Brightness()).names == ["more/tall.png", "wide.png"]


def test_missing_pictures_and_sizes_are_named(photos: Path, tmp_path: Path) -> None:
    for root in (tmp_path / "nothing", None):
        with pytest.raises(FileNotFoundError, match=r"data\.photographs=.* is not a folder"):
            TeacherLabels(root, teacher=Brightness())
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"data\.photographs=.*empty has no pictures: give .*\.jpg"):
        TeacherLabels(tmp_path / "empty", teacher=Brightness())
    teacher = Brightness()
    teacher.input_size = None  # type: ignore[assignment]
    with pytest.raises(ValueError, match="input_size"):
        TeacherLabels(photos, teacher=teacher)


def red_channel(path: Path) -> Path:
    """An ONNX network whose one map is the red channel of its input."""
    shape = [1, 3, 8, 16]
    starts, ends, axes = (
        helper.make_tensor(name, TensorProto.INT64, [1], [value])
        for name, value in (("starts", 0), ("ends", 1), ("axes", 1))
    )
    graph = helper.make_graph(
        [helper.make_node("Slice", ["image", "starts", "ends", "axes"], ["map"])],
        "red",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("map", TensorProto.FLOAT, [1, 1, 8, 16])],
        [starts, ends, axes],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    checker.check_model(model)
    save(model, path)
    return path


def test_an_onnx_file_teaches_with_its_own_preprocessing(tmp_path: Path) -> None:
    file = red_channel(tmp_path / "net.onnx")
    images = torch.rand(2, 3, 8, 16)
    options = {"input_size": (8, 16), "mean": (0.5, 0, 0), "std": (0.25, 1, 1)}
    depth = OnnxTeacher(file, scale=2.0, **options)(images)
    torch.testing.assert_close(depth, 2 * (images[:, :1] - 0.5) / 0.25)
    teacher = OnnxTeacher(file, output="disparity", **options)
    inverse = 1 / teacher(images)
    assert inverse.amin((1, 2, 3)).tolist() == pytest.approx([0.1, 0.1])
    assert inverse.amax((1, 2, 3)).tolist() == pytest.approx([1.1, 1.1])
    assert teacher.signature["weights"]
    assert teacher.signature != OnnxTeacher(file, **options).signature
    with pytest.raises(ValueError, match="output='disp'"):
        OnnxTeacher(file, output="disp", **options)

"""Meters follow the lens: the focal length that is given, the EXIF's, or the canonical camera's."""

import logging
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from support.predicting import photo, read_ply, save, settings
from torch import nn

import eldenet
from eldenet.deploy.lens import Lens, exif_focal
from eldenet.deploy.metadata import describe
from eldenet.deploy.onnx_export import write_onnx
from eldenet.deploy.predictor import DepthPredictor
from eldenet.geometry import focal_of_fov
from eldenet.heads import ScaledHead
from eldenet.model import DepthNet
from eldenet.predict import predict

SIZE = (24, 32)


class Size(nn.Module):
    """A network that measures: canonical depth of a white disc is its size in the picture, inverted."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        white = (image.mean(1, keepdim=True) > 0.4).float().sum((2, 3), keepdim=True)
        return (100 / white.sqrt()).expand(-1, 1, *image.shape[-2:])


def measuring() -> DepthNet:
    """See discs in pictures; f_canonical is 0.8 x 64 px."""
    head = ScaledHead(min_depth=1e-3, max_depth=1e3)
    model = DepthNet(Size(), head, mean=(0, 0, 0), std=(1, 1, 1), canonical_focal=0.8, canonical_width=64)
    model.info = {"input_size": [48, 64]}
    return model.eval()


def disc(height: int, width: int, radius: float) -> np.ndarray:
    rows, cols = np.indices((height, width))
    inside = np.hypot(rows - (height - 1) / 2, cols - (width - 1) / 2) < radius
    return np.repeat((inside * 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.fixture
def lens_model() -> DepthNet:
    torch.manual_seed(0)
    model = eldenet.load("eldenet_s")
    model = DepthNet(model.network, model.head, canonical_focal=0.8, canonical_width=SIZE[1]).eval()
    model.info = {"input_size": list(SIZE)}
    return model


@pytest.mark.parametrize("cut", [(480, 640), (360, 480), (240, 320), (480, 270), (270, 480), (360, 640)])
def test_a_crop_changes_no_meter(cut: tuple[int, int]) -> None:
    """Portrait, 16:9 and longer lenses: the same disc, the same distance."""
    frame = disc(480, 640, 80)
    top, left = (480 - cut[0]) // 2, (640 - cut[1]) // 2
    part = np.ascontiguousarray(frame[top : top + cut[0], left : left + cut[1]])
    predictor, camera = DepthPredictor(measuring()), (520.0, 520.0, 320.0, 240.0)
    whole, seen = (predictor(each, intrinsics=camera)[0, 0] for each in (frame, part))
    assert seen == pytest.approx(whole, rel=0.05)  # a disc of some ten pixels is counted in whole ones


def test_field_of_view_and_intrinsics_say_the_same(lens_model: DepthNet) -> None:
    predictor, frame = DepthPredictor(lens_model), photo(48, 64)
    canonical, focal = predictor(frame), focal_of_fov(90, 64)
    assert focal == pytest.approx(32)
    wide = predictor(frame, fov=90)
    np.testing.assert_array_equal(wide, predictor(frame, intrinsics=np.diag([focal, focal, 1.0])))
    np.testing.assert_array_equal(wide, predictor(frame, focal=focal))
    np.testing.assert_array_equal(wide, predictor(frame, intrinsics=[focal, focal, 31.5, 23.5]))
    np.testing.assert_allclose(wide, canonical * (0.5 / 0.8), rtol=1e-5)
    with pytest.raises(ValueError, match="give only one of them"):
        predictor(frame, fov=90, intrinsics=(32, 32, 31.5, 23.5))
    with pytest.raises(ValueError, match="fx and fy above 0"):
        predictor(frame, intrinsics=(0, 32, 31.5, 23.5))
    with pytest.raises(ValueError, match="focal and fov are given: give only one of them"):
        predictor(frame, focal=32, fov=90)
    with pytest.raises(ValueError, match="focal=-1: give fx of the frame in pixels"):
        predictor(frame, focal=-1)
    with pytest.raises(ValueError, match="fov='69': give the horizontal field of view as a number"):
        predictor(frame, fov="69")
    with pytest.raises(ValueError, match="focal='32': give fx of the frame in pixels, a number"):
        predictor(frame, focal="32")


def test_a_network_without_focal_lengths_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    model = eldenet.load("eldenet_s")
    model.info = {"input_size": list(SIZE)}
    predictor, frame = DepthPredictor(model), photo(48, 64)
    with caplog.at_level(logging.WARNING, "eldenet"):
        np.testing.assert_array_equal(predictor(frame, fov=60), predictor(frame, fov=90))
    assert [record.getMessage()[:38] for record in caplog.records] == [
        "this network ignores focal lengths: th"
    ]


@pytest.mark.parametrize("frame", [(48, 64), (96, 128), (64, 48), (54, 96)])
def test_files_give_the_meters_of_torch(
    frame: tuple[int, int], lens_model: DepthNet, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A file of one size sees other aspects with a border, so these agree in scale alone."""
    pytest.importorskip("onnxruntime")
    from eldenet.deploy import runtimes

    folder = tmp_path_factory.getbasetemp() / "lens"
    path = folder / "lens.onnx"
    if not path.is_file():
        write_onnx(lens_model, path, SIZE, batch=1, opset=17, metadata=describe(lens_model, "lens", SIZE))
    network = runtimes.load(path, "onnxruntime", threads=1)
    assert network.canonical_px == pytest.approx(lens_model.canonical_px)
    by_file, by_torch = DepthPredictor(network), DepthPredictor(lens_model)
    picture = photo(*frame)
    depth = by_file(picture, fov=70)
    assert depth.shape == frame
    if frame[0] * 4 == frame[1] * 3:
        np.testing.assert_allclose(depth, by_torch(picture, fov=70), rtol=1e-3)
    share = 2 / np.tan(np.radians(35)) * np.tan(np.radians(20)) / 2
    np.testing.assert_allclose(by_file(picture, fov=40) * share, depth, rtol=1e-4)


def test_a_file_says_whose_focal_length_scales_its_depth(lens_model: DepthNet) -> None:
    height, width = SIZE
    of_frames = describe(lens_model, "lens", SIZE, camera_size=(3 * height, 4 * width))
    assert "fx [px of the network's image]" in describe(lens_model, "lens", SIZE)["output"]
    assert f"fx [px of the frame x {width} / {4 * width}]" in of_frames["output"]


def photo_with_exif(path: Path, size: tuple[int, int], film: int, *, turned: bool = False) -> Path:
    path.parent.mkdir(exist_ok=True)
    exif = Image.Exif()
    exif[0x8769] = {0xA405: film}
    if turned:
        exif[0x0112] = 6
    Image.fromarray(photo(*size)).save(path, exif=exif)
    return path


def test_exif_knows_the_lens_of_a_photo_however_it_was_held(tmp_path: Path) -> None:
    flat = photo_with_exif(tmp_path / "a.jpg", (48, 64), 26)
    upright = photo_with_exif(tmp_path / "b.jpg", (48, 64), 26, turned=True)
    assert exif_focal(flat, (48, 64)) == pytest.approx(26 * 80 / 43.27)
    assert exif_focal(upright, (64, 48)) == pytest.approx(26 * 80 / 43.27)
    assert exif_focal(save(tmp_path / "c.png", photo()), (48, 64)) is None
    assert exif_focal(photo_with_exif(tmp_path / "d.jpg", (48, 64), 0), (48, 64)) is None


def test_exif_of_a_crop_of_another_shape_is_not_its_lens(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    exif = Image.Exif()
    exif[0x8769] = {0xA405: 26, 0xA002: 64, 0xA003: 48}
    Image.fromarray(photo(48, 64)).save(tmp_path / "a.jpg", exif=exif)
    opened = Image.open(tmp_path / "a.jpg")
    whole = 26 * 80 / 43.27
    assert exif_focal(opened, (48, 64)) == pytest.approx(whole)
    assert exif_focal(opened.resize((32, 24)), (24, 32)) == pytest.approx(whole / 2)
    assert exif_focal(opened.transpose(Image.Transpose.ROTATE_90), (64, 48)) == pytest.approx(whole)
    assert not caplog.text
    assert exif_focal(opened.crop((0, 0, 48, 48)), (48, 48)) is None  # whole x 68 / 80 by its diagonal
    assert "cropped or stretched from 48 x 64 to 48 x 48" in caplog.text
    opened.crop((0, 0, 24, 48)).save(tmp_path / "b.jpg", exif=exif)
    assert exif_focal(tmp_path / "b.jpg", (48, 24)) is None


@pytest.mark.parametrize(("film", "said"), [(26, False), (50, True)])
def test_a_file_for_one_camera_doubts_the_exif_of_another(
    film: int, said: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = photo_with_exif(tmp_path / f"{film}.jpg", (48, 64), film)
    assert Lens(None, known_fov=69).focal_of((48, 64), path) is None
    assert ("is not the lens that the file was exported for, fov=69" in caplog.text) == said


def test_a_field_of_view_of_upright_and_of_other_pictures_is_asked_about(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """A phone that was turned keeps its focal length, not its horizontal field of view."""
    for size, warned in (((48, 64), False), ((48, 80), False), ((64, 48), True)):
        lens = Lens(100.0, fov=73.7)  # a fov of this test's own, as a line is said once
        for one in ((48, 64), size):
            lens.focal_of(one)
        assert ("give focal=43 (fov across the long side)" in caplog.text) == warned
    assert focal_of_fov(73.7, 64) == pytest.approx(43, abs=0.5)


def test_given_beats_exif_beats_canonical(tmp_path: Path) -> None:
    path = photo_with_exif(tmp_path / "a.jpg", (48, 64), 26)
    assert Lens(50.0, focal=70.0).focal_of((48, 64), path) == 70.0
    assert Lens(50.0, fov=90.0).focal_of((48, 64), path) == pytest.approx(32)
    assert Lens(50.0).focal_of((48, 64), path) == pytest.approx(26 * 80 / 43.27)
    assert Lens(50.0).focal_of((48, 64)) is None
    assert Lens(None, focal=70.0).focal_of((48, 64), path) is None


def test_given_beats_kittis_calibration_for_depth_and_points(tmp_path: Path) -> None:
    path = save(tmp_path / "image_2/000001.png", photo(48, 64))
    (tmp_path / "calib").mkdir()
    (tmp_path / "calib/000001.txt").write_text("P2: 100 0 31 0 0 100 23 0 0 0 1 0\n")
    for lens, focal in (
        (Lens(50.0), 100.0),
        (Lens(50.0, focal=70.0), 70.0),
        (Lens(50.0, fov=90.0), 32.0),
        (Lens(50.0, intrinsics=(60.0, 60.0, 30.0, 20.0)), 60.0),
    ):
        camera = lens.camera_of((48, 64), path)
        assert camera is not None
        assert camera.intrinsics[0, 0] == pytest.approx(focal)
        assert lens.focal_of((48, 64), path) == pytest.approx(focal)


def test_a_photo_whose_exif_knows_the_lens_becomes_points(lens_model: DepthNet, tmp_path: Path) -> None:
    lens_model.save_pretrained(tmp_path / "model")
    photo_with_exif(tmp_path / "in/a.jpg", (48, 64), 26)
    photo_with_exif(tmp_path / "in/b.jpg", (64, 48), 26)  # of another size
    predict(settings(tmp_path / "model", tmp_path / "in", tmp_path / "out", "formats=[depth,ply]"))
    focal = 26 * 80 / 43.27
    for name, (height, width) in {"a": (48, 64), "b": (64, 48)}.items():
        points = read_ply(tmp_path / f"out/{name}.ply")
        cols = np.tile(np.arange(width), height)
        np.testing.assert_allclose(points["x"] / points["z"] * focal + (width - 1) / 2, cols, atol=1e-2)


@pytest.mark.parametrize(
    ("film", "overrides", "line"),
    [
        (26, ["focal=50"], "camera: fx 50 px (given), pictures 64 px wide"),
        (26, [], "camera: fx 48 px (from EXIF), pictures 64 px wide"),
        (0, [], "camera: unknown, so all distances may be off by one factor: give fov=, focal= or intrin"),
    ],
)
def test_predict_says_which_camera_it_assumed(
    film: int, overrides: list[str], line: str, lens_model: DepthNet, tmp_path: Path, capsys
) -> None:
    lens_model.save_pretrained(tmp_path / "model")
    photo_with_exif(tmp_path / "in/a.jpg", (48, 64), film)
    save(tmp_path / "in/tiny.png", photo(4, 4))  # is skipped, and does not count
    words = ["formats=[depth]", "on_error=skip", *overrides]
    predict(settings(tmp_path / "model", tmp_path / "in", tmp_path / "out", *words))
    said = capsys.readouterr().out
    assert line in said
    assert "(1 picture)" not in said


def test_no_lens_makes_depth_that_is_not_finite(
    lens_model: DepthNet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ELDENET_ANY_LENS", "1")
    assert np.isfinite(DepthPredictor(lens_model)(photo(48, 64), fov=0.02)).all()
    with pytest.raises(ValueError, match="focal=1e"):
        DepthPredictor(lens_model)(photo(48, 64), focal=1e300)

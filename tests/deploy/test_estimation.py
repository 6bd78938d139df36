"""``eldenet.estimate`` takes what people have, and gives what ``eldenet predict`` writes."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from support.predicting import exported, photo, read_ply, save, settings, small_model, turned_by_exif

import eldenet
from eldenet.data.io import read_depth, read_image
from eldenet.deploy import estimation
from eldenet.predict import predict
from eldenet.weights import BEST

KITCHEN = Path(__file__).parents[2] / "web" / "example.jpg"
FOCAL = 440  # of the kitchen [px]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_model(tmp_path_factory.mktemp("model"))


@pytest.fixture(scope="module")
def kitchen() -> estimation.PictureDepth:
    return eldenet.estimate(str(KITCHEN), focal=FOCAL)


def exif(film: int) -> Image.Exif:
    """Of a camera whose focal length is that of ``film`` mm on 35 mm film."""
    noted = Image.Exif()
    noted[0x8769] = {0xA405: film}
    return noted


def test_a_picture_gets_what_predict_writes(kitchen: estimation.PictureDepth, tmp_path: Path) -> None:
    predict(settings(BEST, KITCHEN, tmp_path / "a", f"focal={FOCAL}", "formats=[depth,color,ply,sigma]"))
    files = kitchen.save(tmp_path / "b", ["depth", "color", "ply", "sigma"])
    written = sorted(path for path in (tmp_path / "a").iterdir() if path.suffix in (".png", ".ply"))
    assert sorted(path.name for path in files) == [path.name for path in written]
    for path in written:
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name
    assert kitchen.depth.shape == kitchen.sigma.shape == (320, 480)
    assert 0.5 < np.median(kitchen.depth) < 5
    np.testing.assert_allclose(
        read_depth(tmp_path / "b/example_depth.png", "mm"), kitchen.depth, atol=0.5001e-3
    )
    assert np.isfinite(kitchen.estimate.interval(0.9)[0]).all()


def test_points_and_colors(kitchen: estimation.PictureDepth, tmp_path: Path) -> None:
    points = kitchen.points()
    np.testing.assert_array_equal(points[..., 2], kitchen.depth)
    # the pixel 100 px right of the center: tan of its angle is 100 / fx
    np.testing.assert_allclose(points[0, 239 + 100, 0] / points[0, 339, 2], 99.5 / FOCAL, rtol=1e-6)
    drawn = np.asarray(kitchen.plot(0.5, 4.0))
    np.testing.assert_array_equal(drawn[-320:, :480], read_image(KITCHEN))  # below its title
    with pytest.raises(ValueError, match=r"near=5, far=1: give 0 <= near < far \[m\]"):
        kitchen.plot(5, 1)
    assert len(read_ply(kitchen.save(tmp_path, "ply")[0])) == 320 * 480


def test_every_form_of_a_picture_gives_the_same_depth(small: Path, tmp_path: Path) -> None:
    path = save(tmp_path / "a.png", photo())
    wanted = eldenet.estimate(path, small, fov=60).depth
    with Image.open(path) as opened:
        forms = [str(path), opened, photo(), photo() / 255, (photo() / 255).astype(np.float32)]
        for form in forms:
            np.testing.assert_array_equal(eldenet.estimate(form, small, fov=60).depth, wanted)
        found = eldenet.estimate(forms, small, fov=60)
    assert [each.name for each in found] == ["a_0", "a_1", "picture_2", "picture_3", "picture_4"]
    save(tmp_path / "b/c.png", photo(64, 48))
    in_folder = eldenet.estimate(tmp_path, small, fov=60)
    assert [(each.name, each.depth.shape) for each in in_folder] == [("a", (48, 64)), ("b/c", (64, 48))]
    assert in_folder[1].save(tmp_path / "out", "color") == [tmp_path / "out/b/c_color.png"]


def test_no_two_results_of_a_list_share_a_name(small: Path, tmp_path: Path) -> None:
    files = [save(tmp_path / name, photo()) for name in ("one/a.png", "two/a.png", "two/a_1.png")]
    names = [each.name for each in eldenet.estimate(files, small, fov=60)]
    assert len(set(names)) == 3, names


def test_a_result_keeps_its_photo_where_a_camera_fills_one_array_again_and_again(small: Path) -> None:
    frame = photo()
    result = eldenet.estimate(frame, small, fov=60)
    frame[:] = 0
    np.testing.assert_array_equal(result.photo, photo())


def test_exif_knows_lens_and_pose_in_a_file_and_in_memory(tmp_path: Path) -> None:
    Image.fromarray(photo()).save(tmp_path / "a.jpg", exif=exif(26))
    with Image.open(tmp_path / "a.jpg") as opened:
        for form in (tmp_path / "a.jpg", opened):
            assert eldenet.estimate(form).camera.intrinsics[0, 0] == pytest.approx(26 * 80 / 43.27)
    assert eldenet.estimate(tmp_path / "a.jpg", fov=90).camera.intrinsics[0, 0] == pytest.approx(32)
    turned = turned_by_exif(save(tmp_path / "b.jpg", photo()))
    with Image.open(turned) as opened, pytest.warns(UserWarning, match="focal length unknown"):
        assert [each.depth.shape for each in eldenet.estimate([turned, opened])] == [(64, 48)] * 2


def test_an_unknown_lens_is_said_and_gives_no_points() -> None:
    with pytest.warns(UserWarning, match=r"distances may be off by one factor: give fov=, focal="):
        found = eldenet.estimate(photo())
    assert "lens unknown" in repr(found)
    with pytest.raises(ValueError, match="points need the lens"):
        found.points()


def test_threads_share_one_network(small: Path) -> None:
    estimation._load.cache_clear()
    pictures = [np.roll(photo(), step, 1) for step in range(8)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda picture: eldenet.estimate(picture, small, fov=60).depth, pictures))
    assert estimation._load.cache_info().misses == 1
    for picture, depth in zip(pictures, found, strict=True):
        np.testing.assert_array_equal(depth, eldenet.estimate(picture, small, fov=60).depth)


def test_weights_that_changed_are_loaded_again(small: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(small, tmp_path / "model")
    before = eldenet.estimate(photo(), folder, fov=60).depth
    torch.manual_seed(1)
    eldenet.load("eldenet_s").save_pretrained(folder, info={"input_size": [32, 64]})
    os.utime(folder / "model.safetensors", ns=(1, 1))  # on a file system with coarse times too
    assert not np.array_equal(eldenet.estimate(photo(), folder, fov=60).depth, before)


def test_an_exported_file_is_a_checkpoint_too(small: Path, tmp_path: Path) -> None:
    file = exported(eldenet.load(small), tmp_path / "small.onnx")
    frame = photo(32, 64)  # the size that the file takes
    found = eldenet.estimate(frame, file, fov=60).depth
    np.testing.assert_allclose(found, eldenet.estimate(frame, small, fov=60).depth, rtol=1e-3)


@pytest.mark.parametrize(
    ("source", "options", "wanted"),
    [
        ("missing.jpg", {}, "does not exist: give a picture"),
        ("camera:0", {}, "for videos and cameras use eldenet predict"),
        ("https://a.org/b.jpg", {}, "download a picture from an address first"),
        (None, {}, "source is NoneType: give a file, a folder, a PIL picture"),
        (photo() * 1.0, {}, "outside \\[0, 1\\]: divide it by 255"),
        (photo()[..., 0], {}, r"source is array \(48, 64\): give a file"),
        (photo()[:, 60:60], {"fov": 60}, r"frame is \(48, 0, 3\) uint8: give the picture"),
        (photo().astype(np.uint16), {}, r"\(48, 64, 3\) uint16: give the picture"),
        (Image.fromarray(photo()[..., 0].astype(np.uint16)), {}, "mode I;16: convert it to 8 bits"),
        (photo(), {"fov": 60, "focal": 50}, "focal and fov are given: give only one"),
        (photo(), {"intrinsics": (50, 50, 100, 20)}, "principal point .* lies outside"),
        (photo(), {"checkpoint": "eldenet"}, "network without trained weights"),
        (photo(), {"checkpoint": "eldenet_indor"}, "did you mean eldenet_indoor"),
        (photo(), {"checkpoint": torch.nn.Identity()}, "a Identity: give a name or a path; for a loaded"),
    ],
)
def test_what_does_not_fit_is_answered_in_one_line(source: object, options: dict, wanted: str) -> None:
    with pytest.raises((ValueError, FileNotFoundError, TypeError), match=wanted) as error:
        eldenet.estimate(source, **options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("folder", "formats", "wanted"),
    [
        ("depth.png", "depth", "is the name of a file: give a folder"),
        ("out", "jpg", "formats='jpg'"),
        ("out", "sigma", "predicts no sigma"),
    ],
)
def test_what_cannot_be_saved_is_refused(small: Path, folder: str, formats: str, wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        eldenet.estimate(photo(), small, fov=60).save(folder, formats)

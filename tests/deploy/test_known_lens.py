"""Files of one camera: ``export fov=`` tells the file its lens, and another lens is refused."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from support.networks import lens_net, picture, small_net
from support.predicting import photo, save

from eldenet.compose import compose
from eldenet.deploy import runtimes
from eldenet.deploy.metadata import read_metadata
from eldenet.deploy.predictor import DepthPredictor, for_camera
from eldenet.deploy.runtimes.module import RuntimeNetwork
from eldenet.evaluation.evaluator import predict_depth, predict_spread
from eldenet.export import ExportSettings, export
from eldenet.geometry import BORDER_COLOR, focal_of_fov, pinhole
from eldenet.model import DepthNet
from eldenet.ray_features import RayFeatures

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")
SIZE, FOV = (32, 64), 70.0


@pytest.fixture(scope="module", params=[RayFeatures, None], ids=["rays", "no rays"])
def model(request: pytest.FixtureRequest) -> DepthNet:
    return lens_net(*SIZE, rays=request.param)


@pytest.fixture(scope="module")
def folder(model: DepthNet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return model.save_pretrained(tmp_path_factory.mktemp("model"))


def exported(folder: Path, output: Path, *words: str) -> Path:
    given = [f"checkpoint='{folder}'", f"output='{output}'", f"fov={FOV}", "checks=2", *words]
    return export(compose(ExportSettings, given))


@pytest.fixture(scope="module")
def path(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported(folder, tmp_path_factory.mktemp("files") / "m.onnx")


def test_the_file_takes_pictures_alone_and_answers_in_meters(model: DepthNet, path: Path) -> None:
    assert read_metadata(path)["units"] == "meters"
    for runtime in ("onnxruntime", "openvino"):
        network = runtimes.load(path, runtime, threads=1)
        assert not network.sees_rays
        images = picture(*SIZE, batch=2)
        with torch.inference_mode():
            expected = model.predict(images, focal_of_fov(FOV, SIZE[1]))
        found = network.predict(images.numpy())
        np.testing.assert_allclose(found.depth, expected.depth, rtol=1e-3)
        np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-3)


@pytest.mark.slow
def test_frames_have_that_lens_too(model: DepthNet, folder: Path, tmp_path: Path) -> None:
    path = exported(folder, tmp_path / "c.onnx", "camera=[64,128]", "batch=1")
    frame = photo(64, 128)
    found = DepthPredictor(runtimes.load(path, threads=1), steady=False)(frame)
    expected = DepthPredictor(model, SIZE, steady=False)(frame, fov=FOV)
    assert np.abs(found / expected - 1).mean() < 0.005  # torch rounds the smaller frame


@pytest.mark.slow
@pytest.mark.parametrize("model", [RayFeatures], indirect=True, ids=["rays"])
@pytest.mark.parametrize(("format", "name"), [("onnx", "q.onnx"), ("openvino", "q.xml")])
def test_int8_files_of_one_lens_stay_near(
    model: DepthNet, folder: Path, tmp_path: Path, format: str, name: str
) -> None:
    if format == "openvino":
        pytest.importorskip("nncf")
    images = picture(*SIZE, batch=8)
    for number, one in enumerate(images):
        save(tmp_path / f"{number}.png", (one.permute(1, 2, 0).numpy() * 255).astype(np.uint8))
    words = [f"format={format}", "precision=int8", f"pictures='{tmp_path}/*.png'", "opset=17"]
    path = exported(folder, tmp_path / name, *words)
    network = runtimes.load(path, threads=1)
    assert (network.precision, read_metadata(path)["units"]) == ("int8", "meters")
    with torch.inference_mode():
        expected = model(images, focal_of_fov(FOV, SIZE[1])).numpy()
    assert np.abs(network(images.numpy()) / expected - 1).mean() < 0.05


def test_the_lens_is_that_of_the_whole_width(path: Path) -> None:
    predictor = DepthPredictor(runtimes.load(path, threads=1), steady=False)
    wide, bordered = photo(36, 96), np.full((48, 96, 3), BORDER_COLOR, np.uint8)
    bordered[6:42] = wide
    np.testing.assert_allclose(predictor(wide)[2:-2], predictor(bordered)[8:40], rtol=0.01)
    with pytest.raises(ValueError, match="narrower than 32 x 64, across which the file's fov=70 reaches"):
        predictor(photo(96, 96))


def test_another_lens_is_refused_and_its_own_is_not(path: Path) -> None:
    predictor = DepthPredictor(runtimes.load(path, threads=1), steady=False)
    frame = photo(48, 96)
    np.testing.assert_array_equal(predictor(frame, fov=FOV), predictor(frame))
    other = focal_of_fov(50, 96)
    with pytest.raises(ValueError, match="fx 103 px have fov=50, but this file was exported for fov=70"):
        predictor(frame, focal=other)
    with pytest.raises(ValueError, match="exported for fov=70"):
        for_camera(predictor, pinhole(other, other, 47.5, 23.5))(frame)


def test_a_runtime_and_a_score_refuse_another_lens_too(path: Path) -> None:
    images, own = picture(*SIZE, batch=2), focal_of_fov(FOV, SIZE[1])
    for runtime in ("onnxruntime", "openvino"):
        network = runtimes.load(path, runtime, threads=1)
        expected = network(images.numpy())
        np.testing.assert_array_equal(network(images.numpy(), [own, 0.0]), expected)
        scored = predict_depth(RuntimeNetwork(network), images, torch.tensor([own, math.nan]))
        np.testing.assert_array_equal(scored.numpy(), expected)
        with pytest.raises(ValueError, match="fx 69 px have fov=50, but this file was exported for fov=70"):
            network(images.numpy(), focal_of_fov(50, SIZE[1]))
        for predicted in (predict_depth, predict_spread):
            with pytest.raises(ValueError, match="exported for fov=70"):
                predicted(RuntimeNetwork(network), images, torch.tensor([own, 1.5 * own]))


@pytest.mark.slow
def test_predict_says_the_files_lens(run_command, path: Path, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    assert cv2.imwrite(str(tmp_path / "photos" / "a.png"), photo(48, 96))
    done = run_command("predict", f"checkpoint={path}", "source=photos", "output=found")
    assert "camera: fov 70 degrees, which the file was exported for" in done.stdout
    done = run_command("predict", f"checkpoint={path}", "source=photos", "output=other", "fov=50")
    assert done.returncode == 1
    assert "but this file was exported for fov=70" in done.stderr


def test_a_network_that_ignores_lenses_has_none(tmp_path: Path) -> None:
    folder = small_net().save_pretrained(tmp_path / "model")
    with pytest.raises(ValueError, match="fov=70: this network ignores lenses: train with canonical_focal"):
        exported(folder, tmp_path / "m.onnx")
    with pytest.raises(ValueError, match=r"fov=200\.0: give the horizontal field of view"):
        exported(folder, tmp_path / "m.onnx", "fov=200")

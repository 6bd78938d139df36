"""Without a lens, the canonical camera's field of view is assumed, at whatever size the network works."""

from pathlib import Path

import numpy as np
import pytest
import torch
from support.networks import canonical_net, small_net
from support.predicting import photo

from eldenet.deploy import runtimes
from eldenet.deploy.metadata import describe
from eldenet.deploy.onnx_export import write_onnx
from eldenet.deploy.predictor import DepthPredictor
from eldenet.heads import LogHead, UncertainHead
from eldenet.model import DepthNet
from eldenet.ray_features import RayFeatures

SIZE = (32, 64)  # of the training [px]
FRAMES = [(64, 128), (128, 96), (48, 96), (36, 96)]


@pytest.fixture(scope="module")
def model() -> DepthNet:
    return canonical_net(*SIZE)


def predictor_of(
    model: DepthNet, path: Path, size: tuple[int, int], camera_size: tuple[int, int] | None = None
) -> DepthPredictor:
    pytest.importorskip("onnxruntime")
    facts = describe(model, "small", size, camera_size=camera_size)
    write_onnx(model, path, size, batch=1, opset=17, metadata=facts, camera_size=camera_size)
    return DepthPredictor(runtimes.load(path, threads=1), steady=False)


@pytest.fixture(scope="module")
def predictors(model: DepthNet, tmp_path_factory: pytest.TempPathFactory) -> dict[str, DepthPredictor]:
    folder = tmp_path_factory.mktemp("files")
    return {
        "as trained": DepthPredictor(model, steady=False),
        "larger": DepthPredictor(model, (64, 128), steady=False),
        "another shape": DepthPredictor(model, (48, 64), steady=False),
        "another runtime": DepthPredictor(runtimes.load(model, "torch", size=(48, 80)), steady=False),
        "file": predictor_of(model, folder / "small.onnx", SIZE),
        "larger file": predictor_of(model, folder / "large.onnx", (48, 80)),
        "frames": predictor_of(model, folder / "frames.onnx", SIZE, (64, 128)),
    }


@pytest.mark.parametrize("size", FRAMES, ids=str)
def test_the_field_of_view_is_the_same_at_any_size_and_in_any_file(
    predictors: dict[str, DepthPredictor], size: tuple[int, int]
) -> None:
    frame, usual = photo(*size), predictors["as trained"]
    focal = 0.8 * SIZE[1] * size[1] / usual.size_for(*size)[1]  # [px of the frame]
    for name, predictor in predictors.items():
        expected = predictor(frame, focal=focal)
        np.testing.assert_allclose(predictor(frame), expected, rtol=1e-5, err_msg=name)


def test_a_network_that_sees_rays_is_not_told_a_lens_that_nobody_knows() -> None:
    """It answers as where its lens is left out, in meters of the training's field of view; sigma too."""
    model = small_net(
        rays=RayFeatures, head=UncertainHead(LogHead()), canonical_focal=0.8, canonical_width=SIZE[1]
    )
    model.info = {"input_size": list(SIZE)}
    for convs in model.network.rays.convs.values():
        torch.nn.init.normal_(convs[2].weight, std=0.3)
    frame = photo(64, 128)
    with torch.inference_mode():
        image = torch.from_numpy(frame).permute(2, 0, 1)[None].float() / 255
        expected = model.predict(image)
    found = DepthPredictor(model, (64, 128), steady=False, uncertainty=True)(frame)
    np.testing.assert_allclose(found.depth, 2 * expected.depth[0, 0], rtol=1e-4)
    np.testing.assert_allclose(found.sigma, 2 * expected.sigma[0, 0], rtol=1e-4)


def test_at_the_trained_size_nothing_changes(model: DepthNet, predictors: dict[str, DepthPredictor]) -> None:
    frame = photo(*SIZE)
    with torch.inference_mode():
        depth = model(torch.from_numpy(frame).permute(2, 0, 1)[None].float() / 255)[0, 0]
    np.testing.assert_allclose(predictors["as trained"](frame), depth, rtol=1e-5)

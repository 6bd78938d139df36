"""Sigma beyond torch: exported files, the predictor, and what predict writes."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from support.networks import small_net
from support.predicting import listed, photo, save, settings

from eldenet.deploy import runtimes
from eldenet.deploy.metadata import describe
from eldenet.deploy.onnx_export import write_onnx
from eldenet.deploy.openvino_export import write_openvino
from eldenet.deploy.predictor import DepthPredictor
from eldenet.heads import LinearHead, UncertainHead
from eldenet.model import DepthNet
from eldenet.predict import predict
from eldenet.uncertainty import NO_SIGMA
from eldenet.visualization import PALE

SIZE = (32, 64)


@pytest.fixture(scope="module")
def model() -> DepthNet:
    net = small_net(head=UncertainHead(LinearHead()))
    net.info = {"input_size": list(SIZE)}
    with torch.no_grad():  # a sigma that differs from pixel to pixel
        net.network.decoder.predict.weight[1].normal_(generator=torch.Generator().manual_seed(0))
    return net


@pytest.fixture(scope="module")
def files(model: DepthNet, tmp_path_factory) -> dict[str, Path]:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("openvino")
    folder, facts = tmp_path_factory.mktemp("files"), describe(model, "m", SIZE)
    graph = write_onnx(model, folder / "m.onnx", SIZE, metadata=facts)
    old = write_onnx(model, folder / "old.onnx", SIZE, batch=1, opset=13, metadata=facts)
    return {
        "onnxruntime": graph,
        "old": old,
        "openvino": write_openvino(graph, folder / "m.xml", facts),
    }


def images(count: int = 2) -> np.ndarray:
    return np.random.default_rng(0).random((count, 3, *SIZE), np.float32)


@pytest.mark.parametrize("name", ["onnxruntime", "openvino", "old", "torch"])
def test_files_and_runtimes_give_the_sigma_of_torch(name: str, model: DepthNet, files: dict) -> None:
    given = images(1 if name == "old" else 2)
    runtime = "onnxruntime" if name == "old" else name
    network = runtimes.load(files.get(name, model), runtime, threads=1)
    with torch.inference_mode():
        expected = model.predict(torch.from_numpy(given))
    found = network.predict(given)
    assert network.distribution == found.distribution == "laplace"
    np.testing.assert_allclose(found.depth, expected.depth.numpy(), rtol=1e-4)
    np.testing.assert_allclose(found.sigma, expected.sigma.numpy(), rtol=1e-4)
    np.testing.assert_array_equal(network(given), found.depth)


def test_a_file_that_takes_frames_gives_sigma_at_their_size(model: DepthNet, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    camera = (64, 128)
    facts = describe(model, "m", SIZE, camera_size=camera)
    path = write_onnx(model, tmp_path / "c.onnx", SIZE, opset=13, camera_size=camera, batch=1, metadata=facts)
    predictor = DepthPredictor(runtimes.load(path, "onnxruntime", threads=1), steady=False, uncertainty=True)
    found = predictor(photo(*camera))
    expected = DepthPredictor(model, SIZE, steady=False, uncertainty=True)(photo(*camera))
    assert found.sigma.shape == camera
    # sigma is resized itself in the graph, and as a share of the depth by the predictor
    for ours, theirs in ((found.depth, expected.depth), (found.sigma, expected.sigma)):
        assert np.median(np.abs(ours - theirs) / theirs) < 0.01


def test_the_predictor_gives_both_at_the_size_of_the_frame(model: DepthNet) -> None:
    frame = photo(48, 90)
    estimate = DepthPredictor(model, uncertainty=True)(frame)
    assert estimate.depth.shape == estimate.sigma.shape == (48, 90)
    np.testing.assert_array_equal(estimate.depth, DepthPredictor(model)(frame))
    low, high = estimate.interval(0.9)
    assert ((low < estimate.depth) & (estimate.depth < high)).all()


def test_the_predictor_refuses_a_network_without_sigma() -> None:
    with pytest.raises(ValueError, match=NO_SIGMA):
        DepthPredictor(small_net(), uncertainty=True)


def test_predict_writes_sigma_and_pales_what_it_does_not_know(
    model: DepthNet, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = save(tmp_path / "room.png", photo())
    folder = model.save_pretrained(tmp_path / "model", info=model.info)
    results = predict(settings(folder, source, tmp_path / "out", "formats=[depth,color,sigma]"))
    names = ["room_color.png", "room_depth.png", "room_sigma.png", "room_sigma_color.png"]
    assert listed(tmp_path / "out") == names
    read = [cv2.imread(str(tmp_path / "out" / name), cv2.IMREAD_UNCHANGED) for name in names]
    estimate = DepthPredictor(model, steady=False, sharp=True, uncertainty=True)(photo())
    np.testing.assert_allclose(read[2] / 1000, estimate.sigma, atol=6e-4)
    assert read[2].dtype == np.uint16
    panel = read[0][-5 * 48 :, 5 * 64 + 4 : 2 * 5 * 64 + 4]  # below its title; small photos are enlarged
    pale = (panel >= PALE).all(-1)
    share = estimate.unsure.mean()
    assert 0.05 < share < 0.95
    assert pale.sum() == pytest.approx(5 * 5 * estimate.unsure.sum(), rel=0.02)
    assert (results.unsure, results.pixels) == (estimate.unsure.sum(), 48 * 64)
    said = capsys.readouterr().out
    assert f"the network is unsure of {100 * share:.1f} % of the pixels" in said
    assert "in pale colors" in said

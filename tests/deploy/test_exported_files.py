"""Exported files of other sizes, opsets and batches; what cannot be exported."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from support.networks import light_net
from support.rooms_network import ROUNDING, SIZE

import eldenet
from eldenet.deploy import runtimes
from eldenet.deploy.metadata import describe
from eldenet.deploy.onnx_export import CameraNet, write_onnx
from eldenet.deploy.openvino_export import write_openvino
from eldenet.deploy.runtimes.module import RuntimeNetwork, measure_runtime_cost
from eldenet.evaluation.cost import count_macs
from eldenet.export import map_errors
from eldenet.geometry import resize_image

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")


def test_a_file_states_its_license_and_training_data(trained_model) -> None:
    model = eldenet.load("eldenet_s")
    assert describe(model, "mine", SIZE)["data"] == "none: freshly initialized"
    model.info = {"trained_on": "streets"}
    assert describe(model, "mine", SIZE)["data"] == "not stated"
    assert describe(trained_model, "m", SIZE, license="CC-BY-4.0")["license"] == "CC-BY-4.0"
    packaged = eldenet.load("eldenet_rooms")
    assert describe(packaged, "m", SIZE)["license"] == packaged.info["license"] != "not stated"


@pytest.mark.parametrize("camera", [(64, 128), (70, 100), (32, 100), (50, 64)])
def test_a_graph_shrinks_frames_as_the_data_sets_do(trained_model, camera: tuple[int, int]) -> None:
    """Up to their rounding to whole gray levels."""
    frame = np.random.default_rng(4).integers(0, 256, (*camera, 3), np.uint8)
    image = torch.from_numpy(frame).permute(2, 0, 1)[None].float()
    ours = CameraNet(trained_model, camera, SIZE).resized(image)[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(ours, resize_image(frame, SIZE), atol=0.51)


def test_a_file_of_an_old_opset_runs(trained_model, images, reference, tmp_path: Path) -> None:
    import onnx

    path = write_onnx(trained_model, tmp_path / "old.onnx", SIZE, batch=1, opset=11, metadata={"model": "m"})
    assert [entry.version for entry in onnx.load(path).opset_import] == [11]
    network = runtimes.load(path, "onnxruntime", threads=1)
    assert map_errors(network(images[:1]), reference[:1])["max_relative"] < ROUNDING
    with pytest.raises(ValueError, match="export another"):
        network(images)
    for wrong in ({"opset": 9}, {"opset": 19}, {"batch": 0}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))}="):
            write_onnx(trained_model, tmp_path / "wrong.onnx", SIZE, **wrong)
    with pytest.raises(ValueError, match=r"would stretch frames of camera=\[72, 96\]: give size=\[35, 47\]"):
        write_onnx(trained_model, tmp_path / "wrong.onnx", SIZE, camera_size=(72, 96))


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".onnx", ".xml"])
def test_a_file_of_a_fixed_batch_is_scored_at_that_batch(
    trained_model, images, reference, tmp_path: Path, ending: str
) -> None:
    facts = describe(trained_model, "eldenet_s", SIZE)
    path = write_onnx(trained_model, tmp_path / "two.onnx", SIZE, batch=2, metadata=facts)
    if ending == ".xml":
        path = write_openvino(path, tmp_path / "two.xml", facts)
    network = runtimes.load(path, threads=1)
    assert network.fixed_batch == 2
    scored = RuntimeNetwork(network)
    for count in (1, 2):  # the last batch of a set may be smaller
        depth = scored(torch.from_numpy(images[:count]))
        assert depth.shape[0] == count
        assert map_errors(depth.numpy(), reference[:count])["max_relative"] < ROUNDING
    with pytest.raises(ValueError, match="takes 2 images at once: give batch_size=2"):
        scored(torch.from_numpy(images))
    cost = measure_runtime_cost(network, SIZE)
    assert cost.batch == 2
    assert cost.throughput_img_s > 0
    assert math.isnan(cost.latency_ms_p50)  # the file does not take one image
    assert math.isnan(cost.latency_ms_p95)


@pytest.mark.slow
def test_a_file_of_any_size_states_its_multiply_adds_for_one_size(tmp_path: Path) -> None:
    model = light_net()
    path = write_onnx(model, tmp_path / "any.onnx", SIZE, any_size=True, metadata=describe(model, "m", SIZE))
    network = runtimes.load(path, threads=1)
    assert measure_runtime_cost(network, SIZE).gmacs == pytest.approx(count_macs(model, SIZE) / 1e9, rel=1e-5)
    assert math.isnan(measure_runtime_cost(network, (SIZE[0] * 2, SIZE[1])).gmacs)


def test_an_opset_that_cannot_express_a_network_is_refused_in_one_line(tmp_path: Path, capfd) -> None:
    with pytest.raises(ValueError, match="opset=11 cannot express this network: "):
        write_onnx(eldenet.load("meter_xxs"), tmp_path / "m.onnx", SIZE, batch=1, opset=11)
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")  # torch prints its whole graph


@pytest.mark.slow
@pytest.mark.parametrize(("opset", "batch"), [(18, None), (18, 1), (17, None)])
def test_openvino_takes_frames_that_are_no_multiple_of_the_networks_size(
    tmp_path: Path, opset: int, batch: int | None
) -> None:
    model, camera = light_net(), (75, 150)
    facts = describe(model, "small", SIZE, camera_size=camera)
    path = write_onnx(model, tmp_path / "c.onnx", SIZE, opset=opset, batch=batch, camera_size=camera)
    frames = np.random.default_rng(0).integers(0, 255, (batch or 3, *camera, 3), dtype=np.uint8)
    expected = runtimes.load(path, "onnxruntime", threads=1).run(frames)
    for file in (path, write_openvino(path, tmp_path / "c.xml", facts)):
        found = runtimes.load(file, "openvino", threads=1).run(frames)
        np.testing.assert_allclose(found, expected, rtol=1e-3)

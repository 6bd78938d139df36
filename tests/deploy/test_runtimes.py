"""One network gives the same meters under every runtime; a file describes itself."""

import copy
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from support.many_threads import outputs_by_thread
from support.networks import light_net
from support.rooms_network import CAMERA, HALF, INT8, ROUNDING, SIZE

import eldenet
from eldenet import runtimes
from eldenet.compose import compose
from eldenet.deploy.metadata import describe, read_metadata
from eldenet.deploy.onnx_export import quantize_onnx, write_onnx
from eldenet.deploy.openvino_export import quantize_openvino, write_openvino
from eldenet.deploy.predictor import DepthPredictor
from eldenet.evaluate import EvaluateSettings, open_checkpoint
from eldenet.export import count_operations, map_errors
from eldenet.model import DepthNet
from eldenet.system.resources import Resources

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")


@pytest.fixture(scope="module")
def files(
    trained_model: DepthNet, images: np.ndarray, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("exports")
    facts = describe(trained_model, "eldenet_s", SIZE)
    onnx = write_onnx(trained_model, folder / "fp32.onnx", SIZE, metadata=facts)
    return {
        "onnx": onnx,
        "xml": write_openvino(onnx, folder / "fp32.xml", facts),
        "int8 onnx": quantize_onnx(onnx, folder / "int8.onnx", [image[None] for image in images]),
        "int8 xml": quantize_openvino(onnx, folder / "int8.xml", [image[None] for image in images], facts),
        "frames": write_onnx(
            trained_model, folder / "frames.onnx", SIZE, batch=1, camera_size=CAMERA, opset=17,
            metadata=describe(trained_model, "eldenet_s", SIZE, camera_size=CAMERA),
        ),
    }  # fmt: skip


def bf16_there() -> bool:
    import openvino

    return "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")


@pytest.mark.parametrize(
    ("file", "runtime"), [("onnx", "onnxruntime"), ("onnx", "openvino"), ("onnx", "auto"), ("xml", "auto")]
)
def test_fp32_files_agree_with_torch(files, images, reference, file: str, runtime: str) -> None:
    network = runtimes.load(files[file], runtime, threads=1)
    assert (network.precision, network.threads, network.device) == ("fp32", 1, "cpu")
    assert network.runtime in ("onnxruntime", "openvino")
    assert network.info == {"input_size": SIZE, "model_name": "eldenet_s"}
    for count in (1, 2, 3):  # any batch
        depth = network(images[:count])
        assert map_errors(depth, reference[:count])["max_relative"] < ROUNDING
    as_tensor = network(torch.from_numpy(images))
    assert isinstance(as_tensor, torch.Tensor)
    np.testing.assert_array_equal(as_tensor.numpy(), network(images))


@pytest.mark.parametrize("runtime", ["torch", "torch_channels_last"])
def test_models_run_without_a_file_and_say_how_to_send_them(
    trained_model, images, reference, runtime: str
) -> None:
    network = runtimes.load(trained_model, runtime, threads=1)
    assert network.runtime == runtime
    with pytest.raises(TypeError, match="this network has no file: write one with eldenet export"):
        pickle.dumps(network)
    assert map_errors(network(images), reference)["max_relative"] < ROUNDING


@pytest.mark.slow
@pytest.mark.parametrize("runtime", ["onnxruntime", "openvino"])
def test_a_model_without_a_file_sees_frames_of_any_shape_as_torch_does(runtime: str) -> None:
    model = light_net()
    model.info = {"input_size": SIZE}
    file = DepthPredictor(runtimes.load(model, runtime, threads=1), steady=False)
    network = DepthPredictor(model, steady=False)
    for size in ((72, 128), (128, 72)):  # of another aspect than the training's
        frame = np.random.default_rng(0).integers(0, 255, (*size, 3), dtype=np.uint8)
        np.testing.assert_allclose(file(frame), network(frame), rtol=1e-3)
    fixed = runtimes.load(model, runtime, threads=1, size=(64, 64))
    assert fixed.fixed_size == (64, 64)
    with pytest.raises(TypeError, match="this network has no file: write one with eldenet export"):
        pickle.dumps(fixed)


@pytest.mark.parametrize(
    ("source", "runtime"),
    [
        ("model", "none"),
        ("model", "torch"),
        ("model", "torch_channels_last"),
        pytest.param("model", "torch_compile", marks=pytest.mark.slow),
        ("onnx", "onnxruntime"),
        ("onnx", "openvino"),
        ("xml", "openvino"),
        ("int8 onnx", "onnxruntime"),
        ("int8 xml", "openvino"),
        ("frames", "onnxruntime"),
        ("frames", "openvino"),
    ],
)
def test_each_of_eight_threads_gets_the_depth_of_its_own_frame(
    trained_model, files, source: str, runtime: str
) -> None:
    network = source = trained_model if source == "model" else files[source]
    if runtime != "none":
        network = runtimes.load(source, runtime, threads=1)
    predictor = DepthPredictor(network, SIZE)
    frames = [np.full((*CAMERA, 3), 10 + 30 * number, np.uint8) for number in range(8)]
    expected = [predictor(frame) for frame in frames]
    assert len({depth.tobytes() for depth in expected}) == 8  # a mix-up would be seen
    for depth, got in zip(expected, outputs_by_thread(predictor, frames, rounds=10), strict=True):
        np.testing.assert_array_equal(got, [depth] * 10)


@pytest.mark.slow
def test_compiled_torch_agrees(trained_model, images, reference) -> None:
    depth = runtimes.load(trained_model, "torch_compile", threads=1)(images)
    assert map_errors(depth, reference)["max_relative"] < ROUNDING


@pytest.mark.parametrize("runtime", ["torch", "torch_channels_last", "openvino"])
def test_bf16_is_near(trained_model, files, images, reference, runtime: str) -> None:
    if runtime == "openvino" and not bf16_there():
        pytest.skip("this processor does not multiply bf16")
    source = files["xml"] if runtime == "openvino" else trained_model
    network = runtimes.load(source, runtime, "bf16", threads=1)
    found = map_errors(network(images), reference)
    assert network.precision == "bf16"
    assert 1e-6 < found["median_relative"] < HALF  # it was bf16 indeed


@pytest.mark.parametrize(
    ("file", "runtime"), [("int8 onnx", "onnxruntime"), ("int8 onnx", "openvino"), ("int8 xml", "openvino")]
)
def test_int8_is_near(files, images, reference, file: str, runtime: str) -> None:
    network = runtimes.load(files[file], runtime, threads=1)
    found = map_errors(network(images), reference)
    assert network.precision == "int8"
    assert 1e-5 < found["median_relative"] < INT8
    assert files[file].stat().st_size > 0
    kinds = count_operations(files[file])
    assert kinds["QuantizeLinear"] + kinds["FakeQuantize"] > 10
    assert read_metadata(files[file])["precision"] == "int8"


def test_the_error_for_what_is_missing_lists_what_there_is(trained_model, files, images) -> None:
    for source, arguments, message in (
        (files["onnx"], {"runtime": "tvm"}, "give one of auto, torch, torch_channels_last"),
        (files["onnx"], {"runtime": "torch"}, "runs under onnxruntime or openvino, not under torch"),
        (files["onnx"], {"runtime": "onnxruntime", "precision": "bf16"}, "only fp32: bf16 runs under Open"),
        (files["onnx"], {"runtime": "onnxruntime", "precision": "fp8"}, "give one of fp32, bf16, fp16, int8"),
        (files["onnx"], {"runtime": "onnxruntime", "precision": "int8"}, "export it with precision=int8"),
        (files["onnx"], {"runtime": "openvino", "device": "fpga"}, "OpenVINO offers .*cpu"),
        (files["int8 xml"], {"precision": "bf16"}, "only int8: export it with precision=bf16"),
        (trained_model, {"precision": "int8"}, "for int8 export a file"),
        (trained_model, {"precision": "fp16"}, "for fp16 give device=cuda"),
        (
            trained_model,
            {"runtime": "onnxruntime", "precision": "int8"},
            "calibration pictures: export a file",
        ),
        (trained_model, {"device": "tpu"}, "give one of cpu, cuda"),
        (eldenet.load("eldenet_s"), {"runtime": "onnxruntime"}, "needs a size"),
    ):
        with pytest.raises(ValueError, match=message):
            runtimes.load(source, **arguments, threads=1)
    with pytest.raises(FileNotFoundError, match=r"nothing\.onnx does not exist"):
        runtimes.load("nothing.onnx")


def test_the_error_for_a_missing_provider_lists_the_installed_ones(files) -> None:
    import onnxruntime

    there = onnxruntime.get_available_providers()
    for device, provider in (("cuda", "CUDAExecutionProvider"), ("tensorrt", "TensorrtExecutionProvider")):
        if provider in there:
            continue
        with pytest.raises(ValueError, match=f"{provider}: this ONNX Runtime has .*{there[-1]}.*runtime-gpu"):
            runtimes.load(files["onnx"], "onnxruntime", device=device)
    named = runtimes.load(files["onnx"], "onnxruntime", device="CPUExecutionProvider")
    assert named.device == "cpu"


def test_evaluate_runs_a_file_where_it_is_asked_to(files, tmp_path) -> None:
    """Not on the CPU without a word: here no runtime has CUDA, and that is said."""
    import onnxruntime

    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("CUDA is there")
    resources = Resources(device="cuda", precision="fp32", threads=1, workers=0, cores=1)
    words = [f"checkpoint='{files['onnx']}'", "engine=onnxruntime"]
    with pytest.raises(ValueError, match="CUDAExecutionProvider"):
        open_checkpoint(compose(EvaluateSettings, [*words, "runtime.device=cuda"]), resources)
    assert open_checkpoint(compose(EvaluateSettings, words), resources).network.device == "cpu"


def test_wrong_images_are_refused(files, images) -> None:
    for network in (runtimes.load(files["onnx"], name, threads=1) for name in ("onnxruntime", "openvino")):
        with pytest.raises(ValueError, match=r"takes float32 RGB .* of shape \(any, 3, 32, 64\)"):
            network((images * 255).astype(np.uint8))
        with pytest.raises(ValueError, match="export another"):
            network(images[..., :-8])
        with pytest.raises(ValueError, match=r"values up to \d{3}: give floats in \[0, 1\]"):
            network(images * 255)


@pytest.mark.parametrize("runtime", ["auto", "onnxruntime", "openvino"])
def test_a_file_that_takes_no_images_is_refused(tmp_path: Path, runtime: str) -> None:
    onnx = pytest.importorskip("onnx")
    ports = [onnx.helper.make_tensor_value_info(name, 1, [3, 8, 8]) for name in "xy"]  # 1: float
    graph = onnx.helper.make_graph([onnx.helper.make_node("Abs", ["x"], ["y"])], "flat", ports[:1], ports[1:])
    opset = onnx.helper.make_opsetid("", 13)
    onnx.save(onnx.helper.make_model(graph, opset_imports=[opset], ir_version=8), tmp_path / "flat.onnx")
    with pytest.raises(ValueError, match=r"flat.onnx takes input of shape \(3, 8, 8\): give a file"):
        runtimes.load(tmp_path / "flat.onnx", runtime, threads=1)


def test_files_describe_themselves(files) -> None:
    for name in ("onnx", "xml"):
        facts = read_metadata(files[name])
        assert facts["model"] == "eldenet_s"
        assert facts["units"] == "meters"
        assert facts["license"] == "not stated"
        assert facts["eldenet_version"] == eldenet.__version__
        assert facts["input_size"] == "[32, 64]"
        assert facts["mean"] == "[0.485, 0.456, 0.406]"
        assert facts["std"] == "[0.229, 0.224, 0.225]"
        assert facts["data"] == "rooms"
        assert facts["protocol"] == "not stated"
        assert "(B, 3, H, W) in [0, 1]" in facts["input"]
    assert "uint8 RGB frame (B, H, W, 3)" in read_metadata(files["frames"])["input"]


def test_the_graph_has_no_superfluous_operations(files) -> None:
    kinds = count_operations(files["onnx"])
    assert kinds["BatchNormalization"] == 0
    assert kinds["DepthToSpace"] == 4  # the four up-convolutions
    assert kinds["Transpose"] == kinds["ScatterND"] == kinds["Slice"] == 0


@pytest.mark.parametrize("runtime", ["onnxruntime", "openvino"])
def test_a_camera_file_and_a_predictor_agree(trained_model, files, runtime: str) -> None:
    generator = np.random.default_rng(1)
    frame = cv2.resize(generator.integers(0, 255, (6, 8, 3), dtype=np.uint8), CAMERA[::-1])
    network = runtimes.load(files["frames"], runtime, threads=1)
    assert network.takes_frames
    assert network.camera_size == CAMERA
    expected = DepthPredictor(trained_model, SIZE)(frame)
    assert expected.shape == CAMERA
    depth = network(frame[None])
    assert depth.shape == (1, 1, *CAMERA)
    # the graph does not round the resized picture to whole gray levels
    assert map_errors(depth[0, 0], expected)["max_relative"] < 5e-3
    # and a predictor takes any runtime, of frames or of images
    np.testing.assert_array_equal(DepthPredictor(network)(frame), depth[0, 0])
    of_images = DepthPredictor(runtimes.load(files["onnx"], runtime, threads=1))(frame)
    assert map_errors(of_images, expected)["max_relative"] < ROUNDING
    with pytest.raises(ValueError, match=r"only takes \[32, 64\]"):
        DepthPredictor(network, (64, 64))


def test_a_folder_of_foreign_classes_needs_trust(trained_model, tmp_path: Path) -> None:
    folder = trained_model.save_pretrained(tmp_path / "model")
    config = folder / "config.json"
    text = config.read_text().replace("eldenet.heads", "tests_foreign.heads")
    config.write_text(text.replace("sha256", "none"))  # theirs has no digests
    with pytest.raises(ValueError, match="trusted_modules"):
        runtimes.load(folder, threads=1)
    with pytest.raises(ValueError, match="tests_foreign"):  # it is looked for now
        runtimes.load(folder, threads=1, trusted_modules=["tests_foreign"])


@pytest.mark.parametrize(("file", "runtime"), [("onnx", "onnxruntime"), ("xml", "openvino")])
def test_a_copy_and_another_process_open_the_file_again(files, images, file: str, runtime: str) -> None:
    network = runtimes.load(files[file], runtime, threads=1)
    for other in (pickle.loads(pickle.dumps(network)), copy.deepcopy(network)):
        np.testing.assert_array_equal(other(images), network(images))

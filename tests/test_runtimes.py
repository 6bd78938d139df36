"""One network under every runtime gives the same metres; a stream never waits for a slow network."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import nn

import eldenet
from eldenet import runtimes
from eldenet.config import compose
from eldenet.decoders.upconv import UpConv2d
from eldenet.evaluate import _open
from eldenet.exporting import (
    CameraNet,
    area_weights,
    count_operations,
    describe,
    differences,
    read_metadata,
    write_onnx,
    write_openvino,
)
from eldenet.folding import fold, merge_upconv
from eldenet.heads import LinearHead
from eldenet.model import DepthNet
from eldenet.predictor import DepthPredictor, resized
from eldenet.quantisation import quantise_onnx, quantise_openvino
from eldenet.resources import Resources
from eldenet.runtimes.onnx import OPTIONS, providers_behind
from eldenet.runtimes.scored import RuntimeNetwork, measure_runtime_cost

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")
SIZE, CAMERA = (32, 64), (72, 96)
ROUNDING, HALF, INT8 = 1e-5, 0.02, 0.05  # relative to torch's fp32: fp32 largest, bf16 and int8 median


@pytest.fixture(scope="module")
def model() -> DepthNet:
    """A trained one: an untrained map is far steeper than what rounding may be judged by."""
    model = eldenet.load("eldenet_rooms").eval()
    model.info = {"input_size": list(SIZE), "model_name": "eldenet_s", "data": "rooms"}
    return model


@pytest.fixture(scope="module")
def images() -> np.ndarray:
    """Smooth pictures: noise would be no test of a depth network's lower precisions."""
    generator = np.random.default_rng(0)
    coarse = generator.random((3, 4, 8, 3), dtype=np.float32)
    return np.stack([cv2.resize(each, SIZE[::-1]).transpose(2, 0, 1) for each in coarse])


@pytest.fixture(scope="module")
def reference(model: DepthNet, images: np.ndarray) -> np.ndarray:
    with torch.inference_mode():
        return model(torch.from_numpy(images)).numpy()


@pytest.fixture(scope="module")
def files(model: DepthNet, images: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("exports")
    facts = describe(model, "eldenet_s", SIZE)
    onnx = write_onnx(model, folder / "fp32.onnx", SIZE, metadata=facts)
    return {
        "onnx": onnx,
        "xml": write_openvino(onnx, folder / "fp32.xml", facts),
        "int8 onnx": quantise_onnx(onnx, folder / "int8.onnx", [image[None] for image in images]),
        "int8 xml": quantise_openvino(onnx, folder / "int8.xml", [image[None] for image in images], facts),
        "frames": write_onnx(
            model, folder / "frames.onnx", SIZE, batch=1, camera_size=CAMERA,
            metadata=describe(model, "eldenet_s", SIZE, camera_size=CAMERA),
        ),
    }  # fmt: skip


def bf16_there() -> bool:
    import openvino

    return "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES")


# --- the inference form -------------------------------------------------------------------------------------


@pytest.mark.parametrize("fast", [True, False])
def test_a_merged_upconvolution_is_the_operator_itself(fast: bool) -> None:
    layer, x = UpConv2d(5, 3, fast=fast).double(), torch.randn(2, 5, 4, 7, dtype=torch.float64)
    bias = torch.randn(3, dtype=torch.float64)
    torch.testing.assert_close(
        merge_upconv(layer.weight, bias)(x), layer.unpooled(x) + bias[:, None, None], rtol=0, atol=1e-12
    )


def test_folding_changes_nothing_but_the_work(model: DepthNet, images: np.ndarray, reference) -> None:
    before = {name: value.clone() for name, value in model.state_dict().items()}
    folded = fold(model)
    assert not any(isinstance(part, nn.BatchNorm2d) for part in folded.modules())
    with torch.inference_mode():
        assert differences(folded(torch.from_numpy(images)).numpy(), reference)["max_relative"] < ROUNDING
    for name, value in model.state_dict().items():
        assert torch.equal(value, before[name]), name


@pytest.mark.parametrize("name", ["resnet18_upconv"])
def test_resnet_blocks_are_folded(name: str) -> None:
    torch.manual_seed(0)
    model = eldenet.load(name).eval()
    for part in model.modules():
        if isinstance(part, nn.BatchNorm2d):
            part.running_mean.uniform_(-0.2, 0.2)
            part.running_var.uniform_(0.5, 1.5)
    folded = fold(model)
    assert not any(isinstance(part, nn.BatchNorm2d) for part in folded.modules())
    image = torch.rand(1, 3, *SIZE)
    with torch.inference_mode():
        assert differences(folded(image).numpy(), model(image).numpy())["max_relative"] < ROUNDING


class ActiveNorm(nn.BatchNorm2d):
    """Normalisation and activation in one, as timm's ``BatchNormAct2d``."""

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        return super().forward(input).relu()


class HalvedConv(nn.Conv2d):
    """Computes something else than its base from the same weights, as weight standardisation does."""

    def forward(self, input: torch.Tensor) -> torch.Tensor:
        return super().forward(input) / 2


@pytest.mark.parametrize("parts", [(nn.Conv2d, ActiveNorm), (HalvedConv, nn.BatchNorm2d)])
def test_what_does_more_than_its_base_is_not_folded(parts: tuple[type, type]) -> None:
    torch.manual_seed(0)
    conv, norm = parts
    network = nn.Sequential(conv(3, 4, 3, padding=1), norm(4), nn.Conv2d(4, 1, 1))
    network[1].running_mean.uniform_(-0.2, 0.2)
    network[1].running_var.uniform_(0.5, 1.5)
    model, image = DepthNet(network, LinearHead()).eval(), torch.rand(1, 3, *SIZE)
    with torch.inference_mode():
        assert differences(fold(model)(image).numpy(), model(image).numpy())["max_relative"] < ROUNDING


# --- runtimes -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("file", "runtime"),
    [("onnx", "onnxruntime"), ("onnx", "openvino"), ("xml", "openvino"), ("onnx", "auto"), ("xml", "auto")],
)
def test_fp32_files_agree_with_torch(files, images, reference, file: str, runtime: str) -> None:
    network = runtimes.load(files[file], runtime, threads=1)
    assert (network.precision, network.threads, network.device) == ("fp32", 1, "cpu")
    assert network.runtime in ("onnxruntime", "openvino")
    assert network.info == {"input_size": SIZE, "model_name": "eldenet_s"}
    for count in (1, 2, 3):  # any batch
        depth = network(images[:count])
        assert differences(depth, reference[:count])["max_relative"] < ROUNDING
    as_tensor = network(torch.from_numpy(images))
    assert isinstance(as_tensor, torch.Tensor)
    np.testing.assert_array_equal(as_tensor.numpy(), network(images))


@pytest.mark.parametrize("runtime", ["torch", "torch_channels_last", "onnxruntime"])
def test_models_run_without_a_file(model, images, reference, runtime: str) -> None:
    network = runtimes.load(model, runtime, threads=1)
    assert network.runtime == runtime
    assert differences(network(images), reference)["max_relative"] < ROUNDING


def test_a_training_or_model_folder_runs(model, images, reference, tmp_path: Path) -> None:
    model.save_pretrained(tmp_path / "run" / "model")
    for folder in (tmp_path / "run", tmp_path / "run" / "model"):
        depth = runtimes.load(folder, threads=1)(images)
        assert differences(depth, reference)["max_relative"] < ROUNDING


@pytest.mark.slow
def test_compiled_torch_agrees(model, images, reference) -> None:
    depth = runtimes.load(model, "torch_compile", threads=1)(images)
    assert differences(depth, reference)["max_relative"] < ROUNDING


@pytest.mark.parametrize("runtime", ["torch", "torch_channels_last", "openvino"])
def test_bf16_is_near(model, files, images, reference, runtime: str) -> None:
    if runtime == "openvino" and not bf16_there():
        pytest.skip("this processor does not multiply bf16")
    source = files["xml"] if runtime == "openvino" else model
    network = runtimes.load(source, runtime, "bf16", threads=1)
    found = differences(network(images), reference)
    assert network.precision == "bf16"
    assert 1e-6 < found["median_relative"] < HALF  # it was bf16 indeed


@pytest.mark.parametrize(
    ("file", "runtime"), [("int8 onnx", "onnxruntime"), ("int8 onnx", "openvino"), ("int8 xml", "openvino")]
)
def test_int8_is_near(files, images, reference, file: str, runtime: str) -> None:
    network = runtimes.load(files[file], runtime, threads=1)
    found = differences(network(images), reference)
    assert network.precision == "int8"
    assert 1e-5 < found["median_relative"] < INT8
    assert files[file].stat().st_size > 0
    kinds = count_operations(files[file])
    assert kinds["QuantizeLinear"] + kinds["FakeQuantize"] > 10
    assert read_metadata(files[file])["precision"] == "int8"


def test_what_is_not_there_is_said(model, files, images) -> None:
    for source, arguments, message in (
        (files["onnx"], {"runtime": "tvm"}, "choose auto, torch, torch_channels_last"),
        (files["onnx"], {"runtime": "torch"}, "runs under onnxruntime or openvino, not under torch"),
        (files["onnx"], {"runtime": "onnxruntime", "precision": "bf16"}, "only fp32: bf16 runs under Open"),
        (files["onnx"], {"runtime": "onnxruntime", "precision": "fp8"}, "choose fp32, bf16, fp16, int8"),
        (files["onnx"], {"runtime": "onnxruntime", "precision": "int8"}, "export it with precision=int8"),
        (files["onnx"], {"runtime": "openvino", "device": "fpga"}, "OpenVINO here has .*cpu"),
        (files["int8 xml"], {"precision": "bf16"}, "only int8"),
        (model, {"precision": "int8"}, "export a file"),
        (model, {"runtime": "onnxruntime", "precision": "int8"}, "calibration frames: export a file"),
        (model, {"device": "tpu"}, "torch runs on cpu or cuda"),
        (eldenet.load("eldenet_s"), {"runtime": "onnxruntime"}, "needs a size"),
    ):
        with pytest.raises(ValueError, match=message):
            runtimes.load(source, **arguments, threads=1)
    with pytest.raises(FileNotFoundError, match=r"nothing\.onnx does not exist"):
        runtimes.load("nothing.onnx")


def test_a_missing_provider_names_those_there_are(files) -> None:
    import onnxruntime

    there = onnxruntime.get_available_providers()
    for device, provider in (("cuda", "CUDAExecutionProvider"), ("tensorrt", "TensorrtExecutionProvider")):
        if provider in there:
            continue
        with pytest.raises(ValueError, match=f"needs ONNX Runtime's {provider}.*{there[-1]}.*runtime-gpu"):
            runtimes.load(files["onnx"], "onnxruntime", device=device)
    named = runtimes.load(files["onnx"], "onnxruntime", device="CPUExecutionProvider")
    assert named.device == "cpu"


def test_an_accelerators_fp32_is_fp32() -> None:
    cpu, cuda, tensorrt = (f"{name}ExecutionProvider" for name in ("CPU", "CUDA", "Tensorrt"))
    assert providers_behind(cpu, [cuda, cpu]) == [cpu]
    assert providers_behind(cuda, [tensorrt, cuda, cpu]) == [cuda, cpu]
    assert providers_behind(tensorrt, [tensorrt, cuda, cpu]) == [tensorrt, cuda, cpu]
    assert providers_behind(tensorrt, [tensorrt, cpu]) == [tensorrt, cpu]
    assert OPTIONS[cuda] == {"use_tf32": "0"}  # ONNX Runtime's own default is TF32


def test_evaluate_runs_a_file_where_it_is_asked_to(files) -> None:
    """Not on the CPU without a word: here no runtime has CUDA, and that is said."""
    import onnxruntime

    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("CUDA is there")
    resources = Resources(device="cuda", precision="fp32", threads=1, workers=0, cores=1)
    words = [f"checkpoint='{files['onnx']}'", "engine=onnxruntime"]
    with pytest.raises(ValueError, match="CUDAExecutionProvider"):
        _open(compose("evaluate", [*words, "runtime.device=cuda"]), resources)
    assert _open(compose("evaluate", words), resources).network.device == "cpu"


def test_wrong_images_are_refused(files, images) -> None:
    for network in (runtimes.load(files["onnx"], name, threads=1) for name in ("onnxruntime", "openvino")):
        with pytest.raises(ValueError, match=r"this network takes \(B, 3, H, W\) float32"):
            network((images * 255).astype(np.uint8))
        with pytest.raises(ValueError, match="export another"):
            network(images[..., :-8])


# --- files --------------------------------------------------------------------------------------------------


def test_files_say_what_they_are(files) -> None:
    for name in ("onnx", "xml"):
        facts = read_metadata(files[name])
        assert facts["model"] == "eldenet_s"
        assert facts["units"] == "metres"
        assert facts["licence"] == "not stated"
        assert facts["eldenet_version"] == eldenet.__version__
        assert facts["input_size"] == "[32, 64]"
        assert facts["mean"] == "[0.485, 0.456, 0.406]"
        assert facts["std"] == "[0.229, 0.224, 0.225]"
        assert facts["data"] == "rooms"
        assert facts["protocol"] == "not stated"
        assert "(B, 3, H, W) in [0, 1]" in facts["input"]
    assert "uint8 RGB frame (B, H, W, 3)" in read_metadata(files["frames"])["input"]


def test_a_licence_is_what_somebody_stated(model: DepthNet) -> None:
    assert describe(model, "m", SIZE, licence="CC-BY-4.0")["licence"] == "CC-BY-4.0"
    packaged = eldenet.load("eldenet_rooms")
    assert describe(packaged, "m", SIZE)["licence"] == packaged.info["licence"] != "not stated"


def test_nothing_runs_twice_in_the_graph(files) -> None:
    kinds = count_operations(files["onnx"])
    assert kinds["BatchNormalization"] == 0
    assert kinds["DepthToSpace"] == 4  # the four up-convolutions
    assert kinds["Transpose"] == kinds["ScatterND"] == kinds["Slice"] == 0


@pytest.mark.parametrize("runtime", ["onnxruntime", "openvino"])
def test_frames_in_metres_out(model, files, runtime: str) -> None:
    generator = np.random.default_rng(1)
    frame = cv2.resize(generator.integers(0, 255, (6, 8, 3), dtype=np.uint8), CAMERA[::-1])
    network = runtimes.load(files["frames"], runtime, threads=1)
    assert network.takes_frames
    assert network.camera_size == CAMERA
    expected = DepthPredictor(model, SIZE)(frame)
    assert expected.shape == CAMERA
    depth = network(frame[None])
    assert depth.shape == (1, 1, *CAMERA)
    # the graph does not round the resized picture to whole grey levels
    assert differences(depth[0, 0], expected)["max_relative"] < 5e-3
    # and a predictor takes any runtime, of frames or of images
    np.testing.assert_array_equal(DepthPredictor(network)(frame), depth[0, 0])
    of_images = DepthPredictor(runtimes.load(files["onnx"], runtime, threads=1))(frame)
    assert differences(of_images, expected)["max_relative"] < ROUNDING
    with pytest.raises(ValueError, match=r"sees \[32, 64\] only"):
        DepthPredictor(network, (64, 64))


@pytest.mark.parametrize("camera", [(64, 128), (20, 40), (70, 100), SIZE])
def test_frames_of_other_sizes(model, camera: tuple[int, int], tmp_path: Path) -> None:
    frame = cv2.resize(np.random.default_rng(2).integers(0, 255, (4, 6, 3), np.uint8), camera[::-1])
    facts = describe(model, "m", SIZE, camera_size=camera)
    path = write_onnx(model, tmp_path / "m.onnx", SIZE, batch=1, opset=13, camera_size=camera, metadata=facts)
    depth = runtimes.load(path, "onnxruntime", threads=1)(frame[None])[0, 0]
    found = differences(depth, DepthPredictor(model, SIZE)(frame))
    assert (
        found["max_relative"] < 0.02
    )  # OpenCV rounds to grey levels, and where a frame grows its weights too
    assert found["median_relative"] < 2e-3


@pytest.mark.parametrize("camera", [(64, 128), (70, 100), (32, 100), (50, 64)])
def test_a_graph_shrinks_a_frame_as_the_data_sets_do(model, camera: tuple[int, int]) -> None:
    """But for their rounding to whole grey levels, and where one side stays as it is, too."""
    frame = np.random.default_rng(4).integers(0, 256, (*camera, 3), np.uint8)
    image = torch.from_numpy(frame).permute(2, 0, 1)[None].float()
    ours = CameraNet(model, camera, SIZE).resized(image)[0].permute(1, 2, 0).numpy()
    np.testing.assert_allclose(ours, resized(frame, SIZE), atol=0.51)


def test_area_weights_equal_opencv() -> None:
    picture = np.random.default_rng(3).random((48, 70)).astype(np.float32)
    ours = area_weights(48, 21).numpy() @ picture @ area_weights(70, 32).numpy().T
    np.testing.assert_allclose(ours, cv2.resize(picture, (32, 21), interpolation=cv2.INTER_AREA), atol=1e-6)


def test_a_static_file_of_an_old_opset(model, images, reference, tmp_path: Path) -> None:
    import onnx

    path = write_onnx(model, tmp_path / "old.onnx", SIZE, batch=1, opset=11, metadata={"model": "m"})
    assert [entry.version for entry in onnx.load(path).opset_import] == [11]
    network = runtimes.load(path, "onnxruntime", threads=1)
    assert differences(network(images[:1]), reference[:1])["max_relative"] < ROUNDING
    with pytest.raises(ValueError, match="export another"):
        network(images)
    for wrong in ({"opset": 9}, {"opset": 19}, {"batch": 0}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))}="):
            write_onnx(model, tmp_path / "wrong.onnx", SIZE, **wrong)
    with pytest.raises(ValueError, match="shrink one way and grow the other"):
        write_onnx(model, tmp_path / "wrong.onnx", SIZE, camera_size=(16, 128))


@pytest.mark.parametrize("ending", [".onnx", ".xml"])
def test_a_file_of_a_fixed_batch_is_scored_at_that_batch(
    model, images, reference, tmp_path: Path, ending: str
) -> None:
    facts = describe(model, "eldenet_s", SIZE)
    path = write_onnx(model, tmp_path / "two.onnx", SIZE, batch=2, metadata=facts)
    if ending == ".xml":
        path = write_openvino(path, tmp_path / "two.xml", facts)
    network = runtimes.load(path, threads=1)
    assert network.fixed_batch == 2
    scored = RuntimeNetwork(network)
    for count in (1, 2):  # the last batch of a set may be smaller
        depth = scored(torch.from_numpy(images[:count]))
        assert depth.shape[0] == count
        assert differences(depth.numpy(), reference[:count])["max_relative"] < ROUNDING
    with pytest.raises(ValueError, match="takes 2 images at once: give batch_size=2"):
        scored(torch.from_numpy(images))
    cost = measure_runtime_cost(network, SIZE)
    assert cost.batch == 2
    assert cost.throughput_img_s > 0
    assert math.isnan(cost.latency_ms_p50)  # of one image, which this file does not take
    assert math.isnan(cost.latency_ms_p95)


def test_any_batch_is_not_fixed(model, files) -> None:
    for source, runtime in ((files["onnx"], "onnxruntime"), (files["xml"], "openvino"), (model, "torch")):
        assert runtimes.load(source, runtime, threads=1).fixed_batch is None


def test_an_opset_that_cannot_express_a_network(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="opset=11 cannot express this network: "):
        write_onnx(eldenet.load("meter_xxs"), tmp_path / "m.onnx", SIZE, batch=1, opset=11)
    assert not list(tmp_path.iterdir())


def test_a_folder_of_foreign_classes_needs_trust(model, tmp_path: Path) -> None:
    folder = model.save_pretrained(tmp_path / "model")
    config = folder / "config.json"
    config.write_text(config.read_text().replace("eldenet.heads", "tests_foreign.heads"))
    with pytest.raises(ValueError, match="trusted_modules"):
        runtimes.load(folder, threads=1)
    with pytest.raises(ValueError, match="tests_foreign") as error:  # it is looked for now
        runtimes.load(folder, threads=1, trusted_modules=["tests_foreign"])
    assert "trusted_modules" not in str(error.value)

"""``python -m eldenet.export``, for every family of networks in the zoo."""

from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from support.networks import canonical_net, light_net, rounding_down_net, small_net

import eldenet
from eldenet.backbones.base import Backbone, outputs_of
from eldenet.backbones.efficientnet import EfficientNetLite
from eldenet.compose import compose
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.decoders.upconv import UpConvDecoder
from eldenet.deploy import runtimes
from eldenet.deploy.calibration_pictures import read_pictures
from eldenet.deploy.metadata import read_metadata
from eldenet.deploy.onnx_export import needs_fixed_size, write_onnx
from eldenet.deploy.predictor import DepthPredictor
from eldenet.export import ExportSettings, compare_with_torch, export, map_errors, target_of
from eldenet.results.run_log import RunLog
from eldenet.types import FeatureInfo
from eldenet.uncertainty import DepthEstimate

pytest.importorskip("onnxruntime")
pytest.importorskip("openvino")
SIZE = (32, 64)


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    generator = np.random.default_rng(0)
    for number in range(6):
        coarse = generator.integers(0, 255, (4, 6, 3), dtype=np.uint8)
        assert cv2.imwrite(str(folder / f"{number}.jpg"), cv2.resize(coarse, (96, 72)))
    return folder


@pytest.fixture(scope="module")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("trained") / "model"
    info = {"input_size": list(SIZE), "model_name": "mine", "data": "rooms", "protocol": "rooms"}
    return eldenet.load("eldenet_s").save_pretrained(folder, info=info)


def run(folder: Path, photos: Path, *overrides: str) -> Path:
    quoted = [f"checkpoint='{folder}'", f"pictures='{photos}'", "calibration=6", "checks=2"]
    return export(compose(ExportSettings, [*quoted, *overrides]))


def image_of(photos: Path) -> np.ndarray:
    picture = cv2.cvtColor(cv2.imread(str(photos / "0.jpg")), cv2.COLOR_BGR2RGB)
    small = cv2.resize(picture, SIZE[::-1], interpolation=cv2.INTER_AREA)
    return (small.transpose(2, 0, 1)[None] / 255).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("name", eldenet.list_models())
def test_every_family_exports_and_agrees_with_torch(name: str, tmp_path: Path) -> None:
    torch.manual_seed(0)
    model = eldenet.load(name)
    image = np.random.default_rng(0).random((1, 3, *SIZE), dtype=np.float32)
    opset = 18 if name == "eldenet_paper" else 17  # the older exporter is quick, and lacks its unfold
    path = write_onnx(model, tmp_path / "m.onnx", SIZE, batch=1, opset=opset)
    with torch.inference_mode():
        reference = model(torch.from_numpy(image)).numpy()
    for runtime in ("onnxruntime", "openvino"):
        depth = runtimes.load(path, runtime, threads=1)(image)
        assert map_errors(depth, reference)["max_relative"] < 1e-4


def test_the_command_exports_from_another_folder(
    run_command, model_folder: Path, photos: Path, tmp_path: Path
) -> None:
    words = (f"checkpoint={model_folder}", f"pictures={photos}", "opset=13")  # an old one: of one size
    done = run_command("export", *words, "checks=2")
    assert done.returncode == 0, done.stderr
    path = tmp_path / "exports" / "mine-32x64-fp32.onnx"
    for text in (
        "the file beside torch on 2 pictures, seen at 32 x 64",
        "0 batch normalizations",
        "exports/mine-32x64-fp32",
    ):
        assert text in done.stdout
    facts = read_metadata(path)
    assert (facts["model"], facts["data"], facts["protocol"]) == ("mine", "rooms", "rooms")
    depth = runtimes.load(path, threads=1)(image_of(photos))
    with torch.inference_mode():
        reference = eldenet.load(model_folder)(torch.from_numpy(image_of(photos))).numpy()
    assert map_errors(depth, reference)["max_relative"] < 1e-5
    again = run_command("export", *words)
    assert again.returncode == 1
    assert "already exists: give another output=, or overwrite=true" in again.stderr
    assert "Traceback" not in again.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weights", "words"),
    [
        *((weights, ["opset=17"]) for weights in eldenet.list_weights()),  # by the exporter that is quick
        ("eldenet_l_indoor", []),
        ("eldenet_indoor", ["camera=[90,160]"]),
    ],
)
def test_every_packaged_network_exports_and_agrees_with_torch(
    weights: str, words: list[str], photos: Path, tmp_path: Path, capsys
) -> None:
    """``export`` refuses an fp32 file that differs; some of them see pictures that are a little squeezed."""
    run(weights, photos, f"output='{tmp_path / 'm.onnx'}'", "batch=1", *words)
    outputs = 1 if eldenet.load(weights).distribution is None else 2
    said = capsys.readouterr().out
    assert said.count("onnxruntime") == said.count("openvino") == outputs


@pytest.mark.parametrize("words", [["size=[40,60]"], ["camera=[80,120]", "size=[40,60]"], ["size=[64,128]"]])
def test_a_network_with_a_canonical_camera_is_compared_at_any_one_size(
    photos: Path, tmp_path: Path, words: list[str], capsys
) -> None:
    """Neither another aspect than the training's nor another scale counts as a difference from torch."""
    folder = canonical_net(*SIZE).save_pretrained(tmp_path / "model")
    run(folder, photos, f"output='{tmp_path / 'm.onnx'}'", "opset=17", *words)
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if " depth " in line]
    assert [row[0] for row in rows if float(row[-1]) < 1e-5] == ["onnxruntime", "openvino"]


@pytest.mark.slow
@pytest.mark.parametrize("format", ["onnx", "openvino"])
def test_int8_files_run(model_folder: Path, photos: Path, tmp_path: Path, format: str, capsys) -> None:
    ending = {"onnx": "onnx", "openvino": "xml"}[format]
    output = tmp_path / f"small.{ending}"
    path = run(model_folder, photos, f"format={format}", "precision=int8", f"output='{output}'", "opset=17")
    said = capsys.readouterr().out
    assert "int8: scales from 6 pictures" in said
    assert "mine, int8: the file beside torch on 2 pictures" in said
    assert runtimes.load(path, threads=1).precision == "int8"


@pytest.mark.slow
def test_the_first_convolution_of_an_int8_file_stays_fp32(
    model_folder: Path, photos: Path, tmp_path: Path
) -> None:
    """Eight bits of the normalized picture cost the most accuracy."""
    import onnx

    path = run(model_folder, photos, "precision=int8", f"output='{tmp_path / 'q.onnx'}'", "batch=1")
    graph = onnx.load(path).graph
    makers = {name: node.op_type for node in graph.node for name in node.output}
    inputs = [[makers.get(name) for name in node.input] for node in graph.node if node.op_type == "Conv"]
    assert "DequantizeLinear" not in inputs[0]
    assert len(inputs) > 10
    assert all(kinds[:2] == ["DequantizeLinear"] * 2 for kinds in inputs[1:])


def test_bf16_is_a_way_to_run_fp32_weights(model_folder: Path, photos: Path, tmp_path: Path, capsys) -> None:
    output = tmp_path / "m.xml"
    path = run(model_folder, photos, "format=openvino", "precision=bf16", f"output='{output}'", "opset=17")
    assert read_metadata(path)["precision"] == "bf16"
    import openvino

    if "BF16" in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES"):
        assert runtimes.load(path, threads=1).precision == "bf16"
    else:
        assert "not compared under openvino" in capsys.readouterr().out
    assert runtimes.load(path, precision="fp32", threads=1).precision == "fp32"


@pytest.mark.parametrize("name", ["m.onnx", "m.xml"])
def test_a_file_that_differs_from_torch_is_removed(
    model_folder: Path, photos: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("eldenet.export.FP32_TOLERANCE", 0.0)
    form = "openvino" if name.endswith("xml") else "onnx"
    with pytest.raises(ValueError, match="differs from torch, so it was removed"):
        run(model_folder, photos, f"format={form}", f"output='{tmp_path / name}'", "opset=17")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("factor", "warned"), [(1.05, True), (1.01, False)])
def test_a_costly_int8_file_is_warned_of(
    factor: float, warned: bool, model_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    """Above 2 % in the median, with the worst pixel beside it."""
    words = [f"checkpoint='{model_folder}'", "precision=int8", f"output='{tmp_path / 'q.onnx'}'"]
    model = eldenet.load(model_folder)
    target = target_of(compose(ExportSettings, words), model)

    class Int8:
        def predict(self, image: np.ndarray, focal: float | None = None) -> DepthEstimate:
            depth = model(torch.from_numpy(image)).detach().numpy() * factor
            depth[..., 0, 0] *= 3 / factor
            return DepthEstimate(depth)

    monkeypatch.setattr(runtimes, "load", lambda *_, **__: Int8())
    monkeypatch.setattr(runtimes, "installed", lambda name: name == "onnxruntime")
    compare_with_torch(target, model, [np.full((*SIZE, 3), 90, np.uint8)], RunLog(tmp_path))
    said = " ".join(capsys.readouterr().out.split())
    assert ("is 5.0% off torch in the median pixel and 200% in the worst" in said) == warned


def test_a_file_that_no_runtime_loads_is_removed(
    model_folder: Path, photos: Path, tmp_path: Path, monkeypatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise ValueError("an operation is missing")

    monkeypatch.setattr(runtimes, "load", refuse)
    with pytest.raises(ValueError, match=r"removed, as no runtime here loads it \(an operation is missing\)"):
        run(model_folder, photos, f"output='{tmp_path / 'm.onnx'}'", "opset=17")
    assert not list(tmp_path.glob("m.*"))


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (["format=tflite"], "onnx, openvino"),
        (["precision=bf16"], "for format=onnx choose from fp32, int8; for bf16 give format=openvino"),
        (["size=[32]"], r"size=\[32\]: give \[height, width\]"),
        (["camera=5"], r"camera=5: give \[height, width\]"),
        (["output=depth.xml"], r"needs a name that ends in \.onnx"),
        (["batch=all"], "batch=all: give a whole number or null"),
        (["pictures=[a.jpg,b.jpg]"], r"pictures=\[a.jpg,b.jpg\]: give a text or null"),
        (["calibration=0"], "calibration=0: give a whole number, 1 or more"),
        (["checks=0"], "checks=0: give a whole number, 1 or more"),
        (["opset=5"], "opset=5: choose 11 to 18"),
        (["opset=12", "precision=int8"], "opset=12: int8 in ONNX has a scale per channel: give 13 or more"),
        (["pictures=/nowhere/*.jpg"], "holds no pictures: give a folder, or a pattern"),
    ],
)
def test_wrong_settings_are_refused(
    model_folder: Path, photos: Path, overrides: list[str], message: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        run(model_folder, photos, *overrides)
    assert not list(tmp_path.rglob("*.onnx"))


def test_pictures_are_spread_evenly(photos: Path) -> None:
    assert len(read_pictures(str(photos), 100, "test")) == 6
    first, last = read_pictures(f"{photos}/*.jpg", 2, "test")
    assert first.shape == last.shape == (72, 96, 3)
    np.testing.assert_array_equal(last, cv2.imread(str(photos / "5.jpg"))[..., ::-1])


@pytest.mark.slow
def test_a_file_of_any_size_crops_what_a_decoder_makes_beyond_an_odd_image(tmp_path: Path) -> None:
    network = small_net(backbone=EfficientNetLite(blocks=[1] * 4), decoder=UpConvDecoder)
    path = write_onnx(network, tmp_path / "any.onnx", (64, 96), any_size=True)
    file, image = runtimes.load(path, "onnxruntime", threads=1), torch.rand(1, 3, 49, 67)
    with torch.inference_mode():
        np.testing.assert_allclose(file(image.numpy()), network(image).numpy(), rtol=1e-3)


def test_a_network_that_rounds_down_has_no_file_of_any_size(photos: Path, tmp_path: Path) -> None:
    """The exporter keeps the branch of its example, which has nothing to pad; ConvNeXt rounds down."""
    folder = rounding_down_net().save_pretrained(tmp_path / "model", info={"input_size": [64, 96]})
    with pytest.raises(ValueError, match=r"no graph for any size: give size=\[64, 96\]"):
        run(folder, photos, f"output='{tmp_path / 'm.onnx'}'")
    assert not list(tmp_path.glob("*.onnx"))


class Patches(Backbone):
    """Patches of 4 x 4 pixels, then a convolution that rounds odd sides up; ``fixed``: of one size alone."""

    def __init__(self, fixed: int = 0) -> None:
        super().__init__()
        self.feature_info = (FeatureInfo(8, 4), FeatureInfo(16, 8))
        self.parts = torch.nn.ModuleList(
            [torch.nn.Conv2d(3, 8, 4, stride=4), torch.nn.Conv2d(8, 16, 3, stride=2, padding=1)]
        )
        self.fixed = fixed

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        assert self.fixed in (0, image.shape[-1])  # as timm's Swin
        return outputs_of(self.parts, image, (0, 1))


def test_patches_that_leave_out_an_edge_have_a_graph_for_any_size() -> None:
    """PoolFormer: no decoder pads, as only the first feature is rounded down."""
    decoder = partial(FastUpConvDecoder, modules=1)
    assert not needs_fixed_size(small_net(backbone=Patches(), decoder=decoder))


def test_a_backbone_of_one_size_has_no_graph_for_any_size(tmp_path: Path) -> None:
    network = small_net(backbone=Patches(64), decoder=partial(FastUpConvDecoder, modules=1))
    with pytest.raises(ValueError, match="this network has no graph for any size"):
        write_onnx(network, tmp_path / "m.onnx", (64, 64), any_size=True)


def test_a_runtime_that_cannot_run_a_file_of_any_size_is_named_with_advice(
    model_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lite-Mono's padding cannot be told from its features."""
    model = eldenet.load(model_folder)
    target = target_of(compose(ExportSettings, [f"checkpoint='{model_folder}'"]), model)
    monkeypatch.setattr(runtimes, "load", lambda *_, **__: None)  # whatever it raises
    picture = np.zeros((*SIZE, 3), np.uint8)
    with pytest.raises(ValueError, match=rf"cannot run it at any size: give size=\[{SIZE[0]}, {SIZE[1]}\]"):
        compare_with_torch(target, model, [picture], RunLog(tmp_path))


@pytest.mark.slow
def test_a_file_of_any_size_predicts_what_torch_predicts(photos: Path, tmp_path: Path) -> None:
    """Pictures of every shape are seen as by torch: without a border, at the same scale."""
    folder = light_net().save_pretrained(tmp_path / "model", info={"input_size": list(SIZE)})
    path = run(folder, photos, f"output='{tmp_path / 'any.onnx'}'")
    network = DepthPredictor(eldenet.load(folder), steady=False)
    for runtime in ("onnxruntime", "openvino"):
        file = DepthPredictor(runtimes.load(path, runtime, threads=1), steady=False)
        for size in ((64, 128), (90, 120), (120, 90), (160, 90), (60, 120)):
            picture = np.random.default_rng(0).integers(0, 255, (*size, 3), dtype=np.uint8)
            assert file.size_for(*size) == network.size_for(*size)
            np.testing.assert_allclose(file(picture), network(picture), rtol=1e-3)

"""PP-LCNet against its published counts, timm's numbers, and Paddle's weights under ONNX Runtime."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from support.networks import picture
from support.paddle import paddle_weights
from support.pplcnet_classifier import PPLCNetClassifier
from torch import nn

from eldenet.backbones.pplcnet import SCALES, PPLCNet
from eldenet.backbones.pplcnet_weights import PUBLISHED
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.layers import DepthwiseSeparable
from eldenet.system.errors import USER_ERRORS
from eldenet.types import FeatureInfo

# scale: parameters and MACs at 224 x 224 of the 1000-class network, then of the encoder alone. The paper
# rounds the first to 1.5, 1.6, 1.9, 2.4, 3.0, 4.5, 6.5 and 9.0 M.
COUNTS = {
    0.25: (1_521_184, 16_773_440, 76_344, 15_329_600),
    0.35: (1_643_090, 27_357_832, 136_810, 25_852_552),
    0.5: (1_879_576, 44_731_008, 270_896, 43_123_328),
    0.75: (2_357_008, 94_786_496, 584_488, 93_014_976),
    1.0: (2_952_520, 155_700_480, 1_016_160, 153_765_120),
    1.5: (4_499_832, 334_188_416, 2_235_792, 331_925_376),
    2.0: (6_521_512, 580_194_816, 3_929_792, 577_604_096),
    2.5: (9_017_560, 893_719_680, 6_098_160, 890_801_280),
}
TIMM = {0.35: "lcnet_035", 0.5: "lcnet_050", 0.75: "lcnet_075", 1.0: "lcnet_100", 1.5: "lcnet_150"}


def randomize(module: nn.Module) -> None:
    """Give every normalization its own statistics, so that swapped ones change the output."""
    for layer in module.modules():
        if isinstance(layer, nn.BatchNorm2d):
            nn.init.uniform_(layer.weight, 0.5, 1.5)
            nn.init.normal_(layer.bias, std=0.1)
            nn.init.normal_(layer.running_mean, std=0.1)
            nn.init.uniform_(layer.running_var, 0.5, 1.5)


def assert_same_features(ours: nn.Module, theirs: Callable, *size: int, **tolerance: float) -> None:
    image = picture(*size)
    with torch.inference_mode():
        for feature, expected in zip(ours(image), theirs(image), strict=True):
            torch.testing.assert_close(feature, expected, **tolerance)


@pytest.mark.parametrize("scale", SCALES)
def test_parameters_and_macs_equal_the_papers_table(scale: float) -> None:
    whole, encoder = PPLCNetClassifier(scale), PPLCNet(scale)
    counts = (count_params(whole), count_macs(whole, (224, 224)))
    assert (*counts, count_params(encoder), count_macs(encoder, (224, 224))) == COUNTS[scale]


def test_stem_feature_replaces_the_first_feature_only() -> None:
    plain, literal = PPLCNet(1.0).eval(), PPLCNet(1.0, stem_feature=True).eval()
    literal.load_state_dict(plain.state_dict())
    assert (plain.feature_info[0], literal.feature_info[0]) == (FeatureInfo(32, 2), FeatureInfo(16, 2))
    assert plain.feature_info[1:] == literal.feature_info[1:]
    assert_same_features(literal, lambda image: (plain.stem(image), *plain(image)[1:]), 64, 96)


def test_depthwise_convolutions_are_initialized_by_their_own_fan_in() -> None:
    torch.manual_seed(0)
    block = PPLCNet(1.0).blocks6[1]
    assert block.depthwise.conv.weight.std().item() == pytest.approx((2 / 25) ** 0.5, rel=0.05)
    assert block.pointwise.conv.weight.std().item() == pytest.approx((2 / 512) ** 0.5, rel=0.05)


def test_shortcuts_add_the_input_where_the_shape_stays() -> None:
    """With a last normalization of 0 a block outputs its shortcut alone."""
    network = PPLCNet(0.5, shortcuts=True).eval()
    blocks = [part for part in network.modules() if isinstance(part, DepthwiseSeparable)]
    shape_stays = [False, False, True, False, True, False, *[True] * 5, False, True]
    assert [block.shortcut for block in blocks] == shape_stays
    assert network.state_dict().keys() == PPLCNet(0.5).state_dict().keys()
    with torch.inference_mode():
        for block in blocks:
            nn.init.zeros_(block.pointwise.norm.weight)
            x = torch.rand(1, block.depthwise.conv.in_channels, 6, 8)
            out = block(x)
            assert torch.equal(out, x if block.shortcut else torch.zeros_like(out))


# --- timm ---


@pytest.fixture
def timm_network() -> Callable[..., Any]:
    timm = pytest.importorskip("timm")

    def create(scale: float, **options: Any) -> nn.Module:
        torch.manual_seed(0)
        network = timm.create_model(TIMM[scale], pretrained=False, **options).eval()
        randomize(network)
        return network

    return create


@pytest.mark.parametrize("scale", TIMM)
def test_timms_files_give_timms_features(
    scale: float, timm_network: Callable[..., Any], tmp_path: Path
) -> None:
    theirs = timm_network(scale, features_only=True)
    save_file(theirs.state_dict(), tmp_path / "model.safetensors")
    ours = PPLCNet(scale, pretrained=str(tmp_path / "model.safetensors")).eval()
    for size in [(64, 64), (97, 131)]:
        assert_same_features(ours, theirs, *size)


def test_one_file_fits_this_network_and_timms(timm_network: Callable[..., Any], tmp_path: Path) -> None:
    from eldenet.backbones.timm import TimmBackbone

    path = tmp_path / "model.safetensors"
    save_file(timm_network(0.5).state_dict(), path)
    ours = PPLCNet(0.5, pretrained=str(path)).eval()
    theirs = TimmBackbone("lcnet_050", pretrained=str(path)).eval()
    assert ours.feature_info == theirs.feature_info
    assert_same_features(ours, theirs, 64, 96)


# --- weights ---


def test_a_file_with_our_own_names_loads(tmp_path: Path) -> None:
    source = PPLCNet(0.25)
    torch.save({"state_dict": source.state_dict()}, tmp_path / "own.pth")
    save_file(source.state_dict(), tmp_path / "own.safetensors")
    for name in ("own.pth", "own.safetensors"):
        loaded = PPLCNet(0.25, pretrained=str(tmp_path / name))
        for a, b in zip(source.state_dict().values(), loaded.state_dict().values(), strict=True):
            assert torch.equal(a, b)
    with pytest.raises(ValueError, match=r"own\.pth do not fit"):
        PPLCNet(0.5, pretrained=str(tmp_path / "own.pth"))


@pytest.mark.parametrize("scale", PUBLISHED)
def test_published_weights_are_downloaded_by_name(scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def no_network(*arguments: str) -> None:
        asked.append(arguments)
        raise OSError("no network")

    monkeypatch.setattr("huggingface_hub.hf_hub_download", no_network)
    for pretrained in (True, PUBLISHED[scale]):
        with pytest.raises(USER_ERRORS, match=rf"timm/{PUBLISHED[scale]}.*pretrained=/path/to/file"):
            PPLCNet(scale, pretrained=pretrained)
    assert asked == [(f"timm/{PUBLISHED[scale]}", "model.safetensors")] * 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": 0.6}, r"scale=0\.6: give one of 0\.25"),
        ({"scale": 2.0, "pretrained": True}, r"x2\.0; choose a scale of 0\.5, 0\.75, 1\.0"),
        ({"pretrained": "imagenet"}, "or an existing file"),
        (
            {"pretrained": True, "shortcuts": True},
            r"trained without shortcuts; also give model\.backbone\.shortcuts=false",
        ),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PPLCNet(**options)


@pytest.mark.net
def test_published_weights_download() -> None:
    assert PPLCNet(0.5, pretrained=True).stem.conv.weight.std() > 0.1


# --- ONNX ---


@pytest.fixture
def paddle_file() -> Path:
    pytest.importorskip("onnx")
    if "ELDENET_WEIGHTS" not in os.environ:
        pytest.skip("ELDENET_WEIGHTS does not name a folder of real weights")
    return Path(os.environ["ELDENET_WEIGHTS"]) / "backbone" / "pplcnet_x1_0_doc_orientation.onnx"


def test_paddles_trained_weights_give_paddles_features(paddle_file: Path) -> None:
    import onnx

    onnxruntime = pytest.importorskip("onnxruntime")
    graph = onnx.load(str(paddle_file))
    # the activation that ends each stage: of the stem, then of the 1st, 3rd, 5th, 11th and 13th block
    ends = [
        [node for node in graph.graph.node if node.op_type == "HardSwish"][index].output[0]
        for index in (0, 2, 6, 10, 22, 26)
    ]
    graph.graph.output.extend(onnx.ValueInfoProto(name=name) for name in ends)
    session = onnxruntime.InferenceSession(graph.SerializeToString(), providers=["CPUExecutionProvider"])
    model = PPLCNet(1.0).eval()
    missing, surplus = model.load_state_dict(paddle_weights(paddle_file, model), strict=False)
    assert not surplus
    assert all(name.endswith("num_batches_tracked") for name in missing)
    image = np.random.default_rng(0).normal(size=(1, 3, 224, 224)).astype(np.float32)
    expected = session.run(ends, {"x": image})
    with torch.inference_mode():
        stem = model.stem(torch.from_numpy(image))
        features = model(torch.from_numpy(image))
    for ours, theirs in zip((stem, *features), expected, strict=True):
        torch.testing.assert_close(ours, torch.from_numpy(theirs), rtol=1e-4, atol=1e-4)

"""PP-LCNet against its published counts, timm's numbers, and Paddle's weights under ONNX Runtime."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from eldenet.backbones.pplcnet import SCALES, PPLCNet, PPLCNetClassifier, scale_channels
from eldenet.backbones.pplcnet_weights import PUBLISHED, from_onnx, from_timm
from eldenet.layers import DepthwiseSeparable
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


def parameters(module: nn.Module) -> int:
    return sum(parameter.numel() for parameter in module.parameters())


def macs(module: nn.Module) -> int:
    with torch.inference_mode(), FlopCounterMode(display=False) as counter:
        module.eval()(torch.zeros(1, 3, 224, 224))
    return counter.get_total_flops() // 2


def randomize(module: nn.Module) -> None:
    """Give the normalizations statistics of their own, so that a swapped one shows."""
    for layer in module.modules():
        if isinstance(layer, nn.BatchNorm2d):
            nn.init.uniform_(layer.weight, 0.5, 1.5)
            nn.init.normal_(layer.bias, std=0.1)
            nn.init.normal_(layer.running_mean, std=0.1)
            nn.init.uniform_(layer.running_var, 0.5, 1.5)


@pytest.mark.parametrize("scale", SCALES)
def test_counts_equal_the_table(scale: float) -> None:
    whole, encoder = PPLCNetClassifier(scale), PPLCNet(scale)
    assert (parameters(whole), macs(whole), parameters(encoder), macs(encoder)) == COUNTS[scale]


def test_table_agrees_with_the_convolutions_of_one_stage_by_hand() -> None:
    # blocks2 of scale 1 at 112 x 112: depthwise 3 x 3 of 16, then 16 -> 32
    stage = PPLCNet(1.0).blocks2
    assert parameters(stage) == (9 * 16 + 2 * 16) + (16 * 32 + 2 * 32)
    with torch.inference_mode(), FlopCounterMode(display=False) as counter:
        stage.eval()(torch.zeros(1, 16, 112, 112))
    assert counter.get_total_flops() // 2 == 112 * 112 * (9 * 16 + 16 * 32)


@pytest.mark.parametrize(("scale", "channels"), [(0.25, 8), (0.35, 8), (0.75, 16), (1.5, 24), (2.5, 40)])
def test_stem_channels_are_rounded_as_in_the_paper(scale: float, channels: int) -> None:
    assert scale_channels(16, scale) == channels


def test_stem_feature_replaces_blocks2_only() -> None:
    torch.manual_seed(0)
    plain = PPLCNet(1.0).eval()
    literal = PPLCNet(1.0, stem_feature=True).eval()
    literal.load_state_dict(plain.state_dict())
    assert plain.feature_info[0] == FeatureInfo(32, 2)
    assert literal.feature_info[0] == FeatureInfo(16, 2)
    assert plain.feature_info[1:] == literal.feature_info[1:]
    image = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        features = literal(image)
        assert torch.equal(features[0], plain.stem(image))
        for a, b in zip(features[1:], plain(image)[1:], strict=True):
            assert torch.equal(a, b)


def test_depthwise_convolutions_start_from_their_fan_in() -> None:
    torch.manual_seed(0)
    block = PPLCNet(1.0).blocks6[1]
    assert block.depthwise.conv.weight.std().item() == pytest.approx((2 / 25) ** 0.5, rel=0.05)
    assert block.pointwise.conv.weight.std().item() == pytest.approx((2 / 512) ** 0.5, rel=0.05)


def test_unknown_scale() -> None:
    with pytest.raises(ValueError, match=r"no scale 0\.6; choose one of 0\.25"):
        PPLCNet(0.6)


def test_exports_and_keeps_its_numbers() -> None:
    model = PPLCNet(0.25).eval()
    image = torch.rand(1, 3, 64, 96)
    exported = torch.export.export(model, (image,)).module()
    with torch.inference_mode():
        for ours, theirs in zip(model(image), exported(image), strict=True):
            torch.testing.assert_close(theirs, ours)


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
def test_same_numbers_as_timm(scale: float, timm_network: Callable[..., Any]) -> None:
    theirs = timm_network(scale, features_only=True)
    ours = PPLCNet(scale).eval()
    ours.load_state_dict(from_timm(theirs.state_dict()))
    for height, width in [(64, 64), (97, 131)]:
        image = torch.rand(1, 3, height, width)
        with torch.inference_mode():
            for feature, expected in zip(ours(image), theirs(image), strict=True):
                torch.testing.assert_close(feature, expected)


def test_classifier_gives_timms_logits(timm_network: Callable[..., Any]) -> None:
    theirs = timm_network(0.5)
    ours = PPLCNetClassifier(0.5, head_bias=True).eval()
    assert parameters(theirs) == parameters(ours) == 1_879_576 + 1280
    head = ("last_conv.", "fc.")
    weights = from_timm(theirs.state_dict())
    ours.load_state_dict({n if n.startswith(head) else f"encoder.{n}": t for n, t in weights.items()})
    image = torch.rand(2, 3, 64, 64)
    with torch.inference_mode():
        torch.testing.assert_close(ours(image), theirs(image))


def test_file_of_timm_goes_into_both_backbones(timm_network: Callable[..., Any], tmp_path: Path) -> None:
    from eldenet.backbones.timm import TimmBackbone

    path = tmp_path / "model.safetensors"
    save_file(timm_network(0.5).state_dict(), path)
    ours = PPLCNet(0.5, pretrained=str(path)).eval()
    theirs = TimmBackbone("lcnet_050", pretrained=str(path)).eval()
    assert ours.feature_info == theirs.feature_info
    image = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        for feature, expected in zip(ours(image), theirs(image), strict=True):
            torch.testing.assert_close(feature, expected)


# --- shortcuts ---


def test_shortcuts_add_the_input_where_the_shape_stays() -> None:
    """A block whose last normalization is 0 gives nothing of its own: what comes out is the shortcut."""
    plain, network = PPLCNet(0.5).eval(), PPLCNet(0.5, shortcuts=True).eval()
    network.load_state_dict(plain.state_dict())
    blocks = [part for part in network.modules() if isinstance(part, DepthwiseSeparable)]
    shape_stays = [False, False, True, False, True, False, *[True] * 5, False, True]
    assert [block.shortcut for block in blocks] == shape_stays
    with torch.inference_mode():
        for block in blocks:
            nn.init.zeros_(block.pointwise.norm.weight)
            x = torch.rand(1, block.depthwise.conv.in_channels, 6, 8)
            out = block(x)
            assert torch.equal(out, x if block.shortcut else torch.zeros_like(out))


def test_published_weights_have_no_shortcuts() -> None:
    with pytest.raises(ValueError, match=r"without shortcuts; give model\.backbone\.shortcuts=false"):
        PPLCNet(0.5, shortcuts=True, pretrained=True)


# --- weights ---


def test_own_file_round_trip(tmp_path: Path) -> None:
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
def test_published_weights_are_asked_for_by_name(scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    import huggingface_hub

    asked = []

    def no_network(*arguments: str) -> None:
        asked.append(arguments)
        raise OSError("no network")

    monkeypatch.setattr(huggingface_hub, "hf_hub_download", no_network)
    for pretrained in (True, PUBLISHED[scale]):
        with pytest.raises(RuntimeError, match=rf"timm/{PUBLISHED[scale]}.*pretrained: /path/to/file"):
            PPLCNet(scale, pretrained=pretrained)
    assert asked == [(f"timm/{PUBLISHED[scale]}", "model.safetensors")] * 2


def test_weights_that_are_not_published() -> None:
    with pytest.raises(ValueError, match=r"x2\.0: timm has them for 0\.5, 0\.75, 1\.0"):
        PPLCNet(2.0, pretrained=True)
    with pytest.raises(ValueError, match=r"lcnet_100.ra2_in1k are not for scale 0\.5"):
        PPLCNet(0.5, pretrained="lcnet_100.ra2_in1k")
    with pytest.raises(ValueError, match="or an existing file"):
        PPLCNet(0.5, pretrained="imagenet")
    with pytest.raises(ValueError, match="not a weight of timm's lcnet"):
        from_timm({"conv_stem.weight": torch.zeros(1), "blocks.9.0.conv_dw.weight": torch.zeros(1)})


@pytest.mark.net
def test_published_weights_download() -> None:
    assert PPLCNet(0.5, pretrained=True).stem.conv.weight.std() > 0.1


# --- ONNX ---


@pytest.fixture
def paddle_file() -> Path:
    if "ELDENET_WEIGHTS" not in os.environ:
        pytest.skip("ELDENET_WEIGHTS does not name a folder of real weights")
    return Path(os.environ["ELDENET_WEIGHTS"]) / "backbone" / "pplcnet_x1_0_doc_orientation.onnx"


def test_paddles_trained_weights_give_paddles_features(paddle_file: Path) -> None:
    onnx = pytest.importorskip("onnx")
    onnxruntime = pytest.importorskip("onnxruntime")
    graph = onnx.load(str(paddle_file))
    # the activation that ends each stage: of the stem, then of the 1st, 3rd, 5th, 11th and 13th block
    ends = [
        [node for node in graph.graph.node if node.op_type == "HardSwish"][index].output[0]
        for index in (0, 2, 6, 10, 22, 26)
    ]
    graph.graph.output.extend(onnx.ValueInfoProto(name=name) for name in ends)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        graph.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )
    model = PPLCNet(1.0, pretrained=str(paddle_file)).eval()
    image = np.random.default_rng(0).normal(size=(1, 3, 224, 224)).astype(np.float32)
    expected = session.run(ends, {"x": image})
    with torch.inference_mode():
        stem = model.stem(torch.from_numpy(image))
        features = model(torch.from_numpy(image))
    for ours, theirs in zip((stem, *features), expected, strict=True):
        torch.testing.assert_close(ours, torch.from_numpy(theirs), rtol=1e-4, atol=1e-4)


def test_onnx_of_another_scale_is_refused(paddle_file: Path) -> None:
    pytest.importorskip("onnx")
    with pytest.raises(ValueError, match="do not fit"):
        PPLCNet(0.5, pretrained=str(paddle_file))


def test_folded_normalizations_give_the_same_features(tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx")
    torch.manual_seed(0)
    source = PPLCNet(0.25).eval()
    randomize(source)
    nodes, tensors = [], []
    for name, layer in source.named_modules():
        if isinstance(layer, nn.Conv2d):
            weight, bias = layer.weight.detach(), layer.bias
            if bias is None:
                norm = source.get_submodule(f"{name.removesuffix('conv')}norm")
                factor = norm.weight / (norm.running_var + norm.eps).sqrt()
                weight = weight * factor[:, None, None, None]
                bias = norm.bias - norm.running_mean * factor
            tensors.append(onnx.numpy_helper.from_array(weight.detach().numpy(), f"{name}.w"))
            tensors.append(onnx.numpy_helper.from_array(bias.detach().numpy(), f"{name}.b"))
            nodes.append(onnx.helper.make_node("Conv", ["x", f"{name}.w", f"{name}.b"], ["x"]))
    graph = onnx.helper.make_graph(nodes, "folded", [], [], tensors)
    onnx.save(onnx.helper.make_model(graph), tmp_path / "folded.onnx")

    loaded = PPLCNet(0.25, pretrained=str(tmp_path / "folded.onnx")).eval()
    image = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        for ours, theirs in zip(loaded(image), source(image), strict=True):
            torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=1e-4)

    onnx.save(
        onnx.helper.make_model(onnx.helper.make_graph(nodes[:3], "cut", [], [], tensors)),
        tmp_path / "cut.onnx",
    )
    with pytest.raises(ValueError, match="3 convolutions where PP-LCNet has 31"):
        from_onnx(tmp_path / "cut.onnx", source)

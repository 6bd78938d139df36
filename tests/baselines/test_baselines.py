"""Other papers' networks: their published sizes, any image size, saving, exporting, published weights."""

import importlib.util
import re
from pathlib import Path

import pytest
import torch
from support.networks import picture
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

import eldenet
from eldenet.backbones.mobilenet import MobileNetV1, MobileNetV2
from eldenet.baselines.guidedepth import GuideDepth
from eldenet.baselines.lite_mono import LiteMono
from eldenet.baselines.meter import METER
from eldenet.decoders.fastdepth import FastDepthDecoder
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.heads import ScaledHead

WHOLE = [
    "fastdepth",
    *("guidedepth", "guidedepth_s"),
    *("lite_mono", "lite_mono_tiny", "lite_mono_small", "lite_mono_8m"),
    *("meter_xxs", "meter_xs", "meter_s"),
]
HAS_TIMM = importlib.util.find_spec("timm") is not None


def rounded(number: float, digits: int) -> float:
    return round(number + 1e-12, digits)


# --- sizes: facts of the papers and their public code ---

# Parameters as published, those that are left out here (and why), and GMACs at the reference size.
PUBLISHED = {
    # dwofk/fast-depth: MobileNetSkipAdd, unpruned
    "fastdepth": (3.960930, 0, 0.737, (224, 224)),
    # mic-rud/GuidedDecoding: biases of convolutions that a normalization follows
    "guidedepth": (5.825, 624, 2.61, (240, 320)),
    "guidedepth_s": (5.723, 284, 1.51, (240, 320)),
    # noahzn/Lite-Mono: layer normalizations that are never used, and the two coarser outputs
    "lite_mono_tiny": (2.148, 2112 + 866, 2.82, (192, 640)),
    "lite_mono_small": (2.477, 2304 + 938, 4.72, (192, 640)),
    "lite_mono": (3.075, 3072 + 938, 5.01, (192, 640)),
    "lite_mono_8m": (8.776, 5184 + 1586, 11.2, (192, 640)),
    # lorenzopapa5/METER; its MACs without the attention's matrix products (see below)
    "meter_xxs": (0.713, 0, 0.213, (192, 256)),
    "meter_xs": (1.450, 0, 0.619, (192, 256)),
    "meter_s": (3.295, 0, 1.106, (192, 256)),
}


@pytest.mark.parametrize("name", WHOLE)
def test_published_sizes(name: str) -> None:
    millions, left_out, gmacs, size = PUBLISHED[name]
    model = eldenet.load(name)
    digits = len(str(millions).partition(".")[2])
    assert rounded((count_params(model) + left_out) / 1e6, max(digits, 3)) == millions
    assert left_out < 0.002 * count_params(model)
    with FlopCounterMode(display=False) as counter, torch.inference_mode():
        model(picture(*size))
    counts = {str(operator): flops / 2e9 for operator, flops in counter.get_flop_counts()["Global"].items()}
    attention = counts.get("aten.bmm", 0.0)
    total = sum(counts.values())
    if name.startswith("meter"):
        # The published figures hold convolutions and linear layers alone. Attention adds up to 5 %.
        assert total - attention == pytest.approx(gmacs, rel=0.01)
        assert 0 < attention < 0.05 * total
    else:
        assert total == pytest.approx(gmacs, rel=0.01)


# Sparse-to-dense's UpConv (parameters exactly; GMACs to three digits) and FastDepth's (through overrides).
UPCONV = [
    ("resnet18_upconv", [], 12_396_720, {(224, 224): 2.464, (228, 304): 3.710}),
    ("resnet18_upconv", ["model.decoder.fast=true"], 12_396_720, {(224, 224): 1.982}),
    ("resnet50_upconv", [], 43_017_728, {(224, 224): 14.47}),
    ("vgg16_upconv", [], 15_934_896, {(224, 224): 16.00}),
    ("vgg16_upconv", ["model/backbone=vgg16_bn"], 15_943_344, {}),
    ("mobilenet_v2_upconv", [], 9_845_912, {(224, 224): 4.358, (228, 304): 7.068}),
    ("mobilenet_v3_upconv", [], 7_259_882, {(224, 224): 2.498, (228, 304): 4.043}),
    ("mobilenet_v3_small_upconv", [], 2_471_174, {(224, 224): 0.878, (228, 304): 1.425}),
]
FASTDEPTH = [
    ("resnet18", "upconv", 29_163_042, 14.686),
    ("resnet18", "nnconv5", 29_163_042, 5.052),
    ("resnet18", "nnconv5_dw", 12_455_778, 2.008),
    ("mobilenet_v1", "upconv", 20_668_194, 13.41),
    ("mobilenet_v1", "nnconv5", 20_668_194, 3.781),
    ("mobilenet_v1", "nnconv5_dw", 3_960_930, 0.737),
]


@pytest.mark.parametrize(("name", "overrides", "params", "gmacs"), UPCONV)
def test_sizes_with_upconv(
    name: str, overrides: list[str], params: int, gmacs: dict[tuple[int, int], float]
) -> None:
    model = eldenet.load(name, overrides=overrides)
    assert count_params(model) == params
    for size, expected in gmacs.items():
        assert count_macs(model, size) / 1e9 == pytest.approx(expected, rel=5e-4)


def test_vgg16_with_torchvisions_pooling() -> None:
    """The published 21.89 GMACs are those of max-pools that round down; here they round up."""
    model = eldenet.load("vgg16_upconv")
    assert count_macs(model, (228, 304)) / 1e9 == pytest.approx(22.474, rel=5e-4)
    for layer in model.modules():
        if isinstance(layer, nn.MaxPool2d):
            layer.ceil_mode = False
    assert count_macs(model, (228, 304)) / 1e9 == pytest.approx(21.89, rel=5e-4)


def test_the_page_lists_every_network() -> None:
    page = (Path(__file__).parents[2] / "docs/networks.md").read_text()
    listed = re.findall(r"^\| `(\w+)` \| ([\d,]+) \|", page, re.M)
    assert sorted(name for name, _ in listed) == eldenet.list_models()
    for name, params in listed:
        if name in WHOLE:
            assert count_params(eldenet.load(name)) == int(params.replace(",", ""))


@pytest.mark.parametrize(("backbone", "operator", "params", "gmacs"), FASTDEPTH)
def test_sizes_with_fastdepths_decoders(backbone: str, operator: str, params: int, gmacs: float) -> None:
    overrides = [
        f"model/backbone={backbone}",
        f"model.decoder.operator={operator}",
        "model.decoder.skips=false",
    ]
    model = eldenet.load("fastdepth", overrides=overrides)
    assert count_params(model) == params
    assert count_macs(model, (224, 224)) / 1e9 == pytest.approx(gmacs, rel=5e-4)


@pytest.mark.skipif(not HAS_TIMM, reason="timm is not installed")
@pytest.mark.parametrize(
    ("name", "classifier"),  # parameters with the 1000-class head, of the papers' and timm's tables
    [("seresnet18", 11_779_624), ("seresnet50", 28_088_024), ("senet154", 115_088_984)],
)
def test_the_senet_family(name: str, classifier: int) -> None:
    model = eldenet.load(f"{name}_upconv")
    channels = model.network.backbone.feature_info[-1].channels
    assert count_params(model.network.backbone) == classifier - 1000 * channels - 1000
    assert type(model.network.decoder).__name__ == "UpConvDecoder"


@pytest.mark.skipif(not HAS_TIMM, reason="timm is not installed")
def test_mobilenet_v1_is_timms(tmp_path: Path) -> None:
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
    MobileNetV1(pretrained=str(tmp_path / "ours.pth"))
    torch.save(MobileNetV2().state_dict(), tmp_path / "other.pth")
    with pytest.raises(ValueError, match=r"other\.pth do not fit"):
        MobileNetV1(pretrained=str(tmp_path / "other.pth"))


# --- the contract of every network ---


@pytest.mark.parametrize("name", WHOLE)
def test_meters_at_any_size(name: str) -> None:
    model = eldenet.load(name)
    for size in ((64, 96), (97, 131), (33, 47)):
        with torch.inference_mode():
            depth = model(picture(*size))
            raw = model.network(picture(*size))
        assert depth.shape == (1, 1, *size)
        assert torch.isfinite(depth).all()
        assert raw.shape[:2] == (1, 1)
        stride = round(size[0] / raw.shape[-2])  # no row or column of the raw map lies beyond the image
        assert raw.shape[-2:] == tuple(-(-side // stride) for side in size)


@pytest.mark.parametrize("name", WHOLE)
def test_an_image_keeps_its_depth_in_a_batch(name: str) -> None:
    model = eldenet.load(name)
    images = picture(64, 64, batch=2)
    with torch.inference_mode():
        torch.testing.assert_close(model(images)[1:], model(images[1:]), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", [name for name in WHOLE if name not in ("lite_mono_8m", "meter_s")])
def test_training_reaches_every_parameter(name: str) -> None:
    torch.manual_seed(0)
    model = eldenet.load(name, overrides=["model.network.drop_path=0"] if "lite" in name else []).train()
    model(picture(64, 96, batch=2)).log().square().mean().backward()
    assert [name for name, value in model.named_parameters() if value.grad is None] == []
    stem = next(model.parameters())
    assert stem.shape[1] == 3
    assert stem.grad.abs().sum() > 0


@pytest.mark.parametrize("name", ["fastdepth", "guidedepth_s", "lite_mono_tiny", "meter_xxs"])
def test_saved_and_read_back(name: str, tmp_path: Path) -> None:
    model = eldenet.load(name)
    back = eldenet.load(model.save_pretrained(tmp_path))
    assert back.config == model.config
    with torch.inference_mode():
        assert torch.equal(back(picture(64, 96)), model(picture(64, 96)))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fastdepth", "guidedepth_s", "lite_mono_tiny", "meter_xxs"])
def test_exports_to_onnx(name: str, tmp_path: Path) -> None:
    onnxruntime = pytest.importorskip("onnxruntime")
    model, image = eldenet.load(name), picture(64, 96)
    torch.onnx.export(model, (image,), tmp_path / "model.onnx", dynamo=True)
    session = onnxruntime.InferenceSession(tmp_path / "model.onnx", providers=["CPUExecutionProvider"])
    (depth,) = session.run(None, {session.get_inputs()[0].name: image.numpy()})
    with torch.inference_mode():
        torch.testing.assert_close(torch.from_numpy(depth), model(image), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (lambda: GuideDepth("large"), "full, small"),
        (lambda: LiteMono("large"), "tiny, small, base, 8m"),
        (lambda: LiteMono(dilations="middle"), "low, high"),
        (lambda: METER("m"), "xxs, xs, s"),
        (lambda: METER(weights="/no/such/file"), "no weights at /no/such/file"),
        (
            lambda: FastDepthDecoder(MobileNetV1().feature_info, operator="deconv"),
            "nnconv5_dw, nnconv5, upconv",
        ),
        (lambda: FastDepthDecoder(MobileNetV1().feature_info[:-1]), "stride 32 or more"),
        (lambda: ScaledHead(0), "scale=0"),
    ],
)
def test_what_does_not_exist(part, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        part()

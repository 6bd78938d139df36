"""Decoders: every backbone feeds every decoder."""

import functools
import importlib.util
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch
import yaml
from torch import Tensor, nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.pplcnet import PPLCNet
from eldenet.backbones.resnet import ResNet
from eldenet.configurable import build
from eldenet.decoders.base import Decoder, crop_or_pad
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.decoders.multi_kernel import MultiKernelDecoder
from eldenet.decoders.upconv import UpConv2d, UpConvDecoder
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.model import EncoderDecoder
from eldenet.types import FeatureInfo

FOLDER = Path(__file__).parents[2] / "configs" / "model"
BACKBONES = {path.stem: path for path in sorted((FOLDER / "backbone").glob("*.yaml"))}
DECODERS = {path.stem: path for path in sorted((FOLDER / "decoder").glob("*.yaml"))}
HAS_TIMM = importlib.util.find_spec("timm") is not None
INFO = tuple(
    FeatureInfo(channels, stride)
    for channels, stride in zip((8, 16, 24, 32, 64), (2, 4, 8, 16, 32), strict=True)
)


def features(height: int, width: int, info: Sequence[FeatureInfo] = INFO) -> list[Tensor]:
    return [torch.rand(2, channels, -(-height // stride), -(-width // stride)) for channels, stride in info]


# --- every backbone with every decoder ---


@functools.lru_cache(maxsize=1)
def backbone(name: str) -> Backbone:
    if name == "timm" and not HAS_TIMM:
        pytest.skip("timm is not installed")
    torch.manual_seed(0)
    return build(yaml.safe_load(BACKBONES[name].read_text()))


@pytest.fixture(params=BACKBONES, scope="module")
def backbone_name(request: pytest.FixtureRequest) -> str:
    return request.param


def paired(backbone_name: str, decoder_name: str) -> EncoderDecoder:
    torch.manual_seed(1)
    return EncoderDecoder(backbone(backbone_name), build(yaml.safe_load(DECODERS[decoder_name].read_text())))


def test_the_yaml_files_are_found() -> None:
    assert set(DECODERS) >= {"fast_upconv", "multi_kernel", "upconv"}


@pytest.mark.parametrize("decoder_name", DECODERS)
def test_yaml_shows_every_argument(decoder_name: str) -> None:
    content = yaml.safe_load(DECODERS[decoder_name].read_text())
    assert content == build(content)(INFO).config


@pytest.mark.parametrize("decoder_name", DECODERS)
def test_pair(backbone_name: str, decoder_name: str) -> None:
    network = paired(backbone_name, decoder_name).train()
    raw = network(torch.rand(2, 3, 64, 96))
    stride = network.decoder.stride
    assert raw.shape == (2, 1, 64 // stride, 96 // stride)
    assert torch.isfinite(raw).all()
    stem = next(network.backbone.parameters())
    (gradient,) = torch.autograd.grad(raw.square().mean(), stem)
    assert torch.isfinite(gradient).all()
    assert gradient.abs().sum() > 0


@pytest.mark.parametrize("decoder_name", DECODERS)
@pytest.mark.parametrize("name", ["pplcnet_x0_25", "mobilenet_v3_small", "resnet18"])
def test_odd_sizes(name: str, decoder_name: str) -> None:
    network = paired(name, decoder_name).eval()
    stride = network.decoder.stride
    for height, width in ((97, 131), (33, 65), (120, 160)):
        with torch.inference_mode():
            raw = network(torch.rand(1, 3, height, width))
        assert raw.shape == (1, 1, -(-height // stride), -(-width // stride))
        assert torch.isfinite(raw).all()


@pytest.mark.parametrize("decoder_name", DECODERS)
def test_every_parameter_of_the_decoder_is_used(decoder_name: str) -> None:
    decoder = build(yaml.safe_load(DECODERS[decoder_name].read_text()))(INFO)
    decoder(features(64, 96)).square().mean().backward()
    assert [name for name, value in decoder.named_parameters() if value.grad is None] == []


# --- skips are found by stride ---


@pytest.mark.parametrize("make", [FastUpConvDecoder, MultiKernelDecoder, UpConvDecoder])
def test_order_of_the_features_does_not_matter(make: type[Decoder]) -> None:
    torch.manual_seed(0)
    decoder = make(INFO).eval()
    shuffled = make([INFO[i] for i in (3, 0, 4, 1, 2)]).eval()
    shuffled.load_state_dict(decoder.state_dict())
    maps = features(64, 96)
    with torch.inference_mode():
        torch.testing.assert_close(shuffled([maps[i] for i in (3, 0, 4, 1, 2)]), decoder(maps))


def test_fusion_and_lateral_strides() -> None:
    assert set(FastUpConvDecoder(INFO).lateral) == {"16", "8", "4", "2"}
    assert set(FastUpConvDecoder(INFO, lateral_strides=[16, 4]).lateral) == {"16", "4"}
    assert set(FastUpConvDecoder(INFO[2:]).lateral) == {"16", "8"}
    alone = FastUpConvDecoder(INFO, fusion="none").eval()
    assert len(alone.lateral) == 0
    maps = features(64, 96)
    with torch.inference_mode():
        before = alone(maps)
        torch.testing.assert_close(
            alone([torch.zeros_like(feature) for feature in maps[:4]] + maps[4:]), before
        )


@pytest.mark.parametrize(
    ("options", "used"),
    [
        ({}, {2, 4, 8, 16, 32}),
        ({"fusion": "none"}, {32}),
        ({"lateral_strides": [16, 4]}, {4, 16, 32}),
        ({"modules": 3}, {4, 8, 16, 32}),
    ],
)
def test_what_the_output_depends_on(options: dict, used: set[int]) -> None:
    maps = [feature.requires_grad_() for feature in features(64, 96)]
    raw = FastUpConvDecoder(INFO, **options).eval()(maps)
    gradients = torch.autograd.grad(raw.square().sum(), maps, allow_unused=True)
    pairs = zip(INFO, gradients, strict=True)
    assert {info.stride for info, gradient in pairs if gradient is not None and gradient.any()} == used


@pytest.mark.parametrize(
    "options", [{}, {"fusion": "none"}, {"lateral_strides": [16]}, {"lateral_strides": [2]}]
)
def test_fast_upconv_stays_on_the_image_whatever_it_fuses(options: dict) -> None:
    raw = FastUpConvDecoder(INFO, **options)(features(97, 131))
    assert raw.shape == (2, 1, 49, 66)


@pytest.mark.parametrize("options", [{}, {"fusion": "none"}, {"lateral_strides": [16]}])
@pytest.mark.parametrize("modules", [1, 2, 3])
def test_fewer_modules_end_at_a_larger_stride(modules: int, options: dict) -> None:
    torch.manual_seed(0)
    decoder = FastUpConvDecoder(INFO, modules=modules, **options)
    stride = 32 // 2**modules
    assert decoder.stride == stride
    assert decoder(features(97, 131)).shape == (2, 1, -(-97 // stride), -(-131 // stride))


def test_raw_map_is_not_squeezed() -> None:
    """A bright spot in the deepest feature keeps its place, also where 32 does not divide the image."""
    decoder = UpConvDecoder(INFO).eval()
    for layer in decoder.modules():
        if isinstance(layer, UpConv2d | nn.Conv2d):
            nn.init.constant_(layer.weight, 0.1)
    for size in ((128, 128), (100, 100)):
        maps = [torch.zeros_like(feature) for feature in features(*size)]
        maps[-1][..., 2, 2] = 1.0
        with torch.inference_mode():
            raw = decoder(maps)[0, 0]
        rows, cols = (raw > 0.5 * raw.max()).nonzero().float().mean(0).tolist()
        assert 2 * rows == pytest.approx(64, abs=4)
        assert 2 * cols == pytest.approx(64, abs=4)


@pytest.mark.parametrize(
    ("make", "stride"), [(FastUpConvDecoder, 1), (UpConvDecoder, 1), (MultiKernelDecoder, 2)]
)
def test_stride_of_the_raw_map(make: type[Decoder], stride: int) -> None:
    shallow = make(INFO[:4])
    assert shallow.stride == stride
    assert shallow(features(64, 96, INFO[:4])).shape == (2, 1, 64 // stride, 96 // stride)


def test_multi_kernel_is_the_papers_text() -> None:
    decoder = MultiKernelDecoder(PPLCNet(0.5).feature_info)
    assert decoder.strides == [2, 4, 8, 32]  # 112, 56, 28 and 7 of 224: the 14 x 14 stage is skipped
    assert [tuple(branch[1].kernel_size) for branch in decoder.branches] == [(3, 3), (3, 2), (2, 3), (2, 2)]
    assert [branch[4].upscale_factor for branch in decoder.branches] == [1, 2, 4, 4]
    assert decoder.branches[3][5].scale_factor == 4
    whole = MultiKernelDecoder(INFO, max_shuffle=16)
    assert [branch[4].upscale_factor for branch in whole.branches] == [1, 2, 4, 16]


def test_features_too_shallow() -> None:
    with pytest.raises(ValueError, match="stride 16 or more, the deepest has 8"):
        UpConvDecoder(INFO[:3])
    for modules in (4, 0):
        with pytest.raises(ValueError, match=f"modules={modules}: .* of stride 8; choose 1 to 3"):
            FastUpConvDecoder(INFO[:3], modules=modules)


def test_wrong_options_say_so() -> None:
    with pytest.raises(ValueError, match="4 kernels need as many features, the backbone has 3"):
        MultiKernelDecoder(INFO[:3])
    with pytest.raises(ValueError, match="fusion='concat': choose one of"):
        FastUpConvDecoder(INFO, fusion="concat")
    with pytest.raises(ValueError, match=r"distinct strides, got \[2, 2\]"):
        UpConvDecoder((FeatureInfo(8, 2), FeatureInfo(16, 2)))


def test_laterals_that_no_module_meets_are_refused() -> None:
    for options in ({"modules": 3, "lateral_strides": [2]}, {"lateral_strides": [32]}):
        with pytest.raises(ValueError, match=r"the modules pass .* of strides \[16, 8, 4"):
            FastUpConvDecoder(INFO, **options)


def test_crop_or_pad() -> None:
    x = torch.arange(6.0).view(1, 1, 2, 3)
    assert torch.equal(crop_or_pad(x, torch.zeros(1, 5, 1, 2)), x[..., :1, :2])
    grown = crop_or_pad(x, torch.zeros(1, 5, 3, 4))
    assert grown[0, 0].tolist() == [[0, 1, 2, 2], [3, 4, 5, 5], [3, 4, 5, 5]]
    assert crop_or_pad(x, torch.zeros(1, 5, 3, 1)).shape == (1, 1, 3, 1)


# --- sizes ---


def test_baseline_has_sparse_to_denses_size() -> None:
    encoder = ResNet(18)
    slow, fast = (
        EncoderDecoder(encoder, functools.partial(UpConvDecoder, fast=fast)) for fast in (False, True)
    )
    assert count_params(slow) == count_params(fast) == 12_396_720
    assert round(count_macs(slow, (224, 224)) / 1e9, 3) == 2.464
    assert round(count_macs(fast, (224, 224)) / 1e9, 3) == 1.982
    assert round(count_macs(slow, (228, 304)) / 1e9, 3) == 3.710
    fast.load_state_dict(slow.state_dict())
    image = torch.rand(1, 3, 64, 96)
    with torch.inference_mode():
        torch.testing.assert_close(fast.eval()(image), slow.eval()(image), atol=1e-5, rtol=1e-4)


def test_eldenet_fits_the_papers_ratio() -> None:
    network = EncoderDecoder(PPLCNet(0.5), FastUpConvDecoder)
    assert 0.4e6 < count_params(network) < 0.6e6  # "0.04x" of 12.4 M

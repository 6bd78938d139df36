"""The contract of every decoder that has a YAML file, and of every pair with a backbone."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import torch
import yaml
from support.networks import picture
from torch import Tensor, nn

from eldenet.backbones.base import Backbone
from eldenet.backbones.mobilenet import MobileNetV1
from eldenet.backbones.pplcnet import PPLCNet
from eldenet.configurable import build
from eldenet.decoders.base import Decoder
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.decoders.fastdepth import FastDepthDecoder
from eldenet.decoders.multi_kernel import KERNELS, MultiKernelDecoder
from eldenet.decoders.upconv import UpConv2d, UpConvDecoder
from eldenet.model import EncoderDecoder
from eldenet.types import FeatureInfo

FOLDER = Path(__file__).parents[2] / "configs" / "model"
BACKBONES = {path.stem: path for path in sorted((FOLDER / "backbone").glob("*.yaml"))}
DECODERS = {path.stem: path for path in sorted((FOLDER / "decoder").glob("*.yaml"))}
INFO = tuple(
    FeatureInfo(channels, stride)
    for channels, stride in zip((8, 16, 24, 32, 64), (2, 4, 8, 16, 32), strict=True)
)


def features(height: int, width: int, info: Sequence[FeatureInfo] = INFO) -> list[Tensor]:
    return [torch.rand(2, channels, -(-height // stride), -(-width // stride)) for channels, stride in info]


def ceil_size(size: tuple[int, int], stride: int) -> tuple[int, int]:
    return -(-size[0] // stride), -(-size[1] // stride)


# --- every backbone with every decoder ---


def backbone(name: str) -> Backbone:
    config = yaml.safe_load(BACKBONES[name].read_text())
    if config["_target_"].endswith("TimmBackbone"):
        pytest.importorskip("timm")
    torch.manual_seed(0)
    return build(config)


@pytest.fixture(params=DECODERS)
def decoder(request: pytest.FixtureRequest) -> Callable[..., Decoder]:
    """The class of a YAML file with its options, without ``feature_info``."""
    torch.manual_seed(1)
    return build(yaml.safe_load(DECODERS[request.param].read_text()))


@pytest.mark.parametrize("name", DECODERS)
def test_the_yaml_shows_every_argument(name: str) -> None:
    content = yaml.safe_load(DECODERS[name].read_text())
    assert content == build(content)(INFO).config


@pytest.mark.parametrize("name", BACKBONES)
def test_every_decoder_fits_every_backbone(name: str, decoder: Callable[..., Decoder]) -> None:
    """In shapes, which is all that the meta device computes: some have many weights."""
    with torch.device("meta"):
        info = backbone(name).feature_info
        made = decoder(info)
        assert made(features(64, 96, info)).shape == (2, 1, *ceil_size((64, 96), made.stride))


@pytest.mark.parametrize("name", ["pplcnet_x0_25", "mobilenet_v3_small", "resnet18"])
def test_odd_image_sizes_round_up(name: str, decoder: Callable[..., Decoder]) -> None:
    network = EncoderDecoder(backbone(name), decoder).eval()
    for size in ((97, 131), (33, 65), (120, 160)):
        with torch.inference_mode():
            raw = network(picture(*size))
        assert raw.shape == (1, 1, *ceil_size(size, network.decoder.stride))
        assert torch.isfinite(raw).all()


def test_training_reaches_every_parameter(decoder: Callable[..., Decoder]) -> None:
    made, maps = decoder(INFO), [feature.requires_grad_() for feature in features(64, 96)]
    raw = made(maps)
    assert torch.isfinite(raw).all()
    raw.square().mean().backward()
    assert [name for name, value in made.named_parameters() if value.grad is None] == []
    assert torch.isfinite(maps[-1].grad).all()
    assert maps[-1].grad.abs().sum() > 0


def test_the_order_of_the_features_does_not_matter(decoder: Callable[..., Decoder]) -> None:
    order, maps = (3, 0, 4, 1, 2), features(64, 96)
    made, shuffled = decoder(INFO).eval(), decoder([INFO[i] for i in order]).eval()
    shuffled.load_state_dict(made.state_dict())
    with torch.inference_mode():
        torch.testing.assert_close(shuffled([maps[i] for i in order]), made(maps))


# --- each decoder ---


@pytest.mark.parametrize(
    ("options", "used"),
    [
        ({}, {2, 4, 8, 16, 32}),
        ({"fusion": "none"}, {32}),
        ({"lateral_strides": [16, 4]}, {4, 16, 32}),
        ({"modules": 3}, {4, 8, 16, 32}),
        ({"fusion": "concat"}, {2, 4, 8, 16, 32}),
        ({"kernels": KERNELS}, {2, 4, 8, 32}),
        ({"kernels": KERNELS[2:], "fusion": "concat"}, {2, 32}),
        ({"kernels": KERNELS, "modules": 3}, {4, 8, 16, 32}),
    ],
)
def test_fast_upconv_uses_the_features_it_is_told_to(options: dict, used: set[int]) -> None:
    maps = [feature.requires_grad_() for feature in features(64, 96)]
    decoder = FastUpConvDecoder(INFO, **options).eval()
    assert {int(stride) for stride in decoder.lateral} == used - {32}
    gradients = torch.autograd.grad(decoder(maps).square().sum(), maps, allow_unused=True)
    pairs = zip(INFO, gradients, strict=True)
    assert {info.stride for info, gradient in pairs if gradient is not None and gradient.any()} == used


def test_a_concatenation_block_keeps_the_channels_of_its_module() -> None:
    added, joined = (FastUpConvDecoder(INFO, fusion=fusion) for fusion in ("add", "concat"))
    for stride, block in joined.merge.items():
        out = added.lateral[stride][0].out_channels
        assert (block.conv.in_channels, block.conv.out_channels) == (2 * out, out)
    assert set(joined.merge) == set(added.lateral)
    assert set(added.state_dict()) < set(joined.state_dict())


FUSED = [{}, {"fusion": "none"}, {"fusion": "concat"}, {"lateral_strides": [16]}, {"kernels": KERNELS[2:]}]


@pytest.mark.parametrize(
    ("modules", "options"),
    [*((modules, options) for modules in (1, 2, 3, 4) for options in FUSED), (4, {"lateral_strides": [2]})],
)
def test_fast_upconv_ends_at_the_stride_of_its_modules(modules: int, options: dict) -> None:
    decoder, stride = FastUpConvDecoder(INFO, modules=modules, **options), 32 // 2**modules
    assert decoder.stride == stride
    assert decoder(features(97, 131)).shape == (2, 1, *ceil_size((97, 131), stride))


def test_the_raw_map_is_not_squeezed() -> None:
    """A bright spot in the deepest feature keeps its place, also where the image is no multiple of 32."""
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
def test_a_shallow_backbone_gives_a_finer_raw_map(make: type[Decoder], stride: int) -> None:
    shallow = make(INFO[:4])
    assert shallow.stride == stride
    assert shallow(features(64, 96, INFO[:4])).shape == (2, 1, 64 // stride, 96 // stride)


def test_multi_kernel_is_a_reading_of_the_paper() -> None:
    decoder = MultiKernelDecoder(PPLCNet(0.5).feature_info)
    assert decoder.strides == [2, 4, 8, 32]  # 112, 56, 28 and 7 of 224: the 14 x 14 stage is skipped
    assert [tuple(branch[1].kernel_size) for branch in decoder.branches] == [(3, 3), (3, 2), (2, 3), (2, 2)]
    assert [branch[4].upscale_factor for branch in decoder.branches] == [1, 2, 4, 4]
    assert decoder.branches[3][5].scale_factor == 4
    whole = MultiKernelDecoder(INFO, max_shuffle=16)
    assert [branch[4].upscale_factor for branch in whole.branches] == [1, 2, 4, 16]


def test_fastdepth_adds_the_features_of_strides_2_4_and_8() -> None:
    torch.manual_seed(0)
    info = MobileNetV1().feature_info
    decoder, maps = FastDepthDecoder(info).eval(), features(64, 64, info)
    with torch.inference_mode():
        whole = decoder(maps)
        for index, used in enumerate([True, True, True, False]):
            changed = [*maps]
            changed[index] = torch.zeros_like(changed[index])
            assert torch.equal(decoder(changed), whole) is not used


def test_fastdepths_upconv_gives_the_same_output_in_its_fast_form() -> None:
    torch.manual_seed(0)
    slow, fast = (
        FastDepthDecoder(INFO, operator="upconv", skips=False, fast=fast).eval() for fast in (False, True)
    )
    fast.load_state_dict(slow.state_dict())
    maps = features(64, 64)
    with torch.inference_mode():
        torch.testing.assert_close(slow(maps), fast(maps), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: UpConvDecoder(INFO[:3]), "the deepest feature has stride 8: four doublings need 16 or more"),
        (lambda: FastDepthDecoder(INFO[:-1]), "stride 16: five doublings need 32 or more"),
        (lambda: FastDepthDecoder(INFO, operator="deconv"), "nnconv5_dw, nnconv5, upconv"),
        (lambda: FastUpConvDecoder(INFO[:3]), "modules=4: .* stride 8; choose 1 to 3"),
        (lambda: FastUpConvDecoder(INFO[:3], modules=0), "modules=0: .* stride 8; choose 1 to 3"),
        (lambda: FastUpConvDecoder(INFO, fusion="cat"), "fusion='cat': give one of add, concat, none"),
        (lambda: FastUpConvDecoder(INFO, kernels=KERNELS, fusion="none"), "neither .* nor fusion=none"),
        (lambda: FastUpConvDecoder(INFO, kernels=KERNELS, lateral_strides=[2]), "neither lateral"),
        (lambda: FastUpConvDecoder(INFO, kernels=KERNELS[:1]), "give 2 to 5"),
        (lambda: FastUpConvDecoder(INFO, modules=3, lateral_strides=[2]), r"strides \[16, 8, 4\]"),
        (lambda: FastUpConvDecoder(INFO, lateral_strides=[32]), r"strides \[16, 8, 4, 2\]"),
        (lambda: MultiKernelDecoder(INFO[:3]), "one feature per kernel is needed, the backbone has 3"),
        (lambda: UpConvDecoder((FeatureInfo(8, 2), FeatureInfo(16, 2))), r"strides \[2, 2\]: .*distinct"),
    ],
)
def test_what_does_not_fit_is_refused(make: Callable[[], Decoder], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()

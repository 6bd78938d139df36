"""Networks of other papers: published sizes, any image size, training, saving, export."""

import functools
import re
from pathlib import Path

import pytest
import torch
from support.networks import picture
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

import eldenet
from eldenet.baselines.guidedepth import GuideDepth
from eldenet.baselines.lite_mono import LiteMono
from eldenet.baselines.meter import METER
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.model import DepthNet

# Parameters [M] as published, those that are left out here (and why), and GMACs at the reference size.
PUBLISHED = {
    # dwofk/fast-depth: MobileNetSkipAdd, not pruned
    "fastdepth": (3.960930, 0, 0.737, (224, 224)),
    # mic-rud/GuidedDecoding: biases of convolutions before a normalization
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
ONE_OF_EACH = ["fastdepth", "guidedepth_s", "lite_mono_tiny", "meter_xxs"]


@functools.cache
def built(name: str) -> DepthNet:
    return eldenet.load(name)


@pytest.mark.parametrize("name", PUBLISHED)
def test_sizes_equal_the_published_ones(name: str) -> None:
    millions, left_out, gmacs, size = PUBLISHED[name]
    model = built(name)
    digits = len(str(millions).partition(".")[2])
    assert round((count_params(model) + left_out) / 1e6 + 1e-12, max(digits, 3)) == millions
    assert left_out < 0.002 * count_params(model)
    with FlopCounterMode(display=False) as counter, torch.inference_mode():
        model(picture(*size))
    counts = {str(operator): flops / 2e9 for operator, flops in counter.get_flop_counts()["Global"].items()}
    attention, total = counts.get("aten.bmm", 0.0), sum(counts.values())
    if name.startswith("meter"):
        # the published figures hold convolutions and linear layers only; attention adds up to 5 %
        assert 0 < attention < 0.05 * total
        total -= attention
    assert total == pytest.approx(gmacs, rel=0.01)


# Sparse-to-dense's UpConv and FastDepth's decoders: parameters and GMACs at (height, width).
NO_SKIPS = "model.decoder.skips=false"
EXACT = [
    ("resnet18_upconv", [], 12_396_720, {(224, 224): 2.464, (228, 304): 3.710}),
    ("resnet18_upconv", ["model.decoder.fast=true"], 12_396_720, {(224, 224): 1.982}),
    ("resnet50_upconv", [], 43_017_728, {(224, 224): 14.47}),
    ("vgg16_upconv", [], 15_934_896, {(224, 224): 16.00}),
    ("vgg16_upconv", ["model/backbone=vgg16_bn"], 15_943_344, {}),
    ("mobilenet_v2_upconv", [], 9_845_912, {(224, 224): 4.358, (228, 304): 7.068}),
    ("mobilenet_v3_upconv", [], 7_259_882, {(224, 224): 2.498, (228, 304): 4.043}),
    ("mobilenet_v3_small_upconv", [], 2_471_174, {(224, 224): 0.878, (228, 304): 1.425}),
    *(
        (
            "fastdepth",
            [f"model/backbone={backbone}", f"model.decoder.operator={operator}", NO_SKIPS],
            parameters,
            {(224, 224): gmacs},
        )
        for backbone, operator, parameters, gmacs in [
            ("resnet18", "upconv", 29_163_042, 14.686),
            ("resnet18", "nnconv5", 29_163_042, 5.052),
            ("resnet18", "nnconv5_dw", 12_455_778, 2.008),
            ("mobilenet_v1", "upconv", 20_668_194, 13.41),
            ("mobilenet_v1", "nnconv5", 20_668_194, 3.781),
            ("mobilenet_v1", "nnconv5_dw", 3_960_930, 0.737),
        ]
    ),
]


@pytest.mark.parametrize(("name", "overrides", "parameters", "gmacs"), EXACT)
def test_backbone_decoder_pairs_have_the_published_sizes(
    name: str, overrides: list[str], parameters: int, gmacs: dict[tuple[int, int], float]
) -> None:
    with torch.device("meta"):  # which computes shapes alone
        model = eldenet.load(name, overrides=overrides)
    assert count_params(model) == parameters
    for size, expected in gmacs.items():
        assert count_macs(model, size) / 1e9 == pytest.approx(expected, rel=5e-4)


def test_vgg16_with_torchvisions_pooling_has_the_published_macs() -> None:
    """The published 21.89 GMACs are those of max-pools that round down; here they round up."""
    with torch.device("meta"):
        model = eldenet.load("vgg16_upconv")
    assert count_macs(model, (228, 304)) / 1e9 == pytest.approx(22.474, rel=5e-4)
    for layer in model.modules():
        if isinstance(layer, nn.MaxPool2d):
            layer.ceil_mode = False
    assert count_macs(model, (228, 304)) / 1e9 == pytest.approx(21.89, rel=5e-4)


@pytest.mark.parametrize(
    ("name", "classifier"),  # parameters with the 1000-class head, as in the papers' and timm's tables
    [("seresnet18", 11_779_624), ("seresnet50", 28_088_024), ("senet154", 115_088_984)],
)
def test_the_senet_family_has_the_published_sizes(name: str, classifier: int) -> None:
    pytest.importorskip("timm")
    with torch.device("meta"):
        model = eldenet.load(f"{name}_upconv")
    channels = model.network.backbone.feature_info[-1].channels
    assert count_params(model.network.backbone) == classifier - 1000 * channels - 1000
    assert type(model.network.decoder).__name__ == "UpConvDecoder"


def test_the_page_lists_every_network_with_its_parameters() -> None:
    page = (Path(__file__).parents[2] / "docs/networks.md").read_text()
    listed = re.findall(r"^\| `(\w+)` \| ([\d,]+) \|", page, re.M)
    assert sorted(name for name, _ in listed) == eldenet.list_models()
    for name, parameters in listed:
        if name in PUBLISHED:
            assert count_params(built(name)) == int(parameters.replace(",", ""))


# --- the contract of every network ---


@pytest.mark.parametrize("name", PUBLISHED)
def test_any_image_size_gives_depth_of_that_size(name: str) -> None:
    model = built(name)
    for size in ((64, 96), (97, 131), (33, 47)):
        with torch.inference_mode():
            depth = model(picture(*size))
            raw = model.network(picture(*size))
        assert depth.shape == (1, 1, *size)
        assert torch.isfinite(depth).all()
        stride = round(size[0] / raw.shape[-2])  # no row or column of the raw map lies beyond the image
        assert raw.shape == (1, 1, *(-(-side // stride) for side in size))


@pytest.mark.parametrize("name", PUBLISHED)
def test_an_image_has_the_same_depth_in_any_batch(name: str) -> None:
    model = built(name)
    images = picture(64, 64, batch=2)
    with torch.inference_mode():
        torch.testing.assert_close(model(images)[1:], model(images[1:]), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", [name for name in PUBLISHED if name not in ("lite_mono_8m", "meter_s")])
def test_training_reaches_every_parameter(name: str) -> None:
    torch.manual_seed(0)
    model = eldenet.load(name, overrides=["model.network.drop_path=0"] if "lite" in name else []).train()
    model(picture(64, 96, batch=2)).log().square().mean().backward()
    assert [name for name, value in model.named_parameters() if value.grad is None] == []
    stem = next(model.parameters())
    assert stem.shape[1] == 3
    assert stem.grad.abs().sum() > 0


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_a_saved_network_gives_the_same_depth(name: str, tmp_path: Path) -> None:
    model = built(name)
    back = eldenet.load(model.save_pretrained(tmp_path))
    assert back.config == model.config
    with torch.inference_mode():
        assert torch.equal(back(picture(64, 96)), model(picture(64, 96)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: GuideDepth("large"), "full, small"),
        (lambda: LiteMono("large"), "tiny, small, base, 8m"),
        (lambda: LiteMono(dilations="middle"), "low, high"),
        (lambda: METER("m"), "xxs, xs, s"),
        (lambda: METER(weights="/no/such/file"), "no weights at /no/such/file"),
    ],
)
def test_what_does_not_exist_is_refused(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()

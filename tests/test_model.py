"""The whole network: metres out, written down and read back, and nothing foreign is ever run."""

import copy
import functools
import importlib.util
import json
import pickle
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from torch import Tensor, nn

import eldenet
from eldenet.backbones.mobilenet import MobileNetV2, MobileNetV3
from eldenet.backbones.pplcnet import PPLCNet
from eldenet.backbones.resnet import ResNet
from eldenet.backbones.vgg import VGG16
from eldenet.configurable import Configurable, build
from eldenet.decoders.base import Decoder
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.decoders.multi_kernel import MultiKernelDecoder
from eldenet.decoders.upconv import UpConvDecoder
from eldenet.heads import Head, InverseHead, LinearHead, LogHead
from eldenet.model import DepthNet, EncoderDecoder
from eldenet.profiling import count_params
from eldenet.refinement import JointBilateral
from eldenet.types import FeatureInfo

REPOSITORY = Path(__file__).parents[1]
NAMES = [
    "eldenet",
    "eldenet_l",
    "eldenet_s",
    "fastdepth",
    "guidedepth",
    "guidedepth_s",
    "lite_mono",
    "lite_mono_8m",
    "lite_mono_small",
    "lite_mono_tiny",
    "meter_s",
    "meter_xs",
    "meter_xxs",
    "mobilenet_v1_upconv",
    "mobilenet_v2_upconv",
    "mobilenet_v3_small_upconv",
    "mobilenet_v3_upconv",
    "resnet152_upconv",
    "resnet18_upconv",
    "resnet50_upconv",
    "senet154_upconv",
    "seresnet18_upconv",
    "seresnet50_upconv",
    "vgg16_upconv",
]
SMALL = {"eldenet", "eldenet_l", "eldenet_s", "mobilenet_v3_upconv", "resnet18_upconv"}
OF_TIMM = {"senet154_upconv", "seresnet18_upconv", "seresnet50_upconv"}
HEADS = [LinearHead, InverseHead, LogHead]


def timm_backbone() -> nn.Module:
    if importlib.util.find_spec("timm") is None:
        pytest.skip("timm is not installed")
    from eldenet.backbones.timm import TimmBackbone

    return TimmBackbone("lcnet_035")


BACKBONES = {
    "pplcnet": functools.partial(PPLCNet, 0.25, stem_feature=True),
    "mobilenet_v2": MobileNetV2,
    "mobilenet_v3": functools.partial(MobileNetV3, "small"),
    "resnet": functools.partial(ResNet, 18),
    "vgg": functools.partial(VGG16, batch_norm=True),
    "timm": timm_backbone,
}


def small_net(seed: int = 0, **options: Any) -> DepthNet:
    torch.manual_seed(seed)
    options = {"backbone": PPLCNet(0.25), "decoder": FastUpConvDecoder, "head": LinearHead()} | options
    return DepthNet.from_parts(**options).eval()


def picture(*size: int, seed: int = 0) -> Tensor:
    return torch.rand(1, 3, *size, generator=torch.Generator().manual_seed(seed))


def same_model(a: DepthNet, b: DepthNet) -> bool:
    """Same config, same tensors and the same output, bit for bit."""
    image = picture(64, 96)
    with torch.inference_mode():
        same = torch.equal(a.eval()(image), b.eval()(image))
    ours, theirs = a.state_dict(), b.state_dict()
    same &= a.config == b.config and list(ours) == list(theirs)
    return same and all(torch.equal(ours[name], theirs[name]) for name in ours)


# --- heads ---


@pytest.mark.parametrize("head", HEADS)
@given(raw=st.floats(-1e4, 1e4, width=32), near=st.floats(0.01, 2), factor=st.floats(1.5, 800))
@settings(deadline=None, max_examples=60)
def test_any_number_is_within_range(head: type[Head], raw: float, near: float, factor: float) -> None:
    made = head(near, near * factor)
    depth = made(torch.tensor(raw)).item()
    assert made.min_depth * (1 - 1e-6) <= depth <= made.max_depth * (1 + 1e-6)


@pytest.mark.parametrize("head", HEADS)
@given(share=st.floats(0.001, 0.999), near=st.floats(0.01, 2), factor=st.floats(1.5, 800))
@settings(deadline=None, max_examples=60)
def test_heads_invert(head: type[Head], share: float, near: float, factor: float) -> None:
    made = head(near, near * factor)
    depth = torch.tensor(near + share * (near * factor - near), dtype=torch.float64)
    torch.testing.assert_close(made.to_metres(made.from_metres(depth)), depth, rtol=3e-3, atol=0)
    raw = torch.tensor(4 * share - 2, dtype=torch.float64)
    torch.testing.assert_close(made.from_metres(made.to_metres(raw)), raw, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("head", HEADS)
def test_metres_outside_the_range_are_clamped(head: type[Head]) -> None:
    made = head(0.5, 8.0)
    raw = made.from_metres(torch.tensor([-1.0, 0.0, 0.4, 0.5, 8.0, 9.0, torch.inf]))
    assert torch.isfinite(raw).all()
    torch.testing.assert_close(made(raw), torch.tensor([0.5] * 4 + [8.0] * 3), rtol=1e-4, atol=0)


def test_head_formulas() -> None:
    raw = torch.tensor([-50.0, 0.0, 50.0])
    torch.testing.assert_close(LinearHead(0.1, 10)(raw), torch.tensor([0.1, 5.05, 10.0]))
    torch.testing.assert_close(InverseHead(0.1, 10)(raw), torch.tensor([10.0, 1 / 5.05, 0.1]))
    torch.testing.assert_close(LogHead(0.1, 10)(raw), torch.tensor([0.1, 1.0, 10.0]))


@pytest.mark.parametrize("limits", [(0, 10), (-1, 10), (5, 5), (5, 1)])
def test_heads_refuse_impossible_ranges(limits: tuple[float, float]) -> None:
    for head in HEADS:
        with pytest.raises(ValueError, match="0 < min_depth < max_depth"):
            head(*limits)


# --- forward ---


@pytest.mark.parametrize("head", HEADS)
@pytest.mark.parametrize("size", [(64, 96), (97, 131), (33, 47), (120, 160)])
def test_metres_at_the_images_size(size: tuple[int, int], head: type[Head]) -> None:
    model = small_net(head=head(0.5, 4.0))
    with torch.inference_mode():
        depth = model(picture(*size))
    assert depth.shape == (1, 1, *size)
    assert depth.dtype == torch.float32
    assert 0.5 <= depth.min() < depth.max() <= 4.0 + 1e-6


def test_the_network_gets_normalised_images() -> None:
    seen: list[Tensor] = []

    class Spy(nn.Module):
        def forward(self, image: Tensor) -> Tensor:
            seen.append(image)
            return image[:, :1]

    image = picture(4, 5)
    DepthNet(Spy(), LinearHead())(image)
    DepthNet(Spy(), LinearHead(), mean=(0.5, 0.5, 0.5), std=(2.0, 2.0, 2.0))(image)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    torch.testing.assert_close(seen[0], (image - mean.view(1, 3, 1, 1)) / std.view(1, 3, 1, 1))
    torch.testing.assert_close(seen[1], (image - 0.5) / 2)


def test_half_precision_networks_still_give_float32_metres() -> None:
    model = small_net().bfloat16()
    with torch.inference_mode():
        assert model(picture(32, 32).bfloat16()).dtype == torch.float32


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (torch.rand(3, 32, 32), r"shape \(3, 32, 32\), \(B, 3, H, W\) is needed"),
        (torch.rand(1, 32, 32, 3), "is needed"),
        (torch.rand(1, 1, 32, 32), "is needed"),
        (torch.zeros(1, 3, 32, 32, dtype=torch.uint8), r"uint8: floats in \[0, 1\]"),
    ],
)
def test_wrong_images_say_so(image: Tensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        small_net()(image)


def test_copies_and_pickles() -> None:
    model = small_net(refine=JointBilateral())
    copied, pickled = copy.deepcopy(model), pickle.loads(pickle.dumps(model))
    assert same_model(model, copied)
    assert same_model(model, pickled)
    with torch.no_grad():
        next(copied.parameters()).add_(1)
    copied.config["network"]["backbone"]["scale"] = 9
    assert same_model(model, pickled)


# --- the zoo ---


def test_public_names() -> None:
    assert eldenet.list_models() == NAMES
    assert dir(eldenet) == eldenet.__all__
    assert all(getattr(eldenet, name) is not None for name in eldenet.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Depthnet'"):
        _ = eldenet.Depthnet


@pytest.mark.parametrize("name", NAMES)
def test_every_name_builds(name: str) -> None:
    if name in OF_TIMM and importlib.util.find_spec("timm") is None:
        pytest.skip("timm is not installed")
    model = eldenet.load(name)
    assert isinstance(model, DepthNet)
    assert not model.training
    assert (model.head.min_depth, model.head.max_depth) == (0.1, 10.0)
    json.dumps(model.config)
    if name in SMALL:
        with torch.inference_mode():
            assert model(picture(64, 96)).shape == (1, 1, 64, 96)


def test_known_sizes() -> None:
    sizes = {name: count_params(eldenet.load(name)) for name in ("resnet18_upconv", "eldenet", "eldenet_s")}
    assert sizes["resnet18_upconv"] == 12_396_720
    assert 0.03 < sizes["eldenet"] / sizes["resnet18_upconv"] < 0.05  # the paper's "0.04x"
    assert sizes["eldenet_s"] < sizes["eldenet"]


def test_overrides_change_what_they_name() -> None:
    model = eldenet.load(
        "eldenet",
        overrides=["model/backbone=pplcnet_x0_25", "model.head.max_depth=80", "model/decoder=multi_kernel"],
    )
    assert model.network.backbone.scale == 0.25
    assert model.head.max_depth == 80
    assert isinstance(model.network.decoder, MultiKernelDecoder)
    filtered = eldenet.load("eldenet_s", overrides=["model/refine=joint_bilateral", "model/head=log"])
    assert isinstance(filtered.refine, JointBilateral)
    assert isinstance(filtered.head, LogHead)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("model/backbone=pplcnet_x9", "pplcnet_x0_5"),  # the message lists what there is
        ("model.head.max_dept=80", "max_dept"),
        ("model.head.max_depth=0.01", "0 < min_depth < max_depth"),
        ("=", "="),
    ],
)
def test_overrides_that_do_not_fit(override: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        eldenet.load("eldenet", overrides=[override])


def test_unknown_names_say_what_there_is() -> None:
    with pytest.raises(ValueError, match=r"unknown model 'eldenett': choose one of eldenet, .*vgg16_upconv"):
        eldenet.load("eldenett")


def test_overrides_of_a_saved_model_are_refused(tmp_path: Path) -> None:
    small_net().save_pretrained(tmp_path)
    with pytest.raises(ValueError, match="overrides change a network built by name"):
        eldenet.load(tmp_path, overrides=["model.head.max_depth=80"])


# --- written down and read back ---


@pytest.mark.parametrize("name", BACKBONES)
def test_every_backbone_comes_back(name: str, tmp_path: Path) -> None:
    model = small_net(backbone=BACKBONES[name]())
    model.save_pretrained(tmp_path)
    assert same_model(DepthNet.from_pretrained(tmp_path), model)


@pytest.mark.parametrize(
    "options",
    [
        {"head": InverseHead(0.2, 80.0)},
        {"head": LogHead(max_depth=20)},
        {"refine": JointBilateral(3, sigma_color=0.2)},
        {"decoder": functools.partial(FastUpConvDecoder, fusion="none", width=24, lateral_strides=None)},
        {"decoder": functools.partial(FastUpConvDecoder, lateral_strides=(16, 8))},
        {"decoder": functools.partial(MultiKernelDecoder, kernels=((3, 3), (5, 5)), max_shuffle=2)},
        {"decoder": functools.partial(UpConvDecoder, fast=True)},
        {"decoder": lambda info: UpConvDecoder(info)},
        {"mean": (0.5, 0.5, 0.5), "std": [0.25, 0.25, 0.25]},
    ],
)
def test_every_part_comes_back(options: dict[str, Any], tmp_path: Path) -> None:
    model = small_net(**options)
    assert model.save_pretrained(tmp_path / "new" / "folder") == tmp_path / "new" / "folder"
    back = eldenet.load(tmp_path / "new" / "folder")
    assert same_model(back, model)
    assert not back.training
    back.save_pretrained(tmp_path / "again")
    assert same_model(eldenet.load(str(tmp_path / "again")), model)


def test_hand_built_model_comes_back(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = EncoderDecoder(MobileNetV3(size="small"), FastUpConvDecoder)
    model = DepthNet(network, LogHead(0.5, 6), refine=JointBilateral())
    model.train().save_pretrained(tmp_path)
    assert same_model(DepthNet.from_pretrained(tmp_path), model)


def test_run_folders_and_info(tmp_path: Path) -> None:
    model = small_net()
    info = {"data": "rooms", "delta1": 0.5}
    model.save_pretrained(tmp_path / "run" / "model", info=info)
    loaded = eldenet.load(tmp_path / "run")
    assert same_model(loaded, model)
    assert loaded.info == info
    loaded.save_pretrained(tmp_path / "copy")
    assert eldenet.load(tmp_path / "copy").info == info
    assert sorted(path.name for path in (tmp_path / "copy").iterdir()) == ["config.json", "model.safetensors"]


def test_pretrained_is_not_saved(tmp_path: Path) -> None:
    torch.save(ResNet(18).state_dict(), tmp_path / "resnet18.pth")
    model = small_net(backbone=ResNet(18, pretrained=str(tmp_path / "resnet18.pth")))
    model.save_pretrained(tmp_path / "model")
    assert "pretrained" not in (tmp_path / "model" / "config.json").read_text()
    (tmp_path / "resnet18.pth").unlink()
    assert same_model(eldenet.load(tmp_path / "model"), model)


def test_what_nobody_could_rebuild_is_refused(tmp_path: Path) -> None:
    model = DepthNet(nn.Conv2d(3, 1, 1), LinearHead())
    with pytest.raises(ValueError, match=r"Conv2d is not JSON serializable.*subclass Configurable"):
        model.save_pretrained(tmp_path / "model")
    with pytest.raises(ValueError, match="info"):
        small_net().save_pretrained(tmp_path / "model", info={"when": object()})
    assert not (tmp_path / "model").exists()


class Wide(FastUpConvDecoder):
    """Somebody's own decoder, with options that it only passes on."""

    def __init__(self, feature_info: Any, **options: Any) -> None:
        super().__init__(feature_info, **{"width": 16} | options)


def test_passed_on_options_are_written_down(tmp_path: Path) -> None:
    model = small_net(decoder=functools.partial(Wide, min_channels=4, fusion="none"))
    assert model.config["network"]["decoder"] == {
        "_target_": f"{__name__}.Wide",
        "_partial_": True,
        "min_channels": 4,
        "fusion": "none",
    }
    model.save_pretrained(tmp_path)
    assert same_model(DepthNet.from_pretrained(tmp_path, trusted_modules=[__name__]), model)


def test_parts_know_how_they_were_built() -> None:
    assert ResNet(18, pretrained=False).config == {"_target_": "eldenet.backbones.resnet.ResNet", "depth": 18}
    assert LinearHead(max_depth=4).config == {
        "_target_": "eldenet.heads.LinearHead", "min_depth": 0.1, "max_depth": 4,
    }  # fmt: skip
    assert isinstance(build(LinearHead().config), LinearHead)
    with pytest.raises(TypeError, match="max_dept"):
        LinearHead(max_dept=4)


# --- a config from elsewhere ---


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return small_net(refine=JointBilateral()).save_pretrained(tmp_path / "model")


@pytest.fixture
def foreign_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module that leaves a mark when it is imported."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "somebodys_parts.py").write_text(
        "from pathlib import Path\n"
        f"Path({str(tmp_path / 'mark')!r}).touch()\n"
        "from eldenet.heads import LinearHead\n"
        "class TheirHead(LinearHead):\n    pass\n"
        "def function(**_):\n    raise SystemExit\n"
    )
    monkeypatch.syspath_prepend(folder)
    yield "somebodys_parts"
    sys.modules.pop("somebodys_parts", None)


def rewrite(folder: Path, change: Any) -> None:
    path = folder / "config.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def nodes(value: Any) -> Iterator[dict[str, Any]]:
    """Every mapping with a ``_target_``, outermost first."""
    if isinstance(value, dict):
        if "_target_" in value:
            yield value
        for item in value.values():
            yield from nodes(item)


HOSTILE = [
    "os.system",
    "builtins.eval",
    "eval",
    "",
    "subprocess.Popen",
    "torch.nn.Linear",
    "torch.load",
    "functools.partial",
    "somebodys_parts.TheirHead",
    "eldenet.config.instantiate",
    "eldenet.trainer.Trainer",
    "eldenet.data.nyu.NYULabelled",
    "eldenet.headsX.Head",
    "eldenet.model.json.loads",
    "eldenet.model.json.codecs.open",
    "eldenet.model.torch.load",
    "eldenet.model.torch",
    "eldenet.model.Path",
    "eldenet.model.build",
    "eldenet.model.DepthNet.from_pretrained",
    "eldenet.model.DepthNet.__init__",
    "eldenet.heads..LinearHead",
    "eldenet.heads.nn.Linear",
    "eldenet.backbones.nothing.Here",
    "eldenet.backbones.weights.read_weights",
    "eldenet.backbones.weights.download_from_hub",
    "..heads.LinearHead",
]


@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("target", HOSTILE)
def test_foreign_targets_are_refused_wherever_they_stand(
    target: str, place: int, saved: Path, foreign_module: str
) -> None:
    def change(content: dict[str, Any]) -> None:
        places = list(nodes(content["model"]))
        assert len(places) == 5  # DepthNet, EncoderDecoder, backbone, decoder, head
        places[place]["_target_"] = target

    rewrite(saved, lambda content: content["model"].pop("refine"))
    rewrite(saved, change)
    before = set(sys.modules)
    with pytest.raises(ValueError, match=r"refused to build|can't build"):
        DepthNet.from_pretrained(saved)
    assert foreign_module not in sys.modules
    assert not (saved.parent / "mark").exists()
    assert {name for name in set(sys.modules) - before if not name.startswith("eldenet")} == set()


@pytest.mark.parametrize("depth", [1, 2, 30])
def test_foreign_targets_are_refused_however_deep(depth: int, saved: Path, foreign_module: str) -> None:
    hostile: Any = {"_target_": f"{foreign_module}.TheirHead"}
    for level in range(depth):
        hostile = [hostile] if level % 2 else {"deeper": hostile}
    rewrite(saved, lambda content: content["model"]["head"].update(min_depth=hostile))
    with pytest.raises(ValueError, match=r"refused to build 'somebodys_parts\.TheirHead'"):
        DepthNet.from_pretrained(saved)
    assert foreign_module not in sys.modules


def test_a_trusted_module_is_used(saved: Path, foreign_module: str) -> None:
    rewrite(saved, lambda content: content["model"]["head"].update(_target_="somebodys_parts.TheirHead"))
    with pytest.raises(ValueError, match=r"name it: trusted_modules=\[\.\.\.\]"):
        eldenet.load(saved)
    with pytest.raises(ValueError, match="refused to build"):
        eldenet.load(saved, trusted_modules=["somebodys", "somebodys_parts.more"])
    with pytest.raises(ValueError, match=r"a list is needed, \['somebodys_parts'\]"):
        eldenet.load(saved, trusted_modules="somebodys_parts")
    assert not (saved.parent / "mark").exists()
    model = eldenet.load(saved, trusted_modules=["somebodys_parts"])
    assert type(model.head).__name__ == "TheirHead"
    assert (saved.parent / "mark").exists()
    rewrite(saved, lambda content: content["model"]["head"].update(_target_="somebodys_parts.function"))
    with pytest.raises(ValueError, match="not a Configurable class of somebodys_parts"):
        eldenet.load(saved, trusted_modules=["somebodys_parts"])


@pytest.mark.parametrize("pretrained", [True, "/etc/hostname", "IMAGENET1K_V1"])
def test_a_saved_model_fetches_nothing(
    pretrained: bool | str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("something was fetched or read")

    monkeypatch.setattr("eldenet.backbones.resnet.load_torchvision_weights", never)
    folder = small_net(backbone=ResNet(18)).save_pretrained(tmp_path)
    rewrite(folder, lambda content: content["model"]["network"]["backbone"].update(pretrained=pretrained))
    with pytest.raises(ValueError, match="refused pretrained="):
        eldenet.load(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content.pop("model"), "no entry 'model': not an eldenet model folder"),
        (lambda content: content.update(model=None), "describes a NoneType, not a DepthNet"),
        (
            lambda content: content.update(model=content["model"]["head"]),
            "describes a LinearHead, not a DepthNet",
        ),
        (lambda content: content["model"].update(_partial_=True), "describes a partial, not a DepthNet"),
        (lambda content: content["model"]["network"].update(backbone=None), "EncoderDecoder does not fit"),
        (lambda content: content["model"]["network"].update(decoder=7), "EncoderDecoder does not fit"),
        (lambda content: content["model"].update(mean=[0.5]), "DepthNet does not fit"),
        (lambda content: content["model"]["head"].update(max_depth="far"), "LinearHead does not fit"),
        (lambda content: content["model"]["head"].update(max_depth=-1), "0 < min_depth < max_depth"),
        (lambda content: content["model"]["head"].update(colour="red"), "LinearHead does not fit.*colour"),
        (
            lambda content: content["model"]["network"]["backbone"].update(scale=0.5),
            "does not fit its own config",
        ),
    ],
)
def test_damaged_configs_say_so(change: Any, message: str, saved: Path) -> None:
    rewrite(saved, change)
    with pytest.raises(ValueError, match=message):
        DepthNet.from_pretrained(saved)


@pytest.mark.parametrize("content", [b"", b"{", b"[1, 2]", b"7", b"\xff\xfe\x00"])
def test_a_config_that_is_no_config(content: bytes, saved: Path) -> None:
    (saved / "config.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"config\.json (can't be read as JSON|has no entry 'model')"):
        DepthNet.from_pretrained(saved)


@pytest.mark.parametrize("keep", [0, 5, 100, 0.5, -1])
def test_truncated_weights_name_the_file(keep: float, saved: Path) -> None:
    path = saved / "model.safetensors"
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content)) if keep == 0.5 else int(keep)])
    with pytest.raises(ValueError, match=r"model\.safetensors is not a whole safetensors file"):
        DepthNet.from_pretrained(saved)


def test_a_pickle_is_no_safetensors(saved: Path) -> None:
    torch.save(small_net().state_dict(), saved / "model.safetensors")
    with pytest.raises(ValueError, match=r"model\.safetensors is not a whole safetensors file"):
        DepthNet.from_pretrained(saved)


@pytest.mark.parametrize("name", ["config.json", "model.safetensors"])
def test_missing_files_are_named(name: str, saved: Path) -> None:
    (saved / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"has no {name}: not an eldenet model folder"):
        eldenet.load(saved)


# --- the Hub ---


def test_offline_hub_says_so_quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    def offline(*_: Any, **__: Any) -> str:
        raise ConnectionError("no route to host")

    monkeypatch.setattr("huggingface_hub.snapshot_download", offline)
    start = time.perf_counter()
    with pytest.raises(
        FileNotFoundError, match=r"somebody/depth is no folder here.*ConnectionError: no route"
    ):
        eldenet.load("somebody/depth")
    assert time.perf_counter() - start < 5


def test_hub_folder_is_read_like_any_other(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def download(repo_id: str, **options: Any) -> str:
        asked.update(options, repo_id=repo_id)
        return str(saved)

    monkeypatch.setattr("huggingface_hub.snapshot_download", download)
    model = eldenet.load("somebody/depth", revision="v2")
    assert same_model(model, DepthNet.from_pretrained(saved))
    assert asked == {
        "repo_id": "somebody/depth", "revision": "v2", "allow_patterns": ["config.json", "model.safetensors"],
    }  # fmt: skip
    (saved / "model.safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"somebody/depth has no model\.safetensors"):
        eldenet.load("somebody/depth")


@pytest.mark.parametrize("source", ["/no/such/folder", "a/b/c", "./nothing/here"])
def test_paths_that_are_nowhere_do_not_ask_the_hub(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **__: pytest.fail("asked the Hub"))
    with pytest.raises(FileNotFoundError, match="neither a folder here nor a Hub id"):
        eldenet.load(source)


def test_push_uploads_both_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls: list[tuple[str, Any]] = []

    class Api:
        def __init__(self, token: str | None = None) -> None:
            calls.append(("token", token))

        def create_repo(self, repo_id: str, **options: Any) -> None:
            calls.append(("create", (repo_id, options)))

        def upload_folder(self, *, repo_id: str, folder_path: str) -> str:
            files = {path.name: path.read_bytes() for path in Path(folder_path).iterdir()}
            calls.append(("upload", (repo_id, files)))
            return f"https://hub/{repo_id}/commit/1"

    monkeypatch.setattr("huggingface_hub.HfApi", Api)
    model = small_net()
    assert model.push_to_hub("me/depth", private=True, info={"a": 1}) == "https://hub/me/depth/commit/1"
    assert calls[:2] == [("token", None), ("create", ("me/depth", {"private": True, "exist_ok": True}))]
    repository, files = calls[2][1]
    assert repository == "me/depth"
    assert set(files) == {"config.json", "model.safetensors"}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    assert same_model(DepthNet.from_pretrained(tmp_path), model)


def test_torch_hub_offers_the_same_names(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = importlib.util.spec_from_file_location("hubconf", REPOSITORY / "hubconf.py")
    hubconf = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hubconf)
    # torch.hub.list's own rule
    public = [name for name in dir(hubconf) if callable(getattr(hubconf, name)) and not name.startswith("_")]
    assert sorted(public) == NAMES
    assert all(getattr(hubconf, name).__doc__ for name in public)

    monkeypatch.setattr(sys, "path", sys.path[:])
    options = {"repo_or_dir": str(REPOSITORY), "source": "local", "model": "eldenet_s"}
    model = torch.hub.load(**options, overrides=["model.head.max_depth=4"])
    assert (type(model).__name__, model.head.max_depth, model.training) == ("DepthNet", 4, False)
    assert model(picture(32, 48)).shape == (1, 1, 32, 48)
    with pytest.raises(TypeError, match="pretrained"):
        torch.hub.load(**options, pretrained=True)


# --- refinement ---


def scene() -> tuple[Tensor, Tensor]:
    """A step in the image at column 16, and the same step in depth, but blurred."""
    sharp = torch.full((1, 1, 24, 32), 1.0)
    sharp[..., 16:] = 5.0
    image = (sharp / 5).expand(-1, 3, -1, -1).contiguous()
    blurred = torch.from_numpy(gaussian_filter(sharp.numpy(), (0, 0, 0, 1.5), mode="nearest"))
    return blurred, image


def test_constant_depth_stays() -> None:
    depth = torch.full((2, 1, 20, 30), 3.25)
    torch.testing.assert_close(JointBilateral()(depth, torch.rand(2, 3, 20, 30)), depth)


def test_refined_depth_stays_within_its_range() -> None:
    depth = 1 + 4 * torch.rand(2, 1, 20, 30, generator=torch.Generator().manual_seed(0))
    refined = JointBilateral(7)(depth, torch.rand(2, 3, 20, 30))
    assert refined.shape == depth.shape
    assert depth.min() - 1e-5 <= refined.min() < refined.max() <= depth.max() + 1e-5
    assert refined.std() < depth.std()  # it does smooth


def test_refinement_follows_the_images_edges() -> None:
    depth, image = scene()
    refined = JointBilateral()(depth, image)[0, 0, 12]
    gaussian = JointBilateral(sigma_color=1e3)(depth, image)[0, 0, 12]  # all colours alike: a plain Gaussian
    jump = [float(line[16] - line[15]) for line in (gaussian, depth[0, 0, 12], refined)]
    assert jump[0] < jump[1] < jump[2]


def test_model_with_refinement_hands_over_the_image() -> None:
    seen: list[Tensor] = []

    class Keep(Configurable, nn.Module):
        def forward(self, depth: Tensor, image: Tensor) -> Tensor:
            seen.append(image)
            return depth + 1

    image = picture(32, 32)
    with torch.inference_mode():
        plain = small_net()(image)
        refined = small_net(refine=Keep())(image)
    assert torch.equal(refined, plain + 1)
    assert torch.equal(seen[0], image)


def test_even_windows_are_refused() -> None:
    with pytest.raises(ValueError, match="kernel_size=4: an odd number"):
        JointBilateral(4)


def test_base_classes_do_nothing_by_themselves() -> None:
    with pytest.raises(NotImplementedError):
        Decoder((FeatureInfo(8, 2),))([torch.zeros(1, 8, 4, 4)])
    with pytest.raises(NotImplementedError):
        Head(0.1, 10)(torch.zeros(1))


def test_saved_files_are_as_readable_as_any_other(tmp_path):
    eldenet.load("eldenet_s").save_pretrained(tmp_path)
    modes = {(tmp_path / name).stat().st_mode for name in ("config.json", "model.safetensors")}
    assert len(modes) == 1

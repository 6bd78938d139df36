"""Networks are saved and read back."""

import functools
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file
from support.networks import same_model, small_net
from torch import nn

import eldenet
from eldenet.backbones.efficientnet import EfficientNetLite
from eldenet.backbones.mobilenet import MobileNetV2, MobileNetV3
from eldenet.backbones.pplcnet import PPLCNet
from eldenet.backbones.resnet import ResNet
from eldenet.backbones.timm import TimmBackbone
from eldenet.backbones.vgg import VGG16
from eldenet.compose import compose
from eldenet.configurable import Configurable, build
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.decoders.multi_kernel import MultiKernelDecoder
from eldenet.decoders.upconv import UpConvDecoder
from eldenet.deploy.predictor import DepthPredictor
from eldenet.heads import InverseHead, LinearHead, LogHead
from eldenet.model import DepthNet
from eldenet.refinement import JointBilateral
from eldenet.results.run_log import RunLog
from eldenet.train import TrainSettings
from eldenet.training.initialization import initial_model


def timm_backbone() -> nn.Module:
    pytest.importorskip("timm")
    return TimmBackbone("lcnet_035")


@pytest.mark.parametrize(
    "options",
    [
        {"backbone": lambda: PPLCNet(0.25, stem_feature=True)},
        {"backbone": MobileNetV2},
        {"backbone": lambda: EfficientNetLite(0, blocks=[1, 1, 1, 2])},
        {"backbone": lambda: MobileNetV3("small")},
        {"backbone": lambda: ResNet(18)},
        {"backbone": lambda: VGG16(batch_norm=True)},
        {"backbone": timm_backbone},
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
def test_every_part_is_saved_and_read_back(options: dict[str, Any], tmp_path: Path) -> None:
    if "backbone" in options:
        options = {"backbone": options["backbone"]()}
    model = small_net(**options)
    assert model.save_pretrained(tmp_path / "new" / "folder") == tmp_path / "new" / "folder"
    back = eldenet.load(tmp_path / "new" / "folder")
    assert same_model(back, model)
    assert not back.training
    back.train().save_pretrained(tmp_path / "again")
    assert same_model(eldenet.load(str(tmp_path / "again")), model)


@pytest.mark.parametrize(
    ("name", "part"), [("head", LinearHead(0.1, 80.0)), ("head", LogHead()), ("refine", JointBilateral(3))]
)
def test_a_replaced_part_is_saved_in_place_of_the_old_one(name: str, part: nn.Module, tmp_path: Path) -> None:
    """Its weights fit either part, so nothing else would show that depth is another."""
    model, image = small_net(), torch.rand(1, 3, 64, 96)
    setattr(model, name, part)
    model.save_pretrained(tmp_path)
    with torch.inference_mode():
        torch.testing.assert_close(eldenet.load(tmp_path)(image), model(image))


def test_half_the_bytes_hold_the_parameters_and_the_exact_statistics(tmp_path: Path) -> None:
    model = small_net()
    model.save_pretrained(tmp_path / "half", half=True)
    back = eldenet.load(tmp_path / "half")
    for stored, given in zip(back.parameters(), model.parameters(), strict=True):
        assert stored.dtype == torch.float32
        torch.testing.assert_close(stored, given, rtol=2**-11, atol=2**-25)  # half a step of fp16
    assert all(map(torch.equal, back.buffers(), model.buffers()))
    back.save_pretrained(tmp_path / "again", half=True)
    first, second = ((tmp_path / name / "config.json").read_bytes() for name in ("half", "again"))
    assert first == second
    torch.nn.init.constant_(next(model.parameters()), 1e5)
    with pytest.raises(ValueError, match=r"half=True: .* beyond 65504"):
        model.save_pretrained(tmp_path / "large", half=True)
    assert not (tmp_path / "large").exists()


def test_a_run_folder_loads_with_its_info(tmp_path: Path) -> None:
    model = small_net()
    info = {"data": "rooms", "delta1": 0.5}
    model.save_pretrained(tmp_path / "run" / "model", info=info)
    loaded = eldenet.load(tmp_path / "run")
    assert same_model(loaded, model)
    assert same_model(DepthNet.from_pretrained(tmp_path / "run"), model)
    assert loaded.info == info
    loaded.save_pretrained(tmp_path / "copy")
    assert eldenet.load(tmp_path / "copy").info == info
    assert sorted(path.name for path in (tmp_path / "copy").iterdir()) == [
        "README.md",
        "config.json",
        "model.safetensors",
    ]


def test_a_folder_of_runs_names_one_of_them(tmp_path: Path) -> None:
    for job in ("0", "1"):
        small_net().save_pretrained(tmp_path / "sweep" / job / "model")
    with pytest.raises(FileNotFoundError, match=r"sweep holds 2 runs: give one of them, such as .*sweep/0$"):
        eldenet.load(tmp_path / "sweep")


def test_new_info_is_added_to_the_old(tmp_path: Path) -> None:
    model = small_net()
    model.info = {"input_size": [48, 64], "whole_frame_size": [60, 76], "data": "kitti"}
    model.save_pretrained(tmp_path / "model", info={"trained_on": "streets", "data": "mine"})
    shared = eldenet.load(tmp_path / "model")
    assert shared.info == {**model.info, "trained_on": "streets", "data": "mine"}
    assert DepthPredictor(shared).size_for(120, 152) == DepthPredictor(model).size_for(120, 152) == (60, 76)
    model.save_pretrained(tmp_path / "tuned", info={"input_size": [96, 128]})  # drops the old frame size
    assert DepthPredictor(eldenet.load(tmp_path / "tuned")).size_for(120, 160) == (96, 128)


def test_a_saved_model_does_not_name_its_pretrained_file(tmp_path: Path) -> None:
    torch.save(ResNet(18).state_dict(), tmp_path / "resnet18.pth")
    model = small_net(backbone=ResNet(18, pretrained=str(tmp_path / "resnet18.pth")))
    model.save_pretrained(tmp_path / "model")
    assert "pretrained" not in (tmp_path / "model" / "config.json").read_text()
    (tmp_path / "resnet18.pth").unlink()
    assert same_model(eldenet.load(tmp_path / "model"), model)


def test_a_model_that_cannot_be_rebuilt_is_not_saved(tmp_path: Path) -> None:
    model = DepthNet(nn.Conv2d(3, 1, 1), LinearHead())
    with pytest.raises(ValueError, match=r"Conv2d is not JSON serializable.*subclass Configurable"):
        model.save_pretrained(tmp_path / "model")
    with pytest.raises(ValueError, match="info"):
        small_net().save_pretrained(tmp_path / "model", info={"when": object()})
    with pytest.raises(ValueError, match="JSON compliant"):  # reading refuses NaN
        small_net().save_pretrained(tmp_path / "model", info={"test": {"delta1": float("nan")}})
    with pytest.raises(ValueError, match=r"input_size of info='64x96': give \[height, width\]"):
        small_net().save_pretrained(tmp_path / "model", info={"input_size": "64x96"})
    assert not (tmp_path / "model").exists()


class Shared(Configurable, nn.Module):
    """A user's network that uses one weight twice."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second, self.out = (nn.Conv2d(3, count, 1) for count in (3, 3, 1))
        self.second.weight = self.first.weight

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return self.out(self.second(self.first(image).relu()))


def test_a_network_with_a_shared_weight_is_saved_and_read_back(tmp_path: Path) -> None:
    model = DepthNet(Shared(), LinearHead())
    model.save_pretrained(tmp_path / "model")
    assert same_model(eldenet.load(tmp_path / "model", trusted_modules=[__name__]), model)
    model.save_pretrained(tmp_path / "half", half=True)
    assert {value.dtype for value in load_file(tmp_path / "half/model.safetensors").values()} == {
        torch.float16
    }


class Wide(FastUpConvDecoder):
    """A user's decoder that passes options on."""

    def __init__(self, feature_info: Any, **options: Any) -> None:
        super().__init__(feature_info, **{"width": 16} | options)


def test_options_that_are_passed_on_are_saved(tmp_path: Path) -> None:
    model = small_net(decoder=functools.partial(Wide, min_channels=4, fusion="none"))
    assert model.config["network"]["decoder"] == {
        "_target_": f"{__name__}.Wide",
        "_partial_": True,
        "min_channels": 4,
        "fusion": "none",
    }
    model.save_pretrained(tmp_path)
    assert same_model(DepthNet.from_pretrained(tmp_path, trusted_modules=[__name__]), model)


def test_a_parts_config_rebuilds_it() -> None:
    assert ResNet(18, pretrained=False).config == {"_target_": "eldenet.backbones.resnet.ResNet", "depth": 18}
    assert LinearHead(max_depth=4).config == {
        "_target_": "eldenet.heads.LinearHead", "min_depth": 0.1, "max_depth": 4,
    }  # fmt: skip
    assert isinstance(build(LinearHead().config), LinearHead)
    with pytest.raises(TypeError, match="max_dept"):
        LinearHead(max_dept=4)


def test_a_training_starts_from_fitting_weights_only(tmp_path: Path) -> None:
    s = compose(TrainSettings, ["model=eldenet", "weights=eldenet_rooms"])
    log = RunLog(tmp_path, quiet=True)
    ours = initial_model(s.model, 0, s.weights, log=log).state_dict()
    assert all(
        torch.equal(ours[name], value) for name, value in eldenet.load("eldenet_rooms").state_dict().items()
    )
    other = compose(TrainSettings, ["model=resnet18_upconv", "model_name=r", "weights=eldenet_rooms"])
    with pytest.raises(ValueError, match=r"eldenet_rooms: they fit only \d % of this network"):
        initial_model(other.model, 0, other.weights)

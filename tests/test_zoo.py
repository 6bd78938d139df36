"""Networks by name, and the trained weights in the package."""

import json
import warnings
from pathlib import Path

import pytest
import torch
from support.networks import picture, small_net

import eldenet
from eldenet.compose import compose
from eldenet.decoders.multi_kernel import MultiKernelDecoder
from eldenet.deploy import runtimes
from eldenet.evaluation.cost import count_params
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.heads import LogHead
from eldenet.model import DepthNet
from eldenet.refinement import JointBilateral
from eldenet.results.fingerprints import sha256
from eldenet.train import TrainSettings
from eldenet.weights import PACKAGED

NAMES = [
    *("eldenet", "eldenet_fast", "eldenet_l", "eldenet_paper", "eldenet_s"),
    *("fastdepth", "guidedepth", "guidedepth_s"),
    *("lite_mono", "lite_mono_8m", "lite_mono_small", "lite_mono_tiny", "meter_s", "meter_xs", "meter_xxs"),
    *("mobilenet_v1_upconv", "mobilenet_v2_upconv", "mobilenet_v3_small_upconv", "mobilenet_v3_upconv"),
    *("resnet152_upconv", "resnet18_upconv", "resnet50_upconv"),
    *("senet154_upconv", "seresnet18_upconv", "seresnet50_upconv", "vgg16_upconv"),
]
SMALL = {"eldenet", "eldenet_l", "eldenet_paper", "eldenet_s", "mobilenet_v3_upconv", "resnet18_upconv"}


def test_the_public_names_are_the_documented_ones() -> None:
    assert eldenet.list_models() == NAMES
    assert dir(eldenet) == eldenet.__all__
    assert all(getattr(eldenet, name) is not None for name in eldenet.__all__)
    with pytest.raises(AttributeError, match="no attribute 'Depthnet'"):
        _ = eldenet.Depthnet


@pytest.mark.parametrize("name", NAMES)
def test_every_name_builds_a_model_in_eval_mode(name: str) -> None:
    if name.startswith("se"):
        pytest.importorskip("timm")
    model = eldenet.load(name)
    assert isinstance(model, DepthNet)
    assert not model.training
    assert (model.head.min_depth, model.head.max_depth) == (0.1, 10.0)
    json.dumps(model.config)
    if name in SMALL:
        with torch.inference_mode():
            assert model(picture(64, 96)).shape == (1, 1, 64, 96)


def test_eldenet_has_the_papers_share_of_the_baselines_parameters() -> None:
    names = ("resnet18_upconv", "eldenet", "eldenet_paper", "eldenet_s")
    sizes = {name: count_params(eldenet.load(name)) for name in names}
    assert 0.03 < sizes["eldenet"] / sizes["resnet18_upconv"] < 0.05
    assert round(sizes["eldenet_paper"] / sizes["resnet18_upconv"], 2) == 0.04  # the paper's "0.04 times"
    assert sizes["eldenet_s"] < sizes["eldenet"]


def test_overrides_replace_parts_and_options() -> None:
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
    ("source", "options", "message"),
    [
        ("eldenett", {}, r"unknown model 'eldenett': did you mean eldenet\? docs/weights"),
        ("eldenet_room", {}, r"did you mean eldenet_rooms\?"),
        ("eldenet_kitti", {}, r"eldenet_rooms: indoors; there are none for streets\)"),
        ("eldenet_outdoor", {}, "there are none for streets"),
        ("runs/mine/checkpoints/best.pt", {}, "give the run folder, which stands for the best epoch"),
        ("qqqqqqqq", {}, r"choose trained weights .*docs/networks\.md"),
        ("eldenet", {"weights": "kitti"}, r"no weights 'kitti' for eldenet, only eldenet_.*load\('kitti'\)"),
        ("eldenet", {"revision": "v2"}, "apply to saved models"),
        ("eldenet_rooms", {"overrides": ["model.head.max_depth=80"]}, "apply to networks built by name"),
        ("eldenet_rooms", {"revision": "v2"}, "revision='v2' applies to Hub ids"),
        # overrides that do not fit; the first message lists the choices
        ("eldenet", {"overrides": ["model/backbone=pplcnet_x9"]}, "pplcnet_x0_5"),
        ("eldenet", {"overrides": ["model.head.max_dept=80"]}, "max_dept"),
        ("eldenet", {"overrides": ["model.head.max_depth=0.01"]}, "0 < min_depth < max_depth"),
        ("eldenet", {"overrides": ["="]}, "="),
    ],
)
def test_what_cannot_be_loaded_is_refused_with_the_choices(source: str, options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        eldenet.load(source, **options)


OF_RENDERED = [name for name in eldenet.list_weights() if "indoor" not in name]


@pytest.mark.parametrize("name", OF_RENDERED)
def test_packaged_weights_fit_their_network_and_say_what_they_saw(name):
    model = eldenet.load(name)
    network, seen = name.rsplit("_", 1)
    fresh = eldenet.load(network)
    assert {key: value.shape for key, value in model.state_dict().items()} == {
        key: value.shape for key, value in fresh.state_dict().items()
    }
    assert sum(path.stat().st_size for path in (PACKAGED / name).iterdir()) < 3_000_000
    assert f"rendered {seen}" in model.info["weights have seen"]
    assert model.info["test"]["protocol"] == seen
    assert not model.training
    named = eldenet.load(network, weights=seen).state_dict()
    assert all(torch.equal(value, named[key]) for key, value in model.state_dict().items())


@pytest.mark.parametrize(("name", "bytes_at_most"), [("eldenet", 4_000_000), ("eldenet_l", 20_000_000)])
def test_weights_of_real_rooms_say_what_they_saw_and_know_the_focal_length(name, bytes_at_most) -> None:
    model = eldenet.load(name, weights="indoor")
    assert "NYU Depth V2" in model.info["weights have seen"]
    assert model.info["test"]["protocol"] == "nyu_inpainted_eigen"
    assert model.canonical_px == 0.8 * model.info["input_size"][1]
    assert sum(path.stat().st_size for path in (PACKAGED / f"{name}_indoor").iterdir()) < bytes_at_most


@pytest.mark.parametrize("name", OF_RENDERED)
def test_packaged_weights_predict_depth(name, cache):
    """AbsRel on a few test frames of their kind of data; on all 512 it is 0.19 for rooms, 0.06 for arenas."""
    network, seen = name.rsplit("_", 1)
    few = ["data.frames.test=16", f"data.root={cache}"]
    config = compose(TrainSettings, [f"data={seen}", *few])
    frames = open_split(config.data, "test", chosen_protocol(config.data, config.protocol), score=True)
    samples = [frames[index] for index in range(len(frames))]
    image, depth, mask = (
        torch.stack([sample[key] for sample in samples]) for key in ("image", "depth", "mask")
    )
    with torch.no_grad():
        fresh, trained = (
            ((eldenet.load(source)(image) - depth).abs() / depth)[mask].mean() for source in (network, name)
        )
    assert trained < 0.25
    assert fresh > 2 * trained


def test_a_tilde_is_the_home_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    small_net().save_pretrained(tmp_path / "runs/mine/model")
    for read in (eldenet.load, lambda source: runtimes.load(source, threads=1)):
        read("~/runs/mine")
        read("~/runs/mine/model")
        with pytest.raises(FileNotFoundError, match="~/nothing is neither a local folder"):
            read("~/nothing")
    (tmp_path / "photo.jpg").touch()
    with pytest.raises(ValueError, match=r"photo\.jpg is a file: give a run folder"):
        eldenet.load("~/photo.jpg")
    with pytest.raises(FileNotFoundError, match=r"~/nothing\.onnx does not exist"):
        runtimes.load("~/nothing.onnx")
    assert sha256("~/runs/mine") == sha256(tmp_path / "runs/mine") is not None


def test_a_run_with_the_name_of_packaged_weights_needs_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    small_net().save_pretrained("eldenet_rooms/model")
    with pytest.warns(UserWarning, match=r"from the package.* to use the folder, give \./eldenet_rooms"):
        packaged = eldenet.load("eldenet_rooms")
    assert "rendered rooms" in packaged.info["weights have seen"]
    assert eldenet.load("./eldenet_rooms").info == {}
    assert runtimes.load("./eldenet_rooms", threads=1).info == {"model_name": "unnamed"}
    (tmp_path / "eldenet_rooms").rename("other")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        eldenet.load("eldenet_rooms")

"""Networks trained on crops of a camera's frames see its whole frames at the scale of those crops."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import layouts
from support.networks import canonical_net, small_net
from support.predicting import exported, save

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.deploy import runtimes
from eldenet.deploy.metadata import describe
from eldenet.deploy.predictor import DepthPredictor
from eldenet.deploy.runtimes.base import Runtime
from eldenet.deploy.runtimes.module import RuntimeNetwork
from eldenet.evaluate import EvaluateSettings, evaluate, trained_size
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.export import ExportSettings, target_of
from eldenet.geometry import resize_intrinsics
from eldenet.model import DepthNet
from eldenet.train import TrainSettings, train
from eldenet.training.initialization import trained_sizes

VGA = layouts.content((480, 640))
CROPPING = {
    "kitti": (layouts.kitti_depth, ["data=kitti"]),
    "kitti_raw": (layouts.kitti_raw, ["data=kitti_raw"]),
    "kitti_paper": (
        layouts.kitti_depth,
        ["+experiment=kitti_paper", "data.depth=groundtruth", "data.subset.train=1"],
    ),
    "nyu_hdf5": (lambda root: layouts.hdf5(root, VGA), ["data=nyu_hdf5"]),
}


def training(name: str, folder: Path) -> tuple[dict[str, Any], Any]:
    """What a model of this training says of sizes, and the training's frames."""
    layout, overrides = CROPPING[name]
    config = compose(TrainSettings, [*overrides, f"data.root={layout(folder)}"])
    protocol = chosen_protocol(config.data, config.protocol)
    frames = open_split(config.data, "train", protocol)
    return trained_sizes(list(config.data["input_size"]), protocol, frames), frames


@pytest.mark.parametrize("name", ["kitti", "kitti_raw", "kitti_paper"])
def test_focal_lengths_are_the_trainings(name: str, tmp_path: Path) -> None:
    info, frames = training(name, tmp_path)
    whole = frames.load_frame(0)
    size = whole.depth.shape
    model = small_net()
    model.save_pretrained(tmp_path / "model", info=info)
    predictor = DepthPredictor(DepthNet.from_pretrained(tmp_path / "model"))
    seen = resize_intrinsics(whole.intrinsics, size, predictor.size_for(*size))
    trained = frames[0]["intrinsics"].numpy()
    for axis, side in ((0, 1), (1, 0)):  # to half a pixel of the size
        half = 0.51 / predictor.size_for(*size)[side]
        assert seen[axis, axis] == pytest.approx(trained[axis, axis], rel=half)
    squeezed = resize_intrinsics(whole.intrinsics, size, info["input_size"])
    assert squeezed[1, 1] < 0.95 * trained[1, 1]


def test_sizes_of_whole_frames(tmp_path: Path) -> None:
    kitti, _ = training("kitti", tmp_path / "kitti")
    assert kitti == {"input_size": [176, 608], "whole_frame_size": [188, 621]}
    nyu, _ = training("nyu_hdf5", tmp_path / "nyu")
    assert nyu == {"input_size": [228, 304], "whole_frame_size": [240, 320]}
    config = compose(
        TrainSettings, ["data=kitti", f"data.root={tmp_path / 'kitti/depth'}", "data.input_size=null"]
    )
    protocol = chosen_protocol(config.data, config.protocol)
    sizes = trained_sizes(None, protocol, open_split(config.data, "train", protocol))
    assert sizes == {"input_size": None, "whole_frame_size": [375, 1242]}


class Fitted(Exception):
    """Raised in the place of a training."""


def test_a_training_tells_its_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fit(*args: Any, info: dict[str, Any], **options: Any) -> None:
        raise Fitted(info)

    monkeypatch.setattr("eldenet.training.trainer.Trainer.fit", fit)
    given = ["data=kitti", f"data.root={layouts.kitti_depth(tmp_path)}", "model=eldenet_s", "model_name=m"]
    config = compose(
        TrainSettings, [*given, f"output={tmp_path / 'run'}", "runtime.threads=1", "runtime.workers=0"]
    )
    with pytest.raises(Fitted) as told:
        train(config)
    assert told.value.args[0]["whole_frame_size"] == [188, 621]
    assert told.value.args[0]["input_size"] == [176, 608]


def test_where_frames_are_seen_whole_nothing_is_added(tmp_path: Path) -> None:
    tree = layouts.cityscapes(tmp_path, layouts.content((1024, 2048)))
    for overrides in (["data=cityscapes"], ["+experiment=cityscapes_paper"]):
        config = compose(TrainSettings, [*overrides, f"data.root={tree}"])
        protocol = chosen_protocol(config.data, config.protocol)
        sizes = trained_sizes([128, 256], protocol, open_split(config.data, "train", protocol))
        assert sizes == {"input_size": [128, 256]}


def test_frames_that_are_squeezed_into_the_input_are_squeezed_by_the_predictor(tmp_path: Path) -> None:
    """A folder of 16:9 pictures and an input of 4:3."""
    tree = layouts.folder(tmp_path, layouts.content((36, 64)))
    config = compose(TrainSettings, ["data=folder", f"data.root={tree}", "data.input_size=[48,64]"])
    protocol = chosen_protocol(config.data, config.protocol)
    sizes = trained_sizes([48, 64], protocol, open_split(config.data, "train", protocol))
    assert sizes == {"input_size": [48, 64], "stretch": pytest.approx(0.75)}
    model = small_net()
    model.info = sizes
    assert DepthPredictor(model).size_for(36, 64) == (48, 64)
    assert trained_sizes(None, protocol, open_split(config.data, "train", protocol)) == {"input_size": None}


WHOLE, PART = [60, 76], [48, 64]


def network_of_crops() -> DepthNet:
    model = small_net()
    model.info = {"input_size": PART, "whole_frame_size": WHOLE}
    return model


def test_files_and_runtimes_take_the_size_of_whole_frames(tmp_path: Path) -> None:
    model = network_of_crops()
    for size, overrides in ((WHOLE, []), (PART, [f"size={PART}"])):
        config = compose(
            ExportSettings, ["checkpoint=eldenet", f"output='{tmp_path / 'm.onnx'}'", *overrides]
        )
        assert list(target_of(config, model).size) == size
    network = runtimes.load(model, "torch", threads=1)
    assert network.info["input_size"] == tuple(WHOLE)
    assert DepthPredictor(network).size_for(120, 152) == tuple(WHOLE)
    chosen = DepthPredictor(runtimes.load(model, "torch", threads=1, size=(48, 64)))
    assert chosen.size_for(120, 160) == (48, 64)


def test_a_protocol_decides_which_size_is_scored() -> None:
    model = network_of_crops()
    crops, whole = (
        instantiate(compose(TrainSettings, [f"protocol={name}"]).protocol)
        for name in ("kitti_eigen_garg_improved", "kitti_eigen_garg_raw")
    )
    assert (trained_size(model, crops), trained_size(model, whole)) == (PART, WHOLE)

    def file(size: list[int]) -> RuntimeNetwork:
        return RuntimeNetwork(Runtime("fp32", 1, "cpu", describe(model, "m", (size[0], size[1]))))

    assert trained_size(file(WHOLE), whole) == tuple(WHOLE)
    assert trained_size(file(PART), crops) == tuple(PART)
    with pytest.raises(ValueError, match=r"whole frames, 60 x 76 pixels, but protocol kitti_eigen_garg_impr"):
        trained_size(file(WHOLE), crops)


@pytest.mark.parametrize(
    ("seen", "stretch", "shown"), [((64, 64), None, (32, 128)), ((64, 128), 0.5, (64, 128))]
)
def test_frames_of_another_shape_are_scored_as_they_are_predicted(
    seen: tuple[int, int], stretch: float | None, shown: tuple[int, int], tmp_path: Path
) -> None:
    model = canonical_net(*seen)
    model.info["stretch"] = stretch
    model.save_pretrained(tmp_path / "model")
    predictor = DepthPredictor(DepthNet.from_pretrained(tmp_path / "model"), steady=False)
    for name in ("depths", "cameras"):
        (tmp_path / "frames" / name).mkdir(parents=True)
    for number, size in enumerate([(64, 256), (64, 256), (256, 128)]):  # the last one upright
        photo = np.random.default_rng(number).integers(0, 255, (*size, 3), np.uint8)
        save(tmp_path / f"frames/images/{number}.png", photo)
        np.save(tmp_path / f"frames/depths/{number}.npy", predictor(photo, focal=200))
        camera = f"200 200 {size[1] / 2 - 0.5} {size[0] / 2 - 0.5}"
        (tmp_path / f"frames/cameras/{number}.txt").write_text(camera)
    words = [
        f"checkpoint={tmp_path}/model",
        "data=folder",
        f"data.root={tmp_path}/frames",
        "data.encoding=meters",
    ]
    words += ["data.intrinsics=cameras", "data.test_split=all", "runtime.workers=0"]
    record = evaluate(compose(EvaluateSettings, [*words, f"output={tmp_path}/scores"]))
    assert record["metrics"]["abs_rel"] < 1e-4
    assert (record["cost"]["height"], record["cost"]["width"]) == shown


@pytest.mark.parametrize(
    ("words", "noted"),
    [
        (["input_size=[64,128]"], " and at its size: give data.intrinsics, and else input_size=model"),
        (["input_size=[32,64]"], ": give data.intrinsics"),
        ([], ": give data.intrinsics"),
        (["data.intrinsics=[50,50,31.5,15.5]"], None),
        (["data.protocol.scale=median"], None),
    ],
)
def test_evaluate_says_for_which_lens_the_meters_are_right(
    words: list[str], noted: str | None, tmp_path: Path, capsys
) -> None:
    canonical_net(32, 64).save_pretrained(tmp_path / "model")
    tree = layouts.folder(tmp_path / "frames", layouts.content((32, 64)), count=2)
    given = [f"checkpoint={tmp_path}/model", "data=folder", f"data.root={tree}", "data.test_split=all"]
    evaluate(compose(EvaluateSettings, [*given, "runtime.workers=0", f"output={tmp_path}/scores", *words]))
    said = " ".join(capsys.readouterr().out.split())
    if noted is None:
        assert "intrinsics" not in said
    else:
        assert f"meters are only right for the lens of the training{noted}" in said


@pytest.mark.slow
def test_a_file_of_one_size_is_not_scored_on_frames_that_it_would_squeeze(tmp_path: Path) -> None:
    file = exported(canonical_net(32, 64), tmp_path / "model.onnx")
    words = [f"checkpoint={file}", "data=folder", "data.test_split=all", "runtime.workers=0", "batch_size=1"]
    words += [f"data.root={layouts.folder(tmp_path / 'frames', count=2)}", f"output={tmp_path}/scores"]
    with pytest.raises(
        ValueError, match=r"takes \[32, 64\] .* squeeze frames of 48 x 64: export one with size=\["
    ):
        evaluate(compose(EvaluateSettings, words))
    evaluate(compose(EvaluateSettings, [*words, "input_size=[32,64]"]))

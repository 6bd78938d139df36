"""A network with a canonical camera: meters follow the focal length, whatever the network is."""

import json
import logging
import math
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from support.networks import MODELS, picture, small_net
from support.synthetic import SyntheticDepth
from support.training import ONE_THREAD, PROTOCOL, make_trainer

import eldenet
from eldenet.compose import FOCAL_RANGE, compose, config_folder
from eldenet.configurable import instantiate
from eldenet.data.mix import Mix
from eldenet.evaluation.evaluator import evaluate, predict_depth
from eldenet.evaluation.splits import chosen_protocol
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.refinement import JointBilateral
from eldenet.system.resources import seed_everything
from eldenet.train import TrainSettings
from eldenet.training.initialization import canonical_camera
from eldenet.training.notes import without_camera
from eldenet.training.trainer import TrainingData

CANONICAL = 0.8  # [widths]
SIZE = (32, 40)


def canonical_net(**options: object) -> eldenet.DepthNet:
    return small_net(canonical_focal=CANONICAL, canonical_width=SIZE[1], **options)


@pytest.mark.parametrize("name", MODELS)
def test_meters_are_canonical_depth_times_the_ratio_of_focal_lengths(name: str) -> None:
    if name.startswith("se"):
        pytest.importorskip("timm")
    words = [f"model={name}", f"canonical_focal={CANONICAL}", f"data.input_size={list(SIZE)}"]
    config = compose(TrainSettings, words)
    model = instantiate(
        config.model, **canonical_camera(config.canonical_focal, config.data["input_size"])
    ).eval()
    assert model.canonical_px == pytest.approx(CANONICAL * SIZE[1])
    assert json.loads(json.dumps(model.config))["canonical_focal"] == CANONICAL
    images, focal = picture(*SIZE, batch=4), torch.tensor([16.0, 80.0, 0.0, math.nan])
    with torch.inference_mode():
        canonical = model(images)
        torch.testing.assert_close(model(images, focal=48.0), canonical * (48 / 32))
        by_image = model(images, focal=focal)
    assert canonical.min() >= model.head.min_depth * (1 - 1e-5)
    assert canonical.max() <= model.head.max_depth * (1 + 1e-5)
    expected = canonical * torch.tensor([16 / 32, 80 / 32, 1, 1]).view(4, 1, 1, 1)  # 0 and NaN are unknown
    torch.testing.assert_close(by_image, expected)


@pytest.mark.parametrize("focal", [(48.0, 48.0, 20.0, 12.0), torch.eye(3) * 48, torch.ones(3)])
def test_intrinsics_in_place_of_a_focal_length_are_refused(focal: object) -> None:
    """They would broadcast: one depth map per number, each through another lens."""
    with pytest.raises(ValueError, match=r"focal has shape .*: give fx \[px\], a number or \(1,\)"):
        canonical_net()(picture(*SIZE), focal=focal)


def test_a_refinement_sees_canonical_depth() -> None:
    """So that what it takes for an edge does not depend on the lens."""
    model, image = canonical_net(refine=JointBilateral()), picture(*SIZE)
    with torch.inference_mode():
        torch.testing.assert_close(model(image, focal=64.0), model(image) * 2)


def test_a_saved_model_keeps_its_camera(tmp_path: Path) -> None:
    model, image = canonical_net(), picture(*SIZE)
    again = eldenet.load(model.save_pretrained(tmp_path))
    assert again.canonical_px == model.canonical_px
    with torch.inference_mode():
        torch.testing.assert_close(again(image, focal=20.0), model(image, focal=20.0))


@pytest.mark.parametrize("name", eldenet.list_weights())
def test_weights_without_a_canonical_camera_ignore_focal_lengths_and_say_so(
    name: str, caplog: pytest.LogCaptureFixture
) -> None:
    model = eldenet.load(name)
    if model.canonical_px is not None:
        pytest.skip("these weights have a canonical camera")
    image, frame = picture(96, 128), np.full((96, 128, 3), 90, np.uint8)
    with torch.inference_mode():
        assert torch.equal(model(image, focal=77.0), model(image))
    predictor = eldenet.DepthPredictor(model, steady=False)
    with caplog.at_level(logging.WARNING, "eldenet"):
        np.testing.assert_array_equal(predictor(frame, fov=90), predictor(frame))
    assert "ignores focal lengths" in caplog.text


@pytest.mark.parametrize("camera", [(0.8, None), (None, 40), (0, 40), (-1, 40), (0.8, 0)])
def test_half_a_camera_is_refused(camera: tuple[float | None, int | None]) -> None:
    with pytest.raises(ValueError, match="give both above 0"):
        small_net(canonical_focal=camera[0], canonical_width=camera[1])


def test_a_camera_in_widths_needs_a_width() -> None:
    config = compose(TrainSettings, ["canonical_focal=0.8", "data.input_size=null"])
    with pytest.raises(ValueError, match=r"canonical_focal is in widths .* data\.input_size"):
        canonical_camera(config.canonical_focal, config.data["input_size"])


def choices(group: str) -> list[str]:
    return sorted(path.stem for path in (config_folder() / group).glob("*.yaml"))


#: Protocols without a limit, or with one of another quantity: there the data set's range counts.
UNLIMITED = {"nyu_sparse_to_dense", "kitti_s2d_912x228", "cityscapes_mtan"}
#: The data set that a protocol scores, if none names it as its own.
SCORED = {
    "kitti_eigen_eigen": "kitti_eigen_raw",
    "nyu_sparse_to_dense": "nyu_hdf5",
    "nyu": "nyu_mat",
    "kitti": "kitti",
    "cityscapes": "cityscapes",
}


HEADS_AND_DATA = [
    *(("linear", data) for data in choices("data")),
    *((head, "rooms") for head in choices("model/head") if head != "linear"),
]


@pytest.mark.parametrize(("head", "data"), HEADS_AND_DATA)
def test_heads_reach_every_depth_of_a_data_set_through_every_lens(head: str, data: str) -> None:
    config = compose(TrainSettings, [f"data={data}", f"model/head={head}", "canonical_focal=0.8"])
    made = instantiate(config.model["head"])
    for focal in FOCAL_RANGE:
        meters = np.array([made.min_depth, made.max_depth]) * focal / CANONICAL
        assert meters[0] <= config.data["min_depth"] * (1 + 1e-9)
        assert meters[1] >= config.data["max_depth"] * (1 - 1e-9)


@pytest.mark.parametrize("name", choices("protocol"))
def test_heads_reach_as_far_as_every_protocol_scores(name: str) -> None:
    own = [
        data
        for data in choices("data")
        if f"protocol: {name}\n" in (config_folder() / "data" / f"{data}.yaml").read_text()
    ]
    for data in own or [SCORED.get(name, SCORED[name.split("_")[0]])]:
        words = [f"data={data}", f"protocol={name}", "canonical_focal=0.8"]
        config = compose(TrainSettings, words)
        protocol, head = chosen_protocol(config.data, config.protocol), instantiate(config.model["head"])
        farthest = config.data["max_depth"] if name in UNLIMITED else protocol.max_depth
        for focal in FOCAL_RANGE:
            assert head.max_depth * focal / CANONICAL >= farthest * (1 - 1e-9), data


def test_without_a_canonical_camera_heads_keep_the_range_of_the_data() -> None:
    config = compose(TrainSettings, [])
    head = instantiate(config.model["head"])
    assert (head.min_depth, head.max_depth) == (config.data["min_depth"], config.data["max_depth"])
    assert canonical_camera(config.canonical_focal, config.data["input_size"]) == {}


@pytest.mark.parametrize(("words", "zoom"), [([], "depth"), (["canonical_focal=0.8"], "focal")])
def test_a_zoom_is_a_longer_lens_where_the_network_knows_lenses(words: list[str], zoom: str) -> None:
    assert compose(TrainSettings, words).augmentation["zoom"] == zoom


class Lenses(SyntheticDepth):
    """The same frames, seen through lenses of 16 px and 64 px in turns."""

    def load_frame(self, index: int):
        frame = super().load_frame(index)
        focal = (16.0, 64.0)[index % 2]
        return frame._replace(intrinsics=np.diag([focal, focal, 1.0]))


def test_figures_are_in_meters_of_each_frames_camera() -> None:
    model, frames = canonical_net(), Lenses(4)
    samples = [frames[index] for index in range(4)]
    image = torch.stack([sample["image"] for sample in samples])
    with torch.inference_mode():
        expected = model(image) * torch.tensor([0.5, 2, 0.5, 2]).view(4, 1, 1, 1)
    focal = torch.tensor([16.0, 64.0, 16.0, 64.0])
    torch.testing.assert_close(predict_depth(model, image, focal), expected)
    result = evaluate(model, frames, PROTOCOL).metrics["mae"]
    depth, mask = (torch.stack([sample[key] for sample in samples]) for key in ("depth", "mask"))
    clamped = expected.clamp(PROTOCOL.min_depth, PROTOCOL.max_depth)
    errors = [(p - d)[m].abs().mean().item() for p, d, m in zip(clamped, depth, mask, strict=True)]
    assert result == pytest.approx(np.mean(errors), rel=1e-4)


class NoCamera(SyntheticDepth):
    def load_frame(self, index: int):
        return super().load_frame(index)._replace(intrinsics=None)


def test_frames_without_a_camera_are_noticed_where_they_teach_meters() -> None:
    assert without_camera(SyntheticDepth(2)) == ""
    assert without_camera(NoCamera(2)) == "synthetic/0"
    for relative, found in ((False, "synthetic/0"), (True, "")):
        unknown = {"data": partial(NoCamera, 2), "weight": 1.0, "relative": relative}
        sources = {"known": {"data": partial(SyntheticDepth, 2), "weight": 1.0}, "unknown": unknown}
        assert without_camera(Mix(sources, 4)) == found


class Watched(WeightedTerm):
    """Remembers what it compared."""

    def forward(self, inputs):
        self.seen = inputs.prediction.detach(), inputs.target, inputs.focal, inputs.ratio
        return super().forward(inputs)


def test_the_loss_compares_depth_of_the_camera_that_it_is_told(tmp_path: Path) -> None:
    seen = {}
    for camera in ("canonical", "own"):
        seed_everything(0)
        term, trainer = Watched(L1Loss()), make_trainer(epochs=1, batch_size=4, loss_camera=camera)
        data = TrainingData(Lenses(4), Lenses(2), PROTOCOL)
        trainer.fit(canonical_net().train(), WeightedSum({"l1": term}), data, tmp_path / camera, ONE_THREAD)
        seen[camera] = term.seen
    prediction, target, focal, none = seen["own"]
    assert none is None
    assert sorted(focal.tolist()) == [16, 16, 64, 64]
    ratio = (focal / 32).view(4, 1, 1, 1)
    torch.testing.assert_close(seen["canonical"][0] * ratio, prediction)
    torch.testing.assert_close(seen["canonical"][1] * ratio, target)
    torch.testing.assert_close(seen["canonical"][2], focal)
    torch.testing.assert_close(seen["canonical"][3], ratio)

"""The constant predictor: the mean of known depth, of few frames where few are rendered."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support import layouts
from support.scoring import score_small
from support.synthetic import SyntheticDepth

from eldenet.compose import compose
from eldenet.data import rendered_scenes, scene_store
from eldenet.data.folder import FolderDataset
from eldenet.data.rooms import Rooms
from eldenet.evaluation.constant_baseline import fit_constant_predictor
from eldenet.geometry import pinhole
from eldenet.simulation.furnished_rooms import render as render_module
from eldenet.simulation.furnished_rooms.render import Views
from eldenet.train import TrainSettings
from eldenet.types import Frame

Asked = list[tuple[str, Sequence[int]]]


class Halves(SyntheticDepth):
    def load_frame(self, index: int) -> Frame:
        frame = super().load_frame(index)
        depth = frame.depth * 0 + (2.0 if index == 0 else 4.0)
        depth[:, :10] = 0 if index == 1 else 1.0
        return frame._replace(depth=depth)


def test_it_predicts_the_mean_of_known_depth() -> None:
    dataset = SyntheticDepth(4)
    model = fit_constant_predictor(dataset)
    expected = torch.stack([dataset[i]["depth"] for i in range(4)]).double().mean(0)
    torch.testing.assert_close(model.mean_depth[0].double(), expected, rtol=1e-6, atol=0)
    assert model(torch.rand(3, 3, 8, 8)).shape == (3, 1, 32, 48)
    mean = fit_constant_predictor(Halves(2)).mean_depth
    assert mean[0, 0, 0, 0] == 1.0  # unknown in the second frame
    assert mean[0, 0, 0, 20] == 3.0


def test_it_reads_at_most_the_given_number_of_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    dataset, read = SyntheticDepth(7), []
    load = dataset.load_frame
    monkeypatch.setattr(dataset, "load_frame", lambda index: read.append(index) or load(index))
    fit_constant_predictor(dataset, frames=4)
    assert read == [0, 2, 4, 6]


def score(data: str, folder: Path, *words: str, split: str) -> dict[str, Any]:
    config = compose(TrainSettings, [f"data={data}", *words, "model_name=small", f"output={folder}"])
    return score_small(config, folder, split)


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """A folder whose every third frame is larger than the others."""
    root = layouts.folder(tmp_path / "set", count=10)
    large = layouts.content((60, 80))
    for i in range(1, 10, 3):
        layouts.picture(root / f"images/f{i:03d}.png", large.rgb)
        layouts.picture(root / f"depths/f{i:03d}.png", large.millimeters)
    return root


@pytest.mark.parametrize("input_size", ["[32,40]", "null"])
def test_frames_of_several_sizes_are_scored_but_have_no_mean_depth_map(
    mixed: Path, input_size: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [f"data.root={mixed}", f"data.input_size={input_size}"]
    record = score("folder", tmp_path, *words, split="train")
    several = input_size == "null"
    assert record["metrics"]["images"] == 9
    assert (record["constant_predictor"] is None) == several
    assert ("no constant predictor in the table: the depth of" in words_of(capsys)) == several


def test_intrinsics_need_frames_of_one_size(mixed: Path) -> None:
    options = {"max_depth": 10.0, "intrinsics": [60, 60, 32, 24]}
    data = FolderDataset(mixed, **options)
    assert data[0]["intrinsics"][0, 0] == 60
    with pytest.raises(ValueError, match=r"f001\.png is \(60, 80\), .*f000\.png is \(48, 64\).*intrinsics"):
        data[1]
    # a split that holds only the other size gets the same error
    with pytest.raises(ValueError, match=r"f000\.png is \(48, 64\)"):
        FolderDataset(mixed, split="val", val_names=["f001"], **options)[0]
    skipping = FolderDataset(mixed, on_error="skip", **options)
    skipping.leave_out_unreadable()
    assert len(skipping) == 7
    assert np.isfinite(FolderDataset(mixed, max_depth=10.0)[1]["depth"]).all()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """Splits and scenes whose rendering was asked for; what is written for them is flat."""
    found: Asked = []

    def flat_scene(split: str, scene: int, size: tuple[int, int], views: int) -> Views:
        depth = np.full((views, *size), 2 + scene / 1000, np.float32)
        image, eye = np.zeros((views, *size, 3), np.uint8), np.tile(np.eye(3), (views, 1, 1))
        camera = np.tile(pinhole(20, 20, 9.5, 7.5), (views, 1, 1))
        return Views(image, depth, camera, eye[:, 0], eye)

    def render(
        folder: Path, generator: Any, split: str, scenes: Sequence[int], size: Any, workers: int
    ) -> None:
        found.append((split, list(scenes)))
        scene_store.render_missing(folder, generator, split, scenes, size, workers=0)

    monkeypatch.setattr(render_module, "render_room", flat_scene)
    monkeypatch.setattr(rendered_scenes, "render_missing", render)
    return found


def score_rooms(folder: Path, *words: str, split: str = "test") -> dict[str, Any]:
    size = ("data.size=[16,20]", "data.input_size=[16,20]")
    return score("rooms", folder, f"data.root={folder}", *size, *words, split=split)


@pytest.mark.slow
def test_an_evaluation_renders_few_training_frames(
    tmp_path: Path, asked: Asked, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = "data.frames={train: 576, val: 8, test: 8}"
    few = score_rooms(tmp_path, frames, "data.subset.train=550")
    assert asked == [("test", [0]), ("train", list(range(64)))]
    assert few["constant_predictor"] is not None
    assert "of the first 512 training frames: not all of data.train.frames=576" in words_of(capsys)
    again = score_rooms(tmp_path, frames)
    assert len(asked) == 2
    assert again["train_split_hash"] == few["train_split_hash"]
    Rooms("train", 576, size=(16, 20), root=tmp_path)  # as a training does
    every = score_rooms(tmp_path, frames)
    assert every["train_split_hash"] != few["train_split_hash"]
    assert every["constant_predictor"] != few["constant_predictor"]


def words_of(capsys: pytest.CaptureFixture[str]) -> str:
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_training_frames_that_are_scored_are_all_rendered(tmp_path: Path, asked: Asked) -> None:
    record = score_rooms(tmp_path, "data.frames={train: 640, val: 8, test: 8}", split="train")
    assert asked == [("train", list(range(80)))]
    assert record["metrics"]["images"] == 640

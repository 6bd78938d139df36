"""Frames that render themselves: an evaluation renders few for the constant predictor, and says so."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.scoring import score_small

from eldenet.config import compose
from eldenet.data import rendered, rendering
from eldenet.data.rooms import Rooms
from eldenet.simulation.furnished_rooms import render as render_module
from eldenet.simulation.furnished_rooms.render import Views

Asked = list[tuple[str, Sequence[int]]]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """Splits and scenes whose rendering was asked for; what is written for them is flat."""
    found: Asked = []

    def flat_scene(split: str, scene: int, size: tuple[int, int], views: int) -> Views:
        depth = np.full((views, *size), 2 + scene / 1000, np.float32)
        image, eye = np.zeros((views, *size, 3), np.uint8), np.tile(np.eye(3), (views, 1, 1))
        return Views(image, depth, eye, eye[:, 0], eye)

    def render(
        folder: Path, generator: Any, split: str, scenes: Sequence[int], size: Any, workers: int
    ) -> None:
        found.append((split, list(scenes)))
        rendering.render_missing(folder, generator, split, scenes, size, workers=0)

    monkeypatch.setattr(render_module, "render_room", flat_scene)
    monkeypatch.setattr(rendered, "render_missing", render)
    return found


def score(folder: Path, *words: str, split: str = "test") -> dict[str, Any]:
    words = ("data=rooms", f"data.root={folder}", "data.size=[16,20]", "data.input_size=[16,20]", *words)
    config = compose("train", [*words, "model_name=small", f"run_dir={folder}"])
    return score_small(config, folder, split)


def test_an_evaluation_renders_few_training_frames(
    tmp_path: Path, asked: Asked, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = "data.frames={train: 576, val: 8, test: 8}"
    few = score(tmp_path, frames, "data.subset.train=550")
    assert asked == [("test", [0]), ("train", list(range(64)))]
    assert few["constant_predictor"] is not None
    assert "of the first 512 training frames: not all of data.train.frames=576" in words_of(capsys)
    again = score(tmp_path, frames)
    assert len(asked) == 2
    assert again["train_split_hash"] == few["train_split_hash"]
    Rooms("train", 576, size=(16, 20), root=tmp_path)  # as a training does
    every = score(tmp_path, frames)
    assert every["train_split_hash"] != few["train_split_hash"]
    assert every["constant_predictor"] != few["constant_predictor"]


def words_of(capsys: pytest.CaptureFixture[str]) -> str:
    return " ".join(capsys.readouterr().out.split())


def test_training_frames_that_are_scored_are_all_rendered(tmp_path: Path, asked: Asked) -> None:
    record = score(tmp_path, "data.frames={train: 640, val: 8, test: 8}", split="train")
    assert asked == [("train", list(range(80)))]
    assert record["metrics"]["images"] == 640

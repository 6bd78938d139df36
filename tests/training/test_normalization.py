"""What the images are normalized by: ImageNet's numbers, the data set's own, or given ones."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support import layouts
from support.networks import same_model

from eldenet.compose import compose, plain
from eldenet.configurable import instantiate
from eldenet.data.folder import FolderDataset
from eldenet.data.inspection import channel_statistics
from eldenet.model import IMAGENET_MEAN, DepthNet
from eldenet.results.run_log import RunLog
from eldenet.train import TrainSettings
from eldenet.training.initialization import initial_model
from eldenet.training.normalization import normalization, write_normalization


@pytest.fixture
def frames(tmp_path: Path) -> FolderDataset:
    """Pictures of blocks of 4 x 4 equal pixels, so that every sixteenth says all."""
    layouts.folder(tmp_path / "set", count=6)
    generator = np.random.default_rng(0)
    for i in range(6):
        small = generator.integers(0, (250, 120, 60), (12, 16, 3)).astype(np.uint8)
        layouts.picture(tmp_path / f"set/images/f{i:03d}.png", small.repeat(4, 0).repeat(4, 1))
    return FolderDataset(tmp_path / "set", max_depth=10.0)


def test_the_data_sets_own_are_numpys(frames: FolderDataset) -> None:
    pixels = np.concatenate([frames.load_frame(i).image.reshape(-1, 3) for i in range(6)]) / 255.0
    chosen = normalization("dataset", frames)
    np.testing.assert_allclose(chosen["mean"], pixels.mean(0), atol=1e-5)
    np.testing.assert_allclose(chosen["std"], pixels.std(0), atol=1e-5)


def test_the_same_frames_are_drawn_again(frames: FolderDataset) -> None:
    some = channel_statistics(frames, frames=2).mean
    assert some == channel_statistics(frames, frames=2).mean != channel_statistics(frames).mean


def test_imagenets_are_the_default_and_change_no_network(frames: FolderDataset) -> None:
    config = compose(TrainSettings, [])
    assert plain(config.normalization) == "imagenet"
    assert normalization("imagenet", frames) == {}
    chosen = instantiate(config.model, **normalization("imagenet", frames))
    assert chosen.config == instantiate(config.model).config  # so older checkpoints still fit
    torch.testing.assert_close(instantiate(config.model).mean.flatten(), torch.tensor(IMAGENET_MEAN))


def test_a_resumed_run_keeps_its_numbers(frames: FolderDataset, tmp_path: Path) -> None:
    first = normalization("dataset", frames)
    write_normalization(tmp_path / "run", "dataset", first)
    layouts.picture(tmp_path / "set/images/f001.png", np.full((48, 64, 3), 255, np.uint8))
    assert normalization("dataset", frames) != first
    assert normalization("dataset", frames, resumed=tmp_path / "run") == first
    write_normalization(tmp_path / "other", "imagenet", {})
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ("kitti", "normalization='kitti': give imagenet, dataset"),
        ({"mean": [0.5] * 3}, "give mean and std"),
        ({"mean": [0.5] * 2, "std": [0.2] * 3}, r"mean=\[0.5, 0.5\]: give three numbers"),
        ({"mean": [0.5] * 3, "std": [0.2, 0.2, 0.0]}, "std above 0"),
        ({"mean": [120, 110, 100], "std": [60, 60, 60]}, r"RGB in \[0, 1\]"),
    ],
)
def test_what_cannot_be_is_refused(choice: Any, message: str, frames: FolderDataset) -> None:
    with pytest.raises(ValueError, match=message):
        normalization(choice, frames)


def test_pictures_of_one_color_are_refused(tmp_path: Path) -> None:
    layouts.folder(tmp_path, layouts.SMALL._replace(rgb=np.full((48, 64, 3), 90, np.uint8)), count=2)
    with pytest.raises(ValueError, match="is constant over 2 frames"):
        normalization("dataset", FolderDataset(tmp_path, max_depth=10.0))


def seeded(tmp_path: Path, *words: str, **arguments: Any) -> DepthNet:
    source = tmp_path / "start"
    config = compose(
        TrainSettings,
        ["model=eldenet_s", "model_name=s", f"weights={source}", "model.head.max_depth=10", *words],
    )
    return initial_model(config.model, 0, config.weights, (), arguments, RunLog(tmp_path))


def test_weights_bring_their_normalization(tmp_path: Path, capsys) -> None:
    theirs = {"mean": [0.3, 0.31, 0.32], "std": [0.2, 0.21, 0.22]}
    config = compose(TrainSettings, ["model=eldenet_s", "model.head.max_depth=10"])
    start = instantiate(config.model, **theirs)
    start.save_pretrained(tmp_path / "start")
    model, image = seeded(tmp_path), torch.rand(1, 3, 32, 64, generator=torch.Generator().manual_seed(0))
    assert same_model(model, start)
    assert "images are normalized as in their training, mean [0.3, 0.31, 0.32]" in capsys.readouterr().out
    model.save_pretrained(tmp_path / "saved")
    assert same_model(DepthNet.from_pretrained(tmp_path / "saved"), start)
    mine = {"mean": [0.5] * 3, "std": [0.25] * 3}
    words = [f"+model.{name}={values}" for name, values in mine.items()]
    for overrides, arguments in (([], mine), (words, {})):
        model = seeded(tmp_path, *overrides, **arguments)
        assert model.config["mean"] == mine["mean"]
        assert model.std.flatten().tolist() == mine["std"]
        assert "you chose mean [0.5, 0.5, 0.5], std [0.25, 0.25, 0.25]" in capsys.readouterr().out
        with torch.inference_mode():
            assert not torch.equal(model.eval()(image), start.eval()(image))


def test_weights_of_other_settings_are_named(tmp_path: Path, capsys) -> None:
    """Their tensors fit as well, and mean something else here."""
    start = instantiate(compose(TrainSettings, ["model=eldenet_s", "model.head.max_depth=10"]).model)
    start.save_pretrained(tmp_path / "start")
    assert same_model(seeded(tmp_path), start)
    assert capsys.readouterr().out == f"weights: 226 of 226 tensors copied from {tmp_path / 'start'}\n"
    model = seeded(tmp_path, "model.head.max_depth=80", "model.backbone.shortcuts=false")
    assert model.head.max_depth == 80
    said = capsys.readouterr().out
    assert "head.max_depth=80 (there 10" in said
    assert "backbone.shortcuts=False (there True)" in said


@pytest.mark.slow
def test_a_training_stores_and_resumes_them(frames: FolderDataset, tmp_path: Path, run_command) -> None:
    arguments = ("data=folder", f"data.root={tmp_path / 'set'}", "data.input_size=[32,40]", "model=eldenet_s")
    arguments += (
        "trainer.epochs=2",
        "trainer.batch_size=4",
        "runtime.workers=0",
        "normalization=dataset",
        "output=run",
    )
    finished = run_command("train", *arguments)
    assert finished.returncode == 0, finished.stderr
    run = json.loads((tmp_path / "run/run.json").read_text())
    stored = json.loads((tmp_path / "run/model/config.json").read_text())["model"]
    kept = json.loads((tmp_path / "run/normalization.json").read_text())
    assert run["normalization"] == {name: pytest.approx(kept[name]) for name in ("mean", "std")}
    assert (stored["mean"], stored["std"]) == (kept["mean"], kept["std"])
    assert kept["mean"][0] > kept["mean"][1] > kept["mean"][2]
    layouts.picture(tmp_path / "set/images/f001.png", np.full((48, 64, 3), 255, np.uint8))
    resumed = run_command("train", *arguments, "ckpt_path=auto")
    assert resumed.returncode == 0, resumed.stderr
    assert json.loads((tmp_path / "run/normalization.json").read_text()) == kept
    both = run_command("train", *arguments[:-1], "output=other", "+model.mean=[0.5,0.5,0.5]")
    assert both.returncode == 1
    assert "use one of them" in both.stderr

"""Weights adapt to a camera on held-out evidence alone."""

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

import eldenet
from eldenet.adapt import AdaptSettings, adapt
from eldenet.compose import compose
from eldenet.data.folder import FolderDataset
from eldenet.deploy.predictor import DepthPredictor
from eldenet.evaluation.splits import chosen_protocol
from eldenet.results.before_after import Change, refuse_copies, thumbnail
from eldenet.training.adaptation import (
    affordable_epochs,
    beside_prediction,
    best_candidate,
    make_frames,
    scale_of,
)
from eldenet.uncertainty import DepthEstimate

SIZE = (24, 32)
NOISE = np.random.default_rng(0)
WALL = cv2.resize(NOISE.integers(0, 255, (12, 16, 3), np.uint8), (640, 480), interpolation=cv2.INTER_CUBIC)


def place(
    root: Path,
    count: int = 48,
    *,
    factor: float = 2.5,
    known: int | None = None,
    noise: float = 0.0,
    head: str = "linear",
) -> Path:
    """Write frames whose depth is ``factor`` times the start's own, known at ``known`` pixels or all."""
    model = eldenet.load(start(root / "start", head))
    rng = np.random.default_rng(0)
    for number in range(count):
        image = cv2.resize(rng.integers(0, 255, (4, 5, 3), np.uint8), SIZE[::-1])
        seen = torch.from_numpy(image[..., ::-1].copy()).permute(2, 0, 1)[None].float() / 255
        with torch.inference_mode():
            depth = factor * model(seen)[0, 0].numpy() * np.exp(noise * rng.standard_normal(SIZE))
        if known is not None:
            hidden = np.ones(depth.size, bool)
            hidden[:known] = False
            depth = np.where(hidden.reshape(depth.shape), 0, depth)
        for part, picture in (("images", image), ("depths", np.rint(depth * 1000).astype(np.uint16))):
            (root / part).mkdir(exist_ok=True)
            cv2.imwrite(str(root / part / f"{number:03d}.png"), picture)
    return root


def start(folder: Path, head: str = "linear") -> Path:
    """Save a small network that predicts about 1 m."""
    torch.manual_seed(0)
    depth = "model.head.depth" if head == "uncertain" else "model.head"
    model = eldenet.load("eldenet_s", overrides=[f"model/head={head}", f"{depth}.max_depth=2"])
    model.info = {"input_size": list(SIZE)}
    return model.save_pretrained(folder)


def setup(root: Path, *overrides: str):
    given = [f"data.root={root}", f"weights={root / 'start'}", "runtime.threads=1", "runtime.workers=0"]
    words = [*given, "trainer.epochs=1", "optimizer.lr=1e-6", "minutes=60", *overrides]
    return compose(AdaptSettings, [*words, f"output={root / 'run'}"])


def open_frames(s: AdaptSettings, model):
    protocol = chosen_protocol(s.data, s.protocol)
    return make_frames(s.data, protocol, s.augmentation, model, seed=s.seed)


@pytest.mark.slow
def test_a_camera_of_another_scale_is_learned_and_kept(tmp_path, capsys):
    assert adapt(setup(place(tmp_path)))
    record = json.loads((tmp_path / "run/run.json").read_text())
    assert record["kept"]
    assert record["scale"] == pytest.approx(2.5, rel=0.05)
    assert record["held_out"]["abs_rel"]["high"] < 0
    same = "run/training" if record["tuned"] == "all weights" else "start"
    kept, tuned = (eldenet.load(tmp_path / name) for name in ("run", same))
    assert all(torch.equal(kept.state_dict()[name], value) for name, value in tuned.state_dict().items())
    assert kept.head.max_depth == pytest.approx(2 * 2.5, rel=0.05)
    for name in ("before_after.png", "held_out.csv", "model/config.json"):
        assert (tmp_path / "run" / name).is_file()
    said = capsys.readouterr().out
    assert "kept" in said
    assert f"predict checkpoint={tmp_path / 'run'}" in said


@pytest.mark.slow
def test_sigma_follows_the_errors_of_the_held_out_frames(tmp_path):
    made = setup(place(tmp_path, noise=0.2, head="uncertain"))
    assert adapt(made)
    model = eldenet.load(tmp_path / "run")
    assert model.info["temperature_from"] == "held-out frames"
    inside = []
    for sample in open_frames(made, model)[3]:
        with torch.inference_mode():
            depth, sigma, _ = model.predict(sample["image"][None])
        low, high = DepthEstimate(depth, sigma, model.distribution).interval(0.8)
        inside.append(((low < sample["depth"]) & (sample["depth"] < high)).float().mean())
    assert np.mean(inside) == pytest.approx(0.8, abs=0.05)


@pytest.mark.slow
def test_weights_that_are_right_already_stay_as_they_were(tmp_path, capsys):
    place(tmp_path, factor=1.0)
    assert not adapt(setup(tmp_path))
    assert "not kept" in capsys.readouterr().out
    kept, old = (eldenet.load(tmp_path / name).state_dict() for name in ("run", "start"))
    assert all(torch.equal(kept[name], old[name]) for name in old)


@pytest.mark.slow
@pytest.mark.parametrize("tuned", ["all weights", "the scale alone"])
def test_frames_of_another_shape_are_compared_as_predict_sees_them(tmp_path, monkeypatch, tuned):
    monkeypatch.setattr("eldenet.training.adaptation.best_candidate", lambda _: tuned)
    rng, before = (
        np.random.default_rng(0),
        DepthPredictor(eldenet.load(start(tmp_path / "start")), steady=False),
    )
    for part in ("images", "depths"):
        (tmp_path / part).mkdir()
    for number in range(48):
        image = cv2.resize(rng.integers(0, 255, (4, 9, 3), np.uint8), (72, 30))
        depth = 2.5 * before(np.ascontiguousarray(image[..., ::-1]))
        cv2.imwrite(str(tmp_path / f"images/{number:03d}.png"), image)
        cv2.imwrite(str(tmp_path / f"depths/{number:03d}.png"), np.rint(depth * 1000).astype(np.uint16))
    assert adapt(setup(tmp_path, "optimizer.lr=1e-2"))
    after, rows = DepthPredictor(eldenet.load(tmp_path / "run"), steady=False), []
    with (tmp_path / "run/held_out.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        image = cv2.imread(str(tmp_path / f"images/{row['name']}.png"))[..., ::-1]
        truth = cv2.imread(str(tmp_path / f"depths/{row['name']}.png"), cv2.IMREAD_UNCHANGED) / 1000
        for when, predictor in (("before", before), ("after", after)):
            error = np.abs(predictor(np.ascontiguousarray(image)) / truth - 1).mean()
            assert float(row[f"abs_rel_{when}"]) == pytest.approx(error, rel=1e-3)


@pytest.mark.parametrize(("count", "known"), [(20, None), (48, 10), (160, 10)])
def test_few_frames_and_few_points_are_refused_with_the_reason(tmp_path, count, known):
    place(tmp_path, count, known=known)
    with pytest.raises(
        ValueError, match=r"few known distances do not calibrate .* differs from image to image"
    ):
        adapt(setup(tmp_path))
    assert not (tmp_path / "run/model").exists()


@pytest.mark.parametrize("factor", [10.0, 0.3])
def test_depth_in_another_unit_is_refused(tmp_path, factor):
    place(tmp_path, factor=factor)
    with pytest.raises(ValueError, match=r"multiplied by .* no factor above 3 .*: check data.encoding"):
        adapt(setup(tmp_path))
    assert not (tmp_path / "run/model").exists()


def test_no_frame_is_both_learned_and_held_out(tmp_path):
    made = setup(place(tmp_path))
    _, train, _, held = open_frames(made, eldenet.load(tmp_path / "start"))
    numbers = sorted(int(name) for name in held.names)
    assert numbers
    assert {int(name) + step for name in train.names for step in (-1, 0, 1)}.isdisjoint(numbers)


def test_the_scale_alone_is_kept_where_the_training_is_not_surely_better():
    def change(after: float, high: float) -> dict[str, Change]:
        return {"abs_rel": Change("abs_rel", 0.3, after, after - 0.4, high, 20)}

    both = {"all": change(0.2, -0.01), "scale": change(0.25, -0.01)}
    assert best_candidate(both) == "all"
    assert best_candidate(both | {"all": change(0.2, 0.01)}) == "scale"
    assert best_candidate(both | {"scale": change(0.1, -0.01)}) == "scale"


def test_the_time_limits_the_training(tmp_path):
    made = setup(place(tmp_path), "trainer.epochs=40")
    model = eldenet.load(tmp_path / "start")
    frames = open_frames(made, model)[1]
    whole = len(frames)
    assert affordable_epochs(model, frames, seconds=1e6, most=40, seed=0) == 40
    assert len(frames) == whole
    assert affordable_epochs(model, frames, seconds=1e-3, most=40, seed=0) == 1
    assert len(frames) < whole
    assert (
        affordable_epochs(model, frames, seconds=-1, most=40, seed=0) == 1
    )  # reading them took all the time
    assert len(frames) >= 2


def test_a_rescaled_network_keeps_its_factor_when_saved(tmp_path):
    model = eldenet.load(start(tmp_path / "start"))
    image = torch.rand(2, 3, *SIZE)
    with torch.inference_mode():
        expected = 1.7 * model(image)
        model.rescale(1.7)
        model.save_pretrained(tmp_path / "new")
        torch.testing.assert_close(eldenet.load(tmp_path / "new")(image), expected)


def test_the_scale_is_the_median_over_frames(tmp_path):
    frames = FolderDataset(place(tmp_path, 9, factor=0.5), max_depth=10.0)
    model = eldenet.load(tmp_path / "start")
    assert scale_of(beside_prediction(model, [frames[i] for i in range(9)])) == pytest.approx(0.5, rel=0.01)


def rewrite(root: Path, part: str, change) -> None:
    """Write all depth maps (or pictures) of a place anew."""
    for number, path in enumerate(sorted((root / part).iterdir())):
        cv2.imwrite(str(path), change(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), number))


def one_scene(picture: np.ndarray, number: int) -> np.ndarray:
    return np.full_like(picture, 90) + np.uint8(number % 2)  # but for noise


def flat(depth: np.ndarray, number: int) -> np.ndarray:
    return np.full_like(depth, 2000 + 10 * number)


def inverse(depth: np.ndarray, number: int) -> np.ndarray:
    return (4e6 / depth).astype(np.uint16)


def of_tum(depth: np.ndarray, number: int) -> np.ndarray:
    return 5 * depth


@pytest.mark.parametrize(
    ("part", "change", "said"),
    [
        ("images", one_scene, "are copies"),
        ("depths", flat, "same everywhere in .* frames"),
        ("depths", inverse, "inverse depth or disparity"),
        ("depths", of_tum, r"multiplied by .*check data\.encoding.*; if all are right"),
    ],
)
def test_frames_that_prove_nothing_are_refused(tmp_path, part, change, said):
    rewrite(place(tmp_path, factor=1.6), part, change)
    with pytest.raises(ValueError, match=said):
        adapt(setup(tmp_path))
    assert not (tmp_path / "run/model").exists()


@pytest.mark.slow
def test_a_large_factor_is_kept_where_it_is_forced(tmp_path):
    assert adapt(setup(place(tmp_path, factor=4.0), "force=true"))
    assert json.loads((tmp_path / "run/run.json").read_text())["scale"] == pytest.approx(4, rel=0.05)


def test_frames_of_a_moving_camera_are_no_copies():
    pictures = [np.roll(WALL, 2 * number, axis=1) for number in range(12)]
    refuse_copies(
        list(map(thumbnail, pictures[::3])), [thumbnail(p) for i, p in enumerate(pictures) if i % 3]
    )
    still = [np.clip(WALL + NOISE.normal(0, 4, WALL.shape), 0, 255).astype(np.uint8) for _ in range(4)]
    with pytest.raises(ValueError, match="1 of 1 held-out frames are copies"):
        refuse_copies([thumbnail(still[0])], list(map(thumbnail, still[1:])))

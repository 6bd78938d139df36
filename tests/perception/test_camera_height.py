"""The camera's height above a visible floor gives weights their scale, or is refused."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from torch import nn

import eldenet
from eldenet.adapt import AdaptSettings, adapt
from eldenet.compose import compose
from eldenet.geometry import pinhole
from eldenet.perception.camera_height import (
    hold_out_floors,
    level_camera,
    log_scale,
    refuse_few,
    scale_of_all,
)

SIZE, CAMERA = (48, 64), (50.0, 50.0, 31.5, 23.5)


def floor(height: float, pitch: float) -> np.ndarray:
    """Depth ``(H, W)`` [m] of a floor before a wall at 5 m, to a camera that looks ``pitch`` [rad] down."""
    camera = level_camera(CAMERA, pitch)
    rows, columns = np.indices(SIZE).astype(float)
    rays = np.stack([columns, rows, np.ones(SIZE)], -1) @ camera.homography.T
    down = np.where(rays[..., 1] > 1e-6, height / np.maximum(rays[..., 1], 1e-6), np.inf)
    return np.minimum(down, 5.0 / np.maximum(rays[..., 2], 1e-6))


@pytest.mark.parametrize("pitch", [0.0, 0.2, 0.5])
def test_the_floor_gives_the_scale_with_and_without_a_known_pitch(pitch):
    wrong = floor(0.8, pitch) / 1.5
    for known in (True, False):
        camera = level_camera(CAMERA, pitch if known else None)
        assert np.exp(log_scale(wrong, camera, 0.8, known_pitch=known)) == pytest.approx(1.5, rel=0.03)


def test_a_wall_gives_no_scale():
    assert np.isnan(log_scale(np.full(SIZE, 2.0), level_camera(CAMERA, None), 0.8, known_pitch=False))


def test_a_table_is_not_taken_for_the_floor():
    depth = floor(0.8, 0.3)
    depth[:, 12:52] = floor(0.4, 0.3)[:, 12:52]
    assert np.isnan(log_scale(depth, level_camera(CAMERA, 0.3), 0.8, known_pitch=True))


def test_few_floors_are_refused():
    refuse_few(np.r_[np.zeros(40), np.full(60, np.nan)])
    with pytest.raises(ValueError, match=r"12 of 100 frames show a floor"):
        refuse_few(np.r_[np.zeros(12), np.full(88, np.nan)])


@pytest.mark.parametrize(("seen_by", "name"), [(1, "held-out"), (0, "other")])
def test_a_part_without_a_floor_is_refused(seen_by, name):
    parts = hold_out_floors(np.zeros(100), 0)
    values = np.full(100, np.nan)
    values[parts[seen_by]] = 0.1
    with pytest.raises(ValueError, match=rf"none of the \d+ {name} frames shows a floor: .*another seed="):
        hold_out_floors(values, 0)


@pytest.mark.parametrize("known", [True, False])
def test_all_depth_follows_the_floor_in_part(known):
    assert scale_of_all(0.2, known_pitch=known) == 1.0  # may be the floor's own error
    for floors in (-0.9, 0.5):
        assert 0 < np.log(scale_of_all(floors, known_pitch=known)) / floors < 1


class Floor(nn.Module):
    """A network that sees one scene at 1 / 1.5 of its size, farther away where it is bright."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        depth = torch.from_numpy(floor(0.8, 0.2) / 1.5).float()
        return depth * (1 + 0.4 * image.mean((1, 2, 3), keepdim=True) - 0.2)


@pytest.fixture
def walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Pictures, and weights that are wrong by 1.5."""
    from eldenet.heads import ScaledHead
    from eldenet.model import DepthNet

    rng = np.random.default_rng(0)
    (tmp_path / "walk").mkdir()
    for number in range(40):
        gray = np.full((*SIZE, 3), rng.integers(256), np.uint8)
        cv2.imwrite(str(tmp_path / f"walk/{number:02d}.png"), gray)
    model = DepthNet(Floor(), ScaledHead(1.0, 0.01, 100.0), mean=(0, 0, 0), std=(1, 1, 1)).eval()
    model.info = {"input_size": list(SIZE)}
    monkeypatch.setattr(eldenet, "load", lambda *_, **__: model)
    monkeypatch.setattr(
        DepthNet, "save_pretrained", lambda self, folder, info=None: saved.append((self, info))
    )
    return tmp_path


saved: list[tuple[nn.Module, dict]] = []


def test_the_scale_is_stored_with_the_weights_and_held_out_frames_decide(walk, capsys):
    for height, kept in ((0.8, True), (0.8 / 1.5, False)):
        given = [f"source={walk / 'walk'}", f"intrinsics={list(CAMERA)}", f"camera_height={height}"]
        given += ["camera_pitch=11.459", "runtime.threads=1"]
        assert adapt(compose(AdaptSettings, [*given, f"output={walk / 'run'}"])) is kept
        model, info = saved.pop()
        assert model.head.scale == pytest.approx(
            scale_of_all(np.log(1.5), known_pitch=True) if kept else 1.0, rel=0.1
        )
        assert bool(info) is kept
        assert json.loads((walk / "run/run.json").read_text())["kept"] is kept
    said = capsys.readouterr().out
    assert "not kept" in said
    assert "error of scale" in said
    assert (walk / "run/before_after.png").is_file()


@pytest.mark.parametrize("height", [3.0, 0.1])
def test_a_factor_that_no_camera_needs_is_refused(walk, height):
    given = [f"source={walk / 'walk'}", f"intrinsics={list(CAMERA)}", f"camera_height={height}"]
    given += ["camera_pitch=11.459", "runtime.threads=1"]
    with pytest.raises(ValueError, match=r"multiplied by .* no factor above 3 .*: check camera_height \[m\]"):
        adapt(compose(AdaptSettings, [*given, f"output={walk / 'run'}"]))
    assert not saved


@pytest.mark.parametrize(
    ("overrides", "match"),
    [
        (["camera_height=80"], "in meters, .*0.05 to 5; 80 looks like centimeters: give 0.8$"),
        (["camera_height=0.8", "camera_pitch=95"], "camera_pitch=95"),
        (["camera_height=0.8", "camera_pitch=0.09"], "camera_pitch=0.09 looks like radians: .*, 5.16, or 0"),
        (["camera_height=0.8", "intrinsics=null"], "give intrinsics="),
        (["camera_height=0.8", "intrinsics=[50,0,32,24]"], r"intrinsics=.*: give .*fx and fy above 0"),
        (["camera_height=0.8", "source=null"], "give source="),
        (["camera_height=0.8", "source=camera:0"], "not a camera"),
        (["camera_height=0.8", "weights=eldenet"], "without trained weights"),
    ],
)
def test_wrong_settings_end_in_one_line(tmp_path, overrides, match):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((*SIZE, 3), np.uint8))
    given = [f"source={tmp_path}", f"intrinsics={list(CAMERA)}", *overrides]
    with pytest.raises(ValueError, match=match):
        adapt(compose(AdaptSettings, [*given, f"output={tmp_path / 'run'}"]))


def test_a_principal_point_outside_the_pictures_is_refused(walk):
    given = [f"source={walk / 'walk'}", "intrinsics=[50,50,500,20]", "camera_height=0.8"]
    with pytest.raises(ValueError, match="principal point"):
        adapt(compose(AdaptSettings, [*given, f"output={walk / 'run'}"]))


def test_the_level_camera_looks_down_by_its_pitch():
    ahead = level_camera(CAMERA, 0.3).homography @ pinhole(*CAMERA) @ np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(ahead, [0, np.sin(0.3), np.cos(0.3)], atol=1e-9)

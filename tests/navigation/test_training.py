"""Trainings of drivers: they resume, and their record keeps the version that trained them."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldenet.navigation import training
from eldenet.navigation.dqn import CHECKPOINT, DQN, DQNSettings
from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import POLICY
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import TrainingArenas
from eldenet.results.run_log import RunLog
from eldenet.simulation.arenas import generate_arena
from eldenet.system.files import write_json

pytest.importorskip("gymnasium")
from eldenet.navigation.env import ArenaNavVectorEnv


class Stopped(Exception):
    """Like a kill."""


def train(
    folder: Path,
    *,
    version: int = 1,
    stop_after: int | None = None,
    seed: int = 0,
    validate: int = 0,
    **environment: Any,
) -> dict:
    """600 steps with two checkpoints; ``stop_after`` ends the training after that many."""

    class Stopping(DQN):
        def save(self, path: Path) -> None:
            super().save(path)
            if self.num_timesteps // 300 == stop_after:
                raise Stopped

    settings = DQNSettings(
        total_timesteps=600, checkpoint_interval=300, learning_starts=100, batch_size=16,
        buffer_size=1000, hidden=(16,), seed=seed,
    )  # fmt: skip
    environment = {"arenas": TrainingArenas((0, 5))} | environment
    learner = Stopping(ArenaNavVectorEnv(4, **environment), settings)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "TRAINING_VERSION", version)
        log = RunLog(folder, quiet=True)
        return training.train(learner, Ranges(), folder, log, validate=validate, config={"seed": seed})


def record(folder: Path) -> dict:
    return json.loads((folder / training.RECORD).read_text())


def test_a_finished_training_is_left_unchanged(tmp_path):
    train(tmp_path)
    files = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert record(tmp_path)["version"] == 1
    assert record(tmp_path)["config"] == {"seed": 0}
    assert train(tmp_path, version=2)["version"] == 1
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == files
    with pytest.raises(ValueError, match="other settings"):
        train(tmp_path, seed=1)


def test_a_stopped_training_continues_only_with_the_version_that_started_it(tmp_path):
    with pytest.raises(Stopped):
        train(tmp_path, stop_after=1)
    checkpoint = (tmp_path / CHECKPOINT).read_bytes()
    with pytest.raises(
        ValueError, match="version 1 started and that stopped at step 300 of 600; this is version 2"
    ):
        train(tmp_path, version=2)
    assert (tmp_path / CHECKPOINT).read_bytes() == checkpoint
    assert not (tmp_path / POLICY).exists()
    assert [leg["steps"] for leg in train(tmp_path)["legs"]] == [300, 600]
    assert record(tmp_path)["version"] == 1
    assert Navigator.load(tmp_path).info == {"steps": 600, "seed": 0}


def test_a_training_that_lacks_only_its_record_keeps_its_version(tmp_path):
    with pytest.raises(Stopped):
        train(tmp_path, stop_after=2)
    assert not (tmp_path / training.RECORD).exists()
    train(tmp_path, version=2)
    assert record(tmp_path)["version"] == 1


def test_settings_that_are_gone_count_only_where_they_changed_something(tmp_path):
    train(tmp_path)
    file = tmp_path / training.PROGRESS
    note = json.loads(file.read_text())
    write_json(file, note | {"settings": note["settings"] | {"quantiles": 0}})
    assert train(tmp_path)["version"] == 1
    write_json(file, note | {"settings": note["settings"] | {"quantiles": 16}})
    with pytest.raises(ValueError, match="other settings"):
        train(tmp_path)


@pytest.mark.slow
def test_a_driver_is_validated_in_what_it_trains_for(tmp_path, monkeypatch):
    """A driver for rooms with pedestrians was validated in open arenas without."""
    seen = []
    run = training.run_episodes

    def spy(arenas, make_policy, sensor, settings):
        seen.append((arenas, settings))
        return run(arenas, make_policy, sensor, settings)

    monkeypatch.setattr(training, "run_episodes", spy)
    tasks = TrainingArenas((0, 5), kind="rooms", pedestrians=3)
    train(tmp_path / "rooms", validate=2, arenas=tasks, time_limit=4.0, goal="fixes")
    arenas, settings = seen.pop()
    assert [arena.name for arena in arenas] == ["val-rooms-5+3-0", "val-rooms-5+3-1"]
    assert (settings.time_limit, settings.goal, settings.physics) == (4.0, "fixes", "kinematic")
    train(tmp_path / "open", validate=1, arenas=TrainingArenas((0, 120)))
    arenas, settings = seen.pop()
    assert (arenas[0].name, settings) == ("val-80-0", EpisodeSettings())


def test_a_trap_keeps_its_own_start_and_goal():
    tasks, rng = TrainingArenas((0, 5), kind="traps", repeats=4), np.random.default_rng(0)
    drawn = [tasks.draw(rng) for _ in range(8)]
    assert drawn[0] is drawn[3]
    assert drawn[0] != drawn[4]
    for arena in drawn:
        assert math.dist(arena.start[:2], arena.waypoints[-1]) >= 10


@pytest.mark.parametrize("distance", [-1.0, 27.0, math.nan])
def test_start_and_goal_that_cannot_be_so_far_apart_are_refused(distance):
    with pytest.raises(ValueError, match=f"min_distance={distance}: give 0 to 20"):
        generate_arena("train", 10, 0, min_distance=distance)

"""Navigation: a training's record stays that of the sources that trained it."""

import json
from pathlib import Path

import pytest

from eldenet.navigation import training
from eldenet.navigation.dqn import CHECKPOINT, DQN
from eldenet.navigation.policy import POLICY, Navigator
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import TrainingArenas
from eldenet.results.run_log import RunLog

pytest.importorskip("gymnasium")
from eldenet.navigation.env import ArenaNavVectorEnv


class Stopped(Exception):
    """Like a kill."""


def train(folder: Path, *, stop_after: int | None = None, seed: int = 0) -> dict:
    """600 steps in two legs; ``stop_after`` ends it after that many checkpoints."""

    class Stopping(DQN):
        def save(self, path: Path) -> None:
            super().save(path)
            if self.done // self.leg == stop_after:
                raise Stopped

    def make_learner() -> DQN:
        env = ArenaNavVectorEnv(4, arenas=TrainingArenas((0, 5)))
        return Stopping(
            env, steps=600, leg=300, warmup=100, batch_size=16, replay=1000, hidden=(16,), seed=seed
        )

    log = RunLog(folder, quiet=True)
    settings = {"seed": seed}
    return training.train(make_learner, Ranges(), folder, log, validate=0, settings=settings, config=settings)


@pytest.fixture
def change_version(monkeypatch):
    return lambda version: monkeypatch.setattr(training, "TRAINING_VERSION", version)


def record(folder: Path) -> dict:
    return json.loads((folder / training.RECORD).read_text())


def test_a_finished_training_is_left_as_it_is(tmp_path, change_version):
    change_version(1)
    train(tmp_path)
    files = {path: path.read_bytes() for path in tmp_path.iterdir()}
    assert record(tmp_path)["version"] == 1
    assert record(tmp_path)["config"] == {"seed": 0}
    change_version(2)
    assert train(tmp_path)["version"] == 1
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == files
    with pytest.raises(ValueError, match="other settings"):
        train(tmp_path, seed=1)


def test_one_that_was_stopped_goes_on_with_the_version_that_began_it(tmp_path, change_version):
    change_version(1)
    with pytest.raises(Stopped):
        train(tmp_path, stop_after=1)
    checkpoint = (tmp_path / CHECKPOINT).read_bytes()
    change_version(2)
    with pytest.raises(
        ValueError, match="version 1 began and that stopped at step 300 of 600; this is version 2"
    ):
        train(tmp_path)
    assert (tmp_path / CHECKPOINT).read_bytes() == checkpoint
    assert not (tmp_path / POLICY).exists()
    change_version(1)
    assert [leg["steps"] for leg in train(tmp_path)["legs"]] == [300, 600]
    assert record(tmp_path)["version"] == 1
    assert Navigator.load(tmp_path).info == {"steps": 600, "seed": 0}


def test_one_that_was_stopped_before_its_record_keeps_its_version(tmp_path, change_version):
    change_version(1)
    with pytest.raises(Stopped):
        train(tmp_path, stop_after=2)
    assert not (tmp_path / training.RECORD).exists()
    change_version(2)
    train(tmp_path)
    assert record(tmp_path)["version"] == 1


def test_a_training_without_a_noted_version_is_not_continued(tmp_path, change_version):
    change_version(1)
    with pytest.raises(Stopped):
        train(tmp_path, stop_after=1)
    progress = tmp_path / training.PROGRESS
    note = json.loads(progress.read_text())
    del note["version"]
    progress.write_text(json.dumps(note))
    with pytest.raises(ValueError, match="version None began"):
        train(tmp_path)

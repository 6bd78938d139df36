"""Modes of ``python -m eldenet.navigate``: their settings, errors, results and records."""

import hashlib
import json

import numpy as np
import pytest

from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.navigate import NavigateSettings, refuse_to_replace
from eldenet.navigation.noisy_ranges import PACKAGED_ERRORS
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import DEFAULT_WEIGHTS
from eldenet.navigation.provenance import driver_identity, sensor_identity
from eldenet.weights import PACKAGED

DRIVES = ("record", "evaluate")
MODES = (*DRIVES, "train")


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def read_run(folder) -> dict:
    return json.loads((folder / "run.json").read_text())


@pytest.mark.parametrize(
    ("modes", "setting"),
    [
        (DRIVES, "density=20"),
        (DRIVES, "checkpoint=runs/driver"),
        (DRIVES, "policy.walkers=true"),
        ((*DRIVES, "train"), "policy=paper_literal"),
        (("evaluate",), "episodes=20"),
        (("evaluate",), "robots=4"),
        (("record",), "video=mp4"),
        (("train",), "learner.total_timesteps=100"),
        (MODES, "sensor=noisy"),
    ],
)
def test_each_mode_accepts_its_own_settings_only(modes, setting):
    for mode in MODES:
        if mode in modes:
            compose(NavigateSettings, [f"mode={mode}", setting])
        else:
            with pytest.raises(ValueError, match="Could not override"):
                compose(NavigateSettings, [f"mode={mode}", setting])


def test_planners_have_no_checkpoint_and_paper_policies_set_their_observer():
    for mode in DRIVES:
        with pytest.raises(ValueError, match="Could not override 'checkpoint'"):
            compose(NavigateSettings, [f"mode={mode}", "policy=dwa", "checkpoint=runs/driver"])
        paper = compose(
            NavigateSettings, [f"mode={mode}", "policy=paper_literal", "observer.memory=6", "checkpoint=a"]
        )
        observer = paper.policy["observer"]
        assert (paper.policy["path"], observer["memory"], observer["bins"]) == ("a", 6, 0)


@pytest.mark.parametrize(("arguments", "message"), [
    (["mode=fly"], "error: mode=fly: choose from evaluate, record, train\n"),
    (["density=[5,20]"], "records one arena"),
    (["video=avi"], "video='avi': give one of gif, webp, mp4"),
    (["mode=evaluate", "episodes=0"], "episodes=0: give a whole number, 1 or more"),
    (["goal=gps", "density=5", "physics=kinematic"], "give one of known, fixes, odometry"),
    (["checkpoint=none.safetensors"], "no policy at none.safetensors"),
    (["sensor=noisy", "sensor.scale=0.2"], "memory=0.8: measured errors replace these"),
    (["arena.file=mine.yaml", "density=80", "arena.kind=rooms"],
     "density, arena.kind: not read with arena.file=mine.yaml, which describes the whole arena; leave"),
    (["mode=evaluate", "arena.file=mine.yaml"], "one arena is for mode=record; give barn_worlds.npz"),
    (["course=triangle", "world=3", "split=val", "pedestrians=2"],
     "world, split, pedestrians: not read with course=triangle"),
    (["mode=train", "policy=dwa"], "mode=train trains a new driver"),
])  # fmt: skip
def test_a_mistake_is_one_clear_line(run_command, arguments, message):
    finished = run_command("navigate", *arguments)
    assert finished.returncode == 1
    assert message in finished.stderr
    assert finished.stderr.count("\n") == 1


@pytest.mark.parametrize("record", [{"mode": "evaluate"}, {"driver": None}, {"model": "eldenet"}])
def test_no_mode_replaces_the_record_of_another(tmp_path, record):
    refuse_to_replace(tmp_path, "record")
    (tmp_path / "run.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"holds results of (evaluate|another command): give another"):
        refuse_to_replace(tmp_path, "record")


# --- what the modes write


@pytest.mark.slow
def test_record_makes_a_video_without_a_display(run_command, tmp_path):
    from PIL import Image

    finished = run_command(
        "navigate", "density=5", "time_limit=2", "video=gif", "physics=kinematic", "output=run", DISPLAY=""
    )
    assert finished.returncode == 0, finished.stderr
    (video,) = (tmp_path / "run").glob("*.gif")
    with Image.open(video) as picture:
        assert picture.n_frames >= 10
        assert picture.size[1] == 500
        assert picture.info["duration"] == 200  # [ms], the period of control: true speed
    run = read_run(tmp_path / "run")
    assert (run["mode"], run["video"], run["config"]["time_limit"]) == ("record", video.name, 2)
    assert run["outcome"] in ("goal", "collision", "timeout")
    assert run["policy"] == "dqn"
    assert "video=gif" in run["command"]
    assert run["versions"]["torch"]


def test_evaluate_writes_rows_and_a_record_of_driver_and_sensor(run_command, tmp_path):
    Navigator.load().save(tmp_path / "a" / "policy.safetensors")
    finished = run_command(
        "navigate", "mode=evaluate", "checkpoint=[a,a/policy.safetensors]", "policy.slows_within=2",
        "density=[5,20]", "episodes=2", "physics=kinematic", "sensor=noisy", "output=run",
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    assert "success [%]" in finished.stdout
    assert (tmp_path / "run" / "episodes_20.csv").read_text().count("\n") == 3
    run = read_run(tmp_path / "run")
    assert run["mode"] == "evaluate"
    assert run["metrics"]["5"]["worlds"] == 2
    assert set(run["arenas"]) == {"5", "20"}
    content = (tmp_path / "a" / "policy.safetensors").read_bytes()
    assert run["driver"]["files"] == [{"file": "a/policy.safetensors", "sha256": sha256(content)}] * 2
    assert run["driver"]["info"] == {"members": [Navigator.load().info] * 2}
    assert run["driver"]["observer"]["slows_within"] == 2.0
    errors = sha256(PACKAGED_ERRORS.read_bytes())
    assert run["inputs"] == {"errors": {"source": "packaged", "sha256": errors}}


def test_evaluate_says_how_many_worlds_of_a_file_were_driven(run_command, tmp_path):
    np.savez(
        tmp_path / "worlds.npz",
        centers=np.array([[-2.0, 8.0], [-1.0, 9.0]], np.float32),
        radius=np.float32(0.075),
        world_start=np.array([0, 1, 2]),
        path=np.array([[17, 0], [17, 20]] * 2),
        path_start=np.array([0, 2, 4]),
    )
    said = run_command(
        "navigate", "mode=evaluate", "arena.file=worlds.npz", "policy=straight", "physics=kinematic"
    ).stdout
    assert "2 arenas of worlds.npz" in said
    assert "test arenas" not in said


@pytest.mark.slow
def test_train_resumes_and_writes_a_policy(run_command, tmp_path):
    small = (
        "mode=train", "learner.total_timesteps=600", "learner.checkpoint_interval=300",
        "learner.learning_starts=100", "learner.batch_size=16", "training.robots=4", "training.validate=2",
        "training.arenas.densities=[0,5]", "output=run",
    )  # fmt: skip
    finished = run_command("navigate", *small)
    assert finished.returncode == 0, finished.stderr
    assert Navigator.load(tmp_path / "run").info == {"steps": 600, "seed": 0}
    note = json.loads((tmp_path / "run" / "training.json").read_text())
    assert [leg["steps"] for leg in note["legs"]] == [300, 600]
    assert "already finished" in run_command("navigate", *small).stdout
    finished = run_command("navigate", *small, "seed=1")
    assert finished.returncode == 1
    assert "other settings" in finished.stderr


def test_drivers_and_sensors_are_identified_by_content(tmp_path):
    identity = driver_identity(Navigator.load())
    assert identity is not None
    weights = sha256(DEFAULT_WEIGHTS.read_bytes())
    assert identity["files"] == [{"file": str(DEFAULT_WEIGHTS), "sha256": weights}]
    sensor = instantiate(compose(NavigateSettings, ["sensor=objects"]).sensor)
    depth = sha256((PACKAGED / "eldenet_arenas" / "model.safetensors").read_bytes())
    assert sensor_identity(sensor) == {"depth": {"source": "eldenet_arenas", "sha256": depth}}
    (tmp_path / "detector.onnx").write_bytes(b"finds")
    sensor.sources = {"detector": ("x.onnx", tmp_path / "detector.onnx"), "depth": ("owner/model",) * 2}
    assert sensor_identity(sensor) == {
        "detector": {"source": "x.onnx", "sha256": sha256(b"finds")},
        "depth": {"source": "owner/model", "sha256": None},  # of a Hub
    }

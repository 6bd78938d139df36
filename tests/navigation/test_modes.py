"""Modes of ``python -m eldenet.navigate``: their settings, errors, results and records."""

import csv
import hashlib
import json
import math

import pytest

from eldenet.config import compose, instantiate
from eldenet.navigate import MODES
from eldenet.navigation.modes import refuse_to_replace
from eldenet.navigation.noisy_ranges import PACKAGED_ERRORS, NoisyRanges
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import DEFAULT_WEIGHTS
from eldenet.navigation.provenance import driver_identity, sensor_identity
from eldenet.navigation.range_errors import RangeErrors, check_edges
from eldenet.renames import renamed
from eldenet.weights import PACKAGED

EVALUATES = ("evaluate", "analyze_failures")
DRIVES = ("record", *EVALUATES)


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def read_run(folder) -> dict:
    return json.loads((folder / "run.json").read_text())


@pytest.mark.parametrize(
    ("modes", "setting"),
    [
        ((*DRIVES, "fit_noise"), "density=20"),
        (DRIVES, "checkpoint=runs/driver"),
        (DRIVES, "policy.walkers=true"),
        ((*DRIVES, "train"), "policy=paper_literal"),
        ((*EVALUATES, "fit_noise"), "episodes=20"),
        (EVALUATES, "robots=4"),
        (("record",), "video=mp4"),
        (("fit_noise",), "fit_noise.places=near"),
        (("train",), "learner.total_timesteps=100"),
        (MODES, "sensor=noisy"),
    ],
)
def test_each_mode_accepts_its_own_settings_only(modes, setting):
    for mode in MODES:
        if mode in modes:
            compose("navigate", [f"mode={mode}", setting])
        else:
            with pytest.raises(ValueError, match="Could not override"):
                compose("navigate", [f"mode={mode}", setting])


def test_planners_have_no_checkpoint_and_paper_policies_set_their_observer():
    for mode in DRIVES:
        with pytest.raises(ValueError, match="Could not override 'checkpoint'"):
            compose("navigate", [f"mode={mode}", "policy=dwa", "checkpoint=runs/driver"])
        paper = compose(
            "navigate", [f"mode={mode}", "policy=paper_literal", "observer.memory=6", "checkpoint=a"]
        )
        assert (paper.policy.path, paper.policy.observer.memory, paper.policy.observer.bins) == ("a", 6, 0)


def test_settings_of_earlier_versions_are_renamed():
    before = {
        "mode": "watch", "film": "gif", "worlds": 3, "movers": 2,
        "measure": {"places": "crossings", "looks": 8},
        "learner": {"_target_": "eldenet.navigation.dqn.DQN", "steps": 5, "warmup": 1, "target_every": 2},
    }  # fmt: skip
    assert renamed(before) == {
        "mode": "record", "video": "gif", "episodes": 3, "pedestrians": 2,
        "fit_noise": {"places": "episodes", "scans": 8},
        "learner": {"_target_": "eldenet.navigation.dqn.DQNSettings", "total_timesteps": 5,
                    "learning_starts": 1, "target_update_interval": 2},
    }  # fmt: skip


@pytest.mark.parametrize(("arguments", "message"), [
    (["mode=fly"], "error: mode=fly: choose one of record, evaluate, analyze_failures, fit_noise, train\n"),
    (["mode=watch"], "train; watch is now record"),
    (["density=500"], "density=500"),
    (["density=[5,20]"], "records one arena"),
    (["video=avi"], "video='avi': give one of gif, webp, mp4"),
    (["mode=evaluate", "episodes=0"], "episodes=0: give at least one"),
    (["mode=evaluate", "robots=0"], "robots=0: give at least 1 episode to run at once"),
    (["mode=train", "training.validate=-1"], "training.validate=-1: give a number of arenas, or 0 for none"),
    (["time_limit=0"], "time_limit=0: give a finite number of seconds above 0"),
    (["mode=train", "seed=-1"], "seed=-1: give a whole number of 0 or more"),
    (["goal=gps", "density=5", "physics=kinematic"], "give one of known, fixes, odometry"),
    (["checkpoint=none.safetensors"], "no policy at none.safetensors"),
    (["sensor=noisy", "sensor.scale=0.2"], "memory=0.8: measured errors replace these"),
    (["arena.file=mine.yaml", "density=80", "arena.kind=rooms"],
     "density, arena.kind: not read with arena.file=mine.yaml, which describes the whole arena; leave"),
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
    refuse_to_replace(tmp_path, "train")  # writes none
    (tmp_path / "run.json").write_text('{"mode": "watch"}')  # an earlier version's name
    refuse_to_replace(tmp_path, "record")


# --- what the modes write


def test_record_makes_a_video_without_a_display(run_command, tmp_path):
    from PIL import Image

    finished = run_command(
        "navigate", "density=5", "time_limit=2", "video=gif", "physics=kinematic", "run_dir=run", DISPLAY=""
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
        "density=[5,20]", "episodes=2", "physics=kinematic", "sensor=noisy", "run_dir=run",
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


def test_analyze_failures_writes_a_table_and_a_picture(run_command, tmp_path):
    import cv2

    finished = run_command(
        "navigate", "mode=analyze_failures", "policy=straight", "density=60", "episodes=4", "split=val",
        "physics=kinematic", "run_dir=run",
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    with (tmp_path / "run" / "failures_60.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["kind"] for row in rows} <= {"in view", "unseen", "left the view", "boxed in"}
    assert cv2.imread(str(tmp_path / "run" / "failures_60.png")).shape[0] % 480 == 0
    run = read_run(tmp_path / "run")
    assert (run["mode"], run["policy"], run["config"]["split"]) == ("analyze_failures", "straight", "val")
    assert run["densities"]["60"]["worlds"] == 4
    assert sum(run["densities"]["60"]["failures"].values()) == len(rows) > 0


def test_fit_noise_writes_errors_that_noisy_reads(run_command, tmp_path):
    finished = run_command(
        "navigate", "mode=fit_noise", "sensor=camera", "sensor.checkpoint=null", "sensor.size=[60,80]",
        "density=40", "episodes=2", "time_limit=6", "run_dir=run",
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    path = tmp_path / "run" / "range_errors.json"
    errors = RangeErrors.read(path)
    assert errors.measured["split"] == "val"
    assert errors.measured["sensor"]["size"] == [60, 80]
    assert abs(errors.bias[2]) < 0.05  # true depth from the renderer
    assert max(errors.miss[:4]) < 0.02
    assert "bias" in finished.stdout
    run = read_run(tmp_path / "run")
    assert (run["mode"], run["errors"], run["config"]["episodes"]) == ("fit_noise", "range_errors.json", 2)
    NoisyRanges(errors=str(path))


def test_fit_noise_scans_near_obstacles_with_the_packaged_network(run_command, tmp_path):
    finished = run_command(
        "navigate", "mode=fit_noise", "sensor=camera", "fit_noise.places=near", "fit_noise.scans=4",
        "fit_noise.edges=[0.3,1.0,3.0,10.0]", "density=80", "episodes=8", "run_dir=run",
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    errors = RangeErrors.read(tmp_path / "run" / "range_errors.json")
    assert errors.measured["scans"] == 32
    assert len(errors.bias) == 3
    assert max(abs(bias) for bias in errors.bias) < 0.2
    assert max(errors.spread) < 0.3


def test_train_resumes_and_writes_a_policy(run_command, tmp_path):
    small = (
        "mode=train", "learner.total_timesteps=600", "learner.checkpoint_interval=300",
        "learner.learning_starts=100", "learner.batch_size=16", "training.robots=4", "training.validate=2",
        "training.arenas.densities=[0,5]", "run_dir=run",
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
    sensor = instantiate(compose("navigate", ["sensor=objects"]).sensor)
    depth = sha256((PACKAGED / "eldenet_arenas" / "model.safetensors").read_bytes())
    assert sensor_identity(sensor) == {"depth": {"source": "eldenet_arenas", "sha256": depth}}
    (tmp_path / "detector.onnx").write_bytes(b"finds")
    sensor.sources = {"detector": ("x.onnx", tmp_path / "detector.onnx"), "depth": ("owner/model",) * 2}
    assert sensor_identity(sensor) == {
        "detector": {"source": "x.onnx", "sha256": sha256(b"finds")},
        "depth": {"source": "owner/model", "sha256": None},  # of a Hub
    }


@pytest.mark.parametrize("edges", [[1.0], [10.0, 3.0, 0.3], [0.3, math.nan, 3.0]])
def test_edges_of_no_bins_are_refused_before_anything_is_scanned(edges):
    with pytest.raises(ValueError, match=r"fit_noise\.edges=\[.*: give two or more finite distances, rising"):
        check_edges("fit_noise.edges", edges)

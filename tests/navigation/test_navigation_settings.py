"""Navigation's command: no setting is silently left out; ``run.json`` says what drove."""

import hashlib
import json
import shlex

import pytest
from test_docs import commands

from eldenet.cli.entry_point import given_settings
from eldenet.config import compose, plain
from eldenet.navigate import MODES
from eldenet.navigation.noisy_ranges import MEASURED
from eldenet.navigation.policy import DEFAULT_WEIGHTS, Navigator
from eldenet.navigation.provenance import driver_identity, sensor_identity
from eldenet.navigation.settings import NOT_READ, refuse_ignored
from eldenet.results.fingerprints import sha256
from eldenet.zoo import PACKAGED


def check(*overrides: str) -> None:
    config = compose("navigate", [*overrides, "run_dir=x"])
    refuse_ignored(given_settings(overrides), plain(config))


CROSSES = ("evaluate", "diagnose")
DRIVES = ("watch", *CROSSES)


@pytest.mark.parametrize(
    ("modes", "setting"),
    [
        (("train",), "density=20"),
        (("train", "measure"), "checkpoint=runs/driver"),
        (("train", "measure"), "policy=astar_dwa"),
        (("train", "measure"), "policy.walkers=true"),
        (("train", "measure"), "policy.slows_within=1.0"),
        (("train", "measure"), "physics=kinematic"),
        (("train", "measure"), "split=val"),
        (("train", "watch"), "worlds=20"),
        (("train", "watch", "measure"), "robots=4"),
        (("train", "measure", *CROSSES), "world=3"),
        (("train", "measure", *CROSSES), "course=triangle"),
        (("train", "measure", *CROSSES), "film=mp4"),
        (("train", *DRIVES), "measure.places=near"),
        (("measure", *DRIVES), "observer=paper"),
        (("measure", *DRIVES), "observer.walkers=true"),
        (("measure", *DRIVES), "observer.seen_through=0"),
        (("measure", *DRIVES), "learner=algorithm2"),
        (("measure", *DRIVES), "learner.steps=100"),
        (("measure", *DRIVES), "training.arenas.repeats=2"),
        (("measure",), "movers=5"),
        (("measure",), "goal=fixes"),
        (MODES, "measure.looks=4"),
        (MODES, "runtime.device=cuda"),
        (MODES, "runtime.precision=bf16"),
    ],
)
def test_what_a_mode_does_not_read_is_refused(modes, setting):
    given, config = given_settings([setting]), plain(compose("navigate", [setting, "run_dir=x"]))
    for mode in modes:
        with pytest.raises(ValueError, match=f"mode={mode} does not read {setting} "):
            refuse_ignored(given, config | {"mode": mode})
    for mode in set(MODES) - set(modes):
        refuse_ignored(given, config | {"mode": mode})


@pytest.mark.parametrize("mode", DRIVES)
def test_what_is_read_depends_on_the_policy(mode):
    with pytest.raises(ValueError, match=r"does not read checkpoint=runs/driver \(planners have none"):
        check(f"mode={mode}", "policy=dwa", "checkpoint=runs/driver")
    with pytest.raises(ValueError, match=r"does not read checkpoint=a .*policy\.path goes before it"):
        check(f"mode={mode}", "policy.path=b", "checkpoint=a")
    check(f"mode={mode}", "policy=paper_literal", "observer.memory=60", "checkpoint=[a,b]")
    check(f"mode={mode}", "policy.walkers=true", "policy.slows_within=2", "checkpoint=a")


def test_what_is_read_depends_on_other_settings():
    for setting in ("density=20", "world=2", "movers=3", "split=val"):
        with pytest.raises(ValueError, match=f"does not read {setting} .course=triangle is an arena"):
            check("course=triangle", setting)
    near = ("mode=measure", "sensor=camera", "measure.places=near")
    check(*near, "measure.looks=4")
    with pytest.raises(ValueError, match="does not read time_limit=6"):
        check(*near, "time_limit=6")
    with pytest.raises(ValueError, match=r"does not read sensor\.drift\.heading=0"):
        check("mode=measure", "sensor=noisy", "sensor.drift.heading=0")
    for mode in MODES:
        with pytest.raises(ValueError, match=r"sensor\.scale=0\.2 .*give sensor\.errors=null"):
            check(f"mode={mode}", "sensor=noisy", "sensor.scale=0.2")
        check(f"mode={mode}", "sensor=noisy", "sensor.scale=0.2", "sensor.errors=null")
        check(f"mode={mode}", "sensor=noisy", "seed=3", "runtime.threads=1", "runtime.device=cpu")


def test_all_that_is_not_read_is_named_at_once():
    with pytest.raises(
        ValueError, match=r"density=20 \(training\.arenas\.densities.*; film=mp4 \(mode=watch"
    ):
        check("mode=train", "density=20", "film=mp4")


def test_what_is_not_read_are_settings():
    names = {name for settings in NOT_READ.values() for name in settings}
    config = compose("navigate", ["sensor=camera"])
    for name in names:
        node = config
        for part in name.split("."):
            assert part in node, name
            node = node[part]


@pytest.mark.parametrize(
    "line", sorted({line for _, line in commands() if line.startswith("eldenet.navigate")})
)
def test_documented_commands_give_nothing_that_is_not_read(line):
    check(*(word for word in shlex.split(line)[1:] if word not in ("-m", "...")))


def test_the_command_refuses_and_a_sweep_goes_on(run_command, tmp_path):
    finished = run_command("navigate", "mode=evaluate", "observer.walkers=true", "density=5", "run_dir=run")
    assert finished.returncode == 1
    assert "error: mode=evaluate does not read observer.walkers=true" in finished.stderr
    assert "Traceback" not in finished.stderr
    assert not list((tmp_path / "run").iterdir())
    finished = run_command(
        "navigate", "-m", "mode=evaluate", "policy=straight,dwa", "density=5", "worlds=1",
        "physics=kinematic", "hydra.sweep.dir=sweep",
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    runs = [json.loads(path.read_text()) for path in sorted(tmp_path.glob("sweep/*/run.json"))]
    assert [run["policy"] for run in runs] == ["straight", "dwa"]
    assert [run["driver"] for run in runs] == [None, None]


# --- what drove ---


def test_run_json_says_what_drove(run_command, tmp_path):
    Navigator.load().save(tmp_path / "a" / "policy.safetensors")
    finished = run_command(
        "navigate", "mode=evaluate", "checkpoint=[a,a/policy.safetensors]", "policy.slows_within=2",
        "density=5", "worlds=1", "physics=kinematic", "sensor=noisy", "run_dir=run",
    )  # fmt: skip
    assert finished.returncode == 0, finished.stderr
    run = json.loads((tmp_path / "run" / "run.json").read_text())
    content = (tmp_path / "a" / "policy.safetensors").read_bytes()
    expected = {"file": "a/policy.safetensors", "sha256": hashlib.sha256(content).hexdigest()}
    assert run["driver"]["files"] == [expected] * 2
    assert run["driver"]["info"] == {"members": [Navigator.load().info] * 2}
    assert run["driver"]["observer"]["slows_within"] == 2.0
    errors = hashlib.sha256(MEASURED.read_bytes()).hexdigest()
    assert run["inputs"] == {"errors": {"source": "packaged", "sha256": errors}}


def test_drivers_and_sensors_are_told_by_their_content(tmp_path):
    identity = driver_identity(Navigator.load(), {"path": None})
    assert identity is not None
    content = hashlib.sha256(DEFAULT_WEIGHTS.read_bytes()).hexdigest()
    assert identity["files"] == [{"file": str(DEFAULT_WEIGHTS), "sha256": content}]
    detector = tmp_path / "detector.onnx"
    detector.write_bytes(b"finds")
    options = plain(
        compose("navigate", ["sensor=objects", f"sensor.detector={{_target_: X, path: {detector}}}"]).sensor
    )
    depth = hashlib.sha256((PACKAGED / "eldenet_arenas" / "model.safetensors").read_bytes()).hexdigest()
    assert sensor_identity(options) == {
        "depth": {"source": "eldenet_arenas", "sha256": depth},
        "detector": {"source": str(detector), "sha256": hashlib.sha256(b"finds").hexdigest()},
    }
    assert sensor_identity({"checkpoint": "owner/model"})["depth"]["sha256"] is None
    assert sensor_identity({"checkpoint": None, "detector": None}) == {}
    (tmp_path / "net.xml").write_text("<net/>")
    (tmp_path / "net.bin").write_bytes(b"weights")
    assert sha256(tmp_path / "net.xml") == hashlib.sha256(b"weights").hexdigest()


def test_a_policy_is_a_file_or_its_run_folder(tmp_path):
    folder = tmp_path / "run"
    Navigator.load().save(str(folder / "policy.safetensors"))
    options = Navigator.load(folder).observer.options
    assert options == Navigator.load(str(folder / "policy.safetensors")).observer.options
    assert Navigator.load([folder, folder]).info["members"][0] == Navigator.load().info
    with pytest.raises(FileNotFoundError, match=r"no policy at .*tmp.*policy\.safetensors: train one"):
        Navigator.load(tmp_path)
    with pytest.raises(
        ValueError, match="no policy: 3 was given, give a run folder, a file or a list of them"
    ):
        Navigator.load(3)  # type: ignore[arg-type]
    wrong = folder / "dqn.pt"
    wrong.write_bytes(b"PK" * 100)
    with pytest.raises(
        ValueError, match=r"dqn\.pt is no \.safetensors file .*: give a training's run folder"
    ):
        Navigator.load(wrong)

"""The commands as a user types them: from another folder, with a typo, resumed, swept, reported."""

import json
import re
from pathlib import Path

import pytest
from support import layouts

import eldenet
from eldenet.compose import compose
from eldenet.configurable import instantiate
from eldenet.evaluation.evaluator import evaluate
from eldenet.train import TrainSettings, train

TINY = (
    "data.size=[32,40]",
    "data.input_size=[32,40]",
    "data.frames={train: 16, val: 8, test: 8}",
    "runtime.workers=0",
    "trainer.epochs=1",
    "trainer.batch_size=8",
    "model=eldenet_s",
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory, command_server) -> Path:
    """A run folder, made by the command itself with the workers that it chooses."""
    folder = tmp_path_factory.mktemp("elsewhere")
    words = (*TINY, "runtime.workers=auto", "output=run")
    finished = command_server.run("eldenet.train", words, folder)
    assert finished.returncode == 0, finished.stderr
    for text in ("epoch", "AbsRel", "constant", "params", "protocol rooms", "run.json"):
        assert text in finished.stdout, finished.stdout
    return folder / "run"


def test_train_writes_every_promised_file_and_field(trained):
    for name in ("run.json", "per_image.csv", "predictions.png", "config.yaml", "history.csv"):
        assert (trained / name).is_file(), name
    run = json.loads((trained / "run.json").read_text())
    assert run["model"] == "eldenet_s"
    assert run["protocol"]["name"] == "rooms"
    assert run["metrics"]["images"] == 8
    assert run["config"]["trainer"]["epochs"] == 1
    assert run["resources"]["threads"] + run["resources"]["workers"] <= run["resources"]["cores"]
    for field in ("metrics delta1", "constant_predictor abs_rel", "cost gmacs", "cost latency_ms_p50",
                  "versions torch", "hardware processor", "training best_epoch"):  # fmt: skip
        group, key = field.split()
        assert run[group][key] is not None, field
    assert len(run["split_hash"]) == 16
    assert {"date", "command", "seed", "git"} <= run.keys()


def test_evaluate_gives_the_same_numbers_and_report_a_table(trained, run_command):
    finished = run_command(
        "evaluate", f"checkpoint={trained}", *TINY[:4], "output=evaluation", cwd=trained.parent
    )
    assert finished.returncode == 0, finished.stderr
    # and no model/, which an evaluation does not write
    assert finished.stdout.rstrip().endswith("run.json, per_image.csv, predictions.png")
    first = json.loads((trained / "run.json").read_text())
    second = json.loads((trained.parent / "evaluation" / "run.json").read_text())
    assert second["metrics"] == pytest.approx(first["metrics"])
    assert "worse than a constant" in finished.stdout  # after a step or two
    assert second["model"] == "eldenet_s"
    finished = run_command(
        "report", f"runs=[{trained}]", "output=tables/first", "costs=false", cwd=trained.parent
    )
    assert finished.returncode == 0, finished.stderr
    assert "eldenet_s" in (trained.parent / "tables" / "first.md").read_text()
    assert {path.suffix for path in (trained.parent / "tables").iterdir()} == {".md", ".csv", ".tex"}
    (trained.parent / "results.csv").write_text("mine")  # a name that many have
    finished = run_command("report", f"runs=[{trained}]", cwd=trained.parent)
    assert finished.stdout.rstrip().endswith("written to runs/report.md, .csv and .tex")
    assert (trained.parent / "results.csv").read_text() == "mine"


def test_a_damaged_picture_is_one_line_also_where_workers_read_it(run_command, tmp_path):
    root = layouts.folder(tmp_path / "data")
    damaged = next((root / "images").iterdir())
    damaged.write_bytes(damaged.read_bytes()[:-30])
    words = ("data=folder", f"data.root={root}", "data.max_depth=10", "split=train", "runtime.threads=1")
    for workers in (0, 1):
        finished = run_command("evaluate", "checkpoint=eldenet_s", *words, f"runtime.workers={workers}")
        assert finished.returncode == 1
        assert finished.stderr.splitlines()[-1].startswith(f"error: {damaged} is truncated or damaged")
        assert "Traceback" not in finished.stderr


@pytest.mark.parametrize(
    "wrong",
    [
        *("trainer.monitor=accuracy", "ckpt_path=none.pt", "weights=nowhere", "weights=resnet18_upconv"),
        *("model.backbone.scale=0.33", "model.head.max_depth=5.5", "optimizer.lr=-1"),
        "scheduler.warmup_fraction=3",
        ["teacher=nowhere", "loss=ssim_l1_distill"],
    ],
)
def test_a_wrong_setting_is_refused_before_frames_are_rendered(run_command, tmp_path, wrong):
    words = [wrong] if isinstance(wrong, str) else wrong
    cache = tmp_path / "empty"
    finished = run_command("train", *words, "runtime.workers=0", ELDENET_CACHE=str(cache))
    assert finished.returncode == 1
    assert words[0].partition("=")[2] in finished.stderr
    assert not cache.exists()


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        ("protocol.size=[480,640]", "defined on ground truth of (480, 640) pixels, this one has (48, 64)"),
        ("protocol.frame_crop=[228,304]", "crop=[228, 304] does not fit"),
    ],
)
def test_frames_that_cannot_be_scored_are_refused_before_the_first_epoch(tmp_path, rule, message):
    root = layouts.folder(tmp_path / "data")
    words = ["data=folder", f"data.root={root}", "model=eldenet_s", "model_name=s", "protocol=folder", rule]
    with pytest.raises(ValueError, match=re.escape(message)):
        train(compose(TrainSettings, [*words, f"output={tmp_path / 'run'}", "runtime.workers=0"]))
    assert not (tmp_path / "run" / "checkpoints").exists()


def test_a_mistake_leaves_no_empty_run_behind(run_command, tmp_path):
    wrong = ("train", "trainer.monitor=accuracy", "runtime.workers=0")
    assert run_command(*wrong).returncode == 1
    assert not list(tmp_path.glob("runs/*"))
    (tmp_path / "mine").mkdir()
    assert run_command(*wrong, "output=mine").returncode == 1
    assert (tmp_path / "mine").is_dir()  # named by the user
    assert run_command("report", "runs=[nowhere]", cwd=tmp_path / "mine").returncode == 1
    assert (tmp_path / "mine").is_dir()  # where a command without a run folder was typed


def test_a_run_folder_holds_one_run(trained, run_command):
    for command, message in (
        (("train", *TINY), "already holds another run (run.json)"),
        (("evaluate", f"checkpoint={trained}", *TINY[:4]), "holds a training"),
    ):
        before = (trained / "run.json").read_bytes()
        finished = run_command(*command, f"output={trained}")
        assert finished.returncode == 1
        assert message in finished.stderr
        assert (trained / "run.json").read_bytes() == before


def test_evaluate_scores_the_training_split_at_its_own_resolution(trained, run_command):
    finished = run_command(
        *("evaluate", f"checkpoint={trained}", "data.size=[32,40]", "data.input_size=[16,20]", *TINY[2:4]),
        *("split=train", "output=a run/of mine"),
        cwd=trained.parent,
    )
    assert finished.returncode == 0, finished.stderr
    run = json.loads((trained.parent / "a run" / "of mine" / "run.json").read_text())
    assert run["metrics"]["images"] == 16
    assert run["metrics"]["pixels"] > 16 * 16 * 20
    assert run["seed"] == 0
    trained_at = json.loads((trained / "run.json").read_text())["config"]["data"]["input_size"]
    assert [run["cost"]["height"], run["cost"]["width"]] == trained_at
    assert "data.input_size=[16, 20] is not used" in finished.stdout


@pytest.mark.parametrize(("choice", "size"), [("data", [16, 20]), ("[24,28]", [24, 28])])
def test_evaluate_at_another_size_and_of_an_untrained_network(run_command, tmp_path, choice, size):
    words = ("data.input_size=[16,20]", f"input_size={choice}", "output=run")
    finished = run_command("evaluate", "checkpoint=eldenet_s", *TINY[:4], *words)
    assert finished.returncode == 0, finished.stderr
    assert "eldenet_s is a freshly initialized network" in finished.stdout
    cost = json.loads((tmp_path / "run" / "run.json").read_text())["cost"]
    assert [cost["height"], cost["width"]] == size


@pytest.mark.slow
def test_evaluate_scores_exported_files(trained, run_command):
    pytest.importorskip("onnxruntime")
    exported = trained.parent / "exported.onnx"
    finished = run_command(
        *("export", f"checkpoint={trained}", f"output={exported}", "checks=1", "format=onnx"),
        cwd=trained.parent,
    )
    assert finished.returncode == 0, finished.stderr
    finished = run_command(
        *("evaluate", f"checkpoint={exported}", "engine=onnxruntime", *TINY[:4], "output=of_the_file"),
        cwd=trained.parent,
    )
    assert finished.returncode == 0, finished.stderr
    first = json.loads((trained / "run.json").read_text())
    second = json.loads((trained.parent / "of_the_file" / "run.json").read_text())
    assert second["metrics"] == pytest.approx(first["metrics"], rel=1e-3)
    assert second["cost"]["runtime"] == "onnxruntime"
    assert [second["cost"][name] for name in ("params", "gmacs")] == pytest.approx(
        [first["cost"][name] for name in ("params", "gmacs")], rel=1e-5
    )
    assert "eldenet_s" in finished.stdout


@pytest.mark.slow
def test_a_sweep_continues_after_a_failed_job(run_command, tmp_path):
    finished = run_command("train", "-m", *TINY, "trainer.monitor=wrong,delta1", "output=sweep")
    assert finished.returncode == 1
    assert "error: monitor='wrong'" in finished.stderr
    assert (tmp_path / "sweep" / "1" / "run.json").is_file()


@pytest.mark.slow
def test_two_processes_train_to_the_end_and_write_one_run(cache, command_server, tmp_path):
    words = (*TINY[:2], "data.frames={train: 32, val: 7, test: 8}", *TINY[3:], "runtime.threads=1")
    words += ("trainer.monitor=abs_rel", "output=run")
    ranks = command_server.run_ranks("eldenet.train", words, tmp_path)
    for rank in ranks:
        assert rank.returncode == 0, rank.stderr[-2000:]
    said = "".join(rank.stdout for rank in ranks)
    assert said.count("epoch   1/1") == said.count("training and 7 validation") == 1
    run = json.loads((tmp_path / "run" / "run.json").read_text())
    assert run["metrics"]["images"] == 8
    # both halves of the validation were scored with the weights and statistics that were saved
    data = compose(TrainSettings, [*TINY[:2], f"data.root={cache}"]).data
    val_set = instantiate(data["val"], frames=7, resize_depth=False)
    saved = evaluate(eldenet.load(tmp_path / "run"), val_set, instantiate(data["protocol"])).metrics
    assert run["training"]["best_value"] == pytest.approx(saved["abs_rel"], rel=1e-6)

"""A study from a stranger builds eldenet's own parts, and other code only where its user trusts that."""

import sys
from pathlib import Path

import pytest
import torch

from eldenet import config as cfg
from eldenet.deploy.benchmarking.run import benchmark
from eldenet.results.studies.plan import read_study
from eldenet.results.studies.runner import StudySetup, run_row

PLAN = """
overrides: [data=rooms, model=eldenet_s, data.root={root}/rooms, "data.frames={{train: 4, val: 2, test: 2}}",
  "data.size=[32,40]", "data.input_size=[32,40]", trainer.epochs=1, runtime.workers=0]
learning_rate: 1.0e-3
rows:
  row: {{overrides: [{override}]}}
"""
WRITE = "_target_=pathlib.Path.write_text"
HOSTILE = [
    f"model.head.{WRITE}",
    "model.head._target_=shutil.copy",
    "model.head._target_=eldenet.heads.importlib.import_module",  # what a module of ours imports
    "model.head._target_=eldenet.train.main",
    "model.head._target_=hydra.utils.instantiate",
    "model.head._target_=eldenet.perception.onnx_detector.OnnxDetector",  # not a training's
    f"'+model.head.more=[{{deep: {{{WRITE.replace('=', ': ')}}}}}]'",
    "'model.head._target_=${oc.decode:pathlib.Path.touch}'",
    f"loss.terms.l1.loss.{WRITE}",
    f"optimizer.{WRITE}",
    f"scheduler.{WRITE}",
    f"trainer.{WRITE}",
    f"augmentation.{WRITE}",
    f"data.train.{WRITE}",
    f"data.protocol.{WRITE}",
    "loss=ssim_l1_distill, teacher=eldenet_s, "
    f"'loss.terms.distilled.teacher.overrides=[\"model.head.{WRITE}\"]'",  # composed while it is built
    "loss=ssim_l1_distill, teacher=eldenet_s, 'loss.terms.distilled.teacher.trusted_modules=[os]'",
]


def write(folder: Path, override: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "sweep.yaml").write_text(PLAN.format(root=folder, override=override))
    return folder


@pytest.mark.parametrize("override", HOSTILE)
def test_a_hostile_setting_runs_nothing(tmp_path, override):
    folder = write(tmp_path / "study", override)
    training = cfg.study_training()
    study = read_study(folder, training.composition)
    (outcome,) = run_row(study, study.rows[0], StudySetup(folder, tmp_path / "runs"), training, print)
    assert outcome.status == "failed"
    assert "refused" in outcome.reason
    assert "trusted_modules=[" in outcome.reason


def test_a_benchmark_of_a_study_runs_nothing_either(tmp_path):
    folder = write(tmp_path / "study", f"model.head.{WRITE}")
    config = cfg.compose("benchmark", [f"study={folder}", "runtimes=[torch]", f"output={tmp_path / 'out'}"])
    with pytest.raises(ValueError, match=r"refused _target_=pathlib\.Path\.write_text.*=\[pathlib\.Path\]"):
        benchmark(cfg.build_benchmark(config))


def test_code_that_the_user_trusts_is_built(tmp_path, monkeypatch):
    (tmp_path / "my_heads.py").write_text(
        "from eldenet.heads import LinearHead\nclass Mine(LinearHead): pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    model = cfg.compose("train", ["model=eldenet_s", "model.head._target_=my_heads.Mine"]).model
    with pytest.raises(ValueError, match=r"trusted_modules=\[my_heads\]"):
        cfg.training_composition().build_model(model)
    assert "my_heads" not in sys.modules  # not even imported
    assert type(cfg.training_composition(["my_heads"]).build_model(model).head).__name__ == "Mine"
    assert isinstance(cfg.build_model(model), torch.nn.Module)  # a command line is its user's own
    with pytest.raises(ValueError, match=r"give a list"):
        cfg.training_composition("my_heads").build_model(model)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("  row:", "  ../../outside:", "give a name of letters"),
        ("  row:", '  "a\',b":', "give a name of letters"),
        ("  row:", '  "a\\nb":', "give a name of letters"),
        ("{override}", "'hydra.searchpath=[pkg://antigravity]'", "overrides of a training"),
        ("rows:", "block: [1]\nrows:", "block=.*a line of text"),
        ("rows:", "seen: 3\nrows:", "seen=3: give a line"),
        ("rows:", "compare: [a]\nrows:", "compare="),
        ("rows:", "latency: {{a: b}}\nrows:", "latency="),
        ("{{overrides: [{override}]}}", "{{from: 5}}", "from=5"),
        ("{{overrides: [{override}]}}", "[a]", "row row: give a mapping"),
        ("{{overrides: [{override}]}}", "{{given: {{a: [1]}}}}", "given="),
    ],
)
def test_a_plan_that_reaches_outside_or_has_odd_values_is_refused(tmp_path, old, new, word):
    (tmp_path / "sweep.yaml").write_text(PLAN.replace(old, new).format(root=tmp_path, override="seed=0"))
    with pytest.raises(ValueError, match=word):
        read_study(tmp_path, cfg.training_composition())

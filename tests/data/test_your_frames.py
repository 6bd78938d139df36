"""The commands of docs/your_frames.md run on recordings of the layouts that they are about."""

import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
from support.recordings import RECORDERS

from eldenet.check_data import CheckDataSettings, check_data
from eldenet.compose import compose
from eldenet.evaluate import EvaluateSettings, evaluate
from eldenet.train import TrainSettings, train

PAGE = Path(__file__).resolve().parents[2] / "docs/your_frames.md"
COMMANDS = {
    match["name"]: shlex.split(match["words"])
    for match in re.finditer(
        r"^eldenet check-data (?P<words>data=folder data\.root=/data/(?P<name>\w+).*)$",
        PAGE.read_text().replace("\\\n", " "),
        re.MULTILINE,
    )
    if match["name"] != "mine"
}


def test_every_layout_has_its_command() -> None:
    assert COMMANDS.keys() == RECORDERS.keys()
    for name, words in COMMANDS.items():
        settings = {word.removeprefix("data.") for word in words[2:]}
        assert settings == {word.replace("'", "") for word in RECORDERS[name].settings}


@pytest.mark.parametrize("name", RECORDERS)
def test_a_documented_command_finds_nothing_wrong(name: str, tmp_path: Path) -> None:
    RECORDERS[name].write(tmp_path / name, (24, 32))
    words = [word.replace("/data", str(tmp_path)) for word in COMMANDS[name]]
    assert check_data(compose(CheckDataSettings, [*words, f"output={tmp_path}/out"]))
    report = json.loads((tmp_path / "out/check.json").read_text())
    train_part = report["splits"][0]
    assert train_part["sizes"] == {"48 x 64": train_part["frames"]}
    assert (train_part["with_intrinsics"] > 0) == RECORDERS[name].has_camera


@pytest.mark.slow
def test_the_same_settings_train_and_evaluate(tmp_path: Path) -> None:
    RECORDERS["stray_scanner"].write(tmp_path / "stray_scanner", (24, 32))
    words = [word.replace("/data", str(tmp_path)) for word in COMMANDS["stray_scanner"]]
    words += ["data.input_size=[32,64]", "runtime.threads=1", "runtime.workers=0"]
    small = ["model=eldenet_s", "trainer.epochs=1", "trainer.batch_size=2", "augmentation=none"]
    train(replace(compose(TrainSettings, [*words, *small]), output=str(tmp_path / "run")))
    settings = compose(EvaluateSettings, [*words, f"checkpoint={tmp_path}/run"])
    evaluate(replace(settings, output=str(tmp_path / "scores")))
    (record,) = (tmp_path / "scores").rglob("run.json")
    assert json.loads(record.read_text())["metrics"]["rmse"] > 0

"""What the commands say of themselves."""

import os
import subprocess
import sys

import pytest

from eldenet.cli.help import QUOTES, help_text, what_was_meant
from eldenet.config import config_folder

COMMANDS = sorted({path.stem for path in config_folder().glob("*.yaml")} - {"base", "zoo"})


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_the_settings_with_their_comments(command):
    shown = help_text(command, "``python -m``: what it does.")
    assert shown.startswith(f"python -m: what it does.\n\n# python -m eldenet.{command}")
    assert "\nhydra:" not in shown
    assert shown.endswith(f"python -m eldenet.{command} --cfg job")


def test_help_lists_the_choices_of_the_commands_own_groups():
    assert "\nmodel/head: inverse, linear, log, scaled\n" in help_text("train", "")
    assert "\nexperiment: cityscapes_paper, " in help_text("train", "")
    assert "\nruntime: auto\n" in help_text("predict", "")
    assert "model: " not in help_text("predict", "")


def test_help_may_be_left_before_its_end():
    read, write = os.pipe()
    os.close(read)  # as head does once it has its lines
    with os.fdopen(write, "w") as closed:
        command = [sys.executable, "-m", "eldenet.report", "--help"]
        result = subprocess.run(command, stdout=closed, stderr=subprocess.PIPE, check=False, timeout=120)
    assert (result.returncode, result.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("command", "words", "meant"),
    [
        ("train", ["epochs=5"], "there is no setting epochs: is trainer.epochs meant?"),
        ("train", ["seed=1", "optimizer.lr=1"], "there is no setting optimizer.lr: is optimizer.lr meant?"),
        ("train", ["-m", "data=kitti", "data.rot=/x"], "there is no setting data.rot: is data.root meant?"),
        ("predict", ["sorce=x", "chekpoint=y"], "there is no setting sorce: is source meant?"),
        ("predict", ["source=my photo (1).jpg"], QUOTES),
        ("predict", ["qqqqqqqq=1"], ""),
        ("train", ["model=eldennet"], ""),  # Hydra lists the choices
        ("train", ["seed=1"], ""),  # it failed for another reason
    ],
)
def test_a_mistyped_setting_hears_the_right_one(command, words, meant):
    assert what_was_meant(command, words) == meant


def test_commands_say_so(run_command):
    finished = run_command("predict", "sorce=photo.jpg")
    assert finished.returncode == 1
    assert finished.stderr.endswith("error: there is no setting sorce: is source meant?\n")
    finished = run_command("predict", "--help")
    assert finished.returncode == 0
    assert finished.stdout.startswith("python -m eldenet.predict: depth of a picture")


@pytest.mark.parametrize(
    ("command", "words", "message"),
    [
        ("report", ["study=x", "columns=[rmse]"], "columns: not read with study="),
        ("report", ["runs=nowhere"], "no such file or folder: nowhere"),
        ("predict", ["checkpoint=a", "source=b", "perception.detector.path=c"], "with boxes=true alone"),
        ("benchmark", ["study=x", "models=eldenet"], "models: not read with study="),
        ("benchmark", ["study=x", "sizes=[[64,64]]"], "sizes: not read with study="),
        (
            "benchmark",
            ["models=eldenet_s", "sizes=[224,224]"],
            "sizes=[224, 224]: give [[height, width], ...]",
        ),
        ("train", ["data.input_size=224"], "input_size=224: give [height, width] in pixels"),
        ("train", ["trainer.epochs=five"], "epochs=five: a whole number, 1 or more, is needed"),
    ],
)
def test_what_would_be_ignored_or_misread_is_refused(run_command, command, words, message):
    finished = run_command(command, *words)
    assert finished.returncode == 1
    assert finished.stderr.startswith("error: ")
    assert message in finished.stderr
    assert finished.stderr.count("\n") == 1

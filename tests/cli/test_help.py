"""What the commands say about themselves and about settings that do not exist."""

import os
import subprocess
import sys

import pytest
from support.composing import composed

from eldenet.cli.commands import module_of
from eldenet.cli.help import QUOTES, advice, quote_paths
from eldenet.compose import config_folder

COMMANDS = sorted({path.stem for path in config_folder().glob("*.yaml")} - {"base", "no_run_folder", "zoo"})


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_the_settings_with_their_comments(command, run_command):
    module = module_of(command.replace("_", "-"))
    finished = run_command(module.removeprefix("eldenet."), "--help")
    assert finished.returncode == 0, finished.stderr
    for name in composed(command):
        assert f"\n{name}: " in finished.stdout or f"\n{name}." in finished.stdout
    assert finished.stdout.startswith(f"python -m {module}: ")
    assert "\nhydra:" not in finished.stdout
    choices = finished.stdout.partition("Choices of its groups:\n")[2]
    assert ("model/head: inverse, linear, log, scaled, uncertain\n" in choices) == (command == "train")
    assert ("sensor: camera, depth_camera, mixed" in choices) == (command == "navigate")
    assert max(map(len, choices.splitlines()), default=0) <= 80
    assert finished.stdout.rstrip().endswith(f"python -m {module} --cfg job")


def test_the_reader_of_help_may_leave_before_its_end():
    read, write = os.pipe()
    os.close(read)  # as head does once it has its lines
    with os.fdopen(write, "w") as closed:
        words = [sys.executable, "-m", "eldenet.report", "--help"]
        result = subprocess.run(words, stdout=closed, stderr=subprocess.PIPE, check=False, timeout=120)
    assert (result.returncode, result.stderr) == (0, b"")


@pytest.mark.parametrize(
    ("command", "words", "line"),
    [
        ("train", ["epochs=5"], "there is no setting epochs: did you mean trainer.epochs?"),
        ("train", ["lr=1e-3"], "there is no setting lr: did you mean optimizer.lr?"),
        ("train", ["batch_size=8"], "there is no setting batch_size: did you mean trainer.batch_size?"),
        ("train", ["compile=true"], "there is no setting compile: did you mean trainer.compile?"),
        ("train", ["patience=3"], "there is no setting patience: did you mean trainer.patience?"),
        ("train", ["amp=true"], "there is no setting amp: did you mean runtime.precision?"),
        ("train", ["early_stopping=3"], "there is no setting early_stopping: did you mean trainer.patience?"),
        (
            "train",
            ["trainer.early_stopping=3"],
            "there is no setting trainer.early_stopping: did you mean trainer.patience?",
        ),
        (
            "train",
            ["seed=1", "optimiser.lr=1"],
            "there is no setting optimiser.lr: did you mean optimizer.lr?",
        ),
        (
            "train",
            ["-m", "data=kitti", "data.rot=/x"],
            "there is no setting data.rot: did you mean data.root?",
        ),
        ("predict", ["sorce=x", "chekpoint=y"], "there is no setting sorce: did you mean source?"),
        ("predict", ["source=my photo (1).jpg"], f"source=my photo (1).jpg cannot be read: {QUOTES}"),
        (  # in the words of other tools
            "predict",
            ["weights=eldenet_indoor"],
            "there is no setting weights: did you mean checkpoint?",
        ),
        ("predict", ["image=a.jpg"], "there is no setting image: did you mean source?"),
        ("predict", ["qqqqqqqq=1"], "there is no setting qqqqqqqq: --help lists all settings"),
        (
            "train",
            ["loss=l1", "augmentation=ful"],
            "augmentation=ful: did you mean full? choose from flip, full, none",
        ),
        ("train", ["data.input_size=[1,2"], f"data.input_size=[1,2 cannot be read: {QUOTES}"),
        ("train", ["quick"], "quick cannot be read: write setting=value (--help lists all settings)"),
        ("predict", [__file__], f"{__file__} cannot be read: write source={__file__}"),
        ("train", ["model/backbne=x"], "there is no setting model/backbne: did you mean model/backbone?"),
        ("train", ["data.subst=5"], "there is no setting data.subst: did you mean data.subset?"),
        (  # it exists, but not with data=mix
            "train",
            ["data=mix", "data.subset.train=5"],
            "there is no setting data.subset.train: did you mean data.train?",
        ),
        (
            "navigate",
            ["mode=evaluate", "world=3"],
            "there is no setting world: --help lists all settings",
        ),
        ("train", ["seed=1"], ""),  # it failed for another reason
    ],
)
def test_a_mistyped_setting_gets_the_nearest_one(command, words, line):
    assert advice(command, words) == line


def test_a_file_with_special_characters_needs_no_quotes_of_its_own(tmp_path):
    file = tmp_path / "my photo (1), b=2.jpg"
    file.touch()
    assert quote_paths([f"source={file}"]) == [f'source="{file}"']
    assert composed("predict", quote_paths([f"source={file}"])).source == str(file)
    as_typed = ["-m", "source=nothing (1).jpg", "seed=1,2", f'source="{file}"', "size=[1,2]"]
    assert quote_paths(as_typed) == as_typed


def test_commands_print_the_advice_as_their_last_line(run_command):
    finished = run_command("predict", "sorce=photo.jpg")
    assert finished.returncode == 1
    assert finished.stderr.endswith("error: there is no setting sorce: did you mean source?\n")


@pytest.mark.parametrize(
    ("command", "words", "message"),
    [
        ("report", ["study=x", "columns=[rmse]"], "columns: not read with study="),
        ("report", ["runs=nowhere"], "no such file or folder: nowhere"),
        ("predict", ["checkpoint=a", "source=b", "perception.detector.path=c"], "only boxes=true makes 3D"),
        ("benchmark", ["study=x", "sizes=[[64,64]]"], "sizes: not read with study="),
        ("benchmark", ["models=eldenet_s", "sizes=[224,224]"], "sizes=[224, 224]: give [[height, width]"),
        ("train", ["data.input_size=224"], "input_size=224: give [height, width] in pixels"),
        ("train", ["trainer.epochs=five"], "epochs=five: give a whole number"),
        ("train", ["data.input_size=[-1,5]"], "input_size=[-1, 5]: give whole numbers of 1 or more"),
        ("train", ["data.subset=5"], "data.subset=5: give it per split, data.subset.train=5"),
        ("train", ["model=eldnet"], "model=eldnet: did you mean eldenet? choose from eldenet,"),
        ("train", ["data=nyu"], "data=nyu: did you mean nyu_densedepth or nyu_hdf5 or nyu_labelled"),
        ("train", ["-m", "model=eldnet,eldenet"], "model=eldnet: did you mean eldenet?"),
        ("train", ["+experiment=nope"], "experiment=nope: choose from"),
        ("train", ["trainer.epochs"], "trainer.epochs cannot be read: write trainer.epochs=value"),
        ("train", ["~foo"], "Could not delete from config. 'foo' does not exist."),
        ("train", ["+trainer.epochs=3"], "Could not append to config. An item is already at"),
        ("train", ["--config-dir=nowhere"], "nowhere' not found"),
        ("train", ["--foo"], "unrecognized arguments: --foo (--help shows what there is)"),
        ("train", ["output=/proc/runs/mine"], "/proc/runs: No such file or directory"),
        ("navigate", ["world=abc"], "world=abc: give a whole number"),
        ("navigate", ["density=many"], "density=many: give a whole number, or a list of them"),
        ("navigate", ["physics=magic"], "physics='magic': give one of kinematic, wheels"),
    ],
)
def test_ignored_and_malformed_settings_are_refused_in_one_line(run_command, command, words, message):
    finished = run_command(command, *words)
    assert finished.returncode in (1, 2)  # 2: argparse's
    assert finished.stderr.startswith("error: ")
    assert message in finished.stderr
    assert finished.stderr.count("\n") == 1

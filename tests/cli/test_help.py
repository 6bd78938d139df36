"""What the commands say about themselves and about settings that do not exist."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.composing import composed

from eldenet.cli.commands import module_of
from eldenet.cli.help import quote_paths
from eldenet.compose import config_folder

PHOTO = Path(__file__).parents[2] / "web/example.jpg"
COMMANDS = sorted({path.stem for path in config_folder().glob("*.yaml")} - {"base", "no_run_folder", "zoo"})


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_the_settings_with_their_comments(command, run_command):
    module = module_of(command.replace("_", "-"))
    finished = run_command(module.removeprefix("eldenet."), "-m", "mine=0,1", "--help")
    assert finished.returncode == 0, finished.stderr
    for name in composed(command):
        assert f"\n{name}: " in finished.stdout or f"\n{name}." in finished.stdout
    assert finished.stdout.startswith(f"python -m {module}: ")
    assert "\nhydra:" not in finished.stdout
    choices = finished.stdout.partition("Choices of its groups:\n")[2]
    assert ("model/head: inverse, linear, log, scaled, uncertain\n" in choices) == (command == "train")
    assert ("sensor: camera, centers, depth_camera, mixed" in choices) == (command == "navigate")
    assert max(map(len, choices.splitlines()), default=0) <= 80
    assert finished.stdout.rstrip().endswith(f"python -m {module} --cfg job")


def test_the_reader_of_help_may_leave_before_its_end():
    read, write = os.pipe()
    os.close(read)  # as head does once it has its lines
    with os.fdopen(write, "w") as closed:
        words = [sys.executable, "-m", "eldenet.report", "--help"]
        result = subprocess.run(words, stdout=closed, stderr=subprocess.PIPE, check=False, timeout=120)
    assert (result.returncode, result.stderr) == (0, b"")


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
    ("words", "message"),
    [
        ("report study=x columns=[rmse]", "columns: not read with study="),
        ("report runs=nowhere", "no such file or folder: nowhere"),
        ("predict checkpoint=a source=b perception.detector.path=c", "only boxes=true makes 3D"),
        (
            f"predict source={PHOTO} focal=440 boxes=true perception.detector.path=a.onnx "
            "perception.tracker.max_age=3",
            "perception.tracker.max_age: objects are tracked in videos",
        ),
        ("benchmark study=x sizes=[[64,64]]", "sizes: not read with study="),
        ("train data.input_size=224", "input_size=224: give [height, width] in pixels"),
        ("train data.input_size=[-1,5]", "input_size=[-1, 5]: give whole numbers of 1 or more"),
        ("train data.subset=5", "data.subset=5: give it per split, data.subset.train=5"),
        ("train -m model=eldnet,eldenet", "model=eldnet: did you mean eldenet?"),
        ("train data=nyu_mat --config-dir . data.root=/nowhere -m seed=0 trainer.epochs=1", "/nowhere"),
        ("train +experiment=nope", "experiment=nope: choose from"),
        ("train ~foo", "Could not delete from config. 'foo' does not exist."),
        ("train +trainer.epochs=3", "Could not append to config. An item is already at"),
        ("train --config-dir=nowhere", "nowhere' not found"),
        ("train --cfg job -m seed=0,1", "Only one of --run, --multirun, --cfg,"),
        ("train --foo", "unrecognized arguments: --foo (--help shows what there is)"),
        ("train output=/proc/runs/mine", "/proc/runs: No such file or directory"),
        ("train experiment=rooms_full", "+experiment"),
        ("train model=eldenet_s runtime.device=cuda", "device=cuda"),
        ("evaluate checkpoint=eldenet_s data=kitti_raw data.root=. ++data.test.split=val", "(data.val...)"),
        ("evaluate checkpoint=nowhere", "unknown model 'nowhere'"),
        ("evaluate checkpoint=eldenet_s batch_size=0", "batch_size=0: give a whole number, 1 or"),
        ("evaluate checkpoint=eldenet_s split=name", "no split 'name': choose train, val or test"),
        ("navigate density=many", "density=many: give a whole number, or a list of them"),
        ("navigate physics=magic", "physics='magic': give one of kinematic, wheels"),
    ],
)
def test_a_started_command_refuses_a_mistake_in_one_line(run_command, words, message):
    finished = run_command(*words.split(), CUDA_VISIBLE_DEVICES="")
    assert finished.returncode in (1, 2)  # 2: argparse's
    assert finished.stderr.startswith("error: ")
    assert message in finished.stderr
    assert finished.stderr.count("\n") == 1

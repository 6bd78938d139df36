"""The command ``eldenet``: its list, its sub-commands, completion, and where results go."""

import ast
import importlib
import os
import pty
import select
import shutil
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from support.composing import composed

from eldenet.cli.commands import COMMANDS, command_list, completion, module_of, unknown
from eldenet.compose import config_folder

LINE = [sys.executable, "-c", "from eldenet.cli.commands import main; main()"]


def eldenet(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*LINE, *words], cwd=cwd, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_module_and_a_short_line(name):
    assert callable(importlib.import_module(module_of(name)).main)
    assert max(map(len, command_list().splitlines())) <= 80


def test_every_command_has_a_config_and_every_config_is_in_the_list():
    shared = {"base", "no-run-folder", "zoo"}
    configs = {file.stem.replace("_", "-") for file in config_folder().glob("*.yaml")} - shared
    assert configs == set(COMMANDS)


def test_the_list_needs_no_heavy_import():
    code = "import sys; from eldenet.cli.commands import main; main([]); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(command_list())
    assert not {"torch", "numpy", "hydra", "omegaconf"} & set(done.stdout.splitlines()[-1].split())


@pytest.mark.slow
def test_a_command_starts_by_its_name_and_finds_code_that_lies_here(tmp_path):
    (tmp_path / "mine.py").write_text("class Loss:\n    pass\n")
    for word in ("check-data", "check_data"):
        done = eldenet(word, "data=folder", "data.root=/nope", cwd=tmp_path)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith("error: /nope")
    words = ["train", "loss={_target_: mine.Loss}", "--cfg", "job"]
    assert eldenet(*words, cwd=tmp_path).returncode == 0
    help_text = eldenet("navigate", "mode=wacth", cwd=tmp_path)
    assert help_text.stderr.startswith("error: mode=wacth: choose from evaluate, record, train")


def test_a_mistyped_command_gets_the_nearest_one(tmp_path):
    assert unknown("trian") == "there is no command trian: did you mean train?"
    assert unknown("xyz").endswith(f"choose one of {', '.join(COMMANDS)}")
    done = eldenet("chek-data", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        1,
        "error: there is no command chek-data: did you mean check-data?\n",
    )


SHELLS = {"bash": ["bash", "--norc", "--noprofile", "-i"], "zsh": ["zsh", "-f", "-i"]}
#: Answers the shell's questions, and notes with which words it was started.
STAND_IN = f"""#!{sys.executable}
import sys
if "-sc" in sys.argv:
    {LINE[-1]}
    sys.exit()
with open("started", "a") as file:
    print(sys.argv[1:], file=file)
"""


def complete(shell: str, folder: Path, *lines: str) -> list[list[str]]:
    """Type lines, each with Tab and Enter, into an interactive shell; return the words of each command."""
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    bin_folder = folder / "bin"
    bin_folder.mkdir()
    (bin_folder / "eldenet").write_text(STAND_IN)
    (bin_folder / "eldenet").chmod(0o755)
    (bin_folder / "script").write_text(completion(shell))
    started = folder / "started"
    started.touch()
    child, terminal = pty.fork()
    if not child:
        os.environ["PATH"] = f"{bin_folder}:{os.environ['PATH']}"
        os.chdir(folder)
        os.execvp(shell, SHELLS[shell])
    try:
        _wait(terminal, lambda: _edits(terminal))
        os.write(terminal, b"source bin/script; echo > ready\n")
        _wait(terminal, (folder / "ready").exists)
        for number, line in enumerate(lines, 1):
            _wait(terminal, lambda: _edits(terminal))
            os.write(terminal, f"{line}\t\n".encode())
            _wait(terminal, lambda: started.read_text().count("\n") == number)  # noqa: B023
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        os.close(terminal)
    return [ast.literal_eval(line) for line in started.read_text().splitlines()]


def _edits(terminal: int) -> bool:
    """Whether the shell reads key by key: what is typed earlier may be lost."""
    return not termios.tcgetattr(terminal)[3] & termios.ICANON


def _wait(terminal: int, done: Callable[[], bool]) -> None:
    """Wait until something is done; meanwhile the shell may print."""
    shown, end = "", time.monotonic() + 60
    while not done():
        assert time.monotonic() < end, shown
        if select.select([terminal], [], [], 0.05)[0]:
            shown += os.read(terminal, 65536).decode(errors="replace")


@pytest.mark.parametrize("shell", SHELLS)
def test_a_shell_completes_commands_settings_and_paths(shell, tmp_path):
    (tmp_path / "my frames" / "left").mkdir(parents=True)
    typed = {
        "eldenet evalu": ["evaluate"],
        "eldenet train data=nyu_l": ["train", "data=nyu_labelled"],
        "eldenet train optimizer=adam_": ["train", "optimizer=adam_paper"],
        "eldenet train +experiment=kitti_p": ["train", "+experiment=kitti_paper"],
        "eldenet check-data data=folder data.roo": ["check-data", "data=folder", "data.root="],
        "eldenet check-data data.root=m": ["check-data", "data.root=my frames"],
        "eldenet check-data data.root=my\\ frames/l": ["check-data", "data.root=my frames/left"],
        "eldenet check-data data.root=./m": ["check-data", "data.root=./my frames"],
    }
    words = complete(shell, tmp_path, *typed)
    assert [[word.rstrip("/") for word in line] for line in words] == list(typed.values())


@pytest.mark.parametrize("shell", SHELLS)
def test_completion_runs_and_expands_no_name_of_a_file(shell, tmp_path):
    names = ["a$(touch run)", "b`touch run`", "c${IFS}d", "e;touch run", "f\nline", "g'x\" *", "h$HOME"]
    folder = tmp_path / "folder"
    folder.mkdir()
    for name in names:
        (folder / name).touch()
    given = {f"{way}{name[0]}": f"{way}{name}" for name in names for way in ("./folder/", "folder/")}
    given |= {way: way for way in ("./folder/", "folder/")}  # of several, none is chosen
    words = complete(shell, tmp_path, *[f"eldenet check-data data.root={path}" for path in given])
    assert words == [["check-data", f"data.root={path}"] for path in given.values()]
    assert not list(tmp_path.rglob("run"))


def test_completion_imports_nothing_that_lies_here(tmp_path):
    (tmp_path / "hydra.py").write_text("open('run', 'w')\n")
    complete("bash", tmp_path, "eldenet train data=nyu_l")
    assert not (tmp_path / "run").exists()


def test_completion_needs_a_shell(tmp_path):
    done = eldenet("completion", "fish", cwd=tmp_path)
    assert done.returncode == 1
    assert 'eval "$(eldenet completion bash)"' in done.stderr


RUN_FOLDERS = ("train", "adapt", "evaluate", "check_data", "navigate")


@pytest.mark.parametrize("command", [*RUN_FOLDERS, "predict"])
def test_output_names_the_folder(command):
    given = {"evaluate": ["checkpoint=a"], "predict": ["checkpoint=a", "source=b"]}.get(command, [])
    assert composed(command, [*given, "output=here"])["output"] == "here"


def test_output_names_the_folder_of_a_sweep(run_command, tmp_path):
    finished = run_command("check_data", "-m", "data=folder", "data.root=/a,/b", "output=sweep")
    assert finished.returncode == 1
    assert "/a is not a folder" in finished.stderr
    assert (tmp_path / "sweep" / "multirun.yaml").is_file()
    assert not (tmp_path / "runs").exists()

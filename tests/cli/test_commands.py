"""The command ``eldenet``: its list, its sub-commands, completion, and where results go."""

import importlib
import os
import pty
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from eldenet.cli.commands import COMMANDS, command_list, completion, module_of, unknown
from eldenet.config import compose, config_folder

LINE = [sys.executable, "-c", "from eldenet.cli.commands import main; main()"]

TYPE = """
type_and_tab() {
    COMP_LINE="$1"; COMP_POINT=${#1}; COMP_WORDS=($1); [[ "$1" == *" " ]] && COMP_WORDS+=("")
    COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=(); _eldenet; echo "${COMPREPLY[*]}"
}
"""


def eldenet(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*LINE, *words], cwd=cwd, capture_output=True, text=True, check=False, timeout=60)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_module_a_config_and_a_short_line(name):
    module = name.replace("-", "_")
    assert callable(importlib.import_module(module_of(name)).main)
    assert (config_folder() / f"{module}.yaml").is_file()
    assert max(map(len, command_list().splitlines())) <= 80


def test_every_config_of_a_command_is_in_the_list():
    shared = {"base", "no-run-folder", "zoo"}
    configs = {file.stem.replace("_", "-") for file in config_folder().glob("*.yaml")} - shared
    assert configs == set(COMMANDS)


def test_the_list_needs_no_heavy_import():
    code = "import sys; from eldenet.cli.commands import main; main([]); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(command_list())
    assert not {"torch", "numpy", "hydra", "omegaconf"} & set(done.stdout.splitlines()[-1].split())


def test_a_command_starts_by_its_name_and_finds_code_that_lies_here(tmp_path):
    (tmp_path / "mine.py").write_text("class Loss:\n    pass\n")
    for word in ("check-data", "check_data"):
        done = eldenet(word, "data=folder", "data.root=/nope", cwd=tmp_path)
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith("error: /nope")
    words = ["train", "loss={_target_: mine.Loss}", "--cfg", "job"]
    assert eldenet(*words, cwd=tmp_path).returncode == 0
    help_text = eldenet("navigate", "mode=wacth", cwd=tmp_path)
    assert help_text.stderr.startswith("error: mode=wacth: choose one of record")


def test_a_mistyped_command_gets_the_nearest_one(tmp_path):
    assert unknown("trian") == "there is no command trian: did you mean train?"
    assert unknown("xyz").endswith(f"choose one of {', '.join(COMMANDS)}")
    done = eldenet("chek-data", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        1,
        "error: there is no command chek-data: did you mean check-data?\n",
    )


def test_bash_completes_commands_and_their_settings(tmp_path):
    here = tmp_path / "eldenet"
    here.write_text(f"#!{sys.executable}\n{LINE[-1]}\n")
    here.chmod(0o755)
    asked = [
        "eldenet tra",
        "eldenet train data=nyu_l",
        "eldenet check-data fra",
        "eldenet train optimizer=adam_",
    ]
    typed = "\n".join(f'type_and_tab "{words}"' for words in asked)
    done = subprocess.run(
        ["bash", "-c", f"{completion('bash')}\n{TYPE}\n{typed}"],
        env={**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    assert [line.strip() for line in done.stdout.splitlines()] == [
        "train",
        "data=nyu_labelled",
        "frames=",
        "optimizer=adam_paper",
    ]


def test_zsh_completes_what_is_typed(tmp_path):
    """In an interactive zsh: the script is bash's, run by zsh's own bashcompinit."""
    if shutil.which("zsh") is None:
        pytest.skip("no zsh here")
    here = tmp_path / "eldenet"
    here.write_text(f"#!{sys.executable}\n{LINE[-1]}\n")
    here.chmod(0o755)
    (tmp_path / "script").write_text(completion("zsh"))
    child, terminal = pty.fork()
    if not child:
        os.environ["PATH"] = f"{tmp_path}:{os.environ['PATH']}"
        os.chdir(tmp_path)
        os.execvp("zsh", ["zsh", "-f", "-i"])
    try:
        os.write(terminal, b"source ./script; print rea''dy\n")
        _read_until(terminal, "ready")
        os.write(terminal, b"eldenet evalu\t")
        shown = _read_until(terminal, "evaluate")
        os.write(terminal, b" data=nyu_l\t")
        shown += _read_until(terminal, "data=nyu_labelled")
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    assert "evaluate" in shown
    assert "data=nyu_labelled" in shown


def _read_until(terminal: int, text: str) -> str:
    shown, end = "", time.monotonic() + 30
    while text not in shown and time.monotonic() < end:
        if select.select([terminal], [], [], 0.1)[0]:
            shown += os.read(terminal, 65536).decode(errors="replace")
    return shown


def test_completion_needs_a_shell(tmp_path):
    done = eldenet("completion", "fish", cwd=tmp_path)
    assert done.returncode == 1
    assert 'eval "$(eldenet completion bash)"' in done.stderr


RUN_FOLDERS = ("train", "adapt", "evaluate", "check_data", "navigate")


@pytest.mark.parametrize("command", [*RUN_FOLDERS, "predict"])
@pytest.mark.parametrize("name", ["output", "run_dir"])
def test_output_names_the_folder_and_run_dir_is_the_same(command, name):
    read = "output" if command == "predict" else "run_dir"
    given = {"evaluate": ["checkpoint=a"], "predict": ["checkpoint=a", "source=b"]}.get(command, [])
    assert compose(command, [*given, f"{name}=here"])[read] == "here"


def test_output_names_the_folder_of_a_sweep(run_command, tmp_path):
    finished = run_command("check_data", "-m", "data=folder", "data.root=/a,/b", "output=sweep")
    assert finished.returncode == 1
    assert "/a is not a folder" in finished.stderr
    assert (tmp_path / "sweep" / "multirun.yaml").is_file()
    assert not (tmp_path / "runs").exists()


def test_the_folder_has_one_name(run_command):
    finished = run_command("train", "output=a", "run_dir=b")
    assert finished.returncode == 1
    assert finished.stderr == "error: output and run_dir are the same setting: give output alone\n"

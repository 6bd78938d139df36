"""What functions are given: few arguments, and no configs below ``compose.py``."""

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from support.settings_walk import walk
from test_layers import FLOOR_OF

from eldenet.visualization import write_picture

PACKAGE = Path(__file__).parents[1] / "eldenet"
MOST_ARGUMENTS = 8
MORE_ARGUMENTS = {"step": 13}  # of a driver on a robot: all that its loop knows, by name

#: A script that runs a command and prints each function below ``compose.py`` that received a config.
WATCHED = """
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

command, *sys.argv[1:] = sys.argv[1:]
found, calls = set(), []
PACKAGE = str(Path(find_spec("eldenet").origin).parent)  # not "/eldenet/", where an environment may lie too
TOP = ("compose.py", "entry_point.py", "help.py")


def watch(frame, event, argument):
    code = frame.f_code
    if event != "call" or not code.co_filename.startswith(PACKAGE):
        return
    if Path(code.co_filename).name in TOP or code.co_name == "main":
        return
    calls.append(code.co_name)
    for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]:
        if type(frame.f_locals.get(name)).__module__.startswith("omegaconf"):
            found.add(f"{code.co_filename}:{code.co_firstlineno} {code.co_name}({name})")


module = import_module(f"eldenet.{command}")
sys.settrace(watch)  # watch returns no tracer of lines, so only calls cost time
try:
    module.main()
finally:
    sys.settrace(None)
    print("CALLS", len(calls))
    print("RECEIVED", *sorted(found), sep="\\n")
"""


def functions() -> Iterator[tuple[str, ast.FunctionDef]]:
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.FunctionDef):
                yield f"{file.relative_to(PACKAGE)}:{node.lineno} {node.name}", node


def test_no_function_takes_more_than_eight_arguments() -> None:
    """Constructors apart: classes that YAML builds have a keyword for every option."""
    long = {}
    for place, node in functions():
        names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        count = len([name for name in names if name not in ("self", "cls")])
        if node.name not in ("__init__", "__new__") and count > MORE_ARGUMENTS.get(node.name, MOST_ARGUMENTS):
            long[place] = count
    assert long == {}


@pytest.mark.parametrize(
    "words",
    [
        "train {tiny} trainer.epochs=1 model=eldenet_s output={out}/run",
        "evaluate checkpoint=eldenet_rooms {tiny} output={out}/scores",
        "predict checkpoint=eldenet_rooms source={photo} output={out}/predictions",
        "navigate mode=evaluate density=[5] episodes=1 output={out}/drive",
    ],
    ids=lambda words: words.split()[0],
)
def test_configs_end_in_compose_py(words: str, tmp_path: Path, command_server) -> None:
    photo = tmp_path / "photo.png"
    write_picture(photo, np.full((48, 64, 3), 90, np.uint8))
    tiny = "data.size=[32,40] data.input_size=[32,40] data.frames={train:8,val:8,test:8} runtime.workers=0"
    for name, value in (("{out}", tmp_path), ("{photo}", photo), ("{tiny}", tiny)):
        words = words.replace(name, str(value))
    (tmp_path / "watched.py").write_text(WATCHED)
    done = command_server.run(str(tmp_path / "watched.py"), words.split(), tmp_path)
    assert done.returncode == 0, done.stderr
    calls, _, received = done.stdout.rpartition("CALLS")[2].partition("RECEIVED")
    assert int(calls) > 100
    assert received.split("\n")[1:] == [""]


def test_a_trainings_settings_are_handed_on_rarely_and_never_up(tmp_path: Path) -> None:
    steps = walk(tmp_path / "run")
    floors = [[FLOOR_OF[function.partition(":")[0].split(".")[0]] for function in step] for step in steps]
    assert 20 < len(steps) <= 60
    assert [step for step, (giver, receiver) in zip(steps, floors, strict=True) if receiver > giver] == []

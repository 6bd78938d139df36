"""Packages that only some settings need: a missing one is named at once, in one line that installs it."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from eldenet.system.extras import EXTRAS, require

REPOSITORY = Path(__file__).parents[2]
PROJECT = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
INSTALLED_AS = {"rerun": "rerun-sdk", "pillow_heif": "pillow-heif"}
PHOTO = f"source={REPOSITORY / 'web/example.jpg'}"

#: Command line -> what its error says: what needs which packages of which extra.
LINES = {
    "predict source=film.mp4": "source=film.mp4 needs av: pip install -e '.[video]'",
    "predict source=camera:0": "source=camera:0 needs av: pip install -e '.[video]'",
    "predict source=rtsp://me:secret@host/x": "source=rtsp://host/x needs av: pip install -e '.[video]'",
    f"predict {PHOTO} viewer=rerun": "viewer=rerun needs rerun: pip install -e '.[viewer]'",
    f"predict {PHOTO} engine=openvino": "engine=openvino needs onnx, onnxscript, openvino: "
    "pip install -e '.[deploy]'",
    f"predict {PHOTO} checkpoint=net.onnx": "net.onnx needs onnxruntime: pip install -e '.[deploy]'",
    f"predict {PHOTO} boxes=true focal=500 perception.detector.path=net.onnx": "running net.onnx "
    "needs onnxruntime: pip install -e '.[deploy]'",
    "evaluate checkpoint=net.onnx": "net.onnx needs onnxruntime: pip install -e '.[deploy]'",
    "evaluate checkpoint=net.xml engine=openvino": "net.xml needs openvino: pip install -e '.[deploy]'",
    "evaluate checkpoint=eldenet_rooms data=nyu_mat data.root=.": "data.train needs h5py: "
    "pip install -e '.[nyu]'",
    "check_data data=nyu_hdf5 data.root=.": "data.train needs h5py: pip install -e '.[nyu]'",
    "train model=seresnet18_upconv": "model.backbone needs timm: pip install -e '.[timm]'",
    "train logger=[tensorboard,wandb]": "logger=wandb needs wandb: pip install -e '.[loggers]'",
    "export checkpoint=eldenet_rooms": "format=onnx, precision=fp32 needs onnx, onnxscript: "
    "pip install -e '.[deploy]'",
    "export checkpoint=eldenet_rooms format=openvino precision=int8": "format=openvino, precision=int8 needs "
    "onnx, onnxscript, openvino, nncf: pip install -e '.[deploy]'",
    "adapt source=walk.mcap camera_height=1": "source=walk.mcap needs rosbags: pip install -e '.[ros]'",
    "demo": "the demo needs onnx, onnxscript: pip install -e '.[deploy]'",
    "benchmark": "the plot of latencies needs matplotlib: pip install -e '.[plots]'",
    f"report study={REPOSITORY / 'experiments/table3_rivals'}": "the report of a study needs matplotlib: "
    "pip install -e '.[plots]'",
    "navigate mode=train": "mode=train needs gymnasium: pip install -e '.[nav]'",
    "navigate mode=record video=mp4": "video=mp4 needs av: pip install -e '.[video]'",
}

# runs one command after the other in a process that has no optional package, and no torch either
RUN = """
import contextlib, importlib, io, json, sys
lines, hidden = json.load(sys.stdin)
sys.modules.update(dict.fromkeys([*hidden, "torch"]))
said = {}
for line in lines:
    command, *words = line.split()
    sys.argv = [f"eldenet {command}", *words]
    with contextlib.redirect_stderr(io.StringIO()) as errors, contextlib.suppress(SystemExit):
        importlib.import_module(f"eldenet.{command}").main()
    said[line] = errors.getvalue()
print(json.dumps(said))
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory) -> dict[str, str]:
    """Command line -> what it prints without the optional packages."""
    folder = tmp_path_factory.mktemp("bare")
    for name in ("film.mp4", "net.onnx", "net.xml"):
        (folder / name).write_bytes(b"")
    done = subprocess.run(
        [sys.executable, "-c", RUN], input=json.dumps([list(LINES), list(EXTRAS)]), cwd=folder,
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize("line", LINES)
def test_a_command_names_the_missing_package_before_torch_is_loaded(line: str, said: dict[str, str]) -> None:
    assert said[line] == f"error: {LINES[line]}\n"


@pytest.mark.parametrize("package", EXTRAS)
def test_every_package_is_in_the_extra_that_its_line_names(package: str, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=f"^this needs {package}: pip install -e '") as caught:
        require("this", package)
    extra = str(caught.value).partition("'.[")[2].removesuffix("]'")
    inside = [re.split(r"[><=]", each)[0] for each in PROJECT["optional-dependencies"][extra]]
    assert INSTALLED_AS.get(package, package) in inside


def test_an_installed_package_is_no_error() -> None:
    require("this", "numpy")

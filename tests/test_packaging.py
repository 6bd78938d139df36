"""The wheel holds all it needs."""

import os
import shutil
import subprocess
import sys
import tomllib
import venv
import zipfile
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import numpy as np
import pytest
from packaging.requirements import Requirement

from eldenet.data.io import read_depth

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel, built by hatchling itself: no network, no isolation."""
    folder = tmp_path_factory.mktemp("wheel")
    script = (
        "import os, sys\n"
        f"os.chdir({str(REPOSITORY)!r})\n"
        "from hatchling.build import build_wheel\n"
        f"print(build_wheel({str(folder)!r}))\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, timeout=120)
    (found,) = folder.glob("*.whl")
    return found


def test_the_wheel_holds_code_configs_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    for name in ("eldenet/py.typed", "eldenet/configs/train.yaml", "eldenet/configs/model/eldenet.yaml"):
        assert name in names
    assert "eldenet/weights/arena_dqn.safetensors" in names
    for name in ("rooms", "fast_rooms", "arenas", "indoor", "l_indoor"):
        assert f"eldenet/weights/eldenet_{name}/config.json" in names
    yamls = {str(path.relative_to(REPOSITORY)) for path in (REPOSITORY / "configs").rglob("*.yaml")}
    assert {f"eldenet/{name}" for name in yamls} <= set(names)
    assert {name.split("/")[0].split("-")[0] for name in names} == {"eldenet"}
    assert not [name for name in names if name.endswith((".pt", ".pth", ".h5"))]
    assert [name for name in names if name.endswith(".jpg")] == ["eldenet/web/example.jpg"]  # MIT


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """Scripts of a fresh environment: the wheel, and what ``pip install .`` brings with it, nothing else."""
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder, with_pip=False)
    (site,) = folder.glob("lib/python3.*/site-packages")
    todo = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["dependencies"]
    seen = set()
    while todo:
        need = Requirement(todo.pop())
        if need.name in seen or not (need.marker is None or need.marker.evaluate({"extra": ""})):
            continue
        seen.add(need.name)
        try:
            found = distribution(need.name)
        except PackageNotFoundError:  # torch's libraries for a GPU
            continue
        todo += found.requires or []
        modules = (found.read_text("top_level.txt") or "").split()  # old pips list the sources as files
        for part in ({file.parts[0] for file in found.files or ()} | {*modules}) - {"..", "__pycache__"}:
            if not (site / part).exists():
                (site / part).symlink_to(Path(str(found.locate_file(part))))
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install"]
    subprocess.run([*pip, "--quiet", "--no-deps", "--no-index", str(wheel)], check=True, timeout=120)
    return folder / "bin"


def in_fresh(command: list[str | Path], folder: Path) -> subprocess.CompletedProcess:
    """What a command of the fresh environment prints, in an empty folder."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, check=False)


@pytest.mark.slow
def test_the_installed_wheel_predicts_with_what_it_brings(installed, tmp_path):
    shutil.copy(REPOSITORY / "web" / "example.jpg", tmp_path)
    ran = in_fresh(
        [installed / "eldenet", "predict", "source=example.jpg", "focal=440", "output=out"], tmp_path
    )
    assert (ran.returncode, ran.stderr) == (0, "")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "example_color.png", "example_depth.png"
    ]  # fmt: skip
    code = (
        "import eldenet; print(eldenet.__file__); eldenet.estimate('example.jpg', focal=440).save('python'); "
        "print(eldenet.compose.config_folder())"
    )
    ran = in_fresh([installed / "python", "-c", code], tmp_path)
    package = next(installed.parent.glob("lib/*/site-packages")) / "eldenet"
    assert ran.stdout.splitlines() == [str(package / "__init__.py"), str(package / "configs")], ran.stderr
    command, function = (
        read_depth(tmp_path / folder / "example_depth.png", "mm") for folder in ("out", "python")
    )
    apart = np.abs(function - command)  # threads add up in another order: a sharpened edge may move
    assert apart.max() < 1e-2
    assert (apart > 2e-3).mean() < 1e-4
    ran = in_fresh([installed / "eldenet", "train", "--cfg", "job"], tmp_path)
    assert "eldenet.backbones.pplcnet.PPLCNet" in ran.stdout


@pytest.mark.parametrize(
    ("command", "missing", "extra"),
    [
        (["demo"], "onnx, onnxscript", "deploy"),
        (["export", "checkpoint=eldenet_indoor"], "onnx, onnxscript", "deploy"),
        (["benchmark", "models=[eldenet]"], "matplotlib", "plots"),
        (["predict", "source=camera:0"], "av", "video"),
        (["predict", "source=example.jpg", "viewer=rerun"], "rerun", "viewer"),
        (["train", "model=seresnet18_upconv"], "timm", "timm"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_what_an_extra_brings_is_named_before_torch_loads(installed, tmp_path, command, missing, extra):
    shutil.copy(REPOSITORY / "web" / "example.jpg", tmp_path)
    (tmp_path / "torch.py").write_text("raise SystemExit('torch was loaded')")
    run = [installed / "python", "-m", "eldenet", *command]
    ran = in_fresh(run, tmp_path)
    (line,) = ran.stderr.splitlines()
    assert ran.returncode == 1
    assert line.endswith(f" needs {missing}: pip install -e '.[{extra}]'"), line


@pytest.mark.net
@pytest.mark.timeout(1800)
def test_a_clean_environment_installs_and_trains(wheel, tmp_path):
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", str(wheel)], check=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment["ELDENET_CACHE"] = str(tmp_path / "cache")
    subprocess.run(
        [
            *(python, "-m", "eldenet.train", "data.size=[32,40]", "data.input_size=[32,40]"),
            *("data.frames={train: 16, val: 8, test: 8}", "trainer.epochs=1", "output=run"),
        ],
        cwd=tmp_path,
        env=environment,
        check=True,
    )
    assert (tmp_path / "run" / "run.json").is_file()

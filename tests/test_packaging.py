"""The wheel holds all it needs."""

import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

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


def test_an_unpacked_wheel_runs_from_another_folder(wheel, tmp_path):
    site = tmp_path / "site"
    zipfile.ZipFile(wheel).extractall(site)
    (tmp_path / "elsewhere").mkdir()

    def printed(*arguments: str) -> str:
        options = {"cwd": tmp_path / "elsewhere", "env": {**os.environ, "PYTHONPATH": str(site)}}
        return subprocess.run(
            [sys.executable, *arguments], capture_output=True, text=True, check=True, **options
        ).stdout

    where = printed("-c", "from eldenet.compose import config_folder; print(config_folder())")
    assert where.strip() == str(site / "eldenet" / "configs")
    assert "eldenet.backbones.pplcnet.PPLCNet" in printed("-m", "eldenet.train", "--cfg", "job")


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

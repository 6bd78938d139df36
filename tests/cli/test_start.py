"""What a command loads: nothing heavy before its paths are checked, and never what it does not use."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.commands import CommandServer
from support.networks import small_net
from support.stored_study import store, write_plan

RUN = """
import atexit, runpy, sys
command = sys.argv[0] = "eldenet." + sys.argv.pop(1)
atexit.register(lambda: print("loaded", *sys.modules))
runpy.run_module(command, run_name="__main__", alter_sys=True)
"""


@pytest.fixture(scope="module")
def light_server() -> Iterator[CommandServer]:
    """Holds what every command loads, and neither torch nor anything of ours beyond the command line."""
    server = CommandServer({**os.environ, "OMP_NUM_THREADS": "1"}, ["hydra.main", "eldenet.cli.entry_point"])
    yield server
    server.close()


def run(words: str, folder: Path, server: CommandServer) -> tuple[subprocess.CompletedProcess[str], set[str]]:
    """Run a command in a process of its own; returns it and the modules that it held at its end."""
    (folder / "held.py").write_text(RUN)
    done = server.run(str(folder / "held.py"), words.split(), folder)
    return done, set(done.stdout.rpartition("loaded ")[2].split())


@pytest.mark.parametrize(
    "words",
    [
        "predict checkpoint=eldenet_rooms source=/nope",
        "predict checkpoint=/nope source=.",
        "train data=kitti data.root=/nope",
        "train weights=/nope",
        "train teacher=/nope loss=ssim_l1_distill",
        "train ckpt_path=/nope",
        "evaluate checkpoint=/nope",
        "evaluate checkpoint=/nope.onnx",
        "evaluate checkpoint=eldenet_rooms data=kitti data.root=/nope",
        "export checkpoint=/nope",
        "report runs=[/nope]",
        "report study=/nope",
        "study study=/nope",
        "check_data data=folder data.root=/nope",
        "benchmark models=[/nope]",
        "navigate checkpoint=/nope",
        "adapt data.root=/nope",
        "adapt data.root=. weights=/nope",
        "adapt source=/nope camera_height=1 intrinsics=[9,9,5,5]",
        "adapt source=/nope poses=/nope camera_height=1 intrinsics=[9,9,5,5]",
    ],
)
def test_a_wrong_path_ends_in_one_line_before_torch_is_loaded(
    words: str, tmp_path: Path, light_server: CommandServer
) -> None:
    done, loaded = run(words, tmp_path, light_server)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert "/nope" in line
    assert not {"torch", "albumentations", "scipy", "matplotlib"} & loaded


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        "predict checkpoint=model source=picture.png output=out",
        "export checkpoint=model size=[32,64] pictures=picture.png checks=1 output=model.onnx",
        "report runs=[.] output=table",
        "report study=.",
    ],
)
def test_commands_that_neither_train_nor_score_load_no_torchvision(
    words: str, tmp_path: Path, light_server: CommandServer
) -> None:
    cv2.imwrite(str(tmp_path / "picture.png"), np.full((32, 64, 3), 100, np.uint8))
    small_net().save_pretrained(tmp_path / "model")
    store(write_plan(tmp_path), "small", 0, np.linspace(0.5, 0.9, 40))
    done, loaded = run(words, tmp_path, light_server)
    assert done.returncode == 0, done.stderr
    assert not {"torchvision", "torchmetrics"} & loaded

"""The examples of CONTRIBUTING.md run in a project outside the package: parts train together, load again."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from eldenet.compose import compose
from eldenet.train import TrainSettings

PAGE = Path(__file__).parents[1] / "CONTRIBUTING.md"
EXAMPLE = (
    r"`eldenet/(\w+)/mine\.py` and `configs/([\w/]+)/mine\.yaml`:\n\n"
    r"```python\n(.*?)```\n\n```yaml\n(.*?)```"
)


# A program with Hydra's config of its own that loads the trained network.
APPLICATION = """
import hydra
import torch
from hydra.core.global_hydra import GlobalHydra

import eldenet


@hydra.main(version_base="1.3", config_path="app", config_name="app")
def main(config):
    assert GlobalHydra.instance().is_initialized()
    by_name = eldenet.load("eldenet_s", overrides=["model.head.max_depth=20"])
    assert by_name.head.max_depth == 20
    try:
        eldenet.load(config.folder)
        raise SystemExit("an untrusted config was built")
    except ValueError as error:
        assert "trusted_modules" in str(error), error
    model = eldenet.load(config.folder, trusted_modules=["my_backbones", "my_decoders"])
    assert model(torch.rand(1, 3, 64, 80)).shape == (1, 1, 64, 80)
    print("app ran", type(model.network.backbone).__name__, config.word)


main()
"""


@pytest.mark.slow
def test_the_parts_of_contributing_train_together_and_another_project_loads_them(
    tmp_path: Path, command_server
) -> None:
    examples = re.findall(EXAMPLE, PAGE.read_text(), re.S)
    assert [package for package, *_ in examples] == ["backbones", "decoders", "losses", "data"]
    for package, group, code, config in examples:
        (tmp_path / f"my_{package}.py").write_text(code)
        path = tmp_path / "my_configs" / group / "mine.yaml"
        path.parent.mkdir(parents=True)
        path.write_text(config.replace(f"eldenet.{package}.mine", f"my_{package}"))
    generator = np.random.default_rng(0)
    for split in ("train", "val"):
        for kind, shape, dtype in (("image", (64, 80, 3), np.uint8), ("depth", (64, 80), np.uint16)):
            folder = tmp_path / "frames" / split / kind
            folder.mkdir(parents=True)
            for number in range(4):
                values = generator.integers(1, 256, shape) * (1 if kind == "image" else 20)
                cv2.imwrite(str(folder / f"{number}.png"), values.astype(dtype))
    (tmp_path / "app").mkdir()
    (tmp_path / "app" / "app.yaml").write_text("word: none\nfolder: ???\n")
    (tmp_path / "app.py").write_text(APPLICATION)

    def printed(module: str, *words: str) -> str:
        finished = command_server.run(module, words, tmp_path)
        assert finished.returncode == 0, finished.stdout + finished.stderr
        return finished.stdout

    printed(
        *("eldenet.train", "--config-dir", "my_configs", "debug=fast", "runtime.workers=0"),
        *("model/backbone=mine", "model/decoder=mine", "loss=mine", "data=mine", "data.root=frames"),
        *("trainer.batch_size=2", "output=run", "runtime.threads=1"),
    )
    assert "app ran Mine hello" in printed(str(tmp_path / "app.py"), "folder=run/model", "word=hello")


def test_a_loss_of_eight_lines_is_used_from_the_command_line(tmp_path: Path, monkeypatch) -> None:
    from hydra.utils import instantiate

    (code,) = re.findall(
        r"Save this as `mine\.py` in the current folder:\n\n```python\n(.*?)```", PAGE.read_text(), re.S
    )
    (words,) = re.findall(r"eldenet train (loss=l1 .*mine\.RelativeLoss)", PAGE.read_text())
    assert len([line for line in code.splitlines() if line]) <= 8
    (tmp_path / "mine.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    loss = instantiate(compose(TrainSettings, words.split()).loss)
    target = torch.full((1, 1, 4, 4), 2.0)
    target[..., 0] = float("nan")  # masked pixels must not matter
    prediction = torch.full_like(target, 3.0, requires_grad=True)
    value = loss.terms["l1"].loss(prediction, target, target.isfinite())
    value.backward()
    assert value.item() == pytest.approx(0.5)
    assert prediction.grad.isfinite().all()


def test_the_command_of_contributing_runs(tmp_path: Path, command_server) -> None:
    page = PAGE.read_text().partition("`eldenet/mine.py` and `configs/mine.yaml`:")[2]
    code, config = re.findall(r"```(?:python|yaml)\n(.*?)```", page, re.S)[:2]
    (tmp_path / "mine.py").write_text(code)
    (tmp_path / "my_configs").mkdir()
    (tmp_path / "my_configs" / "mine.yaml").write_text(config)
    words = ("--config-dir", "my_configs", "checkpoint=eldenet_s")
    finished = command_server.run(str(tmp_path / "mine.py"), (*words, "unit=1000"), tmp_path)
    assert finished.returncode == 0, finished.stderr
    assert re.fullmatch(r"eldenet_s: \d+\.\d+\n", finished.stdout)
    finished = command_server.run(str(tmp_path / "mine.py"), (*words, "unit=0"), tmp_path)
    assert (finished.returncode, finished.stderr) == (1, "error: unit=0: give a whole number, 1 or more\n")

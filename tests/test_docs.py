"""What the documents say can be typed, can be typed; what they link to exists."""

import re
import shlex
from pathlib import Path

import pytest
import torch

from eldenet.config import compose, config_folder
from eldenet.simulation.robot import ROBOT

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = [
    *REPOSITORY.glob("*.md"),
    *(REPOSITORY / "docs").rglob("*.md"),
    *(REPOSITORY / "experiments").rglob("README.md"),
]
CONFIGS = sorted(config_folder().rglob("*.yaml"))


def commands() -> list[tuple[str, str]]:
    """Every ``python -m eldenet.<command> ...`` of the pages and of the comments in the configs."""
    found = set()
    for page in [*PAGES, *CONFIGS]:
        for match in re.finditer(r"python -m (eldenet\.\w+[^`\n|]*)", page.read_text()):
            line = re.split(r"\s{2,}#?|\s#\s|\s&&|`|; ", match.group(1))[0].strip().rstrip(".,:)")
            found.add((str(page.relative_to(REPOSITORY)), line))
    return sorted(found)


def test_there_are_commands_to_check():
    assert len(commands()) > 20


@pytest.mark.parametrize(("page", "line"), commands(), ids=lambda value: value[-60:])
def test_a_documented_command_composes(page, line):
    name, *arguments = shlex.split(line)
    name = name.removeprefix("eldenet.")
    sweep = "-m" in arguments
    overrides = []
    for argument in arguments:
        if argument in ("-m", "...", "--help", "--cfg", "job") or argument.startswith("-"):
            continue
        if argument == "my_configs" or argument.endswith("backbone=mine"):
            continue  # made by test_packaging.py's project
        if argument.startswith(("hydra/launcher=", "hydra.launcher.")):
            continue  # of the [cluster] extra, which need not be installed
        key, _, value = argument.partition("=")
        overrides.append(f"{key}={value.split(',')[0]}" if sweep else argument)
    config = compose(name, overrides)
    assert config is not None


def test_documented_scripts_exist():
    for page in PAGES:
        for script in re.findall(r"python (experiments/\S+\.py)", page.read_text()):
            assert (REPOSITORY / script).is_file(), f"{page}: {script}"


def test_links_lead_somewhere():
    for page in PAGES:
        for link in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            if not link.startswith("http"):
                assert (page.parent / link).exists(), f"{page.name}: {link}"


def python_blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (REPOSITORY / page).read_text(), re.S)


def test_the_readme_snippet_runs():
    (block,) = python_blocks("README.md")
    names: dict = {}
    exec(block, names)
    assert names["depth"].shape == (1, 1, 480, 640)


def test_the_backbone_of_contributing_works():
    block = next(text for text in python_blocks("CONTRIBUTING.md") if "class Mine" in text)
    names: dict = {"__name__": "mine"}
    exec(block, names)
    backbone = names["Mine"]()
    features = backbone(torch.rand(1, 3, 64, 96))
    for feature, info in zip(features, backbone.feature_info, strict=True):
        assert feature.shape[1:] == (info.channels, 64 // info.stride, 96 // info.stride)


def test_sharing_as_documented(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = python_blocks("docs/use_from_elsewhere.md")
    load, save = blocks[0], blocks[1]
    names: dict = {}
    exec(load, names)
    exec(
        "\n".join(line for line in save.splitlines() if "push_to_hub" not in line), {"eldenet": None} | names
    )
    assert (tmp_path / "my-model" / "model.safetensors").is_file()


def test_the_snippets_of_deploy_run(tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    import numpy as np

    import eldenet
    from eldenet.deploy import runtimes
    from eldenet.deploy.files import describe, write_onnx

    monkeypatch.chdir(tmp_path)
    model = eldenet.load("eldenet_s")
    for name in ("my-run-224x224-fp32.onnx", "my-run.onnx"):
        facts = describe(model, "my-run", (32, 64))
        write_onnx(model, f"exports/{name}", (32, 64), opset=17, metadata=facts)
    run, stream = python_blocks("docs/deploy.md")
    names: dict = {"images": np.zeros((2, 3, 32, 64), np.float32)}
    exec(run, names)
    assert names["depth"].shape == (2, 1, 32, 64)
    camera = [np.zeros((48, 64, 3), np.uint8)] * 3
    monkeypatch.setattr(
        runtimes, "DepthStream", lambda source, *args, **options: Stream(camera, *args, **options)
    )
    from eldenet.deploy.stream import DepthStream as Stream

    exec(stream, names)
    assert names["number"] == 2
    assert names["depth"].shape == (48, 64)


def test_the_snippet_of_embedded_gives_what_predict_gives(tmp_path, monkeypatch):
    """A board without eldenet prepares the frame as the package does."""
    pytest.importorskip("onnxruntime")
    import cv2
    import numpy as np
    import skimage

    import eldenet
    from eldenet.deploy.files import describe, write_onnx

    monkeypatch.chdir(tmp_path)
    model = eldenet.load("eldenet_rooms")
    write_onnx(model, "board.onnx", (96, 128), batch=1, metadata=describe(model, "board", (96, 128)))
    cv2.imwrite("photo.jpg", skimage.data.coffee())
    (block,) = python_blocks("docs/embedded.md")
    names: dict = {}
    exec(block, names)
    expected = eldenet.DepthPredictor(model, input_size=(96, 128))(names["frame"])
    assert names["depth"].shape == expected.shape == names["frame"].shape[:2]
    np.testing.assert_allclose(names["depth"], expected, rtol=1e-3, atol=1e-3)


def test_the_snippets_of_navigation_run(tmp_path, monkeypatch):
    """All of the page's Python in one program, top to bottom, as a reader would paste it."""
    for library in ("gymnasium", "onnx", "onnxruntime"):
        pytest.importorskip(library)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in python_blocks("docs/navigation.md"):
        exec(compile(block, "docs/navigation.md", "exec"), names)
    assert 0 <= names["speed"] <= ROBOT.max_speed
    assert abs(names["turn"]) <= ROBOT.max_turn
    assert names["envs"].num_envs == 16
    assert (tmp_path / "driver.onnx").is_file()

"""What the documents say can be typed, can be typed; what they link to exists."""

import re
import shlex
import tomllib
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest
from support import layouts
from support.composing import composed

import eldenet
from eldenet.cli.commands import COMMANDS as ELDENET
from eldenet.compose import config_folder
from eldenet.data import array_files
from eldenet.simulation.robot import ROBOT
from eldenet.system import checks, files

REPOSITORY = Path(__file__).resolve().parents[1]
PAGES = sorted(
    page
    for pattern in (
        "*.md",
        "docs/**/*.md",
        "experiments/README.md",
        "experiments/*/README.md",
        "experiments/indoor/earlier.md",
        "ros2/*/README.md",
    )
    for page in REPOSITORY.glob(pattern)
)


def typed(pattern: str, pages: list[Path]) -> list[str]:
    """What the pages tell a reader to type: the first group of every match, without the comment behind it."""
    found = set()
    for page in pages:
        for match in re.finditer(pattern, page.read_text().replace("\\\n", " ")):
            found.add(re.split(r"\s{2,}#|\s#\s|\s{3,}|\s&&|`|; ", match[1])[0].strip().rstrip(".,:)"))
    return sorted(found)


TYPED_IN = [*PAGES, *sorted(config_folder().rglob("*.yaml"))]
COMMANDS = typed(r"-m (eldenet\.\w+[^`\n|]*)", TYPED_IN)
COMMANDS += typed(rf"(?:^|[`\n]|# )(eldenet (?:{'|'.join(ELDENET)})\b[^`\n|]*)", TYPED_IN)


@pytest.mark.parametrize("line", COMMANDS, ids=lambda line: line[-60:])
def test_every_documented_command_has_settings_that_exist(line):
    line = re.sub(r"\$\w+", "0", line)  # a variable of the shell
    name, *arguments = shlex.split(re.sub("^eldenet ", "eldenet.", line))
    if name == "eldenet.data.prepare":
        assert arguments[0] == "nyu_labelled"  # it has no config; tests/data/test_prepare.py runs it
        return
    sweep = "-m" in arguments
    overrides = []
    for argument in arguments:
        if argument in ("...", "job") or argument.startswith("-"):
            continue
        if name == "eldenet.check-data" and "=" not in argument:
            argument = f"folder={argument}"
        if argument == "my_configs" or argument.endswith("backbone=mine"):
            continue  # made by the project in test_packaging.py
        if argument.startswith(("hydra/launcher=", "hydra.launcher.", "+hydra.launcher.")):
            continue  # need the [cluster] extra
        key, _, value = argument.partition("=")
        overrides.append(f"{key}={value.split(',')[0]}" if sweep else argument)
    assert composed(name.removeprefix("eldenet."), overrides) is not None


def test_documented_scripts_options_and_extras_exist():
    sources = "".join(file.read_text() for file in (REPOSITORY / "experiments").rglob("*.py"))
    for line in typed(r"python3? (experiments/[\w/]+\.py[^`\n|]*)", PAGES):
        script, *arguments = shlex.split(line)
        assert (REPOSITORY / script).is_file()
        for option in {argument.split("=")[0] for argument in arguments if argument.startswith("--")}:
            assert option == "--help" or f'"{option}"' in sources, f"{script} has no option {option}"
    extras = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for named in typed(r"pip install [^\n`]*\[([\w,]+)\]", PAGES):
        assert set(named.split(",")) <= set(extras)


def anchors(page: Path) -> set[str]:
    """The names under which GitHub links to the headings of a page."""
    lines = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page.read_text(), flags=re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in lines}


def test_links_lead_to_files_and_headings_that_exist():
    for page in PAGES:
        for link in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", page.read_text(), flags=re.S)):
            path, _, anchor = link.partition("#")
            target = page.parent / path if path else page
            if not link.startswith("http"):
                assert target.exists(), f"{page.relative_to(REPOSITORY)}: {link}"
                assert not anchor or anchor in anchors(target), f"{page.relative_to(REPOSITORY)}: {link}"


@pytest.mark.parametrize(
    "page", ["README.md", "docs/index.md", "docs/concepts.md", "docs/results.md", "docs/training.md"]
)
def test_lines_and_tables_are_short(page):
    text = re.sub(r"<!-- source:.*?-->\n", "", (REPOSITORY / page).read_text(), flags=re.S)
    assert [line for line in text.splitlines() if len(line) > 120] == []
    for table in re.findall(r"(?:^\|.*\n)+", text, re.M):
        assert table.count("\n") - 2 <= 8, table


def python_blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (REPOSITORY / page).read_text(), re.S)


def test_the_readme_snippet_runs(monkeypatch, tmp_path):
    monkeypatch.chdir(REPOSITORY)
    (block,) = python_blocks("README.md")
    names: dict = {}
    exec(block.replace('"depths"', f'"{tmp_path}"'), names)
    assert 0.5 < np.median(names["result"].depth) < 5  # a kitchen [m]
    assert (tmp_path / "example_depth.png").is_file()


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


def test_the_training_loop_of_another_project_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    layouts.folder(tmp_path / "my_frames")
    names: dict = {}
    exec(python_blocks("docs/use_from_elsewhere.md")[2], names)
    assert 0 < names["metrics"].compute()["abs_rel"] < 100
    assert any(parameter.grad.any() for parameter in names["decoder"].parameters())
    names["model"].save_pretrained("saved")
    assert eldenet.load("saved")(names["batch"]["image"]).shape == (4, 1, 96, 128)


def test_the_snippet_of_uncertainty_runs():
    (block,) = python_blocks("docs/uncertainty.md")
    names: dict = {}
    exec(block, names)
    assert names["estimate"].sigma.shape == names["low"].shape == (96, 128)


def test_the_snippets_of_deploy_run(tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    import eldenet
    from eldenet.deploy import runtimes
    from eldenet.deploy.metadata import describe
    from eldenet.deploy.onnx_export import write_onnx

    monkeypatch.chdir(tmp_path)
    model = eldenet.load("eldenet_s")
    write_onnx(model, "exports/indoor.onnx", (32, 64), opset=17, metadata=describe(model, "indoor", (32, 64)))
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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "size"),
    # without a canonical camera, with one, and told the lens
    [("eldenet_rooms", (96, 128)), (None, (96, 128)), ("eldenet_indoor", (152, 200))],
)
def test_the_snippet_of_embedded_gives_what_predict_gives(name, size, tmp_path, monkeypatch):
    """A board without eldenet prepares the frame as the package does."""
    pytest.importorskip("onnxruntime")
    import cv2
    import skimage
    from support.networks import small_net

    import eldenet
    from eldenet.deploy.metadata import describe
    from eldenet.deploy.onnx_export import write_onnx

    monkeypatch.chdir(tmp_path)
    model = eldenet.load(name) if name else small_net(canonical_focal=0.8, canonical_width=size[1])
    write_onnx(model, "board.onnx", size, batch=1, metadata=describe(model, "board", size))
    cv2.imwrite("photo.jpg", skimage.data.coffee()[:, :533])  # of the aspect that the network was trained at
    (block,) = python_blocks("docs/embedded.md")
    names: dict = {}
    exec(block, names)
    lens = None if model.canonical_px is None else (names["fx"], names["fx"], 266.0, 200.0)
    expected = eldenet.DepthPredictor(model, input_size=size)(names["frame"], intrinsics=lens)
    assert names["depth"].shape == expected.shape == names["frame"].shape[:2]
    np.testing.assert_allclose(names["depth"], expected, rtol=1e-3, atol=1e-3)


def test_the_snippets_of_navigation_run():
    """All of a page's Python in one program, top to bottom, as a reader would paste it."""
    pytest.importorskip("gymnasium")
    names: dict = {}
    for block in python_blocks("docs/navigation.md"):
        if "stable_baselines3" in block and find_spec("stable_baselines3") is None:
            continue
        exec(compile(block, "docs/navigation.md", "exec"), names)
    assert names["envs"].num_envs == 16


def test_the_snippets_of_robot_run(tmp_path, monkeypatch):
    for library in ("onnx", "onnxruntime"):
        pytest.importorskip(library)
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in python_blocks("docs/robot.md"):
        exec(compile(block, "docs/robot.md", "exec"), names)
    assert 0 <= names["speed"] <= ROBOT.max_speed
    assert abs(names["turn"]) <= ROBOT.max_turn
    assert (tmp_path / "driver.onnx").is_file()


def test_security_states_the_limits_of_the_code():
    limits = (REPOSITORY / "SECURITY.md").read_text().partition("## Limits")[2].partition("\n## ")[0]
    for name in re.findall(r"`[\w.]*?([A-Z_]{4,})`", limits):
        assert any(hasattr(module, name) for module in (files, checks)), name
    assert array_files.PIXEL_VARIABLE in limits
    for amount in (
        f"{array_files.MOST_PIXELS // 1_000_000} million pixels",
        *(f"{most // 1_000_000} MB" for most in (files.MOST_YAML, files.MOST_TEXT)),
        *(f"{files.DEEPEST} levels", f"{checks.LARGEST_SIDE:,} px"),
    ):
        assert f"| {amount}" in limits, amount


def test_new_names_of_moved_modules_exist():
    rows = re.findall(
        r"^\| `eldenet\.[^|]+\|([^|]+)\|$", (REPOSITORY / "CHANGELOG.md").read_text(), re.MULTILINE
    )
    assert len(rows) > 10
    for row in rows:
        parent = ""
        for name in re.findall(r"`([\w.]+)", row):
            parent, _, last = (name if "." in name else f"{parent}.{name}").rpartition(".")
            resolve_name(f"{parent}.{last}")

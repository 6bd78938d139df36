"""The packages keep their order, and an import costs what it must."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import torch

from eldenet.backbones.pplcnet import PPLCNet
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.heads import LinearHead
from eldenet.model import DepthNet

PACKAGE = Path(__file__).parents[1] / "eldenet"
FILES = sorted(PACKAGE.rglob("*.py"))

# Bottom up. A module imports from its own package and from the lines above its own, never from its line.
ORDER = """
types configurable uncertainty
system layers
compose weights
geometry heads
boxes ray_features refinement losses visualization
backbones decoders
baselines model
simulation zoo
data
evaluation
results
training
deploy
perception
navigation
cli
train evaluate
studies
adapt predict export benchmark report study check_data navigate demo __main__
"""
FLOOR_OF = {name: floor for floor, line in enumerate(ORDER.split("\n")) for name in line.split()}
COMMANDS = [name for name in ORDER.partition("\ncli\n")[2].split() if name not in ("__main__", "studies")]
HIGHEST_HOUSE = 11  # floors of packages and top-level modules, by the longest chain of imports
MOST_FILES, MOST_FOLDERS = 26, 15  # at the top of the package; weights/ and configs/ hold no code


def room_of(module: str) -> str:
    """``eldenet.data.nyu`` is of "data", ``eldenet.model`` of "model"."""
    return module.split(".")[1] if "." in module else "__init__"


def module_of(file: Path) -> str:
    parts = file.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(file) for file in FILES}


def imported_modules(file: Path, *, typing: bool = True) -> Iterator[tuple[int, str]]:
    """Line and module of every import, in functions too; ``typing``: those for type checkers too."""
    tree = ast.parse(file.read_text())
    if not typing:
        for node in ast.walk(tree):
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                node.body = [ast.Pass()]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}:{node.lineno}: relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield node.lineno, whole if whole in MODULES else str(node.module)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name


def own_imports(file: Path, *, typing: bool = True) -> list[tuple[int, str]]:
    """Imports from the package, without ``import eldenet``: the lazy public names."""
    return [(line, name) for line, name in imported_modules(file, typing=typing) if "eldenet." in name]


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_imports_go_down(file: Path) -> None:
    room = room_of(module_of(file))
    if room == "__init__":
        return  # the public names, each loaded when it is first used
    assert room in FLOOR_OF, f"{room} has no place in ORDER"
    for line, name in own_imports(file):
        other = room_of(name)
        assert other == room or FLOOR_OF[other] < FLOOR_OF[room], f"{file}:{line}: {room} imports {other}"


def test_modules_of_a_package_import_each_other_in_one_direction() -> None:
    graph = {
        module_of(file): {name for _, name in own_imports(file, typing=False)} & MODULES for file in FILES
    }
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, f"imports run in a circle: {' -> '.join((*path, module))}"
        if module not in done:
            for other in sorted(graph[module] - {module}):
                visit(other, (*path, module))
            done.add(module)

    for module in sorted(graph):
        visit(module, ())


def test_the_house_stays_low_and_its_top_floor_short() -> None:
    rooms: dict[str, set[str]] = {}
    for file in FILES:
        room = room_of(module_of(file))
        if room != "__init__":
            rooms.setdefault(room, set()).update(room_of(name) for _, name in own_imports(file))

    @cache
    def floor(room: str) -> int:
        return 1 + max((floor(other) for other in rooms[room] - {room}), default=0)

    assert max(map(floor, rooms)) <= HIGHEST_HOUSE
    top = [file for file in PACKAGE.glob("*.py") if file.stem != "__main__"]
    folders = [
        folder
        for folder in PACKAGE.iterdir()
        if (folder / "__init__.py").is_file() and folder.name != "weights"
    ]
    assert (len(top) <= MOST_FILES, len(folders) <= MOST_FOLDERS) == (True, True)


def test_the_architecture_page_names_every_package_and_module_at_the_top() -> None:
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text()
    named = set(re.findall(r"`(\w+)/?`", page))
    assert set(FLOOR_OF) - named == set()
    assert set(FLOOR_OF) == {room_of(module_of(file)) for file in FILES} - {"__init__"}


def test_the_config_ends_in_one_module() -> None:
    """Only ``compose.py`` and the command line name OmegaConf; a command gets plain values."""
    for file in FILES:
        text, room = file.read_text(), room_of(module_of(file))
        if room in ("compose", "cli"):
            continue
        typed = re.sub(r"if TYPE_CHECKING:\n(    .*\n|\n)+", "", text)
        found = re.search(r"\b(from|import) (hydra|omegaconf)\b|OmegaConf", typed)
        assert not found, f"{file}: {found and found.group(0)}"
        assert "DictConfig" not in text or room in COMMANDS, f"{file} names DictConfig"


# --- what an import costs ---


def loaded_after(code: str) -> set[str]:
    """Top-level modules that a fresh Python holds after ``code``."""
    result = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert result.returncode == 0, result.stderr
    return {name.partition(".")[0] for name in result.stdout.split()}


HEAVY = {"accelerate", "albumentations", "cv2", "gymnasium", "hydra", "kornia", "matplotlib", "mujoco"}
HEAVY |= {"omegaconf", "rich", "scipy", "skimage", "tensorboard", "timm", "torchmetrics", "torchvision"}


def test_importing_eldenet_loads_nothing_heavy() -> None:
    loaded = loaded_after("import eldenet; eldenet.__version__; dir(eldenet)")
    assert loaded & (HEAVY | {"torch", "numpy"}) == set()


def test_the_public_class_needs_torch_alone() -> None:
    assert loaded_after("from eldenet import DepthNet") & HEAVY == set()


def test_loading_a_saved_model_stays_light(tmp_path: Path) -> None:
    torch.manual_seed(0)
    DepthNet.from_parts(PPLCNet(0.25), FastUpConvDecoder, LinearHead()).save_pretrained(tmp_path)
    assert (
        loaded_after(f"import eldenet; eldenet.DepthNet.from_pretrained({str(tmp_path)!r})") & HEAVY == set()
    )
    by_name = loaded_after(f"import eldenet; eldenet.load({str(tmp_path)!r})")
    assert by_name & HEAVY <= {"hydra", "omegaconf"}


def test_commands_start_without_torch() -> None:
    assert "torch" not in loaded_after("import " + ", ".join(f"eldenet.{command}" for command in COMMANDS))

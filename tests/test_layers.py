"""The house keeps its floors: who may import whom, and what an import costs."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from eldenet.backbones.pplcnet import PPLCNet
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.heads import LinearHead
from eldenet.model import DepthNet

PACKAGE = Path(__file__).parents[1] / "eldenet"
LONGEST_FILE = 320  # lines

# A file or package may import from its own layer and from those below it; in layer 2 from those below alone.
LAYERS = {
    0: "types configurable robot bootstrap stopping",
    1: "boxes layers geometry heads protocol refinement resources modes",
    2: "backbones decoders baselines losses data simulation",
    3: "model metrics",
    4: "averaging benchmarking checkpoint comparison evaluation exporting folding legend meter normalization "
    "pictures pointcloud predictions predictor profiling quantization record runlog runtimes schedules "
    "sources tables written",
    5: "trainer",
    6: "perception",
    7: "navigation",
    8: "config usage command zoo scoring resuming report "  # these, and the entry points, see everything
    "studies study train evaluate benchmark benchmark_rows benchmark_tables predict predict_boxes "
    "predict_videos export check_data train_detector navigate",
}
LAYER_OF = {name: layer for layer, names in LAYERS.items() for name in names.split()}
# the rendered data sets; whole networks share helpers with the parts
SIBLINGS_THAT_MAY = {("data", "simulation"), ("baselines", "backbones"), ("baselines", "decoders")}

FILES = sorted(PACKAGE.rglob("*.py"))


def part_of(file: Path) -> str:
    """``eldenet/data/nyu.py`` is of "data", ``eldenet/model.py`` of "model"."""
    return file.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(file: Path) -> Iterator[tuple[int, str]]:
    """Line and part of every import from eldenet, those inside functions too."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}:{node.lineno}: relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        for name in names:
            root, _, rest = name.partition(".")
            if root == "eldenet" and rest != "__version__":
                yield node.lineno, rest.partition(".")[0]


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_imports_go_down(file: Path) -> None:
    part = part_of(file)
    if part == "__init__":
        return  # the public names, each loaded when it is first used
    assert part in LAYER_OF, f"{part} has no layer: give it one in the table above"
    for line, other in imports(file):
        where = f"{file.name}:{line}: {part} (layer {LAYER_OF[part]}) imports {other or 'eldenet'}"
        assert LAYER_OF.get(other, 8) <= LAYER_OF[part], where
        if LAYER_OF[part] == 2 and other != part and (part, other) not in SIBLINGS_THAT_MAY:
            assert LAYER_OF[other] < 2, f"{where}, a sibling"


def test_the_architecture_page_names_every_module() -> None:
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| (\d) \| (.*) \|$", page, re.M)
    named = {(int(layer), name) for layer, row in rows for name in re.findall(r"`(\w+)`", row)}
    assert named == {(layer, name) for name, layer in LAYER_OF.items()}
    assert set(LAYER_OF) == {part_of(file) for file in FILES} - {"__init__"}


def test_hydra_and_omegaconf_stay_on_the_top_floor() -> None:
    for file in FILES:
        tree = ast.parse(file.read_text())
        in_signatures = {
            id(child)
            for node in ast.walk(tree)
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
            for child in ast.walk(node)
        }
        modules = {
            (node.module or "") if isinstance(node, ast.ImportFrom) else node.names[0].name
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom) and id(node) not in in_signatures
        }
        found = {name for name in modules if name.partition(".")[0] in ("hydra", "omegaconf")}
        assert not found or LAYER_OF[part_of(file)] == 8, f"{file.name} imports {found}"


def test_no_file_is_too_long() -> None:
    lengths = {str(file.relative_to(PACKAGE)): len(file.read_text().splitlines()) for file in FILES}
    assert {name: length for name, length in lengths.items() if length > LONGEST_FILE} == {}


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

"""Saved models from other people: no code in them runs, and damage is named."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.networks import small_net

import eldenet
from eldenet.backbones.resnet import ResNet
from eldenet.model import DepthNet


@pytest.fixture
def foreign_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module that leaves a file behind when it is imported."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "somebodys_parts.py").write_text(
        "from pathlib import Path\n"
        f"Path({str(tmp_path / 'mark')!r}).touch()\n"
        "from eldenet.heads import LinearHead\n"
        "class TheirHead(LinearHead):\n    pass\n"
        "def function(**_):\n    raise SystemExit\n"
    )
    monkeypatch.syspath_prepend(folder)
    yield "somebodys_parts"
    sys.modules.pop("somebodys_parts", None)


def rewrite(folder: Path, change: Any) -> None:
    path = folder / "config.json"
    content = json.loads(path.read_text())
    content.pop("sha256", None)  # as in models of earlier versions
    change(content)
    path.write_text(json.dumps(content))


def nodes(value: Any) -> Iterator[dict[str, Any]]:
    """Every mapping with a ``_target_``, outermost first."""
    if isinstance(value, dict):
        if "_target_" in value:
            yield value
        for item in value.values():
            yield from nodes(item)


HOSTILE = [
    # outside the trusted modules
    *("os.system", "eval", "", "torch.load", "functools.partial", "somebodys_parts.TheirHead"),
    *("eldenet.configurable.instantiate", "eldenet.training.trainer.Trainer", "eldenet.headsX.Head"),
    # what the trusted modules import, and functions in them
    *("eldenet.model.json.loads", "eldenet.model.json.codecs.open", "eldenet.model.torch.load"),
    *("eldenet.model.torch", "eldenet.model.Path", "eldenet.heads.nn.Linear", "eldenet.model.build"),
    *("eldenet.model.DepthNet.from_pretrained", "eldenet.model.DepthNet.__init__"),
    *("eldenet.backbones.weights.read_weights", "eldenet.backbones.weights.download_from_hub"),
    # no modules
    *("eldenet.heads..LinearHead", "eldenet.backbones.nothing.Here", "..heads.LinearHead"),
]


@pytest.mark.parametrize("place", range(5))
def test_foreign_targets_are_refused_wherever_they_stand(
    place: int, saved: Path, foreign_module: str
) -> None:
    rewrite(saved, lambda content: content["model"].pop("refine"))
    whole = (saved / "config.json").read_text()
    DepthNet.from_pretrained(saved)  # what any load imports
    before = set(sys.modules)
    for target in HOSTILE:
        content = json.loads(whole)
        places = list(nodes(content["model"]))
        assert len(places) == 5  # DepthNet, EncoderDecoder, backbone, decoder, head
        places[place]["_target_"] = target
        (saved / "config.json").write_text(json.dumps(content))
        with pytest.raises(ValueError, match=r"refused to build|cannot build"):
            DepthNet.from_pretrained(saved)
    assert foreign_module not in sys.modules
    assert not (saved.parent / "mark").exists()
    assert {name for name in set(sys.modules) - before if not name.startswith("eldenet")} == set()


def test_foreign_targets_are_refused_however_deep(saved: Path, foreign_module: str) -> None:
    hostile: Any = {"_target_": f"{foreign_module}.TheirHead"}
    for level in range(30):
        hostile = [hostile] if level % 2 else {"deeper": hostile}
    rewrite(saved, lambda content: content["model"]["head"].update(min_depth=hostile))
    with pytest.raises(ValueError, match=r"refused to build 'somebodys_parts\.TheirHead'"):
        DepthNet.from_pretrained(saved)
    assert foreign_module not in sys.modules


def test_a_module_that_the_user_trusts_is_imported(saved: Path, foreign_module: str) -> None:
    rewrite(saved, lambda content: content["model"]["head"].update(_target_="somebodys_parts.TheirHead"))
    with pytest.raises(ValueError, match=r"add 'trusted_modules=\[[\w.]+\]' \(in Python trusted_modules=\['"):
        eldenet.load(saved)
    with pytest.raises(ValueError, match="refused to build"):
        eldenet.load(saved, trusted_modules=["somebodys", "somebodys_parts.more"])
    with pytest.raises(ValueError, match=r"give a list, \['somebodys_parts'\]"):
        eldenet.load(saved, trusted_modules="somebodys_parts")
    assert not (saved.parent / "mark").exists()
    model = eldenet.load(saved, trusted_modules=["somebodys_parts"])
    assert type(model.head).__name__ == "TheirHead"
    assert (saved.parent / "mark").exists()
    rewrite(saved, lambda content: content["model"]["head"].update(_target_="somebodys_parts.function"))
    with pytest.raises(ValueError, match="not a Configurable class of somebodys_parts"):
        eldenet.load(saved, trusted_modules=["somebodys_parts"])


@pytest.mark.parametrize("pretrained", [True, "/etc/hostname", "IMAGENET1K_V1"])
def test_a_saved_model_cannot_fetch_weights(
    pretrained: bool | str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("something was fetched or read")

    monkeypatch.setattr("eldenet.backbones.resnet.load_torchvision_weights", never)
    folder = small_net(backbone=ResNet(18)).save_pretrained(tmp_path)
    rewrite(folder, lambda content: content["model"]["network"]["backbone"].update(pretrained=pretrained))
    with pytest.raises(ValueError, match="refused pretrained="):
        eldenet.load(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: content.pop("model"), "not an eldenet model folder: config.json has no entry"),
        (lambda content: content.update(model=None), "describes a NoneType, not a DepthNet"),
        (lambda content: content["model"].update(_partial_=True), "describes a partial, not a DepthNet"),
        (lambda content: content["model"]["network"].update(decoder=7), "EncoderDecoder does not fit"),
        (lambda content: content["model"]["head"].update(max_depth="far"), "LinearHead does not fit"),
        (lambda content: content["model"]["head"].update(max_depth=-1), "0 < min_depth < max_depth"),
        (lambda content: content["model"]["head"].update(color="red"), "LinearHead does not fit.*color"),
        (lambda content: content["model"]["network"]["backbone"].update(scale=0.5), "safetensors do not fit"),
    ],
)
def test_damage_in_a_config_is_named(change: Any, message: str, saved: Path) -> None:
    rewrite(saved, change)
    with pytest.raises(ValueError, match=message):
        DepthNet.from_pretrained(saved)


@pytest.mark.parametrize("name", ["config.json", "model.safetensors"])
def test_missing_files_are_named(name: str, saved: Path) -> None:
    (saved / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"not an eldenet model folder: it has no {name}"):
        eldenet.load(saved)

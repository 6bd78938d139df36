"""Every changed bit of weights, checkpoints and policies is noticed when they are loaded."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from support.damages import flips_and_cuts, refusal
from support.networks import small_net
from torch import Tensor

import eldenet
from eldenet.backbones.weights import read_weights
from eldenet.navigation.policy import Navigator
from eldenet.navigation.qnetwork import QNetwork
from eldenet.navigation.range_errors import RangeErrors
from eldenet.weights import PACKAGED, list_weights

State = dict[str, Tensor]


def model(folder: Path) -> Callable[[], State]:
    small_net().save_pretrained(folder, info={"input_size": [64, 96]})
    return lambda: eldenet.load(folder).state_dict()


def state_dict(folder: Path) -> Callable[[], State]:
    torch.save({"weight": torch.randn(100, 100)}, folder / "weights.pt")
    return lambda: read_weights(folder / "weights.pt")


def policy(folder: Path) -> Callable[[], State]:
    observer = Navigator.load().observer
    network = QNetwork(observer.size, observer.actions, (8,))
    Navigator(network, observer.trained_with).save(folder / "policy.safetensors")
    return lambda: Navigator.load(folder / "policy.safetensors").network.state_dict()


@pytest.mark.parametrize(
    ("write", "name"),
    [
        (model, "model.safetensors"),
        (model, "config.json"),
        (state_dict, "weights.pt"),
        (policy, "policy.safetensors"),
    ],
)
def test_a_changed_bit_is_noticed(
    write: Callable[[Path], Callable[[], State]], name: str, tmp_path: Path
) -> None:
    read, path = write(tmp_path), tmp_path / name
    expected = read()
    for content in flips_and_cuts(path.read_bytes()):
        path.write_bytes(content)
        said = refusal(read)
        if said is None:  # in white space, in the digest's own name or between the entries of a zip file
            found = read()
            assert all(torch.equal(found[name], value) for name, value in expected.items())
        else:
            assert str(path) in said


def test_a_model_without_digests_loads_as_before(tmp_path: Path) -> None:
    read = model(tmp_path)
    content = json.loads((tmp_path / "config.json").read_text())
    del content["sha256"]
    (tmp_path / "config.json").write_text(json.dumps(content))
    assert read().keys() == small_net().state_dict().keys()


@pytest.mark.parametrize("size", ["7", [1e6, 1e6], [0, 5], [64], {"a": 1}, [10**6, 10**6], True])
def test_an_odd_size_in_a_config_is_named(size: Any, tmp_path: Path) -> None:
    small_net().save_pretrained(tmp_path)
    content = json.loads((tmp_path / "config.json").read_text())
    del content["sha256"]
    (tmp_path / "config.json").write_text(json.dumps(content | {"info": {"input_size": size}}))
    with pytest.raises(ValueError, match=r"config\.json: input_size of info=.*\[height, width\]"):
        eldenet.load(tmp_path)


def test_weights_that_are_not_finite_do_not_load(tmp_path: Path) -> None:
    broken = small_net()
    with torch.no_grad():
        next(broken.parameters()).view(-1)[:2] = torch.tensor([float("nan"), float("inf")])
    broken.save_pretrained(tmp_path)
    torch.save(broken.state_dict(), tmp_path / "weights.pth")
    for read in (lambda: eldenet.load(tmp_path), lambda: read_weights(tmp_path / "weights.pth")):
        with pytest.raises(ValueError, match=r"not finite \(network\..*; 1 of \d+ tensors\): the training"):
            read()


def test_the_packaged_files_match_their_digests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list_weights():
        config = json.loads((PACKAGED / name / "config.json").read_text())
        assert set(config["sha256"]) == {"config", "weights"}
    monkeypatch.setattr("eldenet.weights.PACKAGED", tmp_path)
    readers = {"arena_dqn.safetensors": Navigator.load, "arena_range_errors.json": RangeErrors.read}
    for name in ("SHA256SUMS", *readers):
        shutil.copy(PACKAGED / name, tmp_path)
    for name, read in readers.items():
        read(tmp_path / name)
        (tmp_path / name).write_bytes(flips_and_cuts((PACKAGED / name).read_bytes(), 1, 0)[0])
        with pytest.raises(ValueError, match=f"{name} is damaged .*install eldenet again"):
            read(tmp_path / name)

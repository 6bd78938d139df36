"""Every changed bit of weights, checkpoints and policies is noticed when they are loaded."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.damages import refusal
from support.networks import same_model, small_net

import eldenet
from eldenet.backbones.weights import read_weights
from eldenet.navigation.policy import Navigator
from eldenet.navigation.qnetwork import QNetwork
from eldenet.navigation.range_errors import RangeErrors
from eldenet.weights import PACKAGED, list_weights


def flips(content: bytes, count: int, first: int = 0) -> list[bytes]:
    """Copies with one changed bit each."""
    generator, found = np.random.default_rng(0), []
    for _ in range(count):
        copy = bytearray(content)
        copy[generator.integers(first, len(copy))] ^= 1 << int(generator.integers(8))
        found.append(bytes(copy))
    return found


def cuts(content: bytes, count: int) -> list[bytes]:
    return [content[:end] for end in np.random.default_rng(1).integers(0, len(content), count)]


def test_a_changed_bit_of_a_saved_model_is_noticed(tmp_path: Path) -> None:
    model = small_net()
    model.save_pretrained(tmp_path, info={"input_size": [64, 96]})
    for name in ("model.safetensors", "config.json"):
        path = tmp_path / name
        whole = path.read_bytes()
        for content in [*flips(whole, 40), *cuts(whole, 10)]:
            path.write_bytes(content)
            said = refusal(lambda: eldenet.load(tmp_path))
            if said is None:  # in the digest's own name, or in white space
                assert name == "config.json"
                assert same_model(eldenet.load(tmp_path), model)
                assert eldenet.load(tmp_path).info == {"input_size": [64, 96]}
            else:
                assert name in said or "config.json" in said
        path.write_bytes(whole)
    assert same_model(eldenet.load(tmp_path), model)


def test_a_model_without_digests_loads_as_before(tmp_path: Path) -> None:
    model = small_net()
    model.save_pretrained(tmp_path)
    content = json.loads((tmp_path / "config.json").read_text())
    del content["sha256"]
    (tmp_path / "config.json").write_text(json.dumps(content))
    assert same_model(eldenet.load(tmp_path), model)


@pytest.mark.parametrize("size", ["7", [1e6, 1e6], [0, 5], [64], {"a": 1}, [10**6, 10**6], True])
def test_an_odd_size_in_a_config_is_named(size: Any, tmp_path: Path) -> None:
    small_net().save_pretrained(tmp_path, info={"input_size": size})
    with pytest.raises(ValueError, match=r"config\.json: input_size of info is .*\[height, width\]"):
        eldenet.load(tmp_path)


def test_the_packaged_files_match_their_digests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list_weights():
        assert set(json.loads((PACKAGED / name / "config.json").read_text())["sha256"]) == {
            "config",
            "weights",
        }
    monkeypatch.setattr("eldenet.weights.PACKAGED", tmp_path)
    readers = {"arena_dqn.safetensors": Navigator.load, "arena_range_errors.json": RangeErrors.read}
    for name in ("SHA256SUMS", *readers):
        shutil.copy(PACKAGED / name, tmp_path)
    for name, read in readers.items():
        read(tmp_path / name)
        (tmp_path / name).write_bytes(flips((PACKAGED / name).read_bytes(), 1)[0])
        with pytest.raises(ValueError, match=f"{name} is damaged .*install eldenet again"):
            read(tmp_path / name)


def test_a_changed_bit_of_a_state_dict_is_noticed(tmp_path: Path) -> None:
    state = {"weight": torch.randn(100, 100)}
    path = tmp_path / "weights.pt"
    torch.save(state, path)
    whole = path.read_bytes()
    for content in [*flips(whole, 40), *cuts(whole, 10)]:
        path.write_bytes(content)
        said = refusal(lambda: read_weights(path))
        if said is None:  # between the zip's entries
            assert torch.equal(read_weights(path)["weight"], state["weight"])
        else:
            assert str(path) in said


def policy(path: Path) -> Path:
    observer = Navigator.load().observer
    network = QNetwork(observer.size, observer.actions, (8,))
    Navigator(network, observer.trained_with).save(path)
    return path


def test_a_changed_bit_of_a_policy_is_noticed(tmp_path: Path) -> None:
    path = policy(tmp_path / "policy.safetensors")
    state = Navigator.load(path).network.state_dict()
    whole = path.read_bytes()
    for content in [*flips(whole, 40), *cuts(whole, 10)]:
        path.write_bytes(content)
        said = refusal(lambda: Navigator.load(path))
        if said is None:
            same = Navigator.load(path).network.state_dict()
            assert all(torch.equal(same[name], value) for name, value in state.items())
        else:
            assert str(path) in said


@pytest.mark.parametrize(
    "change",
    [{"members": 10**9}, {"hidden": [10**9]}, {"inputs": "7"}, {"observer": None}, {"observer": {"a": 1}}],
)
def test_odd_notes_of_a_policy_are_named(change: dict[str, Any], tmp_path: Path) -> None:
    from safetensors import safe_open
    from safetensors.torch import load_file, save_file

    path = policy(tmp_path / "policy.safetensors")
    with safe_open(path, framework="pt") as file:
        notes = json.loads(file.metadata()["navigator"])
    del notes["sha256"]
    save_file(load_file(path), path, metadata={"navigator": json.dumps(notes | change)})
    with pytest.raises(ValueError, match=rf"{path} is truncated or not a valid navigation policy"):
        Navigator.load(path)

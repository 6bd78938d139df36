"""Models from the Hugging Face Hub and from torch.hub."""

import importlib.util
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from support.networks import picture, same_model, small_net

import eldenet
from eldenet.model import DepthNet

REPOSITORY = Path(__file__).parents[1]


def test_an_unreachable_hub_fails_within_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    def offline(*_: Any, **__: Any) -> str:
        raise ConnectionError("no route to host")

    monkeypatch.setattr("huggingface_hub.snapshot_download", offline)
    start = time.perf_counter()
    wanted = (
        r"^there is no folder somebody/depth, and the Hub does not give it \(ConnectionError\): give a run"
    )
    with pytest.raises(FileNotFoundError, match=wanted):
        eldenet.load("somebody/depth")
    assert time.perf_counter() - start < 5


def test_a_hub_that_stalls_ends_and_a_slow_one_does_not(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    monkeypatch.setattr("eldenet.backbones.weights.STALLED", 0.4)

    def slow(repo_id: str, **options: Any) -> str:
        arriving = tmp_path / "models--somebody--depth/blobs/a.incomplete"
        arriving.parent.mkdir(parents=True)
        for count in range(5):
            arriving.write_bytes(bytes(count + 1))
            time.sleep(0.25)
        return str(saved)

    monkeypatch.setattr("huggingface_hub.snapshot_download", slow)
    assert same_model(eldenet.load("somebody/depth"), eldenet.load(saved))
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **__: time.sleep(60))
    with pytest.raises(
        FileNotFoundError, match=r"does not give it \(nothing arrived for 0.4 s\): give a run"
    ):
        eldenet.load("somebody/depth")


def test_a_hub_id_loads_like_a_folder(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def download(repo_id: str, **options: Any) -> str:
        asked.update(options, repo_id=repo_id)
        return str(saved)

    monkeypatch.setattr("huggingface_hub.snapshot_download", download)
    model = eldenet.load("somebody/depth", revision="v2")
    assert same_model(model, DepthNet.from_pretrained(saved))
    assert asked == {
        "repo_id": "somebody/depth", "revision": "v2", "allow_patterns": ["config.json", "model.safetensors"],
    }  # fmt: skip
    (saved / "model.safetensors").unlink()
    with pytest.raises(FileNotFoundError, match=r"not an eldenet model folder: it has no model\.safetensors"):
        eldenet.load("somebody/depth")


@pytest.mark.parametrize("source", ["/no/such/folder", "a/b/c", "./nothing/here"])
def test_missing_paths_are_not_looked_up_on_the_hub(source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda *_, **__: pytest.fail("asked the Hub"))
    with pytest.raises(FileNotFoundError, match="neither a local folder nor a Hub id"):
        eldenet.load(source)


def test_push_uploads_config_and_weights(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls: list[tuple[str, Any]] = []

    class Api:
        def __init__(self, token: str | None = None) -> None:
            calls.append(("token", token))

        def create_repo(self, repo_id: str, **options: Any) -> None:
            calls.append(("create", (repo_id, options)))

        def upload_folder(self, *, repo_id: str, folder_path: str) -> str:
            files = {path.name: path.read_bytes() for path in Path(folder_path).iterdir()}
            calls.append(("upload", (repo_id, files)))
            return f"https://hub/{repo_id}/commit/1"

    monkeypatch.setattr("huggingface_hub.HfApi", Api)
    model = small_net()
    assert model.push_to_hub("me/depth", private=True, info={"a": 1}) == "https://hub/me/depth/commit/1"
    assert calls[:2] == [("token", None), ("create", ("me/depth", {"private": True, "exist_ok": True}))]
    repository, files = calls[2][1]
    assert repository == "me/depth"
    assert set(files) == {"config.json", "model.safetensors", "README.md"}
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    assert same_model(DepthNet.from_pretrained(tmp_path), model)


def test_torch_hub_offers_every_model_with_a_description(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = importlib.util.spec_from_file_location("hubconf", REPOSITORY / "hubconf.py")
    hubconf = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hubconf)
    # torch.hub.list's own rule
    public = [name for name in dir(hubconf) if callable(getattr(hubconf, name)) and not name.startswith("_")]
    assert sorted(public) == sorted([*eldenet.list_models(), *eldenet.list_weights()])
    assert all(getattr(hubconf, name).__doc__ for name in public)

    monkeypatch.setattr(sys, "path", sys.path[:])
    options = {"repo_or_dir": str(REPOSITORY), "source": "local", "model": "eldenet_s"}
    model = torch.hub.load(**options, overrides=["model.head.max_depth=4"])
    assert (type(model).__name__, model.head.max_depth, model.training) == ("DepthNet", 4, False)
    assert model(picture(32, 48)).shape == (1, 1, 32, 48)
    trained = torch.hub.load(str(REPOSITORY), "eldenet_rooms", source="local")
    assert same_model(trained, eldenet.load("eldenet_rooms"))
    with pytest.raises(TypeError, match="pretrained"):
        torch.hub.load(**options, pretrained=True)

"""Shared by all tests: quiet threads, real data if the user has it, small data sets made on the spot."""

import gc
import os
from pathlib import Path

import pytest

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")

import torch

gc.disable()  # while tests are collected: their modules and libraries stay


def pytest_collection_finish() -> None:
    gc.freeze()  # a search need not walk through all libraries each time
    gc.enable()
    gc.set_threshold(100_000, 50, 100)  # torch's exporter makes millions of objects


@pytest.fixture(autouse=True, scope="session")
def _one_thread_per_test_process() -> None:
    torch.set_num_threads(1)


@pytest.fixture(autouse=True, scope="session")
def _less_waiting() -> None:
    from support.composing import compose_each_choice_once
    from support.onnx_operators import parse_operators_once
    from support.timings import short_timings

    short_timings()
    compose_each_choice_once()
    parse_operators_once()


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Rendered rooms, shared by the tests of one process."""
    return os.environ.get("ELDENET_CACHE") or str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="session")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small network as if trained at 32 x 64, for the tests of ``predict``."""
    from support.predicting import small_model

    return small_model(tmp_path_factory.mktemp("trained") / "model")


@pytest.fixture(scope="session")
def model(model_folder: Path):
    """The network in it."""
    import eldenet

    return eldenet.load(model_folder)


@pytest.fixture(scope="session")
def command_server(cache: str):
    """Started by the first test that runs a command."""
    from support.commands import CommandServer

    server = CommandServer({**os.environ, "ELDENET_CACHE": cache, "OMP_NUM_THREADS": "1"})
    yield server
    server.close()


@pytest.fixture
def run_command(tmp_path: Path, command_server):
    """Run ``python -m eldenet.<command>`` from another folder; returns the finished process."""

    def run(
        command: str,
        *arguments: str,
        cwd: Path | None = None,
        interrupt_at: str | None = None,
        **environment: str,
    ):
        place = cwd or tmp_path
        return command_server.run(
            f"eldenet.{command}", arguments, place, environment=environment, interrupt_at=interrupt_at
        )

    return run


@pytest.fixture
def tiny(tmp_path: Path, cache: str) -> Path:
    """The folder of a small study."""
    from support.tiny_study import write_tiny_study

    return write_tiny_study(tmp_path / "tiny", cache)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """A saved model with every kind of part."""
    from support.networks import small_net

    from eldenet.refinement import JointBilateral

    return small_net(refine=JointBilateral()).save_pretrained(tmp_path / "model")


@pytest.fixture
def store_folder(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A frame cache of the test's own."""
    folder = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("ELDENET_CACHE", str(folder))
    return folder / "frames"


@pytest.fixture(scope="session")
def views():
    """Rendered streets, shared by the tests of one process."""
    from eldenet.simulation.street_views import render_street

    return [render_street("test", index, (192, 624)) for index in range(4)]

"""Cores and memory of a machine or a container, and the resources that a run chooses."""

import errno
import os
import warnings
from pathlib import Path

import pytest
import torch

from eldenet.results.run_record import environment
from eldenet.system import resources
from eldenet.system.errors import line_of
from eldenet.system.resources import available_cores, available_memory, choose_resources


@pytest.fixture
def cgroup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(resources, "CGROUP", tmp_path)
    return tmp_path


def test_free_memory_of_a_container_is_its_limit_minus_its_use(cgroup: Path) -> None:
    whole = available_memory()
    assert whole > 2**20
    (cgroup / "memory.max").write_text("max\n")
    (cgroup / "memory.current").write_text("700000\n")
    assert available_memory() > 2**20
    (cgroup / "memory.max").write_text("1000000\n")
    assert available_memory() == 300_000
    (cgroup / "memory.stat").write_text("anon 400000\nfile 300000\ninactive_file 200000\n")
    assert available_memory() == 500_000  # the cache of inactive files counts as free
    (cgroup / "memory.current").write_text("1300000\n")
    assert available_memory() == 0


def test_memory_needs_no_sysconf_which_windows_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sysconf")
    assert environment()["hardware"]["memory_gb"] > 0.1


@pytest.mark.parametrize(
    ("quota", "cores"),
    [
        ("max 100000", 8),
        ("200000 100000", 2),
        ("150000 100000", 2),
        ("20000 100000", 1),
        ("900000 100000", 8),
    ],
)
def test_cores_are_limited_by_the_container_s_quota(
    quota: str, cores: int, cgroup: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert available_cores() == 8
    (cgroup / "cpu.max").write_text(f"{quota}\n")
    assert available_cores() == cores


def test_workers_take_the_cores_that_threads_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "available_cores", lambda: 32)
    monkeypatch.setattr(torch, "set_num_threads", lambda _: None)
    monkeypatch.setattr(resources, "check_torch_device", lambda _: None)
    chosen = [choose_resources(device=device, precision="fp32") for device in ("cpu", "cuda")]
    assert [(one.threads, one.workers) for one in chosen] == [(16, 16), (2, 30)]


def test_choosing_resources_turns_tf32_off() -> None:
    before = torch.backends.cudnn.allow_tf32
    try:
        torch.backends.cudnn.allow_tf32 = True
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            choose_resources(device="cpu", threads=1, workers=0)
        assert not torch.backends.cudnn.allow_tf32
        if hasattr(torch.backends.cudnn, "conv"):  # torch 2.9
            assert torch.backends.cudnn.conv.fp32_precision != "tf32"
        assert not torch.backends.cuda.matmul.allow_tf32
    finally:
        torch.backends.cudnn.allow_tf32 = before


def test_errors_that_name_no_file_say_what_to_do() -> None:
    said = {errno.EMFILE: "ulimit -n", errno.EROFS: "runtime.workers=0", errno.EFBIG: "ulimit -f"}
    for number, words in said.items():
        assert words in line_of(OSError(number, os.strerror(number)))
    assert line_of(OSError(errno.EROFS, "Read-only file system", "/a")).startswith("/a: Read-only")

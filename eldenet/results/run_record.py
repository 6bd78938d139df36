"""``run.json``, the record of a run (``score.py`` fills it): how it is read, and the environment in it."""

import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from eldenet.evaluation.metric_names import METRICS, in_range
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.system.errors import reading
from eldenet.system.files import read_json
from eldenet.system.resources import available_cores

RUN_FILE = "run.json"
CPU_INFO, BOARD = Path("/proc/cpuinfo"), Path("/proc/device-tree/model")
ADVICE = "it is damaged, or another program or command wrote it: restore it, or leave it out"
_PACKAGES = ["eldenet", "torch", "torchvision", "numpy", "kornia", "albumentations", "opencv-python-headless"]
_PACKAGES += ["hydra-core", "accelerate", "torchmetrics", "mujoco"]


def read_record(path: Path) -> dict[str, Any]:
    """Read the ``run.json`` of any command.

    Raises:
        ValueError: it is not a JSON object, or holds NaN or endless nesting.
    """
    content = read_json(path)
    if not isinstance(content, dict):
        raise ValueError(f"{path} is not a JSON object: it was not written by eldenet")
    return content


def read_run(path: str | Path) -> dict[str, Any]:
    """Read a ``run.json`` (or the one in a run folder).

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is not JSON, or has no metrics.
    """
    path = Path(path)
    path = path / RUN_FILE if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(
            f"no {RUN_FILE} at {path}: the run has not finished, or this is not a run folder"
        )
    content = read_record(path)
    if "metrics" not in content:
        raise ValueError(f"{path} has no metrics: it was not written by eldenet's train or evaluate")
    return content


def check_entries(where: str | Path, record: Mapping[str, Any], *names: str) -> None:
    """Raise ValueError, which names the file, unless a record has all these entries (``cost.params``)."""
    for name in names:
        node: Any = record
        for part in name.split("."):
            if not isinstance(node, Mapping) or part not in node:
                raise ValueError(f"{where} has no {name}: {ADVICE}")
            node = node[part]


def check_figures(where: str | Path, figures: Any) -> None:
    """Raise ValueError, which names the file, for a metric or cost that cannot be: delta1=7."""
    for name, value in figures.items() if isinstance(figures, Mapping) else [("a figure", figures)]:
        word = isinstance(value, str) and name not in METRICS  # a cost names its runtime and device
        if not word and (isinstance(value, str) or not in_range(name, value)):
            raise ValueError(f"{where}: {name}={str(value)[:60]} cannot be: {ADVICE}")


def scored_run(where: str | Path, record: Mapping[str, Any], *needed: str) -> dict[str, Any]:
    """Return the record of a training or an evaluation for a table, with every rule in its protocol.

    A rule that did not exist yet was not applied.

    Raises:
        ValueError: it lacks an entry, or has one that cannot be; the message names the file.
    """
    check_entries(where, record, "metrics", "protocol", "model", *needed)
    for group in ("metrics", "cost", "constant_predictor"):
        check_figures(where, record.get(group) or {})
    with reading(where, "record of a run", ADVICE):
        protocol = EvalProtocol(**record["protocol"])
    return {**record, "protocol": protocol.as_dict()}


def environment() -> dict[str, Any]:
    """Time, command, versions, hardware, and commit of a run."""
    import psutil
    import torch

    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join([*Path(sys.argv[0]).name.split(), *sys.argv[1:]]),
        "python": platform.python_version(),
        "versions": {name: version_of(name) for name in _PACKAGES},
        "hardware": {
            "processor": processor_name(),
            "cores": available_cores(),
            "memory_gb": round(psutil.virtual_memory().total / 2**30, 1),
            "accelerator": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
            "system": f"{platform.system()} {platform.machine()}",
        },
        "git": _git_state(),
    }


def version_of(package: str) -> str | None:
    """Return the version of an installed package; None if it is not installed."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def processor_name() -> str:
    """Return the name of the processor, or of the board where it has none, as on a Raspberry Pi or Jetson."""
    if CPU_INFO.is_file():
        for line in CPU_INFO.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    if BOARD.is_file():
        return BOARD.read_text().strip("\0")
    if sys.platform == "darwin":
        ask = ["sysctl", "-n", "machdep.cpu.brand_string"]
        return subprocess.run(ask, capture_output=True, text=True, check=True).stdout.strip()
    return platform.processor() or platform.machine()


def _git_state() -> dict[str, Any] | None:
    """Commit of the checkout around this package, and whether it was changed; None outside a checkout."""
    package = Path(__file__).resolve().parents[1]
    if shutil.which("git") is None or not (package.parent / ".git").exists():
        return None

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(package.parent), *arguments], capture_output=True, text=True, check=False
        ).stdout.strip()

    code = ("eldenet", "configs", "pyproject.toml")  # not the results in experiments/
    changed = bool(git("status", "--porcelain", "--", *code))
    return {"commit": git("rev-parse", "HEAD") or None, "changed": changed}

"""``run.json``: everything that a number needs in order to be believed, in one file."""

import inspect
import json
import os
import pkgutil
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

from eldenet.renames import renamed
from eldenet.system.resources import available_cores

RUN_FILE = "run.json"
_PACKAGES = (
    "eldenet",
    "torch",
    "torchvision",
    "numpy",
    "kornia",
    "albumentations",
    "opencv-python-headless",
    "hydra-core",
    "accelerate",
    "torchmetrics",
    "mujoco",
)


def read_record(path: Path) -> dict[str, Any]:
    """A ``run.json``, whichever command wrote it.

    Raises:
        ValueError: it is no JSON object.
    """
    try:
        content = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"{path} holds no JSON object: it was not written by eldenet")
    return dict(renamed(content))


def read_run(path: str | Path) -> dict[str, Any]:
    """Read a ``run.json`` (or the one in a run folder).

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is no JSON, or holds no metrics.
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


# where a run lay, what it is called and what it was computed with: they change no result that is looked for
NOT_COMPARED = frozenset(
    ("run_dir", "ckpt_path", "model_name", "root", "raw_root", "cache", "threads", "workers", "device")
)


def differences(
    ours: Any, theirs: Any, name: str = "", *, ignored: frozenset[str] = frozenset()
) -> list[str]:
    """Settings that tell two resolved configs apart, as ``name=ours (there theirs)``.

    An option of a class that one side does not know yet counts as its default: so the run was made. A whole
    section, or an entry of ``data``, that one side does not have tells nothing (a data set's options stand
    with its class, too). Anything else that only one side has is a difference. ``ignored`` are further keys,
    of values: the options of a section that is called so (a loss's ``teacher``) are compared.
    """
    if not (isinstance(ours, Mapping) and isinstance(theirs, Mapping)):
        ours, theirs = _listed(ours), _listed(theirs)
        return [] if ours == theirs else [f"{name}={ours} (there {theirs})"]
    grows = not name or name == "data"
    target = ours.get("_target_") if ours.get("_target_") == theirs.get("_target_") else None
    found = []
    for key in [*ours, *(key for key in theirs if key not in ours)]:
        mine, other = ours.get(key), theirs.get(key)
        left_out = key in ignored and not (isinstance(mine, Mapping) and isinstance(other, Mapping))
        if key in NOT_COMPARED or left_out or (grows and not (key in ours and key in theirs)):
            continue
        if target is not None and not (key in ours and key in theirs):
            default = _default(target, key, mine if key in ours else other)
            mine, other = (mine, default) if key in ours else (default, other)
        found += differences(mine, other, f"{name}.{key}" if name else str(key), ignored=ignored)
    return found


def _default(target: str, option: str, otherwise: Any) -> Any:
    """What ``target`` takes for an option that it is not given; ``otherwise`` for what it does not know.

    A record may come from elsewhere: what it names is imported from this package and from torch alone.
    """
    if not target.startswith(("eldenet.", "torch.")):
        return otherwise
    try:
        parameter = inspect.signature(pkgutil.resolve_name(target)).parameters.get(option)
    except (ImportError, AttributeError, TypeError, ValueError):
        return otherwise
    return otherwise if parameter is None or parameter.default is parameter.empty else parameter.default


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def environment() -> dict[str, Any]:
    """What the run ran on: time, versions, hardware, and the state of the code."""
    import torch

    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in _PACKAGES},
        "hardware": {
            "processor": _processor(),
            "cores": available_cores(),
            "memory_gb": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
            "accelerator": torch.cuda.get_device_name() if torch.cuda.is_available() else None,
            "system": f"{platform.system()} {platform.machine()}",
        },
        "git": _git_state(),
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _git_state() -> dict[str, Any] | None:
    """Commit of the checkout that this package stands in, and whether it was changed; None outside one."""
    package = Path(__file__).resolve().parents[1]
    if shutil.which("git") is None or not (package.parent / ".git").exists():
        return None

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(package.parent), *arguments], capture_output=True, text=True, check=False
        ).stdout.strip()

    code = ("eldenet", "configs", "pyproject.toml")  # results that runs leave in experiments/ change none
    changed = bool(git("status", "--porcelain", "--", *code))
    return {"commit": git("rev-parse", "HEAD") or None, "changed": changed}

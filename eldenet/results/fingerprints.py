"""Whether a stored result is the one that is asked for: settings compared one by one, weights by content.

:func:`differences` compares two resolved configs or any two nested dicts, :func:`run_differences` a resolved
config and a finished run, :func:`fingerprint` identifies weights wherever they lie. The caller decides
whether to refuse, redo or leave out what differs.

Stores of frames are identified in another way: the frame cache by the state of its source files
(:mod:`eldenet.data.cache`), rendered frames and episodes by the version of their generator.
"""

import inspect
import pkgutil
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eldenet.system.digests import file_digest
from eldenet.weights import WEIGHT_FILES, located

KEYS = frozenset(("weights", "teacher", "pretrained", "source"))  # each names a file, folder or Hub id
# where a run lies, its name and the resources that it used: none of them changes a result
NOT_COMPARED = frozenset(
    (
        *("output", "run_dir", "ckpt_path", "model_name", "root", "raw_root", "cache"),
        *("threads", "workers", "device", "process_timeout", "logger"),
    )
)


def differences(
    ours: Any, theirs: Any, name: str = "", *, ignored: frozenset[str] = frozenset()
) -> list[str]:
    """Settings that differ between two resolved configs, as ``name=ours (there theirs)``.

    An option of a class that only one side has is compared with the class's default. A whole section, or an
    entry of ``data``, that only one side has is not compared: an older version did not have it. Any other
    setting that only one side has is a difference. Of a path, the name of the file counts.

    Args:
        ours: resolved, plain.
        theirs: the same.
        name: of the section that both are.
        ignored: keys of values that are not compared; a section of that name (a loss's ``teacher``) is.
    """
    if not (isinstance(ours, Mapping) and isinstance(theirs, Mapping)):
        return [] if _comparable(ours) == _comparable(theirs) else [f"{name}={ours} (there {theirs})"]
    target = ours.get("_target_") if ours.get("_target_") == theirs.get("_target_") else None
    found = []
    for key in dict.fromkeys([*ours, *theirs]):
        mine, other = ours.get(key), theirs.get(key)
        is_section = isinstance(mine, Mapping) and isinstance(other, Mapping)
        if key in NOT_COMPARED or (key in ignored and not is_section):
            continue
        if not (key in ours and key in theirs):
            if name in ("", "data"):
                continue
            if target is not None:
                default = _default(target, key, mine if key in ours else other)
                mine, other = (mine, default) if key in ours else (default, other)
        found += differences(mine, other, f"{name}.{key}" if name else str(key), ignored=ignored)
    return found


def _default(target: str, option: str, otherwise: Any) -> Any:
    """Default of an option of ``target``; ``otherwise`` where it has none.

    A record may come from anywhere: only names of this package and of torch are imported.
    """
    if not str(target).startswith(("eldenet.", "torch.")):
        return otherwise
    try:
        parameter = inspect.signature(pkgutil.resolve_name(target)).parameters.get(option)
    except (ImportError, AttributeError, TypeError, ValueError):
        return otherwise
    return otherwise if parameter is None or parameter.default is parameter.empty else parameter.default


def _comparable(value: Any) -> Any:
    """Tuples as lists, and files without their folders: where a file lies changes no result."""
    if isinstance(value, str):
        return re.sub(r"[^\s=,]*/", "", value)
    return [_comparable(each) for each in value] if isinstance(value, list | tuple) else value


def run_differences(
    config: Mapping[str, Any],
    record: Mapping[str, Any],
    *,
    ignored: frozenset[str] = frozenset(),
    given: frozenset[str] | None = None,
) -> list[str]:
    """Settings, weights and teachers that differ between a resolved config and a finished run.

    Weights and teachers are compared by content: the same ones may have moved, or be gone by now.

    Args:
        config: resolved, plain.
        record: contents of ``run.json``.
        ignored: keys that are not compared.
        given: None for a config that names real files. Else the config is only a plan: the dotted settings of
            this set are given when it runs and are not compared, and paths of other weights count only where
            the run recorded their content.
    """
    theirs = record.get("config", {})
    recorded = record.get("sources", {})
    is_plan, given = given is not None, given or frozenset()
    names = frozenset(setting.rpartition(".")[2] for setting in given)
    found = differences(config, theirs, ignored=KEYS | ignored | names)
    ours, there = sources_of(config), sources_of(theirs)
    passed_on = {there.get(name) for name in given}  # also where another setting takes it: ${teacher}
    for name in dict.fromkeys([*ours, *there]):
        mine, other, wanted = ours.get(name), there.get(name), recorded.get(name)
        if name in given or (mine is None and other in passed_on):
            continue
        if mine is None or other is None:
            found.append(f"{name}={mine} (there {other})")
            continue
        content = fingerprint(mine)
        other_path = mine != other and not is_plan  # counts where the run did not record the content
        if other_path if wanted is None else content not in (None, wanted):
            found.append(f"{name}={mine} (content {content}; there {other}, content {wanted})")
    return found


def sources_of(config: Any, name: str = "") -> dict[str, str]:
    """Dotted setting -> the file, folder or id that a config names there ("True": published weights)."""
    if not isinstance(config, Mapping):
        return {}
    found = {}
    for key, value in config.items():
        dotted = f"{name}.{key}" if name else str(key)
        names_weights = key in KEYS or dotted.endswith("teacher.path")  # the latter: a teacher's ONNX file
        if names_weights and not isinstance(value, Mapping):
            if value is not None and value is not False:
                found[dotted] = str(value)
        else:
            found |= sources_of(value, dotted)
    return found


def sha256(source: str | Path) -> str | None:
    """SHA-256 of a source's weights (of the file beside an OpenVINO ``.xml``); None if they are not here."""
    folder = located(source)
    weights = folder.with_suffix(".bin") if folder.suffix == ".xml" else folder
    for file in (weights, *(folder / name for name in WEIGHT_FILES)):
        if file.is_file():
            return file_digest(file)
    return None


def fingerprint(source: str) -> str | None:
    """First 16 digits of :func:`sha256`."""
    found = sha256(source)
    return None if found is None else found[:16]


def fingerprints(config: Any) -> dict[str, str | None]:
    """Dotted setting -> fingerprint of the weights that a config names there; ``run.json`` stores it."""
    return {name: fingerprint(source) for name, source in sources_of(config).items()}

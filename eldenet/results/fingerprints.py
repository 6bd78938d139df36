"""What a training takes over from elsewhere (weights, a teacher): told apart by content, wherever it lies."""

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eldenet.results.run_record import differences
from eldenet.weights import WEIGHT_FILES, located

KEYS = frozenset(("weights", "teacher", "pretrained", "source"))  # each names a file, folder, Hub id


def sources_of(config: Any, name: str = "") -> dict[str, str]:
    """Setting, dotted -> the file, folder or id that a config gives it ("True": published weights)."""
    if not isinstance(config, Mapping):
        return {}
    found = {}
    for key, value in config.items():
        dotted = f"{name}.{key}" if name else str(key)
        if key in KEYS and not isinstance(value, Mapping):
            if value is not None and value is not False:
                found[dotted] = str(value)
        else:
            found |= sources_of(value, dotted)
    return found


def sha256(source: str | Path) -> str | None:
    """SHA-256 of a source's weights (those beside an OpenVINO ``.xml``); None where they do not lie here."""
    folder = located(source)
    weights = folder.with_suffix(".bin") if folder.suffix == ".xml" else folder
    for file in (weights, *(folder / name for name in WEIGHT_FILES)):
        if file.is_file():
            with file.open("rb") as content:
                return hashlib.file_digest(content, "sha256").hexdigest()
    return None


def fingerprint(source: str) -> str | None:
    """First 16 digits of :func:`sha256`."""
    found = sha256(source)
    return None if found is None else found[:16]


def fingerprints(config: Mapping[str, Any]) -> dict[str, str | None]:
    """Setting -> fingerprint, for ``run.json``."""
    return {name: fingerprint(source) for name, source in sources_of(config).items()}


def run_differences(
    config: Mapping[str, Any],
    record: Mapping[str, Any],
    *,
    ignored: frozenset[str] = frozenset(),
    elsewhere: frozenset[str] = frozenset(),
    by_path: bool = True,
) -> list[str]:
    """What tells a resolved config from that of a finished run (its ``run.json``), in words.

    Weights and teachers count by their content: the same ones may lie elsewhere by now, or not be here any
    more.

    Args:
        config: resolved, plain.
        record: contents of ``run.json``.
        ignored: keys that do not count.
        elsewhere: settings, dotted, whose weights or teacher ``config`` cannot name: nothing is said of them.
        by_path: whether a source of which the run recorded no content counts by its path; False where
            ``config`` does not know the run folders.
    """
    theirs = record.get("config", {})
    known = record.get("sources", {})
    found = differences(config, theirs, ignored=KEYS | ignored)
    ours, there = sources_of(config), sources_of(theirs)
    unnamed = {there.get(name) for name in elsewhere}  # also where a setting takes it on: ${teacher}
    for name in dict.fromkeys([*ours, *there]):
        mine, other, wanted = ours.get(name), there.get(name), known.get(name)
        if name in elsewhere or (mine is None and other in unnamed):
            continue
        if mine is None or other is None:
            found.append(f"{name}={mine} (there {other})")
            continue
        here = fingerprint(mine)
        different = by_path and mine != other if wanted is None else here not in (None, wanted)
        if different:
            found.append(f"{name}={mine} (content {here}; there {other}, content {wanted})")
    return found

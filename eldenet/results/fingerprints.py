"""What a training takes over from elsewhere (weights, a teacher): told apart by content, wherever it lies."""

import hashlib
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eldenet.results.run_record import differences

PACKAGED = (
    Path(__file__).resolve().parents[1] / "weights"
)  # trained on rendered frames alone, so they may ship
KEYS = frozenset(("weights", "teacher", "pretrained", "source"))  # each names a file, folder, Hub id
_FILES = ("model.safetensors", "model/model.safetensors")


def located(source: str | Path) -> Path:
    """Folder or file of a source: that of the package's own weights for their name, else the path itself.

    ``~`` is the home folder. ``./name`` is a path, whatever the package holds of that name.

    Warns:
        UserWarning: a saved model of the same name as the package's weights lies here, and is not taken.
    """
    own, here = PACKAGED / source, Path(source).expanduser()
    if "/" in str(source) or not (own / _FILES[0]).is_file():
        return here
    if any((here / name).is_file() for name in _FILES) and here.resolve() != own:
        warnings.warn(
            f"{source} is taken from the package, not from the folder of that name here: for that one give "
            f"./{source}",
            stacklevel=2,
        )
    return own


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
    for file in (weights, *(folder / name for name in _FILES)):
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

"""Rows on disk: what was measured, of which weights and on which machine."""

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.results.run_record import check_entries, check_figures, environment, version_of
from eldenet.system.digests import digest_of, weights_of
from eldenet.system.files import parse_json

if TYPE_CHECKING:
    from eldenet.model import DepthNet

ROWS_FILE = "rows.jsonl"
KEY = ("model", "height", "width", "batch", "runtime", "precision", "threads", "device")  # identify a row
COLUMNS = (
    *KEY,
    *("params", "gmacs", "gflops", "latency_ms_p50", "latency_ms_p95", "fps", "throughput_img_s"),
    *("peak_memory_mb", "file_mb", "gflops_per_s", "share_of_peak", "ratio_latency"),
)
TEXTS = ("model", "runtime", "precision", "device")
FIGURES = tuple(name for name in COLUMNS if name not in TEXTS)
ROW = (*COLUMNS, "key", "command", "date", "processor", "versions", "failed")
PACKAGES = ("eldenet", "torch", "onnxruntime", "openvino", "nncf", "numpy")


def network_digest(model: "DepthNet") -> str:
    """8 hex digits of the SHA-256 of config and weights: identifies a network."""
    return digest_of(json.dumps(model.config, sort_keys=True), *weights_of(model.state_dict()))[:8]


def read_rows(
    folder: Path, wanted: Callable[[Mapping[str, Any]], bool] = lambda row: True
) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Stored rows by key, the newest wanted one of each; a damaged line is skipped and measured again."""
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    path = folder / ROWS_FILE
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        with suppress(ValueError, TypeError):
            row = parse_json(line.decode(), path)
            check_entries(path, row, *ROW)
            check_figures(path, {name: row[name] for name in FIGURES})
            if wanted(row):
                rows[tuple(row["key"])] = row
    return rows


def append_rows(folder: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Append rows to the file; a line that was cut short by a kill remains a separate line."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / ROWS_FILE
    cut_short = path.is_file() and not path.read_bytes().endswith(b"\n")
    with path.open("a") as file:
        file.write("\n" * cut_short)
        file.writelines(json.dumps(row) + "\n" for row in rows)


def machine() -> tuple[dict[str, Any], str]:
    """Versions, processor, cores and accelerator that all rows of a table share; and the command."""
    facts = environment()
    shared = {name: facts["hardware"][name] for name in ("processor", "cores", "accelerator")}
    return {"versions": {name: version_of(name) for name in PACKAGES}, **shared}, facts["command"]


def other_machine(row: Mapping[str, Any], this: Mapping[str, Any]) -> str:
    """Return how the machine of a stored row differs from ``this`` one; "" for the same machine.

    The accelerator counts unless the row ran on the CPU.
    """
    names = ["processor", "cores"] if row["device"] == "cpu" else ["processor", "cores", "accelerator"]
    pairs = [(name, row.get(name), this[name]) for name in names]
    versions = row.get("versions") or {}
    pairs += [(name, versions.get(name), version) for name, version in this["versions"].items()]
    return ", ".join(f"{name} {old}, now {new}" for name, old, new in pairs if old != new)

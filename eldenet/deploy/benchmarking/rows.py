"""Which rows of earlier benchmarks count: those of the same weights, settings and machine."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from omegaconf import DictConfig

PACKAGES = ("eldenet", "torch", "onnxruntime", "openvino", "nncf", "numpy")


def measured_alike(row: Mapping[str, Any], config: "DictConfig", fingerprint: str | None) -> bool:
    """Whether a stored row is of the same weights, reference, rounds and seconds as now asked for."""
    asked = (fingerprint, str(config.reference), config.rounds, config.seconds)
    if row.get("precision") == "int8" and row.get("calibrated") != calibrated(config):
        return False
    return tuple(row.get(name) for name in ("fingerprint", "reference", "rounds", "seconds")) == asked


def calibrated(config: "DictConfig") -> str:
    """What the scales of int8 come from."""
    return f"{config.pictures} {config.calibration}"


def machine() -> tuple[dict[str, Any], str]:
    """What latencies of one table share: versions, processor, its cores, accelerator; and the command."""
    from eldenet.results.run_record import environment

    facts = environment()
    shared = {name: facts["hardware"][name] for name in ("processor", "cores", "accelerator")}
    return {"versions": {name: version_of(name) for name in PACKAGES}, **shared}, facts["command"]


def other_machine(row: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """What tells the machine of a stored row from this one, in words; "" for the same.

    The accelerator counts for rows that may have run on it.
    """
    names = ["processor", "cores"] if row["device"] == "cpu" else ["processor", "cores", "accelerator"]
    pairs = [(name, row.get(name), here[name]) for name in names]
    stored = row.get("versions") or {}
    pairs += [(name, stored.get(name), version) for name, version in here["versions"].items()]
    return ", ".join(f"{name} {there}, here {ours}" for name, there, ours in pairs if there != ours)


def version_of(package: str) -> str | None:
    """Version of an installed package, or None."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return None

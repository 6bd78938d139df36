"""Whether and from where a training resumes: what its run folder holds, and whether that is this run.

Settings that may differ are ``NOT_COMPARED`` in :mod:`eldenet.results.fingerprints`.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eldenet.results.fingerprints import differences, run_differences
from eldenet.results.run_record import RUN_FILE, read_run
from eldenet.system.files import read_yaml
from eldenet.system.resources import number_of_processes

OWN_CHECKPOINT = Path("checkpoints") / "last.pt"  # in a run folder


def finished_value(folder: Path, ckpt_path: str | None, settings: Mapping[str, Any]) -> float | None:
    """Return the best value of the run in ``folder`` if it has finished and ``ckpt_path="auto"`` asks for it.

    Raises:
        ValueError: the finished run had other settings or other frames, or is an evaluation.
    """
    if ckpt_path != "auto" or not (folder / RUN_FILE).is_file():
        return None
    record = read_run(folder)
    if record.get("training", {}) is None:
        raise ValueError(f"{folder} holds an evaluation, not a training to resume: give another folder")
    check_finished(folder, record, settings)
    best_value = record["training"]["best_value"]
    return math.nan if best_value is None else float(best_value)


def check_finished(folder: Path, record: Mapping[str, Any], settings: Mapping[str, Any]) -> None:
    """Raise ValueError if the finished run of ``record`` had other settings or other frames."""
    from eldenet.evaluation.splits import chosen_protocol, open_split

    different = run_differences(settings, record)
    processes = record.get("resources", {}).get("processes")  # absent in early records
    if processes not in (None, number_of_processes()):
        different.append(f"processes={number_of_processes()} (there {processes})")
    if not different:
        protocol = chosen_protocol(settings["data"], settings["protocol"])
        for split, name in (("train", "train_split_hash"), ("test", "split_hash")):
            found = open_split(settings["data"], split, protocol).split_hash
            if record.get(name, found) != found:
                different.append(f"the frames of data.{split} ({found}, there {record[name]})")
    _refuse(folder, "finished run with", different, "give another folder, or remove this one")


def checkpoint_to_resume(folder: Path, ckpt_path: str | None, settings: Mapping[str, Any]) -> Path | None:
    """Return the checkpoint that ``ckpt_path`` names; None if it names none, or there is none yet.

    Args:
        ckpt_path: a checkpoint, a run folder, or "auto": this folder's, if there is one.
        settings: of the training, as ``run.json`` stores them.

    Raises:
        ValueError: the run folder holds another run, or the run to resume was begun with other settings.
        FileNotFoundError: there is no such checkpoint.
    """
    checkpoint, here = _named_checkpoint(folder, ckpt_path), folder.resolve()
    own = checkpoint is not None and here in (checkpoint.resolve(), *checkpoint.resolve().parents)
    if not own:
        held = [file for file in (Path(RUN_FILE), OWN_CHECKPOINT) if (folder / file).exists()]
        if held:
            raise ValueError(
                f"output={folder} already holds another run ({held[0]}): resume it (ckpt_path=auto), "
                "give another output, or remove that folder"
            )
    if checkpoint is None:
        return None
    begun = run_folder(checkpoint)
    if (begun / "config.yaml").is_file():  # the checkpoint itself knows what precision "auto" was
        stored = read_yaml(begun / "config.yaml")
        different = differences(settings, stored, ignored=frozenset(("precision",)))
        advice = "give another folder, or remove this one" if own else f"or start from its weights={begun}"
        _refuse(begun, "run begun with", different, advice)
    return checkpoint


def _refuse(folder: Path, held: str, different: list[str], advice: str) -> None:
    if different:
        raise ValueError(
            f"{folder} holds a {held} other settings: {'; '.join(different[:5])}. Use those settings, "
            f"{advice}"
        )


def _named_checkpoint(folder: Path, ckpt_path: str | None) -> Path | None:
    if ckpt_path is None:
        return None
    if ckpt_path != "auto":
        checkpoint_file(ckpt_path)
        return Path(ckpt_path)
    own = folder / OWN_CHECKPOINT
    return own if own.is_file() else None


def checkpoint_file(path: str | Path) -> Path:
    """``path`` itself, or the last checkpoint of the run folder ``path``.

    Raises:
        FileNotFoundError: there is none.
    """
    path = Path(path)
    path = path / OWN_CHECKPOINT if path.is_dir() else path
    if not path.is_file():
        raise FileNotFoundError(
            f"no checkpoint at {path}: give checkpoints/last.pt of a run, or its run folder"
        )
    return path


def run_folder(checkpoint: Path) -> Path:
    """Return the run folder that a checkpoint belongs to; a run folder is its own."""
    return checkpoint if checkpoint.is_dir() else checkpoint.parent.parent

"""Whether and from where a training goes on: what its run folder holds, and whether that is this run."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.renames import renamed
from eldenet.results.fingerprints import differences

if TYPE_CHECKING:
    from omegaconf import DictConfig


def finished_run(config: "DictConfig", folder: Path) -> dict[str, Any] | None:
    """The ``run.json`` of this very run if it is there already, and ``ckpt_path=auto`` asks for it.

    Raises:
        ValueError: the finished run in ``folder`` had other settings or other data, or is an evaluation.
    """
    from eldenet.results.fingerprints import run_differences
    from eldenet.results.run_record import RUN_FILE, read_run

    if config.ckpt_path != "auto" or not (folder / RUN_FILE).is_file():
        return None
    record = read_run(folder)
    if record.get("training", {}) is None:
        raise ValueError(f"{folder} holds an evaluation, no training to go on with: give another folder")
    different = run_differences(cfg.plain(config), record)
    if not different:
        protocol = cfg.build_protocol(config)
        for split, name in (("train", "train_split_hash"), ("test", "split_hash")):
            found = cfg.build_split(config, split, protocol).split_hash
            if record.get(name, found) != found:
                different.append(f"the frames of data.{split} ({found}, there {record[name]})")
    if different:
        raise ValueError(
            f"{folder} holds a finished run of other settings: {'; '.join(different[:5])}. Take these back, "
            "give another folder, or remove that one"
        )
    return record


def checkpoint_of(config: "DictConfig", folder: Path) -> Path | None:
    """What ``ckpt_path`` says to go on with; None: nothing, or nothing there yet.

    Raises:
        ValueError: ``folder`` holds another run, or this one, begun with other settings.
    """
    checkpoint = _named_checkpoint(config, folder)
    if checkpoint is not None and _lies_in(folder, checkpoint):
        _refuse_other_settings(config, folder)
    else:
        _refuse_to_mix(folder)
    return checkpoint


def _named_checkpoint(config: "DictConfig", folder: Path) -> Path | None:
    from eldenet.training.checkpoint import checkpoint_file

    if config.ckpt_path is None:
        return None
    if config.ckpt_path != "auto":
        checkpoint_file(config.ckpt_path)
        return Path(config.ckpt_path)
    own = folder / "checkpoints" / "last.pt"
    return own if own.is_file() else None


def _lies_in(folder: Path, checkpoint: Path) -> bool:
    resolved = checkpoint.resolve()
    return folder.resolve() in (resolved, *resolved.parents)


def _refuse_other_settings(config: "DictConfig", folder: Path) -> None:
    """A run that was begun goes on with the settings that it began with, or its record would be untrue."""
    begun = folder / "config.yaml"
    # the checkpoint knows what "auto" was
    known = frozenset(("precision",))
    different = (
        differences(cfg.plain(config), renamed(cfg.read_yaml(begun)), ignored=known)
        if begun.is_file()
        else []
    )
    if different:
        raise ValueError(
            f"{folder} holds a run begun with other settings: {'; '.join(different[:5])}. Take these back, "
            "give another folder, or remove that one"
        )


def _refuse_to_mix(folder: Path) -> None:
    """A run folder holds one run."""
    held = [name for name in ("run.json", "checkpoints/last.pt") if (folder / name).exists()]
    if held:
        raise ValueError(
            f"run_dir={folder} holds another run already ({held[0]}): go on with it (ckpt_path=auto), give "
            "another run_dir, or remove that folder"
        )


def run_folder(checkpoint: Path) -> Path:
    """The run that a checkpoint, or a run's folder, belongs to."""
    return checkpoint if checkpoint.is_dir() else checkpoint.parent.parent

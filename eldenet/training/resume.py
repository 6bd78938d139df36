"""Whether and from where a training resumes: what its run folder holds, and whether that is this run.

Settings that may differ are ``NOT_COMPARED`` in :mod:`eldenet.results.fingerprints`.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.renames import renamed
from eldenet.results.fingerprints import differences, run_differences
from eldenet.results.run_record import RUN_FILE, read_run
from eldenet.system.files import read_yaml
from eldenet.system.resources import number_of_processes

if TYPE_CHECKING:
    from eldenet.training.setup import TrainingSetup

OWN_CHECKPOINT = Path("checkpoints") / "last.pt"


def finished_run(setup: "TrainingSetup") -> dict[str, Any] | None:
    """Return the ``run.json`` of this run if it has finished and ``ckpt_path=auto`` asks for it.

    Raises:
        ValueError: the finished run had other settings or other frames, or is an evaluation.
    """
    folder = setup.folder
    if setup.ckpt_path != "auto" or not (folder / RUN_FILE).is_file():
        return None
    record = read_run(folder)
    if record.get("training", {}) is None:
        raise ValueError(f"{folder} holds an evaluation, not a training to resume: give another folder")
    different = run_differences(setup.settings, record)
    processes = record.get("resources", {}).get("processes")  # absent in early records
    if processes not in (None, number_of_processes()):
        different.append(f"processes={number_of_processes()} (there {processes})")
    if not different:
        for split, name in (("train", "train_split_hash"), ("test", "split_hash")):
            found = setup.make_split(split, setup.protocol).split_hash
            if record.get(name, found) != found:
                different.append(f"the frames of data.{split} ({found}, there {record[name]})")
    _refuse(folder, "finished run with", different, "give another folder, or remove this one")
    return record


def checkpoint_to_resume(setup: "TrainingSetup") -> Path | None:
    """Return the checkpoint that ``ckpt_path`` names; None if it names none, or there is none yet.

    Raises:
        ValueError: the run folder holds another run, or the run to resume was begun with other settings.
    """
    checkpoint, folder = _named_checkpoint(setup), setup.folder.resolve()
    own = checkpoint is not None and folder in (checkpoint.resolve(), *checkpoint.resolve().parents)
    if not own:
        held = [file for file in (Path(RUN_FILE), OWN_CHECKPOINT) if (setup.folder / file).exists()]
        if held:
            raise ValueError(
                f"output={setup.folder} already holds another run ({held[0]}): resume it (ckpt_path=auto), "
                "give another output, or remove that folder"
            )
    if checkpoint is None:
        return None
    begun = run_folder(checkpoint)
    if (begun / "config.yaml").is_file():  # the checkpoint itself knows what precision "auto" was
        settings = renamed(read_yaml(begun / "config.yaml"))
        different = differences(setup.settings, settings, ignored=frozenset(("precision",)))
        advice = "give another folder, or remove this one" if own else f"or start from its weights={begun}"
        _refuse(begun, "run begun with", different, advice)
    return checkpoint


def _refuse(folder: Path, held: str, different: list[str], advice: str) -> None:
    if different:
        raise ValueError(
            f"{folder} holds a {held} other settings: {'; '.join(different[:5])}. Use those settings, "
            f"{advice}"
        )


def _named_checkpoint(setup: "TrainingSetup") -> Path | None:
    if setup.ckpt_path is None:
        return None
    if setup.ckpt_path != "auto":
        checkpoint_file(setup.ckpt_path)
        return Path(setup.ckpt_path)
    own = setup.folder / OWN_CHECKPOINT
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

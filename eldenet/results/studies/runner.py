"""Runs of a study: finished ones are skipped, killed ones go on, a failed one does not stop the rest."""

import fcntl
import os
import shutil
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.config import build_training
from eldenet.results.run_record import RUN_FILE
from eldenet.results.studies.matching import compose_run, refuse_missing
from eldenet.results.studies.plan import KEPT, RATE, Study, StudyRow
from eldenet.results.studies.rates import learning_rate
from eldenet.training.resume import finished_run
from eldenet.training.run import train

if TYPE_CHECKING:
    from omegaconf import DictConfig

Say = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What became of one run: "done", "finished before", "running elsewhere", "... not given", "failed"."""

    run: str
    status: str
    reason: str = ""


def run_row(
    study: Study,
    row: StudyRow,
    runs: Path,
    *,
    given: Mapping[str, Any] | None = None,
    seeds: Sequence[int] | None = None,
    rerun: bool = False,
    say: Say = print,
) -> list[Outcome]:
    """All runs of one row: the learning rate's trials, then one run per seed.

    Args:
        study: whose results are stored beside its plan; of a row taken from another study, that one.
        row: of it.
        runs: folder for the run folders, ``<runs>/<study>/<row>/...``.
        given: name -> value of what rows ask for.
        seeds: those of the row's seeds to run; None: all. A row without any of them has nothing to do.
        rerun: train what is stored, but not below ``runs``, too: for its weights, which are not stored, or
            because it was made with other settings or weights; what is stored is replaced.
        say: prints a line.
    """
    study = row.owner or study
    chosen = [seed for seed in row.seeds if seeds is None or seed in seeds]
    if not chosen:
        return []
    settings = {}
    for name, setting in (row.given or {}).items():
        value = (given or {}).get(name)
        if value is None:
            plus = "" if given is None or name in given else "+"  # Hydra's word for a new name
            say(f"{study.name}/{row.name}: {row.missing_word} ({plus}given.{name}=...)")
            return [Outcome(f"{row.name}/seed{seed}", row.missing_word) for seed in chosen]
        settings[setting] = value
    folder = runs / study.name
    shared = [*study.overrides, *row.overrides, *(f"{name}='{value}'" for name, value in settings.items())]
    with sole(folder / row.name) as free:
        if not free:
            say(f"{study.name}/{row.name}: another process is at it")
            return [Outcome(f"{row.name}/seed{seed}", "running elsewhere") for seed in chosen]
        try:
            rate = learning_rate(study, row, shared, folder, say, rerun=rerun)
        except Exception as error:
            return [_failed(folder / row.name, f"{row.name}/learning rate", error, say)]
        (folder / row.name / "failed.txt").unlink(missing_ok=True)
        if rate is not None:
            shared.append(f"{RATE}={rate}")
        return [_run_seed(study, row, seed, shared, folder, rerun, say) for seed in chosen]


def refuse_unknown_seeds(rows: Sequence[StudyRow], seeds: Sequence[int] | None) -> None:
    """Refuse seeds that nothing would be run for.

    Raises:
        ValueError: none of ``rows`` has such a seed.
    """
    known = sorted({seed for row in rows for seed in row.seeds})
    unknown = [seed for seed in seeds or () if seed not in known]
    if unknown:
        raise ValueError(
            f"seeds={unknown}: the chosen rows have the seeds {', '.join(map(str, known))}; further ones are "
            "added in sweep.yaml"
        )


@contextmanager
def sole(folder: Path) -> Iterator[bool]:
    """Whether this process alone works in ``folder`` within the block; the lock ends with its process."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        yield True


def _run_seed(
    study: Study, row: StudyRow, seed: int, shared: list[str], runs: Path, rerun: bool, say: Say
) -> Outcome:
    name, stored = f"{row.name}/seed{seed}", study.stored(row, seed)
    folder = runs / row.name / f"seed{seed}"
    try:
        config = compose_run(shared, folder, runs, name=row.name, seed=seed)
        if not rerun and _finished(config, stored, f"{study.name}/{name}", say):
            return Outcome(name, "finished before")
        refuse_missing(row, runs, seed)
        train(build_training(config, folder))
        store(folder, stored)
    except Exception as error:
        return _failed(folder, name, error, say)
    (folder / "failed.txt").unlink(missing_ok=True)
    return Outcome(name, "done")


def _finished(config: "DictConfig", stored: Path, name: str, say: Say) -> bool:
    """Whether this very run is stored; that takes its settings alone where its frames are not here.

    Raises:
        ValueError: it was made with other settings, weights or frames.
    """
    if not all((stored / file).is_file() for file in KEPT):
        return False
    try:
        finished_run(build_training(config, stored))
    except FileNotFoundError as error:  # the settings were compared before
        say(f"{name}: finished before; its frames are not here to be compared ({str(error).splitlines()[0]})")
        return True
    except ValueError as error:
        raise ValueError(
            f"{error}. Or remove its run folder, if there is one, and train it anew (rerun=true), which "
            "replaces what is stored"
        ) from error
    say(f"{name}: finished before")
    return True


def store(folder: Path, stored: Path) -> None:
    """Copy what tables are made of; a kill half way leaves no run that looks stored."""
    stored.mkdir(parents=True, exist_ok=True)
    for file in KEPT:
        shutil.copyfile(folder / file, stored / f"{file}.part")
    (stored / RUN_FILE).unlink(missing_ok=True)  # an earlier run's does not stand beside this one's files
    for file in KEPT:
        os.replace(stored / f"{file}.part", stored / file)


def _failed(folder: Path, name: str, error: Exception, say: Say) -> Outcome:
    """Note it: the other runs go on."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "failed.txt").write_text(traceback.format_exc())
    say(f"{name} failed: {error} (see {folder / 'failed.txt'})")
    return Outcome(name, "failed", f"{type(error).__name__}: {error}")

"""Runs of a study: finished ones are skipped, killed ones go on, a failed one does not stop the rest."""

import json
import shutil
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.record import RUN_FILE, read_run, write_json
from eldenet.studies.plan import STORED, Study, StudyRow
from eldenet.train import finished_run, train

if TYPE_CHECKING:
    from omegaconf import DictConfig

RATE_FILE = "learning_rate.json"
KEPT = (RUN_FILE, "per_image.csv")
Say = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What became of one run: "done", "finished before", "... not given", or "failed"."""

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
    say: Say = print,
) -> list[Outcome]:
    """All runs of one row: the learning rate's trials, then one run per seed.

    Args:
        study: whose results are stored beside its plan; of a row taken from another study, that one.
        row: of it.
        runs: folder for the run folders, ``<runs>/<study>/<row>/...``.
        given: name -> value of what rows ask for.
        seeds: those of the row's seeds to run; None: all. A row without any of them has nothing to do.
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
            say(f"{study.name}/{row.name}: {row.missing_word} (given.{name}=...)")
            return [Outcome(f"{row.name}/seed{seed}", row.missing_word) for seed in chosen]
        settings[setting] = value
    folder = runs / study.name
    shared = [*study.overrides, *row.overrides, *(f"{name}='{value}'" for name, value in settings.items())]
    try:
        rate = learning_rate(study, row, shared, folder, say)
    except Exception as error:
        return [_failed(folder / row.name, f"{row.name}/learning rate", error, say)]
    if rate is not None:
        shared.append(f"optimizer.lr={rate}")
    return [_run_seed(study, row, seed, shared, folder, say) for seed in chosen]


def _run_seed(study: Study, row: StudyRow, seed: int, shared: list[str], runs: Path, say: Say) -> Outcome:
    name, stored = f"{row.name}/seed{seed}", study.stored(row, seed)
    folder = runs / row.name / f"seed{seed}"
    try:
        config = compose_run(shared, folder, runs, name=row.name, seed=seed)
        if finished_run(config, stored) is not None:
            say(f"{study.name}/{name}: finished before")
            return Outcome(name, "finished before")
        train(config, folder)
        stored.mkdir(parents=True, exist_ok=True)
        for file in KEPT:
            shutil.copyfile(folder / file, stored / file)
    except Exception as error:
        return _failed(folder, name, error, say)
    (folder / "failed.txt").unlink(missing_ok=True)
    return Outcome(name, "done")


def _failed(folder: Path, name: str, error: Exception, say: Say) -> Outcome:
    """Note it: the other runs go on."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "failed.txt").write_text(traceback.format_exc())
    say(f"{name} failed: {error} (see {folder / 'failed.txt'})")
    return Outcome(name, "failed", f"{type(error).__name__}: {error}")


def compose_run(shared: list[str], folder: Path, runs: Path, *, name: str, seed: int) -> "DictConfig":
    """The training config of one run, as its command line would give it."""
    filled = [text.replace("{runs}", str(runs)).replace("{seed}", str(seed)) for text in shared]
    own = [f"model_name='{name}'", f"seed={seed}", f"run_dir='{folder}'", "ckpt_path=auto"]
    return cfg.compose("train", [*filled, *own])


def learning_rate(study: Study, row: StudyRow, shared: list[str], runs: Path, say: Say) -> float | None:
    """The row's learning rate: fixed, or the best of a few short trials; None: the optimiser's own.

    A trial is scored on a held-out part of the training split, so the split that is reported chooses nothing.
    The choice is kept beside the stored runs, with the score of every candidate.

    Raises:
        ValueError: a choice is stored that other candidates or settings led to, or every trial diverged.
    """
    if row.learning_rate is not None or not study.learning_rates:
        return row.learning_rate
    file = study.folder / STORED / row.name / RATE_FILE
    trial = [*shared, *study.rate_overrides, *row.rate_overrides]
    rule = {"candidates": list(study.learning_rates), "overrides": trial}
    if file.is_file():
        kept = json.loads(file.read_text())
        if kept["rule"] != rule:
            raise ValueError(f"{file} was chosen by another rule ({kept['rule']}): remove it to choose again")
        return float(kept["learning_rate"])
    scores: dict[str, float | None] = {}
    record: dict[str, Any] = {}
    for rate in study.learning_rates:
        folder = runs / row.name / f"lr{rate:g}"
        say(f"{study.name}/{row.name}: trial of learning rate {rate:g}")
        config = compose_run([*trial, f"optimizer.lr={rate}"], folder, runs, name=row.name, seed=0)
        try:
            train(config, folder)
        except FloatingPointError:
            scores[f"{rate:g}"] = None  # diverged
            continue
        record = read_run(folder)
        scores[f"{rate:g}"] = record["metrics"]["delta1"]
    reached = {rate: score for rate, score in scores.items() if score is not None}
    if not reached:
        raise ValueError(f"every learning rate of {list(scores)} diverged: give lower ones in {study.folder}")
    best = max(reached, key=lambda rate: reached[rate])
    content = {
        "learning_rate": float(best),
        "delta1": scores,
        "protocol": record["protocol"]["name"],
        "train_split_hash": record["train_split_hash"],
        "held_out_split_hash": record["split_hash"],
        "held_out_images": record["metrics"]["images"],
        "rule": rule,
    }
    write_json(file, content)
    return float(best)

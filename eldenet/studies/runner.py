"""Runs of a study: finished ones are skipped, killed ones resume, a failed one does not stop the rest."""

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from eldenet.cli.help import advice
from eldenet.compose import compose
from eldenet.results.fingerprints import fingerprints, run_differences
from eldenet.results.packed_runs import RUNS, add_record, pack
from eldenet.results.run_record import read_run
from eldenet.studies.matching import refuse_missing, run_overrides, search_differences
from eldenet.studies.plan import RATE, Study, StudyRow, rate_name, run_name, training_settings
from eldenet.system.errors import first_line
from eldenet.system.files import FolderInUse, sole_writer, write_text
from eldenet.train import TrainSettings, checked_parts, train
from eldenet.training.resume import check_finished

FURTHER = 2  # candidates beyond the study's, at most, where the best one lies at the edge
Say = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What became of a run: "done", "finished before", "running elsewhere", "... not given" or "failed"."""

    run: str
    status: str
    reason: str = ""


def run_row(
    study: Study,
    row: StudyRow,
    runs: Path,
    *,
    seeds: Sequence[int] | None = None,
    rerun: bool = False,
    given: Mapping[str, Any] = MappingProxyType({}),
    say: Say = print,
) -> list[Outcome]:
    """All runs of one row: the trials of learning rates, then one run per seed.

    Args:
        study: that the row is of; a row taken from another study is run and stored as that one's.
        row: of it.
        runs: run folders are made below ``<runs>/<study>/<row>``.
        seeds: those of the row's seeds to run; None: all.
        rerun: also train what is stored but not below ``runs``: for its weights, which are not stored, or
            because other settings or weights made it; the stored results are replaced.
        given: name -> value of what the row asks for.
        say: prints a line.
    """
    study = study.owner_of(row)
    chosen = _seeds_of(row, seeds)
    where = f"{study.name}/{row.name}"
    if not chosen:
        return []
    if missing := [name for name in row.given if given.get(name) is None]:
        plus = "" if missing[0] in given else "+"  # Hydra's sign for a new name
        say(f"{where}: {row.not_given} ({plus}given.{missing[0]}=...)")
        return [Outcome(run_name(row, seed), row.not_given) for seed in chosen]
    shared = _with_given(study, row, given)
    run = _RowRun(study, row, rerun, say, runs / study.name)
    try:
        with sole_writer(run.folder):
            return run.run_seeds(chosen, shared)
    except FolderInUse as error:
        say(f"{where}: {error}")
        return [Outcome(run_name(row, seed), "running elsewhere") for seed in chosen]


def refuse_wrong_rows(
    study: Study,
    rows: Sequence[StudyRow],
    runs: Path,
    *,
    seeds: Sequence[int] | None = None,
    rerun: bool = False,
    given: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Compose and check the settings of all runs to come, as :func:`run_row` would one after the other.

    Raises:
        ValueError: those of some rows are wrong; it names these rows.
    """
    wrong = []
    for row in rows:
        owner = study.owner_of(row)
        missing = [seed for seed in _seeds_of(row, seeds) if rerun or owner.stored(row, seed) is None]
        if not missing or any(given.get(name) is None for name in row.given):
            continue
        shared = _with_given(owner, row, given)
        trial = [*shared, *owner.rate_overrides, *row.rate_overrides]
        folder = runs / owner.name
        for words in (shared, trial) if owner.searches_rate(row) else (shared,):
            words = run_overrides(words, folder / row.name, folder, name=row.name, seed=missing[0])
            try:
                settings = compose(TrainSettings, words)
                if not any("{runs}" in word for word in shared):  # it may need a run that is still to come
                    checked_parts(settings)
            except Exception as error:
                wrong.append(f"row {row.name}: {advice('train', words) or first_line(error)}")
                break
    if wrong:
        raise ValueError(f"nothing was trained, since settings are wrong: {'; '.join(wrong)}")


def _seeds_of(row: StudyRow, seeds: Sequence[int] | None) -> list[int]:
    return [seed for seed in row.seeds if seeds is None or seed in seeds]


def _with_given(study: Study, row: StudyRow, given: Mapping[str, Any]) -> list[str]:
    """The row's overrides with what the command line gives."""
    return study.overrides_of(row) + [f"{setting}='{given[name]}'" for name, setting in row.given.items()]


@dataclass(frozen=True)
class _RowRun:
    """One row while it is run."""

    study: Study
    row: StudyRow
    rerun: bool
    say: Say
    runs: Path

    @property
    def folder(self) -> Path:
        return self.runs / self.row.name

    def overrides(self, shared: Sequence[str], folder: Path, seed: int = 0) -> list[str]:
        return run_overrides(shared, folder, self.runs, name=self.row.name, seed=seed)

    def failed(self, folder: Path, name: str, error: Exception) -> Outcome:
        """Record an error; the other runs continue."""
        folder.mkdir(parents=True, exist_ok=True)
        write_text(folder / "failed.txt", traceback.format_exc())
        self.say(f"{name} failed: {error} (see {folder / 'failed.txt'})")
        return Outcome(name, "failed", f"{type(error).__name__}: {error}")

    # ------------------------------------------------------------------ one run per seed

    def run_seeds(self, seeds: Sequence[int], shared: list[str]) -> list[Outcome]:
        """Choose the learning rate, then train one run per seed."""
        try:
            rate = self.learning_rate(shared)
        except Exception as error:
            return [self.failed(self.folder, f"{self.row.name}/learning rate", error)]
        (self.folder / "failed.txt").unlink(missing_ok=True)
        if rate is not None:
            shared.append(f"{RATE}={rate}")
        return [self.run_seed(seed, shared) for seed in seeds]

    def run_seed(self, seed: int, shared: Sequence[str]) -> Outcome:
        """Train one run and store its results, unless they are stored already."""
        name = run_name(self.row, seed)
        folder = self.runs / name
        overrides = self.overrides(shared, folder, seed)
        try:
            if not self.rerun and self._finished(overrides, seed):
                return Outcome(name, "finished before")
            refuse_missing(self.row, self.runs, seed)
            train(compose(TrainSettings, overrides))
            pack(folder, self.study.folder, name)
        except Exception as error:
            return self.failed(folder, name, error)
        (folder / "failed.txt").unlink(missing_ok=True)
        return Outcome(name, "done")

    def _finished(self, overrides: Sequence[str], seed: int) -> bool:
        """Whether this very run is stored; without its frames the settings alone are compared."""
        record, name = self.study.stored(self.row, seed), f"{self.study.name}/{run_name(self.row, seed)}"
        if record is None:
            return False
        note = ""
        try:
            different = run_differences(training_settings(overrides), record)
            if different:
                raise ValueError(f"{name} is stored with other settings: {'; '.join(different[:5])}")
            check_finished(self.study.folder / f"{RUNS}, {name}", record, training_settings(overrides))
        except FileNotFoundError as error:
            note = f"; its frames are not here to be compared ({str(error).splitlines()[0]})"
        except ValueError as error:
            raise ValueError(
                f"{error}. To replace what is stored, remove the run folder, if there is one, and train "
                "again with rerun=true"
            ) from error
        self.say(f"{name}: finished before{note}")
        return True

    # ------------------------------------------------------------------ the learning rate

    def learning_rate(self, shared: Sequence[str]) -> float | None:
        """The row's learning rate: fixed, or the best of a few short trials; None: the optimizer's own.

        A trial is scored on a held-out part of the training split, so the split that is reported chooses
        nothing. While the best candidate is the lowest or highest, the next one beyond it is tried too. The
        choice is kept beside the stored runs with the score of every candidate.

        Raises:
            FileNotFoundError: the trials start from the run of another row, which has not finished.
            ValueError: a choice made with other candidates, settings or weights is stored, and ``rerun`` is
                not set; or every trial diverged.
        """
        study, row = self.study, self.row
        if not study.searches_rate(row):
            return row.learning_rate
        trial = [*shared, *study.rate_overrides, *row.rate_overrides]
        settings = training_settings(self.overrides(trial, self.folder / "trial"))
        rule = {"candidates": list(study.learning_rates), "further": FURTHER, "config": settings}
        kept = self._kept_rate(settings)
        if kept is not None:
            return kept
        refuse_missing(row, self.runs, seed=0)
        scores: dict[float, float | None] = {}
        record: dict[str, Any] = {}
        waiting = list(study.learning_rates)
        while waiting:
            rate = waiting.pop(0)
            self.say(f"{study.name}/{row.name}: trial of learning rate {rate:g}")
            found = self._try(trial, rate)
            scores[rate] = None if found is None else found["metrics"]["delta1"]
            record = found or record
            if not waiting and len(scores) < len(study.learning_rates) + FURTHER:
                waiting = next_candidates(scores)
        best = best_rate(scores)
        if best is None:
            raise ValueError(
                f"every learning rate of {list(scores)} diverged: give lower ones in {study.folder}"
            )
        content = {
            "learning_rate": best,
            "delta1": {f"{rate:g}": scores[rate] for rate in sorted(scores)},
            "protocol": record["protocol"]["name"],
            "train_split_hash": record["train_split_hash"],
            "held_out_split_hash": record["split_hash"],
            "held_out_images": record["metrics"]["images"],
            "sources": fingerprints(settings),
            "rule": rule,
        }
        add_record(study.folder, rate_name(row), content)
        return best

    def _kept_rate(self, trial: Mapping[str, Any]) -> float | None:
        """The stored choice; None: there is none, or another search made it and ``rerun`` replaces it."""
        kept = self.study.stored_rate(self.row)
        if kept is None:
            return None
        different = search_differences(self.study.learning_rates, trial, kept)
        if different and not self.rerun:
            raise ValueError(
                f"the stored learning rate was chosen by another rule ({'; '.join(different[:5])}). Restore "
                "that rule, or choose and train again with rerun=true, which replaces what is stored"
            )
        return None if different else float(kept["learning_rate"])

    def _try(self, trial: Sequence[str], rate: float) -> dict[str, Any] | None:
        """``run.json`` of a trial; None: it diverged."""
        folder = self.folder / f"lr{rate:g}"
        try:
            train(compose(TrainSettings, self.overrides([*trial, f"{RATE}={rate}"], folder)))
        except FloatingPointError:
            return None
        return read_run(folder)


def best_rate(scores: Mapping[float, float | None]) -> float | None:
    """The candidate of the highest score; None: all of them diverged."""
    reached = {rate: score for rate, score in scores.items() if score is not None}
    return max(reached, key=lambda rate: reached[rate]) if reached else None


def next_candidates(scores: Mapping[float, float | None]) -> list[float]:
    """The candidate beyond the best one if that lies at the edge: 1e-4 below 3e-4, 1e-2 above 3e-3."""
    best, tried = best_rate(scores), sorted(scores)
    if best is None or len(tried) < 2 or best not in (tried[0], tried[-1]):
        return []
    digit, _, exponent = f"{best:.0e}".partition("e")
    if best == tried[0]:
        return [float(f"1e{exponent}") if digit != "1" else float(f"3e{int(exponent) - 1}")]
    return [float(f"1e{int(exponent) + 1}") if digit != "1" else float(f"3e{exponent}")]

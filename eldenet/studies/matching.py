"""From a study's row to the settings of its runs, and the stored runs that were made with these settings."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eldenet.results.fingerprints import run_differences
from eldenet.results.packed_runs import RUNS
from eldenet.results.run_record import RUN_FILE, check_entries, scored_run
from eldenet.studies.plan import RATE, Study, StudyRow, rate_name, run_name, training_settings

#: Entries of a stored run.
NEEDED = (
    *("seed", "data", "split", "split_hash", "metrics.images", "config", "date"),
    *("cost.height", "cost.width", "cost.params", "cost.gmacs"),
    *("versions.torch", "hardware.processor", "resources.precision"),
)
_OTHER_RUN = re.compile(r"\{runs\}/([\w./-]+)")  # in an override: the run of another row


def run_overrides(shared: Sequence[str], folder: Path, runs: Path, *, name: str, seed: int) -> list[str]:
    """Overrides of ``eldenet.train`` for one run, as its command line would give them.

    ``shared`` are the row's, with ``{runs}`` and ``{seed}``; ``runs`` is the folder of the study's runs.
    """
    filled = [text.replace("{runs}", str(runs)).replace("{seed}", str(seed)) for text in shared]
    return [*filled, f"model_name='{name}'", f"seed={seed}", f"output='{folder}'", "ckpt_path=auto"]


def refuse_missing(row: StudyRow, runs: Path, seed: int) -> None:
    """Raise FileNotFoundError if a run is missing whose weights the row starts or learns from."""
    texts = [text.replace("{seed}", str(seed)) for text in row.overrides]
    needed = [Path(runs / name).resolve() for text in texts for name in _OTHER_RUN.findall(text)]
    missing = [path for path in needed if not (path / RUN_FILE).is_file()]
    if missing:
        raise FileNotFoundError(
            f"{row.name} needs the weights of {', '.join(map(str, missing))}: run that row first, "
            "with rerun=true if its results are already stored"
        )


@dataclass(frozen=True)
class Choice:
    """The learning rate that the trials of a row chose."""

    rate: float  # the best one
    tried: tuple[float, ...]  # all, in ascending order
    record: Mapping[str, Any]  # everything that is stored of the trials

    @property
    def at_the_edge(self) -> bool:
        """Whether a better one may lie beyond those that were tried."""
        return self.rate in (self.tried[0], self.tried[-1])


def stored_choice(study: Study, row: StudyRow) -> Choice | None:
    """The stored choice of a row's trials; None: there is none, or the row's learning rate is given."""
    record = study.stored_rate(row) if study.searches_rate(row) else None
    if record is None:
        return None
    check_entries(rate_name(row), record, "learning_rate", "delta1", "rule.candidates", "rule.config")
    tried = tuple(sorted(float(rate) for rate in record["delta1"]))
    return Choice(float(record["learning_rate"]), tried, record)


def search_differences(
    candidates: Sequence[float],
    trial: Mapping[str, Any],
    record: Mapping[str, Any],
    given: frozenset[str] | None = None,
) -> list[str]:
    """Differences, in words, between the search for a learning rate that is asked for and a stored one.

    ``trial`` are the resolved settings of a trial, ``record`` is the stored choice; ``given`` is that of
    :func:`~eldenet.results.fingerprints.run_differences`.
    """
    rule = record["rule"]
    asked = {"candidates": list(candidates), **trial}
    chosen = {"config": {"candidates": rule["candidates"], **rule["config"]}, "sources": record["sources"]}
    return run_differences(asked, chosen, ignored=frozenset(("lr",)), given=given)


def outdated_search(study: Study, row: StudyRow, choice: Choice) -> list[str]:
    """Differences between the trials that the plan asks for and those behind a stored choice."""
    trial = planned_settings(row, study.overrides_of(row, trial=True), seed=0)
    candidates = study.owner_of(row).learning_rates
    return search_differences(candidates, trial, choice.record, frozenset(row.given.values()))


def outdated(study: Study, row: StudyRow, run: Mapping[str, Any]) -> list[str]:
    """Differences between the settings that the plan asks for and those of a stored run; needs no data.

    Of weights and teachers, only their presence and the content of packaged ones are compared: where others
    lie, only the command that runs the row knows. The learning rate is the row's, or its stored choice.
    """
    choice = stored_choice(study, row)
    rate = row.learning_rate if choice is None else choice.rate
    further = [] if rate is None else [f"{RATE}={rate}"]
    settings = planned_settings(row, [*study.overrides_of(row), *further], seed=int(run["seed"]))
    ignored = frozenset(("lr",)) if rate is None else frozenset()
    return run_differences(settings, run, ignored=ignored, given=frozenset(row.given.values()))


def planned_settings(row: StudyRow, shared: Sequence[str], *, seed: int) -> dict[str, Any]:
    """The settings of a row's run with these overrides, wherever it would be stored."""
    nowhere = Path("unused")
    return training_settings(run_overrides(shared, nowhere, nowhere, name=row.name, seed=seed))


@dataclass(frozen=True)
class Stored:
    """The stored runs of a row, if they were made with the settings that the plan asks for today."""

    runs: list[dict[str, Any]] = field(default_factory=list)  # contents of run.json, one per finished seed
    outdated: str | None = None  # a setting that differs from the plan; there are no runs then


def stored_runs(study: Study, row: StudyRow) -> Stored:
    """The stored runs of a row, for the tables and plots of the study."""
    found = {seed: run for seed in row.seeds if (run := study.stored(row, seed)) is not None}
    where = study.owner_of(row).folder / RUNS
    runs = [scored_run(f"{where}, {run_name(row, seed)}", run, *NEEDED) for seed, run in found.items()]
    for run in runs:
        if different := outdated(study, row, run):
            return Stored(outdated=different[0])
    if study.epoch == "last":
        runs = [run | {"metrics": last_metrics(run)} for run in runs]
    return Stored(runs)


def last_metrics(run: Mapping[str, Any]) -> dict[str, Any]:
    """Metrics of a run after its last epoch, on the frames that it was validated on.

    Raises:
        ValueError: it was validated on other frames than the table's, so that the metrics of the kept epoch
            differ, or not after its last epoch.
    """
    history = {row["epoch"]: row for row in run["training"]["history"]}
    kept, last = history[run["training"]["best_epoch"]], history[max(history)]
    who = f"{run['model']}, seed {run['seed']}"
    if "val_delta1" not in last:
        raise ValueError(f"{who} was not validated after its last epoch, which 'epoch: last' requires")
    known = {name for name in run["metrics"] if f"val_{name}" in last}  # not: images, pixels
    other = [name for name in sorted(known) if not _close(kept.get(f"val_{name}"), run["metrics"][name])]
    if other:
        raise ValueError(
            f"{who} was validated on frames other than those of its table ({', '.join(other)} of the kept "
            "epoch differ), so 'epoch: last' has no metrics for the table"
        )
    return {**run["metrics"], **{name: last[f"val_{name}"] for name in known}}


def _close(one: float | None, two: float | None) -> bool:
    if one is None or two is None:
        return one is two
    return math.isclose(one, two, rel_tol=1e-3)

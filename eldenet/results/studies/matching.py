"""From a study's row to the training config of one of its runs, and back to what a stored run lacks of it."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.results.fingerprints import run_differences
from eldenet.results.run_record import RUN_FILE, read_record
from eldenet.results.studies.plan import RATE, RATE_FILE, STORED, Study, StudyRow

if TYPE_CHECKING:
    from omegaconf import DictConfig

_NEEDED = re.compile(r"\{runs\}/([\w./-]+)")


def compose_run(shared: Sequence[str], folder: Path, runs: Path, *, name: str, seed: int) -> "DictConfig":
    """The training config of one run, as its command line would give it."""
    filled = [text.replace("{runs}", str(runs)).replace("{seed}", str(seed)) for text in shared]
    own = [f"model_name='{name}'", f"seed={seed}", f"run_dir='{folder}'", "ckpt_path=auto"]
    return cfg.compose("train", [*filled, *own])


def refuse_missing(row: StudyRow, runs: Path, seed: int) -> None:
    """Refuse to start from, or be taught by, another row's run that is not finished below ``runs``.

    Raises:
        FileNotFoundError: names its folder.
    """
    texts = [text.replace("{seed}", str(seed)) for text in row.overrides]
    needed = [Path(runs / name).resolve() for text in texts for name in _NEEDED.findall(text)]
    missing = [path for path in needed if not (path / RUN_FILE).is_file()]
    if missing:
        raise FileNotFoundError(
            f"{row.name} needs the weights of {', '.join(map(str, missing))}: run that row first; where its "
            "results are stored already, with rerun=true"
        )


@dataclass(frozen=True)
class Choice:
    """The learning rate that the trials of a row chose, and all that were tried.

    Attributes:
        rate: the best one.
        tried: in ascending order.
        record: all that is stored of the trials.
    """

    rate: float
    tried: tuple[float, ...]
    record: Mapping[str, Any]

    @property
    def at_the_edge(self) -> bool:
        """Whether a better one may lie beyond those that were tried."""
        return self.rate in (min(self.tried), max(self.tried))


def stored_choice(study: Study, row: StudyRow) -> Choice | None:
    """What is stored of a row's trials; None: nothing, or its learning rate is given."""
    plan = row.owner or study
    file = plan.folder / STORED / row.name / RATE_FILE
    if row.learning_rate is not None or not plan.learning_rates or not file.is_file():
        return None
    record = read_record(file)
    tried = tuple(sorted(float(rate) for rate in record["delta1"]))
    return Choice(float(record["learning_rate"]), tried, record)


def search_differences(
    candidates: Sequence[float], trial: Mapping[str, Any], record: Mapping[str, Any], **options: Any
) -> list[str]:
    """What tells a search for a learning rate from the one that led to a stored choice, in words.

    Args:
        candidates: learning rates that are tried.
        trial: resolved config of a trial, plain.
        record: what is stored of the choice (``learning_rate.json``).
        options: of :func:`eldenet.results.fingerprints.run_differences`.
    """
    theirs = record["rule"]
    found = []
    if list(candidates) != theirs["candidates"]:
        found.append(f"candidates={list(candidates)} (there {theirs['candidates']})")
    ignored = options.pop("ignored", frozenset()) | {"lr"}
    chosen = {"config": theirs["config"], "sources": record["sources"]}
    return found + run_differences(trial, chosen, ignored=ignored, **options)


def outdated(study: Study, row: StudyRow, run: Mapping[str, Any]) -> list[str]:
    """What the plan says today of a stored run's settings, where that is something else; no data is needed.

    Weights and teachers: whether there are any, and the content of those that come with the package; where
    others lie, and what is given, knows the command that runs the row. The learning rate is the row's, or the
    one that is stored as its choice.
    """
    choice = stored_choice(study, row)
    rate = choice.rate if choice is not None else row.learning_rate
    options = _without_data(row)
    if rate is None:
        options["ignored"] |= {"lr"}
    config = _composed(study, row, [] if rate is None else [f"{RATE}={rate}"], seed=int(run["seed"]))
    return run_differences(config, run, **options)


def outdated_search(study: Study, row: StudyRow, choice: Choice) -> list[str]:
    """What the plan says today of the trials behind a stored choice, as :func:`outdated` of its runs."""
    plan = row.owner or study
    trial = _composed(study, row, [*plan.rate_overrides, *row.rate_overrides], seed=0)
    return search_differences(plan.learning_rates, trial, choice.record, **_without_data(row))


def _composed(study: Study, row: StudyRow, further: Sequence[str], *, seed: int) -> Any:
    """The plan's config of a run, plain, where nobody knows the run folders."""
    shared, nowhere = [*(row.owner or study).overrides, *row.overrides, *further], Path("unused")
    return cfg.plain(compose_run(shared, nowhere, nowhere, name=row.name, seed=seed))


def _without_data(row: StudyRow) -> dict[str, Any]:
    """Options of a comparison that knows neither the run folders nor what is given on a command line."""
    given = frozenset((row.given or {}).values())
    ignored = frozenset(setting.rpartition(".")[2] for setting in given)
    return {"ignored": ignored, "elsewhere": given, "by_path": False}

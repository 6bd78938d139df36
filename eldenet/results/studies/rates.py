"""The learning rate of a study's row: the best of a few short trials on frames that no table reports."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from eldenet import config as cfg
from eldenet.config import build_training
from eldenet.results.fingerprints import fingerprints
from eldenet.results.run_record import read_record, read_run
from eldenet.results.studies.matching import compose_run, refuse_missing, search_differences
from eldenet.results.studies.plan import RATE, RATE_FILE, STORED, Study, StudyRow
from eldenet.system.files import write_json
from eldenet.training.run import train

FURTHER = 2  # candidates beyond the study's, at most, where the best one lies at the edge
Say = Callable[[str], None]


def learning_rate(
    study: Study, row: StudyRow, shared: list[str], runs: Path, say: Say, *, rerun: bool = False
) -> float | None:
    """The row's learning rate: fixed, or the best of a few short trials; None: the optimizer's own.

    A trial is scored on a held-out part of the training split, so the split that is reported chooses nothing.
    While the best candidate is the lowest or highest, the next one beyond it is tried too. The choice is kept
    beside the stored runs, with the score of every candidate. One that other candidates, settings or weights
    led to is made anew with ``rerun``.

    Raises:
        FileNotFoundError: the trials would start from another row's run, which is not finished.
        ValueError: such a choice is stored, without ``rerun``; or every trial diverged.
    """
    if row.learning_rate is not None or not study.learning_rates:
        return row.learning_rate
    file = study.folder / STORED / row.name / RATE_FILE
    trial = [*shared, *study.rate_overrides, *row.rate_overrides]
    config = compose_run(trial, runs / row.name / "trial", runs, name=row.name, seed=0)
    rule = {"candidates": list(study.learning_rates), "further": FURTHER, "config": cfg.plain(config)}
    if file.is_file():
        kept = kept_rate(file, rule, rerun=rerun)
        if kept is not None:
            return kept
    refuse_missing(row, runs, seed=0)
    scores: dict[float, float | None] = {}
    record: dict[str, Any] = {}
    waiting = list(study.learning_rates)
    while waiting:
        rate = waiting.pop(0)
        say(f"{study.name}/{row.name}: trial of learning rate {rate:g}")
        found = _try(row, [*trial, f"{RATE}={rate}"], rate, runs)
        scores[rate] = None if found is None else found["metrics"]["delta1"]
        record = found or record
        if not waiting and len(scores) < len(study.learning_rates) + FURTHER:
            waiting = next_candidates(scores)
    best = best_rate(scores)
    if best is None:
        raise ValueError(f"every learning rate of {list(scores)} diverged: give lower ones in {study.folder}")
    content = {
        "learning_rate": best,
        "delta1": {f"{rate:g}": scores[rate] for rate in sorted(scores)},
        "protocol": record["protocol"]["name"],
        "train_split_hash": record["train_split_hash"],
        "held_out_split_hash": record["split_hash"],
        "held_out_images": record["metrics"]["images"],
        "sources": fingerprints(rule["config"]),
        "rule": rule,
    }
    write_json(file, content)
    return best


def best_rate(scores: Mapping[float, float | None]) -> float | None:
    """The candidate of the highest score; None: all of them diverged."""
    reached = {rate: score for rate, score in scores.items() if score is not None}
    return max(reached, key=lambda rate: reached[rate]) if reached else None


def next_candidates(scores: Mapping[float, float | None]) -> list[float]:
    """The candidate beyond the best one, if that lies at the edge: 1e-4 below 3e-4, 1e-2 above 3e-3."""
    best, tried = best_rate(scores), sorted(scores)
    if best is None or len(tried) < 2 or best not in (tried[0], tried[-1]):
        return []
    digit, _, exponent = f"{best:.0e}".partition("e")
    if best == tried[0]:
        return [float(f"1e{exponent}") if digit != "1" else float(f"3e{int(exponent) - 1}")]
    return [float(f"1e{int(exponent) + 1}") if digit != "1" else float(f"3e{exponent}")]


def kept_rate(file: Path, rule: dict[str, Any], *, rerun: bool) -> float | None:
    """The choice that is stored; None: another rule led to it, and ``rerun`` makes it anew.

    Raises:
        ValueError: other candidates, settings or weights led to it, and nobody asked to make it anew.
    """
    kept = read_record(file)
    different = search_differences(rule["candidates"], rule["config"], kept)
    if different and not rerun:
        raise ValueError(
            f"{file} was chosen by another rule ({'; '.join(different[:5])}). Take these back, or choose and "
            "train anew, and replace what is stored: rerun=true"
        )
    return None if different else float(kept["learning_rate"])


def _try(row: StudyRow, overrides: Sequence[str], rate: float, runs: Path) -> dict[str, Any] | None:
    """``run.json`` of a trial; None: it diverged."""
    folder = runs / row.name / f"lr{rate:g}"
    try:
        config = compose_run(list(overrides), folder, runs, name=row.name, seed=0)
        train(build_training(config, folder))
    except FloatingPointError:
        return None
    return read_run(folder)

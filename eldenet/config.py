"""What studies and their reports are built from."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig

from eldenet.compose import listed, plain
from eldenet.configurable import instantiate as build_part

if TYPE_CHECKING:
    from eldenet.results.studies.plan import Composition
    from eldenet.results.studies.runner import StudySetup, Training


def training_composition() -> "Composition":
    """Return the functions that turn a study's overrides of ``eldenet.train`` into settings and networks."""
    from eldenet.compose import compose as settings_of
    from eldenet.results.studies.plan import Composition
    from eldenet.train import TrainSettings

    def settings(overrides: Sequence[str]) -> dict[str, Any]:
        return asdict(settings_of(TrainSettings, overrides))

    return Composition(settings, lambda model: build_part(model, "model"))


def study_training() -> "Training":
    """Return how a study's runs are trained: as ``eldenet.train`` trains."""
    from eldenet.compose import compose as settings_of
    from eldenet.results.studies.runner import Training
    from eldenet.train import TrainSettings, train
    from eldenet.training.resume import check_finished

    def settings(overrides: Sequence[str], folder: Path) -> TrainSettings:
        return settings_of(TrainSettings, [*overrides, f"output='{folder}'"])

    return Training(
        lambda overrides, folder: train(settings(overrides, folder)),
        lambda overrides, where, record: check_finished(where, record, asdict(settings(overrides, where))),
        training_composition(),
    )


def build_study(config: DictConfig) -> "StudySetup":
    """Return the setup of ``python -m eldenet.study``: which runs are trained, and where."""
    from eldenet.results.studies.runner import StudySetup

    return StudySetup(
        study=config.study,
        runs=Path(config.runs),
        rows=plain(config.rows),
        job=config.row,
        seeds=None if config.seeds is None else listed(config.seeds),
        rerun=config.rerun,
        given=plain(config.given),
    )

"""What studies and their reports are built from."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.compose import compose
from eldenet.configurable import instantiate

if TYPE_CHECKING:
    from eldenet.results.studies.plan import Composition
    from eldenet.results.studies.runner import Training


def training_composition() -> "Composition":
    """Return the functions that turn a study's overrides of ``eldenet.train`` into settings and networks."""
    from eldenet.results.studies.plan import Composition
    from eldenet.train import TrainSettings

    def settings(overrides: Sequence[str]) -> dict[str, Any]:
        return asdict(compose(TrainSettings, overrides))

    return Composition(settings, lambda model: instantiate(model, "model"))


def study_training() -> "Training":
    """Return how a study's runs are trained: as ``eldenet.train`` trains."""
    from eldenet.results.studies.runner import Training
    from eldenet.train import TrainSettings, train
    from eldenet.training.resume import check_finished

    def settings(overrides: Sequence[str], folder: Path) -> TrainSettings:
        return compose(TrainSettings, [*overrides, f"output='{folder}'"])

    return Training(
        lambda overrides, folder: train(settings(overrides, folder)),
        lambda overrides, where, record: check_finished(where, record, asdict(settings(overrides, where))),
        training_composition(),
    )

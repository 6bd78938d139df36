"""From a trained network to ``run.json``: what ``train`` and ``evaluate`` both end with."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch import nn

from eldenet.data.rendered import RenderedScenes
from eldenet.evaluation.constant_baseline import fit_constant_predictor
from eldenet.evaluation.cost import CostReport, measure_cost
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, Evaluation, evaluate, sample_rows
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.uncertainty_metrics import PROTOCOL
from eldenet.model import DepthNet
from eldenet.results.fingerprints import fingerprints
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import RUN_FILE, environment
from eldenet.results.uncertainty_plots import write_uncertainty
from eldenet.system.files import write_json, write_rows
from eldenet.system.resources import Resources

if TYPE_CHECKING:
    from eldenet.data.base import DepthDataset

RENDERED_FOR_A_CONSTANT = 512  # frames: as many as a test split has


@dataclass(frozen=True)
class ScoreSetup:
    """What is scored, by which rules, and where the result goes.

    Attributes:
        folder: of the run.
        name: of the row in tables.
        data: name of the data set.
        seed: of the training; None where it is not known.
        protocol: the rules.
        make_split: as :func:`eldenet.config.build_split` without its config.
        resources: device, threads, workers.
        settings: resolved, which ``run.json`` stores.
        split: "train", "val" or "test".
        batch_size: of the evaluation.
        measure: network and ``(height, width)`` [px] -> its cost.
        training_frames: of a rendered training split that may not be rendered yet; None: it is all there.
    """

    folder: Path
    name: str
    data: str
    seed: int | None
    protocol: EvalProtocol
    make_split: Callable[..., "DepthDataset"]
    resources: Resources
    settings: Mapping[str, Any]
    split: str = "test"
    batch_size: int = 16
    measure: Callable[[Any, tuple[int, int]], CostReport] = measure_cost
    training_frames: int | None = None


def score_and_record(
    setup: ScoreSetup, model: nn.Module, log: RunLog, facts: Mapping[str, Any] | None = None, *, step: int = 0
) -> dict[str, Any]:
    """Evaluate, measure the cost; write ``run.json``, ``per_image.csv`` and ``predictions.png``.

    Of a network that predicts its sigma also ``uncertainty.csv``, ``sparsification.png`` and
    ``reliability.png``.

    Args:
        setup: what is scored and how.
        model: a :class:`~eldenet.model.DepthNet`, or an exported file as a module.
        log: what the person sees.
        facts: of the training, if there was one: ``training`` (its progress), ``skipped`` (split -> name ->
            reason), ``teacher`` (loss term -> source and hash) and ``overrides`` (of the command line).
        step: of the training, where TensorBoard shows the pictures.

    Returns:
        What was written to ``run.json``.
    """
    facts = dict(facts or {})
    dataset = setup.make_split(setup.split, setup.protocol, score=True)
    train_set = _training_set(setup, dataset, log)
    result = _score(setup, model, dataset, f"evaluating on {setup.split}", log)
    write_rows(setup.folder / "per_image.csv", PER_IMAGE_HEADER, result.rows)
    if result.uncertainty is not None:
        write_uncertainty(setup.folder, result.uncertainty)
    log.picture("predictions", step, sample_rows(model, dataset, setup.protocol))
    log.close()
    size = dataset[0]["image"].shape[-2:]
    skipped = {"train": {} if train_set is None else train_set.skipped, **facts.get("skipped", {})}
    record = {
        "model": setup.name,
        "data": setup.data,
        "split": setup.split,
        "split_hash": dataset.split_hash,
        "train_split_hash": None if train_set is None else train_set.split_hash,
        "teacher": facts.get("teacher", {}),
        "sources": fingerprints(setup.settings),
        "skipped": skipped | {setup.split: dataset.skipped},
        "protocol": setup.protocol.as_dict(),
        "metrics": result.metrics,
        "uncertainty_protocol": PROTOCOL.as_dict() if result.uncertainty else None,
        "errors_by_class": result.classes or None,
        "constant_predictor": _constant_score(setup, train_set, dataset, log),
        "normalization": _normalization(model),
        "cost": asdict(setup.measure(model, (size[0], size[1]))),
        "seed": setup.seed,
        "resources": asdict(setup.resources),
        "training": facts.get("training"),
        "overrides": facts.get("overrides", []),
        "config": dict(setup.settings),
        **environment(),
    }
    write_json(setup.folder / RUN_FILE, record)
    return record


def _score(
    setup: ScoreSetup, predictor: nn.Module, dataset: "DepthDataset", title: str, log: RunLog
) -> Evaluation:
    predictor.to(setup.resources.device)
    with log.bar(title, len(dataset)) as bar:
        return evaluate(
            predictor,
            dataset,
            setup.protocol,
            device=setup.resources.device,
            batch_size=setup.batch_size,
            workers=setup.resources.workers,
            advance=bar.advance,
        )


def _training_set(setup: ScoreSetup, scored: "DepthDataset", log: RunLog) -> "DepthDataset | None":
    """Frames whose mean depth map is the constant predictor; None where only the scored split is on disk."""
    try:
        few: dict[str, Any] = {}
        wanted = setup.training_frames
        if (
            isinstance(scored, RenderedScenes)
            and wanted is not None
            and wanted > RENDERED_FOR_A_CONSTANT
            and scored.missing_scenes("train", wanted)
        ):
            log.say(
                f"the constant predictor is that of the first {RENDERED_FOR_A_CONSTANT} training frames: not "
                f"all of data.train.frames={wanted} are rendered yet"
            )
            few = {"frames": RENDERED_FOR_A_CONSTANT}
        train_set = setup.make_split("train", setup.protocol, **few)
    except (FileNotFoundError, ValueError) as error:
        log.say(f"no constant predictor in the table, because the training frames are missing: {error}")
        return None
    if train_set.cache == "ram":
        train_set.cache = "none"  # each frame is read once: nothing to keep
    return train_set


def _constant_score(
    setup: ScoreSetup, train_set: "DepthDataset | None", dataset: "DepthDataset", log: RunLog
) -> dict[str, float] | None:
    """Metrics of the constant predictor; None where there are no frames with a mean depth map."""
    if train_set is None:
        return None
    try:
        constant = fit_constant_predictor(train_set)
    except ValueError as error:
        log.say(f"no constant predictor in the table: {error}")
        return None
    return _score(setup, constant, dataset, "evaluating the constant predictor", log).metrics


def _normalization(model: nn.Module) -> dict[str, list[float]] | None:
    """Mean and standard deviation of the images; None for a file, which has them inside."""
    if not isinstance(model, DepthNet):
        return None
    return {
        name: [round(value, 6) for value in getattr(model, name).flatten().tolist()]
        for name in ("mean", "std")
    }

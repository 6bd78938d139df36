"""From a trained network to ``run.json``: what ``train`` and ``evaluate`` both end with."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import nn

from eldenet.data.base import DepthDataset
from eldenet.data.rendered_scenes import RenderedScenes
from eldenet.evaluation.constant_baseline import fit_constant_predictor
from eldenet.evaluation.cost import CostReport, measure_cost
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, Evaluation, evaluate, picture_of_samples
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import OwnShape, open_split
from eldenet.evaluation.uncertainty_metrics import PROTOCOL
from eldenet.model import DepthNet
from eldenet.results.fingerprints import fingerprints
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import RUN_FILE, environment
from eldenet.results.uncertainty_plots import write_uncertainty
from eldenet.system.files import write_json, write_rows
from eldenet.system.resources import Resources
from eldenet.weights import name_of

RENDERED_FOR_A_CONSTANT = 512  # frames: as many as a test split has


def score(
    model: nn.Module,
    settings: Mapping[str, Any],
    protocol: EvalProtocol,
    resources: Resources,
    log: RunLog,
    *,
    input_size: Sequence[int] | OwnShape | None = None,
    measure: Callable[[Any, tuple[int, int]], CostReport] = measure_cost,
    facts: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Evaluate, measure the cost; write ``run.json``, ``per_image.csv`` and ``predictions.png``.

    Of a network that predicts its sigma also ``uncertainty.csv``, ``sparsification.png`` and
    ``reliability.png``.

    Args:
        model: a :class:`~eldenet.model.DepthNet`, or an exported file as a module.
        settings: of the command, which ``run.json`` stores: ``output``, ``data``, and ``split`` and
            ``batch_size`` where they are not "test" and 16.
        protocol: the rules.
        resources: device, threads, workers.
        log: what the person sees.
        input_size: ``(height, width)`` [px] that the network sees, or frames of their own shapes; None: the
            data set's own size.
        measure: network and ``(height, width)`` [px] of the first frame -> its cost.
        facts: of the training, if there was one: ``training`` (its progress), ``skipped`` (split -> name ->
            reason), ``teacher`` (loss term -> source and hash) and ``overrides`` (of the command line).

    Returns:
        What was written to ``run.json``.
    """
    info: Any = model.info
    facts, data, folder = dict(facts or {}), settings["data"], Path(settings["output"])
    split, batch_size = settings.get("split", "test"), settings.get("batch_size", 16)
    dataset = open_split(data, split, protocol, score=True, input_size=input_size)
    train_set = _training_set(data, protocol, input_size, dataset, log)
    result = _evaluate(model, dataset, protocol, resources, batch_size, f"evaluating on {split}", log)
    write_rows(folder / "per_image.csv", PER_IMAGE_HEADER, result.rows)
    if result.uncertainty is not None:
        write_uncertainty(folder, result.uncertainty, log)
    step = (facts.get("training") or {}).get("step", 0)
    log.picture("predictions", step, picture_of_samples(model, dataset, protocol))
    log.close()
    constant = None if train_set is None else _constant_predictor(train_set, log)
    of_constant = None
    if constant is not None:
        title = "evaluating the constant predictor"
        of_constant = _evaluate(constant, dataset, protocol, resources, batch_size, title, log).metrics
    size = dataset[0]["image"].shape[-2:]
    skipped = {"train": {} if train_set is None else train_set.skipped, **facts.get("skipped", {})}
    record = {
        "model": name_of(str(settings.get("checkpoint")), info),
        "data": data["name"],
        "split": split,
        "split_hash": dataset.split_hash,
        "train_split_hash": None if train_set is None else train_set.split_hash,
        "teacher": facts.get("teacher", {}),
        "sources": fingerprints(settings),
        "skipped": skipped | {split: dataset.skipped},
        "protocol": protocol.as_dict(),
        "metrics": result.metrics,
        "uncertainty_protocol": PROTOCOL if result.uncertainty else None,
        "errors_by_class": result.classes or None,
        "constant_predictor": of_constant,
        "normalization": _normalization(model),
        "cost": asdict(measure(model, (size[0], size[1]))),
        "seed": info.get("seed"),
        "resources": asdict(resources),
        "training": facts.get("training"),
        "seconds": log.seconds,  # of the whole command; of a resumed one, since it resumed
        "overrides": facts.get("overrides", []),
        "config": dict(settings),
        **environment(),
    }
    write_json(folder / RUN_FILE, record)
    return record


def _evaluate(
    predictor: nn.Module,
    dataset: DepthDataset,
    protocol: EvalProtocol,
    resources: Resources,
    batch_size: int,
    title: str,
    log: RunLog,
) -> Evaluation:
    predictor.to(resources.device)
    with log.bar(title, len(dataset)) as bar:
        return evaluate(
            predictor,
            dataset,
            protocol,
            device=resources.device,
            batch_size=batch_size,
            workers=resources.workers,
            advance=bar.advance,
        )


def _training_set(
    data: Mapping[str, Any],
    protocol: EvalProtocol,
    input_size: Sequence[int] | OwnShape | None,
    scored: DepthDataset,
    log: RunLog,
) -> DepthDataset | None:
    """Frames whose mean depth map is the constant predictor; None where only the scored split is on disk."""
    try:
        few: dict[str, Any] = {}
        wanted = (data.get("train") or {}).get("frames")
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
        if isinstance(input_size, OwnShape):
            input_size = input_size.size  # a mean depth map has one size
        train_set = open_split(data, "train", protocol, input_size=input_size, **few)
    except (FileNotFoundError, ValueError) as error:
        log.say(f"no constant predictor in the table, because the training frames are missing: {error}")
        return None
    return train_set


def _constant_predictor(train_set: DepthDataset, log: RunLog) -> nn.Module | None:
    """Return the frames' mean depth map as a network; None where there is none."""
    try:
        return fit_constant_predictor(train_set)
    except ValueError as error:
        log.say(f"no constant predictor in the table: {error}")
        return None


def _normalization(model: nn.Module) -> dict[str, list[float]] | None:
    """Mean and standard deviation of the images; None for a file, which has them inside."""
    if not isinstance(model, DepthNet):
        return None
    return {
        name: [round(value, 6) for value in getattr(model, name).flatten().tolist()]
        for name in ("mean", "std")
    }

"""From a trained network to ``run.json``: what ``train`` and ``evaluate`` both end with."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.data.rendered import RenderedScenes
from eldenet.evaluation.constant_baseline import ConstantPredictor, fit_constant_predictor
from eldenet.evaluation.cost import CostReport, measure_cost
from eldenet.evaluation.evaluator import (
    PER_IMAGE_HEADER,
    evaluate,
    sample_rows,
)
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.model import DepthNet
from eldenet.results.fingerprints import fingerprints
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import RUN_FILE, environment, write_json, write_rows
from eldenet.system.resources import Resources
from eldenet.training.checkpoint import Progress

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.data.base import DepthDataset
    from eldenet.deploy.runtimes.module import RuntimeNetwork

RENDERED_FOR_A_CONSTANT = 512  # frames: as many as a test split has
# of the runs of one process: a sweep, or the trials of a study, score the same constant on the same frames
_CONSTANT_SCORES: dict[tuple[str, ...], dict[str, float]] = {}


def score_and_record(
    config: "DictConfig",
    model: "DepthNet | RuntimeNetwork",
    protocol: EvalProtocol,
    resources: Resources,
    folder: Path,
    log: RunLog,
    *,
    name: str,
    split: str = "test",
    batch_size: int = 16,
    progress: Progress | None = None,
    skipped: Mapping[str, Mapping[str, str]] | None = None,
    teacher: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Evaluate on ``split`` and measure the cost; write ``run.json``, ``per_image.csv``, ``predictions.png``.

    Args:
        config: the whole config; its data set is scored, and it is stored.
        model: to score, moved to the device of ``resources``; or an exported file as a module.
        protocol: the rules.
        resources: device, threads, workers.
        folder: of the run.
        log: what the person sees.
        name: of the row in tables.
        split: of the data set.
        batch_size: of the evaluation.
        progress: of the training, if there was one.
        skipped: split -> name -> reason of the frames that the training left out.
        teacher: loss term -> source and hash of the network that it distilled from.

    Returns:
        What was written to ``run.json``.
    """
    dataset = cfg.build_split(config, split, protocol, score=True)
    if progress is None:  # a training has rendered its frames
        _render_few(config, dataset, log)
    train_set = _training_frames(config, protocol, log)

    def score(predictor: Any, title: str) -> Any:
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

    result = score(model, f"evaluating on {split}")
    write_rows(folder / "per_image.csv", PER_IMAGE_HEADER, result.rows)
    log.picture(
        "predictions", 0 if progress is None else progress.step, sample_rows(model, dataset, protocol)
    )
    log.close()
    baseline = None
    if train_set is not None:
        rules = (str(protocol.as_dict()), str(cfg.plain(config.data)))
        baseline = _constant_score(
            train_set,
            (train_set.split_hash, dataset.split_hash, *rules),
            lambda constant: score(constant, "evaluating the constant predictor").metrics,
            log,
        )
    sample = dataset[0]["image"]
    record = {
        "model": name,
        "data": config.data.name,
        "split": split,
        "split_hash": dataset.split_hash,
        "train_split_hash": None if train_set is None else train_set.split_hash,
        "teacher": dict(teacher or {}),
        "sources": fingerprints(cfg.plain(config)),
        "skipped": {
            "train": {} if train_set is None else train_set.skipped,
            **(skipped or {}),
            split: dataset.skipped,
        },
        "protocol": protocol.as_dict(),
        "metrics": result.metrics,
        "errors_by_class": result.classes or None,
        "constant_predictor": baseline,
        "normalization": _normalization(model),
        "cost": _cost(model, (sample.shape[-2], sample.shape[-1])).as_dict(),
        "seed": config.get("seed", model.info.get("seed")),
        "resources": asdict(resources),
        "training": None if progress is None else asdict(progress),
        "config": cfg.plain(config),
        **environment(),
    }
    write_json(folder / RUN_FILE, record)
    return record


def _render_few(config: "DictConfig", scored: "DepthDataset", log: RunLog) -> None:
    """Cut ``data.train`` to what is quickly rendered where it would be rendered for its mean depth alone.

    Whatever is there of it: the same command has the same result, until all is there.
    """
    frames = config.data.train.get("frames")
    if not isinstance(scored, RenderedScenes) or frames is None or frames <= RENDERED_FOR_A_CONSTANT:
        return
    if not scored.missing_shards("train", frames):
        return
    log.say(
        f"the constant predictor is that of the first {RENDERED_FOR_A_CONSTANT} training frames alone: not "
        f"all of data.train.frames={frames} are rendered yet"
    )
    config.data.train.frames = RENDERED_FOR_A_CONSTANT
    if config.data.get("subset"):
        config.data.subset.train = None


def _training_frames(config: "DictConfig", protocol: EvalProtocol, log: RunLog) -> "DepthDataset | None":
    """Whose mean depth map is the constant predictor; None where only the scored split is on disk."""
    try:
        train_set = cfg.build_split(config, "train", protocol)
    except (FileNotFoundError, ValueError) as error:
        log.say(f"no constant predictor beside the result, the training frames are not to be had: {error}")
        return None
    if train_set.cache == "ram":
        train_set.cache = "none"  # each frame is read once: nothing to keep
    return train_set


def _constant_score(
    train_set: "DepthDataset",
    key: tuple[str, ...],
    score: Callable[[ConstantPredictor], dict[str, float]],
    log: RunLog,
) -> dict[str, float] | None:
    """Metrics of the constant predictor, once per ``key``; None where the frames have no mean depth map."""
    if key not in _CONSTANT_SCORES:
        try:
            constant = fit_constant_predictor(train_set)
        except ValueError as error:
            log.say(f"no constant predictor beside the result: {error}")
            return None
        _CONSTANT_SCORES[key] = score(constant)
    return _CONSTANT_SCORES[key]


def _normalization(model: "DepthNet | RuntimeNetwork") -> dict[str, list[float]] | None:
    """Mean and standard deviation of the images; None for a file, which has them inside."""
    if not isinstance(model, DepthNet):
        return None
    return {
        name: [round(value, 6) for value in getattr(model, name).flatten().tolist()]
        for name in ("mean", "std")
    }


def _cost(model: "DepthNet | RuntimeNetwork", size: tuple[int, int]) -> CostReport:
    if isinstance(model, DepthNet):
        return measure_cost(model, size)
    from eldenet.deploy.runtimes.module import measure_runtime_cost

    return measure_runtime_cost(model.network, size)

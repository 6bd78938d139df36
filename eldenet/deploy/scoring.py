"""Score any checkpoint or exported file on any data set by any protocol."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import eldenet
from eldenet.weights import find_checkpoint

if TYPE_CHECKING:
    from eldenet.data.base import DepthDataset
    from eldenet.deploy.runtimes.module import RuntimeNetwork
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog
    from eldenet.results.score import ScoreSetup
    from eldenet.system.resources import Resources


@dataclass(frozen=True)
class EvaluationSetup:
    """What is scored, by which rules, and where the result goes.

    Attributes:
        folder: of the run.
        checkpoint: run folder, saved model, Hub id, packaged weights, or an exported file.
        data: name of the data set.
        split: "train", "val" or "test".
        input_size: ``(height, width)`` [px] that the network sees; "model": what it was trained at; "data" or
            None: ``data_input_size``.
        data_input_size: the data set's own.
        training_frames: of a rendered training split; None: the data set is not rendered.
        protocol: the rules.
        make_split: as :func:`eldenet.config.build_split` without its config.
        engine: runtime of an exported file.
        precision: of an exported file.
        resources: arguments of :func:`~eldenet.system.resources.choose_resources`.
        batch_size: images at once.
        calibrated: folder for the network with the temperature that these frames choose; None: none is.
        trusted_modules: packages whose classes a foreign ``config.json`` may name.
        settings: the resolved settings, which ``run.json`` stores.
    """

    folder: Path
    checkpoint: str
    data: str
    split: str
    input_size: str | Sequence[int] | None
    data_input_size: Sequence[int] | None
    training_frames: int | None
    protocol: "EvalProtocol"
    make_split: Callable[..., "DepthDataset"]
    engine: str
    precision: str | None
    resources: Mapping[str, Any]
    batch_size: int
    calibrated: Path | None
    trusted_modules: Sequence[str]
    settings: Mapping[str, Any]


def evaluate(setup: EvaluationSetup) -> dict[str, Any]:
    """Load, score, measure, write ``run.json`` and show the table.

    Returns:
        What was written to ``run.json``.

    Raises:
        ValueError: the settings do not fit the checkpoint or the protocol, or the folder holds a training.
    """
    from eldenet.results.run_log import RunLog, untrained_note
    from eldenet.results.score import ScoreSetup, score_and_record
    from eldenet.results.tables import closing_table
    from eldenet.system.resources import choose_resources

    if (setup.folder / "checkpoints").is_dir():
        raise ValueError(
            f"output={setup.folder} holds a training, whose run.json this would replace: give another folder"
        )
    resources = choose_resources(**setup.resources)
    model = open_checkpoint(setup, resources)
    setup.folder.mkdir(parents=True, exist_ok=True)
    log = RunLog(setup.folder)
    if find_checkpoint(setup.checkpoint).kind == "network":
        log.say(untrained_note(setup.checkpoint))
    size = chosen_size(setup, model, log)
    scoring = ScoreSetup(
        folder=setup.folder,
        name=str(model.info.get("model_name", setup.checkpoint)),
        data=setup.data,
        seed=model.info.get("seed"),
        protocol=setup.protocol,
        make_split=functools.partial(setup.make_split, input_size=size),
        resources=resources,
        settings=setup.settings,
        split=setup.split,
        batch_size=setup.batch_size,
        measure=_measure,
        training_frames=setup.training_frames,
    )
    if setup.calibrated is not None:
        calibrate(setup.calibrated, scoring, model, log)
    record = score_and_record(scoring, model, log)
    closing_table(log, record)
    return record


def open_checkpoint(setup: EvaluationSetup, resources: "Resources") -> "DepthNet | RuntimeNetwork":
    """A model for torch, or an exported file under ``engine``.

    A file runs on an accelerator only where that was asked for: it needs another build of its runtime.
    """
    from eldenet.deploy import runtimes
    from eldenet.deploy.runtimes.module import RuntimeNetwork

    if find_checkpoint(setup.checkpoint, "checkpoint").kind == "exported":
        device = "cpu" if setup.resources["device"] == "auto" else resources.device
        network = runtimes.load(
            setup.checkpoint, setup.engine, setup.precision, threads=resources.threads, device=device
        )
        return RuntimeNetwork(network)
    if (setup.engine, setup.precision) != ("auto", None):
        raise ValueError("engine and precision are for exported files (eldenet export)")
    return eldenet.load(setup.checkpoint, trusted_modules=setup.trusted_modules)


def calibrate(folder: Path, scoring: "ScoreSetup", model: "DepthNet | RuntimeNetwork", log: "RunLog") -> None:
    """Fit the temperature of the network's sigma on the frames to score; save the network into ``folder``.

    Raises:
        ValueError: the network is an exported file, or predicts no sigma.
    """
    from eldenet.evaluation.calibration import fit_temperature
    from eldenet.model import DepthNet

    if not isinstance(model, DepthNet):
        raise ValueError(
            "calibrated= stores a temperature in a model: give the model's folder, then export it again"
        )
    frames = scoring.make_split(scoring.split, scoring.protocol, score=True)
    model.to(scoring.resources.device)
    temperature = fit_temperature(model, frames, scoring.protocol, batch_size=scoring.batch_size)
    source = f"{scoring.data}/{scoring.split} {frames.split_hash}"
    model.save_pretrained(folder, info={"temperature_from": source})
    log.say(
        f"sigma times {temperature:.3f}, by {len(frames)} frames of {source}: written to {folder}. The table "
        "below is of these very frames: score others"
    )


def chosen_size(
    setup: EvaluationSetup, model: "DepthNet | RuntimeNetwork", log: "RunLog"
) -> Sequence[int] | None:
    """``(height, width)`` [px] that the network sees; None: the data set's own."""
    wanted = trained_size(model, setup.protocol) if setup.input_size == "model" else setup.input_size
    if wanted is None or isinstance(wanted, str) or list(wanted) == setup.data_input_size:
        return None
    log.say(
        f"the network sees {wanted[0]} x {wanted[1]} pixels, data.input_size={setup.data_input_size} is "
        "not used"
    )
    return wanted


def trained_size(model: "DepthNet | RuntimeNetwork", protocol: "EvalProtocol") -> Sequence[int] | None:
    """``(height, width)`` [px] at which ``model`` sees what ``protocol`` shows it: a frame, or a part of it.

    Raises:
        ValueError: a file sees whole frames, and the protocol shows a part.
    """
    from eldenet.deploy.runtimes.module import RuntimeNetwork
    from eldenet.model import size_of_frames

    if not protocol.changes_frames:
        return size_of_frames(model.info)
    seen = model.info.get("input_size")
    if isinstance(model, RuntimeNetwork) and seen is not None and model.network.whole_frame_size == seen:
        raise ValueError(
            f"this file takes the camera's whole frames, {seen[0]} x {seen[1]} pixels, but protocol "
            f"{protocol.name} only shows a part of them: to score the network, export it with size= of "
            "that part "
            "(the training's data.input_size)"
        )
    return seen


def _measure(model: "DepthNet | RuntimeNetwork", size: tuple[int, int]) -> Any:
    from eldenet.deploy.runtimes.module import RuntimeNetwork, measure_runtime_cost
    from eldenet.evaluation.cost import measure_cost

    if isinstance(model, RuntimeNetwork):
        return measure_runtime_cost(model.network, size)
    return measure_cost(model, size)

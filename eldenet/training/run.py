"""One training from its setup to ``run.json``: build, train, score the best epoch, record."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.geometry import same_aspect
from eldenet.system.files import displayed, sole_writer, write_yaml
from eldenet.system.resources import choose_resources, is_main_process, join_processes, main_process_first
from eldenet.training.resume import checkpoint_to_resume, finished_run, run_folder
from eldenet.training.setup import TrainingSetup

if TYPE_CHECKING:
    from torch import Tensor

    from eldenet.data.base import DepthDataset
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.losses.base import WeightedSum
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources
    from eldenet.training.checkpoint import Progress
    from eldenet.training.trainer import Trainer


def train(setup: TrainingSetup) -> float:
    """Train, score the best epoch and record it; with ``ckpt_path="auto"`` a finished run is left as it is.

    Returns:
        The best value of ``trainer.monitor``; NaN where no validation had one.

    Raises:
        ValueError: the settings do not fit each other, or the folder holds another run, or another process
            trains in it.
        FloatingPointError: the loss became NaN or infinite; the last good checkpoint stays.
    """
    with sole_writer(setup.folder) if is_main_process() else nullcontext():
        return _train(setup)


def _train(setup: TrainingSetup) -> float:
    from eldenet.results.run_log import RunLog

    log = RunLog(setup.folder, quiet=not is_main_process(), loggers=setup.loggers)
    record = finished_run(setup)
    if record is not None:
        log.say(f"{setup.folder}: already finished")
        best_value = record["training"]["best_value"]
        return math.nan if best_value is None else float(best_value)
    checkpoint = checkpoint_to_resume(setup)
    resources = choose_resources(**setup.resources)
    from eldenet.results.tables import closing_table

    # before the data, which may take minutes to render: a wrong setting shows at once
    from eldenet.training.initialization import initial_model

    trainer, loss = setup.make_trainer(), make_loss(setup)
    refuse_untrained_sigma(initial_model(setup, RunLog(setup.folder, quiet=True)), loss)
    join_processes(resources, setup.process_timeout)
    progress, skipped, notes = _fit(setup, trainer, loss, resources, log, checkpoint)
    trainer.accelerator.wait_for_everyone()
    trainer.accelerator.end_training()  # a process that leaves with its group open may abort
    if trainer.accelerator.is_main_process:
        facts = {
            "training": asdict(progress) | {"effective_batch": trainer.effective_batch},
            "skipped": skipped,
            "teacher": dict(loss.signature),
            "overrides": list(setup.overrides),
        }
        record = score_best(setup, resources, log, facts)
        closing_table(log, record)
        for note in notes:
            log.say(note)
        if line := collapse(record):
            log.say(line)
    return progress.best_value


def _fit(
    setup: TrainingSetup,
    trainer: "Trainer",
    loss: "WeightedSum",
    resources: "Resources",
    log: "RunLog",
    checkpoint: Path | None,
) -> tuple["Progress", dict[str, Mapping[str, str]], list[str]]:
    """Prepare the frames and train.

    Returns:
        The progress, the frames that were left out by split, and notes on the scores.
    """
    from eldenet.results.fingerprints import fingerprints
    from eldenet.training.initialization import initial_model
    from eldenet.training.normalization import normalization, write_normalization
    from eldenet.training.trainer import TrainingData

    train_set, val_set, test_set = make_splits(setup, resources, labeled=loss.needs_depth)
    resumed = None if checkpoint is None else run_folder(checkpoint)
    chosen = normalization(setup.normalization, train_set, resumed=resumed)
    model = initial_model(setup, log, **chosen)
    if is_main_process():
        setup.folder.mkdir(parents=True, exist_ok=True)
        write_yaml(setup.folder / "config.yaml", setup.settings)
        write_normalization(setup.folder, setup.normalization, chosen)
    log.say(
        f"{setup.data}: {len(train_set)} training and {len(val_set)} validation frames; {resources.device}, "
        f"{resources.precision}, {resources.threads} threads, {resources.workers} workers; run folder "
        f"{displayed(setup.folder)}"
    )
    announce_frames(setup, loss, train_set, {"validation": val_set, "test": test_set}, log)
    if model.canonical_px is not None and (frame := without_camera(train_set)):
        log.say(
            f"note: training frames such as {frame} have no intrinsics, so they count as the canonical "
            "camera's: meters will be off by as much as their focal length differs (data=folder takes "
            "data.intrinsics)"
        )
    progress = trainer.fit(
        model,
        loss,
        TrainingData(train_set, val_set, setup.protocol),
        setup.folder,
        resources,
        ckpt_path=checkpoint,
        info=model_info(setup, train_set),
        sources=fingerprints(setup.settings),
    )
    notes = []
    chosen_of_several = trainer.epochs > trainer.evaluate_every
    if chosen_of_several and (shared := common_frames(val_set, test_set)):
        notes.append(
            f"note: the best epoch was chosen on {shared} of the {len(test_set)} frames that are scored, "
            "so the scores are a little too good"
        )
    return progress, {"train": train_set.skipped, "val": val_set.skipped}, notes


def collapse(record: Mapping[str, Any]) -> str:
    """Return a warning if delta1 and AbsRel are worse than the constant predictor's; else ""."""
    found, constant = record["metrics"], record["constant_predictor"]
    if constant is None or not (
        found["delta1"] < constant["delta1"] and found["abs_rel"] > constant["abs_rel"]
    ):
        return ""
    return (
        f"warning: the network is worse than a constant depth map (delta1 {found['delta1']:.3f} and AbsRel "
        f"{found['abs_rel']:.3f}; the map: {constant['delta1']:.3f} and {constant['abs_rel']:.3f}): it has "
        "learned nothing that holds on these frames. Try a lower optimizer.lr, more trainer.epochs, or "
        "trainer.max_grad_norm=1"
    )


def make_loss(setup: TrainingSetup) -> "WeightedSum":
    """Build the loss.

    Raises:
        ValueError: a teacher is named, but no term of the loss learns from one.
    """
    loss = setup.make_loss()
    if setup.teacher is not None and not loss.signature:
        raise ValueError(
            f"teacher={setup.teacher}: no term of this loss learns from a teacher; use loss=ssim_l1_distill, "
            "or remove teacher="
        )
    return loss


def refuse_untrained_sigma(model: "DepthNet", loss: "WeightedSum") -> None:
    """Raise ValueError if no term of the loss trains the head's sigma, or one does and it has none."""
    if loss.needs_spread == (model.distribution is not None):
        return
    raise ValueError(
        "model/head=uncertain learns its sigma from a likelihood: use loss=ssim_nll, or another head"
        if model.distribution is not None
        else "this loss trains a sigma, but the head predicts none: use model/head=uncertain, or another loss"
    )


def make_splits(
    setup: TrainingSetup, resources: "Resources", *, labeled: bool = True
) -> tuple["DepthDataset", "DepthDataset", "DepthDataset"]:
    """Return training, validation and test frames.

    Args:
        setup: of the training.
        resources: device of the processes.
        labeled: whether the loss needs the training frames' depth.

    Raises:
        ValueError: they cannot be scored, or no pixel of a split is known: better now than after the
            training.
    """
    with main_process_first(resources):  # it renders or prepares what the others then find
        train_set = setup.make_split("train", setup.protocol, augment=True, seed=setup.seed)
        val_set = setup.make_split("val", setup.protocol)
        test_set = setup.make_split("test", setup.protocol, score=True)
    for scored in (val_set, test_set):
        # raises where the protocol's crop does not fit the frame or its ground truth
        _refuse_unknown(setup, scored, setup.protocol.valid_mask)
    if labeled:
        _refuse_unknown(setup, train_set, lambda depth, mask: mask)
    return train_set, val_set, test_set


def _refuse_unknown(
    setup: TrainingSetup, frames: "DepthDataset", valid_mask: Callable[["Tensor", "Tensor"], "Tensor"]
) -> None:
    """Raise ValueError if no frame has a pixel that counts; one frame is read where the first one has."""
    for sample in map(frames.__getitem__, range(len(frames))):
        if valid_mask(sample["depth"][None], sample["mask"][None]).any():
            return
    raise ValueError(
        f"no pixel of {len(frames)} frames such as {frames.names[0]} has a known depth that counts "
        f"({frames.min_depth:g} to {frames.max_depth:g} m, protocol {setup.protocol.name}): check "
        "data.min_depth, data.max_depth and the unit of the depth files with eldenet check-data"
    )


def announce_frames(
    setup: TrainingSetup,
    loss: "WeightedSum",
    train_set: "DepthDataset",
    scored: Mapping[str, "DepthDataset"],
    log: "RunLog",
) -> None:
    """Say how many scored frames are also training frames, and at what size a teacher sees frames."""
    from eldenet.losses.distillation import DistilledTerm

    for split, frames in scored.items():
        if count := common_frames(train_set, frames):
            log.say(f"note: {count} of {len(frames)} {split} frames are also training frames")
    for term in loss.terms.values():
        if isinstance(term, DistilledTerm):
            log.say(term.teacher.describe(setup.input_size))


def without_camera(train_set: "DepthDataset") -> str:
    """Return the name of a frame in meters without intrinsics; "" if the first of each source has them."""
    from eldenet.data.mix import Mix

    parts = [train_set]
    if isinstance(train_set, Mix):
        parts = [source.frames for source in train_set.sources.values() if not source.relative]
    return next((part.names[0] for part in parts if part.load_frame(0).intrinsics is None), "")


def common_frames(train_set: "DepthDataset", scored: "DepthDataset") -> int:
    """Return how many frames of ``scored`` are in ``train_set`` too: their scores measure memory, or luck."""
    from eldenet.data.inspection import identities

    return len(identities(train_set).keys() & identities(scored).keys())


def model_info(setup: TrainingSetup, train_set: "DepthDataset") -> dict[str, Any]:
    """Return the facts stored with the weights: their origin, and the sizes that they were trained at."""
    return {
        "model_name": setup.name,
        "seed": setup.seed,
        "data": setup.data,
        "started_from": setup.weights,
        **trained_sizes(setup.input_size, setup.protocol, train_set),
    }


def trained_sizes(
    input_size: Sequence[int] | None, protocol: "EvalProtocol", train_set: "DepthDataset"
) -> dict[str, Any]:
    """Return ``(height, width)`` [px] of the network's input and, where a protocol crops, of the whole frame.

    The latter is that of the first frame. Where frames are squeezed into the input, ``stretch`` says by how
    much.
    """
    from eldenet.evaluation.protocol_frames import whole_frame_size

    seen = None if input_size is None else list(input_size)
    sizes: dict[str, Any] = {"input_size": seen}
    height, width = train_set.load_frame(0).depth.shape
    whole = list(whole_frame_size(protocol, (height, width), seen))
    if protocol.changes_frames and whole != seen:
        sizes["whole_frame_size"] = whole
    if not same_aspect((whole[0], whole[1]), (height, width)):
        sizes["stretch"] = whole[1] * height / (whole[0] * width)
    return sizes


def score_best(
    setup: TrainingSetup, resources: "Resources", log: "RunLog", facts: Mapping[str, Any]
) -> dict[str, Any]:
    """Score the best epoch's weights, as anybody would load them, on the test frames; write ``run.json``."""
    from eldenet.model import DepthNet
    from eldenet.results.score import ScoreSetup, score_and_record

    best = DepthNet.from_pretrained(setup.folder / "model", trusted_modules=setup.trusted_modules)
    scoring = ScoreSetup(
        folder=setup.folder,
        name=setup.name,
        data=setup.data,
        seed=setup.seed,
        protocol=setup.protocol,
        make_split=setup.make_split,
        resources=resources,
        settings=setup.settings,
    )
    return score_and_record(scoring, best, log, facts, step=facts["training"]["step"])

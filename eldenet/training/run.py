"""One training from its setup to ``run.json``: build, train, score the best epoch, record."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from eldenet.geometry import same_aspect
from eldenet.system.files import write_yaml
from eldenet.system.resources import choose_resources, is_main_process, main_process_first
from eldenet.training.resume import checkpoint_to_resume, finished_run, run_folder
from eldenet.training.setup import TrainingSetup

if TYPE_CHECKING:
    from eldenet.data.base import DepthDataset
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.losses.base import WeightedSum
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources
    from eldenet.training.checkpoint import Progress


def train(setup: TrainingSetup) -> float:
    """Train, score the best epoch and record it; with ``ckpt_path="auto"`` a finished run is left as it is.

    Returns:
        The best value of ``trainer.monitor``; NaN where no validation had one.

    Raises:
        ValueError: the settings do not fit each other, or the folder holds another run.
        FloatingPointError: the loss became NaN or infinite; the last good checkpoint stays.
    """
    from eldenet.results.run_log import RunLog

    log = RunLog(setup.folder, quiet=not is_main_process())
    record = finished_run(setup)
    if record is not None:
        log.say(f"{setup.folder}: already finished")
        best_value = record["training"]["best_value"]
        return math.nan if best_value is None else float(best_value)
    checkpoint = checkpoint_to_resume(setup)
    resources = choose_resources(**setup.resources)
    from eldenet.results.fingerprints import fingerprints
    from eldenet.results.tables import closing_table
    from eldenet.training.initialization import initial_model
    from eldenet.training.normalization import normalization, write_normalization
    from eldenet.training.trainer import TrainingData

    # before the data, which may take minutes to render: a wrong setting shows at once
    trainer, loss = setup.make_trainer(), make_loss(setup)
    initial_model(setup, RunLog(setup.folder, quiet=True))
    train_set, val_set, test_set = make_splits(setup, resources)
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
        f"{setup.folder}"
    )
    announce_frames(setup, loss, train_set, {"validation": val_set, "test": test_set}, log)
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
    trainer.accelerator.wait_for_everyone()
    trainer.accelerator.end_training()  # a process that leaves with its group open may abort
    if trainer.accelerator.is_main_process:
        skipped = {"train": train_set.skipped, "val": val_set.skipped}
        closing_table(log, score_best(setup, resources, log, progress, skipped, loss.signature))
    return progress.best_value


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


def make_splits(
    setup: TrainingSetup, resources: "Resources"
) -> tuple["DepthDataset", "DepthDataset", "DepthDataset"]:
    """Return training, validation and test frames.

    Raises:
        ValueError: they cannot be scored; better now than after the training.
    """
    with main_process_first(resources):  # it renders or prepares what the others then find
        train_set = setup.make_split("train", setup.protocol, augment=True, seed=setup.seed)
        val_set = setup.make_split("val", setup.protocol)
        test_set = setup.make_split("test", setup.protocol, score=True)
    for scored in (val_set, test_set):
        sample = scored[0]  # raises where the protocol's crop does not fit the frame or its ground truth
        setup.protocol.valid_mask(sample["depth"][None], sample["mask"][None])
    return train_set, val_set, test_set


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


def common_frames(train_set: "DepthDataset", scored: "DepthDataset") -> int:
    """Return how many frames of ``scored`` are in ``train_set`` too: their scores measure memorization."""
    from eldenet.data.inspection import identities

    return len(identities(train_set).keys() & identities(scored).keys())


def model_info(setup: TrainingSetup, train_set: "DepthDataset") -> dict[str, Any]:
    """Return what is stored beside the weights: their origin, and the sizes that they were trained at."""
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

    The latter is that of the first frame. Where a protocol squeezes frames, ``stretch`` says by how much.
    """
    from eldenet.evaluation.protocol_frames import whole_frame_size

    seen = None if input_size is None else list(input_size)
    sizes: dict[str, Any] = {"input_size": seen}
    if protocol.changes_frames:
        height, width = train_set.load_frame(0).depth.shape
        whole = list(whole_frame_size(protocol, (height, width), seen))
        if whole != seen:
            sizes["whole_frame_size"] = whole
        if not same_aspect((whole[0], whole[1]), (height, width)):
            sizes["stretch"] = whole[1] * height / (whole[0] * width)
    return sizes


def score_best(
    setup: TrainingSetup,
    resources: "Resources",
    log: "RunLog",
    progress: "Progress",
    skipped: Mapping[str, Mapping[str, str]],
    teacher: Mapping[str, Any],
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
    facts = {"training": asdict(progress), "skipped": skipped, "teacher": dict(teacher)}
    return score_and_record(scoring, best, log, facts, step=progress.step)

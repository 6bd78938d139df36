"""``python -m eldenet.train``: train a network, score its best epoch, write ``run.json`` and show the table.

python -m eldenet.train                                     ELDE-Net on rendered rooms
python -m eldenet.train data=nyu_labelled model=resnet18_upconv seed=1
python -m eldenet.train +experiment=nyu_labelled            a run described in configs/experiment
python -m eldenet.train -m seed=0,1,2 model=eldenet,eldenet_s   a sweep
"""

import shlex
import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.cli.entry_point import entry_point, given_settings
from eldenet.compose import REQUIRED, listed
from eldenet.configurable import instantiate, modules_named_in
from eldenet.data.splits import check_folders
from eldenet.data.workers import start_server
from eldenet.system.extras import EXTRAS, require
from eldenet.system.files import sole_writer, write_yaml
from eldenet.system.resources import choose_resources, is_main_process, join_processes, main_process_first
from eldenet.system.signals import as_ctrl_c
from eldenet.system.terminal import print_note
from eldenet.weights import find_checkpoint

if TYPE_CHECKING:
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.losses.base import WeightedSum
    from eldenet.training.trainer import Trainer


@dataclass(frozen=True)
class TrainSettings:
    """What ``python -m eldenet.train`` reads; ``configs/train.yaml`` names the defaults of the sections."""

    data: dict[str, Any] = REQUIRED
    model: dict[str, Any] = REQUIRED
    loss: dict[str, Any] = REQUIRED
    optimizer: dict[str, Any] = REQUIRED
    scheduler: dict[str, Any] = REQUIRED
    augmentation: dict[str, Any] = field(default_factory=dict)
    trainer: dict[str, Any] = REQUIRED
    runtime: dict[str, Any] = REQUIRED
    protocol: dict[str, Any] | None = None  # a name from configs/protocol; null: the data set's own
    # such as 0.8: the network predicts depth for a camera of this focal length [widths of its input], so that
    # its meters are right for any lens; null: only for the training's lens
    canonical_focal: float | None = None
    # imagenet, dataset (from training frames), or {mean: [r, g, b], std: [r, g, b]}
    normalization: Any = "imagenet"
    model_name: str = "${network_name:}"  # of the row in tables; by default model, or backbone_decoder
    seed: int = 0  # of weights, order and augmentation
    # the run folder; for a sweep, the folder of its runs
    output: str = "runs/${data.name}-${model_name}-${now:%Y%m%d-%H%M%S}"
    logger: Any = (
        "tensorboard"  # tensorboard, mlflow, wandb, trackio, or several: [tensorboard,mlflow]; []: none
    )
    # how long a process waits for the others (torchrun, accelerate launch) before it ends [s]
    process_timeout: float = 50
    ckpt_path: str | None = None  # run folder or .pt file to resume; auto: resume output if it holds a run
    teacher: str | None = None  # run, model folder or Hub id that loss=ssim_l1_distill learns from
    trusted_modules: Any = field(default_factory=list)  # packages whose classes foreign weights may name
    # run, model folder, Hub id or packaged weights to start from: copies the tensors that fit, and their
    # normalization
    weights: str | None = None

    def __post_init__(self) -> None:
        focal = self.canonical_focal
        if focal is not None and not 0.1 <= focal <= 10:
            raise ValueError(f"canonical_focal={focal:g}: give it in widths of the input, 0.1 to 10")
        if not self.process_timeout > 0:
            raise ValueError(f"process_timeout={self.process_timeout:g}: give seconds above 0")


def train(s: TrainSettings, overrides: Sequence[str] = ()) -> float:
    """Train, score the best epoch and record it; with ``ckpt_path="auto"`` a finished run is left as it is.

    Args:
        overrides: of the command line, such as ``loss=l1``; rows of a sweep are named by them.

    Returns:
        The best value of ``trainer.monitor``; NaN where no validation had one.

    Raises:
        ValueError: the settings do not fit each other, or the folder holds another run, or another process
            trains in it.
        FileNotFoundError: there are no such frames or weights.
        FloatingPointError: the loss became NaN or infinite; the last good checkpoint stays.
    """
    for name in listed(s.logger):
        if name in EXTRAS:
            require(f"logger={name}", name)
    folder, settings = Path(s.output), asdict(s)
    with sole_writer(folder) if is_main_process() else nullcontext():
        check_folders(s.data)
        if not (folder / "run.json").is_file():  # a finished run needs them no longer
            for name in ("weights", "teacher"):
                if settings[name] is not None:
                    find_checkpoint(settings[name], name)
        return _train(s, folder, settings, overrides)


def checked_parts(
    s: TrainSettings, weights: str | None = None
) -> "tuple[EvalProtocol, WeightedSum, Trainer, dict[str, Any]]":
    """Build what needs no frames, and the network once; return protocol, loss, trainer, network's settings.

    Raises:
        ValueError: a setting is wrong, or two do not fit each other; or ``weights`` do not fit the network.
    """
    from eldenet.evaluation.splits import chosen_protocol
    from eldenet.training.initialization import (
        canonical_camera,
        check_loss,
        check_range,
        check_sources,
        initial_model,
    )
    from eldenet.training.optim import build_optimizer, frozen_parts

    protocol = chosen_protocol(s.data, s.protocol)
    loss = instantiate(s.loss, "loss")
    trainer = instantiate(
        s.trainer,
        "trainer",
        optimizer=instantiate(s.optimizer, "optimizer"),
        scheduler=instantiate(s.scheduler, "scheduler"),
        seed=s.seed,
        loggers=listed(s.logger),
    )
    network = s.model | canonical_camera(s.canonical_focal, s.data["input_size"])
    model = initial_model(network, s.seed, weights, _trusted(s))
    check_loss(loss, model, s.teacher)
    check_sources(loss, s.data)
    check_range(model, s.data)
    frozen_parts(model, trainer.freeze)
    try:
        optimizer = build_optimizer(
            trainer.make_optimizer, model, loss, backbone_lr_factor=trainer.backbone_lr_factor
        )
    except ValueError as error:  # torch's do not say whose value is wrong
        raise ValueError(f"optimizer: {error}") from error
    trainer.make_scheduler(optimizer, 100, 10)
    return protocol, loss, trainer, network


def _trusted(s: TrainSettings) -> list[str]:
    return [*modules_named_in(s.model), *listed(s.trusted_modules)]


def _train(s: TrainSettings, folder: Path, settings: Mapping[str, Any], overrides: Sequence[str]) -> float:
    from eldenet.results.run_log import RunLog
    from eldenet.training.resume import checkpoint_to_resume, finished_value, run_folder

    loggers = listed(s.logger)
    log = RunLog(
        folder, quiet=not is_main_process(), loggers=[name for name in loggers if name == "tensorboard"]
    )
    if (best_value := finished_value(folder, s.ckpt_path, settings)) is not None:
        log.say(f"{folder}: already finished")
        return best_value
    checkpoint = checkpoint_to_resume(folder, s.ckpt_path, settings)
    if s.runtime.get("workers") != 0:
        start_server()  # its imports go on beside this process's own
    from eldenet.evaluation.splits import open_splits
    from eldenet.model import DepthNet
    from eldenet.results.fingerprints import fingerprints
    from eldenet.results.score import score
    from eldenet.results.tables import closing_table
    from eldenet.training import notes
    from eldenet.training.initialization import initial_model, trained_sizes
    from eldenet.training.normalization import normalization, write_normalization
    from eldenet.training.trainer import TrainingData

    resources = choose_resources(**s.runtime)
    # before the data, which may take minutes to render: a wrong setting shows at once
    protocol, loss, trainer, network = checked_parts(s, s.weights)
    trusted = _trusted(s)

    join_processes(resources, s.process_timeout)
    with main_process_first(resources):  # it renders or prepares what the others then find
        splits = open_splits(s.data, protocol, s.augmentation, seed=s.seed, labeled=loss.needs_depth)
    resumed = None if checkpoint is None else run_folder(checkpoint)
    chosen = normalization(s.normalization, splits.train, resumed=resumed)
    model = initial_model(network, s.seed, s.weights, trusted, chosen, log)
    if is_main_process():
        write_yaml(folder / "config.yaml", settings)
        write_normalization(folder, s.normalization, chosen)
    for note in notes.before(splits, loss, model, s.data, resources, folder):
        log.say(note)
    progress = trainer.fit(
        model,
        loss,
        TrainingData(splits.train, splits.val, protocol),
        folder,
        resources,
        ckpt_path=checkpoint,
        info={
            "model_name": s.model_name,
            "seed": s.seed,
            "data": s.data["name"],
            "started_from": s.weights,
            **trained_sizes(s.data["input_size"], protocol, splits.train),
        },
        sources=fingerprints(settings),
    )
    trainer.accelerator.wait_for_everyone()
    trainer.accelerator.end_training()  # a process that leaves with its group open may abort
    if trainer.accelerator.is_main_process:
        facts = {
            "training": asdict(progress) | {"effective_batch": trainer.effective_batch},
            "skipped": {"train": splits.train.skipped, "val": splits.val.skipped},
            "teacher": dict(loss.signature),
            "overrides": list(overrides),
        }
        # the best epoch, as anybody would load it
        best = DepthNet.from_pretrained(folder / "model", trusted_modules=trusted)
        record = score(best, settings, protocol, resources, log, facts=facts)
        closing_table(log, record)
        for note in notes.after(splits, trainer, record):
            log.say(note)
    return progress.best_value


@entry_point(TrainSettings)
def main(s: TrainSettings) -> float:
    """Train in ``s.output``; the best value of ``trainer.monitor`` is what a sweep may optimize."""
    with as_ctrl_c():
        try:
            return train(s, list(given_settings().values()))
        except KeyboardInterrupt:
            status: str | int | None = 130  # as shells count it
        except SystemExit as end:  # of a signal
            status = end.code
    print_note(f"stopped; to continue: {resume_command(s.output)}")
    raise SystemExit(status)


def resume_command(folder: str) -> str:
    """Return the command line that continues the training in ``folder``."""
    words = [word for key, word in given_settings().items() if key not in ("output", "ckpt_path")]
    start = sys.argv[0] if sys.argv[0].startswith("eldenet ") else "python -m eldenet.train"
    return f"{start} {shlex.join([*words, f'output={folder}', 'ckpt_path=auto'])}"


if __name__ == "__main__":
    main()

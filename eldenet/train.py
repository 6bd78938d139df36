"""``python -m eldenet.train``: config -> plain objects -> training -> evaluation -> ``run.json`` -> table."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point
from eldenet.results.fingerprints import differences
from eldenet.training.resume import checkpoint_of, finished_run, run_folder

if TYPE_CHECKING:
    from collections.abc import Mapping

    from omegaconf import DictConfig

    from eldenet.data.base import DepthDataset
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.losses.base import WeightedSum
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources


@entry_point("train")
def main(config: "DictConfig", folder: Path) -> float:
    """Train, evaluate the best epoch on the test split, measure its cost, write and show the result."""
    return train(config, folder)


def train(config: "DictConfig", folder: Path) -> float:
    """The whole run of ``config`` in ``folder``; with ``ckpt_path=auto`` a finished one is left as it is.

    Returns:
        The best value of ``trainer.monitor``; NaN where no validation had one.
    """
    from omegaconf import OmegaConf

    from eldenet.results.fingerprints import fingerprints
    from eldenet.results.run_log import RunLog
    from eldenet.results.score import score_and_record
    from eldenet.results.tables import closing_table
    from eldenet.system.resources import choose_resources
    from eldenet.training.normalization import normalization, write_normalization

    record = finished_run(config, folder)
    if record is not None:
        RunLog(folder, quiet=not cfg.is_main_process()).say(f"{folder}: finished already")
        best_value = record["training"]["best_value"]
        return math.nan if best_value is None else float(best_value)
    checkpoint = checkpoint_of(config, folder)
    resources = choose_resources(**cfg.plain(config.runtime))
    protocol = cfg.build_protocol(config)
    # before the data, which may take minutes to render: a wrong setting shows at once
    trainer = cfg.instantiate(
        config.trainer,
        optimizer=cfg.instantiate(config.optimizer),
        scheduler=cfg.instantiate(config.scheduler),
        seed=config.seed,
    )
    loss = build_loss(config)
    build_seeded_model(config, RunLog(folder, quiet=True))  # built again once its normalization is known
    train_set, val_set, test_set = build_splits(config, protocol, resources)
    log = RunLog(folder, quiet=not cfg.is_main_process())
    resumed = None if checkpoint is None else run_folder(checkpoint)
    chosen = normalization(cfg.plain(config.normalization), train_set, resumed=resumed)
    if chosen.keys() & config.model.keys():
        raise ValueError("both normalization and model.mean or model.std are given: take one of them")
    model = build_seeded_model(config, log, **chosen)
    if cfg.is_main_process():
        folder.mkdir(parents=True, exist_ok=True)
        OmegaConf.save(config, folder / "config.yaml", resolve=True)
        write_normalization(folder, cfg.plain(config.normalization), chosen)
    log.say(
        f"{config.data.name}: {len(train_set)} training and {len(val_set)} validation frames; "
        f"{resources.device}, {resources.precision}, {resources.threads} threads, {resources.workers} workers"
        f"; run folder {folder}"
    )
    say_what_is_learned_from(config, loss, train_set, {"validation": val_set, "test": test_set}, log)
    progress = trainer.fit(
        model,
        train_set,
        val_set,
        loss,
        protocol,
        folder,
        resources,
        ckpt_path=checkpoint,
        info={
            "model_name": config.model_name,
            "seed": config.seed,
            "data": config.data.name,
            "started_from": config.weights,
            **seen_sizes(cfg.plain(config.data.input_size), protocol, train_set),
        },
        sources=fingerprints(cfg.plain(config)),
    )
    trainer.accelerator.wait_for_everyone()
    trainer.accelerator.end_training()  # a process that leaves with its group open may abort
    if not trainer.accelerator.is_main_process:
        return progress.best_value
    best = _load_best(folder, config)
    record = score_and_record(
        config,
        best,
        protocol,
        resources,
        folder,
        log,
        name=config.model_name,
        progress=progress,
        skipped={"train": train_set.skipped, "val": val_set.skipped},
        teacher=loss.identity,
    )
    closing_table(log, record)
    return progress.best_value


def build_loss(config: "DictConfig") -> "WeightedSum":
    """What is minimized.

    Raises:
        ValueError: a teacher is named that it does not learn from.
    """
    loss: WeightedSum = cfg.instantiate(config.loss)
    if config.teacher is not None and not loss.identity:
        raise ValueError(
            f"teacher={config.teacher}: no term of this loss learns from a teacher; give "
            "loss=ssim_l1_distill, or leave the teacher out"
        )
    return loss


def build_splits(
    config: "DictConfig", protocol: "EvalProtocol", resources: "Resources"
) -> tuple["DepthDataset", "DepthDataset", "DepthDataset"]:
    """Training, validation and test frames.

    Raises:
        ValueError: they cannot be scored; that shows now, not after an epoch or the whole training.
    """
    from eldenet.system.resources import main_process_first

    with main_process_first(resources):  # it renders or prepares what the others then find
        train_set = cfg.build_split(config, "train", protocol, augment=True, seed=config.seed)
        val_set = cfg.build_split(config, "val", protocol)
        test_set = cfg.build_split(config, "test", protocol, score=True)
    for scored in (val_set, test_set):
        check_scored(scored, protocol)
    return train_set, val_set, test_set


def check_scored(dataset: "DepthDataset", protocol: "EvalProtocol") -> None:
    """Bring the first frame to where its metrics would be taken.

    Raises:
        ValueError: the protocol's crop does not fit into it, or its ground truth has another size.
    """
    sample = dataset[0]
    protocol.valid_mask(sample["depth"][None], sample["mask"][None])


def say_what_is_learned_from(
    config: "DictConfig",
    loss: "WeightedSum",
    train_set: "DepthDataset",
    scored: "Mapping[str, DepthDataset]",
    log: "RunLog",
) -> None:
    """Say which scored frames are trained on, and what a teacher sees of them."""
    from eldenet.losses.distillation import DistilledTerm

    for split, frames in scored.items():
        if count := remembered(train_set, frames):
            log.say(f"note: {count} of {len(frames)} {split} frames are trained on")
    for term in loss.terms.values():
        if isinstance(term, DistilledTerm):
            log.say(term.teacher.describe(config.data.input_size))


def remembered(train_set: "DepthDataset", scored: "DepthDataset") -> int:
    """How many of the frames that are scored are training frames: they say how well these are remembered."""
    from eldenet.data.inspection import identities

    return len(identities(train_set).keys() & identities(scored).keys())


def seen_sizes(
    input_size: list[int] | None, protocol: "EvalProtocol", train_set: "DepthDataset"
) -> dict[str, list[int] | None]:
    """What a model says of its pictures: ``(height, width)`` [px] of what it sees, and of the whole frame.

    The latter only where the protocol shows the network a part of the camera's frame, and by the first frame.
    """
    from eldenet.data.resize_crop import whole_frame_size

    sizes: dict[str, list[int] | None] = {"input_size": input_size}
    if protocol.changes_frames:
        height, width = train_set.load_frame(0).depth.shape
        whole = list(whole_frame_size(protocol, (height, width), input_size))
        if whole != input_size:
            sizes["whole_frame_size"] = whole
    return sizes


def build_seeded_model(config: "DictConfig", log: "RunLog", **arguments: Any) -> "DepthNet":
    """The network with weights drawn from ``config.seed``, or taken over from ``config.weights``.

    ``arguments`` go to its constructor beside those of ``config.model``.

    Raises:
        ValueError: the weights are those of another network, or of none.
    """
    from eldenet.system.resources import seed_everything
    from eldenet.training.normalization import keep_normalization

    seed_everything(config.seed)
    model = cfg.build_model(config.model, **arguments)
    if config.weights is not None:
        import eldenet

        if str(config.weights) in eldenet.list_models():
            raise ValueError(
                f"weights={config.weights} names a network without trained weights: give a run of it, a "
                f"saved model, a Hub id, or the package's {', '.join(eldenet.list_weights())} (of a folder "
                f"of that name: ./{config.weights})"
            )
        start = eldenet.load(config.weights, trusted_modules=_own_modules(cfg.plain(config.model)))
        own = model.state_dict()
        fitting = {
            name: value
            for name, value in start.state_dict().items()
            if name in own and own[name].shape == value.shape
        }
        share = sum(value.numel() for value in fitting.values()) / sum(
            value.numel() for value in own.values()
        )
        if share < 0.1:
            raise ValueError(
                f"weights={config.weights}: they fit {100 * share:.0f} % of this network, so it would "
                "start from scratch: take the network that they are of"
            )
        model.load_state_dict(fitting, strict=False)
        if len(fitting) < len(own):
            missing = ", ".join(sorted(own.keys() - fitting.keys())[:3])
            log.say(f"weights: {len(fitting)} of {len(own)} tensors taken over; not: {missing}, ...")
        chosen = bool(arguments) or bool({"mean", "std"} & config.model.keys())
        for line in (keep_normalization(model, start, chosen=chosen), _other_settings(model, start)):
            if line:
                log.say(line)
    return model


def _other_settings(model: "DepthNet", start: "DepthNet") -> str:
    """What to say where the weights are of a network that computes something else from equal tensors."""
    found = differences(model.config, start.config, ignored=frozenset({"mean", "std"}))
    return f"weights: of a network with other settings; here {', '.join(found)}" if found else ""


def _load_best(folder: Path, config: "DictConfig") -> "DepthNet":
    """The best epoch's weights as anybody would load them; parts from elsewhere are the user's own here."""
    from eldenet.model import DepthNet

    return DepthNet.from_pretrained(folder / "model", trusted_modules=_own_modules(cfg.plain(config.model)))


def _own_modules(node: Any) -> list[str]:
    """Modules that the user's own command line named: these are trusted, a downloaded config's are not."""
    if not isinstance(node, dict):
        return []
    named = [str(node["_target_"]).rpartition(".")[0]] if "_target_" in node else []
    return named + [module for value in node.values() for module in _own_modules(value)]


if __name__ == "__main__":
    main()

"""``python -m eldenet.evaluate``: any checkpoint, any data set, any protocol."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.deploy.runtimes.module import RuntimeNetwork
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.model import DepthNet
    from eldenet.results.run_log import RunLog
    from eldenet.system.resources import Resources


@entry_point("evaluate")
def main(config: "DictConfig", folder: Path) -> None:
    """Load, score, measure, write ``run.json`` and show the table."""
    from eldenet.results.run_log import RunLog
    from eldenet.results.score import score_and_record
    from eldenet.results.tables import closing_table
    from eldenet.system.resources import choose_resources
    from eldenet.zoo import note_if_untrained

    if (folder / "checkpoints").is_dir():
        raise ValueError(
            f"run_dir={folder} holds a training, whose run.json this would replace: give another"
        )
    resources = choose_resources(**cfg.plain(config.runtime))
    protocol = cfg.build_protocol(config)
    model = _open(config, resources)
    folder.mkdir(parents=True, exist_ok=True)
    log = RunLog(folder)
    if note := note_if_untrained(config.checkpoint):
        log.say(note)
    _choose_input_size(config, model, protocol, log)
    record = score_and_record(
        config,
        model,
        protocol,
        resources,
        folder,
        log,
        name=str(model.info.get("model_name", config.checkpoint)),
        split=config.split,
        batch_size=config.batch_size,
    )
    closing_table(log, record)


def _open(config: "DictConfig", resources: "Resources") -> "DepthNet | RuntimeNetwork":
    """What ``checkpoint`` names: a model for torch, or an exported file under ``engine``.

    A file runs on an accelerator only where that was asked for: it takes another build of its runtime.
    """
    import eldenet
    from eldenet.deploy import runtimes
    from eldenet.deploy.runtimes.module import RuntimeNetwork

    if Path(str(config.checkpoint)).suffix in runtimes.READS:
        device = "cpu" if config.runtime.device == "auto" else resources.device
        network = runtimes.load(
            config.checkpoint, config.engine, config.precision, threads=resources.threads, device=device
        )
        return RuntimeNetwork(network)
    if (config.engine, config.precision) != ("auto", None):
        raise ValueError("engine and precision are for exported files (python -m eldenet.export)")
    return eldenet.load(config.checkpoint, trusted_modules=cfg.plain(config.trusted_modules))


def _choose_input_size(
    config: "DictConfig", model: "DepthNet | RuntimeNetwork", protocol: "EvalProtocol", log: "RunLog"
) -> None:
    """Set ``data.input_size`` to what ``input_size`` asks for, and say so where that changes it."""
    wanted = cfg.plain(config.input_size)
    if wanted == "model":
        wanted = trained_size(model, protocol)
    if wanted is None or wanted == "data":
        return
    if isinstance(wanted, str) or len(wanted) != 2:
        raise ValueError(f"input_size={wanted!r}: give [height, width], model or data")
    if list(wanted) != cfg.plain(config.data.input_size):
        own = config.data.input_size
        log.say(f"the network sees {wanted[0]} x {wanted[1]} pixels, data.input_size={own} is not used")
        config.data.input_size = list(wanted)


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
            f"this file sees the camera's whole frames, {seen[0]} x {seen[1]} pixels, and protocol "
            f"{protocol.name} shows a part of them: to score the network, export it with size= of that part "
            "(the training's data.input_size)"
        )
    return seen


if __name__ == "__main__":
    main()

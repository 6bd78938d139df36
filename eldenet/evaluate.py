"""``python -m eldenet.evaluate``: any checkpoint, any data set, any protocol."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet import config as cfg

if TYPE_CHECKING:
    from omegaconf import DictConfig


@cfg.entry_point("evaluate")
def main(config: "DictConfig", folder: Path) -> None:
    """Load, score, measure, write ``run.json`` and show the table."""
    import eldenet
    from eldenet.report import closing_table
    from eldenet.resources import choose_resources
    from eldenet.runlog import RunLog
    from eldenet.scoring import score_and_record

    if (folder / "checkpoints").is_dir():
        raise ValueError(
            f"run_dir={folder} holds a training, whose run.json this would replace: give another"
        )
    resources = choose_resources(**cfg.plain(config.runtime))
    protocol = cfg.build_protocol(config)
    model = eldenet.load(config.checkpoint, trusted_modules=cfg.plain(config.trusted_modules))
    folder.mkdir(parents=True, exist_ok=True)
    log = RunLog(folder)
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


if __name__ == "__main__":
    main()

"""``python -m eldenet.train``: train, score the best epoch, write ``run.json`` and show the table."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point
from eldenet.config import build_training

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("train")
def main(config: "DictConfig", folder: Path) -> float:
    """Train in ``folder``; the best value of ``trainer.monitor`` is what a sweep may optimize."""
    from eldenet.training.run import train

    return train(build_training(config, folder))


if __name__ == "__main__":
    main()

"""``python -m eldenet.evaluate``: any checkpoint, any data set, any protocol."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point
from eldenet.config import build_evaluation

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("evaluate")
def main(config: "DictConfig", folder: Path) -> None:
    """Score a checkpoint, write ``run.json`` into ``folder`` and show the table."""
    from eldenet.deploy.scoring import evaluate

    evaluate(build_evaluation(config, folder))


if __name__ == "__main__":
    main()

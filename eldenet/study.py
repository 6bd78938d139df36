"""``python -m eldenet.study``: the missing runs of a study, here or as jobs of a cluster."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point
from eldenet.compose import resolver

if TYPE_CHECKING:
    from omegaconf import DictConfig


@resolver("study_rows")
def study_rows(study: str, rows: Any) -> str:
    """``${study_rows:folder,rows}``: the rows of a study as a sweep (configs/study.yaml)."""
    from eldenet.results.studies.plan import read_study

    return ",".join(row.name for row in read_study(study, cfg.training_composition()).chosen(cfg.plain(rows)))


@entry_point("study")
def main(config: "DictConfig", folder: Path) -> None:
    """Run the chosen rows one after the other and print at the end what became of each."""
    from eldenet.results.run_log import RunLog
    from eldenet.results.studies.runner import run_study

    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise ValueError(
            "a study runs in one process per row (-m): use torchrun for one run of eldenet.train"
        )
    training = cfg.study_training()
    run_study(cfg.build_study(config), training, RunLog(folder))


if __name__ == "__main__":
    main()

"""``python -m eldenet.study``: the missing runs of a study, here or as jobs of a cluster."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point

if TYPE_CHECKING:
    from omegaconf import DictConfig


@cfg.resolver("study_rows")
def study_rows(study: str, rows: Any) -> str:
    """``${study_rows:folder,rows}``: the rows of a study as a sweep (configs/study.yaml)."""
    from eldenet.results.studies.plan import row_names

    return row_names(study, cfg.plain(rows))


@entry_point("study")
def main(config: "DictConfig", folder: Path) -> None:
    """Run the chosen rows one after the other; say at the end what became of each.

    Raises:
        ValueError: after all of them, if some failed; at once for seeds that no chosen row has, or in a job
            of several processes.
    """
    from eldenet.results.run_log import RunLog
    from eldenet.results.studies.plan import read_study
    from eldenet.results.studies.runner import refuse_unknown_seeds, run_row
    from eldenet.system.resources import is_main_process

    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise ValueError("a study runs in one process per row (-m): give torchrun one run of eldenet.train")
    study = read_study(config.study)
    seeds = None if config.seeds is None else cfg.listed(config.seeds)
    refuse_unknown_seeds(study.chosen(cfg.plain(config.rows)), seeds)  # a sweep's job has one row of these
    names = config.row if config.row is not None else cfg.plain(config.rows)
    log = RunLog(folder, quiet=not is_main_process())
    outcomes = []
    for row in study.chosen(names):
        given = cfg.plain(config.given)
        outcomes += run_row(
            study,
            row,
            Path(config.runs),
            given=given,
            seeds=seeds,
            rerun=config.rerun,
            say=log.say,
        )
    log.table(
        f"study {study.name}", ("run", "status"), [(outcome.run, outcome.status) for outcome in outcomes]
    )
    failed = [f"{outcome.run} ({outcome.reason})" for outcome in outcomes if outcome.status == "failed"]
    if failed:
        raise ValueError(f"{len(failed)} of {len(outcomes)} runs failed: {'; '.join(failed)}")
    log.say(f"tables: python -m eldenet.report study={config.study}")


if __name__ == "__main__":
    main()

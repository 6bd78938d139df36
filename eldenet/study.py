"""``python -m eldenet.study``: the missing runs of a study, here or as jobs of a cluster.

python -m eldenet.study study=experiments/table3_rivals                    every row, one after the other
python -m eldenet.study study=experiments/table3_rivals 'rows=[eldenet]'   some rows
python -m eldenet.study -m study=experiments/table3_rivals hydra/launcher=ray   one job per row, anywhere
Wrong settings of any row show first. Finished runs are skipped, killed ones resume, failed ones are listed.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from eldenet.cli.entry_point import entry_point
from eldenet.compose import REQUIRED, listed, plain, resolver
from eldenet.studies.plan import StudyRow, read_study

#: What rows of our own studies need.
GIVEN = (
    *("kitti", "kitti_raw", "cityscapes", "pplcnet_x1_0", "mobilenet_v2"),
    *("eldenet_l_rooms", "eldenet_plain_rooms", "teacher"),
)


@dataclass(frozen=True)
class StudySettings:
    """What ``python -m eldenet.study`` reads."""

    study: str = REQUIRED  # folder of sweep.yaml
    rows: Any = None  # names of rows; null: all
    row: str | None = None  # the row of this job in a sweep
    seeds: Any = None  # of every row; null: its seeds in sweep.yaml
    output: str = "runs"  # run folders are created below <output>/<study>
    # true: also train rows that are stored but not below output, because other rows need their weights
    rerun: bool = False
    # what some rows need (a root, weights); rows that lack it are skipped, and the table says so. Add a name
    # that your own study needs with a plus: +given.mine=...
    given: dict[str, Any] = field(default_factory=lambda: dict.fromkeys(GIVEN))


def study(s: StudySettings) -> None:
    """Run the chosen rows one after the other and print at the end what became of each.

    Raises:
        ValueError: after all of them, if some failed; at once for wrong settings of a row, unknown rows, or
            seeds that no row has.
    """
    from eldenet.results.run_log import RunLog
    from eldenet.studies.runner import refuse_wrong_rows, run_row

    if int(os.environ.get("WORLD_SIZE", "1")) > 1:
        raise ValueError(
            "a study runs in one process per row (-m): use torchrun for one run of eldenet.train"
        )
    plan, log = read_study(s.study), RunLog(Path.cwd())
    seeds = None if s.seeds is None else listed(s.seeds)
    refuse_unknown_seeds(plan.chosen(s.rows), seeds)  # a sweep's job runs one of these rows
    rows = plan.chosen(s.rows if s.row is None else s.row)
    options: dict[str, Any] = {"seeds": seeds, "rerun": s.rerun, "given": s.given}
    if s.row is None:  # better now than when its turn comes
        refuse_wrong_rows(plan, rows, Path(s.output), **options)
    outcomes = [
        outcome for row in rows for outcome in run_row(plan, row, Path(s.output), say=log.say, **options)
    ]
    log.table(f"study {plan.name}", ("run", "status"), [(one.run, one.status) for one in outcomes])
    failed = [f"{one.run} ({one.reason})" for one in outcomes if one.status == "failed"]
    if failed:
        raise ValueError(f"{len(failed)} of {len(outcomes)} runs failed: {'; '.join(failed)}")
    log.say(f"tables: eldenet report study={s.study}")


def refuse_unknown_seeds(rows: Sequence[StudyRow], seeds: Sequence[int] | None) -> None:
    """Raise ValueError for seeds that none of ``rows`` has."""
    known = sorted({seed for row in rows for seed in row.seeds})
    unknown = [seed for seed in seeds or () if seed not in known]
    if unknown:
        raise ValueError(
            f"seeds={unknown}: the chosen rows have the seeds {', '.join(map(str, known))}; add others in "
            "sweep.yaml"
        )


@resolver("study_rows")
def study_rows(study: str, rows: Any) -> str:
    """``${study_rows:folder,rows}``: the rows of a study as a sweep (configs/study.yaml)."""
    return ",".join(row.name for row in read_study(study).chosen(plain(rows)))


main = entry_point(StudySettings)(study)

if __name__ == "__main__":
    main()

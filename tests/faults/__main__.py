"""``python -m tests.faults``: the whole campaign, for ``results.json`` and the table in docs/reliability.md.

``--quick`` makes one flip and one cut of the kinds that take no seconds, and stores nothing.
"""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
os.environ["OMP_NUM_THREADS"] = "1"
os.environ.setdefault("NO_ALBUMENTATIONS_UPDATE", "1")

import torch

torch.set_num_threads(1)

from .accidents import full_disk, kills, on_this_disk, two_caches, two_trainings  # noqa: E402
from .campaign import Outcome, attack, damages  # noqa: E402
from .hostile import attack_all  # noqa: E402
from .kinds import COSTLY, KINDS  # noqa: E402
from .mistakes import try_all  # noqa: E402
from .table import RESULTS, Row, counted, is_wrong, write_page  # noqa: E402


def main() -> None:
    """Run what is asked for; exit code 1 if anything is raw, hangs or is silent where it could be seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", default="", help="kinds of files whose name contains this, nothing else")
    parser.add_argument("--output", type=Path, help="results.json of this run, instead of the repository's")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["ELDENET_CACHE"] = f"{folder}/cache"
        rows = campaign(Path(folder), quick=given.quick, only=given.only)
    if given.output is not None:
        given.output.write_text(json.dumps([row._asdict() for row in rows], indent=1) + "\n")
    if given.output is None and not (given.quick or given.only):
        RESULTS.write_text(json.dumps([row._asdict() for row in rows], indent=1) + "\n")
        write_page(rows)
    sys.exit(any(is_wrong(row) for row in rows))


def campaign(folder: Path, *, quick: bool, only: str) -> list[Row]:
    """One row of the table after the other, said as it is done."""
    rows: list[Row] = []

    def add(part: str, name: str, outcomes: list[Outcome], digest: bool = True) -> None:
        rows.append(counted(part, name, outcomes, digest))
        row = rows[-1]
        print(f"{part}: {name}: {row.counts}", *row.wrong, sep="\n    ", flush=True)

    for number, kind in enumerate(KINDS):
        if only in kind.name and not (quick and any(word in kind.name for word in COSTLY)):
            found = attack(kind, folder / f"kind{number}", damages(1, 1) if quick else damages(20, 10))
            add("file", kind.name, found, kind.digest)
    if only:
        return rows
    for name, outcome in attack_all(folder / "hostile", quick=quick).items():
        add("hostile", name, [outcome])
    for name, outcomes in try_all(folder / "mistakes", 1 if quick else 10).items():
        add("mistake", name, outcomes)
    add("accident", "two processes fill a frame cache", two_caches(folder / "caches", 2 if quick else 20))
    if quick:
        return rows
    disk = full_disk(folder / "full")
    for name, outcomes in (disk or {}).items():
        add("full disk", name, outcomes)
    (folder / "kills").mkdir()
    add("accident", "kills of a training", kills(folder / "kills", 12))
    add("accident", "two trainings in one folder", two_trainings(folder / "two", 3))
    return rows


if __name__ == "__main__":
    if sys.argv[1:2] == ["full-disk"]:  # within the process that may mount
        found = on_this_disk(Path(sys.argv[2]))
        Path(sys.argv[3]).write_text(json.dumps(found))
    else:
        main()

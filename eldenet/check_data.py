"""``python -m eldenet.check_data``: is the data set complete, and does it hold what its config says?

python -m eldenet.check_data my_frames                 (what is this folder, and which settings read it?)
python -m eldenet.check_data data=folder data.root=my_frames
python -m eldenet.check_data data=nyu_labelled frames=100
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.cli.entry_point import entry_point
from eldenet.compose import REQUIRED
from eldenet.data.splits import check_folders, same_splits
from eldenet.system.checks import at_least
from eldenet.system.files import write_json

if TYPE_CHECKING:
    from eldenet.data.inspection import DataCheck, SplitCheck
    from eldenet.results.run_log import RunLog

CHECK_FILE, SHEET = "check.json", "contact_sheet.png"


@dataclass(frozen=True)
class CheckDataSettings:
    """What ``python -m eldenet.check_data`` reads."""

    data: dict[str, Any] = REQUIRED
    # null: the data set's own; val and test must have its kind of ground truth
    protocol: dict[str, Any] | None = None
    folder: str | None = None  # only say what this folder seems to be, and which settings read it
    frames: int | None = None  # number of frames to read from each split, evenly spread; null: all
    samples: int = 4  # frames of each split on the contact sheet
    # folder for check.json and contact_sheet.png; overwritten by the next check
    output: str = "runs/check-${data.name}"

    def __post_init__(self) -> None:
        at_least(1, frames=self.frames)
        at_least(0, samples=self.samples)


def check_data(s: CheckDataSettings) -> bool:
    """Check every split, print a table, write ``check.json`` and a contact sheet; True without faults.

    Raises:
        FileNotFoundError: the data set's folder does not exist.
    """
    check_folders(s.data)
    from eldenet.data.inspection import check_splits
    from eldenet.evaluation.splits import chosen_protocol
    from eldenet.results.run_log import RunLog
    from eldenet.visualization import contact_sheet, write_picture

    folder = Path(s.output).expanduser()
    log, same = RunLog(folder), same_splits(s.data)
    protocol = chosen_protocol(s.data, s.protocol)
    found = check_splits(s.data, protocol.check_ground_truth, log.bar, frames=s.frames, samples=s.samples)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(
        folder / CHECK_FILE,
        {
            "data": s.data["name"],
            "faults": found.faults,
            "same_frames": same,
            "splits": [split.as_dict() for split in found.splits],
            "config": s.data,
        },
    )
    (folder / SHEET).unlink(missing_ok=True)  # from an older check
    if found.panels:
        write_picture(folder / SHEET, contact_sheet(found.panels, s.samples))
    _show(log, s.data, same, found)
    return not found.faults


def recognize_folder(folder: Path) -> bool:
    """Say what a folder seems to be, and print the settings that read it; True if there are some.

    Raises:
        FileNotFoundError: there is no such folder.
    """
    from eldenet.data.folder_recognition import recognize
    from eldenet.data.known_layouts import tree_lines
    from eldenet.results.run_log import RunLog

    log, recognized = RunLog(folder), recognize(folder)
    for found in recognized:
        log.say(f"{folder} seems to hold {found.title}")
        for fact in found.facts:
            log.say(f"  {fact}")
        if len(found.readings) > 1:
            log.say("  a distance that you know decides which of these reads it, if any:")
        for reading in found.readings:
            log.say(f"  {reading.note}:" if reading.note else "  read by:")
            log.say(f"    {reading.line}")
    if not recognized:
        log.say(
            f"{folder} holds no pictures with depth in a layout that is known. Known are, from data.root:"
        )
        for line in tree_lines():
            log.say(f"  {line}")
    return any(found.readings for found in recognized)


def _show(log: "RunLog", data: Mapping[str, Any], same: Mapping[str, str], found: "DataCheck") -> None:
    """Print one table with a column per split that could be opened, then what is wrong or in doubt."""
    from eldenet.data.inspection import encoding_of, inverse_doubts, unit_doubts

    opened = [split for split in found.splits if not split.fault]
    if cells := [_cells(split) for split in opened]:
        rows = [[title, *(column[title] for column in cells)] for title in cells[0]]
        log.table(f"data={data['name']}", ["", *(split.split for split in opened)], rows)
    for copy, original in same.items():
        log.say(f"{copy} has the same frames as {original}, which were read once")
    for split in found.splits:
        if split.split == "train" and split.mean:
            mean, std = (",".join(f"{v:.4f}" for v in values) for values in (split.mean, split.std))
            log.say(f"mean and std of the training images: 'normalization={{mean: [{mean}], std: [{std}]}}'")
    for line in found.faults:
        log.say(line)
    encoding = data.get("encoding")
    guesses = [
        (split.split, *unit_doubts(split.median, encoding_of(encoding, split.split)))
        for split in found.splits
        if encoding is not None and split.median is not None
    ]
    for split_name, line, _ in guesses:
        log.say(f"{split_name}: {line}")
    for line in inverse_doubts({split.split: split.farther_below for split in found.splits}):
        log.say(line)
    if found.faults:
        verdict = "something is wrong, see above"
    elif any(implausible for *_, implausible in guesses):
        verdict = "no file is wrong, but the depth is implausible: check data.encoding"
    elif guesses:
        verdict = "no file is wrong; check with the depth above whether data.encoding is right"
    else:
        verdict = "all is well"
    log.say(f"{verdict}; written to {log.folder}: {CHECK_FILE}" + (f", {SHEET}" if found.panels else ""))


def _cells(found: "SplitCheck") -> dict[str, str]:
    """One column of the table."""
    sizes = [f"{size}: {count}" for size, count in found.sizes.items()]
    marks = {q: found.percentiles.get(q) for q in ("p5", "p50", "p95")}
    focal = f", fx {found.intrinsics[0]:.1f} px" if found.intrinsics else ""
    return {
        "frames": str(len(found.names)),
        "files missing": str(len(found.missing)),
        "read": str(found.looked_at),
        "unreadable": str(len(found.unreadable)),
        "without depth": str(len(found.without_depth)),
        "height x width [px]": "\n".join(sizes[:5] + [f"{len(sizes) - 5} more"] * (len(sizes) > 5)) or "-",
        "pixels with depth": f"{found.valid:.1%}",
        "depth range [m]": f"{found.min_depth:g} to {found.max_depth:g}",
        "pixels out of range": f"{found.outside:.1%}",
        **{f"depth {q} [m]": "-" if mark is None else f"{mark:.2f}" for q, mark in marks.items()},
        "histogram": _bars(found.histogram),
        "intrinsics": f"{found.with_intrinsics}{focal}",
        "split hash": found.split_hash or "-",
    }


def _bars(counts: list[int]) -> str:
    """A histogram in one line of text; every bin that is not empty shows."""
    most = max(counts, default=0)
    if not most:
        return "-"
    return "".join(" ▁▂▃▄▅▆▇█"[-(-8 * count // most)] for count in counts)


@entry_point(CheckDataSettings)
def check(s: CheckDataSettings) -> None:
    """Exit with code 1 if anything is wrong."""
    good = check_data(s) if s.folder is None else recognize_folder(Path(s.folder).expanduser())
    if not good:
        raise SystemExit(1)


def main() -> None:
    """Take a folder without a setting's name as ``folder=``."""
    if len(sys.argv) > 1 and "=" not in sys.argv[1] and not sys.argv[1].startswith("-"):
        sys.argv[1] = f"folder={sys.argv[1]}"
    check()


if __name__ == "__main__":
    main()

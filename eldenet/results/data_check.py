"""The check of a data set as a table, ``check.json`` and a contact sheet."""

from eldenet.data.inspection import CheckDataSetup, DataCheck, SplitCheck, check_data, doubts, encoding_of
from eldenet.results.run_log import RunLog
from eldenet.system.files import write_json
from eldenet.visualization import contact_sheet, write_picture

CHECK_FILE, SHEET = "check.json", "contact_sheet.png"


def check(setup: CheckDataSetup) -> bool:
    """Check the data set, print a table, write ``check.json`` and a contact sheet; True if all is well."""
    log = RunLog(setup.folder)
    found = check_data(setup, log.bar)
    setup.folder.mkdir(parents=True, exist_ok=True)
    write_json(
        setup.folder / CHECK_FILE,
        {
            "data": setup.name,
            "faults": found.faults,
            "same_frames": dict(setup.same),
            "splits": [split.as_dict() for split in found.splits],
            "config": setup.config,
        },
    )
    sheet = setup.folder / SHEET
    sheet.unlink(missing_ok=True)  # from an older check
    if found.panels:
        write_picture(sheet, contact_sheet(found.panels, setup.samples))
    _show(log, setup, found)
    return not found.faults


def _show(log: RunLog, setup: CheckDataSetup, found: DataCheck) -> None:
    """Print one table with a column per split that could be opened, then what is wrong or in doubt."""
    opened = [split for split in found.splits if not split.fault]
    if cells := [_cells(split) for split in opened]:
        rows = [[title, *(column[title] for column in cells)] for title in cells[0]]
        log.table(f"data={setup.name}", ["", *(split.split for split in opened)], rows)
    for copy, original in setup.same.items():
        log.say(f"{copy} has the same frames as {original}, which were read once")
    for split in found.splits:
        if split.split == "train" and split.mean:
            mean, std = (",".join(f"{v:.4f}" for v in values) for values in (split.mean, split.std))
            log.say(f"mean and std of the training images: 'normalization={{mean: [{mean}], std: [{std}]}}'")
    for line in found.faults:
        log.say(line)
    guesses = [
        (split.split, *doubts(split.median, encoding_of(setup.encoding, split.split)))
        for split in found.splits
        if setup.encoding is not None and split.median is not None
    ]
    for split_name, line, _ in guesses:
        log.say(f"{split_name}: {line}")
    if found.faults:
        verdict = "something is wrong, see above"
    elif any(implausible for *_, implausible in guesses):
        verdict = "no file is wrong, but the depth is implausible: check data.encoding"
    elif guesses:
        verdict = "no file is wrong; check with the depth above whether data.encoding is right"
    else:
        verdict = "all is well"
    log.say(f"{verdict}; written to {log.folder}: {CHECK_FILE}" + (f", {SHEET}" if found.panels else ""))


def _cells(found: SplitCheck) -> dict[str, str]:
    """One column of the table."""
    sizes = [f"{size}: {count}" for size, count in found.sizes.items()]
    marks = [found.percentiles.get(q) for q in ("p5", "p50", "p95")]
    focal = f", fx {found.intrinsics[0]:.1f} px" if found.intrinsics else ""
    return {
        "frames": str(len(found.names)),
        "files missing": str(len(found.missing)),
        "read": str(found.looked_at),
        "unreadable": str(len(found.unreadable)),
        "without depth": str(len(found.without_depth)),
        "height x width [px]": "\n".join(sizes[:5] + [f"{len(sizes) - 5} more"] * (len(sizes) > 5)) or "-",
        "pixels with depth": f"{found.valid:.1%}",
        "depth that counts [m]": f"{found.min_depth:g} to {found.max_depth:g}",
        "pixels with depth beyond": f"{found.outside:.1%}",
        "depth p5 / p50 / p95 [m]": " / ".join("-" if mark is None else f"{mark:.2f}" for mark in marks),
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

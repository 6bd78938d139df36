"""``python -m eldenet.check_data``: is the data set whole, and does it hold what its config says?"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.data.base import DepthDataset
    from eldenet.data.inspection import SplitCheck
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.results.run_log import RunLog

SPLITS = ("train", "val", "test")
CHECK_FILE, SHEET = "check.json", "contact_sheet"


@entry_point("check_data")
def main(config: "DictConfig", folder: Path) -> None:
    """Check every split; exit code 1 if anything is wrong."""
    if not check(config):
        raise SystemExit(1)


def check(config: "DictConfig") -> bool:
    """Read the splits, show a table, write ``check.json`` and a contact sheet; True if all is well."""
    from eldenet.data.inspection import SplitCheck, check_split, shared_frames
    from eldenet.results.run_log import RunLog
    from eldenet.system.files import write_json
    from eldenet.visualization import contact_sheet, write_picture

    for name, least in (("frames", 1), ("samples", 0)):
        if config[name] is not None and config[name] < least:
            raise ValueError(f"{name}={config[name]}: give a number from {least} on, or leave it out")
    log = RunLog(Path(config.run_dir).expanduser())
    protocol = cfg.build_protocol(config)
    nodes = {split: cfg.plain(config.data[split]) for split in SPLITS if config.data.get(split) is not None}
    subset = cfg.plain(config.data.get("subset")) or {}
    same: dict[str, str] = {}  # test: ${data.val}, where a data set has no third part
    checks: list[SplitCheck] = []
    panels: list[tuple[str, Any]] = []
    refused: list[str] = []
    for split, node in nodes.items():
        alike = [o for o in nodes if nodes[o] == node and subset.get(o) == subset.get(split)]
        original = alike[0]
        if original != split:
            same[split] = original
            continue
        try:
            # a data set without files of its own (rooms) has nothing to skip
            lenient = {"on_error": "skip"} if "on_error" in node else {}
            dataset = cfg.instantiate({**node, **lenient})
            if subset.get(split) is not None:
                dataset.draw_subset(subset[split], config.data.subset_seed)
        except (ValueError, OSError) as error:
            checks.append(SplitCheck(split, fault=str(error)))
            continue
        total = len(dataset) if config.frames is None else min(config.frames, len(dataset))
        with log.bar(f"checking {split}", total) as bar:
            checks.append(check_split(split, dataset, frames=config.frames, advance=bar.advance))
        panels += _samples(split, dataset, config.samples, checks[-1])
        refused += [] if split == "train" else _refused(split, dataset, protocol)
    faults = [line for found in checks for line in found.faults] + refused + shared_frames(checks)
    log.folder.mkdir(parents=True, exist_ok=True)
    write_json(
        log.folder / CHECK_FILE,
        {
            "data": config.data.name,
            "faults": faults,
            "same_frames": same,
            "splits": [found.as_dict() for found in checks],
            "config": cfg.plain(config.data),
        },
    )
    sheet = log.folder / f"{SHEET}.png"
    sheet.unlink(missing_ok=True)  # an older check's
    if panels:
        write_picture(sheet, contact_sheet(panels, config.samples))
    _show(log, config.data.name, checks, same, faults, bool(panels))
    return not faults


def _refused(split: str, dataset: "DepthDataset", protocol: "EvalProtocol") -> list[str]:
    """What a training would say, if the protocol does not score this kind of ground truth."""
    try:
        protocol.check_ground_truth(dataset.ground_truth)
    except ValueError as error:
        return [f"{split}: {error}"]
    return []


def _samples(split: str, dataset: Any, wanted: int, found: "SplitCheck") -> list[tuple[str, Any]]:
    """Titled pictures of evenly spread frames that can be read: image over depth."""
    from eldenet.data.inspection import spread
    from eldenet.visualization import image_over_depth

    readable = [i for i, name in enumerate(dataset.names) if name not in found.unreadable]
    panels = []
    for at in spread(len(readable), wanted) if readable and wanted else []:
        try:
            frame = dataset.load_frame(readable[at])
        except (ValueError, OSError):  # with frames=..., not every frame was tried
            continue
        panels.append(
            (f"{split}  {frame.name}", image_over_depth(frame.image, frame.depth, dataset.max_depth))
        )
    return panels


def _show(
    log: "RunLog", name: str, checks: "list[SplitCheck]", same: dict[str, str], faults: list[str], sheet: bool
) -> None:
    """One table with a column per split, then what is wrong."""
    cells = [_cells(found) for found in checks]
    rows = [[title, *(column[title] for column in cells)] for title in cells[0]]
    log.table(f"data={name}", ["", *(found.split for found in checks)], rows)
    for copy, original in same.items():
        log.say(f"{copy} is {original}: the same frames, read once")
    for found in checks:
        if found.split == "train" and found.mean:
            mean, std = (",".join(f"{v:.4f}" for v in values) for values in (found.mean, found.std))
            log.say(f"the training images' own: 'normalization={{mean: [{mean}], std: [{std}]}}'")
    for line in faults:
        log.say(line)
    verdict = "something is wrong, see above" if faults else "all is well"
    log.say(f"{verdict}; written to {log.folder}: {CHECK_FILE}" + (f", {SHEET}.png" if sheet else ""))


def _cells(found: "SplitCheck") -> dict[str, str]:
    """One column of the table."""
    sizes = [f"{size}: {count}" for size, count in found.sizes.items()]
    marks = [found.percentiles.get(q) for q in ("p5", "p50", "p95")]
    focal = f", fx {found.intrinsics[0]:.1f} px" if found.intrinsics else ""
    return {
        "frames": "cannot be opened" if found.fault else str(len(found.names)),
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
    """A histogram in one line of text; a bin that holds anything shows."""
    most = max(counts, default=0)
    if not most:
        return "-"
    return "".join(" ▁▂▃▄▅▆▇█"[-(-8 * count // most)] for count in counts)


if __name__ == "__main__":
    main()

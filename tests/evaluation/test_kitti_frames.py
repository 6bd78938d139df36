"""The study of a few KITTI frames: its page shows its frames, and its sets are data sets and protocols."""

import importlib.util
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "experiments" / "kitti_frames"
spec = importlib.util.spec_from_file_location("kitti_frames", FOLDER / "run.py")
study = importlib.util.module_from_spec(spec)
spec.loader.exec_module(study)


def test_the_page_shows_the_stored_frames() -> None:
    rows = list(study.read_table(study.STORED, study.COLUMNS))
    assert (FOLDER / "results.md").read_text() == study.page(rows)
    for name in study.SETS:
        frames: dict[tuple[str, str], list[str]] = {}
        for row in rows:
            if row["set"] == name:
                frames.setdefault((row["weights"], row["scale"]), []).append(row["frame"])
        assert len(set(map(tuple, frames.values()))) == 1, "all weights have the same frames"
        assert {scale for _, scale in frames} == set(study.SCALES)

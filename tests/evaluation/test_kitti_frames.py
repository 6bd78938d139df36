"""The study of a few KITTI frames: its page shows its frames, and its sets are data sets and protocols."""

import importlib.util
from pathlib import Path

import pytest
from support.layouts import real_folder
from torch import nn

from eldenet.compose import compose
from eldenet.evaluate import EvaluateSettings
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import chosen_protocol

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


def protocol_of(*words: str) -> EvalProtocol:
    s = compose(EvaluateSettings, ["checkpoint=none", *words])
    return chosen_protocol(s.data, s.protocol)


@pytest.mark.parametrize("name", study.SETS)
def test_a_set_counts_the_pixels_in_gargs_crop_in_meters(name: str) -> None:
    words = [word.format(root="/data") for word in study.SETS[name].overrides]
    protocol = protocol_of(*words)
    garg = protocol_of("data=kitti", "protocol=kitti_eigen_garg_raw")
    assert protocol.crop_fractions == garg.crop_fractions
    assert (protocol.scale, protocol.max_depth) == ("metric", 80)


class Flat(nn.Module):
    """20 m everywhere."""

    def forward(self, image):
        return image.new_full((len(image), 1, 2, 2), 20.0)


def test_official_frames_are_scored_both_ways() -> None:
    real_folder("kitti/depth", "train")
    found = {scale: study.score(Flat(), study.SETS["devkit"], (96, 320), scale) for scale in study.SCALES}
    assert [row[0] for row in found["metric"]] == [row[0] for row in found["median"]]
    assert len(found["metric"]) == 2
    assert float(found["median"][0][1]) < 1
    assert found["metric"] != found["median"]

"""Average precision of detectors beside table 4: by hand, and the stored table."""

import csv
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from eldenet.boxes import Detections2D

FOLDER = Path(__file__).resolve().parents[2] / "experiments" / "table4_centres"


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(FOLDER))
    try:
        spec = importlib.util.spec_from_file_location("table4_detectors", FOLDER / "detectors.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(FOLDER))
    return module


def frame(study, boxes, counts):
    names = np.array([name for name, _ in boxes], object)
    xyxy = np.array([box for _, box in boxes], float).reshape(-1, 4)
    return study.Frame(np.zeros((100, 300, 3), np.uint8), xyxy, names, np.array(counts, bool), 20.0)


def found(boxes, scores):
    return Detections2D(
        np.array(boxes, float), np.array(scores), np.zeros(len(boxes), np.int64), ("car", "person")
    )


def test_average_precision_by_hand(study):
    """Right, wrong, right of three: precision 1 at a third, 2/3 at two thirds of the recall."""
    labeled = frame(
        study,
        [("car", [0, 0, 40, 40]), ("van", [100, 0, 140, 40]), ("truck", [200, 0, 240, 40])],
        [True, True, True],
    )
    guess = found([[100, 0, 140, 40], [50, 50, 90, 90], [0, 0, 40, 38]], [0.5, 0.8, 0.9])
    matches = study.match(labeled, guess, "vehicles")
    assert matches.right.tolist() == [True, False, True]
    assert study.average_precision([matches]) == pytest.approx(100 * (1 + 2 / 3) / 3)
    assert study.figures([matches])[0] == "3"
    assert study.figures([matches])[-2:] == ["2", "1"]
    nothing = study.match(labeled, found(np.zeros((0, 4)), []), "vehicles")
    assert study.average_precision([nothing]) == 0
    assert np.isnan(study.average_precision([study.match(labeled, guess, "cyclists")]))


def test_what_does_not_count_is_neither_found_nor_missed(study):
    labeled = frame(
        study,
        [("car", [0, 0, 40, 40]), ("car", [60, 0, 100, 40]), ("dontcare", [110, 0, 300, 60])],
        [True, False, False],
    )
    on_hidden, unlabeled, small = [60, 0, 100, 40], [200, 5, 240, 45], [0, 80, 40, 95]
    twice = [1, 0, 40, 40]
    matches = study.match(
        labeled,
        found([on_hidden, unlabeled, small, [0, 0, 40, 40], twice], [0.9, 0.8, 0.7, 0.6, 0.5]),
        "vehicles",
    )
    assert matches.objects == 1
    assert matches.score.tolist() == [0.6, 0.5]
    assert matches.right.tolist() == [True, False]  # an object is found once


def test_the_stored_table_shows_the_stored_figures(study, tmp_path):
    with (FOLDER / "detectors.csv").open(newline="") as lines:
        rows = list(csv.reader(lines))[1:]
    study.write(tmp_path, rows)
    assert (tmp_path / "detectors.csv").read_text() == (FOLDER / "detectors.csv").read_text()
    shown, made = (
        [line for line in (folder / "detectors.md").read_text().splitlines() if line.startswith("| ")]
        for folder in (FOLDER, tmp_path)
    )
    assert shown == made

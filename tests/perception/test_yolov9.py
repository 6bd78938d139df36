"""Average precision of the trained YOLOv9: by hand, and the stored tables."""

import csv
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from eldenet.boxes import Detections2D

FOLDER = Path(__file__).resolve().parents[2] / "experiments" / "yolov9"
_SPEC = importlib.util.spec_from_file_location("yolov9", FOLDER / "run.py")
study = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(study)


def frame(boxes, counts):
    names = np.array([name for name, _ in boxes], object)
    xyxy = np.array([box for _, box in boxes], float).reshape(-1, 4)
    return study.Frame(np.zeros((100, 300, 3), np.uint8), xyxy, names, np.array(counts, bool), 20.0)


def found(boxes, scores):
    return Detections2D(
        np.array(boxes, float), np.array(scores), np.zeros(len(boxes), np.int64), ("car", "person")
    )


def test_average_precision_by_hand():
    """Right, wrong, right of three: precision 1 at a third, 2/3 at two thirds of the recall."""
    labeled = frame(
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


def test_what_does_not_count_is_neither_found_nor_missed():
    labeled = frame(
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


def test_the_stored_table_shows_the_stored_figures(tmp_path):
    with (FOLDER / "figures.csv").open(newline="") as lines:
        rows = list(csv.reader(lines))[1:]
    study.write(tmp_path, rows)
    assert (tmp_path / "figures.csv").read_text() == (FOLDER / "figures.csv").read_text()
    shown, made = (
        [line for line in (folder / "results.md").read_text().splitlines() if line.startswith("| ")]
        for folder in (FOLDER, tmp_path)
    )
    assert shown == made

"""Damaged or forged records end in one error that names the file; never in a traceback or a wrong table."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.stored_study import figures, record_of, write_plan

from eldenet.results.paired_intervals import per_image
from eldenet.results.report_table import report_runs
from eldenet.system.files import write_json


def changed(record: dict, path: tuple, value: Any, *, remove: bool = False) -> dict:
    record = copy.deepcopy(record)
    node = record
    for part in path[:-1]:
        node = node[part]
    if remove:
        del node[path[-1]]
    else:
        node[path[-1]] = value
    return record


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """``run.json`` of a training."""
    (tmp_path / "run").mkdir()
    file = tmp_path / "run/run.json"
    write_json(file, record_of(write_plan(tmp_path), "small", 0, figures(0.0, 0)))
    return file


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("metrics", "delta1"), 7),
        (("metrics", "rmse"), -5),
        (("metrics", "rmse"), 1e999),
        (("metrics", "ssim"), -2),
        (("cost", "params"), -1),
        (("cost", "params"), 10**400),
        (("cost", "latency_ms_p50"), float("nan")),
        (("constant_predictor",), [1]),
        (("protocol", "min_depth"), "x"),
        (("protocol", "crop"), [1]),
    ],
)
def test_figures_that_cannot_be_are_refused_with_the_files_name(run, path, value, tmp_path):
    record = changed(json.loads(run.read_text()), path, value)
    run.write_text(json.dumps(record))
    with pytest.raises(ValueError, match=r"run/run\.json"):
        report_runs([str(run)], tmp_path / "out")
    assert not (tmp_path / "out.md").exists()


def test_a_record_that_lacks_an_entry_is_named(run, tmp_path):
    whole = json.loads(run.read_text())
    for name in ("model", "data", "split_hash", "protocol", "metrics", "cost", "hardware"):
        run.write_text(json.dumps(changed(whole, (name,), None, remove=True)))
        with pytest.raises(ValueError, match=rf"run\.json has no {name}"):
            report_runs([str(run)], tmp_path / "out")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({}, "small has no delta1 of each of its images"),
        ({"name": ["a", "b"], "delta1": [0.5]}, "small has no delta1 of each of its images"),
        ({"name": ["a"], "delta1": ["x"]}, "small has no delta1 of each of its images"),
        ({"name": ["a"], "delta1": [7]}, "small has no delta1 of each of its images"),
    ],
)
def test_images_without_their_metric_are_named(columns, words):
    with pytest.raises(ValueError, match=words):
        per_image({"small": {"per_image": columns}}, "delta1")
    whole = {"per_image": {"name": ["a", "b"], "delta1": [None, 0.5]}}  # an image without known pixels
    assert np.isnan(per_image({"small": whole}, "delta1").values[0, 0])

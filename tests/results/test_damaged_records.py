"""Damaged or forged records end in one error that names the file; never in a traceback or a wrong table."""

import copy
import json
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.stored_study import figures, record_of, store, write_plan

from eldenet.deploy.benchmarking.rows import ROWS_FILE, read_rows
from eldenet.results.comparison import NEEDED_FOR_COSTS, find_runs, report_runs
from eldenet.results.packed_runs import RUNS, read_records
from eldenet.results.paired_intervals import per_image
from eldenet.results.run_record import read_record
from eldenet.system.files import write_json

RNG = random.Random(0)


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


def attempt(action: Callable[[], object]) -> bool:
    """Whether an action worked; an error that is no user's mistake fails the test."""
    try:
        action()
    except (ValueError, FileNotFoundError):
        return False
    return True


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """``run.json`` of a training."""
    (tmp_path / "run").mkdir()
    file = tmp_path / "run/run.json"
    write_json(file, record_of(write_plan(tmp_path), "small", 0, figures(0.0, 0)))
    return file


def damaged(content: bytes, count: int) -> list[bytes]:
    """Copies with one bit flipped, and copies cut short."""
    found = []
    for _ in range(count):
        place = RNG.randrange(len(content))
        found.append(content[:place] + bytes([content[place] ^ 1 << RNG.randrange(8)]) + content[place + 1 :])
    return found + [content[: RNG.randrange(len(content))] for _ in range(count // 2)]


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


def test_flips_and_cuts_of_a_record_are_no_tracebacks(run):
    for content in damaged(run.read_bytes(), 20):
        run.write_bytes(content)
        attempt(lambda: find_runs([str(run)], NEEDED_FOR_COSTS))


def test_flips_and_cuts_of_packed_runs_are_seen(tmp_path):
    study = write_plan(tmp_path)
    store(study, "small", 0, figures(0.0, 0))
    file = tmp_path / RUNS
    whole, record = file.read_bytes(), read_records(file)
    for content in damaged(whole, 40):
        file.write_bytes(content)
        if attempt(lambda: read_records(file)):
            assert read_records(file) == record  # a flip in the header changes nothing


@pytest.mark.parametrize(
    "content", [b"\xff\xfe", b"[" * 100_000, b'{"a": ' + b"9" * 9999 + b"}", b'{"a": NaN}', b"[]"]
)
def test_a_record_that_is_no_json_object_is_named(tmp_path, content):
    (tmp_path / "run.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.json is (not|truncated or not a valid (JSON|text) file)"):
        read_record(tmp_path / "run.json")


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


ROW = {
    **{"model": "a", "height": 32, "width": 48, "batch": 1, "runtime": "torch", "precision": "fp32"},
    **{"threads": 1, "device": "cpu", "key": ["a", 32, 48, 1, "torch", "fp32", 1, "cpu"], "failed": None},
    **{"command": "benchmark.py", "date": "2026", "processor": "some", "versions": {"torch": "2"}},
    **dict.fromkeys(("params", "gmacs", "latency_ms_p50", "latency_ms_p95", "gflops", "fps"), 1.0),
    **dict.fromkeys(("throughput_img_s", "peak_memory_mb", "file_mb", "gflops_per_s", "share_of_peak"), 1.0),
    "ratio_latency": None,
}


def test_damaged_rows_of_a_benchmark_are_measured_again(tmp_path: Path):
    file = tmp_path / ROWS_FILE
    good = json.dumps(ROW)
    for line in ("[1]", "5", "null", '"x"', "{}", '{"model": "m"}', '{"key": 7}'):
        file.write_text(f"{good}\n{good[:40]}\n{line}\n")  # a kill cut the second line
        assert list(read_rows(tmp_path)) == [tuple(ROW["key"])]
    for name in ROW:
        file.write_text(json.dumps(changed(ROW, (name,), None, remove=True)))
        assert read_rows(tmp_path) == {}
    for name in ("height", "params", "latency_ms_p50"):
        file.write_text(json.dumps(changed(ROW, (name,), -1)))
        assert read_rows(tmp_path) == {}
    file.write_bytes(good.encode()[:40] + b"\n\xff\xfe\n" + good.encode() + b"\n")  # a kill, and a bad disk
    assert list(read_rows(tmp_path).values()) == [ROW]
    for content in damaged(f"{good}\n{good}\n".encode(), 30):
        file.write_bytes(content)
        attempt(lambda: read_rows(tmp_path))

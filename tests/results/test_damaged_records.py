"""Damaged or forged records end in one error that names the file; never in a traceback or a wrong table."""

import copy
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.stored_study import figures, store, write_plan

from eldenet.deploy.benchmarking.rows import ROWS_FILE, read_rows
from eldenet.results.comparison import NEEDED_FOR_COSTS, ReportSetup, find_runs, report_runs
from eldenet.results.run_record import read_record
from eldenet.results.statistics import per_image
from eldenet.results.studies.tables import build_blocks

ODD: list[Any] = [None, True, -1, 7, 1e300, 10**400, "", "x", [], [None], {}, {"x": []}]
RNG = random.Random(0)


def places(node: Any, path: tuple = ()) -> list[tuple]:
    """The path of every entry but those of the config, which only the plan is compared with."""
    if isinstance(node, dict):
        return [path] * bool(path) + [
            place for key, value in node.items() if key != "config" for place in places(value, (*path, key))
        ]
    return [path]


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
def stored(tmp_path):
    study = write_plan(tmp_path, "[0, 1, 2]", "[0]")
    return study, store(study, "small", 0, figures(0.0, 0)), store(study, "large", 0, figures(0.1, 1))


def attempt(action) -> bool:
    """Whether an action worked; an error that is no user's mistake fails the test."""
    try:
        action()
    except (ValueError, FileNotFoundError):
        return False
    return True


def test_wrong_types_and_missing_entries_are_errors(stored, tmp_path):
    """A table that comes out all the same shows what the record says."""
    folder = stored[1]
    file, out = folder / "run.json", tmp_path / "out" / "table"
    out.parent.mkdir()
    whole = json.loads(file.read_text())
    setup = ReportSetup(runs=[str(folder)], output=out)
    assert attempt(lambda: report_runs(setup))
    refused = 0
    for path in places(whole):
        for value in RNG.sample(ODD, 4):
            file.write_text(json.dumps(changed(whole, path, value)))
            refused += not attempt(lambda: report_runs(setup))
        file.write_text(json.dumps(changed(whole, path, None, remove=True)))
        refused += not attempt(lambda: report_runs(setup))
    assert refused > 150


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("metrics", "delta1"), 7),
        (("metrics", "rmse"), -5),
        (("metrics", "rmse"), 1e999),
        (("metrics", "ssim"), -2),
        (("metrics", "abs_rel"), "0.1"),
        (("metrics", "images"), 1.5),
        (("cost", "params"), -1),
        (("cost", "params"), 10**400),
        (("cost", "latency_ms_p50"), float("nan")),
        (("constant_predictor",), [1]),
        (("protocol", "min_depth"), "x"),
        (("protocol", "crop"), [1]),
        (("seed",), "1"),
        (("model",), ["x"]),
    ],
)
def test_figures_that_cannot_be_are_refused_with_the_files_name(stored, path, value, tmp_path):
    file = stored[1] / "run.json"
    file.write_text(json.dumps(changed(json.loads(file.read_text()), path, value)))
    for action in (
        lambda: report_runs(ReportSetup(runs=[str(file)], output=tmp_path / "out")),
        lambda: build_blocks(stored[0]),
    ):
        with pytest.raises(ValueError, match=r"small/seed0/run\.json"):
            action()
    assert not (tmp_path / "out.md").exists()


def damaged(content: bytes, count: int) -> list[bytes]:
    """Copies with one bit flipped, and copies cut short."""
    found = []
    for _ in range(count):
        place = RNG.randrange(len(content))
        found.append(content[:place] + bytes([content[place] ^ 1 << RNG.randrange(8)]) + content[place + 1 :])
    return found + [content[: RNG.randrange(len(content))] for _ in range(count // 2)]


def test_flips_and_cuts_of_a_stored_run_are_no_tracebacks(stored):
    folder = stored[1]
    for content in damaged((folder / "run.json").read_bytes(), 20):
        (folder / "run.json").write_bytes(content)
        attempt(lambda: find_runs([str(folder)], NEEDED_FOR_COSTS))
    for content in damaged((folder / "per_image.csv").read_bytes(), 40):
        (folder / "per_image.csv").write_bytes(content)
        attempt(lambda: per_image([folder / "per_image.csv"], "delta1"))


@pytest.mark.parametrize(
    "content", [b"\xff\xfe", b"[" * 100_000, b'{"a": ' + b"9" * 9999 + b"}", b'{"a": NaN}', b"[]"]
)
def test_a_record_that_is_no_json_object_is_named(tmp_path, content):
    (tmp_path / "run.json").write_bytes(content)
    with pytest.raises(ValueError, match=r"run\.json (is not|can't be read as JSON)"):
        read_record(tmp_path / "run.json")


@pytest.mark.parametrize(
    "text",
    [
        *("", "name\na\n", "name,delta1\na\n", "name,delta1\na,x\n", "name,delta1\na,7\n"),
        *("name,delta1\na,0.5\na,0.5\n", 'name,delta1\n"a,0.5\n', "name,delta1\na,0.5,6\n"),
        *("name,delta1\na,inf\n", "name,delta1\n\xff\n"),
    ],
)
def test_a_damaged_per_image_file_is_named(tmp_path, text):
    file = tmp_path / "per_image.csv"
    file.write_bytes(text.encode("latin1"))
    with pytest.raises(ValueError, match=r"per_image\.csv"):
        per_image([file], "delta1")
    file.write_text("name,delta1\na,nan\nb,0.5\n")  # an image without known pixels
    assert np.isnan(per_image([file], "delta1").values[0, 0])


ROW = {
    **{"model": "a", "height": 32, "width": 48, "batch": 1, "runtime": "torch", "precision": "fp32"},
    **{"threads": 1, "device": "cpu", "key": ["a", 32, 48, 1, "torch", "fp32", 1, "cpu"], "failed": None},
    **{"command": "benchmark.py", "date": "2026", "processor": "some", "versions": {"torch": "2"}},
    **dict.fromkeys(("params", "gmacs", "latency_ms_p50", "latency_ms_p95", "gflops", "fps"), 1.0),
    **dict.fromkeys(("throughput_img_s", "peak_memory_mb", "file_mb", "gflops_per_s", "share_of_peak"), 1.0),
    "ratio_latency": None,
}


def test_damaged_rows_of_a_benchmark_are_named_or_measured_again(tmp_path: Path):
    file = tmp_path / ROWS_FILE
    good = json.dumps(ROW)
    for line in ("[1]", "5", "null", '"x"', "{}", '{"model": "m"}', '{"key": 7}'):
        file.write_text(f"{good}\n{good[:40]}\n{line}\n")  # a kill cut the second line
        with pytest.raises(ValueError, match=r"rows\.jsonl, line 3 \(remove that line"):
            read_rows(tmp_path)
    for path in [(name,) for name in ROW]:
        for value in (-1, [{}]) if path[0] in ("height", "params") else ([{}],):
            file.write_text(json.dumps(changed(ROW, path, value)))
            with pytest.raises(ValueError, match=r"rows\.jsonl, line 1"):
                read_rows(tmp_path)
    file.write_bytes(good.encode()[:40] + b"\n\xff\xfe\n" + good.encode() + b"\n")  # a kill, and a bad disk
    assert list(read_rows(tmp_path).values()) == [ROW]
    for content in damaged(f"{good}\n{good}\n".encode(), 30):
        file.write_bytes(content)
        attempt(lambda: read_rows(tmp_path))

"""A change of weights counts only where the whole interval says so."""

import copy

import numpy as np
import pytest

import eldenet
from eldenet.results.before_after import compare, record_change, say_changes
from eldenet.results.run_log import RunLog

HARD = np.linspace(0.1, 1.0, 40)  # errors differ more between frames than between networks


@pytest.mark.parametrize(("metric", "sign"), [("abs_rel", -1), ("scale_error", -1), ("delta1", 1)])
def test_a_small_steady_gain_is_better_and_its_opposite_is_not(metric, sign):
    gain = sign * np.random.default_rng(0).uniform(0.01, 0.03, 40)
    assert compare(metric, HARD, HARD + gain).is_better
    assert not compare(metric, HARD, HARD - gain).is_better
    assert not compare(metric, HARD, HARD).is_better


def test_a_gain_in_one_stretch_of_time_alone_is_not_sure():
    gain = np.where(np.arange(40) < 8, -0.05, 0.001)
    assert gain.mean() < -0.005
    assert not compare("abs_rel", HARD, HARD + gain).is_better


def test_chance_is_not_better():
    noise = np.random.default_rng(1).normal(0, 0.05, 40)
    assert not compare("abs_rel", HARD, HARD + noise - noise.mean() - 0.001).is_better


def test_frames_without_a_value_do_not_count():
    before = np.where(np.arange(40) < 10, np.nan, HARD)
    change = compare("abs_rel", before, HARD - 0.02)
    assert change.frames == 30
    assert change.after - change.before == pytest.approx(-0.02)


def test_the_table_fits_a_terminal(tmp_path, capsys):
    metrics = ("abs_rel", "rmse", "delta1", "scale_error")
    say_changes(RunLog(tmp_path), "title", {m: compare(m, 10 * HARD, 9 * HARD) for m in metrics})
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    for word in ("AbsRel ↓", "RMSE [m] ↓", "δ1 ↑", "error of scale ↓", "95 % interval"):
        assert any(word in line for line in lines)


@pytest.mark.parametrize("gain", [0.02, -0.02])
def test_changed_weights_do_not_state_the_scores_of_the_start(tmp_path, gain):
    start = eldenet.load("eldenet_s")
    start.info = {"test": {"delta1": 0.987, "protocol": "nyu_eigen"}}
    folder = str(start.save_pretrained(tmp_path / "start"))
    changes = {"abs_rel": compare("abs_rel", HARD, HARD - gain)}
    kept = record_change(
        tmp_path,
        RunLog(tmp_path),
        start,
        copy.deepcopy(start),
        changes,
        folder,
        {"config": {"intrinsics": None}},
    )
    assert kept is (gain > 0)
    card = (tmp_path / "model/README.md").read_text()
    assert ("0.987" in card) is not kept
    assert ("adapted from" in card) is kept

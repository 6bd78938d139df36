"""Tables 5 and 6: methods and sensors against each other on the same worlds."""

import sys

import pytest
from support.table5 import FOLDER

from eldenet.navigation.evaluation import Episode


def episodes(solved: list[bool], seconds: float = 10.0) -> list[Episode]:
    return [Episode(f"w{k}", 5, "success" if ok else "timeout", seconds + k, 9.0, 8.0)
            for k, ok in enumerate(solved)]  # fmt: skip


def test_a_sensor_s_loss_is_tested_in_pairs(study):
    comparisons = study("comparisons")
    true, seen = [True] * 90 + [False] * 10, [True] * 80 + [False] * 15 + [True] * 5
    tables = {
        ("wheels", "ranges", "dqn", "5"): [episodes([True] * 100)],
        ("wheels", "ranges", "dqn_mixed", "5"): [episodes(true)],
        ("wheels", "noisy", "dqn_mixed", "5"): [episodes(seen)],
    }
    lines = comparisons.loss(tables, "wheels", "noisy")
    own, default = (line.split(" | ") for line in lines[2:])
    assert own[1:3] == ["dqn_mixed", "5"]
    assert own[3].startswith("5.0 [")
    assert own[4:6] == ["10", "5"]
    assert default[1] == "dqn"
    assert default[3].startswith("15.0 [")
    # the paired interval, against the normal one of the differences
    low, high = (float(value) for value in own[3][len("5.0 [") : -1].split(", "))
    half = 1.96 * 100 * ((0.15 - 0.05**2) / 100) ** 0.5
    assert (low, high) == pytest.approx((5 - half, 5 + half), abs=1.1)
    assert comparisons.loss(tables, "wheels", "ranges") == []


def test_time_is_compared_over_all_trainings_in_pairs(study, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER.parent / "table6_time"))
    sys.modules.pop("run", None)
    run = study("run")
    ok = [True] * 40
    made = {
        "astar_dwa": [episodes(ok)],
        "dqn": [episodes(ok, 11.0), episodes([True] * 39 + [False], 13.0)],
    }
    ratio, low, high, both = run.ratio_to_reference(made, "dqn")
    first = sum(11 + k for k in range(40)) / sum(10 + k for k in range(40))
    second = sum(13 + k for k in range(39)) / sum(10 + k for k in range(39))
    assert ratio == pytest.approx((first + second) / 2)
    assert low < ratio < high
    assert high - low < 0.03  # far less than that of times unpaired
    assert both == 39
    assert run.ratio_to_reference(made, "astar_dwa")[:3] == (1.0, 1.0, 1.0)
    assert run.cell(float("nan"), float("nan"), 0.0, 0.0) == "-"


def test_paired_tests_agree_with_scipy(study):
    from scipy.stats import binomtest

    mcnemar = study("episodes").mcnemar
    a = [True] * 60 + [False] * 40
    b = [True] * 50 + [False] * 10 + [True] * 2 + [False] * 38
    first, second, p = mcnemar(a, b)
    assert (first, second) == (10, 2)
    assert p == pytest.approx(binomtest(10, 12).pvalue)
    assert mcnemar(a, a) == (0, 0, 1.0)


def test_times_are_compared_on_arenas_that_all_methods_solved(study):
    def table(*outcomes):
        return [Episode(f"w{k}", 5, outcome, 10.0, 10.0, 9.0) for k, outcome in enumerate(outcomes)]

    solved_by_all = study("episodes").solved_by_all
    both = solved_by_all([table("success", "success", "timeout"), table("success", "collision", "success")])
    assert both.tolist() == [True, False, False]
    with pytest.raises(ValueError, match="different arenas"):
        solved_by_all([table("success"), table("success", "success")])

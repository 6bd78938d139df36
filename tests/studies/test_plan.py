"""Plans of studies: errors in one are named, and every row of the repository's studies composes."""

from pathlib import Path

import pytest
from support.stored_study import settings_of
from support.tiny_study import EXPECTED, short

from eldenet.studies.plan import read_study
from eldenet.studies.tables import read_expected
from eldenet.weights import list_models

SCORES_TRIALS = {"rooms": "val", "kitti": "val", "cityscapes": "official_val"}
REPOSITORY = Path(__file__).resolve().parents[2]
STUDIES = sorted(path.parent for path in (REPOSITORY / "experiments").glob("*/sweep.yaml"))


def test_errors_in_a_plan_are_named(tiny, tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no sweep\.yaml"):
        read_study(tmp_path)
    with pytest.raises(ValueError, match=r"rows=\['none'\].*eldenet_s"):
        read_study(tiny).chosen(["none"])
    whole = (tiny / "sweep.yaml").read_text()
    for old, new, word in (
        ("seeds: [0, 1]}", "sead: 1}", "sead"),
        ("columns: [rmse, delta1]", "columns: [rsme]", "rsme"),
        ("reference: [eldenet_s]", "reference: [eldenet_m]", "eldenet_m"),
        ("reference: [eldenet_s]", "reference: eldenet_s", "a list of values, each a text"),
        *(("seeds: [0, 1]}", f"seeds: {seeds}}}", "a list of values") for seeds in ("1", "[a]")),
        ("seeds: [0, 1]}", "seeds: [0, 0]}", "different seeds"),
        ("overrides: [model=eldenet],", "overrides: model=eldenet,", "a list of values, each a text"),
        ("plots: [pareto]", "plots: [parreto]", "choose from pareto, differences"),
        ("learning_rate: 1.0e-3}", "learning_rate: fast}", "learning_rate=fast: give a number"),
        ("learning_rates: [1.0e-4, 1.0e-3]", "learning_rates: 1.0e-3", "a list of values, each a number"),
        (
            "eldenet: {overrides: [model=eldenet], learning_rate: 1.0e-3}",
            "eldenet: {from: tiny}",
            "refers to itself: tiny -> tiny",
        ),
        ("reference: [eldenet_s]", "reference:", "reference=None: give a list"),
    ):
        (tiny / "sweep.yaml").write_text(whole.replace(old, new))
        with pytest.raises(ValueError, match=word):
            read_study(tiny)
    other = tmp_path / "other"
    other.mkdir()
    for row, word in (
        ("eldenet: {from: tiny, seeds: [1]}", "row eldenet, taken from another study: it may have a block"),
        ("unknown: {from: tiny}", "has the rows eldenet_s, wrong"),
    ):
        (tiny / "sweep.yaml").write_text(whole)
        (other / "sweep.yaml").write_text(f"rows: {{{row}}}")
        with pytest.raises(ValueError, match=word):
            read_study(other)
    (other / "sweep.yaml").write_text("rows: {eldenet: {from: tiny}}")
    (tiny / "sweep.yaml").write_text("rows: {eldenet: {from: other}}")
    with pytest.raises(ValueError, match="refers to itself: tiny -> other -> tiny"):
        read_study(tiny)
    (tiny / "expected.csv").write_text(EXPECTED.replace(",a paper", ","))
    with pytest.raises(ValueError, match="no protocol or source"):
        read_expected(tiny)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        (
            "[model=eldenet_s], seeds",
            "[model=eldenet_s, optimizer.lr=2.0e-3], seeds",
            "search of learning_rates",
        ),
        (
            "[model=eldenet], learning",
            "[model=eldenet, ++optimizer.lr=2.0e-3], learning",
            "learning_rate: 0.001",
        ),
        ("  - trainer.epochs=1", "  - optimizer.lr=2.0e-3", "row eldenet_s"),
        ("  - data.subset_seed=0", "  - optimizer.lr=2.0e-3", "search of learning_rates"),
    ],
)
def test_a_learning_rate_that_would_have_no_effect_is_refused(tiny, old, new, word):
    whole = (tiny / "sweep.yaml").read_text()
    assert old in whole
    (tiny / "sweep.yaml").write_text(whole.replace(old, new, 1))
    with pytest.raises(ValueError, match=rf"{word}.*optimizer\.lr=2.*write learning_rate: 2\.0e-3"):
        read_study(tiny)


def test_a_learning_rate_among_overrides_counts_where_none_is_searched(tiny):
    plan = short((tiny / "sweep.yaml").read_text())
    (tiny / "sweep.yaml").write_text(
        plan.replace("[model=eldenet_s],", "[model=eldenet_s, optimizer.lr=2.0e-3],")
    )
    row = read_study(tiny).chosen("eldenet_s")[0]
    assert "optimizer.lr=2.0e-3" in row.overrides


def test_a_row_with_other_weights_does_not_state_what_they_have_seen(tiny):
    whole = short((tiny / "sweep.yaml").read_text())
    (tiny / "sweep.yaml").write_text(whole.replace("model=eldenet_s]", "model=eldenet_s, weights=a]"))
    seen = {row.name: row.seen for row in read_study(tiny).rows}
    assert (seen["eldenet_s"], seen["eldenet"]) == ("not stated", "the training frames alone")


@pytest.mark.slow
@pytest.mark.parametrize("folder", STUDIES, ids=lambda folder: folder.name)
def test_every_row_of_every_study_composes(folder):
    study = read_study(folder)
    read_expected(folder)
    assert (folder / "README.md").is_file()
    known = list_models()
    for row in study.rows:
        overrides = study.overrides_of(row)
        network = next((text[6:] for text in overrides[::-1] if text.startswith("model=")), "eldenet")
        assert network in known, f"{row.name}: no network {network}"
        tried = study.searches_rate(row)
        config = settings_of(study.overrides_of(row, trial=tried), row.name)
        assert (config["model_name"], config["ckpt_path"], config["seed"]) == (row.name, "auto", 0)
        assert config["model"]["_target_"].startswith("eldenet.")
        data = config["data"]
        splits = {name: data[name].get("split") for name in ("train", "val", "test")}  # a mix has none
        if tried and data["name"] in SCORES_TRIALS:  # on a split of its own: other rooms, drives, cities
            split = SCORES_TRIALS[data["name"]]
            assert splits["test"] == splits["val"] == split != splits["train"]
            reported = settings_of(overrides, row.name)["data"]
            assert reported["test"]["split"] not in (split, reported["train"]["split"])
        elif tried:  # on training frames that neither the trial trains on nor the table reports
            assert set(splits.values()) == {"train"}
            assert data["subset"]["train"][1] <= data["subset"]["test"][0]

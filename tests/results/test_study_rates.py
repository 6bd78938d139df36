"""The learning rate of a row: by one rule for every network, and told when another one chose it."""

import json
from pathlib import Path
from typing import Any

import pytest

from eldenet import config as cfg
from eldenet.results.studies import rates
from eldenet.results.studies.plan import Study, read_study

PLAN = """
overrides: [data=rooms]
learning_rates: [3.0e-4, 1.0e-3, 3.0e-3]
rate_overrides: [trainer.epochs=1]
rows:
  small: {overrides: [model=eldenet_s]}
  taught: {overrides: [model=eldenet_s, loss=ssim_l1_distill], given: {teacher: teacher}}
"""


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "sweep.yaml").write_text(PLAN)
    return read_study(tmp_path)


@pytest.fixture
def trials(monkeypatch: pytest.MonkeyPatch):
    """Answer trials from a curve of delta1 over the rate; they are noted as (rate, epochs)."""

    def install(curve: dict[float, float | None]) -> list[tuple[float, int]]:
        tried: list[tuple[float, int]] = []

        def train(config: Any, folder: Path) -> float:
            tried.append((config.optimizer.lr, config.trainer.epochs))
            score = curve[config.optimizer.lr]
            if score is None:
                raise FloatingPointError("diverged")
            folder.mkdir(parents=True, exist_ok=True)
            record = {"metrics": {"delta1": score, "images": 100}, "protocol": {"name": "p"}}
            record |= {"train_split_hash": "a", "split_hash": "b", "config": cfg.plain(config)}
            (folder / "run.json").write_text(json.dumps(record))
            return score

        monkeypatch.setattr(rates, "train", train)
        return tried

    return install


def choose(
    study: Study, runs: Path, name: str = "small", given: tuple[str, ...] = (), **options: bool
) -> float | None:
    (row,) = study.chosen(name)
    shared = [*study.overrides, *row.overrides, *given]
    return rates.learning_rate(study, row, shared, runs, lambda text: None, **options)


@pytest.mark.parametrize(
    ("curve", "tried", "best"),
    [
        ({3e-4: 0.4, 1e-3: 0.5, 3e-3: 0.3}, [3e-4, 1e-3, 3e-3], 1e-3),
        ({3e-4: 0.6, 1e-3: 0.5, 3e-3: 0.3, 1e-4: 0.5}, [3e-4, 1e-3, 3e-3, 1e-4], 3e-4),
        ({3e-4: 0.6, 1e-3: 0.5, 3e-3: 0.3, 1e-4: 0.7, 3e-5: 0.2}, [3e-4, 1e-3, 3e-3, 1e-4, 3e-5], 1e-4),
        ({3e-4: 0.1, 1e-3: 0.2, 3e-3: 0.3, 1e-2: 0.4, 3e-2: 0.5}, [3e-4, 1e-3, 3e-3, 1e-2, 3e-2], 3e-2),
        ({3e-4: 0.4, 1e-3: None, 3e-3: None, 1e-4: 0.3}, [3e-4, 1e-3, 3e-3, 1e-4], 3e-4),
    ],
)
def test_the_best_of_all_that_were_tried(study, trials, tmp_path, curve, tried, best) -> None:
    noted = trials(curve)
    assert choose(study, tmp_path / "runs") == best
    assert noted == [(rate, 1) for rate in tried]
    kept = json.loads((tmp_path / "stored" / "small" / "learning_rate.json").read_text())
    assert kept["learning_rate"] == best
    assert {float(rate): score for rate, score in kept["delta1"].items()} == curve
    assert choose(study, tmp_path / "elsewhere") == best
    assert len(noted) == len(tried)  # what is kept is not tried again


def test_all_diverged(study, trials, tmp_path) -> None:
    trials(dict.fromkeys((3e-4, 1e-3, 3e-3)))
    with pytest.raises(ValueError, match="diverged: give lower ones"):
        choose(study, tmp_path / "runs")


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("[3.0e-4, 1.0e-3, 3.0e-3]", "[1.0e-4, 1.0e-3]", "candidates"),
        ("trainer.epochs=1", "trainer.epochs=2", "trainer.epochs=2"),
        ("data=rooms", "data=rooms, augmentation=none", "augmentation.flip"),
    ],
)
def test_a_choice_by_another_rule_is_refused(study, trials, tmp_path, old, new, word) -> None:
    trials({3e-4: 0.4, 1e-3: 0.5, 3e-3: 0.3})
    choose(study, tmp_path / "runs")
    (tmp_path / "sweep.yaml").write_text(PLAN.replace(old, new))
    with pytest.raises(ValueError, match=rf"chosen by another rule \(.*{word}"):
        choose(read_study(tmp_path), tmp_path / "runs")


def test_what_was_given_counts_by_its_content(study, trials, tmp_path) -> None:
    noted = trials({3e-4: 0.4, 1e-3: 0.5, 3e-3: 0.3})
    for name, content in (("a", b"1"), ("b", b"1"), ("c", b"2")):
        (tmp_path / name).write_bytes(content)
    give = lambda name: (f"teacher='{tmp_path / name}'",)  # noqa: E731
    assert choose(study, tmp_path / "runs", "taught", give("a")) == 1e-3
    assert choose(study, tmp_path / "runs", "taught", give("b")) == 1e-3
    with pytest.raises(ValueError, match=r"chosen by another rule .*teacher.*rerun=true"):
        choose(study, tmp_path / "runs", "taught", give("c"))
    assert choose(study, tmp_path / "runs", "taught", give("b"), rerun=True) == 1e-3
    assert len(noted) == 3  # a choice that stands is no trial again
    trials({3e-4: 0.6, 1e-3: 0.5, 3e-3: 0.3, 1e-4: 0.2})
    assert choose(study, tmp_path / "other", "taught", give("c"), rerun=True) == 3e-4
    assert choose(study, tmp_path / "other", "taught", give("c")) == 3e-4  # stored in its place


@pytest.mark.parametrize("place", ["{runs}/small/seed0", "{runs}/small/seed{seed}"])
def test_trials_wait_for_the_row_that_they_start_from(study, trials, tmp_path, place) -> None:
    """A run that is still trained has weights already, but not those that will be compared."""
    noted = trials({3e-4: 0.4, 1e-3: 0.5, 3e-3: 0.3})
    (tmp_path / "sweep.yaml").write_text(PLAN + f'  next: {{overrides: ["weights={place}"]}}\n')
    begun = tmp_path / "runs" / "small" / "seed0"
    (begun / "model").mkdir(parents=True)
    (begun / "model" / "model.safetensors").write_bytes(b"half")
    with pytest.raises(FileNotFoundError, match=r"next needs the weights of \S*small/seed0: run"):
        choose(read_study(tmp_path), tmp_path / "runs", "next")
    assert not noted
    (begun / "run.json").write_text("{}")
    assert choose(read_study(tmp_path), tmp_path / "runs", "next") == 1e-3

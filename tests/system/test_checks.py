"""A wrong value ends in one line that names the setting and what it takes, whatever the setting is."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from eldenet.compose import compose
from eldenet.configurable import check_arguments, instantiate
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.system.resources import choose_resources
from eldenet.train import TrainSettings


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ("seed=abc", "seed=abc: give a whole number"),
        ("seed=1e38", "seed=1e[+]?38: give a whole number"),
        ("process_timeout=abc", "process_timeout=abc: give a number"),
        ("optimizer.lr=abc", "optimizer.lr=abc: give a number"),
        ("optimizer.lr=null", "optimizer.lr=None: give a number"),
        ("trainer.epochs=-1", "epochs=-1: give a whole number, 1 or more"),
        ("trainer.epochs=abc", "trainer.epochs=abc: give a whole number"),
        ("trainer.batch_size=1e38", r"trainer.batch_size=1e\+38: give a whole number"),
        ("trainer.checkpoint_every=99999999999", "trainer.checkpoint_every=.*below 2\\^32"),
        ("trainer.max_grad_norm=abc", "trainer.max_grad_norm=abc: give a number or null"),
        ("loss.terms.l1.weight=abc", "loss.terms.l1.weight=abc: give a number"),
    ],
)
def test_a_wrong_value_of_a_training_is_named(tmp_path: Path, given: str, line: str) -> None:
    def build() -> None:
        s = compose(TrainSettings, [given, f"output={tmp_path}"])
        optimizer = instantiate(s.optimizer, "optimizer")
        instantiate(s.trainer, "trainer", optimizer=optimizer, scheduler=None)
        instantiate(s.loss, "loss")

    with pytest.raises(ValueError, match=line) as error:
        build()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("given", ["data.size=[-96,128]", "data.frames.val=-5", "data.size=[abc,128]"])
def test_wrong_sizes_and_counts_of_data_are_named(tmp_path: Path, given: str) -> None:
    s = compose(TrainSettings, [given, f"data.root={tmp_path}"])
    with pytest.raises(ValueError, match=r"data\.val\.(size|frames)=.*: give") as error:
        open_split(s.data, "val", chosen_protocol(s.data, s.protocol))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("given", [{"threads": "abc"}, {"threads": 0}, {"workers": -1}, {"threads": 1e38}])
def test_threads_and_workers_are_counts(given: dict) -> None:
    (name,) = given
    with pytest.raises(
        ValueError, match=rf"runtime\.{name}=.*: give a whole number from [01] to 1024, or auto"
    ):
        choose_resources(**given)


def test_what_the_annotation_allows_passes() -> None:
    def target(
        size: Sequence[int] | None, rate: float, pair: tuple[float, float], on: bool, any_value
    ) -> None:
        """Annotated as parts are."""

    good = {"size": [1, 2], "rate": 1, "pair": [0.1, 2], "on": True, "any_value": "x", "unknown": -1}
    check_arguments(target, good)
    check_arguments(target, good | {"size": None})
    for name, wrong in (("size", [0, 2]), ("rate", True), ("pair", [1.0]), ("on", "yes"), ("size", [1.5, 2])):
        with pytest.raises(ValueError, match=rf"part\.{name}="):
            check_arguments(target, good | {name: wrong}, "part.")

"""What people mistype most, and the line that each mistake gets: what was given, what is allowed, what to do.

In one process: only what runs no job.
"""

import importlib
import os
from pathlib import Path
from typing import Any

import pytest

from eldenet.cli.commands import module_of
from eldenet.cli.help import QUOTES, advice, comment_on, quote_paths, wrong_option
from eldenet.compose import compose, compose_config


def settings_of(command: str) -> Any:
    """Return the dataclass of a command."""
    name = f"{command.title().replace('-', '')}Settings"
    return getattr(importlib.import_module(module_of(command)), name)


def answer(line: str) -> str:
    """Return what a command answers, without running it; "" if it would start."""
    command, *words = line.split(" ")
    words, settings = quote_paths(words), settings_of(command)
    if said := advice(command.replace("-", "_"), words):
        return said
    try:
        compose(settings, [word for word in words if not word.startswith("-")])
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("line", "said"),
    [
        # a plus and a typo: the same as without the plus
        ("train +optimiser.lr=0.5", "there is no setting optimiser.lr: did you mean optimizer.lr?"),
        ("train ++optimizer.Lr=0.5", "there is no setting optimizer.Lr: did you mean optimizer.lr?"),
        ("train +trainer.epohcs=3", "there is no setting trainer.epohcs: did you mean trainer.epochs?"),
        ("train -m seed=1,2 +sede=1", "there is no setting sede: did you mean seed?"),
        ("train data=folder +data.max_dpeth=3", "data.max_dpeth: did you mean data.max_depth?"),
        ("train --config-dir . +trainer.epohcs=3", "did you mean trainer.epochs?"),
        ("train +optimizer.amsgrad=true", ""),  # its class takes it
        ("train +model.mean=[0,0,0] debug=fast", ""),
        ("train data=folder +data.train.csv=a.csv", ""),
        ("train data=streets +data.plain=0.5", "there is no setting data.plain"),  # rooms has it
        ("train data=kitti +data.resize_on_load=[3,4]", ""),
        ("train data=kitti_selection protocol=folder +data.ground_truth=improved", ""),  # the protocol asks
        ("study study=a +given.mine=/data", ""),
        ("train +debug=fast", "+debug=fast needs no plus: write debug=fast"),
        (
            "train +experiment=rooms_full +model=eldenet_s",
            "+model=eldenet_s needs no plus: write model=eldenet_s",
        ),
        # names
        ("train --config-dir . trainer.epohcs=1", "setting trainer.epohcs: did you mean trainer.epochs?"),
        ("train epoch=3", "there is no setting epoch: did you mean trainer.epochs?"),
        ("check-data root=a", "there is no setting root: did you mean data.root"),
        ("benchmark batch=0", "there is no setting batch: did you mean batches?"),
        ("train lr=1e-3", "there is no setting lr: did you mean optimizer.lr?"),
        ("train batch_size=8", "there is no setting batch_size: did you mean trainer.batch_size?"),
        ("train compile=true", "there is no setting compile: did you mean trainer.compile?"),
        ("train amp=true", "there is no setting amp: did you mean runtime.precision?"),
        ("train early_stopping=3", "there is no setting early_stopping: did you mean trainer.patience?"),
        ("train trainer.early_stopping=3", "trainer.early_stopping: did you mean trainer.patience?"),
        ("train -m data=kitti data.rot=/x", "there is no setting data.rot: did you mean data.root?"),
        ("predict sorce=x chekpoint=y", "there is no setting sorce: did you mean source?"),
        ("predict weights=eldenet_indoor", "there is no setting weights: did you mean checkpoint?"),
        ("predict image=a.jpg", "there is no setting image: did you mean source?"),
        ("predict qqqqqqqq=1", "there is no setting qqqqqqqq: --help lists all settings"),
        ("train model/backbne=x", "there is no setting model/backbne: did you mean model/backbone?"),
        ("train data.subst=5", "there is no setting data.subst: did you mean data.subset?"),
        # it exists, but not with data=mix
        ("train data=mix data.subset.train=5", "no setting data.subset.train: did you mean data.train?"),
        ("navigate mode=evaluate world=3", "there is no setting world: --help lists all settings"),
        # groups
        ("train data=nyu", "data=nyu: did you mean nyu_densedepth or nyu_hdf5 or nyu_labelled or nyu_mat or"),
        ("train optimizer=Adam", "optimizer=Adam: did you mean adam? choose from adam, adam_paper, adamw,"),
        ("train model=eldenet-s", "model=eldenet-s: did you mean eldenet_s?"),
        ("train protocol=3", "protocol=3: choose from arenas, "),
        ("train data=1", "data=1: choose from arenas, "),
        ("train model=null", "model=null: choose from eldenet, "),
        ("train debug=fst", "debug=fst: did you mean fast?"),
        ("train -m data=rooms,nyu", "data=nyu: did you mean"),
        ("train loss=l1 augmentation=ful", "augmentation=ful: did you mean full? choose from flip, full,"),
        # words that are no settings
        ("train data.input_size=[1,2", f"data.input_size=[1,2 cannot be read: {QUOTES}"),
        (f"predict {__file__}", f"{__file__} cannot be read: write source={__file__}"),
        (f"export {__file__}", f"{__file__} cannot be read: write checkpoint={__file__}"),
        (f"report {__file__}", f"{__file__} cannot be read: write runs={__file__}"),
        ("train trainer.epochs = 3", "trainer.epochs cannot be read: write trainer.epochs=value"),
        ("train =3", "=3 cannot be read: write setting=value, with the name of a setting"),
        ("train help", "help cannot be read: write setting=value (--help lists all settings)"),
        ("train data.input_size=(224,224)", "a list has square brackets, data.input_size=[224,224]"),
        # a section that nobody chose
        ("evaluate protocol.scale=median", "give protocol=... too, or data.protocol.scale=median"),
        # sweeps
        ("train seed=1..3", "seed=1..3: give a whole number; for several runs -m seed=1,2,3"),
        ("train -m seed=1-3", "seed=1-3: give a whole number; for several runs -m seed=1,2,3"),
        ("train seed=1,2", "seed=1,2: give one value, a list seed=[1,2], or -m seed=1,2 for a run of each"),
        # values
        ("train canonical_focal=518", "canonical_focal=518: give it in widths of the input, 0.1 to 10"),
        ("train process_timeout=-3", "process_timeout=-3: give seconds above 0"),
        ("adapt intrinsics=440", "intrinsics=440: give [fx, fy, cx, cy]"),
        ("adapt minutes=5min", "minutes=5min: give a number"),
        ("predict source=a focal=26mm", "focal=26mm: give a number or null"),
        ("predict source=a depth_range=10", "depth_range=10: give [near, far] in meters"),
        ("predict source=a input_size=640x480", "input_size='640x480': give [height, width] in pixels"),
        ("predict source=[a,b]", "source=[a,b]: give a text"),
        ("benchmark models=[eldenet] threads=0", "threads=0: give a list of whole numbers of 1 or more"),
        ("benchmark models=[eldenet] seconds=-1", "seconds=-1.0: give a time above 0"),
        ("navigate world=-3", "world=-3: give 0 or more"),
        ("benchmark models=[eldenet] runtimes=[onnx]", "runtimes='onnx': give one of torch, "),
        ("demo port=80000", "port=80000: give a number from 0 (any free port) to 65535"),
        # what is missing
        ("predict", "give source=... on the command line"),
    ],
)
def test_a_mistake_gets_a_line_that_helps(line: str, said: str) -> None:
    if said:
        assert said in answer(line)
    else:
        assert answer(line) == ""


@pytest.mark.parametrize(
    ("option", "line"),
    [
        ("--epochs=3", "--epochs=3: settings have no dashes, and there is no setting epochs: did you mean"),
        ("-epochs", "-epochs: settings have no dashes, and there is no setting epochs: did you mean"),
        ("--seed", "--seed: settings have no dashes, write seed=value"),
        ("--help-me", "unrecognized arguments: --help-me (--help shows what there is)"),
    ],
)
def test_an_option_that_is_a_setting_is_named_without_its_dashes(option: str, line: str) -> None:
    assert wrong_option("train", f"unrecognized arguments: {option} 3").startswith(line.partition(" (")[0])


def test_a_file_of_settings_that_is_no_yaml_is_named(tmp_path: Path) -> None:
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment/mine.yaml").write_text("a: [1\n")
    assert advice("train", ["--config-dir", str(tmp_path), "+experiment=mine"]) == ""  # Hydra names the file
    with pytest.raises(ValueError, match=r"no YAML: .*experiment/mine.yaml.*line 1") as error:
        compose_config("train", ["+experiment=mine"], [f"file://{tmp_path}"])
    assert "\n" not in str(error.value)


def test_settings_that_only_an_added_choice_has_are_known() -> None:
    assert advice("train", ["+experiment=indoor", "data.sources.rooms.weight=0.6"]) == ""
    line = advice("train", ["+experiment=indoor", "data.sources.roms.weight=0.6"])
    assert line.startswith("there is no setting data.sources.roms.weight: did you mean")


def test_a_plus_adds_a_part_beside_others() -> None:
    term = "{_target_: eldenet.losses.base.WeightedTerm, loss: {_target_: eldenet.losses.pointwise.L2Loss}}"
    assert advice("train", [f"+loss.terms.mine={term}"]) == ""
    assert advice("train", ["+loss.terms.mine.weight=2"]).startswith("there is no setting loss.terms.mine")
    for nowhere in ("losses", "data.mine", "trainer.mine"):
        assert advice("train", [f"+{nowhere}={term}"]).startswith(f"there is no setting {nowhere}")


def test_a_missing_setting_is_described_as_in_the_help() -> None:
    assert comment_on(settings_of("predict"), "source").startswith("a picture, a folder of pictures")
    assert comment_on(settings_of("train"), "weights").startswith("run, model folder, Hub id or")
    assert comment_on(settings_of("train"), "data.root") == ""


def test_the_home_folder_is_written_out_where_no_shell_does_it() -> None:
    home = os.path.expanduser("~")
    given = ["data.root=~/mine", "runs=[~/a,~/b]", 'source="~/a b"', "~data", "x=a~b"]
    meant = [f"data.root={home}/mine", f"runs=[{home}/a,{home}/b]", f'source="{home}/a b"', "~data", "x=a~b"]
    assert quote_paths(given) == meant


def test_a_name_in_any_alphabet_needs_no_quotes() -> None:
    given = ["output=runs/Küche", "output=写真 (1)", "runs=[ä,b]", "output=a b", 'output="ä"']
    assert quote_paths(given) == ['output="runs/Küche"', 'output="写真 (1)"', *given[2:]]
    assert advice("train", quote_paths(given[:1])) == ""


def test_a_part_is_chosen_with_a_slash() -> None:
    from eldenet.configurable import check_arguments
    from eldenet.model import DepthNet

    with pytest.raises(ValueError, match="a slash chooses it from its group, as in model/backbone=resnet18"):
        check_arguments(DepthNet.from_parts, {"backbone": "resnet18"}, "model.")


def test_a_depth_range_in_millimeters_is_refused() -> None:
    from eldenet.evaluation.protocol import EvalProtocol

    with pytest.raises(ValueError, match=r"max_depth=6000: give meters; 6, if it is in mm"):
        EvalProtocol("folder", max_depth=6000.0)

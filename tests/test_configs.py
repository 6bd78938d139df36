"""Every YAML file composes, names existing classes, shows all of their options, and refuses typos."""

import functools
import inspect
import re
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra.utils import get_object
from support import layouts
from support.composing import composed

from eldenet.compose import compose, compose_config, config_folder, plain
from eldenet.configurable import Configurable, instantiate
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.system.resources import choose_resources
from eldenet.train import TrainSettings

CONFIGS = config_folder()


def choices(group: str) -> list[str]:
    return sorted(path.stem for path in (CONFIGS / group).glob("*.yaml"))


GROUPS = [
    path.relative_to(CONFIGS).as_posix()
    for path in sorted(CONFIGS.rglob("*"))
    if path.is_dir() and choices(path.relative_to(CONFIGS).as_posix()) and path.name != "experiment"
]
CHOICES = [(group, choice) for group in GROUPS for choice in choices(group)]

# Groups of other commands than train.
COMMAND_OF = dict.fromkeys(("mode", "policy", "sensor", "observer", "learner"), "navigate")

# Sections whose parts stand in the command's own file.
OWN_PARTS = {"predict": "perception"}

# Arguments that the calling code supplies, not the user.
SUPPLIED: dict[str, set[str]] = {
    "eldenet.training.trainer.Trainer": {"optimizer", "scheduler", "seed", "loggers"},
    "eldenet.training.optim.": {"optimizer", "total_steps", "steps_per_epoch"},
    "eldenet.data.": {"transform", "resize_depth", "seed"},  # from build_split
    "torch.optim.": {"params"},
    "eldenet.navigation.policy.": {"robots"},
    "eldenet.navigation.planners.": {"robots"},
    "eldenet.navigation.dqn.DQNSettings": {"seed"},
}
# Workers depend on the machine; rendered frames are never missing and need no cache.
RENDERED = {"workers", "cache", "on_error", "resize_on_load"}
OF_ROOMS = {"near", "down", "plain"}
# Options that YAML files leave out on purpose.
HIDDEN: dict[str, set[str]] = {
    "eldenet.model.DepthNet.from_parts": {
        "refine",  # chosen as a group: model/refine=joint_bilateral
        "rays",  # the same
        "options",  # normalization, ImageNet's by default; the canonical camera, from canonical_focal
    },
    # the same, for whole networks
    "eldenet.model.DepthNet": {"refine", "mean", "std", "canonical_focal", "canonical_width"},
    "eldenet.perception.lifter.BoxLifter": {"priors"},  # a table of class sizes, given from Python
    "eldenet.data.rooms.Rooms": RENDERED,
    "eldenet.data.arenas.Arenas": RENDERED | {"focal"} | OF_ROOMS,  # one lens
    "eldenet.data.streets.Streets": RENDERED | OF_ROOMS,
    "eldenet.losses.": {"applies_to"},  # "metric" but in losses for data=mix
    # options of the sources, which each source states itself
    "eldenet.data.mix.Mix": {"min_depth", "max_depth", "cache", "on_error", "resize_on_load"},
    # torch's rarely used options; +optimizer.eps=... adds one
    "torch.optim.": {
        *("eps", "amsgrad", "foreach", "maximize", "capturable", "differentiable", "fused"),
        *("dampening", "nesterov", "decoupled_weight_decay"),
    },
}


def listed(table: dict[str, set[str]], target: str) -> set[str]:
    return set().union(*(names for start, names in table.items() if target.startswith(start)))


def nodes(node: Any) -> Iterator[dict[str, Any]]:
    """Every mapping with a ``_target_`` in a plain config."""
    if isinstance(node, dict):
        if "_target_" in node:
            yield node
        for value in node.values():
            yield from nodes(value)
    elif isinstance(node, list):
        for value in node:
            yield from nodes(value)


@functools.cache
def section(group: str, choice: str) -> Any:
    """The part of a composed training config that ``group=choice`` put there, resolved."""
    given = {"observer": ["mode=train"], "learner": ["mode=train"], "mode": ["output=x"]}.get(group, [])
    config = composed(COMMAND_OF.get(group, "train"), [f"{group}={choice}", *given])
    if group == "mode":  # written over the whole config
        return plain(config)
    if group == "debug":  # written over the whole config
        return {name: plain(config[name]) for name in ("data", "trainer", "model", "loss")}
    node = config
    for name in group.split("/"):
        node = node[name]
    return plain(node)


def options(target: Callable[..., Any]) -> tuple[set[str], set[str]]:
    """Names of a callable's arguments, and of those without a default."""
    required, every = set(), set()
    if isinstance(target, type) and target.__init__ is torch.nn.Module.__init__:
        return every, required  # its *args and **kwargs are not options
    for name, parameter in inspect.signature(target).parameters.items():
        if parameter.kind is inspect.Parameter.VAR_KEYWORD:
            typed = typing.get_args(parameter.annotation)
            every |= (
                set(typing.get_type_hints(typed[0])) if typed and typing.is_typeddict(typed[0]) else {name}
            )
            continue
        every.add(name)
        if parameter.default is inspect.Parameter.empty:
            required.add(name)
    return every, required


@pytest.mark.parametrize(("group", "choice"), CHOICES)
def test_every_yaml_file_composes_and_shows_every_option(group: str, choice: str) -> None:
    assert_every_option_is_shown(section(group, choice), f"{group}/{choice}.yaml")


def assert_every_option_is_shown(config: Any, file: str) -> None:
    for node in nodes(config):
        target = node["_target_"]
        assert target.startswith(("eldenet.", "torch.optim."))
        part = get_object(target)
        assert callable(part)
        every, required = options(part)
        given = {name for name in node if not name.startswith("_")}
        supplied = listed(SUPPLIED, target)
        if isinstance(part, type) and issubclass(part, Configurable):
            supplied |= set(part.supplied_arguments)
        assert given <= every, f"{target} takes no {given - every}"
        assert required <= given | supplied, f"{target} needs {required - given - supplied}"
        left_out = every - given - supplied - listed(HIDDEN, target)
        assert not left_out, f"configs/{file} does not show {left_out} of {target}"


@pytest.mark.parametrize("choice", choices("runtime"))
def test_every_runtime_shows_every_option(choice: str) -> None:
    given = set(section("runtime", choice))
    assert given == set(inspect.signature(choose_resources).parameters) - {"for_torch"}  # the command knows


@pytest.mark.parametrize("experiment", choices("experiment"))
def test_every_experiment_composes(experiment: str) -> None:
    config = compose(TrainSettings, [f"+experiment={experiment}"])
    chosen_protocol(config.data, config.protocol)
    for name in ("data", "model", "loss", "optimizer", "scheduler", "trainer"):
        assert list(nodes(plain(getattr(config, name))))


@pytest.mark.parametrize(
    "command",
    sorted(path.stem for path in CONFIGS.glob("*.yaml") if path.stem not in ("base", "no_run_folder")),
)
def test_every_command_composes(command: str) -> None:
    config = compose_config("zoo", ["model=eldenet"]) if command == "zoo" else composed(command)
    if command in OWN_PARTS:
        assert_every_option_is_shown(plain(config[OWN_PARTS[command]]), f"{command}.yaml")


def test_a_network_of_other_parts_has_their_names() -> None:
    for words, name in (
        (["model=eldenet_s", "model.decoder.width=64"], "eldenet_s"),
        (["model=mobilenet_v2_upconv", "model/decoder=fast_upconv"], "mobilenet_v2_fast_upconv"),
        (["model/backbone=resnet18", "model_name=mine"], "mine"),
        (["+experiment=indoor_lite"], "efficientnet_lite2_fast_upconv"),  # its YAML replaces both parts
        (["model=guidedepth"], "guidedepth"),
    ):
        assert compose(TrainSettings, words).model_name == name


@pytest.mark.parametrize(
    "wrong", ["trainer.epoch=3", "data.imput_size=[8,8]", "sead=1", "model/backbone=resnet19"]
)
def test_a_typo_on_the_command_line_is_refused(wrong: str) -> None:
    with pytest.raises(ValueError, match=re.escape(wrong.split("=")[0]) + "|resnet19"):
        compose(TrainSettings, [wrong])


@pytest.mark.parametrize("group", ["loss", "augmentation", "protocol", "model/head", "trainer"])
def test_a_typo_in_a_file_is_refused(group: str) -> None:
    for node in nodes(section(group, choices(group)[0])):
        with pytest.raises(ValueError, match="no_such_option"):
            instantiate({**node, "no_such_option": 1})


@pytest.mark.parametrize("choice", choices("augmentation"))
def test_every_augmentation_runs(choice: str, tmp_path: Path) -> None:
    layouts.folder(tmp_path)
    config = compose(TrainSettings, ["data=folder", f"data.root={tmp_path}", f"augmentation={choice}"])
    sample = open_split(
        config.data, "train", chosen_protocol(config.data, config.protocol), augmentation=config.augmentation
    )[0]
    assert sample["image"].shape == (3, *config.data["input_size"])

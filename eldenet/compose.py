"""Hydra's part: from YAML files and overrides to plain values. OmegaConf ends here.

A command's settings are a frozen dataclass in the command's own module, such as
:class:`eldenet.train.TrainSettings`. Hydra knows it as the schema of the YAML file of the same name, so
OmegaConf checks names and types; :func:`compose` returns an instance, with plain lists and dicts in it.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass
from datetime import datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from eldenet.configurable import described
from eldenet.system.files import shipped_folder
from eldenet.system.resources import prepare_environment

prepare_environment()

from hydra._internal.config_loader_impl import ConfigLoaderImpl  # noqa: E402
from hydra._internal.utils import create_config_search_path  # noqa: E402
from hydra.core.config_search_path import SearchPathQuery  # noqa: E402
from hydra.core.config_store import ConfigStore  # noqa: E402
from hydra.core.hydra_config import HydraConfig  # noqa: E402
from hydra.errors import HydraException  # noqa: E402
from hydra.types import RunMode  # noqa: E402
from omegaconf import MISSING, DictConfig, OmegaConf, SCMode, open_dict  # noqa: E402
from omegaconf.errors import InterpolationToMissingValueError, ValidationError  # noqa: E402
from yaml import YAMLError  # noqa: E402

REQUIRED: Any = MISSING  # the default of a setting that has none
#: Metadata of a field that only some choices of a group add, as policy=dqn adds ``checkpoint``; else None.
FROM_CHOICE = {"from_choice": True}
#: Focal lengths [widths of the picture] for which the head of a canonical camera covers the data's depth.
FOCAL_RANGE = (0.4, 2.0)
Settings = TypeVar("Settings")


def config_folder() -> Path:
    """Return the folder of the YAML files: ``configs/`` in a checkout, ``eldenet/configs`` in a wheel."""
    return shipped_folder("configs", "train.yaml")


def compose(settings: type[Settings], overrides: Sequence[str] = ()) -> Settings:
    """Return a command's settings, as its command line would.

    Args:
        settings: the command's dataclass; a mode of the command returns its subclass.
        overrides: as on the command line, such as ``["model=eldenet_s", "seed=1"]``.

    Raises:
        ValueError: there is no such setting or choice, or a value does not fit.
    """
    register(settings)
    composed: Settings = to_settings(_load(command_of(settings), overrides))
    return composed


def command_of(settings: type) -> str:
    """Return the name of a command's YAML file: ``CheckDataSettings`` -> "check_data"."""
    return re.sub(r"(?<=.)(?=[A-Z])", "_", settings.__name__.removesuffix("Settings")).lower()


def register(settings: type) -> None:
    """Make a dataclass and its subclasses known to Hydra; YAML files name them in their ``defaults``."""
    schema = OmegaConf.structured(settings)
    schema._set_flag("readonly", None)  # a frozen dataclass; Hydra merges into it
    for field in fields(settings):
        if field.metadata == FROM_CHOICE:
            schema._set_flag("struct", False)  # until Hydra has composed it
            del schema[field.name]
    ConfigStore.instance().store(name=settings.__name__, node=schema)
    subclasses: list[type] = settings.__subclasses__()
    for mode in subclasses:
        register(mode)


def to_settings(config: DictConfig, **changes: Any) -> Any:
    """Return an instance of the dataclass that a config was composed for, with resolved, plain values.

    ``changes`` replace values of the config; a section ``hydra`` is left out.

    Raises:
        ValueError: a setting is missing or unknown, or the dataclass refuses a value.
    """
    settings: Any = OmegaConf.get_type(config)
    config.update(changes)
    names = [field.name for field in fields(settings)]
    unknown = set(config) - {*names, "hydra"}
    if unknown:
        raise ValueError(f"there is no setting {min(map(str, unknown))}: --help lists all settings")
    for name in names:
        if OmegaConf.is_missing(config, name):
            raise ValueError(f"give {name}=... on the command line")
    for name in ("seed", "world"):
        if config.get(name, 0) < 0:
            raise ValueError(f"{name}={config[name]}: give 0 or more")
    try:
        return settings(**{name: _instance(config[name]) for name in names if name in config})
    except InterpolationToMissingValueError as error:
        missing = str(error).partition("\n")[0].rpartition(": ")[2]
        raise ValueError(f"give {missing}=... on the command line") from error


def _instance(value: Any) -> Any:
    """Return a section as an instance of its dataclass or as plain values, resolved."""
    if not OmegaConf.is_config(value):
        return value
    return OmegaConf.to_container(value, resolve=True, structured_config_mode=SCMode.INSTANTIATE)


def compose_config(
    config_name: str, overrides: Sequence[str] = (), sources: Sequence[str] = ()
) -> DictConfig:
    """Compose a config as the command line would, without touching Hydra's global state.

    So it works inside somebody else's Hydra application. Inside a command of ours it finds what the command
    finds: what ``--config-dir`` and ``hydra.searchpath`` add; ``sources`` are further addresses of folders.

    Raises:
        ValueError: there is no such config, or an override does not fit it.
    """
    config = _load(config_name, overrides, sources)
    with open_dict(config):
        config.pop("hydra", None)
    return config


def choices(config_name: str, overrides: Sequence[str] = ()) -> dict[str, str | None]:
    """Return the YAML file that a command takes from each group, by default or with ``overrides``."""
    return dict(_load(config_name, overrides).hydra.runtime.choices)


def groups(config_name: str) -> dict[str, list[str]]:
    """Return the groups of YAML files that a command chooses from, with the names of their files."""
    modes = [[f"mode={path.stem}"] for path in (config_folder() / "mode").glob("*.yaml")]
    loaded = [_load(config_name, words) for words in (modes if config_name == "navigate" else [[]])]
    chosen = {name.partition("/")[0] for config in loaded for name in config.hydra.runtime.choices}
    if "model" in chosen:
        chosen.add("experiment")
    folder = config_folder()
    files = sorted(path.relative_to(folder) for path in folder.rglob("*.yaml"))
    found: dict[str, list[str]] = {}
    for file in files:
        if file.parts[0] in chosen:
            found.setdefault(file.parent.as_posix(), []).append(file.stem)
    return found


def _load(config_name: str, overrides: Sequence[str], sources: Sequence[str] = ()) -> DictConfig:
    """Compose a config, with Hydra's own part."""
    search_path = create_config_search_path(str(config_folder()))
    for source in (*added_sources(), *sources):
        search_path.prepend("command-line", source, anchor=SearchPathQuery(provider="schema"))
    loader = ConfigLoaderImpl(search_path)
    try:
        return loader.load_configuration(config_name, list(overrides), run_mode=RunMode.RUN)
    except HydraException as error:
        raise ValueError(_wrong_type(error.__cause__, overrides) or str(error)) from error
    except AssertionError as error:  # OmegaConf's, where a part of nothing is set
        raise ValueError(_part_of_nothing(loader, config_name, overrides) or str(error)) from error
    except YAMLError as error:
        raise ValueError(f"a file of settings is no YAML: {' '.join(str(error).split())}") from error


def _part_of_nothing(loader: ConfigLoaderImpl, config_name: str, overrides: Sequence[str]) -> str:
    """Return one line on a setting of a section that is null, such as ``protocol.scale=median``."""
    parts = [word for word in overrides if "." in word.partition("=")[0]]
    others = [word for word in overrides if word not in parts]
    config = loader.load_configuration(config_name, others, run_mode=RunMode.RUN)
    for word in parts:
        section = word.partition("=")[0].rpartition(".")[0]
        if OmegaConf.select(config, section) is None:
            own = f", or data.{word} for the data set's own" if section == "protocol" else ""
            return f"{word}: give {section}=... too{own}"
    return ""


def _wrong_type(error: BaseException | None, overrides: Sequence[str]) -> str:
    """Return one line on a value that is of another type than its dataclass's field, or ""."""
    if not (isinstance(error, ValidationError) and is_dataclass(error.object_type)):
        return ""
    kind = get_type_hints(error.object_type).get(str(error.key))
    given = [word for word in overrides if word.lstrip("+").startswith(f"{error.full_key}=")]
    return f"{given[-1] if given else error.full_key}: give {described(kind)}" if kind else ""


def added_sources() -> list[str]:
    """Return where the running eldenet command finds configs beside our own; none outside of a command."""
    if not HydraConfig.initialized():
        return []
    sources = HydraConfig.get().runtime.config_sources
    ours = any(source.provider == "main" and Path(source.path) == config_folder() for source in sources)
    added = ("command-line", "hydra.searchpath")  # the latter names where it was given, too
    return [
        f"{source.schema}://{source.path}"
        for source in sources
        if ours and source.provider.startswith(added) and source.path
    ]


def plain(config: Any, *, resolve: bool = True) -> Any:
    """Return plain dicts, lists and values; by default resolved."""
    return OmegaConf.to_container(config, resolve=resolve) if OmegaConf.is_config(config) else config


def listed(value: Any) -> list[Any]:
    """Return a setting that takes several values as a list: [] of None, a list of one of a single value."""
    values = plain(value)
    return list(values) if isinstance(values, list | tuple) else [] if values is None else [values]


# --- what YAML files call as ${name:argument,...} -----------------------------------------------------------


def resolver(name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function that YAML files call as ``${name:argument,...}``."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        OmegaConf.register_new_resolver(name, function, replace=True)
        return function

    return decorate


if not OmegaConf.has_resolver("now"):  # Hydra's own, which is there in its applications alone

    @resolver("now")
    def _now(pattern: str) -> str:
        """``${now:%Y%m%d-%H%M%S}``: the time."""
        return datetime.now().strftime(pattern)


@lru_cache
def _parts_of(model: str, sources: tuple[str, ...]) -> dict[str, str | None]:
    """Return the YAML files of a model's parts, found in our folder and ``sources``, of its own choice."""
    return choices("zoo", [f"model={model}"])


@resolver("network_name")
def _network_name(*, _root_: DictConfig) -> str:
    """``${network_name:}``: the chosen model, or its backbone and decoder where one is replaced."""
    hydra_config = _root_.hydra if "hydra" in _root_ else HydraConfig.get()
    taken = hydra_config.runtime.choices
    own = _parts_of(str(taken["model"]), tuple(added_sources()))
    parts = [group for group in ("model/backbone", "model/decoder") if group in taken]
    if any(taken[part] != own.get(part) for part in parts):
        return "_".join(str(taken[part]) for part in parts)
    return str(taken["model"])


@resolver("test_part")
def _test_part(test_root: str | None, root: str | None) -> str:
    """``${test_part:test_root,root}``: "val" of the training's own folder, "all" of another one."""
    places = {folder and Path(folder).expanduser().resolve() for folder in (test_root, root)}
    return "val" if len(places) == 1 else "all"


@resolver("sweep_folder")
def _sweep_folder(overrides: Sequence[str], default: str) -> str:
    """``${sweep_folder:overrides,default}``: the folder that ``output=`` names, of a sweep's runs."""
    given = [word.partition("=")[2] for word in overrides if word.startswith("output=")]
    return given[-1].strip("'\"") if given else default


@resolver("canonical_near")
def _canonical_near(depth: float, canonical_focal: float | None) -> float:
    """``${canonical_near:depth,canonical_focal}``: canonical ``depth`` [m] of the longest lens."""
    return depth if canonical_focal is None else depth * canonical_focal / FOCAL_RANGE[1]


@resolver("canonical_far")
def _canonical_far(depth: float, canonical_focal: float | None) -> float:
    """``${canonical_far:depth,canonical_focal}``: canonical ``depth`` [m] of the widest lens."""
    return depth if canonical_focal is None else depth * canonical_focal / FOCAL_RANGE[0]


@resolver("zoom")
def _zoom(canonical_focal: float | None) -> str:
    """``${zoom:canonical_focal}``: what an augmentation's zoom changes."""
    return "depth" if canonical_focal is None else "focal"

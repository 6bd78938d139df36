"""The one place where a config is composed; it leaves as plain objects, OmegaConf ends here."""

import logging
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from eldenet.system.resources import prepare_environment

prepare_environment()

import hydra  # noqa: E402
from hydra._internal.config_loader_impl import ConfigLoaderImpl  # noqa: E402
from hydra._internal.utils import create_config_search_path  # noqa: E402
from hydra.core.config_search_path import SearchPathQuery  # noqa: E402
from hydra.core.hydra_config import HydraConfig  # noqa: E402
from hydra.errors import HydraException  # noqa: E402
from hydra.types import RunMode  # noqa: E402
from omegaconf import DictConfig, OmegaConf, open_dict  # noqa: E402

USER_ERRORS = (ValueError, OSError, FloatingPointError, ImportError)


def config_folder() -> Path:
    """Where the YAML files lie: ``configs/`` of a checkout, ``eldenet/configs`` of an installed wheel."""
    package = Path(__file__).resolve().parent
    for folder in (package / "configs", package.parent / "configs"):
        if (folder / "train.yaml").is_file():
            return folder
    raise FileNotFoundError(f"no configs beside {package}: the installation is incomplete, reinstall eldenet")


def compose(config_name: str, overrides: Sequence[str] = ()) -> DictConfig:
    """Compose a config as the command line would, without touching Hydra's global state.

    So it works inside somebody else's Hydra application. Inside a command of ours it finds what the command
    finds: what ``--config-dir`` and ``hydra.searchpath`` add.

    Raises:
        ValueError: there is no such config, or an override does not fit it.
    """
    search_path = create_config_search_path(str(config_folder()))
    for source in added_sources():
        search_path.prepend("command-line", source, anchor=SearchPathQuery(provider="schema"))
    loader = ConfigLoaderImpl(search_path)
    try:
        config = loader.load_configuration(config_name, list(overrides), run_mode=RunMode.RUN)
    except HydraException as error:
        raise ValueError(str(error)) from error
    with open_dict(config):
        config.pop("hydra", None)
    return config


def added_sources() -> list[str]:
    """Where the command of ours that is running finds configs beside our own; none elsewhere."""
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


def resolver(name: str) -> Callable[[Callable[..., str]], Callable[..., str]]:
    """Decorate a function that YAML files call as ``${name:argument,...}``."""

    def register(function: Callable[..., str]) -> Callable[..., str]:
        OmegaConf.register_new_resolver(name, function, replace=True)
        return function

    return register


@resolver("test_part")
def _test_part(test_root: str | None, root: str | None) -> str:
    """``${test_part:test_root,root}``: "val" of the training's own folder, "all" of another one."""
    places = {folder and Path(folder).expanduser().resolve() for folder in (test_root, root)}
    return "val" if len(places) == 1 else "all"


def read_yaml(path: Path) -> Any:
    """A YAML file as plain values.

    Raises:
        ValueError: it is no YAML.
    """
    from yaml import YAMLError

    try:
        return OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    except (YAMLError, OSError) as error:
        raise ValueError(f"{path} can't be read as YAML: {error}") from error


def is_main_process() -> bool:
    """Whether this process speaks and writes, of those that ``torchrun`` or ``accelerate launch`` started."""
    return os.environ.get("RANK", "0") == "0"


def plain(config: Any) -> Any:
    """Resolved dicts, lists and values; what ``run.json`` stores."""
    return OmegaConf.to_container(config, resolve=True) if OmegaConf.is_config(config) else config


def listed(config: Any) -> list[Any]:
    """A setting that takes several values: one alone counts as a list of one, as a person would write it."""
    values = plain(config)
    return values if isinstance(values, list) else [values]


def instantiate(config: Any, **arguments: Any) -> Any:
    """Build what a config node describes; the object gets plain lists and dicts, never OmegaConf's.

    Raises:
        ValueError: a class or argument in the config does not exist, or the class refused its arguments.
    """
    from hydra.errors import InstantiationException

    try:
        return hydra.utils.instantiate(config, _convert_="all", **arguments)
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, USER_ERRORS):
            raise cause from None
        raise ValueError(str(error)) from error


def build_model(config: DictConfig, **arguments: Any) -> Any:
    """A :class:`~eldenet.model.DepthNet` from a node of ``configs/model``, and further arguments of it."""
    return instantiate(config, **arguments)


def build_protocol(config: DictConfig) -> Any:
    """The protocol named on the command line, else the data set's own."""
    chosen = config.get("protocol")
    return instantiate(chosen if chosen is not None else config.data.protocol)


def _split_node(config: DictConfig, split: str) -> DictConfig:
    """The settings of one split's data set."""
    node = config.data.get(split)
    if not OmegaConf.is_dict(node):
        raise ValueError(f"data={config.data.name} has no split '{split}': choose train, val or test")
    if "_target_" not in node:  # a part of ${data.val} was overridden, so nothing else is left
        raise ValueError(
            f"data.{split} of data={config.data.name} are another split's settings, by reference: override "
            f"those (data.val...), or give a whole data.{split}"
        )
    return node


def build_split(
    config: DictConfig,
    split: str,
    protocol: Any,
    *,
    augment: bool = False,
    score: bool = False,
    seed: int = 0,
) -> Any:
    """Data set of one split: augmented and resized for training, or with its own ground truth for scoring.

    Args:
        config: the whole config, with ``data`` and, to augment, ``augmentation``.
        split: "train", "val" or "test": an entry of ``config.data``.
        protocol: whose frame geometry (resize, center crop) is applied first.
        augment: for training.
        score: keep the ground truth's own resolution, as "val" and "test" always do.
        seed: of the augmentation.
    """
    from eldenet.data.base import Chain
    from eldenet.data.resize_crop import ResizeCrop

    node = _split_node(config, split)
    steps: list[Any] = []
    if protocol.changes_frames:
        whole = protocol.paste and (score or split != "train")
        steps.append(ResizeCrop.of_protocol(protocol, keep_depth=whole))
    changes: dict[str, Any] = {}
    if node.get("load_size") is not None and (score or protocol.changes_frames):
        changes = {"load_size": None, "cache": "none"}
        if protocol.changes_frames:
            # the protocol speaks of the camera's frame: it must not find a smaller one (or keep whole ones)
            logging.getLogger("eldenet").info(
                "%s: load_size and cache are off: protocol %s resizes or crops the camera's frames first",
                split,
                protocol.name,
            )
    if augment and config.get("augmentation"):  # augmentation=none is an empty node
        steps.append(instantiate(config.augmentation))
    dataset = instantiate(
        node,
        **changes,
        transform=Chain(steps) if steps else None,
        resize_depth=split == "train" and not score,
        seed=seed,
    )
    if score or split != "train":  # the protocol alone says what is scored
        protocol.check_ground_truth(dataset.ground_truth)
        dataset.min_depth, dataset.max_depth = protocol.min_depth, protocol.max_depth
    if dataset.on_error == "skip":
        dataset.leave_out_unreadable()
    places = config.data.get("subset", {}).get(split)
    if places is not None:
        dataset.draw_subset(plain(places), config.data.subset_seed)
    if dataset.skipped:
        logging.getLogger("eldenet").warning(
            "%s: %d of %d frames left out, such as %s",
            split,
            len(dataset.skipped),
            len(dataset.skipped) + len(dataset),
            "; ".join(f"{name} ({reason})" for name, reason in list(dataset.skipped.items())[:3]),
        )
    return dataset


def build_report(config: DictConfig) -> Any:
    """A :class:`~eldenet.results.comparison.ReportSetup`."""
    from eldenet.results.comparison import ReportSetup

    if config.study is not None:
        return ReportSetup(study=Path(config.study))
    return ReportSetup(
        runs=listed(config.runs),
        output=Path(config.output),
        columns=listed(config.columns),
        costs=config.costs,
    )


def build_study(config: DictConfig) -> Any:
    """A :class:`~eldenet.results.studies.runner.StudySetup`."""
    from eldenet.results.studies.runner import StudySetup

    return StudySetup(
        study=config.study,
        runs=Path(config.runs),
        rows=plain(config.rows),
        job=config.row,
        seeds=None if config.seeds is None else listed(config.seeds),
        rerun=config.rerun,
        given=plain(config.given),
    )

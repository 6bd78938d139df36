"""The one place where a config is composed; it leaves as plain objects, OmegaConf ends here.

First come what all commands share: composition, objects from nodes, settings, splits of a data set. Then a
section for each group of commands: ``build_<command>`` returns what ``eldenet/<command>.py`` runs.
"""

import functools
import logging
import math
import os
import pkgutil
import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.configurable import building_only, refuse_foreign_code
from eldenet.system.checks import check_arguments, one_of
from eldenet.system.errors import USER_ERRORS
from eldenet.system.files import shipped_folder
from eldenet.system.resources import choose_resources, prepare_environment
from eldenet.weights import BEST, find_checkpoint, list_models

prepare_environment()

import hydra  # noqa: E402
from hydra._internal.config_loader_impl import ConfigLoaderImpl  # noqa: E402
from hydra._internal.utils import create_config_search_path  # noqa: E402
from hydra.core.config_search_path import SearchPathQuery  # noqa: E402
from hydra.core.hydra_config import HydraConfig  # noqa: E402
from hydra.errors import HydraException  # noqa: E402
from hydra.types import RunMode  # noqa: E402
from omegaconf import DictConfig, OmegaConf, open_dict  # noqa: E402

if TYPE_CHECKING:
    import numpy as np

    from eldenet.data.inspection import CheckDataSetup
    from eldenet.deploy.benchmarking.run import BenchmarkSetup
    from eldenet.deploy.demo import DemoSetup
    from eldenet.deploy.exporting import ExportSetup
    from eldenet.deploy.prediction import PredictionSetup
    from eldenet.deploy.scoring import EvaluationSetup
    from eldenet.navigation.modes import ModeSetup
    from eldenet.perception.camera_height import CalibrationSetup
    from eldenet.results.comparison import ReportSetup
    from eldenet.results.studies.plan import Composition
    from eldenet.results.studies.runner import StudySetup, Training
    from eldenet.training.adaptation import AdaptationSetup
    from eldenet.training.setup import TrainingSetup

SPLITS = ("train", "val", "test")
#: Focal lengths [widths of the picture] for which the head of a canonical camera covers the data's depth.
FOCAL_RANGE = (0.4, 2.0)
# groups of a training's parts: what a study's settings may build
PARTS = (
    "experiment",
    "model",
    "data",
    "loss",
    "optimizer",
    "scheduler",
    "augmentation",
    "trainer",
    "protocol",
)


# --- composition --------------------------------------------------------------------------------------------


def config_folder() -> Path:
    """Return the folder of the YAML files: ``configs/`` in a checkout, ``eldenet/configs`` in a wheel."""
    return shipped_folder("configs", "train.yaml")


def compose(config_name: str, overrides: Sequence[str] = ()) -> DictConfig:
    """Compose a config as the command line would, without touching Hydra's global state.

    So it works inside somebody else's Hydra application. Inside a command of ours it finds what the command
    finds: what ``--config-dir`` and ``hydra.searchpath`` add.

    Raises:
        ValueError: there is no such config, or an override does not fit it.
    """
    config = _load(config_name, overrides)
    with open_dict(config):
        config.pop("hydra", None)
    return config


def groups(config_name: str) -> dict[str, list[str]]:
    """Return the groups of YAML files that a command chooses from, with the names of their files."""
    modes = [[f"mode={path.stem}"] for path in (config_folder() / "mode").glob("*.yaml")]
    loaded = [_load(config_name, words) for words in (modes if config_name == "navigate" else [[]])]
    chosen = {name.partition("/")[0] for config in loaded for name in config.hydra.runtime.choices}
    if "model" in chosen:
        chosen.add("experiment")
    files = sorted(path.relative_to(config_folder()) for path in config_folder().rglob("*.yaml"))
    found: dict[str, list[str]] = {}
    for file in files:
        if file.parts[0] in chosen:
            found.setdefault(file.parent.as_posix(), []).append(file.stem)
    return found


def _load(config_name: str, overrides: Sequence[str]) -> DictConfig:
    """Compose a config, with Hydra's own part."""
    search_path = create_config_search_path(str(config_folder()))
    for source in added_sources():
        search_path.prepend("command-line", source, anchor=SearchPathQuery(provider="schema"))
    loader = ConfigLoaderImpl(search_path)
    try:
        return loader.load_configuration(config_name, list(overrides), run_mode=RunMode.RUN)
    except HydraException as error:
        raise ValueError(str(error)) from error


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


def resolver(name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Decorate a function that YAML files call as ``${name:argument,...}``."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        OmegaConf.register_new_resolver(name, function, replace=True)
        return function

    return register


if not OmegaConf.has_resolver("now"):  # Hydra's own, which is there in its applications alone

    @resolver("now")
    def _now(pattern: str) -> str:
        """``${now:%Y%m%d-%H%M%S}``: the time."""
        return datetime.now().strftime(pattern)


@resolver("test_part")
def _test_part(test_root: str | None, root: str | None) -> str:
    """``${test_part:test_root,root}``: "val" of the training's own folder, "all" of another one."""
    places = {folder and Path(folder).expanduser().resolve() for folder in (test_root, root)}
    return "val" if len(places) == 1 else "all"


@resolver("sweep_folder")
def _sweep_folder(overrides: Sequence[str], default: str) -> str:
    """``${sweep_folder:overrides,default}``: the folder that ``output=`` names, of a sweep's runs."""
    given = [word.partition("=")[2] for word in overrides if word.startswith(("output=", "run_dir="))]
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


def plain(config: Any, *, resolve: bool = True) -> Any:
    """Return plain dicts, lists and values, as ``run.json`` stores them; by default resolved."""
    return OmegaConf.to_container(config, resolve=resolve) if OmegaConf.is_config(config) else config


def listed(config: Any) -> list[Any]:
    """Return a setting that takes several values as a list; a single value becomes a list of one."""
    values = plain(config)
    return values if isinstance(values, list) else [values]


# --- objects from config nodes ------------------------------------------------------------------------------


@contextmanager
def settings_of_a_study(trusted_modules: Sequence[str]) -> Iterator[None]:
    """Within the block, :func:`instantiate` builds only what the settings of a stranger's study may build.

    That is what our own YAML files of a training's parts name, and those of ``--config-dir``. A command line
    is its user's own and may name anything.

    Args:
        trusted_modules: packages or modules that settings may name beyond that.
    """
    folders = [config_folder(), *(Path(source.removeprefix("file://")) for source in added_sources())]
    files = [file for folder in folders for part in PARTS for file in (folder / part).rglob("*.yaml")]
    texts = [file.read_text(errors="replace") for file in files]
    known = frozenset(target for text in texts for target in re.findall(r"_target_: *([\w.]+)", text))
    with building_only(known, trusted_modules):
        yield


def instantiate(config: Any, **arguments: Any) -> Any:
    """Build what a config node describes; the object gets plain lists and dicts, never OmegaConf's.

    Raises:
        ValueError: a class or argument in the config does not exist, a value is of another type than the
            class's, the class refused its arguments, or the node is of a study and names code that it may
            not run.
    """
    from hydra.errors import InstantiationException

    refuse_foreign_code(plain(config))

    if OmegaConf.is_config(config):
        _check_values(plain(config), config._get_full_key(None), arguments)
    try:
        return hydra.utils.instantiate(config, _convert_="all", **arguments)
    except InstantiationException as error:
        cause = error.__cause__
        if isinstance(cause, USER_ERRORS):
            raise cause from None
        raise ValueError(str(error)) from error


def _check_values(node: Any, name: str, arguments: Mapping[str, Any] | None = None) -> None:
    """Compare the values of a node, and of those below it, with what their classes are annotated with."""
    if isinstance(node, list):
        node = dict(enumerate(node))
    if not isinstance(node, dict):
        return
    prefix = f"{name}." if name else ""
    if "_target_" in node:
        try:
            target = pkgutil.resolve_name(node["_target_"])
        except (ImportError, AttributeError, ValueError):  # Hydra's own error says more
            return
        check_arguments(target, {key: value for key, value in node.items() if value != "???"}, prefix)
        check_arguments(target, arguments or {})
    for key, value in node.items():
        _check_values(value, f"{prefix}{key}")


def build_model(config: Any, **arguments: Any) -> Any:
    """Build a :class:`~eldenet.model.DepthNet` from a node of ``configs/model`` and further arguments."""
    return instantiate(config, **arguments)


def build_protocol(config: DictConfig) -> Any:
    """Build the protocol named on the command line, else the data set's own."""
    chosen = config.get("protocol")
    return instantiate(chosen if chosen is not None else config.data.protocol)


# --- settings that several commands read --------------------------------------------------------------------


def _settings_in(folder: Path, config: DictConfig) -> Any:
    """Return the resolved settings of a run in ``folder``, as ``run.json`` stores them."""
    return plain(OmegaConf.merge(config, {"output": str(folder), "run_dir": str(folder)}))


def _filled(setup: Any, config: DictConfig, **given: Any) -> Any:
    """Fill a dataclass from the settings that its fields name; those in ``given`` are checked already."""
    names = [field.name for field in fields(setup) if field.name not in given]
    return setup(**{name: plain(config[name]) for name in names}, **given)


def _check_types(config: DictConfig, target: Any, *names: str) -> None:
    """Raise ValueError for the first of these settings that is of another type than the class's field."""
    check_arguments(target, {name: plain(config[name]) for name in names})


def _numbers(config: DictConfig, name: str, meaning: str) -> tuple[float, ...] | None:
    """Return a setting such as ``[near, far] in meters`` as numbers, or None for null.

    Raises:
        ValueError: it is not a list of as many finite numbers.
    """
    given = plain(config[name])
    if given is None:
        return None
    count = meaning.count(",") + 1
    try:
        numbers = tuple(float(value) for value in given)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name}={given}: give {meaning}, {count} numbers, or null")
    return numbers


def _camera(config: DictConfig) -> "np.ndarray | None":
    """Return the setting ``intrinsics`` as ``(3, 3)`` [px], or None for null.

    Raises:
        ValueError: it does not describe a camera.
    """
    from eldenet.geometry import intrinsic_matrix

    return None if config.intrinsics is None else intrinsic_matrix(plain(config.intrinsics))


def _size(config: DictConfig, name: str, otherwise: str = "null") -> tuple[int, int] | None:
    """Return a setting ``[height, width]`` [px], or None for null; ``otherwise``: what the error offers too.

    Raises:
        ValueError: it is not such a pair.
    """
    given = plain(config[name])
    if given is None:
        return None
    pair = isinstance(given, list) and [type(side) for side in given] == [int, int]
    if not pair or min(given) < 1:
        raise ValueError(f"{name}={given}: give [height, width] in pixels, or {otherwise}")
    return given[0], given[1]


def check_data_folders(config: DictConfig) -> None:
    """Raise FileNotFoundError if no split's folder exists: a mistake in ``data.root`` then costs no imports.

    Rendered data sets, which have no ``on_error``, make their folder themselves.
    """
    splits = [plain(config.data.get(split)) for split in SPLITS]
    roots = [node.get("root") for node in splits if isinstance(node, dict) and "on_error" in node]
    if not roots or any(root is not None and Path(root).expanduser().is_dir() for root in roots):
        return
    if roots[0] is not None:
        raise FileNotFoundError(f"{roots[0]} is not a folder: set data.root to the data set's folder")
    if not os.environ.get("ELDENET_DATA"):
        raise FileNotFoundError("no folder given for the data set: set data.root, or ELDENET_DATA")


def check_sources(config: DictConfig, *names: str) -> None:
    """Check the networks that these settings name: a mistake in a path then costs no imports.

    Raises:
        FileNotFoundError: there is no such file or folder.
        ValueError: there is no network of that name.
    """
    for name in names:
        if config[name] is not None:
            find_checkpoint(str(config[name]), name)


# --- data sets: splits, and check_data ----------------------------------------------------------------------


def build_split(
    config: DictConfig,
    split: str,
    protocol: Any,
    *,
    augment: bool = False,
    score: bool = False,
    seed: int = 0,
    input_size: Sequence[int] | None = None,
    frames: int | None = None,
) -> Any:
    """Data set of one split: augmented and resized for training, or with its own ground truth for scoring.

    Args:
        config: the whole config, with ``data`` and, to augment, ``augmentation``.
        split: "train", "val" or "test": an entry of ``config.data``.
        protocol: whose frame geometry (resize, center crop) is applied first.
        augment: for training.
        score: keep the ground truth's own resolution, as "val" and "test" always do.
        seed: of the augmentation.
        input_size: ``(height, width)`` [px] that the network sees; None: what ``data.input_size`` says.
        frames: for rendered scenes, the number of first frames of the split to use instead of its own choice.
    """
    from eldenet.data.base import Compose
    from eldenet.evaluation.protocol_frames import frame_geometry

    node, places = _split_node(config, split), subset_of(config).get(split)
    steps: list[Any] = []
    if protocol.changes_frames:
        whole = protocol.paste and (score or split != "train")
        steps.append(frame_geometry(protocol, keep_depth=whole))
    changes: dict[str, Any] = {}
    if input_size is not None:
        changes["input_size"] = list(input_size)
    if frames is not None:
        changes["frames"] = frames
    if node.get("resize_on_load") is not None and (score or protocol.changes_frames):
        changes |= {"resize_on_load": None, "cache": "none"}
        if protocol.changes_frames:
            # the protocol speaks of the camera's frame: it must not find a smaller one (or keep whole ones)
            logging.getLogger("eldenet").info(
                "%s: resize_on_load and cache are off, because protocol %s resizes or crops the frames first",
                split,
                protocol.name,
            )
    if augment and config.get("augmentation"):  # augmentation=none is an empty node
        steps.append(instantiate(config.augmentation))
    dataset = instantiate(
        node,
        **changes,
        transform=Compose(steps) if steps else None,
        resize_depth=split == "train" and not score,
        seed=seed,
    )
    if score or split != "train":  # only the protocol says what is scored
        protocol.check_ground_truth(dataset.ground_truth)
        dataset.min_depth, dataset.max_depth = protocol.min_depth, protocol.max_depth
    if dataset.on_error == "skip":
        dataset.leave_out_unreadable()
    if places is not None and frames is None:
        dataset.draw_subset(plain(places), config.data.get("subset_seed", 0))
    if dataset.skipped:
        logging.getLogger("eldenet").warning(
            "%s: %d of %d frames left out, such as %s",
            split,
            len(dataset.skipped),
            len(dataset.skipped) + len(dataset.names),
            "; ".join(f"{name} ({reason})" for name, reason in list(dataset.skipped.items())[:3]),
        )
    return dataset


def _split_node(config: DictConfig, split: str) -> DictConfig:
    """Return the settings of one split's data set."""
    node = config.data.get(split)
    if not OmegaConf.is_dict(node):
        raise ValueError(f"data={config.data.name} has no split '{split}': choose train, val or test")
    if "_target_" not in node:  # a part of ${data.val} was overridden, so nothing else is left
        raise ValueError(
            f"data.{split} in data={config.data.name} refers to another split's settings: override "
            f"those (data.val...), or give every setting of data.{split}"
        )
    return node


def subset_of(config: DictConfig) -> dict[str, Any]:
    """Return how many frames of each split are used; a split without an entry uses all.

    Raises:
        ValueError: ``data.subset`` is no table.
    """
    subset = plain(config.data.get("subset")) or {}
    if not isinstance(subset, dict):
        raise ValueError(f"data.subset={subset}: give it per split, data.subset.train={subset}")
    return subset


def build_check_data(config: DictConfig) -> "CheckDataSetup":
    """Return the setup of ``python -m eldenet.check_data``.

    Raises:
        ValueError: ``frames`` or ``samples`` is out of its range.
        FileNotFoundError: the data set's folder does not exist.
    """
    for name, least in (("frames", 1), ("samples", 0)):
        if config[name] is not None and config[name] < least:
            raise ValueError(f"{name}={config[name]}: give a number of at least {least}, or leave it out")
    check_data_folders(config)
    from eldenet.data.inspection import CheckDataSetup

    nodes = {split: plain(config.data[split]) for split in SPLITS if config.data.get(split) is not None}
    subset = subset_of(config)
    same: dict[str, str] = {}  # test: ${data.val}, if a data set has no third part
    for split in nodes:
        first = next(
            one for one in nodes if nodes[one] == nodes[split] and subset.get(one) == subset.get(split)
        )
        if first != split:
            same[split] = first

    def open_split(split: str) -> Any:
        node = nodes[split]
        dataset = instantiate({**node, "on_error": "skip"} if "on_error" in node else node)
        if subset.get(split) is not None:
            dataset.draw_subset(subset[split], config.data.get("subset_seed", 0))
        return dataset

    return CheckDataSetup(
        folder=Path(config.run_dir).expanduser(),
        name=config.data.name,
        config=plain(config.data),
        splits={split: functools.partial(open_split, split) for split in nodes if split not in same},
        same=same,
        check_ground_truth=build_protocol(config).check_ground_truth,
        frames=config.frames,
        samples=config.samples,
        encoding=plain(config.data.get("encoding")),
    )


# --- train, evaluate, adapt ---------------------------------------------------------------------------------


def build_training(config: DictConfig, folder: Path, overrides: Sequence[str] = ()) -> "TrainingSetup":
    """Return the setup of ``python -m eldenet.train`` in ``folder``; ``overrides``: of the command line."""
    check_data_folders(config)
    if not (folder / "run.json").is_file():  # a finished run needs them no more
        check_sources(config, "weights", "teacher")
    from eldenet.training.setup import TrainingSetup

    _check_types(config, TrainingSetup, "seed", "process_timeout")
    settings = _settings_in(folder, config)
    return TrainingSetup(
        folder=folder,
        name=config.model_name,
        seed=config.seed,
        data=config.data.name,
        input_size=settings["data"]["input_size"],
        protocol=build_protocol(config),
        make_split=functools.partial(build_split, config),
        make_model=functools.partial(instantiate, config.model, **canonical_camera(config)),
        own_normalization=bool({"mean", "std"} & config.model.keys()),
        make_loss=functools.partial(instantiate, config.loss),
        make_trainer=functools.partial(_build_trainer, config),
        resources=settings["runtime"],
        process_timeout=config.process_timeout,
        normalization=settings["normalization"],
        weights=config.weights,
        teacher=config.teacher,
        ckpt_path=config.ckpt_path,
        trusted_modules=[*_named_modules(settings["model"]), *listed(config.trusted_modules)],
        settings=settings,
        overrides=overrides,
        loggers=[name for name in listed(config.logger) if name == "tensorboard"],
    )


def _build_trainer(config: DictConfig, **changes: Any) -> Any:
    optimizer, scheduler = instantiate(config.optimizer), instantiate(config.scheduler)
    own = {"optimizer": optimizer, "scheduler": scheduler, "seed": config.seed}
    return instantiate(config.trainer, **own, loggers=listed(config.get("logger", [])), **changes)


def canonical_camera(config: DictConfig) -> dict[str, Any]:
    """Return ``canonical_focal`` and ``canonical_width`` of the network to train; nothing without them.

    Raises:
        ValueError: the input's width is unknown.
    """
    if config.canonical_focal is None:
        return {}
    if config.data.input_size is None:
        raise ValueError(
            "canonical_focal is in widths of the input, but data.input_size=null leaves the width open: give "
            "data.input_size=[height,width], or canonical_focal=null"
        )
    return {"canonical_focal": config.canonical_focal, "canonical_width": config.data.input_size[1]}


def _named_modules(settings: Any) -> list[str]:
    """Return the modules that the user's own settings name; these are trusted, a downloaded config's not."""
    if not isinstance(settings, dict):
        return []
    named = [str(settings["_target_"]).rpartition(".")[0]] if "_target_" in settings else []
    return named + [module for value in settings.values() for module in _named_modules(value)]


def build_evaluation(config: DictConfig, folder: Path) -> "EvaluationSetup":
    """Return the setup of ``python -m eldenet.evaluate``, which writes its results into ``folder``."""
    check_data_folders(config)
    check_sources(config, "checkpoint")
    _split_node(config, config.split)
    from eldenet.deploy.scoring import EvaluationSetup

    _check_types(config, EvaluationSetup, "batch_size")
    if config.input_size not in ("model", "data"):
        _size(config, "input_size", "model or data")
    settings = _settings_in(folder, config)
    return EvaluationSetup(
        folder=folder,
        checkpoint=str(config.checkpoint),
        data=config.data.name,
        split=config.split,
        input_size=settings["input_size"],
        data_input_size=settings["data"]["input_size"],
        training_frames=(settings["data"].get("train") or {}).get("frames"),
        protocol=build_protocol(config),
        make_split=functools.partial(build_split, config),
        engine=config.engine,
        precision=config.precision,
        resources=settings["runtime"],
        batch_size=config.batch_size,
        calibrated=None if config.calibrated is None else Path(config.calibrated).expanduser(),
        trusted_modules=settings["trusted_modules"],
        settings=settings,
    )


def build_adaptation(config: DictConfig, folder: Path) -> "AdaptationSetup":
    """Return the setup of ``python -m eldenet.adapt`` with depth frames.

    Raises:
        ValueError: a setting is wrong.
        FileNotFoundError: there are no such weights or frames.
    """
    if config.data.get("root") is None and config.data.name == "folder":
        raise ValueError(
            "give data.root=<folder with images/ and depths/>, or camera_height= with source= if you have no "
            "depth frames"
        )
    check_data_folders(config)
    _check_adaptation(config)
    from eldenet.training.adaptation import AdaptationSetup

    settings = _settings_in(folder, config)
    return AdaptationSetup(
        folder=folder,
        weights=str(config.weights),
        minutes=float(config.minutes),
        seed=config.seed,
        protocol=build_protocol(config),
        make_split=functools.partial(_split_for_weights, config),
        make_loss=functools.partial(instantiate, config.loss),
        make_trainer=functools.partial(_build_trainer, config),
        epochs=config.trainer.epochs,
        resources=settings["runtime"],
        trusted_modules=settings["trusted_modules"],
        settings=settings,
    )


def _split_for_weights(
    config: DictConfig,
    split: str,
    protocol: Any,
    input_size: Sequence[int] | None,
    canonical_focal: float | None,
    *,
    augment: bool = False,
) -> Any:
    """Build a split at the ``input_size`` [px] and for the canonical camera of weights."""
    of_weights = {
        "data": {"input_size": input_size and list(input_size)},
        "canonical_focal": canonical_focal,
    }
    with open_dict(config):
        fitted = OmegaConf.merge(config, of_weights)
    assert isinstance(fitted, DictConfig)
    return build_split(fitted, split, protocol, augment=augment, seed=config.seed)


def build_calibration(config: DictConfig, folder: Path) -> "CalibrationSetup":
    """Return the setup of ``python -m eldenet.adapt`` with the camera's height.

    Raises:
        ValueError: a setting is wrong.
        FileNotFoundError: there are no such weights or pictures.
    """
    _check_adaptation(config)
    if config.source is None:
        raise ValueError(
            "give source=<folder of pictures, or video>: camera_height needs frames of your camera"
        )
    camera = _camera(config)
    if camera is None:
        raise ValueError(
            "give intrinsics=[fx,fy,cx,cy] of the source's pictures [px]: the floor's height needs them"
        )
    height, pitch = config.camera_height, config.camera_pitch
    if not isinstance(height, int | float):
        raise ValueError(f"camera_height={height}: give a number of meters")
    if pitch is not None and not (isinstance(pitch, int | float) and -90 < pitch < 90):
        raise ValueError(f"camera_pitch={pitch}: give degrees below the horizon, between -90 and 90, or null")
    if not (isinstance(config.frames, int) and config.frames >= 1):
        raise ValueError(f"frames={config.frames}: give a whole number above 0")
    from eldenet.deploy.prediction import find_source

    settings = _settings_in(folder, config)
    source = find_source(str(config.source), folder, None)
    if source.is_live:
        raise ValueError(f"source={config.source}: give a folder of pictures or a video file, not a camera")
    from eldenet.perception.camera_height import CalibrationSetup

    return CalibrationSetup(
        folder=folder,
        weights=str(config.weights),
        source=source,
        intrinsics=camera,
        camera_height=float(height),
        camera_pitch=None if pitch is None else math.radians(pitch),
        frames=config.frames,
        seed=config.seed,
        resources=settings["runtime"],
        trusted_modules=settings["trusted_modules"],
        settings=settings,
    )


def _check_adaptation(config: DictConfig) -> None:
    """Check what both kinds of adaptation read.

    Raises:
        ValueError: a setting is wrong, or the weights are not trained.
        FileNotFoundError: there are no such weights.
    """
    find_checkpoint(str(config.weights), "weights", trained=True)
    if not (isinstance(config.minutes, int | float) and 0 < config.minutes < math.inf):
        raise ValueError(f"minutes={config.minutes}: give a number above 0")


# --- predict, export, demo, benchmark -----------------------------------------------------------------------


def build_prediction(config: DictConfig) -> "PredictionSetup":
    """Return the setup of ``python -m eldenet.predict``; all else is checked before torch is loaded.

    Raises:
        ValueError: a setting or the source is wrong.
        FileNotFoundError: there is no such source.
    """
    from eldenet.data.kitti_calibration import object_camera
    from eldenet.deploy import runtimes
    from eldenet.deploy.lens import needs_lens
    from eldenet.deploy.outputs import ENDING, Results
    from eldenet.deploy.prediction import PredictionSetup, find_source
    from eldenet.deploy.viewer import check_installed
    from eldenet.geometry import focal_of_fov
    from eldenet.results.fingerprints import fingerprint

    if config.checkpoint is None:
        config.checkpoint = BEST
    check_sources(config, "checkpoint")
    checkpoint, engine = str(config.checkpoint), str(config.engine)
    one_of("engine", engine, ("auto", *runtimes.RUNTIMES))
    one_of("on_error", str(config.on_error), ("stop", "skip"))
    _check_types(config, PredictionSetup, "frames", "focal", "fov", "max_side", "steady", "sharp")
    _check_types(config, Results, "overwrite")
    if type(config.boxes) is not bool:
        raise ValueError(f"boxes={config.boxes}: give true or false")
    wait = config.camera_timeout
    if wait is not None and not (isinstance(wait, int | float) and 0 < wait <= threading.TIMEOUT_MAX):
        raise ValueError(f"camera_timeout={wait}: give seconds above 0, or null to wait forever")
    camera = _camera(config)
    given = [name for name in ("intrinsics", "focal", "fov") if config[name] is not None]
    if len(given) > 1:
        raise ValueError(f"{' and '.join(given)} are given: give only one of them")
    if config.focal is not None and not config.focal > 0:
        raise ValueError(f"focal={config.focal}: give fx of the source's pictures in pixels, above 0")
    if config.fov is not None:
        focal_of_fov(config.fov, 1)
    span = _numbers(config, "depth_range", "[near, far] in meters")
    if span and not 0 <= span[0] < span[1]:
        raise ValueError(f"depth_range={list(span)}: give [near, far] in meters, 0 <= near < far")
    size = _size(config, "input_size")
    output = Path(config.output).expanduser()
    source = find_source(str(config.source), output, config.frames)
    with_points = camera is not None and not config.boxes
    formats = ["color"] if source.is_video else ["depth", "color", *["ply"] * with_points]
    if config.formats is not None:
        formats = [str(name) for name in listed(config.formats)]
    for name in formats:
        if name == "colour":
            raise ValueError("formats: 'colour' is now called 'color'")
        one_of("formats", name, tuple(ENDING))
    if not formats:
        raise ValueError(f"formats is empty: give at least one of {', '.join(ENDING)}")
    if not given and (config.boxes or "ply" in formats):
        needs_lens("boxes" if config.boxes else "point clouds", list(source.names), is_video=source.is_video)
    results = Results(
        output,
        tuple(formats),
        (span[0], span[1]) if span else None,
        config.overwrite,
        one_size=camera is not None,
    )
    recording = None
    if config.viewer is not None:
        one_of("viewer", str(config.viewer), ("rerun",))
        check_installed()
        recording = output / "predict.rrd"
        results.refuse_to_overwrite([], [recording])
    if not (config.boxes or recording or source.is_live):
        deciding = ("checkpoint", "source", "engine", "input_size", "max_side", "depth_range", "sharp")
        results.settings = {name: str(config[name]) for name in (*deciding, "intrinsics", "focal", "fov")}
        results.settings |= {"formats": formats, "weights": fingerprint(checkpoint)}
    files = [file for name in source.names.values() for file in results.files(name, is_video=source.is_video)]
    results.refuse_to_overwrite(list(map(Path, source.names)), files)
    boxes = None
    if config.boxes:
        of_kitti = not given and not source.is_video and all(map(object_camera, map(Path, source.names)))
        boxes = _build_boxes(config, of_kitti=of_kitti, is_video=source.is_video)
    exported = find_checkpoint(checkpoint, "checkpoint").kind == "exported"
    by_torch = not exported and engine in ("auto", *runtimes.TORCH)
    return _filled(
        PredictionSetup,
        config,
        source=source,
        results=results,
        resources=choose_resources(**plain(config.runtime), for_torch=by_torch),
        input_size=size,
        intrinsics=camera,
        boxes=boxes,
        recording=recording,
        skip_unreadable=config.on_error == "skip",
    )


def _build_boxes(config: DictConfig, *, of_kitti: bool, is_video: bool) -> Callable[..., Any]:
    """Return what adds 3D boxes to the results of ``predict``: detector, lifter and, for a video, tracker.

    ``of_kitti``: all pictures have KITTI's calibration, so their camera's height is known.

    Raises:
        ValueError: no detector was given, or not as a file's path.
    """
    from eldenet.data.kitti_calibration import CAMERA_HEIGHT
    from eldenet.perception.box_results import box_results
    from eldenet.perception.scene import Perception

    if isinstance(config.perception.detector, str):
        raise ValueError(
            f"perception.detector={config.perception.detector}: give the file as perception.detector.path"
        )
    if config.perception.detector.get("path", "") is None:
        raise ValueError(
            "boxes need a detector: give perception.detector.path=<file>.onnx, see docs/boxes.md"
        )
    detector = instantiate(config.perception.detector)
    lifter = instantiate(config.perception.lifter)
    tracker = instantiate(config.perception.tracker) if is_video else None
    if of_kitti and lifter.camera_height is None:
        lifter.camera_height = CAMERA_HEIGHT
    perception = Perception(None, detector, lifter, None, tracker=tracker)
    by_depth = config.perception.lifter.get("method") != "no_depth"
    return functools.partial(box_results, perception, is_video=is_video, check_sizes=by_depth)


def build_export(config: DictConfig) -> "ExportSetup":
    """Return the setup of ``python -m eldenet.export``.

    Raises:
        ValueError: a setting is wrong.
    """
    from eldenet.deploy.exporting import ENDINGS, PRECISIONS, ExportSetup

    kind, precision = str(config.format), str(config.precision)
    one_of("format", kind, tuple(ENDINGS))
    if precision not in PRECISIONS[kind]:
        raise ValueError(
            f"precision={precision}: for format={kind} choose from {', '.join(PRECISIONS[kind])}"
            + ("; for bf16 give format=openvino" if precision == "bf16" else "")
        )
    _check_types(
        config, ExportSetup, "batch", "opset", "overwrite", "pictures", "calibration", "checks", "license"
    )
    for name in ("calibration", "checks"):
        if config[name] < 1:
            raise ValueError(f"{name}={config[name]}: give the number of pictures, 1 or more")
    output = None if config.output is None else Path(config.output).expanduser()
    if output is not None and output.suffix != ENDINGS[kind]:
        raise ValueError(f"output={output}: format={kind} needs a name that ends in {ENDINGS[kind]}")
    check_sources(config, "checkpoint")
    return _filled(
        ExportSetup, config, size=_size(config, "size"), camera=_size(config, "camera"), output=output
    )


def build_demo(config: DictConfig) -> "DemoSetup":
    """Return the setup of ``eldenet demo``.

    Raises:
        ValueError: a setting is wrong.
    """
    check_sources(config, "checkpoint")
    if type(config.port) is not int or not 0 <= config.port <= 65535:
        raise ValueError(f"port={config.port}: give a number from 0 (any free port) to 65535")
    from eldenet.data.paths import default_cache
    from eldenet.deploy.demo import DemoSetup

    _check_types(config, DemoSetup, "serve", "browser")
    output = default_cache() / "demo" if config.output is None else Path(config.output).expanduser()
    trusted = tuple(listed(config.trusted_modules))
    return _filled(DemoSetup, config, size=_size(config, "size"), output=output, trusted_modules=trusted)


def build_benchmark(config: DictConfig) -> "BenchmarkSetup":
    """Return the setup of ``python -m eldenet.benchmark``.

    Raises:
        ValueError: a setting is wrong.
    """
    from eldenet.deploy.runtimes import PRECISIONS, RUNTIMES
    from eldenet.evaluation.metric_names import METRICS

    several = ("batches", "runtimes", "precisions", "threads", "accuracies", "trusted_modules")
    lists = {name: tuple(listed(config[name])) for name in several}
    for runtime in lists["runtimes"]:
        one_of("runtimes", runtime, RUNTIMES)
    for precision in lists["precisions"]:
        one_of("precisions", precision, PRECISIONS)
    if config.rounds < 1:
        raise ValueError(f"rounds={config.rounds}: give 1 or more")
    sizes = plain(config.sizes)
    if not all(isinstance(size, list) and [type(side) for side in size] == [int, int] for size in sizes):
        raise ValueError(f"sizes={sizes}: give [[height, width], ...] in pixels")
    one_of("accuracy", str(config.accuracy), METRICS)
    models = list_models() if config.models is None else listed(config.models)
    for model in models:
        find_checkpoint(str(model), "models")
    from eldenet.deploy.benchmarking.run import BenchmarkSetup

    return _filled(
        BenchmarkSetup,
        config,
        **lists,
        models=tuple(map(str, models)),
        sizes=tuple(map(tuple, sizes)),
        output=Path(config.output).expanduser(),
        composition=training_composition(lists["trusted_modules"]),
    )


# --- navigate -----------------------------------------------------------------------------------------------


def build_navigation(config: DictConfig, folder: Path) -> "ModeSetup":
    """Return the setup of the mode that ``python -m eldenet.navigate`` was composed for."""
    from eldenet.navigation.policy_files import policy_files

    settings = plain(config)
    policy_files((settings.get("policy") or {}).get("path"))
    from eldenet.navigation import modes
    from eldenet.navigation.episodes import EpisodeSettings
    from eldenet.navigation.latency import Predictive

    names = ("physics", "goal", "time_limit", "seed", "range_filter", "range_scale")
    episode = {name: settings[name] for name in names if name in settings}
    episode |= {f"robot_{name}": value for name, value in settings.get("robot", {}).items()}
    check_arguments(EpisodeSettings, episode)
    common: dict[str, Any] = {
        "mode": config.mode,
        "folder": folder,
        "threads": config.runtime.threads,
        "make_sensor": functools.partial(instantiate, config.sensor),
        "episode": EpisodeSettings(**episode),
        "settings": settings,
    }
    if config.mode == "train":
        make_learner = functools.partial(_build_learner, config)
        return modes.TrainSetup(**common, make_learner=make_learner, validate=config.training.validate)
    densities = listed(config.density)
    if any(type(density) is not int for density in densities):
        raise ValueError(f"density={config.density}: give a whole number, or a list of them")
    counted = ("pedestrians", "world", "episodes", "robots")
    check_arguments(
        modes.RecordSetup if config.mode == "record" else modes.EvaluationSetup,
        {name: settings[name] for name in counted if name in settings},
    )
    policy = instantiate(config.policy)
    late = config.sensor.latency if config.predict_latency else 0.0

    def make_policy(robots: int) -> Any:
        driver = policy(robots=robots)
        return Predictive(driver, late, robots) if late else driver

    common |= {
        "make_policy": make_policy,
        "split": config.split,
        "kind": config.arena.kind,
        "pedestrians": config.pedestrians,
    }
    if config.mode == "record":
        if len(densities) != 1:
            raise ValueError(f"density={densities}: mode=record only records one arena: give one number")
        extra = {name: settings[name] for name in ("world", "course", "video")}
        extra["arena_file"] = settings["arena"]["file"]
        return modes.RecordSetup(**common, density=densities[0], **extra)
    return modes.EvaluationSetup(
        **common, densities=densities, episodes=config.episodes, robots=config.robots
    )


def _build_learner(config: DictConfig, sensor: Any) -> Any:
    from eldenet.navigation.dqn import DQN
    from eldenet.navigation.env import ArenaNavVectorEnv
    from eldenet.navigation.episodes import Randomization

    settings = plain(config)
    if "policy" in settings and settings["policy"].get("path", "planner") is not None:
        raise ValueError(
            "mode=train trains a new driver: remove checkpoint=; policy may be paper_literal or paper_state"
        )

    env = ArenaNavVectorEnv(
        config.training.robots, sensor=sensor, arenas=instantiate(config.training.arenas),
        time_limit=config.time_limit, goal=config.goal,
        randomization=Randomization(**settings["training"]["randomize"]), **settings["observer"],
    )  # fmt: skip
    return DQN(env, instantiate(config.learner)(seed=config.seed))


# --- study and report ---------------------------------------------------------------------------------------


def training_composition(trusted_modules: Sequence[str] = ()) -> "Composition":
    """Return the functions that turn a study's overrides of ``eldenet.train`` into settings and networks.

    Args:
        trusted_modules: packages beyond eldenet whose code a study's settings may run.
    """
    from eldenet.results.studies.plan import Composition

    def build(model: Any) -> Any:
        with settings_of_a_study(trusted_modules):
            return build_model(model)

    return Composition(lambda overrides: plain(compose("train", overrides)), build)


def study_training(trusted_modules: Sequence[str] = ()) -> "Training":
    """Return how a study's runs are trained: as ``eldenet.train`` trains, but with its own code alone.

    Args:
        trusted_modules: packages beyond eldenet whose code a study's settings may run.
    """
    from eldenet.results.studies.runner import Training

    def train_run(overrides: Sequence[str], folder: Path) -> None:
        from eldenet.training.run import train

        with settings_of_a_study(trusted_modules):
            train(build_training(compose("train", overrides), folder))

    def check_finished(overrides: Sequence[str], stored: Path) -> None:
        from eldenet.training.resume import finished_run

        with settings_of_a_study(trusted_modules):
            finished_run(build_training(compose("train", overrides), stored))

    return Training(train_run, check_finished, training_composition(trusted_modules))


def build_study(config: DictConfig) -> "StudySetup":
    """Return the setup of ``python -m eldenet.study``: which runs are trained, and where."""
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


def build_report(config: DictConfig) -> "ReportSetup":
    """Return the setup of ``python -m eldenet.report``."""
    from eldenet.results.comparison import ReportSetup

    if config.study is not None:
        return ReportSetup(study=Path(config.study))
    return ReportSetup(
        runs=listed(config.runs),
        output=Path(config.output),
        columns=None if config.columns is None else listed(config.columns),
        costs=config.costs,
        names=[str(name) for name in listed(config.names)],
    )

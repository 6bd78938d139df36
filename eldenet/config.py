"""The one place where a config is composed; it leaves as plain objects, OmegaConf ends here."""

import functools
import logging
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from eldenet.deploy.scoring import EvaluationSetup
    from eldenet.perception.detector_training import DetectorTrainingSetup
    from eldenet.perception.scene import Perception
    from eldenet.training.setup import TrainingSetup

SPLITS = ("train", "val", "test")
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


def plain(config: Any, *, resolve: bool = True) -> Any:
    """Dicts, lists and values, resolved unless ``resolve`` is False; what ``run.json`` stores."""
    return OmegaConf.to_container(config, resolve=resolve) if OmegaConf.is_config(config) else config


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


# --- what commands are built from


def build_training(config: DictConfig, folder: Path) -> "TrainingSetup":
    """What ``python -m eldenet.train`` trains in ``folder``."""
    from eldenet.training.setup import TrainingSetup

    settings = plain(OmegaConf.merge(config, {"run_dir": str(folder)}))
    return TrainingSetup(
        folder=folder,
        name=config.model_name,
        seed=config.seed,
        data=config.data.name,
        input_size=settings["data"]["input_size"],
        protocol=build_protocol(config),
        make_split=functools.partial(build_split, config),
        make_model=functools.partial(instantiate, config.model),
        own_normalization=bool({"mean", "std"} & config.model.keys()),
        make_loss=functools.partial(instantiate, config.loss),
        make_trainer=functools.partial(_build_trainer, config),
        resources=settings["runtime"],
        normalization=settings["normalization"],
        weights=config.weights,
        teacher=config.teacher,
        ckpt_path=config.ckpt_path,
        trusted_modules=_named_modules(settings["model"]),
        settings=settings,
    )


def build_evaluation(config: DictConfig, folder: Path) -> "EvaluationSetup":
    """What ``python -m eldenet.evaluate`` scores, with its results in ``folder``."""
    from eldenet.deploy.scoring import EvaluationSetup

    settings = plain(OmegaConf.merge(config, {"run_dir": str(folder)}))
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
        trusted_modules=settings["trusted_modules"],
        settings=settings,
    )


def build_train_detector(config: DictConfig, folder: Path) -> "DetectorTrainingSetup":
    """What ``python -m eldenet.train_detector`` trains in ``folder``.

    Raises:
        ValueError: the folder holds another run already, or libreyolo is missing.
    """
    from eldenet.perception.detector_training import DetectorTrainingSetup
    from eldenet.perception.libreyolo_detector import YoloTraining
    from eldenet.simulation.street_views import NAMES
    from eldenet.system.resources import choose_resources

    settings = plain(OmegaConf.merge(config, {"run_dir": str(folder)}))
    if (folder / "train").exists() and not config.resume:
        raise ValueError(f"run_dir={folder} holds a training already: give another run_dir, or resume=true")
    resources = choose_resources(**settings["runtime"])
    return DetectorTrainingSetup(
        folder=folder,
        detector=instantiate(config.detector, names=settings["detector"]["names"] or list(NAMES)),
        training=YoloTraining(
            **settings["training"], workers=resources.workers, device=resources.device, seed=config.seed
        ),
        data=Path(settings["data"]["root"]),
        kinds=listed(config.data.kinds),
        counts={split: config.data[split] for split in ("train", "test")},
        resources=resources,
        resume=config.resume,
        settings=settings,
    )


def build_perception(config: DictConfig, intrinsics: Any, *, is_video: bool) -> "Perception":
    """Detector, lifter and, for a video, tracker of ``python -m eldenet.predict boxes=true``.

    Raises:
        ValueError: intrinsics or detector are missing.
    """
    from eldenet.geometry import PinholeCamera
    from eldenet.perception.scene import Perception

    if intrinsics is None:
        raise ValueError("boxes need the camera: give intrinsics=[fx,fy,cx,cy] of the pictures [px]")
    if config.perception.detector.get("path", "") is None:
        raise ValueError(
            "boxes need a detector: give perception.detector.path=<file>.onnx, see docs/boxes.md"
        )
    detector = instantiate(config.perception.detector)
    lifter = instantiate(config.perception.lifter)
    tracker = instantiate(config.perception.tracker) if is_video else None
    return Perception(None, detector, lifter, PinholeCamera(intrinsics), tracker=tracker)


def _build_trainer(config: DictConfig) -> Any:
    optimizer, scheduler = instantiate(config.optimizer), instantiate(config.scheduler)
    return instantiate(config.trainer, optimizer=optimizer, scheduler=scheduler, seed=config.seed)


def _named_modules(settings: Any) -> list[str]:
    """Modules that the user's own settings name: these are trusted, a downloaded config's are not."""
    if not isinstance(settings, dict):
        return []
    named = [str(settings["_target_"]).rpartition(".")[0]] if "_target_" in settings else []
    return named + [module for value in settings.values() for module in _named_modules(value)]


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
        frames: of rendered scenes, so many of the split's first frames instead of its own choice.
    """
    from eldenet.data.base import Compose
    from eldenet.evaluation.protocol_frames import frame_geometry

    node = _split_node(config, split)
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
                "%s: resize_on_load and cache are off, as protocol %s resizes or crops the frames first",
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
    if score or split != "train":  # the protocol alone says what is scored
        protocol.check_ground_truth(dataset.ground_truth)
        dataset.min_depth, dataset.max_depth = protocol.min_depth, protocol.max_depth
    if dataset.on_error == "skip":
        dataset.leave_out_unreadable()
    places = config.data.get("subset", {}).get(split)
    if places is not None and frames is None:
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


def build_check_data(config: DictConfig) -> Any:
    """The :class:`~eldenet.data.inspection.CheckDataSetup` of ``check_data``.

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
    subset = plain(config.data.get("subset")) or {}
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
            dataset.draw_subset(subset[split], config.data.subset_seed)
        return dataset

    return CheckDataSetup(
        folder=Path(config.run_dir).expanduser(),
        name=config.data.name,
        config=plain(config.data),
        splits={split: partial(open_split, split) for split in nodes if split not in same},
        same=same,
        check_ground_truth=build_protocol(config).check_ground_truth,
        frames=config.frames,
        samples=config.samples,
    )

"""What a training is made of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eldenet.data.base import DepthDataset
    from eldenet.evaluation.protocol import EvalProtocol
    from eldenet.losses.base import WeightedSum
    from eldenet.model import DepthNet
    from eldenet.training.trainer import Trainer


@dataclass(frozen=True)
class TrainingSetup:
    """Everything that a training is made of, as plain objects; ``config.build_training`` makes it.

    Attributes:
        folder: of the run.
        name: of the row in tables.
        seed: of weights, order and augmentation.
        data: name of the data set.
        input_size: ``(height, width)`` [px] that the network sees; None: the frames' own.
        protocol: of validation and test.
        make_split: as :func:`eldenet.config.build_split` without its config.
        make_model: keywords of :class:`~eldenet.model.DepthNet` -> the network, freshly initialized.
        own_normalization: whether the network's settings name a mean or standard deviation.
        make_loss: builds what is minimized, a teacher included.
        make_trainer: builds the trainer.
        resources: arguments of :func:`~eldenet.system.resources.choose_resources`.
        process_timeout: seconds to wait for another process's answer.
        normalization: as :func:`~eldenet.training.normalization.normalization` takes it.
        weights: what the network starts from: run folder, saved model, Hub id or packaged weights.
        teacher: what the loss distills from.
        ckpt_path: checkpoint or run folder to resume; "auto": this folder's, if there is one.
        trusted_modules: modules whose classes the user's own settings name.
        settings: the resolved settings, which ``run.json`` stores.
        loggers: that show the pictures of the final scores.
        overrides: what the command line set, such as ``loss=l1``; rows of a sweep are named by them.
    """

    folder: Path
    name: str
    seed: int
    data: str
    input_size: Sequence[int] | None
    protocol: "EvalProtocol"
    make_split: Callable[..., "DepthDataset"]
    make_model: Callable[..., "DepthNet"]
    own_normalization: bool
    make_loss: Callable[[], "WeightedSum"]
    make_trainer: Callable[[], "Trainer"]
    resources: Mapping[str, Any]
    process_timeout: float
    normalization: str | Mapping[str, Any]
    weights: str | None
    teacher: str | None
    ckpt_path: str | None
    trusted_modules: Sequence[str]
    settings: Mapping[str, Any]
    overrides: Sequence[str] = ()
    loggers: Sequence[str] = ()

"""Where the curves and pictures of a run go: TensorBoard, MLflow, Weights & Biases, Trackio.

Each library is imported when a run logs to it. MLflow and Weights & Biases follow their own environment
variables (``MLFLOW_TRACKING_URI``, ``WANDB_MODE=offline``); without them MLflow writes into the run folder.
A resumed run goes on where it stopped.
"""

import os
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from eldenet.system.extras import require

PROJECT = "eldenet"


class Logger(Protocol):
    """Takes what a training measures."""

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Log values by name."""

    def picture(self, name: str, step: int, picture: np.ndarray) -> None:
        """Log a picture ``(H, W, 3)`` uint8."""

    def close(self) -> None:
        """End the run's log; what it holds is written."""


class TensorBoard:
    """Event files in ``<folder>/tensorboard``, without a killed process's points from ``first_step`` on."""

    def __init__(self, folder: Path, first_step: int | None) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.writer = SummaryWriter(str(folder / "tensorboard"), purge_step=first_step)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Log values by name."""
        for name, value in values.items():
            self.writer.add_scalar(name, value, step)

    def picture(self, name: str, step: int, picture: np.ndarray) -> None:
        """Log a picture ``(H, W, 3)`` uint8."""
        self.writer.add_image(name, picture, step, dataformats="HWC")

    def close(self) -> None:
        """Write what is held."""
        self.writer.close()


class MLflow:
    """A run of the experiment "eldenet": on the server of ``MLFLOW_TRACKING_URI``, else in a SQLite file."""

    def __init__(self, folder: Path, first_step: int | None) -> None:
        mlflow = _library("mlflow")
        own = f"sqlite:///{folder.resolve() / 'mlflow.db'}"
        self.client = mlflow.MlflowClient(tracking_uri=os.environ.get("MLFLOW_TRACKING_URI", own))
        self.folder = folder

        def start() -> str:
            found = self.client.get_experiment_by_name(PROJECT)
            files = None if "MLFLOW_TRACKING_URI" in os.environ else (folder / "mlflow").resolve().as_uri()
            experiment = found.experiment_id if found else self.client.create_experiment(PROJECT, files)
            return str(self.client.create_run(experiment, run_name=folder.name).info.run_id)

        self.run = _own_id(folder, "mlflow", start)

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Log values by name."""
        for name, value in values.items():
            self.client.log_metric(self.run, name, value, step=step)

    def picture(self, name: str, step: int, picture: np.ndarray) -> None:
        """Log a picture ``(H, W, 3)`` uint8."""
        from eldenet.visualization import write_picture

        file = self.folder / f"{name}.png"
        write_picture(file, picture)
        self.client.log_artifact(self.run, str(file))

    def close(self) -> None:
        """Mark the run as finished."""
        self.client.set_terminated(self.run)


class WandB:
    """A run of the project "eldenet" of Weights & Biases; ``WANDB_MODE=offline`` keeps it on this machine."""

    def __init__(self, folder: Path, first_step: int | None) -> None:
        wandb = _library("wandb")
        own = _own_id(folder, "wandb", lambda: os.urandom(4).hex())
        self.run = wandb.init(project=PROJECT, name=folder.name, dir=str(folder), id=own, resume="allow")
        self.image = wandb.Image

    def scalars(self, step: int, values: Mapping[str, float]) -> None:
        """Log values by name."""
        self.run.log(dict(values), step=step)

    def picture(self, name: str, step: int, picture: np.ndarray) -> None:
        """Log a picture ``(H, W, 3)`` uint8."""
        self.run.log({name: self.image(picture)}, step=step)

    def close(self) -> None:
        """Write or upload what is held."""
        self.run.finish()


class Trackio(WandB):
    """A run of the project "eldenet" of Trackio, on this machine; it has the interface of wandb."""

    def __init__(self, folder: Path, first_step: int | None) -> None:
        trackio = _library("trackio")
        name = _own_id(folder, "trackio", lambda: f"{folder.name}-{os.urandom(2).hex()}")
        self.run = trackio.init(project=PROJECT, name=name, resume="allow")
        self.image = trackio.Image


LOGGERS: Mapping[str, Callable[[Path, int | None], Logger]] = {
    "tensorboard": TensorBoard,
    "mlflow": MLflow,
    "wandb": WandB,
    "trackio": Trackio,
}


def _library(name: str) -> Any:
    """Import a logger's library."""
    require(f"logger={name}", name)
    return import_module(name)


def _own_id(folder: Path, logger: str, make: Callable[[], str]) -> str:
    """The run's id with a logger, kept in its folder, so that a resumed run has the same one."""
    file = folder / f"{logger}_id.txt"
    if not file.is_file():
        from eldenet.system.files import write_text

        folder.mkdir(parents=True, exist_ok=True)
        write_text(file, make())
    return file.read_text()

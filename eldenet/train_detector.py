"""``python -m eldenet.train_detector``: rendered scenes -> YOLOv9 -> a scored ONNX file."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point
from eldenet.config import build_train_detector

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("train_detector")
def main(config: "DictConfig", folder: Path) -> None:
    """Render, train, export, and score the exported file on held-out scenes."""
    from eldenet.perception.detector_training import train_detector

    train_detector(build_train_detector(config, folder))


if __name__ == "__main__":
    main()

"""``python -m eldenet.predict``: depth of a picture, a folder of pictures, a video, or a camera."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.config import build_prediction

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("predict")
def main(config: "DictConfig", folder: Path) -> None:
    """Predict and write; ``folder`` is not used, results go to ``output``."""
    from eldenet.deploy.prediction import predict

    if not config.boxes:
        refuse_unread(("perception",), "only boxes=true makes 3D boxes")
    try:
        predict(build_prediction(config))
    except KeyboardInterrupt:
        raise SystemExit(130) from None  # as shells count it


if __name__ == "__main__":
    main()

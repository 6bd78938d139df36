"""``python -m eldenet.adapt``: weights for your own camera, kept only if held-out frames are better."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.config import build_adaptation, build_calibration
from eldenet.system.files import sole_writer

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("adapt")
def main(config: "DictConfig", folder: Path) -> None:
    """Tune on depth frames, or fit the scale to the camera's height; write the model into ``folder``."""
    if config.camera_height is None:
        refuse_unread(("source", "frames", "camera_pitch"), "only camera_height= reads it")
        tuned = build_adaptation(config, folder)
        from eldenet.training.adaptation import adapt

        with sole_writer(folder):
            adapt(tuned)
    else:
        unread = ("data", "loss", "optimizer", "scheduler", "augmentation", "trainer", "protocol", "minutes")
        refuse_unread(unread, "camera_height fits the scale alone, from source=")
        scaled = build_calibration(config, folder)
        from eldenet.perception.camera_height import calibrate

        with sole_writer(folder):
            calibrate(scaled)


if __name__ == "__main__":
    main()

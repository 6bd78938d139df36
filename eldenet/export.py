"""``python -m eldenet.export``: a trained network as a file for other runtimes, checked against torch."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point
from eldenet.config import build_export

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("export")
def main(config: "DictConfig", folder: Path) -> None:
    """Export; ``folder`` is not used, the file goes to ``output``."""
    from eldenet.deploy.exporting import export

    export(build_export(config))


if __name__ == "__main__":
    main()

"""``python -m eldenet.demo``: a page that runs the network in the browser, on this machine alone."""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point
from eldenet.config import build_demo

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("demo")
def main(config: "DictConfig", folder: Path) -> None:
    """Build and serve; ``folder`` is not used, the page goes to ``output``."""
    setup = build_demo(config)
    from eldenet.deploy.demo import demo

    demo(setup)


if __name__ == "__main__":
    main()

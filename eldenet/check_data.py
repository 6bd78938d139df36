"""``python -m eldenet.check_data``: is the data set complete, and does it hold what its config says?"""

from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point
from eldenet.config import build_check_data

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("check_data")
def main(config: "DictConfig", folder: Path) -> None:
    """Check every split; exit code 1 if anything is wrong."""
    setup = build_check_data(config)
    from eldenet.results.data_check import check

    if not check(setup):
        raise SystemExit(1)


if __name__ == "__main__":
    main()

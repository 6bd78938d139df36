"""``python -m eldenet.navigate``: record, evaluate or train a driver; analyze failures; fit range noise."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point
from eldenet.config import build_navigation
from eldenet.renames import VALUES

if TYPE_CHECKING:
    from omegaconf import DictConfig

MODES = ("record", "evaluate", "analyze_failures", "fit_noise", "train")


@entry_point("navigate")
def run(config: "DictConfig", folder: Path) -> None:
    """Run the mode that the config was composed for; results go to ``folder``."""
    from eldenet.navigation.modes import run_mode

    run_mode(build_navigation(config, folder))


def main() -> None:
    """Run the command; an unknown mode ends in one line."""
    words = [word.removeprefix("mode=") for word in sys.argv[1:] if word.startswith("mode=")]
    for mode in ",".join(words).split(",") if words else []:
        if mode not in MODES:
            renamed = f"; {mode} is now {VALUES['mode', mode]}" if ("mode", mode) in VALUES else ""
            print(f"error: mode={mode}: choose one of {', '.join(MODES)}{renamed}", file=sys.stderr)  # noqa: T201
            sys.exit(1)
    run()


if __name__ == "__main__":
    main()

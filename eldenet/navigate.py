"""``python -m eldenet.navigate``: record, evaluate or train a driver."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.config import build_navigation
from eldenet.system.extras import require

if TYPE_CHECKING:
    from omegaconf import DictConfig

MODES = ("record", "evaluate", "train")


def main() -> None:
    """Run ``python -m eldenet.navigate``."""
    check_mode(sys.argv[1:])
    run()


@entry_point("navigate")
def run(config: "DictConfig", folder: Path) -> None:
    """Run the mode that the config was composed for; results go to ``folder``."""
    file, course = config.get("arena", {}).get("file"), config.get("course")
    if file is not None or course is not None:
        given = f"course={course}" if file is None else f"arena.file={file}"
        unread = ("density", "pedestrians", "world", "split", "arena.kind")
        refuse_unread(unread, f"not read with {given}, which describes the whole arena; leave it out")
    if config.mode == "train":
        require("mode=train", "gymnasium")
    if config.get("video") == "mp4":
        require("video=mp4", "av")
    setup = build_navigation(config, folder)
    from eldenet.navigation.modes import run_mode

    run_mode(setup)


def check_mode(words: Sequence[str]) -> None:
    """Exit with a one-line error for an unknown mode."""
    for word in words:
        for mode in word.removeprefix("mode=").split(",") if word.startswith("mode=") else []:
            if mode not in MODES:
                print(f"error: mode={mode}: choose one of {', '.join(MODES)}", file=sys.stderr)  # noqa: T201
                sys.exit(1)


if __name__ == "__main__":
    main()

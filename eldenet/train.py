"""``python -m eldenet.train``: train, score the best epoch, write ``run.json`` and show the table."""

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.cli.entry_point import entry_point, given_settings
from eldenet.config import build_training
from eldenet.system.signals import as_ctrl_c

if TYPE_CHECKING:
    from omegaconf import DictConfig


@entry_point("train")
def main(config: "DictConfig", folder: Path) -> float:
    """Train in ``folder``; the best value of ``trainer.monitor`` is what a sweep may optimize."""
    with as_ctrl_c():
        try:
            from eldenet.training.run import train

            setup = build_training(config, folder, list(given_settings().values()))
            return train(setup)
        except KeyboardInterrupt:
            status: str | int | None = 130  # as shells count it
        except SystemExit as end:  # of a signal
            status = end.code
    print(f"stopped; to continue: {resume_command(folder)}", file=sys.stderr)  # noqa: T201
    raise SystemExit(status)


def resume_command(folder: Path) -> str:
    """Return the command line that continues the training in ``folder``."""
    own = ("output", "run_dir", "ckpt_path")
    words = [word for key, word in given_settings().items() if key not in own]
    start = sys.argv[0] if sys.argv[0].startswith("eldenet ") else "python -m eldenet.train"
    return f"{start} {shlex.join([*words, f'output={folder}', 'ckpt_path=auto'])}"


if __name__ == "__main__":
    main()

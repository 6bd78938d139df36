"""A command of ours: Hydra's command line, errors that a user can act on, what was set and what was meant."""

import functools
import logging
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig, MissingMandatoryValue

from eldenet.cli.help import explained
from eldenet.config import USER_ERRORS, config_folder


def entry_point(config_name: str) -> Callable[[Callable[[DictConfig, Path], Any]], Callable[[], Any]]:
    """Make ``main(config, run_folder)`` a command with Hydra's command line.

    A user's mistake (a wrong value, a missing file) ends in one line and exit code 1; ``hydra.verbose=true``
    shows its traceback. Anything else is our bug and shows its traceback. In a sweep the other jobs go on.
    """

    def decorate(main: Callable[[DictConfig, Path], Any]) -> Callable[[], Any]:
        @functools.wraps(main)
        def task(config: DictConfig) -> Any:
            hydra_config = HydraConfig.get()
            folder = Path(hydra_config.runtime.output_dir)
            sweep = hydra_config.mode == RunMode.MULTIRUN
            try:
                if sweep and any(word.startswith("run_dir=") for word in hydra_config.overrides.task):
                    raise ValueError(
                        "run_dir is the folder of a single run: give a sweep's as hydra.sweep.dir=..., and "
                        "each job's name in it as hydra.sweep.subdir=..."
                    )
                return main(config, folder)
            except MissingMandatoryValue as error:
                print(f"error: give {error.full_key}=... on the command line", file=sys.stderr)  # noqa: T201
                if sweep:
                    raise
                raise SystemExit(1) from None
            except USER_ERRORS as error:
                logging.getLogger("eldenet").debug("", exc_info=True)
                print(f"error: {error}", file=sys.stderr)  # noqa: T201
                if sweep:
                    raise  # Hydra notes it, runs the other jobs and fails at the end
                raise SystemExit(1) from None
            finally:
                if not sweep and "run_dir" not in given_settings() and folder != Path.cwd():
                    with suppress(OSError):
                        folder.rmdir()  # Hydra made it; a mistake leaves it empty

        parsed = hydra.main(version_base="1.3", config_path=str(config_folder()), config_name=config_name)
        return explained(config_name, sys.modules[main.__module__].__doc__ or "")(parsed(task))

    return decorate


def given_settings(overrides: Sequence[str] | None = None) -> dict[str, str]:
    """What the command line set, ``{"policy.walkers": "policy.walkers=true"}``.

    A composed config does not tell it from the defaults.

    Args:
        overrides: as typed; None: those of the command, or of the sweep's job, that runs.
    """
    if overrides is None:
        overrides = HydraConfig.get().overrides.task
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return {override.key_or_group: str(override.input_line) for override in parsed}


def refuse_unread(names: Sequence[str], because: str) -> None:
    """Raise ValueError if the command line sets one of these, or a part of it, which nothing would read."""
    unread = [key for key in given_settings() if key.partition(".")[0] in names]
    if unread:
        raise ValueError(f"{', '.join(unread)}: {because}")

"""The entry point of every command: Hydra's command line, and errors that a user can act on."""

import functools
import logging
import os
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import StringIO
from pathlib import Path
from typing import Any, TypeVar

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from eldenet.cli.help import advice, help_template, quote_paths
from eldenet.compose import command_of, config_folder, register, resolver, to_settings
from eldenet.system.errors import FULL, USER_ERRORS, line_of
from eldenet.system.extras import require_for_parts

S = TypeVar("S")
QUIET = ("-h", "--help", "--hydra-help", "-c", "--cfg", "-sc", "--shell-completion", "-i", "--info")


def entry_point(settings: type[S]) -> Callable[[Callable[[S], Any]], Callable[[], None]]:
    """Make ``main(settings)`` a command with Hydra's command line; ``settings``: its dataclass.

    A user's mistake (a wrong value, a missing file) ends in one line and exit code 1; ``hydra.verbose=true``
    shows its traceback. Any other error is a bug and shows its traceback. A sweep continues with its other
    jobs.
    """
    register(settings)
    config_name = command_of(settings)

    def decorate(main: Callable[[S], Any]) -> Callable[[], None]:
        composed = False
        held, stderr = StringIO(), sys.stderr  # Hydra's own lines, which ours replace where there is one

        @functools.wraps(main)
        def task(config: DictConfig) -> Any:
            nonlocal composed
            composed = True
            release()
            return _run(main, config)

        def release() -> None:
            sys.stderr = stderr
            stderr.write(held.getvalue())
            held.truncate(0)
            held.seek(0)

        @functools.wraps(main)
        def command() -> None:
            nonlocal stderr
            stderr = sys.stderr
            about = sys.modules[main.__module__].__doc__ or ""
            resolver("command_help")(lambda: help_template(settings, about))
            words = sys.argv[1:] = quote_paths(sys.argv[1:])
            if stderr.isatty() and not any(word in QUIET for word in words):
                stderr.write(f"eldenet {config_name} starts ...\r")  # at once: the imports take seconds
                stderr.flush()
            decorated = hydra.main(
                version_base="1.3", config_path=str(config_folder()), config_name=config_name
            )
            try:
                sys.stderr = held
                decorated(task)()
                sys.stdout.flush()
            except SystemExit as end:
                failed = end.__context__
                if isinstance(failed, OSError) and not isinstance(failed, HydraException) and not composed:
                    held.truncate(0)
                    held.seek(0)
                    sys.stderr = stderr
                    _print_error(line_of(failed))
                    raise
                may_be_unknown = not composed or any(word.startswith("+") for word in words)
                line = advice(config_name, words) if end.code and may_be_unknown else ""
                if line := line or (_in_one_line(held.getvalue()) if end.code and not composed else ""):
                    held.truncate(0)
                    sys.stderr = stderr
                    _print_error(line)
                raise
            except BrokenPipeError:  # as after `| head`
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for Python's last flush
            finally:
                release()

        return command

    return decorate


def _run(main: Callable[[S], Any], config: DictConfig) -> Any:
    """Run a job and turn a user's mistake into one line."""
    hydra_config = HydraConfig.get()
    folder = Path(hydra_config.runtime.output_dir)
    sweep = hydra_config.mode == RunMode.MULTIRUN
    threading.excepthook = _thread_failed
    try:
        require_for_parts(OmegaConf.to_container(config))
        # a command with a run folder, which a sweep numbers: 0, 1, ...
        changes = {} if hydra_config.run.dir == "." else {"output": str(folder)}
        return main(to_settings(config, **changes))
    except USER_ERRORS as error:
        if isinstance(error, BrokenPipeError):
            raise
        logging.getLogger("eldenet").debug("", exc_info=True)
        _print_error(line_of(error))
        if sweep:
            raise  # Hydra runs the other jobs and fails at the end
        raise SystemExit(1) from None
    finally:
        if not (sweep or "output" in given_settings()) and folder != Path.cwd():
            with suppress(OSError):
                folder.rmdir()  # Hydra made it; a mistake leaves it empty


def _in_one_line(text: str) -> str:
    """Return what Hydra or argparse said about the command line as one line; "" for a traceback."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and "HYDRA_FULL_ERROR" not in line]
    if text.startswith("usage:"):
        lines = [lines[-1].partition("error: ")[2], "(--help shows what there is)"]
    return "" if "Traceback" in text else " ".join(lines)


def _thread_failed(failed: threading.ExceptHookArgs) -> None:
    """Keep quiet about a full disk in a thread: TensorBoard raises the error again in the main thread."""
    error = failed.exc_value
    if not (isinstance(error, OSError) and error.errno in FULL):
        threading.__excepthook__(failed)


def _print_error(line: str) -> None:
    print(f"error: {line}", file=sys.stderr)  # noqa: T201


def given_settings(overrides: Sequence[str] | None = None) -> dict[str, str]:
    """Return what the command line sets, as ``{"policy.walkers": "policy.walkers=true"}``.

    Args:
        overrides: as typed; None: those of the running command or job of a sweep.
    """
    if overrides is None:
        overrides = HydraConfig.get().overrides.task
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return {override.key_or_group: str(override.input_line) for override in parsed}


def refuse_unread(names: Sequence[str], because: str) -> None:
    """Raise ``ValueError`` if the command line sets one of these settings, or a part of one."""
    unread = [key for key in given_settings() if key in names or key.partition(".")[0] in names]
    if unread:
        raise ValueError(f"{', '.join(unread)}: {because}")

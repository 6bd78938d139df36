"""The entry point of every command: Hydra's command line, and errors that a user can act on."""

import functools
import logging
import re
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, suppress
from io import StringIO
from pathlib import Path
from typing import Any, TypeVar

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from eldenet.cli.help import advice, comment_on, help_template, quote_paths, wrong_option
from eldenet.compose import command_of, config_folder, register, resolver, to_settings
from eldenet.system.errors import FULL, USER_ERRORS, line_of
from eldenet.system.extras import require_for_parts
from eldenet.system.terminal import log_in_lines, print_error, terminal

S = TypeVar("S")
MISSING = re.compile(r"give ([\w.]+)=\.\.\. on the command line")
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
        @functools.wraps(main)
        def command() -> None:
            about = sys.modules[main.__module__].__doc__ or ""
            resolver("command_help")(lambda: help_template(settings, about))
            # options first: argparse takes the settings from one place only, as in train data=x -m seed=0,1
            words = sorted(quote_paths(sys.argv[1:]), key=lambda word: word[:1] != "-" and "=" in word)
            words = ["--help"] if {"-h", "--help"} & set(words) else words  # it is the same for all settings
            sys.argv[1:] = words
            with terminal():
                if any(word.startswith("+") for word in words) and (line := advice(config_name, words)):
                    print_error(line)
                    raise SystemExit(1)
                if sys.stderr.isatty() and not any(word in QUIET for word in words):
                    sys.stderr.write(f"eldenet {config_name} starts ...\r")  # at once: imports take seconds
                    sys.stderr.flush()
                _start(main, config_name, words)

        return command

    return decorate


def _start(main: Callable[[S], Any], config_name: str, words: Sequence[str]) -> None:
    """Let Hydra compose the settings and run the job or jobs; where it fails, one line says what to do."""
    stderr, hydras_lines = sys.stderr, StringIO()
    raised: list[Exception] = []  # by jobs

    @functools.wraps(main)
    def task(config: DictConfig) -> Any:
        with redirect_stderr(stderr):
            try:
                return _run(main, config)
            except Exception as error:
                raised.append(error)
                raise

    decorated = hydra.main(version_base="1.3", config_path=str(config_folder()), config_name=config_name)
    try:
        with redirect_stderr(hydras_lines):
            decorated(task)()
    except SystemExit as end:
        failed, text = end.__context__, hydras_lines.getvalue()
        of_a_job = any(failed is error for error in raised)
        if not end.code or (of_a_job and not isinstance(failed, USER_ERRORS)):  # a bug shows its traceback
            stderr.write(text)
        elif of_a_job or not text:
            pass  # said where it happened
        elif text.startswith("usage:"):
            print_error(wrong_option(config_name, text.rstrip().rpartition("error: ")[2]))
        else:
            is_of_disk = isinstance(failed, OSError) and not isinstance(failed, HydraException)
            line = line_of(failed) if failed and is_of_disk else advice(config_name, words)
            print_error(line or _in_one_line(text, failed))
        raise
    except (HydraException, ValueError) as failed:  # before there is a job, as of --cfg job -m
        print_error(advice(config_name, words) or _in_one_line(str(failed), failed))
        raise SystemExit(1) from None
    stderr.write(hydras_lines.getvalue())


def _run(main: Callable[[S], Any], config: DictConfig) -> Any:
    """Run a job and turn a user's mistake into one line."""
    hydra_config = HydraConfig.get()
    folder = Path(hydra_config.runtime.output_dir)
    sweep = hydra_config.mode == RunMode.MULTIRUN
    threading.excepthook = _thread_failed
    log_in_lines()
    try:
        if empty := [word for word in given_settings().values() if word.endswith("=")]:
            raise ValueError(f"{empty[0]}: give a value, or leave it out")
        require_for_parts(OmegaConf.to_container(config))
        # a command with a run folder, which a sweep numbers: 0, 1, ...
        changes = {} if hydra_config.run.dir == "." else {"output": str(folder)}
        return main(to_settings(config, **changes))
    except BrokenPipeError:  # the reader left, as head does: end as the signal would
        raise SystemExit(128 + signal.SIGPIPE) from None
    except USER_ERRORS as error:
        logging.getLogger("eldenet").debug("", exc_info=True)
        missing = MISSING.fullmatch(line_of(error))
        comment = comment_on(OmegaConf.get_type(config) or dict, missing[1]) if missing else ""
        print_error(line_of(error) + (f": {comment}" if comment else ""))
        if sweep:
            raise  # Hydra runs the other jobs and fails at the end
        raise SystemExit(1) from None
    finally:
        if not (sweep or "output" in given_settings()) and folder != Path.cwd():
            with suppress(OSError):
                folder.rmdir()  # Hydra made it; a mistake leaves it empty


def _in_one_line(text: str, failed: BaseException | None) -> str:
    """Return what Hydra said about the command line, or the error where it said nothing in words."""
    if "Traceback" in text and failed is not None:
        return f"the settings cannot be read ({type(failed).__name__}: {failed}): --help shows what there is"
    return " ".join(text.partition("\nSet the environment variable")[0].split())


def _thread_failed(failed: threading.ExceptHookArgs) -> None:
    """Keep quiet about a full disk in a thread: TensorBoard raises the error again in the main thread."""
    error = failed.exc_value
    if not (isinstance(error, OSError) and error.errno in FULL):
        threading.__excepthook__(failed)


def given_settings() -> dict[str, str]:
    """Return what the running command or job sets, as ``{"policy.walkers": "policy.walkers=true"}``."""
    overrides = HydraConfig.get().overrides.task if HydraConfig.initialized() else ()
    parsed = OverridesParser.create().parse_overrides(list(overrides))
    return {override.key_or_group: str(override.input_line) for override in parsed}


def refuse_unread(names: Sequence[str], because: str) -> None:
    """Raise ``ValueError`` if the command line sets one of these settings, or a part of one."""
    unread = [key for key in given_settings() if any(f"{key}.".startswith(f"{name}.") for name in names)]
    if unread:
        raise ValueError(f"{', '.join(unread)}: {because}")

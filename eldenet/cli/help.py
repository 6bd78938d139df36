"""What a command says of itself: its help, and what was probably meant by a setting that it does not have."""

import difflib
import functools
import os
import re
import sys
from collections.abc import Callable, Sequence
from typing import Any

from hydra.errors import OverrideParseException
from omegaconf import DictConfig, OmegaConf

from eldenet.config import compose, config_folder

QUOTES = "a value with spaces or signs goes into two pairs of quotes: 'source=\"my photo (1).jpg\"'"


def explained(config_name: str, about: str) -> Callable[[Callable[[], Any]], Callable[[], Any]]:
    """Decorate a command of Hydra's: ``--help`` shows its YAML file; a mistyped setting is answered.

    Hydra's own help has the settings without their comments and the groups of all commands. With a
    ``--config-dir`` it stays, for it knows what lies there.

    Args:
        config_name: of the command's YAML file.
        about: what the command is for.
    """

    def decorate(command: Callable[[], Any]) -> Callable[[], Any]:
        @functools.wraps(command)
        def run() -> Any:
            words = sys.argv[1:]
            if {"--help", "-h"} & set(words) and not any(
                word.startswith(("--config", "-c")) for word in words
            ):
                _show(help_text(config_name, about))
                return None
            try:
                return command()
            except SystemExit as end:
                if end.code and (meant := what_was_meant(config_name, words)):
                    print(f"error: {meant}", file=sys.stderr)  # noqa: T201
                raise

        return run

    return decorate


def _show(text: str) -> None:
    """Print, also into a pager that is left before the end (``| head``)."""
    try:
        print(text, flush=True)  # noqa: T201
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes once more at its end


def help_text(config_name: str, about: str) -> str:
    """What the command does, its YAML file with the comments, and the choices of its groups."""
    folder = config_folder()
    settings = (folder / f"{config_name}.yaml").read_text().partition("\nhydra:")[0].strip()
    if "\n  - mode: " in settings:  # each mode adds settings of its own
        files = sorted((folder / "mode").glob("*.yaml"))
        of_modes = [f"mode={path.stem}\n{path.read_text().strip()}" for path in files]
        settings = "\n\n".join([settings, *of_modes])
    groups = list(dict.fromkeys(re.findall(r"^  - (?:optional )?/?(\w+): ", settings, re.MULTILINE)))
    groups += dict.fromkeys(re.findall(r"\+(\w+)=", settings))  # such as +experiment=...
    inner = [f"{group}/{part.name}" for group in groups for part in sorted((folder / group).glob("*/"))]
    choices = [
        f"{group}: {', '.join(sorted(path.stem for path in (folder / group).glob('*.yaml')))}"
        for group in [*groups, *inner]
    ]
    whole = f"Every setting there is: python -m eldenet.{config_name} --cfg job"
    return "\n\n".join([about.replace("``", "").strip(), settings, *choices, whole])


def what_was_meant(config_name: str, words: Sequence[str]) -> str:
    """Of the words of a command that failed: the settings nearest to one that does not exist, or ""."""
    words = [word for word in words if "=" in word and not word.startswith("-")]
    try:
        compose(config_name, words)
    except ValueError as error:
        if isinstance(error.__cause__, OverrideParseException):
            return QUOTES
        unknown = re.search(r"Could not override '(.+?)'", str(error))
        return nearest(config_name, unknown[1], words) if unknown else ""
    return ""


def nearest(config_name: str, key: str, words: Sequence[str]) -> str:
    """The settings that ``key`` may stand for, in words: those of its last name, or the one spelt alike."""
    try:
        known = settings_of(compose(config_name, [word for word in words if word.partition("=")[0] != key]))
    except ValueError:  # another word is wrong, too
        known = settings_of(compose(config_name))
    last = key.rpartition(".")[2]
    alike = [name for name in known if name.rpartition(".")[2] == last]
    alike = alike or difflib.get_close_matches(key, known, 1)
    return f"there is no setting {key}: is {' or '.join(alike[:3])} meant?" if alike else ""


def settings_of(config: DictConfig) -> list[str]:
    """Dotted names of all settings and sections."""

    def names(node: Any, prefix: str) -> list[str]:
        if not isinstance(node, dict):
            return []
        return [name for key in node for name in (f"{prefix}{key}", *names(node[key], f"{prefix}{key}."))]

    return names(OmegaConf.to_container(config, resolve=False), "")

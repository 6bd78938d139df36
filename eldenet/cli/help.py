"""Help texts of the commands, and advice on settings that do not exist."""

import difflib
import inspect
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any, get_type_hints

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException

from eldenet.cli.commands import module_of
from eldenet.compose import choices, command_of, compose_config, config_folder, groups, plain

MEANT = {  # settings as other tools, and earlier states, call them
    "weights": "checkpoint",
    "model": "checkpoint",
    "input": "source",
    "image": "source",
    "video": "source",
    "run_dir": "output",
}
WRONG_VALUE = re.compile(r"^[\w.]+=.*: give ")
FIELD = re.compile(r"(?P<name>\w+): .+?(?P<comment>  # .*)?$")  # of a dataclass
CHOICE = re.compile(  # in Hydra's words
    r"Could not find '(?P<name>[^']+)'\s+Available options in '(?P<group>[^']+)':\n(?P<options>(?:\t.+\n?)+)"
)
QUOTES = (
    "close every bracket and quote; a value with spaces or special characters needs two pairs of quotes: "
    "'source=\"my photo (1).jpg\"'"
)


def help_template(settings: type, about: str) -> str:
    """Return Hydra's help template of a command: what it does, its settings with comments, all choices.

    Args:
        settings: the command's dataclass.
        about: what the command does, with examples.
    """
    config_name, shown = command_of(settings), settings_help(settings)
    listed = "\n".join(
        fill(f"{group}: {', '.join(names)}", shutil.get_terminal_size().columns, subsequent_indent="  ")
        for group, names in groups(config_name).items()
    )
    if listed:
        listed = f"Choices of its groups:\n{listed}\n\n"
    return (
        f"{about.replace('``', '').strip()}\n\n{shown}\n\n{listed}"
        f"Every setting: python -m {module_of(config_name)} --cfg job"
    ).replace("$", "$$")


def settings_help(settings: type) -> str:
    """Return a command's settings, a line each, with their defaults and the comments beside them.

    Settings that its modes add follow under the docstrings of the dataclass's subclasses. A section that the
    command's YAML file writes out is shown as it stands there, with its comments.
    """
    config_name = command_of(settings)
    written = re.split(r"\n(?=\w)", (config_folder() / f"{config_name}.yaml").read_text().rstrip())
    sections = {text.partition(":")[0]: text for text in written}

    def shown(part: type) -> str:
        chosen = [f"mode={part.mode}"] if hasattr(part, "mode") else []
        defaults = plain(compose_config(config_name, chosen), resolve=False)
        taken = {name: file for name, file in choices(config_name, chosen).items() if "/" not in name}
        defaults |= taken
        lines = [
            line if (name := line.partition(":")[0]) in taken else sections.get(name, line)
            for line in _lines(part, defaults)
        ]
        modes: list[type] = part.__subclasses__()
        added = [f"\n{(mode.__doc__ or '').splitlines()[0]}\n{shown(mode)}" for mode in modes]
        return "\n".join([*lines, *added])

    return shown(settings)


def _lines(settings: type, defaults: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Return the lines of a dataclass's own fields; a section that is a dataclass has a line for each."""
    lines: list[str] = []
    comments: list[str] = []
    for line in inspect.getsource(settings).splitlines():
        text = line.strip()
        if text.startswith("def "):
            break
        field = FIELD.match(text)
        if text.startswith("# "):
            comments.append(text)
        elif field:
            name, comment = field["name"], field["comment"] or ""
            value = json.dumps(defaults.get(name)).strip('"').replace("???", "(required)")
            bases = reversed(getattr(get_type_hints(settings)[name], "__mro__", ()))
            sections = [base for base in bases if hasattr(base, "__dataclass_fields__")]
            inner = [one for part in sections for one in _lines(part, defaults[name], f"{prefix}{name}.")]
            lines += [*comments, *(inner or [f"{prefix}{name}: {value}{comment}"])]
            comments = []
    return lines


def advice(config_name: str, words: Sequence[str]) -> str:
    """Return one line on the override that made a command fail, or "" if none did.

    Args:
        config_name: of the command's YAML file.
        words: of the command line.
    """
    words = [word for word in words if not word.startswith("-")]
    if unread := next((word for word in words if _parsed(word) is None), None):
        if "=" in unread:
            return f"{unread} cannot be read: {QUOTES}"
        named = "source" in _settings(config_name, []) and os.path.exists(unread)
        return f"{unread} cannot be read: write {f'source={unread}' if named else 'setting=value'}"
    try:
        for job in _jobs(words):
            words = job
            compose_config(config_name, job)
    except ValueError as error:
        if choice := CHOICE.search(str(error)):
            return _choice(choice["group"], choice["name"], choice["options"].split())
        unknown = re.search(r"Could not override '(.+?)'", str(error))
        if unknown:
            others = [word for word in words if getattr(_parsed(word), "key_or_group", "") != unknown[1]]
            return _nearest(unknown[1], _settings(config_name, others))
        if WRONG_VALUE.search(str(error)):
            return str(error)
    return ""


def quote_paths(words: Sequence[str]) -> list[str]:
    """Quote values that Hydra cannot read but that name a file: ``source=my photo (1).jpg``."""
    quoted = []
    for word in words:
        key, _, value = word.partition("=")
        plain_name = not word.startswith("-") and value and '"' not in value
        if plain_name and _parsed(word) is None and os.path.exists(value):
            word = f'{key}="{value}"'
        quoted.append(word)
    return quoted


def _jobs(words: Sequence[str]) -> Iterator[list[str]]:
    """Yield the overrides of jobs in which every value of a sweep appears once; one job without a sweep."""
    values = []
    for word in words:
        override = _parsed(word)
        sweep = override.sweep_string_iterator() if override.is_sweep_override() else None
        key = word.partition("=")[0]
        values.append([word] if sweep is None else [f"{key}={value}" for value in sweep])
    first = [one[0] for one in values]
    yield first
    for place, one in enumerate(values):
        for value in one[1:]:
            yield [*first[:place], value, *first[place + 1 :]]


def _parsed(word: str) -> Any:
    """Return Hydra's reading of an override, or None if it cannot be read."""
    try:
        return OverridesParser.create().parse_overrides([word])[0]
    except OverrideParseException:
        return None


def _choice(group: str, name: str, options: Sequence[str]) -> str:
    """Return a line on a choice that a group does not have."""
    name = name.removeprefix(f"{group}/")
    near = difflib.get_close_matches(name, options, 1)
    return (
        f"{group}={name}: " + (f"did you mean {near[0]}? " if near else "") + f"choose from "
        f"{', '.join(options)}"
    )


def _nearest(key: str, known: dict[str, Any]) -> str:
    """Return a line that asks whether the settings with the same last name, or a similar one, were meant."""
    if key == "experiment":  # a group that no default names
        return "experiment=... needs a plus: write +experiment=..."
    last = key.rpartition(".")[2]
    others = [name for name in known if name != key]  # it may exist with other choices
    alike = [name for name in others if name.rpartition(".")[2] == last]
    alike = alike or [name for name in others if name == MEANT.get(key)]
    alike = alike or difflib.get_close_matches(key, others, 1)
    if "/" in key:  # a group of choices
        alike = [name.replace(".", "/") for name in alike]
    found = f"did you mean {' or '.join(alike[:3])}?" if alike else "--help lists all settings"
    return f"there is no setting {key}: {found}"


def _settings(config_name: str, words: Sequence[str]) -> dict[str, Any]:
    """Return all settings and sections by dotted name, with the groups that ``words`` choose."""
    config = None
    for chosen in ([word for word in words if "." not in word.partition("=")[0]], []):
        try:
            config = compose_config(config_name, chosen)
            break
        except ValueError:  # a wrong choice
            continue

    def flat(node: Any, prefix: str) -> dict[str, Any]:
        entries = {f"{prefix}{key}": value for key, value in node.items()}
        inner = [flat(value, f"{key}.") for key, value in entries.items() if isinstance(value, dict)]
        return {key: value for part in (entries, *inner) for key, value in part.items()}

    return {} if config is None else flat(plain(config, resolve=False), "")

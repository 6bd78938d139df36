"""Help texts of the commands, and the mistakes of their command lines."""

import inspect
import json
import os
import pkgutil
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from textwrap import fill
from typing import Any, get_type_hints

from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import OverrideParseException

from eldenet.cli.commands import module_of
from eldenet.cli.mistakes import line_on_choice, line_on_setting
from eldenet.compose import choices, command_of, compose_config, config_folder, groups, plain

WRONG_VALUE = re.compile(r"^[\w.]+=.*: give ")
FIELD = re.compile(r"(?P<name>\w+): .+?(?P<comment>  # .*)?$")  # of a dataclass
HOME = re.compile(r"(?<=[=\[,\"'])~(?=/|$)")  # at the start of a path, or of one in a list
SHOWING = ("-h", "--help", "--hydra-help", "--version")  # options at which argparse would stop
CHOICE = re.compile(  # in Hydra's words
    r"Could not find '(?P<name>[^']+)'\s+Available options in '(?P<group>[^']+)':\n(?P<options>(?:\t.+\n?)+)"
)
QUOTES = (
    "close every bracket and quote; a value with spaces or special characters needs two pairs of quotes: "
    "'source=\"my photo (1).jpg\"'"
)


def help_template(settings: type, about: str) -> str:
    """Return Hydra's help template of a command: what it does, its settings with comments, all choices."""
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
            inner = [
                one for part in sections for one in _lines(part, defaults.get(name) or {}, f"{prefix}{name}.")
            ]
            lines += [*comments, *(inner or [f"{prefix}{name}: {value}{comment}"])]
            comments = []
    return lines


def comment_on(settings: type, name: str) -> str:
    """Return the comment beside a setting in one line, "" if there is none, as in a section."""
    lines = _lines(settings, {})
    place = next((place for place, line in enumerate(lines) if line.startswith(f"{name}: ")), None)
    if place is None:
        return ""
    comments = [lines[place].partition("  # ")[2]]
    while place and lines[place - 1].startswith("# "):
        place -= 1
        comments.insert(0, lines[place].removeprefix("# "))
    return " ".join(comments).strip()


def advice(config_name: str, words: Sequence[str]) -> str:
    """Return one line on the override that made a command fail, or "" if none did.

    A setting that a plus adds must be a group, or something that a part takes.
    """
    options, _ = get_args_parser().parse_known_args([word for word in words if word not in SHOWING])
    sources = [] if options.config_dir is None else [f"file://{os.path.abspath(options.config_dir)}"]
    words = options.overrides
    if unread := next((word for word in words if word.startswith("=") or _parsed(word) is None), None):
        return _unread(config_name, unread)
    several = next((word for word in words if _parsed(word).is_sweep_override()), "")
    if several and not options.multirun:
        key, _, value = several.partition("=")
        return f"{several}: give one value, a list {key}=[{value}], or -m {several} for a run of each"
    try:
        for job in _jobs(words):
            words = job
            if line := _no_choice(config_name, job) or _added(config_name, job, sources):
                return line
            compose_config(config_name, job, sources)
    except ValueError as error:
        if choice := CHOICE.search(str(error)):
            return line_on_choice(choice["group"], choice["name"], choice["options"].split())
        twice = re.search("Multiple values for|appears more than once|force-add of config groups", str(error))
        added = [word for word in words if word.startswith("+") and not word.startswith("+experiment")]
        if twice and added:
            return f"{added[0]} needs no plus: write {added[0].lstrip('+')}"
        unknown = re.search(r"Could not override '(.+?)'", str(error))
        if unknown:
            others = [word for word in words if getattr(_parsed(word), "key_or_group", "") != unknown[1]]
            return line_on_setting(unknown[1], _settings(config_name, others, sources))
        if WRONG_VALUE.search(str(error)):
            sweep = re.match(r"([\w.]+)=\[?\d+ ?(\.\.|-|:|,| )", str(error))
            return str(error) + (f"; for several runs -m {sweep[1]}=1,2,3" if sweep else "")
    return ""


def wrong_option(config_name: str, fault: str) -> str:
    """Return one line on an option that does not exist, such as ``--epochs=3``; ``fault`` is argparse's."""
    option = fault.partition("unrecognized arguments: ")[2].partition(" ")[0]
    key = option.lstrip("-").partition("=")[0]
    known = _settings(config_name, [])
    if key in known:
        return f"{option}: settings have no dashes, write {key}=value"
    if option and "did you mean" in (line := line_on_setting(key, known)):
        return f"{option}: settings have no dashes, and {line}"
    return f"{fault} (--help shows what there is)"


def _unread(config_name: str, word: str) -> str:
    """Return a line on a word of the command line that is no override."""
    key, equals, value = word.partition("=")
    if equals and (" " in key or not key):
        return f"{word} cannot be read: write setting=value, with the name of a setting and without spaces"
    if re.fullmatch(r"\(.*\)", value):
        return f"{word} cannot be read: a list has square brackets, {key}=[{value[1:-1]}]"
    if equals:
        return f"{word} cannot be read: {QUOTES}"
    known = _settings(config_name, [])
    reader = next((name for name in ("source", "checkpoint", "runs", "models", "study") if name in known), "")
    if reader and os.path.exists(word):
        return f"{word} cannot be read: write {reader}={word}"
    name = word if word in known else "setting"
    return f"{word} cannot be read: write {name}=value (--help lists all settings)"


def _no_choice(config_name: str, words: Sequence[str]) -> str:
    """Return a line on a number or null where a group's choice should be, as in ``data=1``."""
    options = groups(config_name)
    for word in words:
        override = _parsed(word)
        group = override.key_or_group
        if group in options and isinstance(override.value(), bool | int | float | None):
            return line_on_choice(group, word.partition("=")[2], options[group])
    return ""


def _added(config_name: str, words: Sequence[str], sources: Sequence[str]) -> str:
    """Return a line on a setting that a plus adds and that nothing would read."""
    added = [word for word in words if word.startswith("+")]
    options = groups(config_name) if added else {}
    added = [word for word in added if _parsed(word).key_or_group not in options]  # choices stay
    if not added:
        return ""
    config = plain(compose_config(config_name, [w for w in words if w not in added], sources), resolve=False)
    named = set(re.findall(r"\$\{(?:oc\.select:)?([\w.]+)", json.dumps(config, default=str)))
    for word in added:
        key = _parsed(word).key_or_group
        if "/" in key or "@" in key or key.partition(".")[0] == "hydra" or key in named:
            continue
        section, place, name = config, "", key
        while "." in name and isinstance(section.get(name.partition(".")[0]), dict):
            first, _, name = name.partition(".")
            section, place = section[first], f"{place}{first}."
        value = _parsed(word).value()
        if place and _is_part(value) and all(map(_is_part, section.values())):
            continue  # one more of several parts, such as a term of the loss
        if name.partition(".")[0] not in section and not _takes(section, place, name.partition(".")[0]):
            known = _flat(config)
            if "_target_" in section:
                known |= dict.fromkeys(f"{place}{one}" for one in _arguments(section["_target_"]))
            return line_on_setting(key, known)
    return ""


def _takes(section: Mapping[str, Any], place: str, name: str) -> bool:
    """Return whether something reads an entry that is added to a section of the settings."""
    if "_target_" in section:
        arguments = _arguments(section["_target_"])
        return name[:1] == "_" or not arguments or name in arguments
    if not place:
        return False  # of the command's own settings
    if not any(map(_is_part, section.values())):
        return True  # a mapping of anything, such as given of a study
    texts = [file.read_text() for file in (config_folder() / place.partition(".")[0]).rglob("*.yaml")]
    entry = re.compile(rf"^{re.escape(name)}:", re.MULTILINE)
    # what a file itself hands on, as rooms.yaml does data.plain, is nothing to the others
    return any(entry.search(text) and f"${{{place}{name}}}" not in text for text in texts)


def _is_part(value: Any) -> bool:
    """Return whether a value describes a part to build."""
    return isinstance(value, dict) and "_target_" in value


def _arguments(target: str) -> list[str]:
    """Return the names that a part takes; none where it takes any, or cannot be imported."""
    try:
        parameters = inspect.signature(pkgutil.resolve_name(target)).parameters.values()
    except (ImportError, AttributeError, TypeError, ValueError):
        return []
    any_name = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)
    return [] if any_name else [parameter.name for parameter in parameters]


def quote_paths(words: Sequence[str]) -> list[str]:
    """Return words of the command line with ``~`` for the home folder written out, and names of files quoted.

    Quotes are for what Hydra cannot read: ``source=my photo (1).jpg``, ``output=Küche``.
    """
    quoted = []
    for word in words:
        if not word.startswith(("-", "~")):  # no shell expands the ~ within data.root=~/mine
            word = HOME.sub(os.path.expanduser("~"), word)
        key, _, value = word.partition("=")
        plain_name = not word.startswith("-") and value and '"' not in value
        is_name = os.path.exists(value) or not (value.isascii() or value.startswith(("[", "{")))
        if plain_name and is_name and _parsed(word) is None:
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


def _settings(config_name: str, words: Sequence[str], sources: Sequence[str] = ()) -> dict[str, Any]:
    """Return all settings and sections by dotted name, with the groups that ``words`` choose."""
    for chosen in ([word for word in words if "." not in word.partition("=")[0]], []):
        try:
            return _flat(plain(compose_config(config_name, chosen, sources), resolve=False))
        except ValueError:  # a wrong choice
            continue
    return {}


def _flat(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the entries of nested mappings by dotted name, those of mappings too."""
    entries = {f"{prefix}{key}": value for key, value in node.items()}
    inner = [_flat(value, f"{key}.") for key, value in entries.items() if isinstance(value, dict)]
    return {key: value for part in (entries, *inner) for key, value in part.items()}

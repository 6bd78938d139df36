"""Parts that record how they were built, and what builds parts from such records.

A part's ``config`` has the form of its YAML file, such as
``{"_target_": "eldenet.heads.LinearHead", "max_depth": 10.0}``.
:func:`instantiate` builds what the user's own settings describe. Saved models come from other people, so
:func:`build` checks the name of a target's module *before* it imports anything, and then accepts only
subclasses of :class:`Configurable`.
"""

import functools
import importlib
import inspect
import pkgutil
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

TRUSTED_MODULES = (
    "eldenet.backbones",
    "eldenet.decoders",
    "eldenet.heads",
    "eldenet.baselines",
    "eldenet.model",
    "eldenet.ray_features",
    "eldenet.refinement",
)
LARGEST = 2**32  # of a whole number: numpy's seeds end there too
WORDS = {
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    str: "a text",
    types.NoneType: "null",
    dict[str, Any]: "a section, {...}",
}
COUNTS = ("size", "frames")  # a setting whose name ends so counts something: 1 or more


class Configurable:
    """Mixin that records the constructor's arguments in ``config``; it must be the first base class.

    Attributes:
        transient_arguments: names of arguments that say where weights come from (``pretrained``), not what
            the part is; they are not recorded.
        supplied_arguments: names of arguments that the surrounding part supplies (a decoder's
            ``feature_info``); they are not recorded, and the config becomes a partial one.
        config: the record, as :func:`build` takes it.
    """

    transient_arguments: tuple[str, ...] = ()
    supplied_arguments: tuple[str, ...] = ()
    config: dict[str, Any]

    def __init_subclass__(cls, **options: Any) -> None:
        """Show the constructor's signature: inspect in Python 3.11.2, Debian 12's, shows that of __new__."""
        super().__init_subclass__(**options)
        signature = inspect.signature(cls.__init__)
        cls.__signature__ = signature.replace(parameters=list(signature.parameters.values())[1:])  # type: ignore[attr-defined]

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        """Record the arguments that ``__init__`` will get, including defaults."""
        part = super().__new__(cls)
        signature = inspect.signature(cls.__init__)
        given = signature.bind_partial(part, *args, **kwargs)
        given.apply_defaults()
        arguments = dict(list(given.arguments.items())[1:])
        for parameter in signature.parameters.values():
            if parameter.kind is parameter.VAR_KEYWORD:  # **options are arguments like any other
                arguments |= arguments.pop(parameter.name)
        unsaved = {*cls.transient_arguments, *cls.supplied_arguments}
        config = {"_target_": f"{cls.__module__}.{cls.__qualname__}"}
        if cls.supplied_arguments:
            config["_partial_"] = True  # type: ignore[assignment]
        config |= {name: _plain(value) for name, value in arguments.items() if name not in unsaved}
        object.__setattr__(part, "config", config)
        return part


def _plain(value: Any) -> Any:
    """Return an argument in a form that JSON can hold; a part becomes its config."""
    if isinstance(value, Configurable):
        return value.config
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [_plain(item) for item in value]
    if isinstance(value, functools.partial):
        return {"_target_": f"{value.func.__module__}.{value.func.__qualname__}", "_partial_": True} | {
            name: _plain(item) for name, item in value.keywords.items()
        }
    return value


def build(config: Any, trusted_modules: Sequence[str] = ()) -> Any:
    """Build the part that a ``config`` describes.

    Args:
        config: nested mappings with ``_target_`` (and ``_partial_``), as :class:`Configurable` records them.
        trusted_modules: packages or modules beyond our own model parts whose classes may be built.

    Raises:
        ValueError: a target is outside the trusted modules (then nothing is imported), is no
            :class:`Configurable` class, does not take its arguments, or sets a transient argument (which
            could download or read any file).
    """
    if isinstance(trusted_modules, str):
        raise ValueError(f"trusted_modules={trusted_modules!r}: give a list, [{trusted_modules!r}]")
    if isinstance(config, Mapping):
        arguments = {key: build(value, trusted_modules) for key, value in config.items() if key[:1] != "_"}
        if "_target_" not in config:
            return arguments
        part = _resolve(str(config["_target_"]), trusted_modules)
        for name in part.transient_arguments:
            if arguments.get(name):
                raise ValueError(
                    f"refused {name}={arguments[name]!r} of {config['_target_']}: a saved model must not "
                    "fetch weights; remove that entry"
                )
        if config.get("_partial_"):
            return functools.partial(part, **arguments)
        try:
            return part(**arguments)
        except ValueError:
            raise
        except Exception as error:  # a damaged config makes a part fail in any way
            raise ValueError(f"config of {config['_target_']} does not fit: {error}") from error
    if isinstance(config, list | tuple):
        return [build(item, trusted_modules) for item in config]
    return config


def _resolve(target: str, trusted_modules: Sequence[str]) -> type[Configurable]:
    """Return the class that ``target`` names; a module that is not trusted is not imported."""
    module, _, name = target.rpartition(".")
    trusted = (*TRUSTED_MODULES, *trusted_modules)
    if not any(module == one or module.startswith(f"{one}.") for one in trusted):
        raise ValueError(
            f"refused to build {target!r}: its module is not one of {', '.join(trusted)}. If you trust that "
            f"code, add 'trusted_modules=[{module}]' (in Python trusted_modules=[{module!r}])"
        )
    try:
        part = getattr(importlib.import_module(module), name, None)
    except ModuleNotFoundError as error:
        raise ValueError(f"cannot build {target!r}: {error}") from error
    if not (isinstance(part, type) and issubclass(part, Configurable)):
        raise ValueError(f"refused to build {target!r}: not a Configurable class of {module}")
    return part


# --- the user's own settings --------------------------------------------------------------------------------


def instantiate(settings: Any, name: str = "", **arguments: Any) -> Any:
    """Build what the user's own settings describe; their targets may be any class or function.

    Args:
        settings: nested mappings with ``_target_`` (and ``_partial_``), as YAML files hold them; other values
            are returned as they are.
        name: of the section, for errors: "trainer".
        arguments: replace those of the outermost part.

    Raises:
        ValueError: a class or argument does not exist, or a value is of another type than the class's.
    """
    prefix = f"{name}." if name else ""
    if isinstance(settings, list):
        return [instantiate(item, f"{prefix}{place}") for place, item in enumerate(settings)]
    if not isinstance(settings, Mapping):
        return settings
    target = None
    if "_target_" in settings:
        try:
            target = pkgutil.resolve_name(str(settings["_target_"]))
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(f"{prefix}_target_={settings['_target_']}: {error}") from error
        given = {key: value for key, value in settings.items() if key not in arguments}
        if missing := next((key for key, value in given.items() if value == "???"), None):
            raise ValueError(f"give {prefix}{missing}=... on the command line")
        check_arguments(target, given, prefix)
        check_arguments(target, arguments)
    parts = {
        key: instantiate(value, f"{prefix}{key}")
        for key, value in settings.items()
        if key not in arguments and key not in ("_target_", "_partial_")
    } | arguments
    if target is None:
        return parts
    if settings.get("_partial_"):
        return functools.partial(target, **parts)
    try:
        return target(**parts)
    except TypeError as error:
        raise ValueError(f"{name or 'settings'} of {settings['_target_']}: {error}") from error


def modules_named_in(settings: Any) -> list[str]:
    """Return the modules that the user's own settings name: a saved model may name their classes, too."""
    if not isinstance(settings, Mapping):
        return []
    named = [str(settings["_target_"]).rpartition(".")[0]] if "_target_" in settings else []
    return named + [module for value in settings.values() for module in modules_named_in(value)]


def check_arguments(target: Callable[..., Any], arguments: Mapping[str, Any], prefix: str = "") -> None:
    """Compare plain values with the annotations of what they are passed to.

    Args:
        target: class or function.
        arguments: name -> value; objects pass, and so does a name that ``target`` does not annotate.
        prefix: of the settings' names in the error, as "trainer.".

    Raises:
        ValueError: a value of another type, a whole number out of range, or a size below 1.
    """
    try:
        parameters = inspect.signature(target).parameters
    except (TypeError, ValueError):  # built in
        return
    for name, value in arguments.items():
        kind = parameters[name].annotation if name in parameters else Any
        if not _fits(value, kind):
            raise ValueError(f"{prefix}{name}={value}: give {described(kind)}")
        whole = [one for one in (value if isinstance(value, list) else [value]) if type(one) is int]
        if any(abs(one) >= LARGEST for one in whole):
            raise ValueError(f"{prefix}{name}={value}: give a whole number below 2^32")
        if name.rpartition("_")[2] in COUNTS and any(one < 1 for one in whole):
            raise ValueError(f"{prefix}{name}={value}: give whole numbers of 1 or more")


def _fits(value: Any, kind: Any) -> bool:
    """Whether a plain value is of an annotated type; True where the annotation says too little."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, one) for one in inner)
    if kind in (None, types.NoneType):
        return value is None
    if kind is float:
        return type(value) in (int, float)
    if kind in (int, bool):
        return type(value) is kind
    if kind is str:
        return isinstance(value, str)
    if origin in (list, tuple, Sequence):
        if not isinstance(value, list | tuple):
            return False
        kinds = inner if origin is tuple and Ellipsis not in inner else inner[:1] * len(value)
        return len(kinds) == len(value) and all(map(_fits, value, kinds))
    if isinstance(kind, type) and issubclass(kind, Configurable):
        return not isinstance(value, str | int | float)
    return getattr(kind, "__name__", "") != "Tensor" or hasattr(value, "shape")


def described(kind: Any) -> str:
    """Return what a type takes, in words: "a whole number or null"."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        words = dict.fromkeys(described(one) for one in inner if getattr(one, "__name__", "") != "Tensor")
        return " or ".join(words)
    if origin in (list, tuple, Sequence):
        count = f"{len(inner)} values" if origin is tuple and Ellipsis not in inner else "values"
        return f"a list of {count}" + (f", each {described(inner[0])}" if inner[0] is not Any else "")
    if isinstance(kind, type) and issubclass(kind, Configurable):
        return "a part; a slash chooses it from its group, as in model/backbone=resnet18"
    return WORDS.get(type(None) if kind is None else kind, getattr(kind, "__name__", str(kind)))

"""Parts of models that record how they were built, and a safe builder for such records.

A part's ``config`` has the form of its YAML file, such as
``{"_target_": "eldenet.heads.LinearHead", "max_depth": 10.0}``.
Saved models come from other people, so :func:`build` checks the name of a target's module *before* it imports
anything, and then accepts only subclasses of :class:`Configurable`.

Studies come from other people, too, and Hydra builds whatever their settings name. :func:`building_only` and
:func:`refuse_foreign_code` keep that to known parts.
"""

import functools
import importlib
import inspect
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Self

TRUSTED_MODULES = (
    "eldenet.backbones",
    "eldenet.decoders",
    "eldenet.heads",
    "eldenet.baselines",
    "eldenet.model",
    "eldenet.refinement",
)


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
    _refuse_text(trusted_modules)
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
    module, _, name = target.rpartition(".")
    trusted = (*TRUSTED_MODULES, *trusted_modules)
    if not _within(module, trusted):
        raise ValueError(
            f"refused to build {target!r}: its module is not one of {', '.join(trusted)}. If you trust that "
            "code, name it: trusted_modules=[...]"
        )
    try:
        part = getattr(importlib.import_module(module), name, None)
    except ModuleNotFoundError as error:
        raise ValueError(f"cannot build {target!r}: {error}") from error
    if not (isinstance(part, type) and issubclass(part, Configurable)):
        raise ValueError(f"refused to build {target!r}: not a Configurable class of {module}")
    return part


def _within(name: str, modules: Sequence[str]) -> bool:
    return any(name == module or name.startswith(f"{module}.") for module in modules)


def _refuse_text(trusted_modules: Sequence[str]) -> None:
    if isinstance(trusted_modules, str):
        raise ValueError(f"trusted_modules={trusted_modules!r}: give a list, [{trusted_modules!r}]")


# --- settings of studies ------------------------------------------------------------------------------------

_allowed: ContextVar[tuple[Collection[str], Sequence[str]] | None] = ContextVar("_allowed", default=None)


@contextmanager
def building_only(targets: Collection[str], trusted_modules: Sequence[str] = ()) -> Iterator[None]:
    """Within the block, :func:`refuse_foreign_code` lets these targets pass; outside of any, all.

    Args:
        targets: each as ``_target_`` names it.
        trusted_modules: packages or modules of which everything passes.

    Raises:
        ValueError: ``trusted_modules`` is no list.
    """
    _refuse_text(trusted_modules)
    token = _allowed.set((targets, trusted_modules))
    try:
        yield
    finally:
        _allowed.reset(token)


def refuse_foreign_code(settings: Any) -> None:
    """Raise ValueError for a setting, at any depth, that names code which may not be built here.

    A teacher's ``trusted_modules`` is such a setting, too: its saved config may name their classes.

    Args:
        settings: resolved, plain.
    """
    allowed = _allowed.get()
    if allowed is None:
        return
    targets, trusted_modules = allowed
    if isinstance(settings, list):
        for item in settings:
            refuse_foreign_code(item)
    for key, value in settings.items() if isinstance(settings, Mapping) else ():
        names = {"_target_": [value], "trusted_modules": value if isinstance(value, list) else [value]}
        for name in map(str, filter(None, names.get(key, ()))):
            if not _within(name, trusted_modules) and not (key == "_target_" and name in targets):
                module = name.rpartition(".")[0] or name
                raise ValueError(
                    f"refused {key}={name}: a study's settings may only name eldenet's own parts. If you "
                    f"have read that code and trust it, give trusted_modules=[{module}]"
                )
        refuse_foreign_code(value)

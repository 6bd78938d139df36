"""Configs of commands by their name."""

import importlib
from collections.abc import Sequence
from typing import Any

from eldenet.cli.commands import module_of
from eldenet.compose import compose_config


def composed(command: str, overrides: Sequence[str] = ()) -> Any:
    """What Hydra composes for ``command``, whose module makes its settings known."""
    importlib.import_module(module_of(command))
    return compose_config(command.replace("-", "_"), overrides)

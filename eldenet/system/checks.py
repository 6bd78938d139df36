"""Checks of settings that need no heavy imports."""

from collections.abc import Sequence


def one_of(name: str, value: str, allowed: Sequence[str]) -> None:
    """Raise ``ValueError`` if a setting has none of the allowed values."""
    if value not in allowed:
        raise ValueError(f"{name}={value!r}: give one of {', '.join(allowed)}")

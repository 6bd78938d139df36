"""One place that turns the errors of readers into ours."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def reading(source: object, kind: str, advice: str = "fetch or write it again") -> Iterator[None]:
    """Turn every error of a reader, which may be of any type, into a ``ValueError`` that names the file."""
    try:
        yield
    except Exception as error:
        reason = (f"{type(error).__name__}: {error}".splitlines() or [""])[0][:200]
        raise ValueError(f"{source} is truncated or not a valid {kind} ({reason}): {advice}") from error

"""SHA-256 digests: they identify data and networks, and show a changed bit when a file is loaded."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor

KEY = "sha256"


def file_digest(path: Path) -> str:
    """Return the SHA-256 of a file, as ``sha256sum`` prints it."""
    with path.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def digest_of(*parts: bytes | str) -> str:
    """Return the SHA-256 of several pieces, one after the other; text is UTF-8."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() if isinstance(part, str) else part)
    return digest.hexdigest()


def weights_of(state: Mapping[str, "Tensor"]) -> Iterator[bytes]:
    """Yield names and contents of a state dict, in the order of the names, for :func:`digest_of`."""
    import torch

    for name, value in sorted(state.items()):
        yield name.encode()
        yield value.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy().tobytes()


def canonical(content: Mapping[str, Any]) -> bytes:
    """Return JSON values without their digests, independent of the order and layout of a file."""
    return json.dumps({key: value for key, value in content.items() if key != KEY}, sort_keys=True).encode()


def with_digests(config: Mapping[str, Any], weights: bytes) -> dict[str, Any]:
    """Return a config with the digests of its own entries and of the weights beside it."""
    plain = json.loads(json.dumps(config))
    digests = {"config": digest_of(canonical(plain)), "weights": digest_of(weights)}
    return {**plain, KEY: digests}


def check_digests(config: Mapping[str, Any], path: Path, weights: Path) -> None:
    """Raise ValueError unless the config read from ``path`` and the weights beside it match their digests.

    Configs of earlier versions have none.
    """
    stored = config.get(KEY)
    found = {weights: ("weights", file_digest(weights)), path: ("config", digest_of(canonical(config)))}
    for file, (name, digest) in found.items():
        if isinstance(stored, Mapping) and stored.get(name) not in (None, digest):
            raise ValueError(
                f"{file} does not match its digest in {path.name}: it is damaged, fetch or save the model "
                f"again; if you changed it on purpose, remove the entry {KEY!r} of {path.name}"
            )

"""Digests at the end of exported files, so that a changed bit is noticed when they are loaded.

An ``.onnx`` file ends in an entry of its metadata, an OpenVINO ``.xml`` file in a comment; either holds the
SHA-256 of all bytes before it and, for OpenVINO, of the ``.bin`` file beside it. Other programs ignore it.
"""

import re
from pathlib import Path

from eldenet.system.digests import digest_of

SEAL = "eldenet-sha256"
_HEAD = 1024  # bytes in which an ONNX file says that it ends in a digest
_KEY = SEAL.encode()
# a ModelProto may come in pieces; this one is an entry of metadata_props (field 14): key (1) and value (2)
_ENTRY = bytes([14 << 3 | 2, len(_KEY) + 68, 1 << 3 | 2, len(_KEY)]) + _KEY + bytes([2 << 3 | 2, 64])
_ONNX_END = re.compile(re.escape(_ENTRY) + rb"([0-9a-f]{64})\Z")
_XML_END = re.compile(rb"<!-- " + _KEY + rb" ([0-9a-f]{64}) -->\n\Z")


def sealed(content: bytes, weights: bytes | None = None) -> bytes:
    """Return a file's content with its digest; ``weights``: of the ``.bin`` beside an ``.xml``."""
    if weights is None:
        return content + _ENTRY + digest_of([content]).encode()
    return content + f"<!-- {SEAL} {digest_of([content, weights])} -->\n".encode()


def check_seal(path: Path) -> bool:
    """Check an exported file against its digest; return whether it has one.

    Files of other programs, and of eldenet before it wrote digests, have none.

    Raises:
        ValueError: the file, or the ``.bin`` beside it, is damaged.
    """
    content = path.read_bytes()
    is_onnx, beside = path.suffix == ".onnx", path.with_suffix(".bin")
    if not is_onnx and not beside.is_file():
        raise ValueError(f"{path} needs {beside.name}, which holds its weights: keep both in the same folder")
    end = (_ONNX_END if is_onnx else _XML_END).search(content, max(0, len(content) - 128))
    if end is None and not (is_onnx and _KEY in content[:_HEAD]):
        return False
    parts = [] if end is None else [content[: end.start()], *([] if is_onnx else [beside.read_bytes()])]
    if end is None or digest_of(parts) != end[1].decode():
        files = path.name if is_onnx else f"{path.name} or {beside.name}"
        raise ValueError(
            f"{path} does not match its digest: {files} is damaged or was changed after the export; "
            "export it again (eldenet export)"
        )
    return True


def is_whole(path: Path) -> bool:
    """Whether an exported file is there and matches its digest."""
    try:
        return path.is_file() and check_seal(path)
    except ValueError:
        return False

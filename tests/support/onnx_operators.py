"""torch parses the source of every ONNX operator anew for each file, for half a second: here, once."""

from contextlib import suppress
from functools import cache


def parse_operators_once() -> None:
    """In this process; other versions of torch keep them elsewhere and just take longer."""
    with suppress(ImportError):
        from torch.onnx._internal._lazy_import import onnxscript_apis as apis

        apis.get_torchlib_ops = cache(lambda: type(apis).__getattr__(apis, "get_torchlib_ops")())

"""eldenet: light-weight monocular depth for robots and edge cameras.

Public names are loaded when they are first used, which keeps ``import eldenet`` fast.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eldenet.deploy import runtimes
    from eldenet.deploy.estimation import estimate
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.model import DepthNet, EncoderDecoder
    from eldenet.weights import list_models, list_weights
    from eldenet.zoo import load

__version__ = "0.1.0"
__all__ = [
    "DepthNet",
    "DepthPredictor",
    "EncoderDecoder",
    "__version__",
    "estimate",
    "list_models",
    "list_weights",
    "load",
    "runtimes",
]

_MODULE_OF = {
    "DepthNet": "eldenet.model",
    "DepthPredictor": "eldenet.deploy.predictor",
    "EncoderDecoder": "eldenet.model",
    "estimate": "eldenet.deploy.estimation",
    "list_models": "eldenet.weights",
    "list_weights": "eldenet.weights",
    "load": "eldenet.zoo",
    "runtimes": "eldenet.deploy.runtimes",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'eldenet' has no attribute {name!r}")
    from importlib import import_module

    home = import_module(_MODULE_OF[name])
    return home if _MODULE_OF[name].endswith(f".{name}") else getattr(home, name)


def __dir__() -> list[str]:
    return __all__

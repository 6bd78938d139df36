"""eldenet: light-weight monocular depth for robots and edge cameras.

Public names load when they are first used, so that importing the package stays light.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from eldenet.deploy import runtimes
    from eldenet.deploy.predictor import DepthPredictor
    from eldenet.model import DepthNet, EncoderDecoder
    from eldenet.zoo import list_models, list_weights, load

__version__ = "0.1.0"
__all__ = [
    "DepthNet",
    "DepthPredictor",
    "EncoderDecoder",
    "__version__",
    "list_models",
    "list_weights",
    "load",
    "runtimes",
]

_HOME_OF = {
    "DepthNet": "eldenet.model",
    "DepthPredictor": "eldenet.deploy.predictor",
    "EncoderDecoder": "eldenet.model",
    "list_models": "eldenet.zoo",
    "list_weights": "eldenet.zoo",
    "load": "eldenet.zoo",
    "runtimes": "eldenet.deploy.runtimes",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'eldenet' has no attribute {name!r}")
    from importlib import import_module

    home = import_module(_HOME_OF[name])
    return home if _HOME_OF[name].endswith(f".{name}") else getattr(home, name)


def __dir__() -> list[str]:
    return __all__

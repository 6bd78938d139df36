"""Models for ``torch.hub``: ``torch.hub.load(<this repository>, "eldenet_indoor")``.

Each name of ``eldenet.list_weights()`` (trained) and of ``eldenet.list_models()`` (freshly initialized) is a
function here. It returns a network in eval mode: image ``(B, 3, H, W)``, RGB in [0, 1] -> depth
``(B, 1, H, W)`` [m]. It takes the options of :func:`eldenet.load`; those of a network that is not trained are
changes such as ``overrides=["model.head.max_depth=80"]``.
"""

from functools import partial as _partial  # torch.hub lists every callable without an underscore

from eldenet.compose import config_folder as _config_folder
from eldenet.weights import list_models as _list_models
from eldenet.weights import list_weights as _list_weights
from eldenet.zoo import load as _load

dependencies = ["hydra", "numpy", "omegaconf", "safetensors", "torch", "torchvision"]

for _name in _list_weights():
    globals()[_name] = _function = _partial(_load, _name)
    _function.__doc__ = f"{_name}: trained weights of the package, see docs/weights.md."
for _name in _list_models():
    _function = _partial(_load, _name)
    # torch.hub.help prints the comment at the top of the YAML file
    _comment = (_config_folder() / "model" / f"{_name}.yaml").read_text().partition("\ndefaults:")[0]
    _function.__doc__ = _comment.replace("# ", "")
    globals()[_name] = _function

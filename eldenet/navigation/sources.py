"""Which source files a training or a crossing rests on, as a hash: it tells old results from new."""

import hashlib
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent
_WORLD = ("robot.py", "simulation/arena*.py", "simulation/culling.py", "simulation/mjcf.py")
#: What a driver is trained by; the rest of navigation only watches, counts or plans.
_TRAINING = ("arcs", "crossings", "dqn", "env", "localisation", "memory", "noise",
             "observer", "qnetwork", "range_errors", "replay", "sensors", "tasks", "walkers")  # fmt: skip
#: Of navigation, what no crossing rests on: a policy's file has a hash of its own.
_NO_PART = ("dqn", "env", "failures", "film", "identity", "pictures", "registration", "replay",
            "settings", "sources", "statistics", "training")  # fmt: skip
#: From a rendered frame to ranges.
_CAMERA = (
    "simulation/*.py", "perception/*.py", "runtimes/*.py", "backbones/*.py", "decoders/*.py", "heads/*.py",
    "baselines/*.py", "boxes.py", "configurable.py", "folding.py", "geometry.py", "layers.py", "model.py",
    "normalisation.py", "predictor.py", "types.py",
)  # fmt: skip


def training_hash() -> str:
    """SHA-256 over the code that a training rests on."""
    return _digest(*_WORLD, *(f"navigation/{name}.py" for name in _TRAINING))


def crossing_hash(*, camera: bool = False) -> str:
    """SHA-256 over the code that a crossing rests on; ``camera``: that of rendering and networks too."""
    files = (file for file in PACKAGE.glob("navigation/**/*.py") if file.stem not in _NO_PART)
    names = (file.relative_to(PACKAGE).as_posix() for file in files)
    return _digest(*_WORLD, *names, *(_CAMERA if camera else ()))


def _digest(*patterns: str) -> str:
    digest = hashlib.sha256()
    for file in sorted({file for pattern in patterns for file in PACKAGE.glob(pattern)}):
        name = file.relative_to(PACKAGE).as_posix()
        digest.update(name.encode() + file.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()

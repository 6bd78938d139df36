"""Whole networks by name: ``eldenet.load("eldenet")``, ``eldenet.load("runs/my-run")``."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eldenet.losses.distillation import Teacher
    from eldenet.model import DepthNet

PACKAGED = Path(__file__).resolve().parent / "weights"
WEIGHT_FILES = ("model.safetensors", "model/model.safetensors")  # of a saved model, of a run folder


def located(source: str | Path) -> Path:
    """File or folder of a source: the package's own weights for their name, else the path itself.

    ``~`` is the home folder. ``./name`` is always a path.

    Warns:
        UserWarning: a saved model of the same name as the package's weights lies here and is not used.
    """
    own, here = PACKAGED / source, Path(source).expanduser()
    if "/" in str(source) or not (own / WEIGHT_FILES[0]).is_file():
        return here
    if any((here / name).is_file() for name in WEIGHT_FILES) and here.resolve() != own:
        warnings.warn(
            f"{source} is the name of packaged weights, which are used; for the folder {source} here give "
            f"./{source}",
            stacklevel=2,
        )
    return own


def list_models() -> list[str]:
    """Names that :func:`load` builds."""
    from eldenet.config import config_folder

    return sorted(path.stem for path in (config_folder() / "model").glob("*.yaml"))


def list_weights() -> list[str]:
    """Trained weights that come with the package, such as ``eldenet_rooms``: eldenet trained on rooms."""
    return sorted(path.parent.name for path in PACKAGED.glob("*/config.json"))


def note_if_untrained(source: str | Path) -> str:
    """What to say of a network that is built by name, where trained ones are wanted; empty for any other."""
    if str(source) not in list_models():
        return ""
    return f"note: {source} is a freshly initialized network: its depth means nothing"


def load(
    source: str | Path,
    *,
    weights: str | None = None,
    overrides: Sequence[str] = (),
    trusted_modules: Sequence[str] = (),
    revision: str | None = None,
) -> "DepthNet":
    """Build a network by name, or read a trained one.

    Args:
        source: a name of :func:`list_models` (freshly initialized) or of :func:`list_weights` (trained), a
            folder written by ``save_pretrained``, a run folder of ``eldenet.train`` (its best epoch), or a
            Hub id ``owner/name``.
        weights: for a name of :func:`list_models`: what the package's weights for it were trained on
            (``load("eldenet", weights="rooms")`` is ``load("eldenet_rooms")``).
        overrides: for a name: changes as on the command line, such as ``["model/backbone=pplcnet_x0_75"]`` or
            ``["model.head.max_depth=80"]``.
        trusted_modules: for a folder or Hub id: packages beyond eldenet whose classes its config may name.
        revision: of a Hub id.

    Returns:
        The network, in eval mode.

    Raises:
        ValueError: an unknown name, weights that the package does not have, an override that does not fit, or
            a config that names something untrusted.
        FileNotFoundError: no such folder, or the Hub could not be reached.
    """
    from eldenet.model import DepthNet

    if weights is not None:
        known = list_weights()
        if f"{source}_{weights}" not in known:
            raise ValueError(
                f"no weights {weights!r} of {source} in the package: it has {', '.join(known)}. A run "
                f"folder, a saved model or a Hub id is given alone: eldenet.load({weights!r})"
            )
        source = f"{source}_{weights}"
    if str(source) in list_models():
        from eldenet.config import build_model, compose

        if revision is not None or trusted_modules:
            raise ValueError(f"revision and trusted_modules are for saved models; {source} is built by name")
        return build_model(compose("zoo", [f"model={source}", *overrides]).model).eval()
    if overrides:
        raise ValueError(f"overrides change a network built by name; {source} is read as it was saved")
    folder = located(source)
    if "/" not in str(source) and not folder.is_dir():
        raise ValueError(
            f"unknown model {str(source)!r}: choose one of {', '.join(list_models())}, trained weights "
            f"({', '.join(list_weights())}), or give a folder or a Hub id 'owner/name'"
        )
    if revision is not None and folder.is_dir():
        raise ValueError(f"revision={revision!r} is for Hub ids; {source} is a folder here")
    found = folder if folder.is_dir() or folder.is_absolute() else source
    return DepthNet.from_pretrained(found, trusted_modules=trusted_modules, revision=revision)


def build_teacher(
    source: str | None,
    *,
    overrides: Sequence[str] = (),
    input_size: Sequence[int] | None = None,
    trusted_modules: Sequence[str] = (),
) -> "Teacher":
    """A frozen :class:`~eldenet.losses.distillation.Teacher` for a distilled loss term.

    Args:
        source: anything :func:`eldenet.load` takes: run folder, saved model, Hub id; or a model's name.
        overrides: for a name, which needs them: where its weights come from (``model.network.weights=...``).
        input_size: ``(height, width)`` that the teacher sees [px]; None: the student's.
        trusted_modules: as in :func:`eldenet.load`.

    Raises:
        ValueError: no teacher was named, or one without trained weights.
    """
    from eldenet.losses.distillation import Teacher

    if source is None:
        raise ValueError("this loss distils from a teacher: give teacher=<run folder, saved model or Hub id>")
    if source in list_models() and not overrides:
        raise ValueError(f"teacher={source} names a network without trained weights: give a run of it")
    network = load(source, overrides=overrides, trusted_modules=trusted_modules)
    return Teacher(network, source=str(source), input_size=input_size)

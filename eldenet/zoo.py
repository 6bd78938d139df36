"""Networks and trained weights by name: ``eldenet.load("eldenet")``, ``eldenet.load("runs/my-run")``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from eldenet.compose import compose_config, plain
from eldenet.configurable import instantiate
from eldenet.weights import find_checkpoint, list_weights

if TYPE_CHECKING:
    from eldenet.losses.distillation import Teacher
    from eldenet.model import DepthNet


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
        weights: for a name of :func:`list_models`: the data that the package's weights were trained on
            (``load("eldenet", weights="rooms")`` is ``load("eldenet_rooms")``).
        overrides: for a name of :func:`list_models`: changes, written as on the command line, such as
            ``["model/backbone=pplcnet_x0_75"]`` or ``["model.head.max_depth=80"]``.
        trusted_modules: for a folder or Hub id: other packages whose classes its config may name.
        revision: for a Hub id: branch, tag or commit.

    Returns:
        The network, in eval mode.

    Raises:
        ValueError: an unknown name, weights that the package does not have, an override that does not fit, or
            a config that names something untrusted.
        FileNotFoundError: no such folder, or the Hub cannot be reached.
    """
    from eldenet.model import DepthNet

    if weights is not None:
        if f"{source}_{weights}" not in list_weights():
            raise ValueError(
                f"the package has no weights {weights!r} for {source}, only {', '.join(list_weights())}; for "
                f"a run folder, saved model or Hub id write eldenet.load({weights!r})"
            )
        source = f"{source}_{weights}"
    found = find_checkpoint(source)
    if found.kind == "network":
        if revision is not None or trusted_modules:
            raise ValueError(
                f"revision and trusted_modules apply to saved models, but {source} is built by name"
            )
        network = compose_config("zoo", [f"model={source}", *overrides]).model
        return instantiate(plain(network), "model").eval()
    if overrides:
        raise ValueError(f"overrides apply to networks built by name, but {source} is a saved model")
    if revision is not None and found.kind != "hub":
        raise ValueError(f"revision={revision!r} applies to Hub ids, but {source} is a folder here")
    return DepthNet.from_pretrained(found.path, trusted_modules=trusted_modules, revision=revision)


def build_teacher(
    source: str | None,
    *,
    overrides: Sequence[str] = (),
    input_size: Sequence[int] | str | None = None,
    trusted_modules: Sequence[str] = (),
) -> "Teacher":
    """Return a frozen :class:`~eldenet.losses.distillation.Teacher` for a distilled loss term or photographs.

    Args:
        source: run folder, saved model, Hub id or name, as in :func:`load`.
        overrides: for a name of :func:`list_models`, which needs them to get trained weights
            (``model.network.weights=...``).
        input_size: ``(height, width)`` of the images that the teacher sees [px]; "model": that of whole
            frames in its training; None: the student's.
        trusted_modules: as in :func:`load`.

    Raises:
        ValueError: no teacher is named, it has no trained weights, or it does not say the size of its
            training and is to see that.
    """
    from eldenet.losses.distillation import Teacher
    from eldenet.model import size_of_frames

    if source is None:
        raise ValueError(
            "a teacher is missing: give a run folder, saved model or Hub id, for a loss as teacher=..., for "
            "photographs as data.sources.photographs.data.teacher.source=..."
        )
    find_checkpoint(source, "teacher", trained=not overrides)
    network = load(source, overrides=overrides, trusted_modules=trusted_modules)
    if isinstance(input_size, str):
        size = size_of_frames(network.info) if input_size == "model" else None
        if size is None:
            raise ValueError(
                f"teacher.input_size={input_size}: give [height, width] in pixels, or model for a teacher "
                "that states the size of its training"
            )
        input_size = size
    return Teacher(network, source=str(source), input_size=input_size)

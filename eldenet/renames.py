"""What stored results call parts that have another name today.

Runs, checkpoints and saved models outlive a name. Everything that reads one passes it through
:func:`renamed`, so that a run stored under an old name counts as what it is.
"""

from collections.abc import Mapping
from typing import Any

#: ``_target_`` of earlier versions -> today's.
TARGETS = {
    "eldenet.config.build_teacher": "eldenet.zoo.build_teacher",
    "eldenet.metrics.EvalProtocol": "eldenet.evaluation.protocol.EvalProtocol",
    "eldenet.navigation.noise.NoisyRanges": "eldenet.navigation.noisy_ranges.NoisyRanges",
    "eldenet.schedules.constant": "eldenet.training.optim.constant",
    "eldenet.schedules.cosine": "eldenet.training.optim.cosine",
    "eldenet.schedules.epoch_decay": "eldenet.training.optim.epoch_decay",
    "eldenet.schedules.one_cycle": "eldenet.training.optim.one_cycle",
    "eldenet.trainer.Trainer": "eldenet.training.trainer.Trainer",
}
#: Today's ``_target_`` -> its options that were renamed: old name -> new name.
OPTIONS: dict[str, dict[str, str]] = {}
#: Sections and entries that were renamed, wherever they stand: old name -> new name.
KEYS = {"load_size": "resize_on_load", "normalisation": "normalization"}
#: Values that were renamed: (key, old value) -> new value.
VALUES: dict[tuple[str, Any], str] = {("encoding", "metres"): "meters", ("space", "metres"): "meters"}


def renamed(content: Any) -> Any:
    """``content`` (a stored config, or a record that holds one, as plain values) with today's names."""
    if isinstance(content, list | tuple):
        return [renamed(item) for item in content]
    if not isinstance(content, Mapping):
        return content
    target = content.get("_target_")
    target = TARGETS.get(str(target), target)
    options = KEYS | OPTIONS.get(str(target), {})
    found = {}
    for key, value in content.items():
        new = options.get(key, key)
        found[new] = target if key == "_target_" else renamed(value)
        if isinstance(value, str) and (new, value) in VALUES:
            found[new] = VALUES[new, value]
    return found

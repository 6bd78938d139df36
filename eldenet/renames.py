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
#: Settings (dotted) that were renamed: old name -> new name.
SETTINGS: dict[str, str] = {}


def renamed(content: Any, name: str = "") -> Any:
    """``content``, plain (of a stored config or a record that holds one), with today's names."""
    if isinstance(content, list | tuple):
        return [renamed(item, name) for item in content]
    if not isinstance(content, Mapping):
        return content
    target = content.get("_target_")
    target = TARGETS.get(target, target) if isinstance(target, str) else None
    options = OPTIONS.get(str(target), {})
    found = {}
    for key, value in content.items():
        dotted = f"{name}.{key}" if name else str(key)
        new = SETTINGS[dotted].rpartition(".")[2] if dotted in SETTINGS else options.get(key, key)
        found[new] = target if key == "_target_" and target else renamed(value, dotted)
    return found

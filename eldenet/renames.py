"""Names that stored runs, checkpoints and saved models use for parts that are called something else today.

Everything that reads such a file passes it through :func:`renamed`, so that results stored under an old
name still count.
"""

from collections.abc import Mapping
from typing import Any

#: ``_target_`` of earlier versions -> today's.
TARGETS = {
    "eldenet.config.build_teacher": "eldenet.zoo.build_teacher",
    "eldenet.metrics.EvalProtocol": "eldenet.evaluation.protocol.EvalProtocol",
    "eldenet.navigation.dqn.DQN": "eldenet.navigation.dqn.DQNSettings",
    "eldenet.navigation.noise.NoisyRanges": "eldenet.navigation.noisy_ranges.NoisyRanges",
    "eldenet.schedules.constant": "eldenet.training.optim.constant",
    "eldenet.schedules.cosine": "eldenet.training.optim.cosine",
    "eldenet.schedules.epoch_decay": "eldenet.training.optim.epoch_decay",
    "eldenet.schedules.one_cycle": "eldenet.training.optim.one_cycle",
    "eldenet.trainer.Trainer": "eldenet.training.trainer.Trainer",
}
#: Today's ``_target_`` -> its options that were renamed: old name -> new name.
OPTIONS: dict[str, dict[str, str]] = {
    "eldenet.backbones.efficientnet.EfficientNetLite": {"size": "variant"},
    "eldenet.losses.pointwise.BerHuLoss": {"share": "threshold_ratio"},
    "eldenet.losses.silog.SILogLoss": {"balance": "variance_focus"},
    "eldenet.navigation.dqn.DQNSettings": {
        "exploration": "exploration_fraction",
        "exploration_end": "exploration_final_eps",
        "gradient_clip": "max_grad_norm",
        "gradient_every": "train_freq",
        "leg": "checkpoint_interval",
        "replay": "buffer_size",
        "steps": "total_timesteps",
        "target_every": "target_update_interval",
        "warmup": "learning_starts",
    },
    "eldenet.perception.tracking.BoxTracker": {
        "births": "min_hits",
        "deaths": "max_age",
        "gate": "max_distance",
    },
    "eldenet.training.optim.constant": {"warmup": "warmup_fraction"},
    "eldenet.training.optim.cosine": {"warmup": "warmup_fraction"},
    "eldenet.training.optim.one_cycle": {"peak": "max_lr_factor", "warmup": "warmup_fraction"},
    "eldenet.training.trainer.Trainer": {
        "accumulate": "accumulate_grad_batches",
        "backbone_lr": "backbone_lr_factor",
        "gradient_clip": "max_grad_norm",
    },
}
#: Renamed keys, at any depth: old name -> new name.
KEYS = {
    "film": "video",
    "load_size": "resize_on_load",
    "looks": "scans",
    "measure": "fit_noise",
    "movers": "pedestrians",
    "normalisation": "normalization",
    "worlds": "episodes",
}
#: Values that were renamed: (key, old value) -> new value.
VALUES: dict[tuple[str, Any], str] = {
    ("encoding", "metres"): "meters",
    ("mode", "watch"): "record",
    ("places", "crossings"): "episodes",
    ("space", "metres"): "meters",
}


def renamed(content: Any) -> Any:
    """Return a stored config, or a record that holds one, as plain values with today's names."""
    if isinstance(content, list | tuple):
        return [renamed(item) for item in content]
    if not isinstance(content, Mapping):
        return content
    target = content.get("_target_")
    target = TARGETS.get(str(target), target)
    options = KEYS | OPTIONS.get(str(target), {})
    found: dict[str, Any] = {}
    for key, value in content.items():
        new = str(options.get(key, key))
        found[new] = target if key == "_target_" else renamed(value)
        if isinstance(value, str) and (new, value) in VALUES:
            found[new] = VALUES[new, value]
    return found

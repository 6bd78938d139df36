"""What a setting or a choice that does not exist was meant to be."""

import difflib
from collections.abc import Sequence
from typing import Any

MEANT = {  # settings as other tools, and earlier states, call them
    "weights": "checkpoint",
    "model": "checkpoint",
    "input": "source",
    "image": "source",
    "video": "source",
    "run_dir": "output",
    "early_stopping": "trainer.patience",
    "early_stop": "trainer.patience",
    "amp": "runtime.precision",
    "fp16": "runtime.precision",
    "bf16": "runtime.precision",
    "half": "runtime.precision",
    "learning_rate": "optimizer.lr",
    "lr_scheduler": "scheduler",
    "max_epochs": "trainer.epochs",
    "num_epochs": "trainer.epochs",
    "batch": "trainer.batch_size",
    "num_workers": "runtime.workers",
    "gradient_clip_val": "trainer.max_grad_norm",
    "resume": "ckpt_path",
    "pretrained": "weights",
}
MOST_MEANT = 5  # names in a question


def line_on_choice(group: str, name: str, options: Sequence[str]) -> str:
    """Return a line on a choice that a group does not have."""
    name = name.removeprefix(f"{group}/")
    small = name.lower().replace("-", "_")
    near = [option for option in options if option.startswith(f"{small}_")] if small not in options else []
    near = near or difflib.get_close_matches(small, options, 1)
    meant = f"did you mean {' or '.join(near)}? " if 0 < len(near) <= MOST_MEANT else ""
    return f"{group}={name}: {meant}choose from {', '.join(options)}"


def line_on_setting(key: str, known: dict[str, Any]) -> str:
    """Return a line that asks whether the settings with the same last name, or a similar one, were meant."""
    if key == "experiment":  # a group that no default names
        return "experiment=... needs a plus: write +experiment=..."
    last = key.rpartition(".")[2]
    others = [name for name in known if name != key]  # it may exist with other choices
    alike = [name for name in others if name.rpartition(".")[2] == last]
    alike = alike or [name for name in others if name in (MEANT.get(key), MEANT.get(last))]
    ends = difflib.get_close_matches(last, {name.rpartition(".")[2] for name in others}, 1, 0.8)
    alike = alike or difflib.get_close_matches(key, others, 1)
    alike = alike or [name for name in others if name.rpartition(".")[2] in ends]
    if "/" in key:  # a group of choices
        alike = [name.replace(".", "/") for name in alike]
    found = f"did you mean {' or '.join(alike[:3])}?" if alike else "--help lists all settings"
    return f"there is no setting {key}: {found}"

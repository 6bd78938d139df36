"""The networks of a study's rows and their latency, for its accuracy-against-latency table and plot."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.record import write_rows
from eldenet.studies.composing import compose_run
from eldenet.studies.plan import Study

if TYPE_CHECKING:
    from eldenet.model import DepthNet

COSTS_FILE = "benchmark.csv"
COLUMNS = ("runtime", "precision", "threads", "device", "batch", "height", "width", "params", "gmacs")
FACTS = ("processor", "versions", "date", "command")


def row_networks(study: Study) -> tuple[dict[str, "DepthNet"], dict[str, str]]:
    """The different networks of a study, initialised from seed 0, and which of them each row has.

    Rows that differ in weights, loss or data alone share one. Options that only some trained run can give
    (``pretrained`` weights) are left out: they change no latency.

    Returns:
        Name of the first row with it -> network; row -> that name.
    """
    import torch

    networks: dict[str, DepthNet] = {}
    first: dict[str, str] = {}
    network_of: dict[str, str] = {}
    for row in study.rows:
        overrides = [*(row.owner or study).overrides, *row.overrides]
        config = compose_run(overrides, Path("unused"), Path("unused"), name=row.name, seed=0)
        parts = [cfg.plain(config.model), cfg.plain(config.data.input_size)]
        key = json.dumps(parts, sort_keys=True, default=str)
        name = first.setdefault(key, row.name)
        if name == row.name:
            torch.manual_seed(0)  # a benchmark knows what it measured by the weights
            networks[name] = cfg.build_model(config.model).eval()
        network_of[row.name] = name
    return networks, network_of


def write_costs(study: Study, measured: Sequence[Mapping[str, Any]], network_of: Mapping[str, str]) -> Path:
    """Write ``benchmark.csv`` of a study: a line for each row whose network was measured, once each."""
    by_network = {line["model"]: line for line in measured}
    path = study.folder / COSTS_FILE
    lines = [
        [row.name, line["latency_ms_p50"], *(_text(line[name]) for name in (*COLUMNS, *FACTS))]
        for row in study.rows
        if (line := by_network.get(network_of[row.name])) and line["latency_ms_p50"] is not None
    ]
    write_rows(path, ["row", "latency_ms_p50", *COLUMNS, *FACTS], lines)
    return path


def _text(fact: Any) -> Any:
    """Versions as words, in a cell."""
    return ", ".join(f"{name} {value}" for name, value in fact.items()) if isinstance(fact, Mapping) else fact

"""The networks of a study's rows and their latency, for its accuracy-against-latency table and plot."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.results.studies.matching import compose_run
from eldenet.results.studies.plan import Study
from eldenet.system.files import write_rows

if TYPE_CHECKING:
    from eldenet.model import DepthNet

COSTS_FILE = "benchmark.csv"
COLUMNS = ("runtime", "precision", "threads", "device", "batch", "height", "width", "params", "gmacs")
FACTS = ("processor", "versions", "date", "command")


@dataclass(frozen=True)
class RowNetworks:
    """The different networks of a study, each at the input that its rows train and score it with.

    Attributes:
        networks: initialized from seed 0, by the name of the first row with it.
        sizes: (height, width) [px] of each one's input.
        settings: of each, the ``model`` of a training's config.
        network_of: row -> which of them it has.
    """

    networks: dict[str, "DepthNet"]
    sizes: dict[str, tuple[int, int]]
    settings: dict[str, Any]
    network_of: dict[str, str]


def row_networks(study: Study) -> RowNetworks:
    """The networks of a study's rows.

    Rows that differ in weights, loss or data alone share one. Options that only some trained run can give
    (``pretrained`` weights) are left out: they change no latency.

    Raises:
        ValueError: a row's frames are not resized, so its input has no one size.
    """
    import torch

    found = RowNetworks({}, {}, {}, {})
    first: dict[str, str] = {}
    for row in study.rows:
        overrides = [*(row.owner or study).overrides, *row.overrides]
        config = compose_run(overrides, Path("unused"), Path("unused"), name=row.name, seed=0)
        settings, size = cfg.plain(config.model), cfg.plain(config.data.input_size)
        if size is None:
            raise ValueError(
                f"{study.name}, row {row.name}: data.input_size is null, so there is no one input to measure "
                "its latency at; give it a (height, width)"
            )
        name = first.setdefault(json.dumps([settings, size], sort_keys=True, default=str), row.name)
        if name == row.name:
            torch.manual_seed(0)  # a benchmark knows what it measured by the weights
            found.networks[name] = cfg.build_model(config.model).eval()
            found.settings[name], found.sizes[name] = settings, tuple(size)
        found.network_of[row.name] = name
    return found


def write_costs(study: Study, measured: Sequence[Mapping[str, Any]], rows: RowNetworks) -> Path:
    """Write ``benchmark.csv`` of a study: a line for each row whose network was measured, once each.

    Raises:
        ValueError: none was; the file that is there stays.
    """
    by_network = {line["model"]: line for line in measured}
    path = study.folder / (study.latency or COSTS_FILE)
    if all(line["latency_ms_p50"] is None for line in measured):
        reason = next((line["failed"] for line in measured if line.get("failed")), "nothing was measured")
        raise ValueError(f"no network of {study.name} has a latency, {path} stays as it is: {reason}")
    lines = [
        [
            *(row, line["latency_ms_p50"], *(_text(line[name]) for name in (*COLUMNS, *FACTS))),
            json.dumps(rows.settings[name], default=str),
        ]
        for row, name in rows.network_of.items()
        if (line := by_network.get(name)) and line["latency_ms_p50"] is not None
    ]
    write_rows(path, ["row", "latency_ms_p50", *COLUMNS, *FACTS, "network"], lines)
    return path


def _text(fact: Any) -> Any:
    """Versions as words, in a cell."""
    return ", ".join(f"{name} {value}" for name, value in fact.items()) if isinstance(fact, Mapping) else fact

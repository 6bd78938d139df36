"""Latencies of a study's rows: the networks that a benchmark measures, and the file that it writes."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet.configurable import instantiate
from eldenet.results.fingerprints import differences
from eldenet.results.run_record import check_figures
from eldenet.studies.matching import planned_settings
from eldenet.studies.plan import Study, StudyRow
from eldenet.system.errors import reading
from eldenet.system.files import read_table, write_rows

if TYPE_CHECKING:
    from eldenet.model import DepthNet

COSTS_FILE = "benchmark.csv"
COLUMNS = ("runtime", "precision", "threads", "device", "batch", "height", "width", "params", "gmacs")
FACTS = ("processor", "versions", "date", "command")
# one value of each in a file: latencies of two machines or runtimes do not compare
SAME = ("runtime", "precision", "threads", "device", "batch", "processor")
COUNTED = ("params", "gmacs", "height", "width")  # of a network, both measured and trained


@dataclass(frozen=True)
class RowNetworks:
    """The different networks of a study, each at the input size of its rows."""

    networks: dict[str, "DepthNet"]  # initialized from seed 0, by the name of the first row with it
    sizes: dict[str, tuple[int, int]]  # (height, width) [px] of each network's input
    settings: dict[str, Any]  # model section of each network's config
    network_of: dict[str, str]  # row -> name of its network


def row_networks(study: Study) -> RowNetworks:
    """The networks of a study's rows; rows that differ in weights, loss or data alone share one.

    Options that only a trained run can give (``pretrained`` weights) are left out: they change no latency.

    Raises:
        ValueError: a row's frames are not resized, so its input has no one size.
    """
    import torch

    found = RowNetworks({}, {}, {}, {})
    first: dict[str, str] = {}
    for row in study.rows:
        config = planned_settings(row, study.overrides_of(row), seed=0)
        settings, size = config["model"], config["data"]["input_size"]
        if size is None:
            raise ValueError(
                f"{study.name}, row {row.name}: data.input_size is null, so its latency has no single input "
                "size: give [height, width]"
            )
        name = first.setdefault(json.dumps([settings, size], sort_keys=True, default=str), row.name)
        if name == row.name:
            torch.manual_seed(0)  # a benchmark identifies networks by their weights
            found.networks[name] = instantiate(settings, "model").eval()
            found.settings[name], found.sizes[name] = settings, tuple(size)
        found.network_of[row.name] = name
    return found


def write_costs(study: Study, measured: Sequence[Mapping[str, Any]], rows: RowNetworks) -> Path:
    """Write ``benchmark.csv`` of a study: a line for each row whose network was measured.

    Raises:
        ValueError: none was; the existing file stays.
    """
    by_network = {line["model"]: line for line in measured if line["latency_ms_p50"] is not None}
    path = study.folder / (study.latency or COSTS_FILE)
    if not by_network:
        reason = next((line["failed"] for line in measured if line.get("failed")), "nothing was measured")
        raise ValueError(f"no latency of {study.name} was measured, and {path} was not changed: {reason}")
    lines = [
        [
            *(row, line["latency_ms_p50"], *(_text(line[name]) for name in (*COLUMNS, *FACTS))),
            json.dumps(rows.settings[name], default=str),
        ]
        for row, name in rows.network_of.items()
        if (line := by_network.get(name))
    ]
    write_rows(path, ["row", "latency_ms_p50", *COLUMNS, *FACTS, "network"], lines)
    return path


def _text(fact: Any) -> Any:
    """Versions as words, in a cell."""
    return ", ".join(f"{name} {value}" for name, value in fact.items()) if isinstance(fact, Mapping) else fact


@dataclass(frozen=True)
class Latencies:
    """The lines of a study's benchmark file by row."""

    lines: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, study: Study) -> "Latencies | None":
        """Read the file that ``sweep.yaml`` names; None: it names none.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is empty, or was measured on different machines or runtimes.
        """
        if study.latency is None:
            return None
        path = study.folder / study.latency
        if not path.is_file():
            raise FileNotFoundError(
                f"{path} does not exist, but sweep.yaml names it as latency: eldenet benchmark "
                f"study={study.folder} writes it"
            )
        needed = ("row", "latency_ms_p50", *COLUMNS, "processor", "date", "command", "network")
        table = read_table(path, needed) if path.stat().st_size else []
        with reading(path, "benchmark of a study", "restore it, or measure again"):
            lines = {line["row"]: {**line, "network": json.loads(line["network"])} for line in table}
            for line in lines.values():
                check_figures(path, {name: float(line[name]) for name in ("latency_ms_p50", *COUNTED)})
        if not lines:
            raise ValueError(f"{path} has no line: eldenet benchmark study={study.folder} writes it")
        for name in SAME:
            values = sorted({line[name] for line in lines.values()})
            if len(values) > 1:
                raise ValueError(f"{path}: {name} differs ({' | '.join(values)}): they cannot be compared")
        return cls(lines)

    def check(self, row: StudyRow, run: Mapping[str, Any]) -> None:
        """Raise ValueError for a latency of another network than a row's run has, or at another input."""
        line = self.lines.get(row.name)
        if line is None:
            return
        given = frozenset(setting.rpartition(".")[2] for setting in row.given.values())
        measured = {name: f"{float(line[name]):.6g}" for name in COUNTED}
        measured |= {"model": line["network"]}
        trained = {name: f"{run['cost'][name]:.6g}" for name in COUNTED} | {"model": run["config"]["model"]}
        different = differences(measured, trained, ignored=given)
        if different:
            raise ValueError(
                f"the latency of {row.name} was measured on another network than its runs have: "
                f"{', '.join(different[:3])}. Measure it again (eldenet benchmark study=...)"
            )

    def of(self, row: str) -> float | None:
        """Median latency of a row's network [ms], None where it was not measured."""
        return float(self.lines[row]["latency_ms_p50"]) if row in self.lines else None

    @property
    def title(self) -> str:
        """Title of the column and of the plot's axis."""
        return f"latency [ms] ({next(iter(self.lines.values()))['runtime']})"

    @property
    def line(self) -> str:
        """One line on what they were measured on."""
        facts = next(iter(self.lines.values()))
        sizes = sorted({(int(line["height"]), int(line["width"])) for line in self.lines.values()})
        inputs = " or ".join(f"{height} x {width}" for height, width in sizes)
        inputs += ", each row at its own" if len(sizes) > 1 else ""
        return (
            f"latency: median of interleaved rounds, {facts['runtime']}, {facts['precision']}, "
            f"{facts['threads']} threads, {facts['device']} ({facts['processor']}), "
            f"input {inputs}, batch {facts['batch']}; {facts['date']}, "
            f"`{facts['command']}`" + (f"; {facts['versions']}" if facts.get("versions") else "")
        )

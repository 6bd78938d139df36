"""Latencies of a study's rows that a benchmark measured beside each other, and what it measured them on."""

import csv
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from eldenet.results.run_record import differences
from eldenet.results.studies.plan import Study, StudyRow

# one value of each in a file: latencies of two machines or runtimes do not compare
SAME = ("runtime", "precision", "threads", "device", "batch", "processor")
# of a network, where it was measured and where it was trained
COUNTED = ("params", "gmacs", "height", "width")


@dataclass(frozen=True)
class Latencies:
    """The lines of a study's benchmark file by row."""

    lines: Mapping[str, Mapping[str, str]]

    @classmethod
    def read(cls, study: Study) -> "Latencies | None":
        """Those that ``sweep.yaml`` names; None: it names none.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: there is no line, or they were measured on different machines or runtimes.
        """
        if study.latency is None:
            return None
        path = study.folder / study.latency
        if not path.is_file():
            raise FileNotFoundError(f"{path} does not exist, but sweep.yaml there names it as its latency")
        with path.open(newline="") as content:
            lines = {line["row"]: line for line in csv.DictReader(content)}
        if not lines:
            raise ValueError(f"{path} has no line: python -m eldenet.benchmark study={study.folder} makes it")
        for name in SAME:
            values = sorted({line[name] for line in lines.values()})
            if len(values) > 1:
                raise ValueError(f"{path}: {name} differs ({' | '.join(values)}): they do not compare")
        return cls(lines)

    def check(self, row: StudyRow, run: Mapping[str, Any]) -> None:
        """Refuse the latency of another network than that of a row's run, or at another input.

        What the row is given (``pretrained`` weights) changes no latency. Files of before networks were
        written down tell them by their counts alone.

        Raises:
            ValueError: names what differs.
        """
        line = self.lines.get(row.name)
        if line is None:
            return
        cost = run["cost"]
        different = [
            f"{name}={line[name]} (there {cost[name]})"
            for name in COUNTED
            if not math.isclose(float(line[name]), cost[name], rel_tol=1e-6)
        ]
        if line.get("network"):
            given = frozenset(setting.rpartition(".")[2] for setting in (row.given or {}).values())
            measured = json.loads(line["network"])
            different += differences(measured, run["config"]["model"], "model", ignored=given)
        if different:
            raise ValueError(
                f"the latency of {row.name} was measured on another network than its runs have: "
                f"{', '.join(different[:3])}. Measure it again (python -m eldenet.benchmark study=...)"
            )

    def of(self, row: str) -> float | None:
        """Median latency of a row's network [ms], None where it was not measured."""
        return float(self.lines[row]["latency_ms_p50"]) if row in self.lines else None

    def text(self, row: str) -> str:
        """The same for a table."""
        latency = self.of(row)
        return "-" if latency is None else f"{latency:.2f}"

    @property
    def title(self) -> str:
        """Of the column, and of the plot's axis."""
        return f"latency [ms] ({next(iter(self.lines.values()))['runtime']})"

    @property
    def line(self) -> str:
        """One line that says what they were measured on."""
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

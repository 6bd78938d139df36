"""``python -m eldenet.benchmark``: models, sizes, batches, runtimes, precisions, threads -> one table.

python -m eldenet.benchmark 'models=[eldenet,resnet18_upconv]' 'sizes=[[224,224]]' 'threads=[1,2]'
python -m eldenet.benchmark 'models=[runs/mine,runs/rival]' 'accuracies=[runs]' 'precisions=[fp32,bf16,int8]'
python -m eldenet.benchmark study=experiments/table3_rivals 'runtimes=[onnxruntime]'
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import eldenet
from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.compose import listed
from eldenet.deploy.benchmarking.rows import append_rows, machine, network_digest, other_machine, read_rows
from eldenet.deploy.benchmarking.tables import read_accuracies, write_results
from eldenet.deploy.calibration_pictures import read_pictures
from eldenet.deploy.metadata import describe, is_whole
from eldenet.deploy.openvino_export import quantize_openvino, write_openvino
from eldenet.deploy.predictor import as_image
from eldenet.deploy.runtimes import PACKAGES, PRECISIONS, RUNTIMES, TORCH
from eldenet.evaluation.metric_names import METRICS
from eldenet.geometry import resize_image
from eldenet.results.run_log import RunLog
from eldenet.system.checks import at_least, check_size, one_of
from eldenet.system.digests import digest_of
from eldenet.system.extras import require
from eldenet.system.files import safe_stem
from eldenet.weights import find_checkpoint, list_models, name_of

if TYPE_CHECKING:
    from eldenet.deploy.benchmarking.measure import Case, Network
    from eldenet.model import DepthNet

DEFAULT_REFERENCE = "resnet18_upconv"  # it may be absent


@dataclass(frozen=True)
class BenchmarkSettings:
    """What ``python -m eldenet.benchmark`` reads."""

    # names (configs/model), run folders, model folders or Hub ids; null: all names
    models: Any = field(default_factory=lambda: ["eldenet", "resnet18_upconv"])
    # folder of a study: measures the networks of its rows and writes their latencies to its benchmark.csv
    study: str | None = None
    # (height, width) [px]; not for a study, whose rows have data.input_size
    sizes: Any = field(default_factory=lambda: [[224, 224]])
    batches: Any = field(default_factory=lambda: [1])
    # also torch, torch_compile (compiles for minutes)
    runtimes: Any = field(default_factory=lambda: ["torch_channels_last", "onnxruntime", "openvino"])
    # fp32, bf16, fp16, int8; a row that a runtime cannot run says why
    precisions: Any = field(default_factory=lambda: ["fp32"])
    threads: Any = field(default_factory=lambda: [1])  # on a CPU
    device: str = "cpu"  # cpu, cuda, tensorrt (onnxruntime), gpu, npu (openvino)
    # ratio_latency refers to its fp32 row of the same size, batch, runtime, threads
    reference: str = DEFAULT_REFERENCE
    rounds: int = 7  # turns of each row; the rows of one size, batch, runtime, threads take turns
    seconds: float = 0.2  # duration of each turn
    memory: bool = True  # measure memory too, each row in its own process (seconds per row)
    calibration: int = 32  # number of pictures for the scales of int8
    pictures: str | None = None  # for int8, as in eldenet.export; null: the built-in rooms
    # run.json files, or their folders: the plot then shows accuracy over latency
    accuracies: Any = field(default_factory=list)
    accuracy: str = "delta1"  # metric for accuracies
    trusted_modules: Any = field(default_factory=list)  # packages that a config.json from elsewhere may name
    overwrite: bool = False  # true: measure existing rows again
    # folder for rows.jsonl (all rows), results.md .csv .tex .png, exports/
    output: str = "runs/benchmark"

    def __post_init__(self) -> None:
        for name in ("sizes", "batches", "runtimes", "precisions", "threads"):
            if not listed(getattr(self, name)):
                raise ValueError(f"{name}={getattr(self, name)}: give at least one")
        for runtime in listed(self.runtimes):
            one_of("runtimes", runtime, RUNTIMES)
        for precision in listed(self.precisions):
            one_of("precisions", precision, PRECISIONS)
        for name in ("batches", "threads"):
            if not all(type(count) is int and count >= 1 for count in listed(getattr(self, name))):
                raise ValueError(f"{name}={getattr(self, name)}: give a list of whole numbers of 1 or more")
        at_least(1, rounds=self.rounds, calibration=self.calibration)
        if not 0 < self.seconds < math.inf:
            raise ValueError(f"seconds={self.seconds}: give a time above 0 for each turn")
        sizes = listed(self.sizes)
        if not all(isinstance(size, list) and [*map(type, size)] == [int, int] for size in sizes):
            raise ValueError(f"sizes={self.sizes}: give [[height, width], ...] in pixels")
        for size in sizes:
            check_size("sizes", size)
        one_of("accuracy", self.accuracy, METRICS)

    @property
    def calibrated(self) -> str:
        """Identity of the pictures that give int8 its scales."""
        return f"{self.pictures} {self.calibration}"

    @property
    def folder(self) -> Path:
        """Where the results go."""
        return Path(self.output).expanduser()


@dataclass(frozen=True)
class Networks:
    """The networks of a table.

    Attributes:
        models: name of the rows -> network.
        sizes: each one's ``(height, width)`` [px]; None: all have the sizes of the settings.
        finish: writes a study's latencies, and returns the file; None: there is no study.
    """

    models: Mapping[str, "DepthNet"]
    sizes: Mapping[str, tuple[int, int]] | None = None
    finish: Callable[[Sequence[Mapping[str, Any]]], Path] | None = None


def benchmark(s: BenchmarkSettings) -> list[dict[str, Any]]:
    """Measure the missing rows, write each group when it is done, then write the tables of all rows.

    Raises:
        ValueError: two models share a name, the reference is none of them, the accuracies do not compare, or
            every row failed.
    """
    found = load_models(s) if s.study is None else study_models(s)
    log = RunLog(s.folder)
    if s.reference not in found.models:
        if s.reference != DEFAULT_REFERENCE:
            names = ", ".join(found.models)
            raise ValueError(f"reference={s.reference} is not among the models: choose one of {names}")
        log.say(f"reference {s.reference} is not among the models: no ratio_latency (give reference=)")
    cases = list_cases(s, list(found.models), found.sizes)
    accuracies = read_accuracies(listed(s.accuracies), s.accuracy, found.models)
    fingerprints = {name: network_digest(model) for name, model in found.models.items()}
    machine_now, command = machine()

    def is_alike(row: Mapping[str, Any]) -> bool:
        return measured_alike(row, s, fingerprints)

    def counts(row: Mapping[str, Any]) -> bool:
        return is_alike(row) and not other_machine(row, machine_now)

    earlier = {} if s.overwrite else read_rows(s.folder, counts)
    wanted = {case.key for case in cases}
    elsewhere = [row for key, row in read_rows(s.folder, is_alike).items() if key in wanted - set(earlier)]
    if elsewhere and not s.overwrite:
        difference = other_machine(elsewhere[0], machine_now)
        log.say(
            f"{len(elsewhere)} rows come from another machine ({difference}) and are measured again: all "
            "rows of a table come from one machine"
        )
    # rows of a study compare across inputs, so all of them take turns
    by_group = itertools.groupby(cases, key=lambda case: case.group)
    groups = [cases] if found.sizes else [list(group) for _, group in by_group]
    for number, group in enumerate(groups, 1):
        title = f"[{number}/{len(groups)}] {describe_group(group)}"
        if all(case.key in earlier for case in group):
            log.say(f"{title}: measured before (overwrite=true measures again)")
            continue
        log.say(f"{title}: {len(group)} rows")
        rows = measured(group, found.models, fingerprints, s)
        for row in rows:
            row |= {
                **machine_now,
                "command": command,
                "date": datetime.now(UTC).isoformat(timespec="seconds"),
            }
            if row["failed"]:
                log.say(f"  {row['model']}, {row['precision']}: {row['failed']}")
        # rows measured before stay, though the whole group took turns; a study's are all of one session
        append_rows(s.folder, [row for row in rows if found.sizes or tuple(row["key"]) not in earlier])
    rows = [row for key, row in read_rows(s.folder, counts).items() if key in wanted]
    write_results(rows, accuracies, s.folder, log)
    if found.finish is not None:
        log.say(f"the study's latencies: {found.finish(rows)}")
    if all(row["failed"] for row in rows):
        raise ValueError(f"no row was measured; the first: {rows[0]['failed']}")
    return rows


def measured(
    group: Sequence["Case"],
    models: Mapping[str, "DepthNet"],
    fingerprints: Mapping[str, str],
    s: BenchmarkSettings,
) -> list[dict[str, Any]]:
    """Rows of one group, with what decides whether they count later (:func:`measured_alike`)."""
    from eldenet.deploy.benchmarking.measure import measure_group

    networks = {case: prepare(case, models[case.model], fingerprints[case.model], s) for case in group}
    rows = measure_group(
        group,
        networks,
        reference=s.reference,
        rounds=s.rounds,
        seconds=s.seconds,
        memory=s.memory,
        trusted_modules=listed(s.trusted_modules),
    )
    for case, row in zip(group, rows, strict=True):
        row |= {"key": list(case.key), "fingerprint": fingerprints[case.model], "calibrated": s.calibrated}
        row |= {"reference": s.reference, "rounds": s.rounds, "seconds": s.seconds, "memory": s.memory}
        row["ratio_to"] = ratio_to(s, fingerprints)
    return rows


def measured_alike(row: Mapping[str, Any], s: BenchmarkSettings, fingerprints: Mapping[str, str]) -> bool:
    """Return whether a stored row was measured as the settings ask for, of the same weights.

    That is with the same reference, rounds and seconds; int8 with the same pictures; and memory, if wanted.
    """
    if row.get("precision") == "int8" and row.get("calibrated") != s.calibrated:
        return False
    if s.memory and not row.get("memory"):
        return False
    to = ratio_to(s, fingerprints)
    if to is not None and row.get("ratio_to") != to:
        return False
    asked = (fingerprints.get(row["model"]), s.reference, s.rounds, s.seconds)
    return tuple(row.get(name) for name in ("fingerprint", "reference", "rounds", "seconds")) == asked


def ratio_to(s: BenchmarkSettings, fingerprints: Mapping[str, str]) -> str | None:
    """Digest of the network that ``ratio_latency`` refers to; None: no such row is asked for."""
    return fingerprints.get(s.reference) if "fp32" in listed(s.precisions) else None


def study_models(s: BenchmarkSettings) -> Networks:
    """The networks of a study's rows, each at its own input.

    Raises:
        ValueError: several measurements of each are asked for, or the study shows another study's latencies.
    """
    from eldenet.studies.latency import row_networks, write_costs
    from eldenet.studies.plan import read_study

    study = read_study(str(s.study))
    lists = ("batches", "runtimes", "precisions", "threads")
    several = [name for name in lists if len(listed(getattr(s, name))) != 1]
    if several:
        raise ValueError(
            f"a study has one latency per row: give one value each for {', '.join(several)}, such as "
            "runtimes=[onnxruntime]"
        )
    if study.latency is not None and Path(study.latency).parent != Path():
        raise ValueError(
            f"{study.name} shows the latencies of another study, in {study.latency}: measure that one "
            f"(study={Path(study.folder, study.latency).parent})"
        )
    found = row_networks(study)
    return Networks(found.networks, found.sizes, lambda rows: write_costs(study, rows, found))


def load_models(s: BenchmarkSettings) -> Networks:
    """The networks that ``models`` names.

    Raises:
        ValueError: there are none, or two have one name.
    """
    sources = list_models() if s.models is None else [str(source) for source in listed(s.models)]
    for source in sources:
        find_checkpoint(source, "models")
    import torch

    models: dict[str, DepthNet] = {}
    for source in sources:
        torch.manual_seed(0)
        trusted = () if find_checkpoint(source).kind == "network" else listed(s.trusted_modules)
        model = eldenet.load(source, trusted_modules=trusted)
        name = name_of(source, model.info)
        if name in models:
            raise ValueError(
                f"two models are called {name!r}, but rows need distinct names: give one of them another "
                "model_name="
            )
        models[name] = model
    if not models:
        raise ValueError("models is empty: give names, or folders")
    return Networks(models)


def describe_group(group: Sequence["Case"]) -> str:
    """``224 224 batch 1 onnxruntime 1 cpu``, or ``3 inputs batch 1 ...``."""
    sizes = {(case.height, case.width) for case in group}
    size = group[0].group[:2] if len(sizes) == 1 else (f"{len(sizes)} inputs",)
    return " ".join(map(str, (*size, f"batch {group[0].batch}", *group[0].group[3:])))


def list_cases(
    s: BenchmarkSettings, names: Sequence[str], own_sizes: Mapping[str, tuple[int, int]] | None = None
) -> list["Case"]:
    """Every row that is asked for, group by group; ``own_sizes`` replaces those of the settings."""
    from eldenet.deploy.benchmarking.measure import Case

    sizes = listed(s.sizes) if own_sizes is None else sorted({*own_sizes.values()})
    return [
        Case(name, height, width, batch, runtime, precision, threads, s.device)
        for (height, width), batch, runtime, threads in itertools.product(
            sizes, listed(s.batches), listed(s.runtimes), listed(s.threads)
        )
        for precision in listed(s.precisions)
        for name in names
        if own_sizes is None or own_sizes[name] == (height, width)
    ]


def prepare(case: "Case", model: "DepthNet", fingerprint: str, s: BenchmarkSettings) -> "Network":
    """Count what a case computes and make the file that it runs, unless it is there."""
    from eldenet.deploy.benchmarking.measure import Network, reason_of
    from eldenet.deploy.fold import fold
    from eldenet.evaluation.cost import count_macs, count_params

    size = (case.height, case.width)
    params, macs, run_macs = count_params(model), count_macs(model, size), count_macs(fold(model), size)
    try:
        source = _write_source(case, model, f"{safe_stem(case.model)}-{fingerprint}", s)
    except Exception as error:  # a failed export is the row's result
        return Network(None, params, macs, run_macs, reason_of(error))
    return Network(source, params, macs, run_macs)


def _write_source(case: "Case", model: "DepthNet", name: str, s: BenchmarkSettings) -> Path:
    """Write the folder or file that a case loads, unless it is there; it is called after ``name``."""
    from eldenet.deploy.onnx_export import quantize_onnx, write_onnx

    folder, size = s.folder / "exports", (case.height, case.width)
    require(f"runtime={case.runtime}", *PACKAGES[case.runtime])
    if case.runtime in TORCH:
        return model.save_pretrained(folder / name)
    stem = f"{name}-{case.height}x{case.width}-batch{case.batch}"
    graph, metadata = folder / f"{stem}.onnx", describe(model, case.model, size)
    if s.overwrite or not is_whole(graph):
        write_onnx(model, graph, size, batch=case.batch, metadata=metadata)
    # other calibration pictures make another int8 file
    quantized = f"-int8-{digest_of(s.calibrated)[:8]}" if case.precision == "int8" else ""
    path = folder / f"{stem}{quantized}{'.onnx' if case.runtime == 'onnxruntime' else '.xml'}"
    if path == graph or (is_whole(path) and not s.overwrite):
        return path
    if not quantized:
        return write_openvino(graph, path, metadata)
    frames = read_pictures(s.pictures, s.calibration, "train")
    inputs = [as_image(resize_image(frame, size)).repeat(case.batch, axis=0) for frame in frames]
    if case.runtime == "onnxruntime":
        return quantize_onnx(graph, path, inputs)
    return quantize_openvino(graph, path, inputs, metadata)


@entry_point(BenchmarkSettings)
def main(s: BenchmarkSettings) -> None:
    """Refuse what a study's rows set, then measure."""
    if s.study is not None:
        refuse_unread(
            ("models", "sizes"), "not read with study=, whose rows name the networks and their inputs"
        )
    require("the plot of latencies", "matplotlib")
    benchmark(s)


if __name__ == "__main__":
    main()

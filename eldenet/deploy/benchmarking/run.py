"""Measure models x sizes x batches x runtimes x precisions x threads, and write one table."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

import eldenet
from eldenet.deploy.benchmarking.measure import Case, Network, measure_group, reason_of
from eldenet.deploy.benchmarking.rows import (
    append_rows,
    machine,
    network_digest,
    other_machine,
    read_rows,
)
from eldenet.deploy.benchmarking.tables import read_accuracies, write_results
from eldenet.deploy.fold import fold
from eldenet.deploy.metadata import describe, is_whole
from eldenet.deploy.onnx_export import quantize_onnx, write_onnx
from eldenet.deploy.openvino_export import quantize_openvino, write_openvino
from eldenet.deploy.pictures import read_pictures
from eldenet.deploy.predictor import as_image
from eldenet.deploy.runtimes import PACKAGES, TORCH
from eldenet.evaluation.cost import count_macs, count_params
from eldenet.geometry import resize_image
from eldenet.results.run_log import RunLog
from eldenet.system.digests import digest_of
from eldenet.system.extras import require
from eldenet.system.files import safe_stem
from eldenet.weights import find_checkpoint, name_of

if TYPE_CHECKING:
    from eldenet.model import DepthNet
    from eldenet.results.studies.plan import Composition

DEFAULT_REFERENCE = "resnet18_upconv"  # of configs/benchmark.yaml; it may be absent


@dataclass(frozen=True)
class BenchmarkSetup:
    """The settings of ``configs/benchmark.yaml``, checked; it explains each."""

    models: tuple[str, ...]
    study: str | None
    sizes: tuple[tuple[int, int], ...]
    batches: tuple[int, ...]
    runtimes: tuple[str, ...]
    precisions: tuple[str, ...]
    threads: tuple[int, ...]
    device: str
    reference: str
    rounds: int
    seconds: float
    memory: bool
    calibration: int
    pictures: str | None
    accuracies: tuple[str, ...]
    accuracy: str
    trusted_modules: tuple[str, ...]
    overwrite: bool
    output: Path
    composition: "Composition"

    @property
    def calibrated(self) -> str:
        """Identity of the pictures that give int8 its scales."""
        return f"{self.pictures} {self.calibration}"


@dataclass(frozen=True)
class Networks:
    """The networks of a table.

    Attributes:
        models: name of the rows -> network.
        sizes: each one's ``(height, width)`` [px]; None: all have the sizes of the setup.
        finish: writes a study's latencies, and returns the file; None: there is no study.
    """

    models: Mapping[str, "DepthNet"]
    sizes: Mapping[str, tuple[int, int]] | None = None
    finish: Callable[[Sequence[Mapping[str, Any]]], Path] | None = None


def benchmark(setup: BenchmarkSetup) -> list[dict[str, Any]]:
    """Measure the missing rows, write each group when it is done, then write the tables of all rows.

    Raises:
        ValueError: two models share a name, the reference is none of them, or the accuracies do not compare.
    """
    found = load_models(setup) if setup.study is None else study_models(setup)
    log = RunLog(setup.output)
    if setup.reference not in found.models:
        if setup.reference != DEFAULT_REFERENCE:
            names = ", ".join(found.models)
            raise ValueError(f"reference={setup.reference} is not among the models: choose one of {names}")
        log.say(f"reference {setup.reference} is not among the models: no ratio_latency (give reference=)")
    cases = list_cases(setup, list(found.models), found.sizes)
    accuracies = read_accuracies(setup.accuracies, setup.accuracy, found.models)
    prints = {name: network_digest(model) for name, model in found.models.items()}
    machine_now, command = machine()

    def is_alike(row: Mapping[str, Any]) -> bool:
        return measured_alike(row, setup, prints.get(row["model"]))

    def counts(row: Mapping[str, Any]) -> bool:
        return is_alike(row) and not other_machine(row, machine_now)

    earlier = {} if setup.overwrite else read_rows(setup.output, counts)
    wanted = {case.key for case in cases}
    elsewhere = [
        row for key, row in read_rows(setup.output, is_alike).items() if key in wanted - set(earlier)
    ]
    if elsewhere and not setup.overwrite:
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
        rows = measured(group, found.models, prints, setup)
        for row in rows:
            row |= {
                **machine_now,
                "command": command,
                "date": datetime.now(UTC).isoformat(timespec="seconds"),
            }
            if row["failed"]:
                log.say(f"  {row['model']}, {row['precision']}: {row['failed']}")
        # rows measured before stay, though the whole group took turns; a study's are all of one session
        append_rows(setup.output, [row for row in rows if found.sizes or tuple(row["key"]) not in earlier])
    rows = [row for key, row in read_rows(setup.output, counts).items() if key in wanted]
    write_results(rows, accuracies, setup.output, log)
    if found.finish is not None:
        log.say(f"the study's latencies: {found.finish(rows)}")
    return rows


def measured(
    group: Sequence[Case],
    models: Mapping[str, "DepthNet"],
    prints: Mapping[str, str],
    setup: BenchmarkSetup,
) -> list[dict[str, Any]]:
    """Rows of one group, with what decides whether they count later (:func:`measured_alike`)."""
    networks = {case: prepare(case, models[case.model], prints[case.model], setup) for case in group}
    rows = measure_group(
        group,
        networks,
        reference=setup.reference,
        rounds=setup.rounds,
        seconds=setup.seconds,
        memory=setup.memory,
        trusted_modules=setup.trusted_modules,
    )
    for case, row in zip(group, rows, strict=True):
        row |= {"key": list(case.key), "fingerprint": prints[case.model], "calibrated": setup.calibrated}
        row |= {"reference": setup.reference, "rounds": setup.rounds, "seconds": setup.seconds}
    return rows


def measured_alike(row: Mapping[str, Any], setup: BenchmarkSetup, fingerprint: str | None) -> bool:
    """Return whether a stored row has the weights, reference, rounds and seconds that are asked for."""
    if row.get("precision") == "int8" and row.get("calibrated") != setup.calibrated:
        return False
    asked = (fingerprint, setup.reference, setup.rounds, setup.seconds)
    return tuple(row.get(name) for name in ("fingerprint", "reference", "rounds", "seconds")) == asked


def study_models(setup: BenchmarkSetup) -> Networks:
    """The networks of a study's rows, each at its own input.

    Raises:
        ValueError: several measurements of each are asked for, or the study shows another study's latencies.
    """
    from eldenet.results.studies.latency import row_networks, write_costs
    from eldenet.results.studies.plan import read_study

    several = [
        name for name in ("batches", "runtimes", "precisions", "threads") if len(getattr(setup, name)) != 1
    ]
    if several:
        raise ValueError(f"a study has one latency per row: give one value each for {', '.join(several)}")
    study = read_study(str(setup.study), setup.composition)
    if study.latency is not None and Path(study.latency).parent != Path():
        raise ValueError(
            f"{study.name} shows the latencies of another study, in {study.latency}: measure that one "
            f"(study={Path(study.folder, study.latency).parent})"
        )
    found = row_networks(study)
    return Networks(found.networks, found.sizes, lambda rows: write_costs(study, rows, found))


def load_models(setup: BenchmarkSetup) -> Networks:
    """The networks that ``models`` names.

    Raises:
        ValueError: there are none, or two have one name.
    """
    models: dict[str, DepthNet] = {}
    for source in setup.models:
        torch.manual_seed(0)
        trusted = () if find_checkpoint(source).kind == "network" else setup.trusted_modules
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


def describe_group(group: Sequence[Case]) -> str:
    """``224 224 batch 1 onnxruntime 1 cpu``, or ``3 inputs batch 1 ...``."""
    sizes = {(case.height, case.width) for case in group}
    size = group[0].group[:2] if len(sizes) == 1 else (f"{len(sizes)} inputs",)
    return " ".join(map(str, (*size, f"batch {group[0].batch}", *group[0].group[3:])))


def list_cases(
    setup: BenchmarkSetup, names: Sequence[str], own_sizes: Mapping[str, tuple[int, int]] | None = None
) -> list[Case]:
    """Every row that is asked for, group by group; ``own_sizes`` replaces the sizes of the setup."""
    sizes = setup.sizes if own_sizes is None else sorted({*own_sizes.values()})
    return [
        Case(name, height, width, batch, runtime, precision, threads, setup.device)
        for (height, width), batch, runtime, threads in itertools.product(
            sizes, setup.batches, setup.runtimes, setup.threads
        )
        for precision in setup.precisions
        for name in names
        if own_sizes is None or own_sizes[name] == (height, width)
    ]


def prepare(case: Case, model: "DepthNet", fingerprint: str, setup: BenchmarkSetup) -> Network:
    """Count what a case computes and make the file that it runs, unless it is there."""
    size = (case.height, case.width)
    params, macs, run_macs = count_params(model), count_macs(model, size), count_macs(fold(model), size)
    try:
        source = _make(case, model, f"{safe_stem(case.model)}-{fingerprint}", setup)
    except Exception as error:  # a failed export is the row's result
        return Network(None, params, macs, run_macs, reason_of(error))
    return Network(source, params, macs, run_macs)


def _make(case: Case, model: "DepthNet", name: str, setup: BenchmarkSetup) -> Path:
    folder, size = setup.output / "exports", (case.height, case.width)
    require(f"runtime={case.runtime}", *PACKAGES[case.runtime])
    if case.runtime in TORCH:
        return model.save_pretrained(folder / name)
    stem = f"{name}-{case.height}x{case.width}-batch{case.batch}"
    graph, metadata = folder / f"{stem}.onnx", describe(model, case.model, size)
    if setup.overwrite or not is_whole(graph):
        write_onnx(model, graph, size, batch=case.batch, metadata=metadata)
    # other calibration pictures make another int8 file
    pictures = digest_of(setup.calibrated)[:8]
    quantized = f"-int8-{pictures}" if case.precision == "int8" else ""
    path = folder / f"{stem}{quantized}{'.onnx' if case.runtime == 'onnxruntime' else '.xml'}"
    if is_whole(path) and not (setup.overwrite and path != graph):
        return path
    if not quantized:
        return write_openvino(graph, path, metadata)
    frames = read_pictures(setup.pictures, setup.calibration, "train")
    inputs = [as_image(resize_image(frame, size)).repeat(case.batch, axis=0) for frame in frames]
    if case.runtime == "onnxruntime":
        return quantize_onnx(graph, path, inputs)
    return quantize_openvino(graph, path, inputs, metadata)

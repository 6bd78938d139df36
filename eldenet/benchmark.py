"""``python -m eldenet.benchmark``: models, sizes, batches, runtimes, precisions, threads -> one table."""

import hashlib
import itertools
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point, refuse_unread
from eldenet.deploy.benchmarking.rows import calibrated, machine, measured_alike, other_machine

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.deploy.benchmarking.measure import Case, Network
    from eldenet.model import DepthNet

DEFAULT_REFERENCE = "resnet18_upconv"  # of configs/benchmark.yaml: it may be absent
LISTS = ("models", "batches", "runtimes", "precisions", "threads", "accuracies")


@entry_point("benchmark")
def main(config: "DictConfig", folder: Path) -> None:
    """Measure; ``folder`` is not used, results go to ``output``."""
    if config.study is not None:
        refuse_unread(
            ("models", "sizes"),
            "not read with study=, whose rows say which networks are measured, at what input",
        )
    benchmark(config)


def benchmark(config: "DictConfig") -> list[dict[str, Any]]:
    """Measure what is not there yet, write each group as it is done, then the tables of all asked for."""
    from eldenet.deploy.benchmarking.measure import append_rows, fingerprint, measure_group, read_rows
    from eldenet.deploy.benchmarking.tables import read_accuracies, write_results
    from eldenet.results.run_log import RunLog

    for name in LISTS:  # models=eldenet is a list of one
        if config[name] is not None:
            config[name] = cfg.listed(config[name])
    output = Path(config.output).expanduser()
    if config.study is None:
        models, sizes, finish = load_models(config), None, None
    else:
        models, sizes, finish = study_models(config)
    check_reference(config, list(models))
    cases = list_cases(config, list(models), sizes)
    read_accuracies(config, models)  # refused before measuring
    log = RunLog(output)
    if str(config.reference) not in models:
        log.say(f"reference {config.reference} is not among the models: no ratio_latency (give reference=)")
    prints = {name: fingerprint(model) for name, model in models.items()}
    here, command = machine()

    def asked(row: Mapping[str, Any]) -> bool:
        return measured_alike(row, config, prints.get(row["model"]))

    def alike(row: Mapping[str, Any]) -> bool:
        return asked(row) and not other_machine(row, here)

    there = {} if config.overwrite else read_rows(output, alike)
    wanted = {case.key for case in cases}
    elsewhere = [row for key, row in read_rows(output, asked).items() if key in wanted - set(there)]
    if elsewhere and not config.overwrite:
        log.say(
            f"{len(elsewhere)} rows there are of another machine ({other_machine(elsewhere[0], here)}): "
            "they are measured anew, as a table is of one"
        )
    # a study's rows compare whatever their inputs are, so all of them take turns
    groups = (
        [cases] if sizes else [list(one) for _, one in itertools.groupby(cases, key=lambda case: case.group)]
    )
    for number, group in enumerate(groups, 1):
        title = describe_group(group)
        if all(case.key in there for case in group):
            log.say(f"[{number}/{len(groups)}] {title}: measured before (overwrite=true measures again)")
            continue
        log.say(f"[{number}/{len(groups)}] {title}: {len(group)} rows")
        networks = {
            case: prepare(case, models[case.model], prints[case.model], config, output / "exports")
            for case in group
        }
        rows = measure_group(
            group,
            networks,
            reference=str(config.reference),
            rounds=config.rounds,
            seconds=config.seconds,
            memory=config.memory,
            trusted_modules=cfg.plain(config.trusted_modules),
        )
        for case, row in zip(group, rows, strict=True):
            row |= {
                "key": list(case.key),
                "fingerprint": prints[case.model],
                **here,
                "command": command,
                "date": datetime.now(UTC).isoformat(timespec="seconds"),
                "reference": str(config.reference),
                "rounds": config.rounds,
                "seconds": config.seconds,
                "calibrated": calibrated(config),
            }
            if row["failed"]:
                log.say(f"  {case.model}, {case.precision}: {row['failed']}")
        # what was measured before stays: the group ran whole, so that the missing rows took turns with it; of
        # a study, whose table is of one session, all are replaced
        append_rows(output, [row for row in rows if sizes or tuple(row["key"]) not in there])
    rows = [row for key, row in read_rows(output, alike).items() if key in wanted]
    write_results(config, rows, output, log)
    if finish is not None:
        log.say(f"the study's latencies: {finish(rows)}")
    return rows


def study_models(
    config: "DictConfig",
) -> tuple[dict[str, "DepthNet"], dict[str, tuple[int, int]], Callable[[Sequence[Mapping[str, Any]]], Path]]:
    """The networks of a study's rows, the input of each, and what writes their latencies into its folder.

    Raises:
        ValueError: more than one measurement of each is asked for, or the study's latencies are another's:
            refused before measuring.
    """
    from eldenet.results.studies.latency import row_networks, write_costs
    from eldenet.results.studies.plan import read_study

    several = [name for name in ("batches", "runtimes", "precisions", "threads") if len(config[name]) != 1]
    if several:
        raise ValueError(f"a study's table has one latency: give one value of {', '.join(several)}")
    study = read_study(config.study)
    if study.latency is not None and Path(study.latency).parent != Path():
        raise ValueError(
            f"{study.name} shows the latencies of {study.latency}, which another study's rows have: measure "
            f"that one (study={Path(study.folder, study.latency).parent})"
        )
    found = row_networks(study)
    return found.networks, found.sizes, lambda rows: write_costs(study, rows, found)


def check_reference(config: "DictConfig", names: Sequence[str]) -> None:
    """Refuse a reference that is none of the models, unless nobody asked for it.

    Raises:
        ValueError: names the models.
    """
    if config.reference not in names and config.reference != DEFAULT_REFERENCE:
        raise ValueError(f"reference={config.reference}: none of the models, which are {', '.join(names)}")


def describe_group(group: Sequence["Case"]) -> str:
    """``224 224 batch 1 onnxruntime 1 cpu``; of several inputs without them."""
    sizes = {(case.height, case.width) for case in group}
    size = group[0].group[:2] if len(sizes) == 1 else (f"{len(sizes)} inputs",)
    return " ".join(map(str, (*size, f"batch {group[0].batch}", *group[0].group[3:])))


def load_models(config: "DictConfig") -> dict[str, "DepthNet"]:
    """The networks by the name of their rows.

    Raises:
        ValueError: two have one name.
    """
    import torch

    import eldenet

    sources = eldenet.list_models() if config.models is None else [str(name) for name in config.models]
    models: dict[str, DepthNet] = {}
    for source in sources:
        torch.manual_seed(0)
        named = source in eldenet.list_models()
        trusted = [] if named else cfg.plain(config.trusted_modules)
        model = eldenet.load(source, trusted_modules=trusted)
        name = str(model.info.get("model_name", Path(source).name))
        if name in models:
            raise ValueError(
                f"two models are called {name!r}, and rows are named so: train one with another model_name="
            )
        models[name] = model
    if not models:
        raise ValueError("models is empty: give names, or folders")
    return models


def list_cases(
    config: "DictConfig", names: Sequence[str], own_sizes: Mapping[str, tuple[int, int]] | None = None
) -> list["Case"]:
    """Every row that is asked for, a group's together.

    Args:
        config: of the command.
        names: of the networks.
        own_sizes: (height, width) of each one's input; None: ``sizes`` of the config for every network.

    Raises:
        ValueError: a choice that does not exist.
    """
    from eldenet.deploy.benchmarking.measure import Case
    from eldenet.deploy.runtimes import PRECISIONS, RUNTIMES
    from eldenet.system.checks import one_of

    for runtime in config.runtimes:
        one_of("runtimes", str(runtime), RUNTIMES)
    for precision in config.precisions:
        one_of("precisions", str(precision), PRECISIONS)
    if config.rounds < 1:
        raise ValueError(f"rounds={config.rounds}: each row needs a turn")
    sizes = (
        cfg.listed(config.sizes) if own_sizes is None else [[*one] for one in sorted({*own_sizes.values()})]
    )
    if not all(isinstance(size, list) and [type(length) for length in size] == [int, int] for size in sizes):
        raise ValueError(f"sizes={sizes}: give [[height, width], ...] in pixels")
    return [
        Case(name, height, width, int(batch), str(runtime), str(precision), int(threads), str(config.device))
        for (height, width), batch, runtime, threads in itertools.product(
            sizes, config.batches, config.runtimes, config.threads
        )
        for precision in config.precisions
        for name in names
        if own_sizes is None or own_sizes[name] == (height, width)
    ]


def prepare(
    case: "Case", model: "DepthNet", fingerprint: str, config: "DictConfig", folder: Path
) -> "Network":
    """Make the file that a case runs, unless it is there."""
    from eldenet.deploy.benchmarking.measure import Network, reason_of
    from eldenet.deploy.fold import fold
    from eldenet.evaluation.cost import count_macs, count_params

    size = (case.height, case.width)
    params, macs, run_macs = count_params(model), count_macs(model, size), count_macs(fold(model), size)
    try:
        source = _make(case, model, f"{case.model}-{fingerprint}", config, folder)
    except Exception as error:  # an export that fails is the row's result
        return Network(None, params, macs, run_macs, reason_of(error))
    return Network(source, params, macs, run_macs)


def _make(case: "Case", model: "DepthNet", name: str, config: "DictConfig", folder: Path) -> Path:
    from eldenet.deploy.files import describe, write_onnx, write_openvino
    from eldenet.deploy.quantize import quantize_onnx, quantize_openvino
    from eldenet.deploy.runtimes import TORCH, installed

    if not installed(case.runtime):
        raise ImportError(f"{case.runtime} is not installed: pip install 'eldenet[deploy]'")
    if case.runtime in TORCH:
        return model.save_pretrained(folder / name)
    size = (case.height, case.width)
    stem = f"{name}-{case.height}x{case.width}-batch{case.batch}"
    graph, facts = folder / f"{stem}.onnx", describe(model, case.model, size)
    if config.overwrite or not graph.is_file():
        write_onnx(model, graph, size, batch=case.batch, metadata=facts)
    # the scales of int8 come from the calibration pictures: others make another file
    pictures = hashlib.sha256(calibrated(config).encode()).hexdigest()[:8]
    quantized = f"-int8-{pictures}" if case.precision == "int8" else ""
    path = folder / f"{stem}{quantized}{'.onnx' if case.runtime == 'onnxruntime' else '.xml'}"
    if path.is_file() and not (config.overwrite and path != graph):
        return path
    if not quantized:
        return write_openvino(graph, path, facts)
    from eldenet.deploy.predictor import as_image, resized
    from eldenet.export import read_pictures

    frames = read_pictures(config.pictures, config.calibration, "train")
    inputs = [as_image(resized(frame, size)).repeat(case.batch, axis=0) for frame in frames]
    if case.runtime == "onnxruntime":
        return quantize_onnx(graph, path, inputs)
    return quantize_openvino(graph, path, inputs, facts)


if __name__ == "__main__":
    main()

"""``python -m eldenet.benchmark``: models, sizes, batches, runtimes, precisions, threads -> one table."""

import itertools
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.benchmarking import Case, Network
    from eldenet.model import DepthNet
    from eldenet.runlog import RunLog

PACKAGES = ("eldenet", "torch", "onnxruntime", "openvino", "nncf", "numpy")


@cfg.entry_point("benchmark")
def main(config: "DictConfig", folder: Path) -> None:
    """Measure; ``folder`` is not used, results go to ``output``."""
    benchmark(config)


def benchmark(config: "DictConfig") -> list[dict[str, Any]]:
    """Measure what is not there yet, write each group as it is done, then the tables of all asked for."""
    from eldenet.benchmarking import append_rows, measure_group, read_rows
    from eldenet.record import environment
    from eldenet.runlog import RunLog

    output = Path(config.output).expanduser()
    models = load_models(config)
    cases = list_cases(config, list(models))
    log = RunLog(output)
    there = {} if config.overwrite else read_rows(output)
    facts = environment()
    groups = [list(members) for _, members in itertools.groupby(cases, key=lambda case: case.group)]
    for number, group in enumerate(groups, 1):
        title = " ".join(map(str, (*group[0].group[:2], f"batch {group[0].batch}", *group[0].group[3:])))
        if all(case.key in there for case in group):
            log.say(f"[{number}/{len(groups)}] {title}: measured before (overwrite=true measures again)")
            continue
        log.say(f"[{number}/{len(groups)}] {title}: {len(group)} rows")
        networks = {case: prepare(case, models[case.model], config, output / "exports") for case in group}
        rows = measure_group(
            group,
            networks,
            reference=str(config.reference),
            rounds=config.rounds,
            seconds=config.seconds,
            memory=config.memory,
        )
        for case, row in zip(group, rows, strict=True):
            row |= {
                "key": list(case.key),
                "versions": {name: version_of(name) for name in PACKAGES},
                "processor": facts["hardware"]["processor"],
                "cores": facts["hardware"]["cores"],
                "command": facts["command"],
                "date": datetime.now(UTC).isoformat(timespec="seconds"),
                "reference": str(config.reference),
                "rounds": config.rounds,
                "seconds": config.seconds,
            }
            if row["failed"]:
                log.say(f"  {case.model}, {case.precision}: {row['failed']}")
        append_rows(output, rows)
    rows = list(read_rows(output).values())
    wanted = {case.key for case in cases}
    rows = [row for row in rows if tuple(row["key"]) in wanted]
    write_results(config, rows, output, log)
    return rows


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
            raise ValueError(f"two models are called {name!r}: a table needs a name for each")
        models[name] = model
    if not models:
        raise ValueError("models is empty: give names, or folders")
    return models


def list_cases(config: "DictConfig", names: Sequence[str]) -> list["Case"]:
    """Every row that is asked for, a group's together.

    Raises:
        ValueError: a choice that does not exist.
    """
    from eldenet.benchmarking import Case
    from eldenet.data.roots import one_of
    from eldenet.runtimes import PRECISIONS, RUNTIMES

    for runtime in config.runtimes:
        one_of("runtimes", str(runtime), RUNTIMES)
    for precision in config.precisions:
        one_of("precisions", str(precision), PRECISIONS)
    if config.rounds < 1:
        raise ValueError(f"rounds={config.rounds}: each row needs a turn")
    sizes = [(int(height), int(width)) for height, width in cfg.plain(config.sizes)]
    return [
        Case(name, height, width, int(batch), str(runtime), str(precision), int(threads), str(config.device))
        for (height, width), batch, runtime, threads in itertools.product(
            sizes, config.batches, config.runtimes, config.threads
        )
        for precision in config.precisions
        for name in names
    ]


def prepare(case: "Case", model: "DepthNet", config: "DictConfig", folder: Path) -> "Network":
    """Make the file that a case runs, unless it is there."""
    from eldenet.benchmarking import Network, reason_of
    from eldenet.folding import fold
    from eldenet.profiling import count_macs, count_params

    size = (case.height, case.width)
    params, macs, run_macs = count_params(model), count_macs(model, size), count_macs(fold(model), size)
    try:
        source = _make(case, model, config, folder)
    except Exception as error:  # an export that fails is the row's result
        return Network(None, params, macs, run_macs, reason_of(error))
    return Network(source, params, macs, run_macs)


def _make(case: "Case", model: "DepthNet", config: "DictConfig", folder: Path) -> Path:
    from eldenet.exporting import describe, write_onnx, write_openvino
    from eldenet.quantisation import quantise_onnx, quantise_openvino
    from eldenet.runtimes import TORCH, installed

    if not installed(case.runtime):
        raise ImportError(f"{case.runtime} is not installed: pip install 'eldenet[deploy]'")
    if case.runtime in TORCH:
        return model.save_pretrained(folder / case.model)
    size = (case.height, case.width)
    stem = f"{case.model}-{case.height}x{case.width}-batch{case.batch}"
    graph, facts = folder / f"{stem}.onnx", describe(model, case.model, size)
    if config.overwrite or not graph.is_file():
        write_onnx(model, graph, size, batch=case.batch, metadata=facts)
    quantised = "-int8" if case.precision == "int8" else ""
    path = folder / f"{stem}{quantised}{'.onnx' if case.runtime == 'onnxruntime' else '.xml'}"
    if path.is_file() and not (config.overwrite and path != graph):
        return path
    if not quantised:
        return write_openvino(graph, path, facts)
    from eldenet.export import read_pictures
    from eldenet.predictor import as_image, resized

    pictures = read_pictures(config.pictures, config.calibration, "train")
    inputs = [as_image(resized(picture, size)).repeat(case.batch, axis=0) for picture in pictures]
    if case.runtime == "onnxruntime":
        return quantise_onnx(graph, path, inputs)
    return quantise_openvino(graph, path, inputs, facts)


def version_of(package: str) -> str | None:
    """Version of an installed package, or None."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return None


# --- what is written ----------------------------------------------------------------------------------------


def write_results(
    config: "DictConfig", rows: Sequence[Mapping[str, Any]], output: Path, log: "RunLog"
) -> None:
    """Write ``results.csv`` (full figures), ``.md`` and ``.tex`` (rounded), ``.png``, and the terminal."""
    from eldenet.benchmarking import COLUMNS, KEY
    from eldenet.record import write_rows
    from eldenet.report import to_latex, to_markdown

    write_rows(output / "results.csv", COLUMNS, [[row[name] for name in COLUMNS] for row in rows])
    cells = [[text_of(name, row[name]) for name in COLUMNS] for row in rows]
    notes = notes_of(rows)
    (output / "results.md").write_text(to_markdown(COLUMNS, cells, notes))
    (output / "results.tex").write_text(to_latex(COLUMNS, cells, notes))
    # a terminal is narrow: what all rows share is said once
    same = {name for name in KEY[1:] if len({row[name] for row in rows}) == 1}
    shown = [position for position, name in enumerate(COLUMNS) if name not in same]
    log.table(
        ", ".join(f"{name} {rows[0][name]}" for name in COLUMNS if name in same),
        [COLUMNS[position] for position in shown],
        [[line[position] for position in shown] for line in cells],
    )
    for note in notes:
        log.say(note)
    drawn = draw(config, rows, output / "results.png")
    log.say(f"written to {output}: results.md, .csv, .tex{', .png' if drawn else ''}, rows.jsonl")


def text_of(name: str, value: Any) -> str:
    """A figure as a table shows it."""
    if value is None:
        return "-"
    if not isinstance(value, float):
        return f"{value:,}" if name == "params" else str(value)
    if name in ("gmacs", "gflops", "share_of_peak", "ratio_latency"):
        return f"{value:.3f}"
    return f"{value:.1f}" if abs(value) >= 100 else f"{value:.2f}"


def notes_of(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What makes the figures believable: machine, versions, how they were measured, and what failed."""
    notes = []
    for row in rows:
        versions = ", ".join(f"{name} {version}" for name, version in row["versions"].items() if version)
        notes.append(f"{row['processor']}, {row['cores']} cores; {versions}")
        notes.append(
            f"latency: median of one call, {row['rounds']} interleaved rounds of {row['seconds']} s for each "
            f"row; ratio_latency to {row['reference']}, fp32, in the same rounds; 1 MAC = 2 FLOPs"
        )
        notes.append(f"made by `{row['command']}`")
    notes.append(
        "fps: calls per second; peak_memory_mb: added to a process by loading and running; share_of_peak: of "
        "a matrix product's FLOP/s in the same precision and rounds; gmacs and gflops are of the network as "
        "it is defined, gflops_per_s of its inference form (eldenet.folding)"
    )
    failed = [
        f"not measured: {row['model']}, {row['runtime']}, {row['precision']}: {row['failed']}"
        for row in rows
        if row["failed"]
    ]
    return list(dict.fromkeys(notes + failed))


def draw(config: "DictConfig", rows: Sequence[Mapping[str, Any]], path: Path) -> bool:
    """Accuracy over latency where accuracies are given, else parameters over latency."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    from eldenet.report import find_runs

    runs = find_runs(cfg.plain(config.accuracies)) if config.accuracies else []
    accuracy = {str(run["model"]): run["metrics"][config.accuracy] for run in runs}
    shown = [row for row in rows if row["latency_ms_p50"] and (not runs or row["model"] in accuracy)]
    if not shown:
        return False
    figure, axes = pyplot.subplots(figsize=(7, 5), layout="constrained")
    series: dict[str, list[Mapping[str, Any]]] = {}
    for row in shown:
        label = (
            f"{row['runtime']}, {row['precision']}, {row['height']}x{row['width']}, batch {row['batch']}, "
        )
        series.setdefault(f"{label}{row['threads']} threads", []).append(row)
    slowest: dict[str, tuple[float, float]] = {}  # one name for each model, right of its last point
    for label, members in series.items():
        latency = [row["latency_ms_p50"] for row in members]
        heights = [accuracy[row["model"]] if runs else row["params"] / 1e6 for row in members]
        axes.scatter(latency, heights, label=label, s=24)
        for row, x, y in zip(members, latency, heights, strict=True):
            slowest[row["model"]] = max((x, y), slowest.get(row["model"], (0.0, y)))
    for model, place in slowest.items():
        axes.annotate(model, place, fontsize=7, xytext=(5, -2), textcoords="offset points")
    axes.margins(x=0.18)
    axes.set(
        xscale="log",
        xlabel=f"latency [ms], {shown[0]['processor']}",
        ylabel=str(config.accuracy) if runs else "parameters [M]",
        yscale="linear" if runs else "log",
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)
    return True


if __name__ == "__main__":
    main()

"""``python -m eldenet.navigate``: watch a driver, evaluate, diagnose, train; measure a camera's errors."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldenet import config as cfg
from eldenet.cli.entry_point import entry_point, given_settings

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.navigation.evaluation import Crossing
    from eldenet.results.run_log import RunLog
    from eldenet.simulation.arenas import Arena

MODES = ("watch", "evaluate", "diagnose", "measure", "train")


@entry_point("navigate")
def main(config: "DictConfig", folder: Path) -> None:
    """Do what ``mode`` says; results go to the run folder."""
    from eldenet.navigation.settings import refuse_ignored
    from eldenet.results.run_log import RunLog
    from eldenet.system.checks import one_of
    from eldenet.system.resources import choose_resources

    one_of("mode", str(config.mode), MODES)
    refuse_ignored(given_settings(), cfg.plain(config))
    density = cfg.plain(config.density)
    densities = [int(value) for value in cfg.listed(density)]
    if not densities or int(config.worlds) < 1:
        raise ValueError(f"density={density}, worlds={config.worlds}: give at least one of each")
    if config.mode == "watch" and len(densities) > 1:
        raise ValueError(f"density={density}: mode=watch films one arena, give one number")
    refuse_to_replace(folder, str(config.mode))
    choose_resources(**cfg.plain(config.runtime))
    folder.mkdir(parents=True, exist_ok=True)
    log = RunLog(folder)
    if config.mode == "train":
        train(config, folder, log)
    elif config.mode == "evaluate":
        evaluate(config, densities, folder, log)
    elif config.mode == "diagnose":
        diagnose(config, densities, folder, log)
    elif config.mode == "measure":
        measure(config, densities, folder, log)
    else:
        watch(config, densities[0], folder, log)
    log.close()


def refuse_to_replace(folder: Path, mode: str) -> None:
    """A run folder keeps the record of what made it; the same mode may be run again.

    Raises:
        ValueError: ``folder`` holds a ``run.json`` of another mode or command.
    """
    from eldenet.results.run_record import RUN_FILE, read_record

    if mode == "train" or not (folder / RUN_FILE).is_file():  # a training's record is training.json
        return
    record = read_record(folder / RUN_FILE)
    before = record.get("mode", "evaluate" if "driver" in record else "another command")
    if before != mode:
        raise ValueError(f"run_dir={folder} holds a {RUN_FILE} of {before}: give another run_dir")


def write_record(config: "DictConfig", folder: Path, found: Mapping[str, Any]) -> dict[str, Any]:
    """Write ``run.json``: what was found, with the seed, the whole config, versions and the command."""
    from eldenet.results.run_record import RUN_FILE, environment
    from eldenet.system.files import write_json

    record = {
        "mode": str(config.mode),
        **found,
        "seed": int(config.seed),
        "config": cfg.plain(config),
        **environment(),
    }
    write_json(folder / RUN_FILE, record)
    return record


def _who(config: "DictConfig", policy: Any) -> dict[str, Any]:
    """The driver and what it sees by, told by content."""
    from eldenet.navigation.provenance import driver_identity, sensor_identity

    return {
        "policy": policy.name,
        "driver": driver_identity(policy, cfg.plain(config.policy)),
        "inputs": sensor_identity(cfg.plain(config.sensor)),
    }


def watch(config: "DictConfig", density: int, folder: Path, log: "RunLog") -> Path:
    """Film one crossing; write ``run.json``."""
    from eldenet.navigation.video import FORMATS, film_crossing
    from eldenet.simulation.arenas import arenas_hash, generate_arena, triangle_course
    from eldenet.simulation.robot import ROBOT
    from eldenet.system.checks import one_of

    one_of("film", str(config.film), FORMATS)
    if config.course is not None:
        one_of("course", str(config.course), ("triangle",))
        arena = triangle_course()
    else:
        arena = generate_arena(config.split, density, int(config.world), pedestrians=int(config.movers))
    policy = cfg.instantiate(config.policy)(robots=1)
    path = folder / f"{policy.name}-{arena.name}.{config.film}"
    with log.bar("filming", round(config.time_limit / ROBOT.period), unit="frames") as bar:
        event, seconds = film_crossing(
            arena, policy, cfg.instantiate(config.sensor), path,
            **_settings(config), advance=bar.advance,
        )  # fmt: skip
    crossing = {"outcome": event.name.lower(), "seconds": float(seconds), "film": path.name}
    write_record(config, folder, {**_who(config, policy), "arena": arenas_hash([arena]), **crossing})
    log.say(f"{policy.name} in {arena.name}: {event.name.lower()} after {seconds:.1f} s; film in {path}")
    return path


def evaluate(config: "DictConfig", densities: list[int], folder: Path, log: "RunLog") -> dict[str, Any]:
    """Cross frozen arenas; write one CSV row per world and ``run.json``."""
    from eldenet.navigation.evaluation import as_rows, summarize
    from eldenet.results.run_record import RUN_FILE
    from eldenet.simulation.arenas import arenas_hash
    from eldenet.system.files import write_rows

    make_policy, sensor = cfg.instantiate(config.policy), cfg.instantiate(config.sensor)
    who = _who(config, make_policy(robots=1))
    metrics, hashes, table = {}, {}, []
    for density in densities:
        arenas, rows = _cross(config, density, make_policy, sensor, log)
        hashes[str(density)] = arenas_hash(arenas)
        write_rows(folder / f"worlds_{density}.csv", *as_rows(rows))
        metrics[str(density)] = summarize(rows)
        table.append([str(density), *_cells(metrics[str(density)])])
    record = write_record(config, folder, {**who, "metrics": metrics, "arenas": hashes})
    title = (
        f"{who['policy']}, {config.physics}, goal {config.goal}, {config.worlds} {config.split} arenas a "
        f"density: {folder / RUN_FILE}"
    )
    log.table(title, ["obstacles", "success [%]", "95 %", "collision", "time-out", "time [s]", "SPL"], table)
    return record


def _settings(config: "DictConfig") -> dict[str, Any]:
    """Of a crossing, whoever drives."""
    return {
        "physics": str(config.physics),
        "seed": int(config.seed),
        "time_limit": float(config.time_limit),
        "goal": str(config.goal),
    }


def _cross(
    config: "DictConfig", density: int, make_policy: Any, sensor: Any, log: "RunLog"
) -> tuple[list["Arena"], list["Crossing"]]:
    """Cross the frozen arenas of a density, with a progress bar."""
    from eldenet.navigation.evaluation import cross
    from eldenet.navigation.tasks import frozen_arenas

    arenas = list(frozen_arenas(density, int(config.worlds), split=config.split, movers=int(config.movers)))
    with log.bar(f"{density} obstacles", len(arenas), unit="worlds") as bar:
        rows = cross(
            arenas, lambda robots: make_policy(robots=robots), sensor, robots=int(config.robots),
            advance=bar.advance, **_settings(config),
        )  # fmt: skip
    return arenas, rows


def _cells(summary: dict[str, Any]) -> list[str]:
    s = summary
    return [
        *(
            f"{s['success']:.1f}",
            f"{s['success_low']:.1f} to {s['success_high']:.1f}",
            f"{s['collision']:.1f}",
        ),
        *(f"{s['timeout']:.1f}", f"{s['seconds']:.1f}", f"{s['spl']:.3f}"),
    ]


def diagnose(config: "DictConfig", densities: list[int], folder: Path, log: "RunLog") -> None:
    """Trace every failure: ``failures_<density>.csv``, and a picture of the worst; write ``run.json``."""
    from collections import Counter

    from eldenet.navigation.failures import KINDS, as_rows, draw_worst, trace
    from eldenet.simulation.arenas import arenas_hash
    from eldenet.system.files import write_rows
    from eldenet.visualization import write_picture

    make_policy, sensor = cfg.instantiate(config.policy), cfg.instantiate(config.sensor)
    found: dict[str, dict[str, Any]] = {}
    for density in densities:
        arenas, rows = _cross(config, density, make_policy, sensor, log)
        failures = trace(arenas, rows, lambda robots: make_policy(robots=robots), sensor, **_settings(config))
        counts = Counter(failure.kind for failure in failures)
        found[str(density)] = {"worlds": len(rows), "arenas": arenas_hash(arenas), "failures": dict(counts)}
        if not failures:
            log.say(f"{density} obstacles: all {len(rows)} crossings succeeded")
            continue
        write_rows(folder / f"failures_{density}.csv", *as_rows(failures))
        write_picture(folder / f"failures_{density}.png", draw_worst(failures))
        table = [[kind, str(counts[kind]), KINDS[kind]] for kind in KINDS if counts[kind]]
        title = f"{len(failures)} of {len(rows)} failed at {density} obstacles: {folder}"
        log.table(title, ["kind", "failures", "what happened"], table)
    write_record(config, folder, {**_who(config, make_policy(robots=1)), "densities": found})


def measure(config: "DictConfig", densities: list[int], folder: Path, log: "RunLog") -> Path:
    """Measure the errors of a sensor's ranges for ``sensor=noisy``, on arenas of the "val" split."""
    from eldenet.navigation.looks import look_along, look_near
    from eldenet.navigation.policy import Navigator
    from eldenet.navigation.provenance import sensor_identity
    from eldenet.navigation.range_errors import fit_errors
    from eldenet.navigation.tasks import frozen_arenas
    from eldenet.results.run_record import environment
    from eldenet.system.checks import one_of

    options, sensor = cfg.plain(config.measure), cfg.instantiate(config.sensor)
    one_of("measure.places", options["places"], ("crossings", "near"))
    arenas = [a for density in densities for a in frozen_arenas(density, int(config.worlds), split="val")]
    with log.bar("looking", len(arenas), unit="worlds") as bar:
        if options["places"] == "near":
            looks = look_near(
                arenas, sensor, looks=options["looks"], seed=int(config.seed), advance=bar.advance
            )
        else:
            looks = look_along(
                arenas, sensor, Navigator.load(), seed=int(config.seed), time_limit=float(config.time_limit),
                advance=bar.advance,
            )  # fmt: skip
    where = environment()
    note = {"sensor": cfg.plain(config.sensor), "densities": densities, "worlds": int(config.worlds)}
    note |= {"measure": options} | {name: where[name] for name in ("date", "git", "versions", "command")}
    errors = fit_errors(looks, options["edges"], split="val", **note)
    path = folder / "range_errors.json"
    errors.write(path)
    write_record(config, folder, {"inputs": sensor_identity(cfg.plain(config.sensor)), "errors": path.name})
    names = ("bias", "spread", "missed", "ghost")
    table = []
    for row, bias in zip(errors.sectors, errors.bias, strict=True):
        values = (row.get(name, float("nan")) for name in names)
        count = f"{row['count']:.0f}"
        table.append([f"{row['from']} to {row['to']} m", count, *(f"{v:.3f}" for v in values), f"{bias:.3f}"])
    title = f"errors of sectors' nearest ranges (natural logarithm), and the bias of columns: {path}"
    log.table(title, ["true range", "looks", "bias", "spread", "missed", "ghosts", "columns' bias"], table)
    return path


def train(config: "DictConfig", folder: Path, log: "RunLog") -> dict[str, Any]:
    """Train a driver in ``folder``; goes on where a killed run stopped."""
    from eldenet.navigation.env import ArenaNavVectorEnv
    from eldenet.navigation.policy import POLICY
    from eldenet.navigation.training import train as train_driver

    sensor = cfg.instantiate(config.sensor)
    names = ("seed", "sensor", "observer", "learner", "training", "time_limit", "goal")
    settings = {name: cfg.plain(config[name]) for name in names}

    def make_learner() -> Any:
        env = ArenaNavVectorEnv(
            int(config.training.robots), sensor=sensor, arenas=cfg.instantiate(config.training.arenas),
            time_limit=float(config.time_limit), goal=str(config.goal), **cfg.plain(config.observer),
        )  # fmt: skip
        return cfg.instantiate(config.learner)(env, seed=int(config.seed))

    note = train_driver(
        make_learner, sensor, folder, log, validate=int(config.training.validate), settings=settings,
        config=cfg.plain(config),
    )  # fmt: skip
    log.say(f"policy in {folder / POLICY}; {note['cpu_seconds']:.0f} s of processor time")
    return note


if __name__ == "__main__":
    main()

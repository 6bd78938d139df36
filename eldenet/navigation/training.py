"""Train a driver: legs, validation on arenas of their own, TensorBoard, the policy file."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from eldenet.navigation.dqn import CHECKPOINT, DQN
from eldenet.navigation.evaluation import cross, summarize
from eldenet.navigation.policy import POLICY, Navigator
from eldenet.navigation.sensors import Sensor
from eldenet.navigation.tasks import frozen_arenas
from eldenet.navigation.versions import TRAINING_VERSION
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import environment, read_record
from eldenet.system.files import write_json

PROGRESS, RECORD = "progress.json", "training.json"
VALIDATION_DENSITY = 80


def train(
    make_learner: Callable[[], DQN],
    sensor: Sensor,
    folder: Path,
    log: RunLog,
    *,
    validate: int = 100,
    settings: dict[str, Any] | None = None,
    config: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Train in ``folder`` to the end; a folder that holds a checkpoint of the same settings is gone on with.

    One that is finished is left as it is: its record keeps the version that trained it.
    After every leg the driver crosses ``validate`` dense arenas of the "val" split. The policy that is
    kept is the last one: the validation is for people to see, and chooses nothing.

    Args:
        make_learner: builds the learner with its environment.
        sensor: of the validation.
        folder: of the run.
        log: bar, TensorBoard.
        validate: number of arenas; 0: none.
        settings: what must agree for a checkpoint to fit.
        config: the whole of it, for the record.

    Returns:
        Steps, seconds spent by the processor and on the clock, and the validation after every leg.

    Raises:
        ValueError: the folder holds a run with other settings, or one that another version began.
    """
    learner = make_learner()
    note: dict[str, Any] = {
        "settings": settings or {}, "version": TRAINING_VERSION, "legs": [],
        "cpu_seconds": 0.0, "wall_seconds": 0.0,
    }  # fmt: skip
    if (folder / CHECKPOINT).is_file() and (folder / PROGRESS).is_file():
        note = _begun(learner, folder, note)
        if learner.done >= learner.steps and (folder / POLICY).is_file() and (folder / RECORD).is_file():
            log.say(f"{folder}: finished already")
            return note
        log.say(f"going on at step {learner.done:,} of {learner.steps:,}")
    arenas = frozen_arenas(VALIDATION_DENSITY, validate, split="val")
    clocks = time.process_time(), time.perf_counter()
    spent = note["cpu_seconds"], note["wall_seconds"]
    with log.bar("training", learner.steps, learner.done, "steps") as bar:

        def report(step: int, values: dict[str, float]) -> None:
            log.scalars(step, {f"training/{name}": value for name, value in values.items()})
            shown = f"success {values['success']:.0%}  loss {values['loss']:.3f}"
            bar.advance(step - bar.done, shown)

        def after_leg(learner: DQN) -> None:
            leg: dict[str, Any] = {"steps": learner.done}
            if arenas:
                rows = cross(
                    arenas, lambda robots: as_navigator(learner, robots), sensor,
                    goal=learner.env.crossings.goal_from,
                )  # fmt: skip
                leg |= {
                    name: summarize(rows)[name] for name in ("success", "collision", "timeout", "seconds")
                }
                log.scalars(learner.done, {f"validation/{name}": value for name, value in leg.items()})
                log.say(
                    f"step {learner.done:,}: {leg['success']:.1f} % of {len(arenas)} validation arenas at "
                    f"{VALIDATION_DENSITY} obstacles crossed"
                )
            note["legs"].append(leg)
            note["cpu_seconds"] = round(spent[0] + time.process_time() - clocks[0], 1)
            note["wall_seconds"] = round(spent[1] + time.perf_counter() - clocks[1], 1)
            write_json(folder / PROGRESS, note)

        learner.learn(folder=folder, report=report, after_leg=after_leg)
    navigator = as_navigator(learner, 1)
    navigator.info = {"steps": learner.done, "seed": learner.seed}
    navigator.save(folder / POLICY)
    write_json(folder / RECORD, {**note, "config": config or {}, **environment()})
    return note


def _begun(learner: DQN, folder: Path, fresh: dict[str, Any]) -> dict[str, Any]:
    """The note of the training that ``folder`` holds; the learner is put where it stopped.

    Raises:
        ValueError: it has other settings than ``fresh``, or it is not finished and another version began it.
    """
    before: dict[str, Any] = {"version": None} | read_record(folder / PROGRESS)
    if before["settings"] != json.loads(json.dumps(fresh["settings"])):
        raise ValueError(f"run_dir={folder} holds a training with other settings: give another folder")
    learner.restore(folder / CHECKPOINT)
    if learner.done < learner.steps and before["version"] != fresh["version"]:
        raise ValueError(
            f"run_dir={folder} holds a training that version {before['version']} began and that stopped at "
            f"step {learner.done:,} of {learner.steps:,}; this is version {fresh['version']}: give another "
            "folder, or finish it with the eldenet that began it"
        )
    return before | {"legs": [leg for leg in before["legs"] if leg["steps"] <= learner.done]}


def as_navigator(learner: DQN, robots: int) -> Navigator:
    """The learner's present policy."""
    return Navigator(learner.policy_dqn.plain(), learner.env.observer.options, robots=robots)

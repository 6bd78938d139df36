"""Train a driver: checkpoints, validation on separate arenas, TensorBoard, the policy file."""

import copy
import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from eldenet.navigation.dqn import CHECKPOINT, DQN
from eldenet.navigation.evaluation import run_episodes, summarize
from eldenet.navigation.policy import Navigator
from eldenet.navigation.policy_files import POLICY
from eldenet.navigation.provenance import TRAINING_VERSION
from eldenet.navigation.sensors import Sensor
from eldenet.navigation.tasks import frozen_arenas
from eldenet.results.run_log import RunLog
from eldenet.results.run_record import environment, read_record
from eldenet.system.files import write_json

PROGRESS, RECORD = "progress.json", "training.json"
VALIDATION_DENSITY = 80  # or the greatest number of obstacles in training, if that is less
#: Settings that a checkpoint and the training that continues it have in common.
COMPARED = ("seed", "sensor", "observer", "learner", "training", "time_limit", "goal")
#: Settings, with the values that change nothing: earlier trainings (policies.zip of table5_success) lack some
#: of them, and have ``quantiles`` and ``curriculum``, which are gone.
IDLE: Mapping[str, tuple[Any, ...]] = {
    "false_near": (0.0,),
    "false_far": (0.0,),
    "stuck": (0,),
    "factor": (1.0,),
    "view": (69.4,),
    "lost": (0.0,),
    "latency": (0.0,),
    "drift": ({"distance": 0.0, "heading": 0.0},),
    "kind": ("open",),
    "quantiles": (0,),
    "curriculum": (0.0,),
    "randomize": ({"size": [1.0, 1.0], "speed": [1.0, 1.0], "latency": [0.0, 0.0]},),
}


def train(
    learner: DQN, sensor: Sensor, folder: Path, log: RunLog, *, validate: int, config: Mapping[str, Any]
) -> dict[str, Any]:
    """Train in ``folder`` to the end; continue from its checkpoint if there is one with the same settings.

    A finished training is left unchanged: its record keeps the version that trained it. At each checkpoint
    the driver is validated on dense arenas of the "val" split, of the training's kind, with its greatest
    number of pedestrians and its time limit. The last policy is kept, whatever the validation says.

    Args:
        learner: with the environment to train in.
        sensor: for the validation.
        folder: for checkpoint, policy and record.
        log: for progress and scalars.
        validate: number of arenas; 0: no validation.
        config: settings, of which a checkpoint must have the same :data:`COMPARED`.

    Returns:
        Settings, version, seconds of processor time and wall clock, and the validation at each checkpoint
        ("legs").

    Raises:
        ValueError: the folder has a training with other settings, or one that another version started.
    """
    total = learner.settings.total_timesteps
    note: dict[str, Any] = {
        "settings": comparable(config),
        "version": TRAINING_VERSION,
        "legs": [],
        "cpu_seconds": 0.0,
        "wall_seconds": 0.0,
    }
    if (folder / CHECKPOINT).is_file() and (folder / PROGRESS).is_file():
        note = _restore(learner, folder, note)
        if learner.finished and (folder / POLICY).is_file() and (folder / RECORD).is_file():
            log.say(f"{folder}: already finished")
            return note
        log.say(f"continuing at step {learner.num_timesteps:,} of {total:,}")
    tasks, settings = learner.env.arenas, learner.env.episodes.settings
    density = min(VALIDATION_DENSITY, tasks.densities[1])
    arenas = frozen_arenas(density, validate, split="val", pedestrians=tasks.pedestrians, kind=tasks.kind)
    walking = f" and {tasks.pedestrians} pedestrians" if tasks.pedestrians else ""
    clocks = time.process_time(), time.perf_counter()
    spent = note["cpu_seconds"], note["wall_seconds"]
    with log.bar("training", total, learner.num_timesteps, "steps") as bar:

        def report(step: int, values: dict[str, float]) -> None:
            log.scalars(step, {f"training/{name}": value for name, value in values.items()})
            shown = f"success {values['success']:.0%}  loss {values['loss']:.3f}"
            bar.advance(step - bar.done, shown)

        def at_checkpoint(learner: DQN) -> None:
            leg: dict[str, Any] = {"steps": learner.num_timesteps}
            if arenas:
                rows = run_episodes(arenas, lambda robots: as_navigator(learner, robots), sensor, settings)
                summary = summarize(rows)
                leg |= {name: summary[name] for name in ("success", "collision", "timeout", "seconds")}
                log.scalars(leg["steps"], {f"validation/{name}": value for name, value in leg.items()})
                log.say(
                    f"step {leg['steps']:,}: success in {leg['success']:.1f} % of {len(arenas)} validation "
                    f"arenas ({tasks.kind}) with {density} obstacles{walking}"
                )
            note["legs"].append(leg)
            note["cpu_seconds"] = round(spent[0] + time.process_time() - clocks[0], 1)
            note["wall_seconds"] = round(spent[1] + time.perf_counter() - clocks[1], 1)
            write_json(folder / PROGRESS, note)

        learner.learn(folder=folder, report=report, at_checkpoint=at_checkpoint)
    navigator = as_navigator(learner, 1)
    navigator.info = {"steps": learner.num_timesteps, "seed": learner.settings.seed}
    navigator.save(folder / POLICY)
    write_json(folder / RECORD, {**note, "config": config, **environment()})
    return note


def comparable(config: Mapping[str, Any]) -> dict[str, Any]:
    """Settings that two trainings must have in common, without those that change nothing."""
    settings = {name: config[name] for name in COMPARED if name in config}
    return {name: _without_idle(value) for name, value in settings.items()}


def _without_idle(settings: Any) -> Any:
    if not isinstance(settings, Mapping):
        return settings
    named = {name: _without_idle(value) for name, value in settings.items()}
    return {name: value for name, value in named.items() if name not in IDLE or value not in IDLE[name]}


def _restore(learner: DQN, folder: Path, fresh: dict[str, Any]) -> dict[str, Any]:
    """Load the checkpoint in ``folder`` into the learner and return the training's note."""
    note: dict[str, Any] = {"version": None} | read_record(folder / PROGRESS)
    if _without_idle(note["settings"]) != json.loads(json.dumps(fresh["settings"])):
        raise ValueError(f"output={folder} has a training with other settings: give another output")
    learner.restore(folder / CHECKPOINT)
    if not learner.finished and note["version"] != fresh["version"]:
        raise ValueError(
            f"output={folder} has a training that version {note['version']} started and that stopped at "
            f"step {learner.num_timesteps:,} of {learner.settings.total_timesteps:,}; this is version "
            f"{fresh['version']}: give another output, or finish it with the eldenet that started it"
        )
    return note | {"legs": [leg for leg in note["legs"] if leg["steps"] <= learner.num_timesteps]}


def as_navigator(learner: DQN, robots: int) -> Navigator:
    """Return the learner's current policy."""
    return Navigator(copy.deepcopy(learner.policy_dqn), learner.env.observer.options, robots=robots)

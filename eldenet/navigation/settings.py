"""Which settings a mode of ``python -m eldenet.navigate`` does not read: whoever gives one is told."""

from collections.abc import Mapping
from typing import Any

LEARNT = "eldenet.navigation.policy.Navigator.load"
_FILMS = "mode=watch alone reads it"
_MEASURES = {"measure": "mode=measure alone reads it"}
_TRAINS = {
    "learner": "mode=train alone reads it",
    "training": "mode=train alone reads it",
    "observer": "a trained driver brings that of its training; policy.walkers=true follows what moves",
}
_CROSSES = {"world": "worlds=N takes the first N", "course": _FILMS, "film": _FILMS, **_MEASURES, **_TRAINS}
#: Mode -> setting that it does not read (with all below it) -> what to know or to do instead.
NOT_READ: dict[str, dict[str, str]] = {
    "watch": {
        "worlds": "one arena is filmed, world= says which",
        "robots": "one robot is filmed",
        **_MEASURES,
        **_TRAINS,
    },
    "evaluate": _CROSSES,
    "diagnose": _CROSSES,
    "measure": {
        **dict.fromkeys(("policy", "checkpoint"), "the packaged driver drives, by true ranges"),
        "goal": "the packaged driver drives, its goal is known",
        "movers": "errors are measured without people",
        "physics": "it is kinematic always",
        "robots": "one robot is under way",
        "sensor.drift": "ranges are measured, not odometry",
        "split": "it takes val always",
        "world": "worlds=N takes the first N",
        "course": _FILMS,
        "film": _FILMS,
        **_TRAINS,
        "observer": "the packaged driver brings its own",
    },
    "train": {
        "checkpoint": "a training starts from nothing, or goes on in its own run_dir",
        "density": "training.arenas.densities=[least,greatest] says how many obstacles",
        "worlds": "training.validate=N says how many arenas validate",
        "world": _FILMS,
        "split": "training.arenas.split says it",
        "course": _FILMS,
        "film": _FILMS,
        "physics": "it is kinematic always",
        "robots": "training.robots says how many are under way",
        **dict.fromkeys(
            ("policy.path", "policy.observer", "policy.walkers", "policy.slows_within"),
            "it is of driving; observer.* says what is trained",
        ),
        **_MEASURES,
    },
}


def refuse_ignored(given: Mapping[str, str], config: Mapping[str, Any]) -> None:
    """Nothing that was asked for is silently left out.

    Args:
        given: what the command line set: name -> as typed.
        config: the whole config, as plain values.

    Raises:
        ValueError: ``config["mode"]`` does not read a setting that was given.
    """
    not_read = NOT_READ[config["mode"]] | _by_values(config)
    not_read = {name: advice for name, advice in not_read.items() if advice}
    found = [
        f"{typed} ({advice})"
        for name, typed in given.items()
        for setting, advice in not_read.items()
        if name == setting or name.startswith(f"{setting}.")
    ]
    if found:
        raise ValueError(
            f"mode={config['mode']} does not read {'; '.join(found)}: leave out what is not read"
        )


def _by_values(config: Mapping[str, Any]) -> dict[str, str]:
    """What is not read because of another setting; "" for what is read because of one."""
    mode, policy, sensor = config["mode"], config["policy"], config["sensor"]
    found: dict[str, str] = {}
    if mode in ("watch", "evaluate", "diagnose"):
        if policy.get("observer") is not None:
            found["observer"] = ""  # policy=paper_*: the checkpoint must have been trained with it
        if policy.get("path") != config["checkpoint"]:
            found["checkpoint"] = "planners have none; of policy=dqn, policy.path goes before it"
    if mode == "train" and policy["_target_"] != LEARNT:
        found["policy"] = "planners are not trained; choose policy=dqn, paper_literal or paper_state"
    if mode == "watch" and config["course"] is not None:
        names = ("density", "world", "movers", "split")
        found |= dict.fromkeys(names, f"course={config['course']} is an arena of its own")
    if mode == "measure" and config["measure"]["places"] == "near":
        found["time_limit"] = "measure.places=near has no crossings"
    elif mode == "measure":
        found["measure.looks"] = "it is of measure.places=near"
    if sensor.get("errors") is not None:
        names = ("scale", "smooth", "column", "memory")
        found |= {f"sensor.{name}": "sensor.errors replaces it; give sensor.errors=null" for name in names}
    runtime = config["runtime"]
    if runtime["device"] not in ("auto", "cpu"):
        found["runtime.device"] = "navigation computes on the processor"
    if runtime["precision"] not in ("auto", "fp32"):
        found["runtime.precision"] = "navigation computes in full precision"
    return found

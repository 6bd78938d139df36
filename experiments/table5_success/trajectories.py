"""Ways that several methods take through the same arenas, from above: trajectories.png.

python experiments/table5_success/trajectories.py                           one "val" arena of 40 and one of 80
python experiments/table5_success/trajectories.py --worlds 80:3,80:7 --policy paper_literal=runs/table5/paper_literal-0/policy.safetensors

A row per arena, a column per method; a dot is the start, a panel says how its
crossing ended. Wheels physics, true ranges.
"""  # noqa: E501 - a command

from argparse import ArgumentParser
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from methods import LEARNT, PLANNERS

from eldenet.navigation.crossings import Crossings, Event
from eldenet.navigation.evaluation import OUTCOMES, Policy
from eldenet.navigation.pictures import Scene
from eldenet.navigation.policy import Navigator
from eldenet.navigation.sensors import Ranges
from eldenet.pictures import write_picture
from eldenet.simulation.arenas import Arena, generate_arena

HERE = Path(__file__).parent
SIDE, TITLE = 420, 24  # of a panel and its title [px]
GAP = 6
PACKAGED = "dqn_ensemble"


def main() -> None:
    parser = ArgumentParser()
    parser.add_argument("--worlds", default="40:1,80:5", help="density:index of every arena")
    parser.add_argument("--split", default="val", help="stream of the arenas")
    parser.add_argument("--policy", action="append", default=[], help="name=policy.safetensors; many times")
    parser.add_argument("--out", type=Path, default=HERE / "trajectories.png")
    given = parser.parse_args()
    methods: dict[str, Callable[[int], Policy]] = {PACKAGED: partial(_load, PACKAGED, None)}
    for name, _, path in (text.partition("=") for text in given.policy):
        methods[name] = partial(_load, name, path)
    methods |= PLANNERS
    rows = []
    for density, index in (map(int, world.split(":")) for world in given.worlds.split(",")):
        arena = generate_arena(given.split, density, index)
        panels = [panel(arena, name, make(1)) for name, make in methods.items()]
        rows.append(np.concatenate([part for each in panels for part in (each, gap(each, 1))], axis=1))
    write_picture(given.out, np.concatenate([part for row in rows for part in (row, gap(row, 0))], axis=0))


def _load(name: str, path: str | None, robots: int) -> Policy:
    """A policy that drives as the table's method of that name."""
    return Navigator.load(path, **LEARNT.get(name, LEARNT["dqn"]).drives, robots=robots)


def panel(arena: Arena, name: str, policy: Policy) -> np.ndarray:
    """One crossing from above, its end said above it ``(TITLE + SIDE, SIDE, 3)`` uint8 RGB."""
    crossings = Crossings(1, Ranges(), physics="wheels")
    crossings.start(0, arena, (0, arena.index))
    policy.reset(0, crossings.worlds[0])
    scene, event = Scene(arena, SIDE), Event.NONE
    while event is Event.NONE:
        senses = crossings.sense()
        scene.trail.append(tuple(crossings.poses[0]))
        _, events = crossings.step(policy.commands(senses))
        event = Event(int(events[0]))
    crossings.sense()
    scene.trail.append(tuple(crossings.poses[0]))
    title = np.full((TITLE, SIDE, 3), 255, np.uint8)
    text = f"{name}: {OUTCOMES[event]}, {crossings.seconds[0]:.1f} s, {crossings.travelled[0]:.1f} m"
    colour = (0, 0, 0) if event is Event.GOAL else (190, 20, 20)
    begun = scene.pixel(*scene.trail[0][:2])
    top = scene.top_view(crossings, 0)
    cv2.circle(top, begun, 5, (30, 100, 220), -1, cv2.LINE_AA)
    cv2.putText(title, text, (4, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.46, colour, 1, cv2.LINE_AA)
    return np.concatenate([title, top], axis=0)


def gap(picture: np.ndarray, axis: int) -> np.ndarray:
    """A white strip beside or below a picture."""
    shape = list(picture.shape)
    shape[axis] = GAP
    return np.full(shape, 255, np.uint8)


if __name__ == "__main__":
    main()

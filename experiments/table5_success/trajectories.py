"""Draw the paths of several methods through the same arenas, from above: trajectories.png.

python experiments/table5_success/trajectories.py                           one "val" arena of 40 and one of 80
python experiments/table5_success/trajectories.py --worlds 80:3,80:7 --policy paper_literal=runs/table5/paper_literal-0/policy.safetensors

Each arena is a line of panels, one for each method. A dot is the start; the text above a panel says how the
episode ended. Physics on wheels, true ranges.
"""  # noqa: E501 - a command

from argparse import ArgumentParser
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from methods import LEARNED, PLANNERS

from eldenet.navigation.episodes import Episodes, EpisodeSettings, Event
from eldenet.navigation.evaluation import OUTCOMES, Policy
from eldenet.navigation.policy import Navigator
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.visualization import Scene
from eldenet.simulation.arenas import Arena, generate_arena
from eldenet.visualization import write_picture

HERE = Path(__file__).parent
SIDE, TITLE = 320, 42  # size of a panel and height of its two lines of text [px]
GAP = 8
COLUMNS = 4  # panels beside each other: more would be too small to read on a page
FONT = cv2.FONT_HERSHEY_SIMPLEX
PACKAGED = "dqn_ensemble"


def main() -> None:
    parser = ArgumentParser()
    parser.add_argument("--worlds", default="40:1,80:5", help="density:index of each arena")
    parser.add_argument("--split", default="val", help="split of the arenas")
    parser.add_argument("--policy", action="append", default=[], help="name=policy.safetensors; repeatable")
    parser.add_argument("--out", type=Path, default=HERE / "trajectories.png")
    args = parser.parse_args()
    methods: dict[str, Callable[..., Policy]] = {PACKAGED: partial(_load, PACKAGED, None)}
    for name, _, path in (text.partition("=") for text in args.policy):
        methods[name] = partial(_load, name, path)
    methods |= PLANNERS
    rows = []
    for density, index in (map(int, world.split(":")) for world in args.worlds.split(",")):
        arena = generate_arena(args.split, density, index)
        panels = [panel(arena, name, make(robots=1)) for name, make in methods.items()]
        rows += [heading(f"{density} obstacles on 400 m2", panels), *lines_of(panels)]
    write_picture(args.out, np.concatenate(rows, axis=0))


def _load(name: str, path: str | None, robots: int) -> Policy:
    """Return a policy that drives like the table's method of this name."""
    return Navigator.load(path, **LEARNED.get(name, LEARNED["dqn"]).drives, robots=robots)


def panel(arena: Arena, name: str, policy: Policy) -> np.ndarray:
    """Return one episode from above, its end in the title ``(TITLE + SIDE, SIDE, 3)`` uint8 RGB."""
    crossings = Episodes(1, Ranges(), EpisodeSettings("wheels"))
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
    top = scene.top_view(crossings, 0)
    cv2.circle(top, scene.pixel(*scene.trail[0][:2]), 5, (30, 100, 220), -1, cv2.LINE_AA)
    title = np.full((TITLE, SIDE, 3), 255, np.uint8)
    color = (0, 0, 0) if event is Event.GOAL else (190, 20, 20)
    end = f"{OUTCOMES[event]}, {crossings.seconds[0]:.1f} s, {crossings.travelled[0]:.1f} m"
    for text, line in ((name, 16), (end, 35)):
        cv2.putText(title, text, (4, line), FONT, 0.52, color, 1, cv2.LINE_AA)
    return np.concatenate([title, top], axis=0)


def lines_of(panels: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return lines of ``COLUMNS`` panels beside each other; the last line is filled up with white."""
    columns = min(len(panels), COLUMNS)
    blank = np.full_like(panels[0], 255)
    padded = [*panels, *[blank] * (-len(panels) % columns)]
    edges = ((0, GAP), (0, GAP), (0, 0))
    framed = [np.pad(each, edges, constant_values=255) for each in padded]
    return [np.concatenate(framed[at : at + columns], axis=1) for at in range(0, len(framed), columns)]


def heading(text: str, panels: Sequence[np.ndarray]) -> np.ndarray:
    """Return a line of text as wide as the panels below it."""
    width = min(len(panels), COLUMNS) * (panels[0].shape[1] + GAP)
    line = np.full((32, width, 3), 255, np.uint8)
    cv2.putText(line, text, (4, 22), FONT, 0.7, (0, 0, 0), 2, cv2.LINE_AA)
    return line


if __name__ == "__main__":
    main()

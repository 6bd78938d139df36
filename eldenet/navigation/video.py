"""A film of one crossing, without a display: the paper's Fig. 12, moving."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from eldenet.navigation.episodes import Crossings, Event
from eldenet.navigation.evaluation import Policy
from eldenet.navigation.sensors import Sensor
from eldenet.navigation.visualization import Scene
from eldenet.simulation.arenas import Arena
from eldenet.simulation.robot import ROBOT

FORMATS = ("gif", "mp4")


def film_crossing(
    arena: Arena,
    policy: Policy,
    sensor: Sensor,
    path: Path,
    *,
    physics: str = "wheels",
    time_limit: float = 60.0,
    goal: str = "known",
    seed: int = 0,
    speed: float = 2.0,
    advance: Callable[[int], None] = lambda count: None,
) -> tuple[Event, float]:
    """Cross an arena and write it as ``.gif`` or ``.mp4``: camera, depth, sectors, top view with the trail.

    Args:
        arena: the world.
        policy: who drives, one robot.
        sensor: what it sees with.
        path: of the film; its ending is its format.
        physics: "wheels" or "kinematic".
        time_limit: [s].
        goal: "known" or "odometry"; see :class:`~eldenet.navigation.episodes.Crossings`.
        seed: of the sensor's errors.
        speed: of the film, times real time.
        advance: told of every frame.

    Returns:
        How it ended, and after how long [s].
    """
    from eldenet.simulation.arena_view import ArenaView

    crossings = Crossings(1, sensor, physics=physics, time_limit=time_limit, goal=goal)
    crossings.start(0, arena, (seed, arena.index))
    policy.reset(0, crossings.worlds[0])
    scene, view = Scene(arena), ArenaView(arena)
    event = Event.NONE
    with film_writer(path, speed / ROBOT.period) as add:
        while True:
            senses = crossings.sense()
            scene.trail.append(tuple(crossings.poses[0]))
            ended = {
                Event.NONE: "",
                Event.GOAL: "  goal",
                Event.COLLISION: "  COLLISION",
                Event.TIMEOUT: "  time-out",
            }
            note = f"{policy.name}  {arena.name}  {crossings.seconds[0]:4.1f} s{ended[event]}"
            frame = scene.draw(crossings, 0, note, view)
            for _ in range(1 if event is Event.NONE else 8):  # stay at the end for a moment
                add(frame)
            advance(1)
            if event is not Event.NONE:
                return event, float(crossings.seconds[0])
            _, events = crossings.step(policy.commands(senses))
            event = Event(int(events[0]))


@contextmanager
def film_writer(path: Path, per_second: float) -> Iterator[Callable[[np.ndarray], None]]:
    """Yields a function that adds a frame ``(H, W, 3)`` uint8 RGB.

    Raises:
        ValueError: the ending is no format.
    """
    if path.suffix[1:] not in FORMATS:
        raise ValueError(f"film {path.name}: its ending must be one of {', '.join(FORMATS)}")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".mp4":
        from eldenet.deploy.outputs import open_video

        with open_video(path, per_second) as add:
            yield add
        return
    from PIL import Image

    frames: list[Image.Image] = []

    def keep(frame: np.ndarray) -> None:
        frames.append(Image.fromarray(frame).quantize(96, dither=Image.Dither.NONE))

    yield keep
    frames[0].save(
        path,
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 / per_second),
        loop=0,
        optimize=False,
    )

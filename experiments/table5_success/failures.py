"""Why episodes fail: every failure is run once more, alone, and its cause is looked up.

python experiments/table5_success/failures.py density=80 episodes=200 split=val
python experiments/table5_success/failures.py density=20 pedestrians=10 policy.walkers=true

Takes the settings of ``eldenet navigate mode=evaluate``. ``failures_80.csv`` has a row for each failure,
``failures_80.png`` shows those that ended farthest from the goal. An episode ends the same alone and among
others, so the second run repeats the first.
"""

import math
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from eldenet.compose import compose, listed
from eldenet.configurable import instantiate
from eldenet.navigate import (
    NavigateEvaluateSettings,
    NavigateSettings,
    arenas_of,
    episode_settings,
    load_driver,
)
from eldenet.navigation.collision_arcs import STEP
from eldenet.navigation.episodes import Episodes, EpisodeSettings, Event
from eldenet.navigation.evaluation import OUTCOMES, Episode, Policy, as_rows, run_episodes
from eldenet.navigation.observer import HORIZON, Observer
from eldenet.navigation.planners.astar import from_robot, seen_points
from eldenet.navigation.sensors import Sensor
from eldenet.navigation.visualization import Scene
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT
from eldenet.system.files import write_rows
from eldenet.system.resources import choose_resources
from eldenet.visualization import write_picture

KINDS = {
    "walker": "touched a pedestrian",
    "unseen": "the touched spot was never in view, even if the obstacle was",
    "boxed in": "a second earlier, no arc was free for another second",
    "left the view": "the touched spot was seen, but not recently, and another arc was free",
    "in view": "the touched spot was in view, and another arc was free",
    "timeout": "ran until the time limit",
}
RECENT = 0.5  # [s]
SAME_SPOT = 0.15  # between a seen point and the touched spot [m]
WAY_OUT = 1.0  # time that an arc must be free, and time before the end at which it is checked [s]
ZOOM = 6.0  # side of the square that a picture shows [m]
LEGEND = (
    "blue: path; yellow: robot at its end; lines: its view; red: last scan; cross: touched spot; ring: goal"
)
_PICTURE, _STRIP, _GAP = 480, 28, 10  # [px]


@dataclass(frozen=True)
class Failure:
    """A failed episode.

    Attributes:
        world: name of the arena.
        kind: key of :data:`KINDS`.
        touched: kind of the obstacle, or "wall"; "" after a time-out.
        bearing: of the touched spot from straight ahead, left positive [degrees].
        unseen_for: time since the spot was last in view [s]; infinite if it never was.
        way_out: longest free time of an arc, a second before the end [s].
        speed: at the end [m/s].
        turn: at the end [rad/s].
        seconds: duration [s].
        remaining: straight-line distance to the goal [m].
        picture: top view around the robot ``(P, P, 3)`` uint8 RGB.
    """

    world: str
    kind: str
    touched: str
    bearing: float
    unseen_for: float
    way_out: float
    speed: float
    turn: float
    seconds: float
    remaining: float
    picture: np.ndarray


def trace(
    arenas: Sequence[Arena],
    rows: Sequence[Episode],
    make_policy: Callable[[int], Policy],
    sensor: Sensor,
    settings: EpisodeSettings = EpisodeSettings(),  # noqa: B008 - immutable
) -> list[Failure]:
    """Return the failures among ``rows``, the results of :func:`~.evaluation.run_episodes` for ``arenas``.

    Raises:
        ValueError: a second run ended differently, so the settings are not those of the first.
    """
    failures = []
    for number, (arena, row) in enumerate(zip(arenas, rows, strict=True)):
        if row.outcome == "success":
            continue
        episodes = Episodes(1, sensor, settings)
        episodes.start(0, arena, (settings.seed, number))
        failure, event = _repeat(arena, make_policy(1), episodes)
        if OUTCOMES[event] != row.outcome:
            raise ValueError(
                f"{arena.name} ended in {row.outcome} at first, but in {OUTCOMES[event]} now: give the "
                "policy, "
                "sensor and settings of the first run"
            )
        failures.append(failure)
    return failures


def _repeat(arena: Arena, policy: Policy, episodes: Episodes) -> tuple[Failure, Event]:
    policy.reset(0, episodes.worlds[0])
    witness = _witness(policy)
    scene = Scene(arena, round(_PICTURE * arena.side / ZOOM))
    seen: list[np.ndarray] = []  # points of every scan, in the world frame
    ways: list[float] = []  # longest free time of an arc at every scan
    event = Event.NONE
    while event is Event.NONE:
        senses = episodes.sense()
        pose = episodes.poses[0].copy()
        scene.trail.append(tuple(pose))
        seen.append(from_robot(seen_points(senses.ranges[0]), pose))
        command = policy.commands(senses).copy()
        witness.last[:] = command
        ways.append(float(witness.observe(senses)[0, -witness.actions :].max()) * HORIZON)
        _, events = episodes.step(command)
        event = Event(int(events[0]))
    episodes.sense()
    # the world's clock stops at a contact, so pedestrians are where they were then
    world: Any = episodes.worlds[0]
    pose, time = episodes.poses[0], world.time
    scene.trail.append(tuple(pose))
    touched, spot = "", pose[:2]
    if event is not Event.TIMEOUT:
        touched, spot = touched_spot(arena, pose, time, world.size)
    hits = [number for number, points in enumerate(seen) if _near(points, spot)]
    unseen_for = (len(seen) - 1 - hits[-1]) * ROBOT.period if hits else math.inf
    way_out = ways[max(0, len(ways) - 1 - round(WAY_OUT / ROBOT.period))]
    kind = _kind(event, arena, touched, spot, time, unseen_for, way_out)
    turned = math.atan2(spot[1] - pose[1], spot[0] - pose[0]) - pose[2]
    return Failure(
        world=arena.name,
        kind=kind,
        touched=touched,
        bearing=round(math.degrees(math.remainder(turned, 2 * math.pi))),
        unseen_for=round(unseen_for, 1),
        way_out=round(way_out, 2),
        speed=round(float(command[0, 0]), 2),
        turn=round(float(command[0, 1]), 2),
        seconds=round(float(episodes.seconds[0]), 1),
        remaining=round(float(episodes.goals()[0, 0]), 2),
        picture=_picture(
            scene, episodes, None if event is Event.TIMEOUT else spot, _title(arena, touched, kind)
        ),
    ), event


def _witness(policy: Policy) -> Observer:
    """Observer that sees and remembers everything, whatever the policy uses."""
    own = getattr(getattr(policy, "driver", policy), "observer", None)
    own = own if isinstance(own, Observer) else Observer()
    options: dict[str, Any] = own.options | {"memory": 60, "bins": 0, "arcs": True}
    return type(own)(1, **options)


def _near(points: np.ndarray, spot: np.ndarray) -> bool:
    return bool((np.hypot(*(points - spot).T) < SAME_SPOT).any())


def touched_spot(arena: Arena, pose: np.ndarray, time: float, size: float = 1.0) -> tuple[str, np.ndarray]:
    """Kind of the obstacle nearest to the footprint, or "wall", and the spot that touches it ``(2,)``.

    ``size`` is that of the footprint, relative to :data:`~eldenet.simulation.robot.ROBOT`.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    along = size * np.linspace(-0.5, 0.5, 41)
    x, y = np.meshgrid(along * ROBOT.length, along * ROBOT.width)
    wx, wy = pose[0] + c * x - s * y, pose[1] + s * x + c * y
    best = ("wall", arena.side / 2 - np.maximum(np.abs(wx), np.abs(wy)))
    for obstacle in arena.obstacles:
        distance = _at(obstacle, time).distance(wx, wy)
        if distance.min() < best[1].min():
            best = (obstacle.kind, distance)
    row, column = np.argwhere(best[1] <= best[1].min() + 1e-3).mean(axis=0).round().astype(int)
    return best[0], np.array([wx[row, column], wy[row, column]])


def _at(obstacle: Obstacle, time: float) -> Obstacle:
    x, y = obstacle.position(time)
    return replace(obstacle, x=x, y=y)


def _kind(
    event: Event, arena: Arena, touched: str, spot: np.ndarray, time: float, unseen_for: float, way_out: float
) -> str:
    if event is Event.TIMEOUT:
        return "timeout"
    walkers = [_at(walker, time).distance(*spot) for walker in arena.pedestrians if touched == "person"]
    if walkers and min(walkers) < SAME_SPOT:
        return "walker"
    if math.isinf(unseen_for):
        return "unseen"
    if way_out < WAY_OUT - STEP / 2:
        return "boxed in"
    return "left the view" if unseen_for > RECENT else "in view"


def _title(arena: Arena, touched: str, kind: str) -> str:
    return f"arena {arena.name.rpartition('-')[2]}: {touched or 'time'}, {kind}"


def _picture(scene: Scene, episodes: Episodes, spot: np.ndarray | None, title: str) -> np.ndarray:
    """Cut the square of 6 m around the robot out of the top view."""
    top = scene.top_view(episodes, 0)
    if spot is not None:
        cv2.drawMarker(top, scene.pixel(*spot), (200, 0, 160), cv2.MARKER_TILTED_CROSS, 22, 3, cv2.LINE_AA)
    side, center = _PICTURE, scene.pixel(*episodes.poses[0, :2])
    left, upper = (int(np.clip(at - side // 2, 0, scene.size - side)) for at in center)
    part = top[upper : upper + side, left : left + side].copy()
    meter = round(side / ZOOM)
    cv2.line(part, (12, side - 12), (12 + meter, side - 12), (0, 0, 0), 3)
    _write(part, "1 m", (12, side - 20))
    strip = np.full((_STRIP, side, 3), 255, np.uint8)
    _write(strip, title, (2, _STRIP - 8))
    return np.concatenate([strip, part])


def _write(picture: np.ndarray, text: str, place: tuple[int, int]) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1, cv2.LINE_AA)


def draw_worst(failures: Sequence[Failure], most: int = 12, across: int = 4) -> np.ndarray:
    """Pictures of the failures that ended farthest from the goal ``(h, w, 3)`` uint8 RGB."""
    worst = sorted(failures, key=lambda failure: -failure.remaining)[:most]
    pictures = [failure.picture for failure in worst]
    across = min(across, len(pictures))
    pictures += [np.full_like(pictures[0], 255)] * (-len(pictures) % across)
    pictures = [np.pad(each, ((0, _GAP), (0, _GAP), (0, 0)), constant_values=255) for each in pictures]
    rows = [np.concatenate(pictures[at : at + across], axis=1) for at in range(0, len(pictures), across)]
    strip = np.full((_STRIP, rows[0].shape[1], 3), 255, np.uint8)
    _write(strip, LEGEND, (2, _STRIP - 8))
    return np.concatenate([*rows, strip], axis=0)


def main(words: Sequence[str]) -> None:
    """Run the episodes of the settings in ``words``; write a table and a picture of the failures."""
    s = compose(NavigateSettings, ["mode=evaluate", "output=runs/failures", *words])
    assert isinstance(s, NavigateEvaluateSettings)
    folder, episode = Path(s.output), episode_settings(s)
    choose_resources(device="cpu", precision="fp32", **s.runtime)
    load, sensor = partial(load_driver, s), instantiate(s.sensor, "sensor")
    for density in listed(s.density):
        arenas = arenas_of(s, density)
        rows = run_episodes(arenas, load, sensor, episode, robots=s.robots)
        failures = trace(arenas, rows, load, sensor, episode)
        print(f"{density} obstacles: {len(failures)} of {len(rows)} episodes failed")
        if failures:
            folder.mkdir(parents=True, exist_ok=True)
            write_rows(folder / f"failures_{density}.csv", *as_rows(failures, without=["picture"]))
            write_picture(folder / f"failures_{density}.png", draw_worst(failures))
        counts = Counter(failure.kind for failure in failures)
        for kind in KINDS:
            if counts[kind]:
                print(f"  {counts[kind]:3d}  {kind}: {KINDS[kind]}")


if __name__ == "__main__":
    main(sys.argv[1:])

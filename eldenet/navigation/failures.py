"""Why crossings fail: every failure is driven once more, alone, and what led to it is looked up.

A crossing ends alike alone and among others, so the second drive is the first one.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import cv2
import numpy as np

from eldenet.navigation.collision_arcs import STEP
from eldenet.navigation.episodes import Crossings, Event
from eldenet.navigation.evaluation import OUTCOMES, Crossing, Policy
from eldenet.navigation.observer import HORIZON, Observer
from eldenet.navigation.sensors import Sensor
from eldenet.navigation.visualization import Scene
from eldenet.simulation.arenas import Arena, Obstacle
from eldenet.simulation.robot import ROBOT

KINDS = {
    "walker": "touched somebody who walks",
    "unseen": "the spot it touched was never in view, though the thing may have been",
    "boxed in": "a second before, none of its arcs was free for another second",
    "left the view": "it had seen what it touched, not lately, and another arc was free",
    "in view": "it saw what it touched, and another arc was free",
    "timeout": "it was under way until the time limit",
}
LATELY = 0.5  # [s]
SAME_SPOT = 0.15  # from a seen point to the spot that was touched [m]
WAY_OUT = 1.0  # that an arc must be free, and how long before the end it is asked [s]
ZOOM = 6.0  # side of the square that a picture shows [m]


@dataclass(frozen=True)
class Failure:
    """One crossing that failed.

    Attributes:
        world: the arena's name.
        kind: of :data:`KINDS`.
        touched: kind of the obstacle, or "wall"; "" after a time-out.
        bearing: of the spot that was touched, from ahead, left positive [degrees].
        unseen_for: how long the spot was out of view [s]; infinite if it was never seen.
        way_out: longest free time of an arc, a second before the end [s].
        speed: at the end [m/s].
        turn: at the end [rad/s].
        seconds: until the end.
        remaining: distance to the goal, as the crow flies [m].
        picture: ``(P, P, 3)`` uint8 RGB from above, around the robot.
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
    rows: Sequence[Crossing],
    make_policy: Callable[[int], Policy],
    sensor: Sensor,
    *,
    physics: str = "kinematic",
    seed: int = 0,
    time_limit: float = 60.0,
    goal: str = "known",
    advance: Callable[[int], None] = lambda count: None,
) -> list[Failure]:
    """Every failure among ``rows``, which :func:`eldenet.navigation.evaluation.cross` gave for ``arenas``.

    Raises:
        ValueError: a second drive ended in another way: the settings are not those of the first.
    """
    failures = []
    for number, (arena, row) in enumerate(zip(arenas, rows, strict=True)):
        if row.outcome == "success":
            continue
        crossings = Crossings(1, sensor, physics=physics, time_limit=time_limit, goal=goal)
        crossings.start(0, arena, (seed, number))
        failure, event = _drive(arena, make_policy(1), crossings)
        if OUTCOMES[event] != row.outcome:
            raise ValueError(
                f"{arena.name} ended in {row.outcome} first and in {OUTCOMES[event]} now: give the policy, "
                "sensor, physics and seed of the first drive"
            )
        failures.append(failure)
        advance(1)
    return failures


def _drive(arena: Arena, policy: Policy, crossings: Crossings) -> tuple[Failure, Event]:
    policy.reset(0, crossings.worlds[0])
    witness = _witness(policy)
    scene = Scene(arena, round(480 * arena.side / ZOOM))
    seen: list[np.ndarray] = []  # points of every look, in the world
    ways: list[float] = []  # longest free time at every look
    event = Event.NONE
    while event is Event.NONE:
        senses = crossings.sense()
        pose = crossings.poses[0].copy()
        scene.trail.append(tuple(pose))
        seen.append(_points(senses.ranges[0], pose))
        command = policy.commands(senses).copy()
        witness.last[:] = command
        ways.append(float(witness.observe(senses)[0, -witness.actions :].max()) * HORIZON)
        _, events = crossings.step(command)
        event = Event(int(events[0]))
    crossings.sense()
    # the world's own clock, which stops at a contact: where people were then
    pose, time = crossings.poses[0], crossings.worlds[0].time  # type: ignore[union-attr]
    scene.trail.append(tuple(pose))
    touched, spot = ("", pose[:2]) if event is Event.TIMEOUT else touched_spot(arena, pose, time)
    hits = [look for look, points in enumerate(seen) if _near(points, spot)]
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
        seconds=round(float(crossings.seconds[0]), 1),
        remaining=round(float(crossings.goals()[0, 0]), 2),
        picture=_picture(scene, crossings, None if event is Event.TIMEOUT else spot, f"{arena.name}: {kind}"),
    ), event


def _witness(policy: Policy) -> Observer:
    """Sees and remembers all that there was to be known, whatever the policy makes of it."""
    own = getattr(policy, "observer", None)
    own = own if isinstance(own, Observer) else Observer()
    options: dict[str, Any] = own.options | {"memory": 60, "bins": 0, "arcs": True}
    return type(own)(1, **options)


def _points(ranges: np.ndarray, pose: np.ndarray) -> np.ndarray:
    angles = np.array(ROBOT.column_angles) + pose[2]
    eye = pose[:2] + ROBOT.camera_ahead * np.array([math.cos(pose[2]), math.sin(pose[2])])
    points = eye + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.asarray(points[ranges < ROBOT.far])


def _near(points: np.ndarray, spot: np.ndarray) -> bool:
    return bool((np.hypot(*(points - spot).T) < SAME_SPOT).any())


def touched_spot(arena: Arena, pose: np.ndarray, time: float) -> tuple[str, np.ndarray]:
    """Kind of what is nearest to the robot's footprint ("wall" among them), and where it touches ``(2,)``."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 41) * ROBOT.length, np.linspace(-0.5, 0.5, 41) * ROBOT.width)
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
    return "left the view" if unseen_for > LATELY else "in view"


def _picture(scene: Scene, crossings: Crossings, spot: np.ndarray | None, title: str) -> np.ndarray:
    """The square of 6 m around the robot, as far as the arena goes."""
    top = scene.top_view(crossings, 0)
    if spot is not None:
        cv2.drawMarker(top, scene.pixel(*spot), (200, 0, 160), cv2.MARKER_TILTED_CROSS, 22, 3, cv2.LINE_AA)
    side = 480
    column, row = scene.pixel(*crossings.poses[0, :2])
    left, upper = (int(np.clip(at - side // 2, 0, scene.size - side)) for at in (column, row))
    part = top[upper : upper + side, left : left + side].copy()
    cv2.rectangle(part, (0, 0), (side, 20), (255, 255, 255), -1)
    cv2.putText(part, title, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return part


def draw_worst(failures: Sequence[Failure], most: int = 12, across: int = 4) -> np.ndarray:
    """Pictures of the failures that ended farthest from the goal ``(h, w, 3)`` uint8 RGB.

    Raises:
        ValueError: there are none.
    """
    if not failures:
        raise ValueError("no failures to draw: every crossing succeeded")
    worst = sorted(failures, key=lambda failure: -failure.remaining)[:most]
    pictures = [failure.picture for failure in worst]
    across = min(across, len(pictures))
    pictures += [np.full_like(pictures[0], 255)] * (-len(pictures) % across)
    rows = [np.concatenate(pictures[at : at + across], axis=1) for at in range(0, len(pictures), across)]
    return np.concatenate(rows, axis=0)


def as_rows(failures: Sequence[Failure]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows for :func:`eldenet.results.run_record.write_rows`."""
    names = [field.name for field in fields(Failure) if field.name != "picture"]
    return names, [[getattr(failure, name) for name in names] for failure in failures]

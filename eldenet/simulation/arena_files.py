"""Your own arenas as YAML files: obstacles, a start and way-points, checked before a robot drives."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.simulation.arenas import (
    INFLATION,
    RESOLUTION,
    VEHICLE_HALF,
    VEHICLE_HEIGHT,
    Arena,
    clearance_map,
    reachable,
)
from eldenet.simulation.obstacle import SIDE, Obstacle, Point
from eldenet.simulation.pedestrians import PERSON_RADIUS
from eldenet.system.checks import one_of
from eldenet.system.files import read_yaml

MOST_OBSTACLES, MOST_WAYPOINTS = 160, 20
SIDES = (4.0, SIDE)  # of an arena [m]: drivers and planners know none larger
LIMITS = {
    "radius": (0.05, 2.0),
    "size": (0.05, 10.0),
    "height": (0.45, 3.0),  # the robot's ranges are measured 0.40 m above the floor
    "speed": (0.05, 2.0),
}  # [m], [m/s]
#: Kind -> the keys that it reads beside ``kind`` and ``at``, with their defaults; None: must be given.
KINDS: dict[str, dict[str, Any]] = {
    "cylinder": {"radius": 0.3, "height": 1.0},
    "box": {"size": None, "yaw": 0.0, "height": 1.0},
    "vehicle": {"yaw": 0.0},
    "person": {"height": 1.7, "path": [], "speed": 0.6},
}


def read_arena(path: str | Path) -> Arena:
    """Read an arena from a YAML file; docs/navigation.md shows its keys.

    Raises:
        ValueError: an unknown key, a value out of its limits, or a start or way-point that lies outside, too
            near an obstacle or wall, or cannot be reached from the one before.
    """
    try:
        return _arena(read_yaml(Path(path).expanduser()))
    except ValueError as error:
        raise ValueError(str(error) if str(path) in str(error) else f"{path}: {error}") from error


def _arena(content: Any) -> Arena:
    known: dict[str, Any] = {"side": SIDE, "start": None, "waypoints": None, "obstacles": []}
    entries = _entries("the file", content, known)
    side = _number("side", entries["side"], SIDES)
    *place, degrees = _numbers("start", entries["start"], 3)
    start = _inside("start", (place[0], place[1]), side)
    waypoints = [
        _place(*named, side) for named in _list_of("waypoints", entries["waypoints"], MOST_WAYPOINTS)
    ]
    obstacles = [
        _obstacle(name, value, side)
        for name, value in _list_of("obstacles", entries["obstacles"], MOST_OBSTACLES)
    ]
    obstacles.sort(key=lambda obstacle: bool(obstacle.path))  # standing ones first
    standing = sum(not obstacle.path for obstacle in obstacles)
    _check_way((start, *waypoints), obstacles, side)
    for obstacle in obstacles[standing:]:
        apart = math.dist(start, (obstacle.x, obstacle.y)) - PERSON_RADIUS
        if apart < INFLATION:
            raise ValueError(
                f"start=[{start[0]:g}, {start[1]:g}] lies {max(apart, 0):.2f} m from a person who walks: the "
                f"robot needs {INFLATION} m"
            )
    pose = (*start, math.radians(degrees))
    return Arena("", standing, 0, tuple(obstacles), pose, tuple(waypoints), side)


def _obstacle(name: str, content: Any, side: float) -> Obstacle:
    kind = content.get("kind") if isinstance(content, Mapping) else None
    one_of(f"{name}.kind", str(kind), tuple(KINDS))
    entries = _entries(name, content, {"kind": None, "at": None} | KINDS[str(kind)])
    x, y = _place(f"{name}.at", entries["at"], side)
    height = _number(f"{name}.height", entries.get("height", VEHICLE_HEIGHT), LIMITS["height"])
    yaw = math.radians(_number(f"{name}.yaw", entries.get("yaw", 0.0), (-360.0, 360.0)))
    if kind == "cylinder":
        radius = _number(f"{name}.radius", entries["radius"], LIMITS["radius"])
        return Obstacle("cylinder", x, y, 0.0, (radius, radius), height)
    if kind == "box":
        length, width = _numbers(f"{name}.size", entries["size"], 2)
        for value in (length, width):
            _number(f"{name}.size", value, LIMITS["size"])
        return Obstacle("box", x, y, yaw, (length / 2, width / 2), height)
    if kind == "vehicle":
        return Obstacle("vehicle", x, y, yaw, VEHICLE_HALF, VEHICLE_HEIGHT)
    corners = [_place(*named, side) for named in _list_of(f"{name}.path", entries["path"], MOST_WAYPOINTS)]
    if {*corners} == {(x, y)}:
        raise ValueError(f"{name}.path={entries['path']} stays at its start: give another point, or no path")
    speed = _number(f"{name}.speed", entries["speed"], LIMITS["speed"])
    path = ((x, y), *corners) if corners else ()  # from where the person stands, and back
    half = (PERSON_RADIUS, PERSON_RADIUS)
    return Obstacle("person", x, y, 0.0, half, height, path, speed if path else 0.0)


def _check_way(points: Sequence[Point], obstacles: Sequence[Obstacle], side: float) -> None:
    """Raise unless a robot has room at every point and a way from each to the next."""
    names = ["start", *(f"waypoints[{index}]" for index in range(len(points) - 1))]
    clearance = clearance_map(obstacles, side)
    regions = reachable(clearance)
    found = []
    for name, (x, y) in zip(names, points, strict=True):
        column, row = (min(int((value + side / 2) / RESOLUTION), len(clearance) - 1) for value in (x, y))
        if not regions[row, column]:
            raise ValueError(
                f"{name}=[{x:g}, {y:g}] lies {clearance[row, column]:.2f} m from an obstacle or wall: the "
                f"robot needs {INFLATION} m"
            )
        found.append(int(regions[row, column]))
    if (broken := np.flatnonzero(np.diff(found))).size:
        raise ValueError(
            f"there is no way from {names[broken[0]]} to {names[broken[0] + 1]}: obstacles close it"
        )


def _entries(name: str, content: Any, known: Mapping[str, Any]) -> dict[str, Any]:
    """Entries with their defaults, once none is unknown and none is missing."""
    if not isinstance(content, Mapping):
        raise ValueError(f"{name} is not a mapping: give {', '.join(known)}")
    for key in content:
        one_of(f"{name}: key", str(key), tuple(known))
    entries = {**known, **content}
    for key, value in entries.items():
        if value is None or (value == [] and known[key] is None):
            raise ValueError(f"{name} has no {key}: add it")
    return entries


def _listed(name: str, value: Any, counts: range, what: str) -> list[Any]:
    if not isinstance(value, list) or len(value) not in counts:
        raise ValueError(f"{name}={value}: give {what}")
    return value


def _list_of(name: str, value: Any, most: int) -> Iterator[tuple[str, Any]]:
    """Each entry with its name."""
    entries = _listed(name, value, range(most + 1), f"a list of at most {most}")
    return ((f"{name}[{index}]", entry) for index, entry in enumerate(entries))


def _place(name: str, value: Any, side: float) -> Point:
    x, y = _numbers(name, value, 2)
    return _inside(name, (x, y), side)


def _numbers(name: str, value: Any, count: int) -> list[float]:
    what = "[x, y] in meters" if count == 2 else "[x, y, heading] in meters and degrees"
    entries = _listed(name, value, range(count, count + 1), what)
    return [_number(name, entry, (-1000.0, 1000.0)) for entry in entries]


def _number(name: str, value: Any, limits: tuple[float, float]) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not limits[0] <= value <= limits[1]:
        raise ValueError(f"{name}={value}: give a number from {limits[0]:g} to {limits[1]:g}")
    return float(value)


def _inside(name: str, point: Point, side: float) -> Point:
    if max(map(abs, point)) > side / 2:
        raise ValueError(
            f"{name}=[{point[0]:g}, {point[1]:g}] lies outside the arena: give x and y from {-side / 2:g} "
            f"to {side / 2:g} m"
        )
    return point

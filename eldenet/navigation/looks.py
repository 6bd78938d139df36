"""Looks of a sensor beside what is true: along crossings, or from places close to obstacles."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eldenet.navigation.episodes import Crossings, Event
from eldenet.navigation.evaluation import Policy
from eldenet.navigation.sensors import Ranges, Sensor
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena, cell_center, clearance_map

NEAR = (0.3, 0.9)  # clearance of a place close to something [m]; a robot fits from the first on


@dataclass(frozen=True)
class Looks:
    """Ranges of ``F`` looks ``(F, columns)`` [m], what is true, and which crossing each is of ``(F,)``."""

    ranges: np.ndarray
    true: np.ndarray
    crossing: np.ndarray


def look_along(
    arenas: Sequence[Arena],
    sensor: Sensor,
    policy: Policy,
    *,
    physics: str = "kinematic",
    seed: int = 0,
    time_limit: float = 60.0,
    advance: Callable[[int], None] = lambda count: None,
) -> Looks:
    """Let a sensor look along crossings that ``policy`` drives by true ranges, so that none depends on it."""
    crossings = Crossings(1, Ranges(), physics=physics, time_limit=time_limit)
    rows: list[tuple[np.ndarray, np.ndarray, int]] = []
    for number, arena in enumerate(arenas):
        crossings.start(0, arena, (seed, number))
        world = crossings.worlds[0]
        assert world is not None
        policy.reset(0, world)
        eye = sensor.begin(world, np.random.default_rng((seed, number)))
        event = Event.NONE
        while event is Event.NONE:
            senses = crossings.sense()
            rows.append((eye.look().ranges, senses.ranges[0].copy(), number))
            _, events = crossings.step(policy.commands(senses))
            event = Event(int(events[0]))
        advance(1)
    return _looks(rows)


def look_near(
    arenas: Sequence[Arena],
    sensor: Sensor,
    *,
    looks: int = 8,
    seed: int = 0,
    advance: Callable[[int], None] = lambda count: None,
) -> Looks:
    """Let a sensor look from random places close to standing obstacles or walls, at any heading.

    Drivers avoid such places, so crossings hold few of them; each look counts as a crossing of its own.

    Raises:
        ValueError: fewer than one look, or an arena with people, who might stand in the robot.
    """
    if looks < 1:
        raise ValueError(f"looks={looks}: give at least one look an arena")
    rows: list[tuple[np.ndarray, np.ndarray, int]] = []
    for number, arena in enumerate(arenas):
        if arena.pedestrians:
            raise ValueError(f"{arena.name} has people who walk: looks from places take arenas without")
        rng = np.random.default_rng((seed, number))
        clearance = clearance_map(arena.obstacles)
        places = np.argwhere((clearance >= NEAR[0]) & (clearance < NEAR[1]))
        world = ArenaWorld(arena)
        eye = sensor.begin(world, rng)
        for _ in range(looks):
            x, y = cell_center(*places[rng.integers(len(places))])
            world.place((x, y, rng.uniform(-math.pi, math.pi)))
            rows.append((eye.look().ranges, world.ranges(), len(rows)))
        advance(1)
    return _looks(rows)


def _looks(rows: Sequence[tuple[np.ndarray, np.ndarray, int]]) -> Looks:
    ranges, true, crossing = zip(*rows, strict=True)
    return Looks(np.array(ranges), np.array(true), np.array(crossing))

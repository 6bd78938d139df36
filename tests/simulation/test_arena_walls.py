"""Rooms with doors and traps: the same on every machine, other arenas in every split, and passable."""

import math
from itertools import pairwise

import numpy as np
import pytest
from skimage.measure import label

from eldenet.navigation.planners.paths import inflated_cost, shortest_path
from eldenet.simulation.arena_mjcf import arena_mjcf
from eldenet.simulation.arena_walls import CORRIDORS, DOORS, THICKNESS
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import arenas_hash, clearance_map, generate_arena

# The first three test arenas of each kind: if one changes, it is another test set.
DENSITY = {"rooms": 10, "traps": 10, "office": 10, "maze": 0, "corridor": 0}
FROZEN = {
    "rooms": "49fdc1d21c7ec2a5a9caec40b614e9b2187d1e486de4a018cd05f64128868aec",
    "traps": "4554e1f98dfafbb9c644537b0a85b511da285093cb10090df21ef1635539edf5",
    "office": "aa693fbbdaaef348f6960b3f43c40add546cf83bfaec5e25f0b1fc0b8aaa4714",
    "maze": "721525bb68fb119148774105832d3ab32d1953e65889d08e07c17acfca3859f5",
    "corridor": "13d74f0ca6e9a31db15d3eb8c1c3becd67e52e9b99ac24a52a076deab37229eb",
}


@pytest.mark.parametrize("kind", FROZEN)
def test_the_test_arenas_are_frozen_in_no_other_split_and_passable(kind):
    arenas = [generate_arena("test", DENSITY[kind], index, kind=kind) for index in range(3)]
    assert arenas_hash(arenas) == FROZEN[kind]
    others = [
        generate_arena(split, DENSITY[kind], index, kind=kind)
        for split in ("train", "val")
        for index in range(4)
    ]
    assert len({arena_mjcf(arena) for arena in (*arenas, *others)}) == 11
    assert len({arena.name for arena in (*arenas, *others, generate_arena("test", 10, 0))}) == 12
    for arena in others[4:]:
        cost = inflated_cost(clearance_map(arena.obstacles))
        assert shortest_path(cost, arena.start[:2], arena.waypoints[0]) is not None
        assert kind not in ("rooms", "traps") or math.dist(arena.start[:2], arena.waypoints[0]) >= 10.0 - 0.2
        assert not ArenaWorld(arena).advance(0.0, 0.0, 0.1)


def test_doors_are_as_wide_as_they_should_be():
    widths = []
    for index in range(5):
        walls = [o for o in generate_arena("val", 0, index, kind="rooms").obstacles]
        for upright in (True, False):
            along = [w for w in walls if (w.half[0] == THICKNESS / 2) == upright]
            for line in {round(w.x if upright else w.y, 3) for w in along}:
                parts = sorted(
                    (w.y - w.half[1], w.y + w.half[1]) if upright else (w.x - w.half[0], w.x + w.half[0])
                    for w in along
                    if round(w.x if upright else w.y, 3) == line
                )
                gaps = [low - high for (_, high), (low, _) in pairwise(parts)]
                widths += [gap for gap in gaps if gap > 0.01]
    assert len(widths) >= 5 * 8  # nine rooms need eight doors
    assert min(widths) > DOORS[0] - 1e-3
    assert max(widths) < DOORS[1] + 1e-3


def test_a_trap_lies_between_start_and_goal():
    for index in range(10):
        arena = generate_arena("val", 5, index, kind="traps")
        share = np.linspace(0, 1, 400)
        x, y = (arena.start[k] + share * (arena.waypoints[0][k] - arena.start[k]) for k in (0, 1))
        back = arena.obstacles[0]
        assert (back.distance(x, y) == 0).any()


def test_open_arenas_know_no_walls():
    arena = generate_arena("test", 5, 0)
    assert (arena.kind, arena.name) == ("open", "test-5-0")
    with pytest.raises(ValueError, match=r"arena\.kind='mazes': give one of open, rooms, traps, office"):
        generate_arena("test", 5, 0, kind="mazes")


@pytest.mark.parametrize(("kind", "least"), [("maze", 0.7), ("corridor", 0.85), ("office", 0.1)])
def test_walls_are_as_close_as_a_corridor_is_wide(kind, least):
    """Of the cells where a robot fits and that it can reach, most are within half a corridor of a wall."""
    arena = generate_arena("val", 0, 1, kind=kind)
    clearance = clearance_map(arena.obstacles)
    regions = label(clearance >= 0.45, connectivity=1)
    row, column = (int((value + 10) / 0.1) for value in (arena.start[1], arena.start[0]))
    inside = clearance[regions == regions[row, column]]
    assert (inside < CORRIDORS[1] / 2).mean() > least


@pytest.mark.parametrize("kind", ["maze", "corridor"])
def test_mazes_and_corridors_take_no_obstacles(kind):
    with pytest.raises(ValueError, match=rf"density=5, pedestrians=0: arena\.kind={kind} has room for none"):
        generate_arena("test", 5, 0, kind=kind)

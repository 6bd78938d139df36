"""Tracking of pedestrians, and its effect on the driver's memory."""

import math

import numpy as np
import pytest

from eldenet.navigation.observer import Observer, Senses
from eldenet.navigation.pedestrian_tracking import MAX_AGE, RADIUS, PedestrianTracker
from eldenet.simulation.arena_world import ArenaWorld
from eldenet.simulation.arenas import Arena
from eldenet.simulation.obstacle import Obstacle
from eldenet.simulation.robot import ROBOT

WALKER = Obstacle("person", 4.0, -1.5, 0.0, (0.25, 0.25), 1.7, ((4.0, -1.5), (4.0, 4.5)), 0.8)
STANDING = (
    Obstacle("person", 3.0, -0.8, 0.0, (0.25, 0.25), 1.7),
    Obstacle("box", 3.5, 1.8, 0.4, (0.4, 0.4), 1.0),
)


def world_of(*obstacles: Obstacle) -> ArenaWorld:
    return ArenaWorld(Arena("", len(obstacles), 0, obstacles, (0.0, 0.0, 0.0), ((9.0, 0.0),)))


def points_of(world: ArenaWorld) -> tuple[np.ndarray, np.ndarray]:
    ranges = world.ranges()
    x, y, yaw = world.pose
    angles = np.array(ROBOT.column_angles) + yaw
    eye = np.array([x + ROBOT.camera_ahead * math.cos(yaw), y + ROBOT.camera_ahead * math.sin(yaw)])
    return eye + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1), ranges


def drive(
    world: ArenaWorld, steps: int, speed: float = 0.0, turn: float = 0.0
) -> tuple[PedestrianTracker, list]:
    walkers, moving = PedestrianTracker(), []
    for _ in range(steps):
        moving = walkers.update(*points_of(world))
        world.advance(speed, turn, ROBOT.period)
    return walkers, moving


@pytest.mark.parametrize(("speed", "turn"), [(0.0, 0.0), (0.5, 0.0), (0.3, 0.2)])
def test_position_and_velocity_of_a_pedestrian_are_found(speed, turn):
    world = world_of(WALKER, *STANDING)
    _, moving = drive(world, 11, speed, turn)
    (track,) = moving
    assert track.velocity == pytest.approx([0.0, 0.8], abs=0.2)
    x, y = WALKER.position(world.time - ROBOT.period)
    assert math.dist(track.position, (x, y)) < 2 * RADIUS


def test_standing_obstacles_do_not_move_when_the_robot_does():
    _, moving = drive(world_of(*STANDING), 20, 0.4, 0.1)
    assert moving == []


def test_pedestrians_out_of_view_are_kept_for_a_while():
    walkers, _ = drive(world_of(WALKER), 11)
    (track,) = (track for track in walkers.tracks if track.moving)
    there = track.position.copy()
    far = np.full((ROBOT.columns, 2), 50.0), np.full(ROBOT.columns, ROBOT.far)
    for _ in range(MAX_AGE):
        assert walkers.update(*far) == [track]
    assert track.position[1] - there[1] == pytest.approx(0.8 * MAX_AGE * ROBOT.period, rel=0.25)
    assert walkers.update(*far) == []


def test_the_memory_forgets_a_pedestrian_s_trail_and_marks_its_path():
    episode = Obstacle("person", 2.2, -1.2, 0.0, (0.25, 0.25), 1.7, ((2.2, -1.2), (2.2, 6.0)), 0.8)
    seen = {}
    for follow in (False, True):
        observer, world = Observer(walkers=follow, seen_through=0), world_of(episode)
        for _ in range(12):
            senses = Senses(world.ranges()[None], np.array([world.pose]), np.array([[8.0, 0.0]]))
            observer.observe(senses)
            world.advance(0.0, 0.0, ROBOT.period)
        _, x, y, _ = observer.memory.near(np.array([world.pose]))
        seen[follow] = np.stack([x, y], axis=1)
        observer.reset()
        assert len(observer.memory.near(np.array([world.pose]))[0]) == 0
    now = episode.position(2.2)[1]
    trail = {follow: (points[:, 1] < now - 0.6).sum() for follow, points in seen.items()}
    ahead = {follow: (points[:, 1] > now + 0.6).sum() for follow, points in seen.items()}
    assert trail[False] > 10
    assert trail[True] <= 2  # seen before it was wholly in view
    assert ahead[False] == 0
    assert ahead[True] > 10


def test_tracking_changes_nothing_without_pedestrians():
    world = world_of(*STANDING)
    observers = [Observer(walkers=follow) for follow in (False, True)]
    for _ in range(10):
        senses = Senses(world.ranges()[None], np.array([world.pose]), np.array([[8.0, 0.0]]))
        first, second = (observer.observe(senses) for observer in observers)
        np.testing.assert_array_equal(first, second)
        world.advance(0.3, 0.1, ROBOT.period)

"""BARN's worlds from their file: where the cylinders, start, goal and path lie, and what a drive scores."""

import math

import numpy as np
import pytest

from eldenet.simulation.barn import read_barn


def write(path, **changed):
    """Two worlds: a cylinder each, and a path of two cells."""
    arrays = {
        "centers": np.array([[-2.0, 8.0], [-1.0, 9.0]], np.float32),
        "radius": np.float32(0.075),
        "world_start": np.array([0, 1, 2]),
        "path": np.array([[17, 0], [17, 20]] * 2),
        "path_start": np.array([0, 2, 4]),
    }
    np.savez(path, **arrays | changed)
    return path


def test_worlds_lie_in_the_middle_of_an_arena(tmp_path):
    first, second = read_barn(write(tmp_path / "worlds.npz"))
    (cylinder,) = first.arena.obstacles
    assert (cylinder.x, cylinder.y, cylinder.radius) == (0.25, 1.5, 0.075)
    assert first.arena.start == (0.25, -3.5, math.pi / 2)
    assert first.arena.waypoints == ((0.25, 6.5),)
    assert (first.arena.name, second.arena.name) == ("test-barn-1-0", "test-barn-1-1")


def test_a_drive_scores_by_its_optimal_time(tmp_path):
    world = read_barn(write(tmp_path / "worlds.npz"))[0]
    # cells (17, 0) and (17, 20) lie at (-2.025, 5.075) and (-2.025, 8.075)
    sides = math.hypot(0.025, 2.075), 3.0, math.hypot(0.025, 4.925)
    assert world.length == pytest.approx(sum(sides))
    optimal = world.length / 2
    assert world.score(None) == 0
    assert world.score(optimal) == 0.5
    assert world.score(4 * optimal) == pytest.approx(0.25)
    assert world.score(99 * optimal) == pytest.approx(0.125)
    assert world.score(optimal, least=4.0) == 0.25


def test_another_file_is_refused_in_one_line(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_barn(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for path in (tmp_path / "other.npz", write(tmp_path / "w.npz", path_start=np.array([0, 2]))):
        with pytest.raises(ValueError, match=r"not a valid \.npz file of BARN's worlds") as error:
            read_barn(path)
        assert "\n" not in str(error.value)

"""Arenas of one's own: what a file may hold, and what a robot could not drive."""

import math
import re
from pathlib import Path

import pytest

from eldenet.simulation.arena_files import read_arena
from eldenet.system.files import write_yaml

MINE = {
    "start": [-8, -8, 90],
    "waypoints": [[0, 5], [8, 8]],
    "obstacles": [
        {"kind": "person", "at": [5, 0], "path": [[5, 4]], "speed": 0.5},
        {"kind": "cylinder", "at": [2, 2], "radius": 0.4},
        {"kind": "box", "at": [-3, 0], "size": [4, 0.5], "yaw": 30},
        {"kind": "vehicle", "at": [0, -5]},
    ],
}
WALL = {"kind": "box", "at": [0, 0], "size": [10, 0.5], "yaw": 0}


def test_a_file_becomes_an_arena(tmp_path):
    write_yaml(tmp_path / "mine.yaml", MINE)
    arena = read_arena(tmp_path / "mine.yaml")
    assert arena.start == (-8, -8, pytest.approx(math.pi / 2))
    assert arena.waypoints == ((0, 5), (8, 8))
    assert (arena.density, len(arena.pedestrians), arena.side) == (3, 1, 20.0)
    assert arena.obstacles[-1].position(8.0) == pytest.approx((5, 4))  # 4 m at 0.5 m/s: the far corner
    assert arena.obstacles[1].half == (2.0, 0.25)


def test_the_example_of_the_page_is_an_arena(tmp_path):
    page = Path(__file__).resolve().parents[2] / "docs" / "navigation.md"
    (tmp_path / "mine.yaml").write_text(re.search(r"```yaml\n(.*?)```", page.read_text(), re.S)[1])
    assert [obstacle.kind for obstacle in read_arena(tmp_path / "mine.yaml").obstacles] == [
        *("cylinder", "box", "vehicle", "person")
    ]


@pytest.mark.parametrize(("changes", "message"), [
    ({"waypoints": [[30, 2]]}, r"waypoints\[0\]=\[30, 2\] lies outside the arena: give x and y"),
    ({"waypoints": [[2, 2.5]]}, r"waypoints\[0\]=\[2, 2.5\] lies 0.\d\d m from an obstacle"),
    ({"start": [-9.9, 0, 0]}, "start=.* from an obstacle or wall"),
    ({"start": [5, 0.5, 0]}, r"start=\[5, 0.5\] lies 0\.25 m from a person who walks"),
    ({"start": [1, 2]}, r"start=\[1, 2\]: give \[x, y, heading\] in meters and degrees"),
    ({"waypoints": []}, "has no waypoints: add it"),
    ({"side": 50}, "side=50: give a number from 4 to 20"),
    ({"obstacles": [{"kind": "tree", "at": [0, 0]}]}, "kind='tree': give one of cylinder, box"),
    ({"obstacles": [{"kind": "box", "at": [0, 0]}]}, r"obstacles\[0\] has no size"),
    ({"obstacles": [{"kind": "cylinder", "at": [0, 0], "radius": -1}]}, "radius=-1: give a number"),
    ({"obstacles": [{"kind": "person", "at": [5, 0], "path": [[5, 0]]}]}, "stays at its start: give another"),
    ({"obstacles": [WALL | {"yaw": []}]}, r"yaw=\[\]: give a number"),
    ({"waypoint": [[1, 1]]}, "key='waypoint': give one of side, start, waypoints, obstacles"),
    ({"side": 10, "start": [0, -3, 0], "waypoints": [[0, 3]], "obstacles": [WALL]},
     r"no way from start to waypoints\[0\]"),
])  # fmt: skip
def test_what_a_robot_could_not_drive_is_refused_in_one_line(tmp_path, changes, message):
    write_yaml(tmp_path / "mine.yaml", MINE | changes)
    with pytest.raises(ValueError, match=message) as raised:
        read_arena(tmp_path / "mine.yaml")
    assert str(raised.value).startswith(f"{tmp_path}/mine.yaml: ")
    assert "\n" not in str(raised.value)

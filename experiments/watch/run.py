"""Which faults does a driver's watch notice, how soon, and how often does it stop a robot without a fault?

python experiments/watch/run.py --drives 100    reads stored drives and measures those that are missing

Each drive crosses a test arena on wheels by the driver's own ``step``. A fault begins after 3 to 8 s. A
command that was stopped goes on with the row where it stopped.
"""

import math
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.geometry import level_rotation  # noqa: E402
from eldenet.navigation.episodes import Episodes, EpisodeSettings, Event  # noqa: E402
from eldenet.navigation.floor import Leveler  # noqa: E402
from eldenet.navigation.on_robot import OnRobot  # noqa: E402
from eldenet.navigation.planners.plan_and_steer import PlanAndSteer  # noqa: E402
from eldenet.navigation.policy import Navigator  # noqa: E402
from eldenet.navigation.sensors import Drift, Ranges  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.simulation.arena_view import ArenaView, camera_pose  # noqa: E402
from eldenet.simulation.arenas import Arena, generate_arena  # noqa: E402
from eldenet.simulation.depth_camera import StereoArtifacts  # noqa: E402
from eldenet.simulation.obstacle import WALL_HEIGHT, Obstacle  # noqa: E402
from eldenet.simulation.robot import ROBOT, arc  # noqa: E402
from eldenet.system.files import read_table, write_rows  # noqa: E402

HERE = Path(__file__).parent
#: Raise it whenever drives change: stored rows of another version are measured again.
WATCH_VERSION = 1
SIZE = (96, 128)  # of pictures [px]
NOTICED_WITHIN = 30.0  # [s]; a closed goal: the driver looks at it from all sides first
CLOSED_WITHIN = 150.0
NETWORK = "eldenet_arenas"
DRIVERS: dict[str, Callable[[], OnRobot]] = {
    "plan": lambda: PlanAndSteer(slows_within=1.0),
    "alone": lambda: Navigator.load(slows_within=1.0),
}


@dataclass
class Inputs:
    """What ``step`` is given; a fault changes it."""

    depth: np.ndarray
    goal: tuple[float, float]
    odometry: tuple[float, float, float]
    stamp: float
    image: np.ndarray | None = None
    height: float = ROBOT.camera_height


class Row(NamedTuple):
    """One drive: when the fault began and when the watch stopped it [s], -1: never."""

    version: int
    sensor: str
    driver: str
    fault: str
    world: int
    outcome: str
    began: float
    stopped: float
    reason: str


Fault = Callable[[Inputs, Inputs], Inputs]  # inputs now, inputs when it began -> inputs with the fault


def scaled(factor: float) -> Fault:
    return lambda now, then: replace(now, depth=(now.depth * factor).astype(np.float32))


def gray(level: float, spread: float = 0.0) -> Callable[[Inputs], np.ndarray]:
    """A picture of one level with a bright middle, as a finger's, and the noise of pixels."""
    rows, columns = np.mgrid[-1 : 1 : SIZE[0] * 1j, -1 : 1 : SIZE[1] * 1j]
    glow = level + spread * np.exp(-(rows**2 + columns**2))

    def picture(now: Inputs) -> np.ndarray:
        noise = np.random.default_rng(int(now.stamp * 10)).normal(0, 2, (*SIZE, 3))
        return np.clip(glow[..., None] * (1.0, 0.6, 0.5) + noise, 0, 255).astype(np.uint8)

    return picture


ANYWHERE: dict[str, Fault] = {
    "none": lambda now, then: now,
    "frozen camera": lambda now, then: replace(now, depth=then.depth, image=then.image),
    "frozen odometry": lambda now, then: replace(now, odometry=then.odometry, goal=then.goal),
    "all frozen": lambda now, then: replace(then, stamp=now.stamp),
    "slipping wheels": lambda now, then: now,  # see drive
    "data 1 s old": lambda now, then: replace(now, stamp=now.stamp - 1.0),
}


def told(change: Callable[[float, float, float], tuple[float, float, float]]) -> Fault:
    """Odometry of another sign, order or unit from the start; the goal's bearing is right."""
    return lambda now, then: replace(now, odometry=change(*now.odometry))


CONTRARY: dict[str, Fault] = {
    "heading clockwise": told(lambda x, y, heading: (x, y, -heading)),
    "y and heading to the right": told(lambda x, y, heading: (x, -y, -heading)),
    "heading in degrees": told(lambda x, y, heading: (x, y, math.degrees(heading))),
    "x and y swapped": told(lambda x, y, heading: (y, x, heading)),
    "odometry in mm": told(lambda x, y, heading: (1000 * x, 1000 * y, heading)),
}
FAULTS: dict[str, dict[str, Fault]] = {
    "ranges": {
        **ANYWHERE,
        **CONTRARY,
        "all -inf": lambda now, then: replace(now, depth=np.full(ROBOT.columns, -np.inf)),
        "all 1e-9 m": lambda now, then: replace(now, depth=np.full(ROBOT.columns, 1e-9)),
        "goal at 1e300 m": lambda now, then: replace(now, goal=(1e300, 0.0)),
        "odometry nan": lambda now, then: replace(now, odometry=(math.nan, 0.0, 0.0)),
        "closed goal": lambda now, then: now,
    },
    "depth camera": {
        **ANYWHERE,
        "covered": lambda now, then: replace(now, depth=np.zeros_like(now.depth)),
        "pitch 5 degrees": lambda now, then: now,
        "roll 5 degrees": lambda now, then: now,
        "height 0.25 m, told 0.40": lambda now, then: now,
        "depth x 0.1": scaled(0.1),
        "depth x 0.75": scaled(0.75),
        "depth x 1.35": scaled(1.35),
        "depth x 10": scaled(10.0),
    },
    "network": {
        **ANYWHERE,
        "black": lambda now, then: replace(now, image=gray(2)(now)),
        "white": lambda now, then: replace(now, image=gray(253)(now)),
        "finger": lambda now, then: replace(now, image=gray(60, 90)(now)),
    },
}
#: Camera's pitch and roll [rad] and height [m] of faults that turn or move it.
MOUNTS = {
    "pitch 5 degrees": (math.radians(5), 0.0, ROBOT.camera_height),
    "roll 5 degrees": (0.0, math.radians(5), ROBOT.camera_height),
    "height 0.25 m, told 0.40": (0.0, 0.0, 0.25),
}
AT_ONCE = ("none", "closed goal", *MOUNTS, *CONTRARY)
LEVEL = (0.0, 0.0, ROBOT.camera_height)
#: Faults of level.py, for every sensor with a picture.
UNLEVEL: dict[str, Fault] = {
    **{name: ANYWHERE["none"] for name in ("none", "pitch 5 degrees", "roll 5 degrees")},
    **{f"depth x {factor:g}": scaled(factor) for factor in (0.8, 1.2)},
}
KINDS = {"80": ("open", 80), "rooms": ("rooms", 10)}


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=20, help="of every fault")
    parser.add_argument("--sound", type=int, default=None, help="drives without a fault; default: as many")
    parser.add_argument("--sensors", default=",".join(FAULTS))
    parser.add_argument("--drivers", default=",".join(DRIVERS))
    parser.add_argument("--faults", default=None, help="separated by semicolons; default: all of a sensor")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    rows = read(folder / "drives.csv.xz")
    for sensor in args.sensors.split(","):
        names = list(FAULTS[sensor]) if args.faults is None else args.faults.split(";")
        for fault in [name for name in names if name in FAULTS[sensor]]:
            for driver in args.drivers.split(","):
                count = args.drives if fault != "none" or args.sound is None else args.sound
                done = {row.world for row in rows if row[1:4] == (sensor, driver, fault)}
                missing = sorted(set(range(count)) - done)
                rows += [drive(sensor, driver, fault, world) for world in missing]
                if missing:
                    write(folder, rows)
                    print(line(sensor, driver, fault, rows), flush=True)
    write(folder, rows)


def arena_of(fault: str, world: int) -> Arena:
    """Half of the drives are among 80 obstacles, half in rooms."""
    kind, density = KINDS["80" if world % 2 == 0 else "rooms"]
    arena = generate_arena("test", density, world // 2, kind=kind)
    if fault != "closed goal":
        return arena
    x, y = arena.waypoints[0]
    walls = [
        Obstacle("box", x + 0.72 * a, y + 0.72 * b, 0.0, (0.06, 0.78) if a else (0.78, 0.06), WALL_HEIGHT)
        for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))
    ]
    return replace(arena, obstacles=(*arena.obstacles, *walls))


class Eye:
    """Depth as a sensor gives it, at the robot's pose."""

    def __init__(self, sensor: str, arena: Arena, mount: tuple[float, float, float], seed: int) -> None:
        self.sensor, self.mount, self.rng = sensor, mount, np.random.default_rng(seed)
        if sensor == "ranges":
            return
        self.view = ArenaView(arena, SIZE)
        self.artifacts = StereoArtifacts()
        self.dead = self.artifacts.draw_dead(SIZE[1], self.rng)

    def look(
        self, pose: tuple[float, float, float], ranges: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Depth [m] and picture."""
        if self.sensor == "ranges":
            return ranges, None
        center, rotation = camera_pose(pose)
        pitch, roll, height = self.mount
        rotation = rotation @ level_rotation(pitch, roll)
        center = np.array([*center[:2], height])
        if self.sensor == "network":
            photo = self.view.photo(pose, 0.0, int(self.rng.integers(2**31)), camera=(center, rotation))
            return photo.depth, photo.image
        room = self.view.room
        depth = self.view.camera.cast(room.model, room.data, center, rotation).depth.reshape(SIZE)
        focal = float(self.view.intrinsics[0, 0])
        return self.artifacts.apply(depth.astype(np.float32), focal, self.dead, self.rng), None


def drive(sensor: str, name: str, fault: str, world: int, leveled: bool | None = None) -> Row:
    """One drive to the goal, to a stop of the watch, a collision or the end of time.

    With ``leveled`` (not None) the fault is there from the start and the watch is off.
    """
    arena, driver = arena_of(fault, world), DRIVERS[name]()
    drift = Ranges() if sensor == "ranges" else Ranges(drift=Drift())
    limit = CLOSED_WITHIN if fault == "closed goal" else 60.0
    within = CLOSED_WITHIN if fault == "closed goal" else NOTICED_WITHIN
    episodes = Episodes(1, drift, EpisodeSettings("wheels", time_limit=limit))
    episodes.start(0, arena, (7, world))
    began = ROBOT.period * int(np.random.default_rng([7, world]).integers(15, 40))
    began = 0.0 if leveled is not None or fault in AT_ONCE else began
    driver.leveler = Leveler() if leveled else None
    change = FAULTS[sensor][fault] if leveled is None else UNLEVEL[fault]
    eye = Eye(sensor, arena, MOUNTS.get(fault, LEVEL), world)
    predictor = network() if sensor == "network" else None
    assert driver.watch is not None
    driver.watch.tolerance = 0.0  # the episode ends there
    clock = [0.0]
    driver.watch.clock = lambda: clock[0]
    driver.watch = driver.watch if leveled is None else None
    then: Inputs | None = None
    spun: tuple[float, float, float] | None = None  # odometry of wheels that slip: the robot stands
    stopped, reason, event = -1.0, "", Event.NONE
    while event is Event.NONE:
        clock[0] = float(episodes.seconds[0])
        if leveled is None and (stopped >= 0 or (clock[0] > began + within and fault != "none")):
            break
        senses = episodes.sense()
        pose = tuple(episodes.poses[0].tolist())
        depth, image = eye.look(pose, senses.ranges[0])
        goal, odometry = tuple(senses.goal[0].tolist()), tuple(senses.odometry[0].tolist())
        now = Inputs(depth, goal, odometry, clock[0], image)
        if clock[0] >= began - 1e-6:
            then = then or now
            now = change(now, then)
            if fault == "slipping wheels":
                now.odometry = spun = spun or now.odometry
        options: dict[str, Any] = {}
        if sensor != "ranges":
            options["intrinsics"] = eye.view.intrinsics
        if predictor is not None:
            options["image"] = now.image
            now.depth = predictor(now.image, intrinsics=eye.view.intrinsics)
            now = now if leveled is None else change(now, now)
        command = driver.step(now.depth, now.goal, now.odometry, stamp=now.stamp, **options)
        if driver.stop_reason is not None:
            stopped, reason = clock[0], driver.stop_reason
        if spun is not None:
            spun, command = arc(*spun, *command, ROBOT.period), (0.0, 0.0)
        event = Event(int(episodes.step(np.array([command]))[1][0]))
    return Row(
        WATCH_VERSION,
        sensor,
        name,
        fault,
        world,
        event.name.lower(),
        round(began, 1),
        round(stopped, 1),
        reason,
    )


_networks: dict[str, Any] = {}


def network() -> Any:
    """The depth network, loaded once."""
    if NETWORK not in _networks:
        _networks[NETWORK] = eldenet.DepthPredictor(eldenet.load(NETWORK), steady=False)
    return _networks[NETWORK]


def read(file: Path) -> list[Row]:
    """Return the stored drives of today's version."""
    if not file.is_file():
        return []
    rows = [
        Row(int(v), sensor, driver, fault, int(world), outcome, float(began), float(stopped), reason)
        for v, sensor, driver, fault, world, outcome, began, stopped, reason in (
            row.values() for row in read_table(file, Row._fields)
        )
    ]
    return [row for row in rows if row.version == WATCH_VERSION]


def line(sensor: str, driver: str, fault: str, rows: Sequence[Row]) -> str:
    """Return a line of the table."""
    found = [row for row in rows if row[1:4] == (sensor, driver, fault)]
    # a drive that ended before its fault began says nothing
    met = [row for row in found if row.outcome == "none" or fault == "none" or row.stopped >= row.began]
    caught = [row for row in met if row.stopped >= row.began]
    early = [row for row in found if 0 <= row.stopped < row.began]
    if fault == "none":
        cells = ["-", "-", "-", f"{len(caught)} of {len(found)}"]
    else:
        crashed = [row for row in found if row.outcome != "none" and row not in caught and row not in early]
        seconds = sorted(row.stopped - row.began for row in caught)
        times = [f"{seconds[len(seconds) // 2]:.1f}", f"{seconds[-1]:.1f}"] if seconds else ["-", "-"]
        cells = [f"{len(caught)} of {len(found)} ({len(crashed)} ended before)", *times, f"{len(early)}"]
    return f"| {sensor} | {driver} | {fault} | {' | '.join(cells)} |"


def write(folder: Path, rows: Sequence[Row]) -> None:
    """Write every drive to ``drives.csv.xz`` and the table to ``results.md``."""
    write_rows(folder / "drives.csv.xz", Row._fields, sorted(rows))
    keys = [
        (sensor, driver, fault)
        for sensor, faults in FAULTS.items()
        for fault in faults
        for driver in DRIVERS
        if any(row[1:4] == (sensor, driver, fault) for row in rows)
    ]
    text = [
        "# What the watch notices",
        "",
        f"Drives in test arenas, half with 80 obstacles, half with rooms; {environment()['date']}. A fault "
        "begins after 3 to 8 s (a mount's, a closed goal's, odometry's sign, order or unit: at once). "
        "Seconds are from then to the stop, median and greatest. False: drives that the watch stopped "
        "without a fault, or before it.",
        "",
        "| sensor | driver | fault | noticed | median [s] | greatest [s] | false |",
        "|---|---|---|---:|---:|---:|---:|",
        *(line(*key, rows) for key in keys),
        "",
        "Made by `python experiments/watch/run.py`.",
    ]
    (folder / "results.md").write_text("\n".join(text) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])

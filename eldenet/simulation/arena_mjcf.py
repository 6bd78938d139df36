"""Arenas as MJCF: the same walls and obstacles for physics, ranges and camera.

Contacts: obstacles and walls have ``contype`` 1, the floor has 2; the robot's chassis touches obstacles only,
its wheels touch both.
"""

from typing import TYPE_CHECKING

from eldenet.simulation.arenas import SPLITS, Arena
from eldenet.simulation.obstacle import WALL_HEIGHT, Obstacle
from eldenet.simulation.rendering.mjcf import Body, Draw, number, numbers
from eldenet.simulation.robot import ROBOT
from eldenet.system.checks import one_of

if TYPE_CHECKING:
    from eldenet.simulation.rendering.materials import Materials

CEILING = 4.0  # [m]
ROBOTS = ("none", "planar", "wheels")
WHEEL_RADIUS, WHEEL_TRACK = 0.10, 0.42  # [m]
FRICTION = 1.1  # between wheels and floor
TIMESTEP = 0.005  # of the wheels' physics [s]


def arena_mjcf(
    arena: Arena,
    robot: str = "planar",
    *,
    visual: bool = False,
    size: float = 1.0,
    friction: float = FRICTION,
) -> str:
    """Return the MJCF text of an arena.

    Args:
        arena: the world.
        robot: "planar" (two slides and a hinge, moved by writing its pose), "wheels" (free body, two driven
            wheels and a caster on the floor) or "none" (for the camera's model).
        visual: add materials, a ceiling and the hall for :mod:`eldenet.simulation.arena_view`.
        size: of the robot's footprint and track, relative to :data:`~eldenet.simulation.robot.ROBOT`.
        friction: between wheels and floor.

    Raises:
        ValueError: unknown robot.
    """
    one_of("robot", robot, ROBOTS)
    materials = None
    if visual:
        from eldenet.simulation.rendering.materials import Materials

        materials = Materials(Draw((SPLITS.get(arena.split, 0), arena.density, arena.index, 1)))
    walls = _walls(arena, materials)
    bodies = [_geoms(o, materials, n) for n, o in enumerate(arena.obstacles) if not o.path]
    bodies += [
        f'<body mocap="true" pos="{number(o.x)} {number(o.y)} 0">'
        f"{_geoms(o, materials, n, centered=True)}</body>"
        for n, o in enumerate(arena.obstacles)
        if o.path
    ]
    assets = materials.palette.assets() if materials is not None else ""
    body = {"none": "", "planar": _planar(size), "wheels": _wheels(size, friction)}[robot]
    inner = "\n".join([*walls, *bodies, body])
    return (
        '<mujoco model="arena">\n<compiler angle="radian"/>\n'
        f'<option timestep="{TIMESTEP}" integrator="implicitfast"/>\n<size memory="256K"/>\n'
        f"{assets}\n<worldbody>\n{inner}\n</worldbody>\n{_MOTORS if robot == 'wheels' else ''}\n</mujoco>\n"
    )


def _walls(arena: Arena, materials: "Materials | None") -> list[str]:
    """Return floor and walls, and with materials the ceiling and the hall around them."""
    floor = "" if materials is None else f' material="m{materials.floor}"'
    wall = "" if materials is None else f' material="m{materials.walls[0]}"'
    lines = [f'<geom name="floor" type="plane" size="0 0 1" contype="2" conaffinity="0" condim="1"{floor}/>']
    half, thick = arena.side / 2, 0.05
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        center = (x * (half + thick), y * (half + thick), WALL_HEIGHT / 2)
        size = (thick if x else half + 2 * thick, thick if y else half + 2 * thick, WALL_HEIGHT / 2)
        lines.append(_geom("box", center, size, 0.0, wall, collide=True))
    if materials is not None:
        hall = Body()
        hall.plane((0, 0, CEILING), (0, 0, -1), materials.ceiling)
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):  # the hall is larger than the arena
            hall.plane((x * (half + 1), y * (half + 1), 0), (-x, -y, 0), materials.walls[1])
        lines += [line.replace("/>", ' contype="0" conaffinity="0"/>') for line in hall.geoms]
    return lines


def _geoms(obstacle: Obstacle, materials: "Materials | None", order: int, *, centered: bool = False) -> str:
    """Return the geoms of an obstacle: one solid of its footprint, and what only the camera sees."""
    x, y = (0.0, 0.0) if centered else (obstacle.x, obstacle.y)
    hx, hy = obstacle.half
    main = cap = ""
    if materials is not None:
        cloth = materials.clothes[order % len(materials.clothes)]
        color = materials.colors[order % len(materials.colors)]
        front = materials.fronts[order % len(materials.fronts)]
        main = f' material="m{ {"person": cloth, "box": front}.get(obstacle.kind, color) }"'
        cap = f' material="m{materials.skin if obstacle.kind == "person" else materials.dark}"'
    tall = obstacle.height
    if obstacle.kind == "person":
        body = _geom("cylinder", (x, y, (tall - 0.3) / 2), (hx, (tall - 0.3) / 2), 0.0, main, collide=True)
        return body + _geom("ellipsoid", (x, y, tall - 0.17), (0.1, 0.1, 0.14), 0.0, cap)
    if obstacle.kind == "cylinder":
        return _geom("cylinder", (x, y, tall / 2), (hx, tall / 2), 0.0, main, collide=True)
    solid = _geom("box", (x, y, tall / 2), (hx, hy, tall / 2), obstacle.yaw, main, collide=True)
    if obstacle.kind == "vehicle":
        solid += _geom("box", (x, y, tall + 0.15), (0.55 * hx, 0.85 * hy, 0.15), obstacle.yaw, cap)
    return solid


def _geom(
    kind: str,
    center: tuple[float, float, float],
    size: tuple[float, ...],
    yaw: float,
    material: str,
    *,
    collide: bool = False,
) -> str:
    turn = f' euler="0 0 {number(yaw)}"' if yaw else ""
    bits = 'contype="1" conaffinity="0"' if collide else 'contype="0" conaffinity="0"'
    return f'<geom type="{kind}" pos="{numbers(center)}" size="{numbers(size)}"{turn} {bits}{material}/>'


def _chassis(size: float) -> str:
    """Return a box down to 6 cm, so that nothing slips under it; it turns around the center of the axle."""
    half = (size * ROBOT.length / 2, size * ROBOT.width / 2, (ROBOT.height - 0.06) / 2)
    return (
        f'<geom name="chassis" type="box" pos="0 0 {number((ROBOT.height + 0.06) / 2)}" '
        f'size="{numbers(half)}" contype="0" conaffinity="1" group="5" mass="6"/>'
    )


def _planar(size: float) -> str:
    """Return two slides and a hinge: ``qpos`` is the pose."""
    return (
        '<body name="robot"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>'
        f'<joint type="hinge" axis="0 0 1"/>{_chassis(size)}</body>'
    )


def _wheels(size: float, friction: float) -> str:
    """Return a free body on two driven wheels and a frictionless caster behind them."""
    # of two bodies that touch, MuJoCo takes the greater friction, unless one has priority
    grip = f'friction="{number(friction)}"' + ("" if friction == FRICTION else ' priority="1"')
    shared = 'contype="0" conaffinity="3" group="5"'
    wheels = "".join(
        f'<body name="{name}" pos="0 {number(y)} {WHEEL_RADIUS}">'
        f'<joint name="{name}" type="hinge" axis="0 1 0" damping="0.05" armature="0.02"/>'
        f'<geom type="cylinder" size="{WHEEL_RADIUS} 0.02" euler="1.5708 0 0" condim="3" {grip} '
        f'{shared} mass="1"/></body>'
        for name, y in (("left", size * WHEEL_TRACK / 2), ("right", -size * WHEEL_TRACK / 2))
    )
    caster = (
        f'<geom name="caster" type="sphere" pos="{number(-0.22 * size)} 0 0.05" size="0.05" condim="1" '
        f'{shared} mass="0.5"/>'
    )
    # low weight between axle and caster keeps the robot from tipping when it brakes or accelerates
    battery = (
        f'<geom type="box" pos="{number(-0.15 * size)} 0 0.12" size="0.1 0.15 0.04" '
        'contype="0" conaffinity="0" group="5" mass="14"/>'
    )
    return f'<body name="robot"><freejoint/>{_chassis(size)}{battery}{caster}{wheels}</body>'


# A speed controller on each wheel, with the torque of a 90 W motor behind a gear [N m].
_MOTORS = (
    '<actuator><velocity joint="left" kv="40" ctrlrange="-20 20" forcerange="-6 6"/>'
    '<velocity joint="right" kv="40" ctrlrange="-20 20" forcerange="-6 6"/></actuator>'
)

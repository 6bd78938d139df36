"""Render views of furnished rooms with exact depth: Infinigen 2 builds a room, Blender takes pictures.

python3.11 -m venv blender && blender/bin/pip install "infinigen==2.0.0a3"     # BSD-3; 1.4 GB
blender/bin/python experiments/indoor/infinigen_rooms.py $ELDENET_DATA/infinigen_rooms --rooms 0:40

A program of its own: it imports nothing of eldenet, and eldenet nothing of it. A room is a folder with
``<view>.jpg``, ``<view>.png`` (planar depth [mm], 16 bits, 0 unknown) and ``<view>.txt`` (``fx fy cx cy``
[px]) of each view; a room that could not be built is an empty folder. A third of the views look at what is
close (median depth below 0.9 m). Cameras are 0.2 to 1.7 m high, see 45 to 95 degrees, look a little down.
"""

import argparse
import math
import os
import resource
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numpy as np

SIZE = (156, 208)  # (height, width) [px]
VIEWS, SAMPLES = 8, 5
LONGEST = 600  # seconds of processor time for a room
MEMORY = 9_000_000_000  # bytes
KINDS = ("livingroom", "bedroom", "kitchen", "bathroom", "diningroom")
ACROSS, DOWN = np.linspace(0.1, 0.9, 7), np.linspace(0.1, 0.9, 5)  # rays that try a pose
NOTHING = 99.0  # depth where a ray hits nothing [m]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rooms", default="0:40", help="first and last but one")
    parser.add_argument("--seed", type=int, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.seed is not None:
        render_room(chosen.seed, chosen.folder)
        return
    for seed in range(*map(int, chosen.rooms.split(":"))):
        room = chosen.folder / f"{seed:05d}"
        if not room.exists():
            render_apart(seed, room)


def render_apart(seed: int, room: Path) -> None:
    """Render a room in a process of its own, which may fail; the folder appears when it is whole."""
    partial = room.with_suffix(".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    command = [sys.executable, __file__, str(partial), "--seed", str(seed)]
    with (partial / "log").open("w") as log:
        ended = subprocess.run(
            command, stdout=log, stderr=log, preexec_fn=limit, env=os.environ | {"OMP_NUM_THREADS": "1"}
        )
    if ended.returncode:
        print(f"{room.name}: failed, see {room.with_suffix('.log')}", flush=True)
        shutil.move(partial / "log", room.with_suffix(".log"))
        shutil.rmtree(partial)
        partial.mkdir()
    else:
        print(f"{room.name}: {len(list(partial.glob('*.jpg')))} views", flush=True)
        (partial / "log").unlink()
    partial.rename(room)


def limit() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def render_room(seed: int, folder: Path) -> None:
    """Build the room of a seed and write its views."""
    os.environ["INFINIGEN_CYCLES_DEVICE_TYPE"] = "CPU"
    import bpy
    import procfunc
    from infinigen2.scenes.room import room

    replace_what_fails()
    procfunc.ops.object.clear_scene()
    scene = bpy.context.scene
    simplify = {"use_simplify": True, "simplify_subdivision": 1, "simplify_subdivision_render": 1}
    for name, value in simplify.items():
        setattr(scene.render, name, value)
    build = getattr(room, f"room_{KINDS[seed % len(KINDS)]}_rand")
    built = build(np.random.default_rng(seed))
    remove_what_disturbs(built)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    set_up_cycles(scene, folder)
    rng = np.random.default_rng(10_000 + seed)
    for view in range(VIEWS):
        focal = place_camera(rng, built, camera, near=view % 3 == 2)
        if focal is not None:
            name = folder / f"{seed:05d}_{view}"
            take_picture(rng, scene, name)
            name.with_suffix(".txt").write_text(f"{focal} {focal} {SIZE[1] / 2} {SIZE[0] / 2}\n")


def replace_what_fails() -> None:
    """Replace what needs an add-on or covers walls with large patterns; put doors in a fifth of the walls."""
    import bpy
    import mathutils
    import procfunc
    from infinigen2.objects import ant_landscape
    from infinigen2.scenes.room import room
    from infinigen2.scenes.room.wall_cutouts import wall_doors_rand
    from infinigen2.shaders import functionality_lists as surfaces

    def rock(material=None, **options):
        bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=4, radius=1.0)
        stone = bpy.context.active_object
        mathutils.noise.seed_set(int(options.get("random_seed", 0)) % 10000 + 1)
        for vertex in stone.data.vertices:
            vertex.co *= 1 + 0.35 * mathutils.noise.fractal(vertex.co * 1.5, 1.0, 2.0, 4)
        return procfunc.MeshObject(stone)

    ant_landscape.landscape = rock
    paint = surfaces.paint_wall_rand
    surfaces.paint_patterned_rand = surfaces._art_patterned_paint_rand = paint
    surfaces.wall.wall_flaked_tile_rand = paint
    ground = surfaces.tiles.tile_indoor_ground_rand  # tiles on walls overflow Cycles' stack and turn black
    surfaces.tiles = types.SimpleNamespace(tile_indoor_wall_rand=paint, tile_indoor_ground_rand=ground)
    arrangement = room.wall_arrangement_rand

    def with_doors(rng, wall=None, *rest, wall_material=None, wall_thickness=0.05, **options):
        chance, rng = rng.spawn(2)
        materials = {"wall_material": wall_material, "wall_thickness": wall_thickness}
        if chance.random() < 0.2:
            return wall_doors_rand(rng, wall, **materials)
        return arrangement(rng, wall, *rest, **materials, **options)

    room.wall_arrangement_rand = with_doors


def remove_what_disturbs(built) -> None:
    """Take away failed placements, what only ray casts would see, and subdivision that takes 13 GB."""
    import bpy
    from infinigen2.util.scene_cleanup import cleanup_except

    cleanup_except([*built.all_objects, *built.lights, *built.colliders.objs])
    for thing in bpy.data.objects:
        thing.hide_viewport = thing.hide_viewport or thing.hide_render
        for modifier in [other for other in thing.modifiers if other.type == "SUBSURF"]:
            large = thing.type == "MESH" and len(thing.data.polygons) > 1500
            if modifier.subdivision_type == "SIMPLE" or large:
                thing.modifiers.remove(modifier)
            else:
                modifier.quality, modifier.use_limit_surface, modifier.use_custom_normals = 1, False, False
    bpy.context.view_layer.update()


def place_camera(rng: np.random.Generator, built, camera, *, near: bool) -> float | None:
    """Put the camera where something is to be seen; return its focal length [px], None: no place found."""
    import bpy
    import mathutils
    from infinigen2.cameras.util import camera_transform_cube_free_space_check

    scene, graph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    floor = built.floor.item()
    corners = np.array([floor.matrix_world @ mathutils.Vector(corner) for corner in floor.bound_box])
    low, high = corners.min(0), corners.max(0)

    def cast(eye, direction):
        hit, place, _, _, thing, _ = scene.ray_cast(graph, eye, direction)
        return ((place - eye).length, thing.name) if hit else (NOTHING, "")

    for tried in range(400):
        height = rng.choice(
            [rng.uniform(0.2, 0.6), rng.uniform(0.6, 1.2), rng.uniform(1.2, 1.7)], p=[0.35, 0.3, 0.35]
        )
        eye = np.array([*rng.uniform(low[:2] + 0.25, high[:2] - 0.25), low[2] + height])
        eye[2] = min(eye[2], low[2] + built.dimensions[2] - 0.3)
        pitch, roll = np.radians(rng.normal([-8, 0], [10, 2.5]))
        turn = mathutils.Euler((math.pi / 2 + pitch, roll, rng.uniform(0, 2 * math.pi)))
        matrix = turn.to_matrix()
        field = math.radians(rng.uniform(45, 95))
        if near:  # towards what it sees
            ahead = matrix @ mathutils.Vector((0, 0, -1))
            eye += np.array(ahead) * max(cast(mathutils.Vector(eye), ahead)[0] - rng.uniform(0.25, 0.9), 0)
        focal = SIZE[1] / 2 / math.tan(field / 2)
        depths, seen = [], set()
        for x in (ACROSS - 0.5) * SIZE[1] / focal:
            for y in (DOWN - 0.5) * SIZE[0] / focal:
                ray = mathutils.Vector((x, -y, -1))
                distance, thing = cast(mathutils.Vector(eye), matrix @ ray.normalized())
                depths.append(distance / ray.length)
                seen.add(thing)
        if (
            not worth_seeing(np.array(depths), len(seen), tried, rng.random(), near=near)
            or eye[2] < low[2] + 0.12
        ):
            continue
        pose = np.array(mathutils.Matrix.Translation(eye) @ matrix.to_4x4())
        if camera_transform_cube_free_space_check(pose, built.colliders, probe_size=0.15 if near else 0.4):
            camera.location, camera.rotation_euler = eye, turn
            camera.data.sensor_fit, camera.data.angle, camera.data.clip_start = "HORIZONTAL", field, 0.02
            bpy.context.view_layer.update()
            return focal
    return None


def worth_seeing(depths: np.ndarray, things: int, tried: int, chance: float, *, near: bool) -> bool:
    """Whether a pose is near or far as asked, in the room, and not before a bare wall (but for a few)."""
    median, spread = np.median(depths), np.percentile(depths, 90) / np.percentile(depths, 10)
    if near:
        rich, fits = things >= 3 and spread > 1.3, depths.min() > 0.12 and 0.2 < median < 0.9
    else:
        rich, fits = things >= 5 and spread > 1.6, depths.min() > 0.2 and median > 0.9
    bare = tried > 60 or (near and chance < 0.1)
    return fits and (depths > 30).mean() < 0.3 and (rich or bare)


def set_up_cycles(scene, folder: Path) -> None:
    """Few samples and a denoiser on one thread; picture and planar depth as EXR."""
    scene.render.engine = "CYCLES"
    scene.render.resolution_y, scene.render.resolution_x = SIZE
    scene.render.threads_mode, scene.render.threads, scene.render.use_persistent_data = "FIXED", 1, True
    settings = {
        "device": "CPU",
        "samples": SAMPLES,
        "max_bounces": 5,
        "diffuse_bounces": 4,
        "glossy_bounces": 3,
        "transmission_bounces": 4,
        "sample_clamp_indirect": 10,
        "use_denoising": True,
        "denoiser": "OPENIMAGEDENOISE",
    }
    for name, value in settings.items():
        setattr(scene.cycles, name, value)
    scene.view_layers[0].use_pass_z = True
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
    layers, files = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeOutputFile")
    files.base_path = str(folder)
    files.format.file_format, files.format.color_depth = "OPEN_EXR", "32"
    files.file_slots.clear()
    for output, slot in (("Depth", "depth"), ("Image", "image")):
        files.file_slots.new(slot)
        tree.links.new(layers.outputs[output], files.inputs[slot])


def take_picture(rng: np.random.Generator, scene, name: Path) -> None:
    """Render; expose for the mean brightness, up to a random factor, and write picture and depth."""
    import bpy
    import cv2

    scene.frame_set(1)
    bpy.ops.render.render(write_still=False)
    depth, light = (
        read_exr(name.with_name("depth0001.exr"))[..., 0],
        read_exr(name.with_name("image0001.exr"))[..., :3],
    )
    brightness = np.exp(np.log(light @ [0.21, 0.72, 0.07] + 1e-3).mean())
    light = np.clip(light * 0.35 / brightness * rng.uniform(0.7, 1.3), 0, None)
    light = light * (1 + light / 9) / (1 + light)  # Reinhard's curve, white at 3
    picture = (np.clip(light, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)
    cv2.imwrite(f"{name}.jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
    known = (depth > 0.05) & (depth < 30)
    cv2.imwrite(f"{name}.png", np.where(known, depth * 1000, 0).round().astype(np.uint16))


def read_exr(path: Path) -> np.ndarray:
    """Return the channels of a file ``(H, W, C)`` as floats, colors as RGB, and delete it."""
    import OpenEXR

    channels = OpenEXR.File(str(path)).channels()
    path.unlink()
    if together := channels.get("RGBA") or channels.get("RGB"):
        return np.array(together.pixels, dtype=np.float32)
    order = [name for name in "RGB" if name in channels] or sorted(channels)
    return np.stack([np.array(channels[name].pixels, dtype=np.float32) for name in order], -1)


if __name__ == "__main__":
    main()

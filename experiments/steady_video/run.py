"""Measure how steady the depth of a video is, with the filter and without.

python experiments/steady_video/run.py [weights ...]

Walks through rendered rooms have known depth and poses. So each still point of a frame is found in the next
one, and whatever changes between its predicted and its true depth is flicker.
"""

import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from eldenet.system.resources import prepare_environment

prepare_environment()

import cv2  # noqa: E402
import numpy as np  # noqa: E402

import eldenet  # noqa: E402
from eldenet.deploy.steady import SteadyFilter  # noqa: E402
from eldenet.geometry import back_project, resize_image  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.simulation.furnished_rooms.render import Views, choose_pose, draw_intrinsics  # noqa: E402
from eldenet.simulation.furnished_rooms.rooms import SPLITS, generate_room  # noqa: E402
from eldenet.simulation.rendering.camera import RayCamera, camera_rotation  # noqa: E402
from eldenet.simulation.rendering.camera_noise import develop  # noqa: E402
from eldenet.simulation.rendering.mjcf import Draw  # noqa: E402
from eldenet.simulation.rendering.shading import CompiledRoom  # noqa: E402
from eldenet.system.timing import median_ms, time_interleaved  # noqa: E402

HERE = Path(__file__).parent
FRAMES = 45
WALKS = 24  # rooms of the split "test"; the filter's constants were chosen on 16 walks of "val"
MODELS = ("eldenet_rooms", "eldenet_indoor", "eldenet_l_indoor")
SAME_SURFACE = 0.02  # relative difference in depth up to which a point is the one that was seen before
FRAMES_PER_SECOND = 15
CLEARANCE = 0.5  # [m] kept to whatever is ahead


class Walk(NamedTuple):
    """Figures of one walk.

    Attributes:
        flicker: mean over still points of the change of ``log(predicted / true)`` from frame to frame.
        abs_rel: mean over all pixels.
        approach: median change of the true log depth of still points, one per frame.
        level: mean log of the predicted depth, one per frame.
    """

    flicker: float
    abs_rel: float
    approach: np.ndarray
    level: np.ndarray


def render_walk(split: str, index: int, size: tuple[int, int] = (192, 256), frames: int = FRAMES) -> Views:
    """Render a walk through room ``index`` of a split, at 15 frames per second.

    The camera starts as in :func:`~eldenet.simulation.furnished_rooms.render.render_room`. It stands for a
    fifth of the time, then walks at up to 0.8 m/s and turns at up to 30 degrees/s, with the shake of a hand.
    It stops where something is close ahead. Lens, exposure and tone stay the same; the noise of the pixels
    differs from frame to frame.

    Args:
        split: "train", "val" or "test".
        index: of the room.
        size: ``(height, width)`` [px].
        frames: number of frames.
    """
    cv2.setNumThreads(0)
    room = CompiledRoom(generate_room(split, index))
    draw = Draw((SPLITS[split], index, 3))
    camera = RayCamera(size, draw_intrinsics(draw, size))
    start, rotation = choose_pose(room, camera, draw)
    forward = rotation[:, 2]
    yaw, pitch = float(np.arctan2(forward[1], forward[0])), float(np.arcsin(np.clip(forward[2], -1, 1)))
    heading = yaw + draw.uniform(-0.6, 0.6)
    speed, turn = draw.uniform(0.2, 0.8), np.radians(draw.uniform(-30, 30))
    shake = np.random.default_rng((SPLITS[split], index, 4)).normal(size=(frames, 3)) * np.radians(0.25)
    probe_size = (9, 12)
    scale = np.diag([probe_size[1] / size[1], probe_size[0] / size[0], 1.0])
    probe = RayCamera(probe_size, scale @ camera.intrinsics)
    position, pace = start.copy(), 0.0
    views = []
    for number in range(frames):
        wanted = speed if number >= frames // 5 else 0.0
        ahead, _ = probe.probe(room.model, room.data, position, camera_rotation(heading, 0.0))
        wanted = wanted if ahead.min() > CLEARANCE else 0.0
        pace += float(np.clip(wanted - pace, -0.15, 0.1))
        turning = turn if number >= frames // 5 else 0.0
        yaw, heading = yaw + turning / FRAMES_PER_SECOND, heading + turning / FRAMES_PER_SECOND
        position = position + pace / FRAMES_PER_SECOND * np.array([np.cos(heading), np.sin(heading), 0.0])
        pose = camera_rotation(yaw + shake[number, 0], pitch + shake[number, 1], shake[number, 2])
        linear, hits = room.photograph(camera, position, pose)
        # the same draws develop every frame; the noise of the pixels is its own
        image = develop(linear, Draw((SPLITS[split], index, 5)), (SPLITS[split], index, 6, number))
        views.append((image, hits.depth.astype(np.float32).reshape(size), camera.intrinsics, position, pose))
    return Views(*(np.stack(column) for column in zip(*views, strict=True)))


def measure(views: Views, predicted: np.ndarray) -> Walk:
    """Compare predicted depth ``(T, H, W)`` [m] with a walk's."""
    changes, approach = [], []
    for now in range(1, len(predicted)):
        before = now - 1
        places, z, seen = follow(views, before, now)
        depth = cv2.remap(predicted[now], places, None, cv2.INTER_LINEAR)[seen]
        truth = np.log(z[seen] / views.depth[before][seen])
        changes.append(np.abs(np.log(depth / predicted[before][seen]) - truth).mean())
        approach.append(np.median(truth))
    known = views.depth > 0
    abs_rel = (np.abs(predicted - views.depth)[known] / views.depth[known]).mean()
    level = np.log(predicted).mean(axis=(1, 2))[1:]
    return Walk(float(np.mean(changes)), float(abs_rel), np.array(approach), level)


def follow(views: Views, before: int, now: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the points of one frame in another.

    Returns:
        Their places ``(H, W, 2)`` [px], their depth ``(H, W)`` [m], and which are in view ``(H, W)`` bool.
    """
    intrinsics, depth = views.intrinsics[0], views.depth[before]
    points = back_project(depth, intrinsics) @ views.rotation[before].T + views.position[before]
    x, y, z = np.moveaxis((points - views.position[now]) @ views.rotation[now], -1, 0)
    ahead = (depth > 0) & (z > 0.05)
    z = np.where(ahead, z, 1.0)
    u, v = x / z * intrinsics[0, 0] + intrinsics[0, 2], y / z * intrinsics[1, 1] + intrinsics[1, 2]
    places = np.stack([u, v], axis=-1).astype(np.float32)
    rows, columns = depth.shape
    inside = ahead & (u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1)
    found = cv2.remap(views.depth[now], places, None, cv2.INTER_NEAREST)
    return places, z, inside & (np.abs(found - z) < SAME_SURFACE * z)


def compare(model: str) -> list[str]:
    """Return the lines of the table of a network, and the sentence below them."""
    predictor = eldenet.DepthPredictor(eldenet.load(model), steady=False)
    alone, steady = [], []
    for index in range(WALKS):
        views = render_walk("test", index)
        raw = np.stack([predict(predictor, frame, views) for frame in views.image])
        smooth = eldenet.DepthPredictor(predictor.model)
        alone.append(measure(views, raw))
        steady.append(measure(views, np.stack([predict(smooth, frame, views) for frame in views.image])))
    flicker = np.array([[a.flicker, s.flicker] for a, s in zip(alone, steady, strict=True)])
    abs_rel = np.array([[a.abs_rel, s.abs_rel] for a, s in zip(alone, steady, strict=True)])
    approach = np.concatenate([walk.approach for walk in alone])
    behind = np.concatenate([s.level - a.level for a, s in zip(alone, steady, strict=True)])
    lag = -float(approach @ behind) / float(approach @ approach)
    size = predictor.size_for(*views.image.shape[1:3])
    frames = [resize_image(image, size) for image in views.image]
    # the filter skips a frame that is repeated
    film = itertools.cycle([(frame, predictor(frame)) for frame in frames])
    frame, keep_steady = frames[0], SteadyFilter()
    times = time_interleaved(
        {"network": lambda: predictor(frame), "filter": lambda: keep_steady(*next(film))}, rounds=15
    )
    network_ms, filter_ms = (median_ms(times[name]) for name in ("network", "filter"))
    height, width = frame.shape[:2]
    before, after = flicker.mean(axis=0)
    ratios, gains = flicker[:, 1] / flicker[:, 0] - 1, abs_rel[:, 1] - abs_rel[:, 0]
    name = f"`{model}`, {height} x {width}"
    print(f"{model}: flicker {before:.4f} -> {after:.4f}", flush=True)
    return [
        f"| {name}, each frame alone | {before:.4f} | {abs_rel[:, 0].mean():.4f} | 0 | {network_ms:.2f} |",
        f"| {name}, steady | {after:.4f} | {abs_rel[:, 1].mean():.4f} | {lag:.2f} | + {filter_ms:.2f} |",
        f"- `{model}`: the filter changes flicker by {100 * (after / before - 1):.0f} % (in single walks by "
        f"{100 * ratios.min():.0f} to {100 * ratios.max():.0f} %). AbsRel falls in "
        f"{int((gains < 0).sum())} of {WALKS} walks; in the worst it changes by {gains.max():+.4f}.",
    ]


def predict(predictor: eldenet.DepthPredictor, frame: np.ndarray, views: Views) -> np.ndarray:
    """Depth ``(H, W)`` [m] of a frame; a network with a canonical camera is told the walk's lens."""
    if predictor.model.canonical_px is None:
        return predictor(frame)
    return predictor(frame, intrinsics=views.intrinsics[0])


def main(models: Sequence[str]) -> None:
    cv2.setNumThreads(1)
    tables = [compare(model) for model in models]
    where = environment()
    lines = [
        f"{where['hardware']['processor']}, 1 thread, torch {where['versions']['torch']}, {where['date']}; "
        f"{WALKS} walks of {FRAMES} frames through test rooms.",
        "",
        "| depth of a video | flicker | AbsRel | lag [frames] | ms/frame |",
        "|---|---:|---:|---:|---:|",
        *(line for table in tables for line in table[:2]),
        "",
        *(table[2] for table in tables),
        "",
        f"Made by `python experiments/steady_video/run.py {' '.join(models)}`.",
    ]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main(sys.argv[1:] or MODELS)

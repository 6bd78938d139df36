"""Views of NYU's training frames by a camera that has moved towards things and turned.

python experiments/indoor/moved_frames.py $ELDENET_DATA/moved_frames

A frame with depth is a colored surface, and a second camera may look at it: from a tenth to four fifths of
the way to what it looks at, turned by about 14 degrees to a side and 11 up or down, with a lens up to 1.5
times as long. So real things stand at distances that NYU hardly has. What the first camera did not see is
filled in the picture and unknown in the depth; a view of which less than 80 % was seen is drawn anew.

Each frame gets a folder of ``<view>.jpg`` (240 x 320), ``<view>.png`` (planar depth [mm], 16 bits, 0 unknown)
and ``<view>.txt`` (``fx fy cx cy`` [px]), as ``+experiment=moved_frames`` reads them; run it again to resume.
"""

import argparse
import math
from pathlib import Path

import cv2
import numpy as np

from eldenet.data.nyu import NYULabelled
from eldenet.types import Frame

SIZE = (240, 320)  # (height, width) of a view [px]
BORDER = 12  # of NYU's frames, which has no picture [px]
NEAREST = 0.25  # [m]
KNOWN = 0.8  # least share of a view that the frame shows
COARSE = 8  # the quick look at a view has so many times fewer rows and columns
TRIES = 40


def surface(frame: Frame, times: int) -> tuple[np.ndarray, np.ndarray]:
    """Points ``(N, 3)`` [m] and colors ``(N, 3)`` of a frame, ``times`` as dense in both directions."""
    depth = frame.depth
    size = (depth.shape[1] * times, depth.shape[0] * times)
    steps = cv2.dilate(depth, np.ones((3, 3))) > 1.12 * cv2.erode(depth, np.ones((3, 3)))
    fine = cv2.resize(cv2.bilateralFilter(depth, 7, 0.08, 3.0), size, interpolation=cv2.INTER_LINEAR)
    steps = cv2.resize(steps.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    fine = np.where(steps, cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST), fine)
    image = cv2.resize(frame.image, size, interpolation=cv2.INTER_CUBIC)
    (fx, _, cx), (_, fy, cy), _ = frame.intrinsics
    rows, columns = np.mgrid[: size[1], : size[0]]
    x = ((columns + 0.5) / times - 0.5 - cx) / fx * fine
    y = ((rows + 0.5) / times - 0.5 - cy) / fy * fine
    inside = np.s_[BORDER * times : -BORDER * times, BORDER * times : -BORDER * times]
    known = np.zeros(fine.shape, bool)
    known[inside] = fine[inside] > 0
    return np.stack([x, y, fine], -1)[known].astype(np.float32), image[known].astype(np.float32)


def seen(
    points: np.ndarray, colors: np.ndarray, focal: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Picture ``(h, w, 3)`` and depth ``(h, w)`` [m] of points ``(N, 3)`` before a camera; 0: nothing."""
    height, width = size
    ahead = points[:, 2] > 0.05
    points, colors = points[ahead], colors[ahead]
    column = np.floor(points[:, 0] / points[:, 2] * focal + width / 2).astype(np.int64)
    row = np.floor(points[:, 1] / points[:, 2] * focal + height / 2).astype(np.int64)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    place, z, colors = (row * width + column)[inside], points[inside, 2], colors[inside]
    nearest = np.full(height * width, np.inf, np.float32)
    np.minimum.at(nearest, place, z)
    around = cv2.erode(nearest.reshape(size), np.ones((3, 3))).ravel()
    nearest = np.where(around < 0.9 * nearest, around, nearest)  # the background shows through no crack
    front = z <= 1.03 * nearest[place]
    place, z, colors = place[front], z[front], colors[front]
    number = np.bincount(place, minlength=height * width)
    sums = [np.bincount(place, values, height * width) for values in (*colors.T, z)]
    means = np.stack(sums, -1).reshape(height, width, 4) / np.maximum(number, 1).reshape(height, width, 1)
    return means[..., :3], means[..., 3]


def view(frame: Frame, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Picture, depth [m] and focal length [px] of a view of a frame; None: no try shows enough of it."""
    height, width = frame.depth.shape
    (fx, _, cx), (_, fy, cy), _ = frame.intrinsics
    points, colors = surface(frame, 1)
    points, colors = points[::29], colors[::29]
    for _ in range(TRIES):
        yaw, pitch, roll = generator.normal(0, np.radians([14, 11, 2]))
        focal = fx / width * SIZE[1] * math.exp(generator.uniform(0, math.log(1.5)))
        way = generator.uniform(0.1, 0.8)
        rotation = cv2.Rodrigues(np.array([0, 0, roll]))[0] @ cv2.Rodrigues(np.array([pitch, 0, 0]))[0]
        rotation = rotation @ cv2.Rodrigues(np.array([0, yaw, 0]))[0]
        aim = rotation[2] / rotation[2, 2]
        column, row = int(fx * aim[0] + cx), int(fy * aim[1] + cy)
        if not (BORDER < column < width - BORDER and BORDER < row < height - BORDER):
            continue
        beside = width // 16
        patch = frame.depth[max(0, row - beside) : row + beside, max(0, column - beside) : column + beside]
        if not (patch > 0).all():
            continue
        center = aim * way * np.percentile(patch, 20) + generator.normal(0, 0.04, 3) * np.median(patch)
        coarse = (SIZE[0] // COARSE, SIZE[1] // COARSE)
        quick = seen((points - center) @ rotation.T, colors, focal / COARSE, coarse)[1]
        if (quick > 0).mean() < KNOWN or quick[quick > 0].min() < NEAREST:
            continue
        # pixels of the view per pixel of the frame
        magnified = focal / np.median(quick[quick > 0]) * np.median(frame.depth[frame.depth > 0]) / fx
        dense, dense_colors = surface(frame, 3 if magnified > 1.4 else 2 if magnified > 0.6 else 1)
        picture, depth = seen((dense - center) @ rotation.T, dense_colors, focal, SIZE)
        if (depth > 0).mean() < KNOWN:
            continue
        picture = picture.clip(0, 255).astype(np.uint8)
        picture = cv2.inpaint(picture, (depth == 0).astype(np.uint8), 3, cv2.INPAINT_NS)
        return picture, np.where(depth < NEAREST, 0, depth), focal
    return None


def main() -> None:
    """Write the views that are missing."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("folder", type=Path)
    options.add_argument("--views", type=int, default=4, help="of a frame")
    options.add_argument("--part", default="0/1", help="K/N: one of N parts, each for a process of its own")
    args = options.parse_args()
    cv2.setNumThreads(1)
    frames = NYULabelled(split="train", min_depth=0.1, max_depth=10.0)
    first, parts = map(int, args.part.split("/"))
    for index in range(first, len(frames), parts):
        frame = frames.load_frame(index)
        folder = args.folder / Path(frame.name).stem
        folder.mkdir(parents=True, exist_ok=True)
        for number in range(args.views):
            if (folder / f"{number}.txt").exists():
                continue
            made = view(frame, np.random.default_rng((index, number)))
            if made is None:
                continue
            picture, depth, focal = made
            cv2.imwrite(str(folder / f"{number}.jpg"), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
            cv2.imwrite(str(folder / f"{number}.png"), (depth * 1000).round().astype(np.uint16))
            (folder / f"{number}.txt").write_text(f"{focal} {focal} {SIZE[1] / 2} {SIZE[0] / 2}\n")
        print(f"\r{index + 1} of {len(frames)} frames", end="", flush=True)


if __name__ == "__main__":
    main()

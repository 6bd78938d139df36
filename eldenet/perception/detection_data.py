"""Rendered scenes as a data set for a YOLO trainer: pictures, one text file of boxes each, ``data.yaml``."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from eldenet.boxes import Detections2D
from eldenet.data.io import read_image
from eldenet.geometry import from_corner, to_corner
from eldenet.simulation.street_views import KINDS, NAMES, render_objects
from eldenet.visualization import write_picture

PICTURES, BOXES, SETTINGS = "images", "labels", "settings.json"


def write_dataset(
    folder: Path,
    counts: Mapping[str, int],
    size: tuple[int, int],
    *,
    kinds: Sequence[str] = KINDS,
    advance: Callable[[int], None] | None = None,
) -> Path:
    """Render ``counts[split]`` pictures of each split and write them below ``folder``; returns ``data.yaml``.

    Kinds take turns. Pictures that are there already are left as they are, so a killed run goes on.

    Args:
        folder: ``images/<split>/*.png``, ``labels/<split>/*.txt`` (class, then middle and size of the box as
            shares of the picture).
        counts: by split of the simulator: "train", "val", "test".
        size: ``(height, width)`` [px].
        kinds: of scenes, see :data:`eldenet.simulation.street_views.KINDS`.
        advance: called with the number of pictures that came to be.

    Raises:
        ValueError: no pictures, unknown kinds, or the folder holds pictures of other settings.
    """
    if not kinds or not set(kinds) <= set(KINDS):
        raise ValueError(f"kinds={list(kinds)}: give some of {list(KINDS)}")
    if any(count < 1 for count in counts.values()):
        raise ValueError(f"counts={dict(counts)}: every split needs a picture or more")
    settings = {"size": list(size), "kinds": list(kinds), "names": list(NAMES)}
    held = folder / SETTINGS
    if held.is_file() and json.loads(held.read_text()) != settings:
        raise ValueError(
            f"{folder} holds pictures of other settings ({held.read_text()}): give another folder"
        )
    folder.mkdir(parents=True, exist_ok=True)
    held.write_text(json.dumps(settings))
    for split, count in counts.items():
        for number in range(count):
            picture = folder / PICTURES / split / f"{number:06d}.png"
            if not picture.is_file():
                kind = kinds[number % len(kinds)]
                view = render_objects(split, number // len(kinds), size, kind)
                _write_boxes(folder / BOXES / split / f"{number:06d}.txt", view.detections, size)
                write_picture(picture, view.image)  # last: where it is, its boxes are too
            if advance is not None:
                advance(1)
    lines = [f"path: {json.dumps(str(folder.resolve()))}"]
    lines += [f"{split}: {PICTURES}/{split}" for split in counts]
    lines += ["names:", *(f"  {number}: {name}" for number, name in enumerate(NAMES))]
    (folder / "data.yaml").write_text("\n".join(lines) + "\n")
    return folder / "data.yaml"


def read_split(folder: Path, split: str, count: int) -> list[tuple[np.ndarray, Detections2D]]:
    """The first ``count`` pictures ``(H, W, 3)`` uint8 of a split with their boxes."""
    pairs = []
    for number in range(count):
        image = read_image(folder / PICTURES / split / f"{number:06d}.png")
        text = (folder / BOXES / split / f"{number:06d}.txt").read_text()
        pairs.append((image, _read_boxes(text, image.shape[:2])))
    return pairs


def _write_boxes(path: Path, found: Detections2D, size: tuple[int, int]) -> None:
    sides = np.array([size[1], size[0]], float)
    xyxy = to_corner(found.xyxy)
    middle, extent = (xyxy[:, :2] + xyxy[:, 2:]) / 2 / sides, (xyxy[:, 2:] - xyxy[:, :2]) / sides
    lines = [
        f"{label} {x:.6f} {y:.6f} {width:.6f} {height:.6f}\n"
        for label, (x, y), (width, height) in zip(found.label, middle, extent, strict=True)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("".join(lines))


def _read_boxes(text: str, size: tuple[int, int]) -> Detections2D:
    table = np.array([line.split() for line in text.splitlines()], float).reshape(-1, 5)
    sides = np.array([size[1], size[0]], float)
    middle, extent = table[:, 1:3] * sides, table[:, 3:] * sides
    xyxy = from_corner(np.concatenate([middle - extent / 2, middle + extent / 2], axis=1))
    return Detections2D(xyxy, np.ones(len(table)), table[:, 0].astype(np.int64), NAMES)

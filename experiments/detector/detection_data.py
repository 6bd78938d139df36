"""Rendered scenes as a data set in YOLO's layout: images, a text file of boxes for each, ``data.yaml``."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from object_views import names_of, render_objects

from eldenet.boxes import Detections2D
from eldenet.data.arenas import Arenas
from eldenet.data.io import read_image
from eldenet.geometry import from_corner, to_corner
from eldenet.simulation.street_views import STREETS_VERSION
from eldenet.system.errors import reading
from eldenet.system.files import read_json, read_text, write_text
from eldenet.visualization import write_picture

PICTURES, BOXES, SETTINGS = "images", "labels", "settings.json"


def write_dataset(
    folder: Path,
    counts: Mapping[str, int],
    size: tuple[int, int],
    *,
    kinds: Sequence[str],
    focal: tuple[float, float] | None = None,
    advance: Callable[[int], None] | None = None,
) -> Path:
    """Render ``counts[split]`` images of each split into ``folder``; return the path of ``data.yaml``.

    The kinds of scenes alternate. Existing images are kept, so a killed run continues.

    Args:
        folder: gets ``images/<split>/*.png`` and ``labels/<split>/*.txt`` (class, then center and size of the
            box as shares of the image).
        counts: by split of the simulator: "train", "val", "test".
        size: ``(height, width)`` [px].
        kinds: of scenes, see :data:`object_views.OBJECTS`.
        focal: range of fx [widths], of which each image draws its own; None: the lens of its kind.
        advance: called with the number of new images.

    Raises:
        ValueError: no images, unknown kinds, an impossible lens, or a folder of images of other settings.
    """
    names = names_of(kinds)
    if min(counts.values()) < 1:
        raise ValueError(f"counts={dict(counts)}: give every split at least one image")
    if focal is not None and (len(focal) != 2 or not 0.2 <= focal[0] <= focal[1] <= 5):
        raise ValueError(f"focal={list(focal)}: give [low, high] in widths, from 0.2 to 5")
    settings = {"size": list(size), "kinds": list(kinds), "names": list(names)}
    settings |= {"frames": scene_versions(kinds)}
    settings |= {} if focal is None else {"focal": list(focal)}
    stored = folder / SETTINGS
    if stored.is_file() and read_json(stored) != settings:
        raise ValueError(
            f"{folder} holds images made with other settings ({stored.read_text()}): give another folder"
        )
    folder.mkdir(parents=True, exist_ok=True)
    write_text(stored, json.dumps(settings))
    for split, count in counts.items():
        for number in range(count):
            picture = folder / PICTURES / split / f"{number:06d}.png"
            if not picture.is_file():
                kind = kinds[number % len(kinds)]
                view = render_objects(split, number // len(kinds), size, kind, focal=focal)
                boxes = folder / BOXES / split / f"{number:06d}.txt"
                _write_boxes(boxes, view.detections, names, size)
                write_picture(picture, view.image)  # last: an image is only there with its boxes
            if advance is not None:
                advance(1)
    lines = [f"path: {json.dumps(str(folder.resolve()))}"]
    lines += [f"{split}: {PICTURES}/{split}" for split in counts]
    lines += ["names:", *(f"  {number}: {name}" for number, name in enumerate(names))]
    write_text(folder / "data.yaml", "\n".join(lines) + "\n")
    return folder / "data.yaml"


def scene_versions(kinds: Sequence[str]) -> str:
    """Return the generators of these kinds of scenes with their versions, as "streets-v2, arenas-v3"."""
    found = [f"streets-v{STREETS_VERSION}"] if set(kinds) - {"arena"} else []
    found += [f"arenas-v{Arenas.generator.version}"] if "arena" in kinds else []
    return ", ".join(found)


def read_split(folder: Path, split: str, count: int) -> list[tuple[np.ndarray, Detections2D]]:
    """The first ``count`` images ``(H, W, 3)`` uint8 of a split with their boxes."""
    names = tuple(read_json(folder / SETTINGS)["names"])
    pairs = []
    for number in range(count):
        image = read_image(folder / PICTURES / split / f"{number:06d}.png")
        boxes = folder / BOXES / split / f"{number:06d}.txt"
        text = read_text(boxes)
        with reading(boxes, "list of boxes"):
            table = np.array(text.split(), float).reshape(-1, 5)
            if not np.isfinite(table).all() or not np.isin(table[:, 0], np.arange(len(names))).all():
                raise ValueError(f"classes are 0 to {len(names) - 1}, numbers are finite")
        sides = np.array(image.shape[1::-1])
        center, half = table[:, 1:3] * sides, table[:, 3:] * sides / 2
        xyxy = from_corner(np.concatenate([center - half, center + half], axis=1))
        pairs.append((image, Detections2D(xyxy, np.ones(len(table)), table[:, 0].astype(np.int64), names)))
    return pairs


def _write_boxes(path: Path, found: Detections2D, names: Sequence[str], size: tuple[int, int]) -> None:
    sides = np.array([size[1], size[0]], float)
    xyxy = to_corner(found.xyxy)
    center, extent = (xyxy[:, :2] + xyxy[:, 2:]) / 2 / sides, (xyxy[:, 2:] - xyxy[:, :2]) / sides
    label = [names.index(name) for name in found.classes]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, np.column_stack([label, center, extent]), fmt="%d" + 4 * " %.6f")

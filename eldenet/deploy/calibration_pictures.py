"""Pictures that check an exported file and give int8 its scales."""

from pathlib import Path

import numpy as np

from eldenet.data.io import IMAGE_ENDINGS, read_image
from eldenet.data.paths import with_endings
from eldenet.data.splits import evenly_spaced


def read_pictures(source: str | None, count: int, split: str) -> list[np.ndarray]:
    """Up to ``count`` pictures ``(H, W, 3)`` uint8 RGB, evenly spread over a folder or a pattern.

    Without a source they are frames of the built-in rooms.

    Raises:
        ValueError: the source holds no pictures.
    """
    if source is None:
        from eldenet.data.rooms import Rooms

        rooms = Rooms(split, frames=count)
        return [rooms.load_frame(index).image for index in range(len(rooms))]
    folder = Path(source).expanduser()
    paths = sorted(folder.iterdir() if folder.is_dir() else folder.parent.glob(folder.name))
    paths = with_endings(paths, IMAGE_ENDINGS, folder)
    if not paths:
        raise ValueError(
            f"pictures={source} holds no pictures: give a folder, or a pattern such as 'photos/*.jpg'"
        )
    return [read_image(paths[index], upright=True) for index in evenly_spaced(len(paths), count)]

"""Draws rooms, streets and arenas as they are and with ``detail``, side by side.

``python experiments/renders/picture.py docs/images/renders_detail.jpg`` takes the first view of the first
test scenes of each; nothing is chosen.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from eldenet.simulation.arena_view import render_arena
from eldenet.simulation.furnished_rooms.render import render_room
from eldenet.simulation.street_views import render_streets
from eldenet.visualization import contact_sheet

RENDERERS = {
    "rooms": (render_room, (180, 240), 4),
    "streets": (render_streets, (96, 320), 3),
    "arenas": (render_arena, (180, 240), 4),
}


def main(path: str) -> None:
    """Draw the picture to ``path``."""
    panels = []
    for name, (render, size, count) in RENDERERS.items():
        for detail in (False, True):
            views = [render("test", index, size, 1, detail=detail).image[0] for index in range(count)]
            picture = np.concatenate(views, axis=1)
            shape = (960, 960 * picture.shape[0] // picture.shape[1])
            panels.append((f"{name}, detail={str(detail).lower()}", cv2.resize(picture, shape)))
    sheet = contact_sheet(panels, 1)
    Path(path).write_bytes(
        cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()
    )


if __name__ == "__main__":
    main(sys.argv[1])

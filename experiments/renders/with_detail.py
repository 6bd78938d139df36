"""Rooms, streets and arenas as they are and with ``detail``: what they cost, and a picture of them.

``python experiments/renders/with_detail.py`` prints images per second of CPU time, so that a busy machine
matters less. With a path, such as ``docs/images/renders_detail.jpg``, it draws the first view of the first
test scenes side by side; nothing is chosen.
"""

import sys
import time
from pathlib import Path

import cv2
import numpy as np

from eldenet.results.tables import to_markdown
from eldenet.simulation.arena_view import render_arena
from eldenet.simulation.furnished_rooms.render import render_room
from eldenet.simulation.street_views import render_streets
from eldenet.visualization import contact_sheet

#: Kind -> renderer, size that is timed, size that is drawn, scenes that are drawn.
RENDERERS = {
    "rooms": (render_room, (96, 128), (180, 240), 4),
    "streets": (render_streets, (96, 320), (96, 320), 3),
    "arenas": (render_arena, (96, 128), (180, 240), 4),
}
SCENES, VIEWS = 8, 8


def measure() -> None:
    """Time all of them, scene by scene in turns, and print a table."""
    rows = []
    for name, (render, size, *_) in RENDERERS.items():
        seconds = {False: 0.0, True: 0.0}
        for index in range(-1, SCENES):  # the first one warms up
            for detail in seconds:
                start = time.process_time()
                render("train", max(0, index), size, VIEWS, detail=detail)
                seconds[detail] += (time.process_time() - start) * (index >= 0)
        plain, detailed = (SCENES * VIEWS / spent for spent in seconds.values())
        rows.append([name, f"{size[0]}x{size[1]}", f"{plain:.0f}", f"{detailed:.0f}"])
    print(to_markdown(("data", "size", "images per CPU second", "with detail"), rows, []))


def draw(path: str) -> None:
    """Draw the picture to ``path``."""
    panels = []
    for name, (render, _, size, count) in RENDERERS.items():
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
    if sys.argv[1:]:
        draw(sys.argv[1])
    else:
        measure()

"""Images per second of CPU time, without and with ``detail``.

``python experiments/renders/speed.py`` prints a table. CPU time, so that a busy machine matters less.
"""

import time

from eldenet.results.tables import to_markdown
from eldenet.simulation.arena_view import render_arena
from eldenet.simulation.furnished_rooms.render import render_room
from eldenet.simulation.street_views import render_streets

RENDERERS = {
    "rooms": (render_room, (96, 128)),
    "streets": (render_streets, (96, 320)),
    "arenas": (render_arena, (96, 128)),
}
SCENES, VIEWS = 8, 8


def main() -> None:
    """Measure all of them, scene by scene in turns."""
    rows = []
    for name, (render, size) in RENDERERS.items():
        seconds = {False: 0.0, True: 0.0}
        for index in range(-1, SCENES):  # the first one warms up
            for detail in seconds:
                start = time.process_time()
                render("train", max(0, index), size, VIEWS, detail=detail)
                seconds[detail] += (time.process_time() - start) * (index >= 0)
        plain, detailed = (SCENES * VIEWS / spent for spent in seconds.values())
        rows.append([name, f"{size[0]}x{size[1]}", f"{plain:.0f}", f"{detailed:.0f}"])
    print(to_markdown(("data", "size", "images per CPU second", "with detail"), rows, []))


if __name__ == "__main__":
    main()

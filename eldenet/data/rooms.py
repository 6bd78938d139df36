"""``rooms``: furnished rooms rendered with rays, the data set that needs no download."""

from eldenet.data.rendered import RenderedScenes
from eldenet.data.rendering import Generator


class Rooms(RenderedScenes):
    """Furnished rooms, from the height of a robot or a hand; the splits hold different rooms."""

    generator = Generator(
        "rooms", 1, "eldenet.simulation.furnished_rooms.render.render_room", {(96, 128): "fd67c9271919"}
    )

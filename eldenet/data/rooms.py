"""``rooms``: furnished rooms rendered with rays, the data set that needs no download."""

from eldenet.data.rendered_scenes import RenderedScenes
from eldenet.data.scene_store import Generator


class Rooms(RenderedScenes):
    """Furnished rooms, from the height of a robot or a hand; the splits hold different rooms.

    Frames have 128 x 160 px unless given, and focal lengths of about the Kinect's, 0.76 to 0.88 widths. With
    ``detail``, rooms are as people photograph them: natural colors, more things, light that bounces, shade
    where things touch.
    """

    generator = Generator(
        "rooms", 1, "eldenet.simulation.furnished_rooms.render.render_room", {(96, 128): "fd67c9271919"}
    )
    detailed = generator._replace(digests={}, options={"detail": True})

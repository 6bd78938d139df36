"""``rooms``: furnished rooms rendered with rays, the data set that needs no download."""

from eldenet.data.rendered import RenderedScenes
from eldenet.data.rendering import Generator


class Rooms(RenderedScenes):
    """Furnished rooms, from the height of a robot or a hand; the splits hold different rooms.

    Args:
        size: ``(height, width)`` of the rendered frames [px]; None: 128 x 160.
        focal: range of focal lengths [widths]; None: about the Kinect's, 0.76 to 0.88.
        detail: rooms as people photograph them: natural colors, more things, light that bounces, shade where
            things touch.
        near: share of frames of what is close: half of their pixels within 0.3 to 1.2 m.
        down: share of frames that look down at the floor and what stands on it.
        plain: share of rooms whose surfaces have no pattern.
        **options: see :class:`~eldenet.data.rendered.RenderedScenes`.
    """

    generator = Generator(
        "rooms", 1, "eldenet.simulation.furnished_rooms.render.render_room", {(96, 128): "fd67c9271919"}
    )
    detailed = generator._replace(digests={}, detail=True)

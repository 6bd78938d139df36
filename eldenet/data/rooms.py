"""``rooms``: furnished rooms rendered with rays, the data set that needs no download."""

from eldenet.data.rendered import RenderedScenes
from eldenet.data.shards import Generator

#: Of the light, the surfaces and the camera, which every rendered data set shares.
LOOKS = tuple(
    f"simulation/{name}"
    for name in (
        "camera", "culling", "furniture", "household", "kinds", "materials", "mjcf", "motifs", "patterns",
        "render", "rooms", "seating", "sensor", "shading", "textures", "walls", "weights",
    )
)  # fmt: skip


class Rooms(RenderedScenes):
    """Furnished rooms, seen as a robot or a hand would hold the camera; the splits hold different rooms."""

    generator = Generator("rooms", 1, "eldenet.simulation.render.render_room", LOOKS)

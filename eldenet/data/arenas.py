"""``arenas``: the view of the navigating robot's camera, rendered with rays; needs no download."""

from eldenet.data.rendered_scenes import RenderedScenes
from eldenet.data.scene_store import Generator


class Arenas(RenderedScenes):
    """Arenas with 0 to 80 obstacles and walking people, in dim to bright light, as the robot sees them.

    The camera is level, 0.4 m above the floor, with a field of view of 69.4 degrees. Train, val and test
    hold different arenas, all of navigation's training stream; drivers are evaluated on other arenas. With
    ``detail`` obstacles are furniture and people of the same footprints, with doors, windows and cables.
    """

    any_lens = False
    generator = Generator(
        "arenas", 1, "eldenet.simulation.arena_view.render_arena", {(96, 128): "0223d0934865"}
    )
    detailed = generator._replace(digests={}, options={"detail": True})

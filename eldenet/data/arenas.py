"""``arenas``: what the navigating robot's camera sees, rendered with rays; needs no download either."""

from eldenet.data.rendered import RenderedScenes
from eldenet.data.rendering import Generator


class Arenas(RenderedScenes):
    """Arenas with 0 to 80 obstacles and walking people, from dim to bright light, by the robot's camera.

    The camera is level, 0.4 m above the floor, with a field of view of 69.4 degrees. Train, val and test
    hold different arenas, all of navigation's training stream: drivers are chosen and reported on others.
    """

    generator = Generator(
        "arenas", 1, "eldenet.simulation.arena_frames.render_arena", {(96, 128): "0223d0934865"}
    )

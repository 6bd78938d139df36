"""``streets``: rendered streets as a car's camera sees them; needs no download."""

from eldenet.data.rendered_scenes import RenderedScenes
from eldenet.data.scene_store import Generator


class Streets(RenderedScenes):
    """Streets with vehicles, people and houses, from the height of a car's roof; the sky has no depth.

    Every frame is a different street: frame ``i`` is street ``i`` of
    :func:`~eldenet.simulation.street_views.render_street`. Depth range 1 to 80 m unless given, frames of
    96 x 320 px and KITTI's focal length, 0.58 widths. With ``detail``, streets have sidewalks, trees, poles,
    signs, house fronts, clouds and shadows.
    """

    depth_range = (1.0, 80.0)
    default_size = (96, 320)
    generator = Generator(
        "streets", 1, "eldenet.simulation.street_views.render_streets", {}, depth_step=0.002
    )
    detailed = generator._replace(options={"detail": True})

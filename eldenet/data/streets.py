"""``streets``: rendered streets as a car's camera sees them; needs no download."""

from eldenet.data.rendered import RenderedScenes
from eldenet.data.rendering import Generator


class Streets(RenderedScenes):
    """Streets with vehicles, people and houses, from the height of a car's roof; the sky has no depth.

    Every frame is a different street: frame ``i`` is street ``i`` of
    :func:`~eldenet.simulation.street_views.render_street`. Depth range 1 to 80 m unless given.

    Args:
        size: ``(height, width)`` of the rendered frames [px]; None: 96 x 320.
        focal: range of focal lengths [widths]; None: KITTI's, 0.58.
        detail: streets with sidewalks, trees, poles, signs, house fronts, clouds and shadows.
        **options: see :class:`~eldenet.data.rendered.RenderedScenes`.
    """

    depth_range = (1.0, 80.0)
    default_size = (96, 320)
    generator = Generator(
        "streets", 1, "eldenet.simulation.street_views.render_streets", {}, depth_step=0.002
    )
    detailed = generator._replace(detail=True)

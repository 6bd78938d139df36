"""``streets``: rendered streets as a car's camera sees them; needs no download."""

import os
from collections.abc import Sequence
from typing import Unpack

from eldenet.data.base import SampleOptions
from eldenet.data.rendered import RenderedScenes
from eldenet.data.rendering import Generator


class Streets(RenderedScenes):
    """Streets with vehicles, people and houses, from the height of a car's roof; the sky has no depth.

    Every frame is a different street: frame ``i`` is street ``i`` of
    :func:`~eldenet.simulation.street_views.render_street`. Depth range 1 to 80 m unless given.

    Args:
        split: "train", "val" or "test".
        frames: how many frames of the split to use.
        size: ``(height, width)`` of the rendered frames [px].
        root: folder for rendered frames, see :class:`~eldenet.data.rendered.RenderedScenes`.
        workers: processes that render, see there.
        focal: range of focal lengths [widths], such as ``[0.4, 2.0]`` for a network that shall know any lens;
            None: KITTI's, 0.58.
        detail: streets with sidewalks, trees, poles, signs, house fronts, clouds and shadows.
        depth_camera: depth as a stereo depth camera measures it, see there.
        **options: see :class:`~eldenet.data.base.DepthDataset`.

    Raises:
        ValueError: an argument is out of its range.
    """

    depth_range = (1.0, 80.0)
    generator = Generator(
        "streets", 1, "eldenet.simulation.street_views.render_streets", {}, depth_step=0.002
    )
    detailed = generator._replace(detail=True)

    def __init__(
        self,
        split: str = "train",
        frames: int = 2048,
        *,
        size: Sequence[int] = (96, 320),
        root: str | os.PathLike[str] | None = None,
        workers: int | None = None,
        focal: Sequence[float] | None = None,
        detail: bool = False,
        depth_camera: bool = False,
        **options: Unpack[SampleOptions],
    ) -> None:
        self.generator = self.generator.with_focal(focal)
        super().__init__(
            split,
            frames,
            size=size,
            root=root,
            workers=workers,
            detail=detail,
            depth_camera=depth_camera,
            **options,
        )

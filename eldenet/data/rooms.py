"""``rooms``: furnished rooms rendered with rays, the data set that needs no download."""

import os
from collections.abc import Sequence
from typing import Unpack

from eldenet.data.base import SampleOptions
from eldenet.data.rendered import RenderedScenes
from eldenet.data.rendering import Generator


class Rooms(RenderedScenes):
    """Furnished rooms, from the height of a robot or a hand; the splits hold different rooms.

    Args:
        split: "train", "val" or "test".
        frames: how many frames of the split to use.
        size: ``(height, width)`` of the rendered frames [px].
        root: folder for rendered frames, see :class:`~eldenet.data.rendered.RenderedScenes`.
        workers: processes that render, see there.
        focal: range of focal lengths [widths], such as ``[0.4, 2.0]`` for a network that shall know any lens;
            None: about the Kinect's, 0.76 to 0.88.
        detail: rooms as people photograph them: natural colors, more things, light that bounces, shade where
            things touch.
        depth_camera: depth as a stereo depth camera measures it, see there.
        **options: see :class:`~eldenet.data.base.DepthDataset`.

    Raises:
        ValueError: an argument is out of its range.
    """

    generator = Generator(
        "rooms", 1, "eldenet.simulation.furnished_rooms.render.render_room", {(96, 128): "fd67c9271919"}
    )
    detailed = generator._replace(digests={}, detail=True)

    def __init__(
        self,
        split: str = "train",
        frames: int = 2048,
        *,
        size: Sequence[int] = (128, 160),
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

"""Results of ``python -m eldenet.predict boxes=true``: images with 3D boxes, and KITTI result files."""

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from eldenet.deploy.video_files import in_time, open_video
from eldenet.geometry import PinholeCamera
from eldenet.perception.drawing import bev_reach
from eldenet.perception.size_check import SizeCheck
from eldenet.visualization import write_picture

if TYPE_CHECKING:
    from eldenet.deploy.outputs import Results
    from eldenet.perception.scene import Perception
    from eldenet.results.run_log import RunLog

MIN_INTERVAL = 1e-3  # [s] between two frames
MAX_TIMES = 10_000  # images whose times are kept: a camera may run for days
REACH_FRAMES = 10.0  # frames in which the bird's-eye view of a video approaches the reach it needs


@contextmanager
def box_results(
    perception: "Perception",
    results: "Results",
    names: Sequence[str],
    log: "RunLog",
    depth_seconds: Collection[float] = (),
    max_depth: float | None = None,
    *,
    is_video: bool = False,
    check_sizes: bool = True,
) -> Iterator[Callable[[str, np.ndarray, Any, float | None, PinholeCamera | None], None]]:
    """Yield a function that writes the boxes of an image: ``(name, image, depth, time, camera)``.

    An image gets ``<name>_boxes.png`` and ``<name>_boxes.txt``; a video gets ``<name>_boxes.mp4`` and a text
    file per frame. Where the depth has a sigma, ``<name>_distances.csv`` has the interval of each distance.
    At the end, the log shows the median time of each stage after the first image, and a note if depth and
    sizes contradict each other (:class:`~eldenet.perception.size_check.SizeCheck`). The times [s] of the
    frames set speeds and how long the video shows each frame, whatever frames were dropped in between.

    Args:
        perception: detector, lifter and, for a video, tracker.
        names: of the images, or of the video.
        depth_seconds: that the depth of each image took; read at the end.
        max_depth: that the network can answer [m]; None: any.
        is_video: the images are frames of a video or a camera.
        check_sizes: whether the boxes come from the depth, which must then fit the sizes.

    Raises:
        ValueError: a result already exists.
    """
    endings = ("_boxes.mp4", "") if is_video else ("_boxes.png", "_boxes.txt")  # "": the folder of its frames
    results.refuse_to_overwrite([], [results.folder / f"{name}{end}" for name in names for end in endings])
    spent: dict[str, deque[float]] = {}
    show: Callable[[np.ndarray, float], None] | None = None
    last: float | None = None
    reach: float | None = None
    sizes = SizeCheck(max_depth)
    found = unsure = 0

    def write(
        name: str, image: np.ndarray, depth: Any, taken: float | None, camera: PinholeCamera | None = None
    ) -> None:
        """Write what is found in ``image (H, W, 3)`` uint8 RGB."""
        nonlocal show, last, reach, found, unsure
        rate = results.frames_per_second
        interval = 1 / rate if taken is None or last is None else max(taken - last, MIN_INTERVAL)
        last = taken
        scene = perception(image, depth=depth, seconds=interval, camera=camera)
        found, unsure = found + len(scene.boxes), unsure + int(scene.boxes.doubtful.sum())
        sizes.add(scene.depth, scene.detections, scene.camera)
        if results.viewer is not None:
            results.viewer.show_boxes(scene.boxes)
        for stage, seconds in scene.seconds.items():
            spent.setdefault(stage, deque(maxlen=MAX_TIMES)).append(seconds)
        if taken is None:
            write_picture(results.folder / f"{name}_boxes.png", scene.picture())
        else:
            if show is None:  # the rate of a camera is known only now
                film = open_video(results.folder / f"{names[0]}_boxes.mp4", rate)
                show = in_time(stack.enter_context(film), rate)
            needed = bev_reach(scene.boxes, scene.bev_size)
            # the view changes slowly: a grid that jumps cannot be read
            reach = needed if reach is None else max(reach + (needed - reach) / REACH_FRAMES, needed / 2)
            show(scene.picture(reach), taken)
        scene.write_kitti(results.folder / f"{name}_boxes.txt")
        scene.write_intervals(results.folder / f"{name}_distances.csv")

    with ExitStack() as stack:
        yield write
    spent["depth"] = deque(depth_seconds)  # the depth came with each image
    parts = [
        f"{stage} {1000 * float(np.median([*times][1:])):.1f} ms"  # the first one warms up
        for stage, times in spent.items()
        if len(times) > 1 and (stage != "track" or is_video)
    ]
    if parts:
        log.say(f"boxes: median {', '.join(parts)} per picture")
    if unsure:
        why = "their cues disagree, or nothing tells their distance"
        log.say(f"boxes: {unsure} of {found} are doubtful (dashed; occluded is 3): {why}")
    if check_sizes and (line := sizes.warning()):
        log.say(line)

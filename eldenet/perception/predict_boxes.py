"""What ``boxes=true`` adds to ``eldenet.predict``: pictures with 3D boxes, and KITTI result files."""

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from eldenet.deploy.outputs import Results
    from eldenet.perception.scene import Perception
    from eldenet.results.run_log import RunLog

SHORTEST = 1e-3  # [s] between two frames, however fast they were read
REMEMBERED = 10_000  # pictures whose times are kept: a camera may run for days
FOLLOWED = 10.0  # frames in which a video's view from above comes near the reach that it wants

Add = Callable[[str, np.ndarray, np.ndarray, float | None], None]


@contextmanager
def box_results(
    perception: "Perception",
    results: "Results",
    names: Sequence[str],
    log: "RunLog",
    depth_seconds: Collection[float] = (),
    *,
    is_video: bool = False,
) -> Iterator[Add]:
    """Give a function that takes ``(name, photo, depth, time)`` of each picture.

    Pictures become ``<name>_boxes.png`` and ``<name>_boxes.txt``, a video ``<name>_boxes.mp4`` and one text
    file per frame. At the end the time that each stage took is said; ``depth_seconds`` are those that depth
    took, once it is over. Speeds, and how long a video shows a frame, follow from the frames' times [s],
    whatever was dropped between them.

    Raises:
        ValueError: a result is there already.
    """
    from eldenet.deploy.outputs import in_time, open_video
    from eldenet.perception.drawing import bev_reach
    from eldenet.visualization import write_picture

    endings = ("_boxes.mp4", "") if is_video else ("_boxes.png", "_boxes.txt")  # "": the folder of its frames
    results.refuse_to_overwrite([], [results.folder / f"{name}{end}" for name in names for end in endings])
    spent: dict[str, deque[float]] = {}
    with ExitStack() as stack:
        show: Callable[[np.ndarray, float], None] | None = None
        last: float | None = None
        reach: float | None = None

        def add(name: str, photo: np.ndarray, depth: np.ndarray, taken: float | None) -> None:
            nonlocal show, last, reach
            rate = results.frames_per_second
            step = 1 / rate if taken is None or last is None else max(taken - last, SHORTEST)
            last = taken
            scene = perception(photo, depth=depth, seconds=step)
            for stage, seconds in scene.seconds.items():
                spent.setdefault(stage, deque(maxlen=REMEMBERED)).append(seconds)
            if taken is not None:
                if show is None:  # a camera's rate is known by now
                    path = results.folder / f"{names[0]}_boxes.mp4"
                    show = in_time(stack.enter_context(open_video(path, rate)), rate)
                wanted = bev_reach(scene.boxes, scene.bev_size)
                # a video's view from above follows slowly: a grid that jumps can't be read
                reach = wanted if reach is None else max(reach + (wanted - reach) / FOLLOWED, wanted / 2)
                show(scene.picture(reach), taken)
            else:
                path = results.folder / f"{name}_boxes.png"
                write_picture(path, scene.picture())
            scene.write_kitti(results.folder / f"{name}_boxes.txt")

        yield add
    spent["depth"] = deque(depth_seconds)  # it came with each picture
    parts = [
        f"{stage} {1000 * float(np.median(times)):.1f} ms"
        for stage, times in spent.items()
        if times and (stage != "track" or is_video)
    ]
    if parts:
        log.say(f"boxes: median {', '.join(parts)} per picture")

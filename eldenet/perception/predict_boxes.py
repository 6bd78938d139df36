"""What ``boxes=true`` adds to ``eldenet.predict``: pictures with 3D boxes, and KITTI result files."""

import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

import numpy as np

from eldenet import config as cfg

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from eldenet.deploy.outputs import Results
    from eldenet.perception.scene import Perception
    from eldenet.results.run_log import RunLog

SHORTEST = 1e-3  # [s] between two frames, however fast they were read
REMEMBERED = 10_000  # pictures whose times are kept: a camera may run for days
FOLLOWED = 10.0  # frames in which a video's view from above comes near the reach that it wants

Add = Callable[[str, np.ndarray, np.ndarray, float | None], None]


@contextmanager
def box_results(
    config: "DictConfig",
    results: "Results",
    names: Sequence[str],
    log: "RunLog",
    depth_seconds: Collection[float] = (),
    *,
    is_video: bool = False,
) -> Iterator[Add | None]:
    """Give a function that takes ``(name, photo, depth, time)`` of each picture; None without ``boxes=true``.

    Pictures become ``<name>_boxes.png`` and ``<name>_boxes.txt``, a video ``<name>_boxes.mp4`` and one text
    file per frame. At the end the time that each stage took is said; ``depth_seconds`` are those that depth
    took, once it is over. Speeds, and how long a video shows a frame, follow from the frames' times [s],
    whatever was dropped between them.

    Raises:
        ValueError: no intrinsics or no detector were given, or a result is there already.
    """
    from eldenet.deploy.outputs import in_time, open_video
    from eldenet.perception.drawing import bev_reach
    from eldenet.visualization import write_picture

    if not config.boxes:
        yield None
        return
    perception = build_perception(config, results.intrinsics, tracked=is_video)
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
                    film = open_video(path, rate, lambda path: results.note(path, name))
                    show = in_time(stack.enter_context(film), rate)
                wanted = bev_reach(scene.boxes, scene.bev_size)
                # a video's view from above follows slowly: a grid that jumps can't be read
                reach = wanted if reach is None else max(reach + (wanted - reach) / FOLLOWED, wanted / 2)
                show(scene.picture(reach), taken)
            else:
                path = results.folder / f"{name}_boxes.png"
                write_picture(path, scene.picture())
                results.note(path, name)
            path = results.folder / f"{name}_boxes.txt"
            scene.write_kitti(path)
            results.note(path, name)

        yield add
    spent["depth"] = deque(depth_seconds)  # it came with each picture
    parts = [
        f"{stage} {1000 * float(np.median(times)):.1f} ms"
        for stage, times in spent.items()
        if times and (stage != "track" or is_video)
    ]
    if parts:
        log.say(f"boxes: median {', '.join(parts)} per picture")


class Timed:
    """A depth predictor that notes how long each picture took.

    Attributes:
        seconds: of each of the last pictures.
    """

    def __init__(self, predictor: Callable[[np.ndarray], np.ndarray]) -> None:
        self.predictor = predictor
        self.seconds: deque[float] = deque(maxlen=REMEMBERED)

    def __call__(self, frame: np.ndarray) -> np.ndarray:
        """Depth ``(H, W)`` [m] of a frame."""
        start = time.perf_counter()
        depth = self.predictor(frame)
        self.seconds.append(time.perf_counter() - start)
        return depth


def build_perception(config: "DictConfig", intrinsics: np.ndarray | None, *, tracked: bool) -> "Perception":
    """Detector, lifter and tracker of the ``perception`` node.

    Raises:
        ValueError: no intrinsics or no detector were given.
    """
    from eldenet.geometry import PinholeCamera
    from eldenet.perception.scene import Perception

    if intrinsics is None:
        raise ValueError("boxes need intrinsics=[fx,fy,cx,cy] of the source's pictures [px]")
    if config.perception.detector.get("path", "") is None:
        raise ValueError(
            "boxes need a detector: give perception.detector.path=<file>.onnx, see docs/boxes.md"
        )
    detector = cfg.instantiate(config.perception.detector)
    lifter = cfg.instantiate(config.perception.lifter)
    tracker = cfg.instantiate(config.perception.tracker) if tracked else None

    def no_model(frame: np.ndarray) -> np.ndarray:
        raise AssertionError("depth comes with each picture")

    return Perception(no_model, detector, lifter, PinholeCamera(intrinsics), tracker=tracker)

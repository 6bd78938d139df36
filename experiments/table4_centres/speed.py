"""Processor time of lifting boxes and of whole frames, which other work on the machine does not add to."""

import time
from collections.abc import Callable

import numpy as np
from cases import Case, Setting

from eldenet.perception.detectors import Detector
from eldenet.perception.lifter import BoxLifter

COUNTS = (3, 15)  # objects in a picture
_REPEATS = 5


def milliseconds(work: Callable[[], object]) -> float:
    """Return the least processor time of a few calls [ms], all threads together."""
    spent = []
    for _ in range(_REPEATS):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return 1000 * min(spent)


def lifting(setting: Setting, frames: int = 10) -> list[str]:
    """Return a line: time of ``refine`` per object in pictures with few and many objects, ground included."""
    lifter = refine(setting)
    parts = []
    for count in COUNTS:
        cases = [case for case in setting.cases if len(case.detections) >= count][:frames]
        if not cases:
            continue
        times = [
            milliseconds(lambda c=case, n=count: lifter(c.depth, c.detections.select(np.arange(n)), c.camera))
            for case in cases
        ]
        parts.append(
            f"{np.median(times) / count:.1f} ms with {count} objects ({np.median(times):.0f} ms in all)"
        )
    return [f"`refine`, {setting.depth}: per object {', '.join(parts)}"] if parts else []


def stages(setting: Setting, depth_of: Callable[[np.ndarray], np.ndarray], detector: Detector) -> list[str]:
    """Return a line: median times of the stages of whole frames."""
    lifter = refine(setting)

    def spent(case: Case) -> tuple[float, float, float]:
        return (
            milliseconds(lambda: depth_of(case.image)),
            milliseconds(lambda: detector(case.image)),
            milliseconds(lambda: lifter(case.depth, case.detections, case.camera)),
        )

    table = np.array([spent(case) for case in setting.cases[:10]])
    objects = np.median([len(case.detections) for case in setting.cases[:10]])
    depth, detect, lift = np.median(table, axis=0)
    return [
        f"a frame of {setting.depth} ({setting.resolution}; {objects:.0f} objects): depth {depth:.0f} ms, "
        f"detector {detect:.0f} ms, boxes {lift:.0f} ms, in all {np.median(table.sum(1)):.0f} ms"
    ]


def refine(setting: Setting) -> BoxLifter:
    return BoxLifter(camera_height=setting.height, depth_sigma=setting.sigma[0], small_sigma=setting.sigma[1])

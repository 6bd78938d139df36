"""How late the poses of a drive are for its pictures, where the two have different clocks.

While a robot turns, what it sees moves sideways, through any lens in proportion to the turn. The delay at
which both agree best (their correlation) is right to a tenth of a second. Then it is the one at which corners
lie nearest to the lines that the poses give, as in :mod:`eldenet.data.self_calibration`.
"""

from collections.abc import Sequence

import numpy as np

from eldenet.data.drive_poses import DrivePoses
from eldenet.data.self_calibration import LEAST_PAIRS, Pair, fit_error

MOST_DELAY, DELAY_STEP = 3.0, 0.02  # of the first search [s]
LEAST_TURN = 0.05  # standard deviation of a drive's turn rate that tells the delay [rad/s]
LEAST_AGREE = 0.7  # correlation that tells it
OTHER_WAY = 0.05  # a heading of the wrong sign correlates better by so much
FINE_STEPS = np.arange(-5, 6) * 0.05  # of the second search [s]


def find_delay(
    pairs: Sequence[Pair], poses: DrivePoses, intrinsics: np.ndarray, forward: np.ndarray | None
) -> float | None:
    """Return how much later the stamp of a pose is than that of the picture there [s]; None: not told.

    Args:
        pairs: of a drive.
        poses: of the drive.
        intrinsics: ``(3, 3)`` that were told [px].
        forward: as for :func:`~eldenet.data.self_calibration.fit_camera`.

    Raises:
        ValueError: the poses turn the other way than the pictures.
    """
    timed = [pair for pair in pairs if pair.times is not None]
    if poses.seconds is None or len(timed) < LEAST_PAIRS:
        return None
    near = _by_turns(timed, poses)
    if near is None:
        return None
    camera: np.ndarray | None = None
    errors = []
    for step in FINE_STEPS:
        moved = moved_pairs(timed, poses, near + step)
        if len(moved) < LEAST_PAIRS:  # poses too rare to be interpolated
            return None
        error, camera = fit_error(moved, intrinsics, forward, camera)
        errors.append(error)
    best = int(np.argmin(errors))
    if best in (0, len(errors) - 1):
        return None
    before, here, after = errors[best - 1 : best + 2]
    between = (before - after) / (2 * (before - 2 * here + after))  # the lowest point of a parabola
    return float(near + FINE_STEPS[best] + between * (FINE_STEPS[1] - FINE_STEPS[0]))


def moved_pairs(pairs: Sequence[Pair], poses: DrivePoses, delay: float) -> list[Pair]:
    """Return pairs with the motion between poses ``delay`` [s] after their times; none beyond the poses."""
    found = []
    for pair in pairs:
        begin, end = (poses.at(time + delay) for time in pair.times or ())
        if begin is not None and end is not None:
            found.append(pair._replace(motion=np.linalg.inv(end) @ begin))
    return found


def _by_turns(pairs: Sequence[Pair], poses: DrivePoses) -> float | None:
    """The delay [s] at which turns and sideways shifts of corners agree best; None: not told.

    Raises:
        ValueError: the poses turn the other way than the pictures.
    """
    from scipy.spatial.transform import Rotation

    begins, ends = np.array([pair.times for pair in pairs]).T
    shifts = np.array([np.median(pair.there[:, 0] - pair.here[:, 0]) for pair in pairs]) / (ends - begins)
    turns = Rotation.from_matrix(poses.cameras[:, :3, :3])
    to_right = np.append(0.0, np.cumsum((turns[:-1].inv() * turns[1:]).as_rotvec()[:, 1]))  # [rad]
    delays = np.arange(-MOST_DELAY, MOST_DELAY + DELAY_STEP / 2, DELAY_STEP)
    stamps = np.asarray(poses.seconds)
    agree = np.full(len(delays), np.nan)
    for number, delay in enumerate(delays):
        known = (begins + delay >= stamps[0]) & (ends + delay <= stamps[-1])
        before, after = (np.interp(at[known] + delay, stamps, to_right) for at in (begins, ends))
        rates = (after - before) / (ends - begins)[known]
        if known.sum() >= LEAST_PAIRS and rates.std() > LEAST_TURN:
            agree[number] = -np.corrcoef(rates, shifts[known])[0, 1]
    if np.isnan(agree).all():
        return None
    if -np.nanmin(agree) > max(LEAST_AGREE, np.nanmax(agree) + OTHER_WAY):
        raise ValueError(
            f"{poses.path} turns the other way than the pictures: give heading in radians, counter-clockwise"
        )
    best = int(np.nanargmax(agree))
    return float(delays[best]) if agree[best] > LEAST_AGREE else None

"""A map built while driving, from a robot's own ranges and odometry, and A* on it."""

import math
from collections.abc import Sequence

import numpy as np

from eldenet.navigation.planners.paths import shortest_path
from eldenet.simulation.arenas import INFLATION, RESOLUTION
from eldenet.simulation.obstacle import SIDE
from eldenet.simulation.robot import ROBOT, view_of

ENDS, PASSES = 2, -1  # evidence that a scan adds to cells in which rays end, and to those they pass
LEAST_EVIDENCE, MOST_EVIDENCE = -2, 8
SURE = 4  # evidence of a cell that is occupied for sure
BEFORE_END = 0.15  # rays pass no cells so close before their end [m]
TIGHT_COST = 6.0  # of a meter within the full inflation
LEAST_ROOM, NEAR = 0.20, 0.5  # clearance of a way [m]; distance to the robot and to a goal that counts [m]
TIGHT = 0.30  # inflation if no path exists at the full one [m]
_UNDER = np.stack(np.meshgrid(np.arange(-6, 7), np.arange(-6, 7)), axis=-1).reshape(-1, 2) * RESOLUTION / 2
_UNDER = _UNDER[np.hypot(*_UNDER.T) < ROBOT.length / 2]  # points of a disc under the robot, every 5 cm [m]
_MARGIN = 2.0  # around the map: odometry may drift out of the arena [m]


class OnlineMap:
    """Map of one robot: which cells rays ended in, and which they passed through.

    A cell is occupied if its evidence is above 0: a scan whose rays end in it weighs as much as two that pass
    through it. The map's frame is the odometry's, moved so that the first pose is its origin, in the middle.

    Args:
        reach: range up to which readings count [m].
    """

    def __init__(self, reach: float = ROBOT.far) -> None:
        self.reach = reach
        self.side = 2 * SIDE + _MARGIN  # the start is the center, the goal up to a side away
        self.count = round(self.side / RESOLUTION)
        self.evidence = np.zeros((self.count, self.count), np.int8)
        self.seen = np.zeros((self.count, self.count), bool)  # a ray met it, or the robot stood there
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self.evidence[:] = 0
        self.seen[:] = False
        self.origin = np.full(2, np.nan)

    def covers(self, odometry: np.ndarray) -> bool:
        """Whether a pose of the odometry ``(3,)`` is far enough within the map, or the map has no origin."""
        return not (np.abs(odometry[:2] - self.origin) > SIDE).any()

    def place(self, odometry: np.ndarray) -> np.ndarray:
        """Return a pose of the odometry ``(3,)`` in the map's frame."""
        if np.isnan(self.origin[0]):
            self.origin = odometry[:2].copy()
        out = odometry.copy()
        out[:2] -= self.origin
        return out

    def add(self, pose: np.ndarray, ranges: np.ndarray, cautious: np.ndarray | None = None) -> None:
        """Update the evidence: up where rays end, down where they pass.

        Args:
            pose: ``(3,)`` of the robot in the map's frame.
            ranges: ``(columns,)`` [m].
            cautious: how near things may be ``(columns,)`` [m]; no ray passes where it is 0: the camera does
                not see there.
        """
        angles = np.array(view_of(len(ranges)).column_angles) + pose[2]
        camera = pose[:2] + ROBOT.camera_ahead * np.array([np.cos(pose[2]), np.sin(pose[2])])
        rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        grid = self.evidence
        steps = np.arange(0.0, self.reach, RESOLUTION)
        free = ranges if cautious is None else np.where(cautious > 0, ranges, 0.0)
        passed = steps[None, :] < free[:, None] - BEFORE_END
        cells = self.cells(self._inside((camera + steps[None, :, None] * rays[:, None])[passed]))
        grid[cells] = np.maximum(grid[cells] + PASSES, LEAST_EVIDENCE)
        met = steps[None, :] < free[:, None] + RESOLUTION / 2
        self.seen[self.cells(self._inside((camera + steps[None, :, None] * rays[:, None])[met]))] = True
        self.seen[self.cells(self._inside(pose[:2] + _UNDER))] = True
        ends = ranges < self.reach
        cells = self.cells(self._inside(camera + ranges[ends, None] * rays[ends]))
        grid[cells] = np.minimum(np.maximum(grid[cells], 0) + ENDS, MOST_EVIDENCE)

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Those of the points ``(N, 2)`` [m] that lie on the map."""
        return points[(np.abs(points) < self.side / 2).all(axis=1)]

    def cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of points ``(N, 2)`` [m]."""
        numbers = np.clip(((points + self.side / 2) / RESOLUTION).astype(int), 0, self.count - 1)
        return numbers[:, 1], numbers[:, 0]

    def near(self, pose: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Centers of the cells within ``reach`` [m] ``(M, 2)`` [m], and their evidence ``(M,)``."""
        centers, inside, window = self._around(pose, reach)
        return centers[inside], self.evidence[window].ravel()[inside]

    def unseen_near(self, pose: np.ndarray, reach: float) -> np.ndarray:
        """Centers ``(M, 2)`` [m] of cells within ``reach`` that were never seen.

        Cells beside a seen one do not count: a camera may not see them from where the robot came. But beside
        a wall they do, for walls go on.
        """
        import cv2

        centers, inside, window = self._around(pose, reach)
        seen = self.seen[window]
        beside = cv2.dilate(seen.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        walls = cv2.dilate((self.evidence[window] > 0).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
        return centers[inside & ~(seen | (beside & ~walls)).ravel()]

    def _around(self, pose: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, tuple[slice, slice]]:
        """Centers ``(M, 2)`` [m] of cells around, mask of those within ``reach`` [m], their rows, columns."""
        low, high = (
            np.clip((pose[:2] + self.side / 2 + beside) / RESOLUTION, 0, self.count).astype(int)
            for beside in (-reach - 0.2, reach + 0.2)
        )
        rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
        centers = (np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5) * RESOLUTION - self.side / 2
        inside = np.hypot(*(centers - pose[:2]).T) < reach
        return centers, inside, (slice(low[1], high[1]), slice(low[0], high[0]))

    def walls_near(self, pose: np.ndarray, reach: float = 3.0) -> np.ndarray:
        """Centers of occupied cells within ``reach`` ``(M, 2)`` [m]."""
        centers, evidence = self.near(pose, reach)
        return centers[evidence > 0]

    def plan_by_costs(
        self,
        pose: np.ndarray,
        goal: tuple[float, float],
        costs: Sequence[tuple[float, float]],
        points: np.ndarray,
    ) -> np.ndarray | None:
        """Return the path ``(n, 2)`` [m] of least cost; None if there is none. Unseen cells are free.

        Args:
            pose: ``(3,)`` of the robot in the map's frame.
            goal: in that frame [m].
            costs: pairs of a clearance [m] and the cost of a meter with less, by rising clearance.
            points: ``(M, 2)`` [m] that are occupied; so are cells with evidence above 1: a reading that the
                next scan passes does not count.
        """
        import cv2

        taken = self.evidence > 1
        taken[self.cells(points)] = True
        rows, columns = self._window(taken, tuple(pose[:2]), goal)
        free = 1 - taken[rows, columns].astype(np.uint8)
        clearance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * RESOLUTION
        cost = np.ones(free.shape)
        for least, value in reversed(costs):
            cost[clearance < least - 1e-3] = value
        return shortest_path(cost, tuple(pose[:2]), goal, self.side, corner=(rows.start, columns.start))

    def closes(self, pose: np.ndarray, goal: tuple[float, float]) -> bool:
        """Whether what was seen for sure leaves no way from ``pose (3,)`` to the goal [m], or near to it.

        It asks for less room than a plan: what closes a plan may be a wrong reading beside the robot.
        """
        import cv2

        taken = self.evidence >= SURE
        rows, columns = self._window(taken, tuple(pose[:2]), goal)
        free = 1 - taken[rows, columns].astype(np.uint8)
        clearance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * RESOLUTION
        _, regions = cv2.connectedComponents((clearance >= LEAST_ROOM).astype(np.uint8))
        ends = []
        for at in (pose[:2], np.array(goal)):
            row, column = (int(cell[0]) for cell in self.cells(at[None]))
            y, x = np.ogrid[rows, columns]
            near = np.hypot(y - row, x - column) * RESOLUTION < NEAR
            ends.append(set(regions[near].tolist()) - {0})
        return not ends[0] & ends[1]

    def plan(self, pose: np.ndarray, goal: tuple[float, float]) -> np.ndarray | None:
        """Return the cheapest path ``(n, 2)`` [m]; None if there is none.

        Unseen cells are free. Without a path at full inflation, it may pass closer to obstacles.
        """
        taken = self.evidence > 0
        rows, columns = self._window(taken, tuple(pose[:2]), goal)
        taken = taken[rows, columns].astype(np.uint8)
        corner = (rows.start, columns.start)
        too_close, much_too_close = (within(taken, reach) for reach in (INFLATION, TIGHT))
        for close, cost_of_close in ((too_close, np.inf), (much_too_close, TIGHT_COST)):
            cost = np.where(close, np.inf, np.where(too_close, cost_of_close, 1.0))
            path = shortest_path(cost, tuple(pose[:2]), goal, self.side, corner=corner)
            if path is not None:
                return path
        return None

    def _window(
        self, taken: np.ndarray, start: tuple[float, float], goal: tuple[float, float]
    ) -> tuple[slice, slice]:
        """Rows and columns of ``taken (n, n)`` with start, goal, all occupied cells and free cells around.

        No path outside is cheaper: clamped to the window it is no longer, and the border is free.
        """
        (y0, y1), (x0, x1) = self.cells(np.array([start, goal]))
        margin = math.ceil(INFLATION / RESOLUTION) + 1
        out = []
        for used, ends in ((taken.any(axis=1), (y0, y1)), (taken.any(axis=0), (x0, x1))):
            among = [*np.flatnonzero(used)[[0, -1]], *ends] if used.any() else list(ends)
            out.append(slice(max(min(among) - margin, 0), min(max(among) + margin + 1, self.count)))
        return out[0], out[1]


def within(taken: np.ndarray, reach: float) -> np.ndarray:
    """Mask of the cells within ``reach`` [m] of an occupied one, between centers ``(n, m)`` bool."""
    import cv2

    count = math.ceil(reach / RESOLUTION)
    offset = np.arange(-count, count + 1)
    # equal to a distance transform, to the last digit
    disc = np.sqrt(offset[:, None] ** 2 + offset**2) * RESOLUTION < reach
    grown = cv2.dilate(taken, disc.astype(np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(grown > 0)

"""The methods that cross the arenas: learned ones, by their training and their driving, and planners."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA
from eldenet.navigation.planners.dwa import LocalDWA
from eldenet.navigation.planners.plan_and_steer import PlanAndSteer
from eldenet.navigation.planners.straight import Straight


@dataclass(frozen=True)
class Learned:
    """A learned method.

    Attributes:
        options: of ``python -m eldenet.navigate mode=train``.
        drivers: the method whose trainings it drives with, if it has none of its own.
        packaged: whether it drives with the policy that comes with the package.
        follows: whether it follows moving obstacles, trained for that or not.
        slows_within: distance to the goal from which it slows down [m]; None: as trained.
    """

    options: tuple[str, ...] = ()
    drivers: str | None = None
    packaged: bool = False
    follows: bool = False
    slows_within: float | None = 1.0

    @property
    def drives(self) -> dict[str, Any]:
        """Return the options of ``Navigator.load``."""
        return {"walkers": True if self.follows else None, "slows_within": self.slows_within}


LEARNED = {
    "paper_literal": Learned(("policy=paper_literal",), slows_within=None),
    "paper_state": Learned(("policy=paper_state",), slows_within=None),
    # the paper's state with the centers of objects: for --sensors centers
    "paper_centers": Learned(("policy=paper_literal", "sensor=centers"), slows_within=None),
    "dqn": Learned(),
    "dqn_ensemble": Learned(packaged=True),  # three of dqn's trainings drive together
    "dqn_as_trained": Learned(drivers="dqn", slows_within=None),  # 3 m
    "dqn_follows": Learned(drivers="dqn", follows=True),
    "dqn_ensemble_follows": Learned(packaged=True, follows=True),
    "dqn_walkers": Learned(("pedestrians=10", "observer.walkers=true")),
    "dqn_mixed": Learned(("sensor=mixed",)),  # measured errors of a depth network in half of the episodes
    "dqn_by_age": Learned(("observer.seen_through=0",)),  # remembered points are forgotten by age only
    # the five turns, turning on the spot to either side, and driving straight back
    "dqn_reverse": Learned((
        "observer.turn_rates=[1.2,0.5,0.0,-0.5,-1.2,1.2,-1.2,0.0]",
        "observer.turn_factors=[0.35,0.75,1.0,0.75,0.35,0.0,0.0,-0.4]",
    )),
}  # fmt: skip
VARIANTS = ("paper_centers", "dqn_reverse", "astar_online_dqn_follows")  # only run by name
PLANNERS: dict[str, Callable[..., Any]] = {
    "astar_online_dqn": partial(
        PlanAndSteer, slows_within=1.0, heeds_unseen=False
    ),  # steers with the packaged policy
    "astar_online_dqn_follows": partial(PlanAndSteer, slows_within=1.0, heeds_unseen=False, walkers=True),
    "astar_dwa": AStarDWA,
    "astar_online_dwa": AStarOnlineDWA,
    "dwa": LocalDWA,
    "dwa, 5 sectors, no memory": partial(LocalDWA, sight="sectors", memory=0, carrot=20.0),
    "straight": Straight,
}

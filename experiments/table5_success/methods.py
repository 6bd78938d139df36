"""Who crosses the arenas: learnt methods, by what trains them and how they drive, and planners."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from eldenet.navigation.planners.astar import AStarDWA, AStarOnlineDWA
from eldenet.navigation.planners.dwa import LocalDWA
from eldenet.navigation.planners.straight import Straight


@dataclass(frozen=True)
class Learnt:
    """A learnt method.

    Attributes:
        options: of ``python -m eldenet.navigate mode=train``.
        drivers: the method whose trainings drive, where it has none of its own.
        packaged: the policy of the package drives, alone.
        follows: what moves, trained so or not.
        slows_within: that far from the goal [m]; None: as it was trained.
    """

    options: tuple[str, ...] = ()
    drivers: str | None = None
    packaged: bool = False
    follows: bool = False
    slows_within: float | None = 1.0

    @property
    def drives(self) -> dict[str, Any]:
        """Options of ``Navigator.load``."""
        return {"walkers": True if self.follows else None, "slows_within": self.slows_within}


LEARNT = {
    "paper_literal": Learnt(("policy=paper_literal",), slows_within=None),
    "paper_state": Learnt(("policy=paper_state",), slows_within=None),
    "dqn": Learnt(),
    "dqn_ensemble": Learnt(packaged=True),  # three of dqn's trainings drive together
    "dqn_as_trained": Learnt(drivers="dqn", slows_within=None),  # 3 m
    "dqn_follows": Learnt(drivers="dqn", follows=True),
    "dqn_ensemble_follows": Learnt(packaged=True, follows=True),
    "dqn_walkers": Learnt(("pedestrians=10", "observer.walkers=true")),
    "dqn_mixed": Learnt(("sensor=mixed",)),  # half of the crossings with a depth network's measured errors
    "dqn_by_age": Learnt(("observer.seen_through=0",)),  # remembered points are forgotten with age alone
    # beside the five turns: on the spot to either side, and straight back
    "dqn_reverse": Learnt((
        "observer.turn_rates=[1.2,0.5,0.0,-0.5,-1.2,1.2,-1.2,0.0]",
        "observer.turn_factors=[0.35,0.75,1.0,0.75,0.35,0.0,0.0,-0.4]",
    )),
    "dqn_curriculum": Learnt(("training.arenas.curriculum=0.5",)),
    "dqn_quantile": Learnt(("learner.quantiles=16",)),
}  # fmt: skip
VARIANTS = ("dqn_reverse", "dqn_curriculum", "dqn_quantile")  # asked for by name alone
PLANNERS: dict[str, Callable[[int], Any]] = {
    "astar_dwa": lambda robots: AStarDWA(robots=robots),
    "astar_online_dwa": lambda robots: AStarOnlineDWA(robots=robots),
    "dwa": lambda robots: LocalDWA(robots=robots),
    "dwa, 5 sectors, no memory": lambda robots: LocalDWA(sight="sectors", memory=0, robots=robots),
    "straight": lambda robots: Straight(robots=robots),
}

"""Versions of what navigation computes: they tell old results from new.

Raise a version whenever the results that it names change. Golden episodes in the tests fail where episodes
change and their version does not.
"""

#: Of how drivers are trained. A training that stopped goes on with the version that began it.
TRAINING_VERSION = 1
#: Of arenas, sensors, drivers and rendering: of everything that an episode's outcome rests on.
EPISODE_VERSION = 1

# What version 1 is called in results that were stored before versions: digests of the sources of that time.
_TRAINING_DIGEST = "5d72d0ec9b918b6ae5857d48c0beb61e287fdfa405571686b04b98daf115805c"
_EPISODE_DIGEST = "e42aa00d814fff6cc37098aa14e4d3f0f3593bdf6f29abf87f6a98e681d17385"
_CAMERA_EPISODE_DIGEST = "765bc105770f003478334e64de8d4111f88849292a16d603a730275282343ab0"


def training_hash() -> str:
    """Digest of version 1 of a training, as stored rows of ``experiments/table5_success`` hold it."""
    return _TRAINING_DIGEST


def crossing_hash(*, camera: bool = False) -> str:
    """Digest of version 1 of an episode, as stored rows hold it; ``camera``: of one with rendered frames."""
    return _CAMERA_EPISODE_DIGEST if camera else _EPISODE_DIGEST

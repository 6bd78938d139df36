"""What a stored result comes from: versions of the code's behavior, and hashes of policy and sensor files.

Raise a version whenever the results that it names change. Golden episodes in the tests fail where episodes
change and their version does not.
"""

from typing import Any

from eldenet.navigation.evaluation import Policy
from eldenet.navigation.policy import Navigator
from eldenet.navigation.sensors import Sensor
from eldenet.results.fingerprints import sha256

#: Of how drivers are trained. A stopped training can only continue with the version that started it.
TRAINING_VERSION = 1
#: Of everything that an episode's outcome depends on: arenas, sensors, drivers, rendering.
EPISODE_VERSION = 1

# Names of version 1 in results that were stored before versions: digests of the sources at that time.
_TRAINING_DIGEST = "5d72d0ec9b918b6ae5857d48c0beb61e287fdfa405571686b04b98daf115805c"
_EPISODE_DIGEST = "e42aa00d814fff6cc37098aa14e4d3f0f3593bdf6f29abf87f6a98e681d17385"
_CAMERA_EPISODE_DIGEST = "765bc105770f003478334e64de8d4111f88849292a16d603a730275282343ab0"


def training_hash() -> str:
    """Digest of version 1 of a training, as stored in the rows of ``experiments/table5_success``."""
    return _TRAINING_DIGEST


def episode_hash(*, camera: bool = False) -> str:
    """Digest of version 1 of an episode, as stored in rows; ``camera``: of one with rendered frames."""
    return _CAMERA_EPISODE_DIGEST if camera else _EPISODE_DIGEST


def driver_identity(policy: Policy) -> dict[str, Any] | None:
    """Files, training notes and observer of a learned driver; None for a planner."""
    if not isinstance(policy, Navigator):
        return None
    files = [{"file": str(file), "sha256": sha256(file)} for file in policy.files]
    return {"files": files, "info": policy.info, "observer": policy.observer.options}


def sensor_identity(sensor: Sensor) -> dict[str, dict[str, str | None]]:
    """Name and hash of each file that a sensor uses: depth network, detector, range errors.

    The hash is None if the file is not on this machine, as for a Hub id.
    """
    sources = getattr(sensor, "sources", {})
    return {name: {"source": source, "sha256": sha256(file)} for name, (source, file) in sources.items()}

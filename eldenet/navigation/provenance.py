"""Origin of a stored result: versions of the code's behavior, and hashes of policy and sensor files.

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


def driver_identity(policy: Policy) -> dict[str, Any] | None:
    """Files, training notes and observer of a learned driver, or of a planner's; None without one."""
    navigator = getattr(policy, "navigator", policy)
    if not isinstance(navigator, Navigator):
        return None
    files = [{"file": str(file), "sha256": sha256(file)} for file in navigator.files]
    return {"files": files, "info": navigator.info, "observer": navigator.observer.options}


def sensor_identity(sensor: Sensor) -> dict[str, dict[str, str | None]]:
    """Name and hash of each file that a sensor uses: depth network, detector, range errors.

    The hash is None if the file is not on this machine, as for a Hub id.
    """
    sources = getattr(sensor, "sources", {})
    return {name: {"source": source, "sha256": sha256(file)} for name, (source, file) in sources.items()}

"""What drove and what it saw with, for ``run.json``: told by content, wherever the files lie."""

from collections.abc import Mapping
from typing import Any

from eldenet.navigation.noisy_ranges import errors_file
from eldenet.navigation.policy import Navigator, policy_files
from eldenet.results.fingerprints import sha256


def driver_identity(policy: Any, options: Mapping[str, Any]) -> dict[str, Any] | None:
    """Files of a learnt driver, what is known of its training, its observer; None of a planner.

    Args:
        policy: that drives.
        options: that it was built with.
    """
    if not isinstance(policy, Navigator):
        return None
    files = [{"file": str(file), "sha256": sha256(file)} for file in policy_files(options.get("path"))]
    return {"files": files, "info": policy.info, "observer": policy.observer.options}


def sensor_identity(options: Mapping[str, Any]) -> dict[str, dict[str, str | None]]:
    """Of the depth network, the detector and the table of errors, where the options name some.

    The hash is None where the content does not lie here, as of a Hub id.
    """
    found = {"depth": options.get("checkpoint"), "errors": options.get("errors")}
    if isinstance(options.get("detector"), Mapping):
        found["detector"] = options["detector"].get("path")
    identity = {
        name: {"source": str(source), "sha256": sha256(source)} for name, source in found.items() if source
    }
    if "errors" in identity:
        identity["errors"]["sha256"] = sha256(errors_file(identity["errors"]["source"] or ""))
    return identity

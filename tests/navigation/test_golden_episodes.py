"""What the packaged driver does in an arena changes only together with ``EPISODE_VERSION``, on any machine.

After an intended change: raise the version, then run ``python tests/navigation/test_golden_episodes.py``.
"""

import json
from pathlib import Path

import pytest

from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import run_episodes
from eldenet.navigation.policy import Navigator
from eldenet.navigation.provenance import EPISODE_VERSION
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas

GOLDEN = Path(__file__).parent / "golden" / f"episodes-v{EPISODE_VERSION}.json"


def episodes() -> list[dict[str, object]]:
    rows = []
    for physics in ("kinematic", "wheels"):
        for density, movers in ((5, 0), (20, 0), (20, 10)):
            arenas = frozen_arenas(density, 2, split="val", pedestrians=movers)
            settings = EpisodeSettings(physics)
            found = run_episodes(arenas, lambda robots: Navigator.load(robots=robots), Ranges(), settings)
            rows += [{"physics": physics, "density": density, "movers": movers, "outcome": row.outcome,
                      "seconds": round(row.seconds, 2), "travelled": round(row.travelled, 3)}
                     for row in found]  # fmt: skip
    return rows


def test_episodes_change_only_together_with_their_version() -> None:
    golden, found = json.loads(GOLDEN.read_text()), episodes()
    assert [row["outcome"] for row in found] == [row["outcome"] for row in golden]
    for row, wanted in zip(found, golden, strict=True):
        assert row["travelled"] == pytest.approx(wanted["travelled"], abs=0.3), (row, wanted)  # [m]
        assert row["seconds"] == pytest.approx(wanted["seconds"], abs=0.8), (row, wanted)


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps(episodes(), indent=1) + "\n")

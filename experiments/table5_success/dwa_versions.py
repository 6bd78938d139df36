"""Cross arenas of 80 obstacles with today's DWA, beside the stored episodes of its version 1.

python experiments/table5_success/dwa_versions.py
"""

from pathlib import Path

from eldenet.navigation.episodes import EpisodeSettings
from eldenet.navigation.evaluation import run_episodes
from eldenet.navigation.planners.dwa import LocalDWA
from eldenet.navigation.sensors import Ranges
from eldenet.navigation.tasks import frozen_arenas
from eldenet.system.files import read_table, write_rows

HERE = Path(__file__).parent
COURSE = {"sensor": "ranges", "goal": "known", "physics": "wheels", "course": "80", "worlds": "500"}
ARENAS = 100


def main() -> None:
    lines = read_table(HERE / "rows" / "dwa.csv", (*COURSE, "world", "outcome", "seconds"))
    stored = [line for line in lines if COURSE.items() <= line.items()][:ARENAS]
    arenas = frozen_arenas(80, 500)[:ARENAS]
    today = run_episodes(arenas, lambda robots: LocalDWA(robots=robots), Ranges(), EpisodeSettings("wheels"))
    rows = [
        [old["world"], old["outcome"], new.outcome, old["seconds"], f"{new.seconds:.2f}"]
        for old, new in zip(stored, today, strict=True)
    ]
    write_rows(
        HERE / "dwa_versions.csv",
        ["world", "outcome_version_1", "outcome", "seconds_version_1", "seconds"],
        rows,
    )
    for column, name in ((1, "version 1"), (2, "today")):
        print(f"{name}: {sum(row[column] == 'success' for row in rows)} of {len(rows)}")


if __name__ == "__main__":
    main()

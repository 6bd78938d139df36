"""Measure the packaged driver with a camera: depth by a network or a depth camera, boxes by a detector.

python experiments/table5_robustness/pixels.py --detector runs/detector-arenas/detector.onnx

All rows cross the same test arenas. Stored rows of the same depth network and detector are read; a command
that was stopped goes on with the row where it stopped.
"""

import hashlib
import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import torch  # noqa: E402

from eldenet.navigation.cameras import FACES_VERSION, camera, depth_camera, objects  # noqa: E402
from eldenet.navigation.episodes import EpisodeSettings  # noqa: E402
from eldenet.navigation.evaluation import Episode, run_episodes, summarize  # noqa: E402
from eldenet.navigation.policy import Navigator  # noqa: E402
from eldenet.navigation.provenance import EPISODE_VERSION  # noqa: E402
from eldenet.navigation.range_filter import FILTER_VERSION  # noqa: E402
from eldenet.navigation.sensors import Ranges, Sensor  # noqa: E402
from eldenet.navigation.tasks import frozen_arenas  # noqa: E402
from eldenet.results.run_record import environment  # noqa: E402
from eldenet.weights import located  # noqa: E402

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "table5_success"))
from episodes import mcnemar, read_episodes, write_episodes  # noqa: E402

DEPTH = "eldenet_arenas"
SENSORS = (
    "true ranges",
    "camera",
    "objects, ideal detector",
    "objects, trained detector",
    "depth camera",
    "depth camera, range filter",
)
BY_NETWORK = SENSORS[1:4]


@dataclass(frozen=True)
class Condition:
    """What is in the arenas, and whether the driver tracks pedestrians.

    Attributes:
        density: number of standing obstacles.
        pedestrians: walking people.
        tracked: the driver tracks them.
    """

    density: int
    pedestrians: int = 0
    tracked: bool = False


CONDITIONS: Mapping[str, Condition] = {
    "80 obstacles": Condition(80),
    "20 obstacles": Condition(20),
    "20 obstacles, 10 pedestrians, tracked": Condition(20, 10, True),
    "20 obstacles, 10 pedestrians": Condition(20, 10),
    "80 obstacles, 10 pedestrians, tracked": Condition(80, 10, True),
}
LABELS = ("condition", "sensor", "version")

# (condition, sensor, version) -> episodes by arena
Rows = dict[tuple[str, str, str], list[Episode]]


def main(arguments: Sequence[str] | None = None, folder: Path = HERE) -> None:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=40, help="test arenas")
    parser.add_argument("--detector", type=Path, help="a trained one, .onnx; needed for its rows")
    parser.add_argument("--sensors", default=";".join(SENSORS), help="separated by semicolons")
    parser.add_argument("--conditions", default=";".join(CONDITIONS), help="separated by semicolons")
    args = parser.parse_args(arguments)
    torch.set_num_threads(1)
    stored = read(folder / "pixels.csv.xz")
    for name in args.conditions.split(";"):
        condition = CONDITIONS[name]
        arenas = frozen_arenas(condition.density, args.worlds, pedestrians=condition.pedestrians)
        for kind in args.sensors.split(";"):
            rows = stored.setdefault((name, kind, version(kind, args.detector)), [])
            if len(rows) >= args.worlds:
                continue
            rows[:] = run_episodes(
                arenas,
                lambda robots, tracked=condition.tracked: Navigator.load(
                    walkers=tracked, slows_within=1.0, robots=robots
                ),
                make_sensor(kind, args.detector),
                EpisodeSettings("wheels", range_filter="range filter" in kind),
                robots=8,
            )
            write(folder, stored)
            solved = sum(row.outcome == "success" for row in rows)
            print(f"{name}, {kind}: {solved} of {len(rows)}", flush=True)
    write(folder, stored)


def make_sensor(kind: str, detector: Path | None) -> Sensor:
    """Return one of ``SENSORS``."""
    if kind == "true ranges":
        return Ranges()
    if kind == "camera":
        return camera(DEPTH)
    if kind in SENSORS[4:]:
        return depth_camera()
    return objects(DEPTH, detector=detector if kind == SENSORS[3] else None)


def version(kind: str, detector: Path | None) -> str:
    """Return the versions of what a row depends on: episodes, depth network, faces of boxes, detector.

    Raises:
        ValueError: the row needs a detector, and none is given.
    """
    if kind != "objects, trained detector":
        return code_version(kind)
    if detector is None:
        raise ValueError("--detector is missing: give the .onnx file, or leave its sensor out of --sensors")
    return f"{code_version(kind)}.{digest(detector)}"


def code_version(kind: str) -> str:
    """Return :func:`version` without a detector."""
    parts = [str(EPISODE_VERSION)]
    if kind in BY_NETWORK:
        parts.append(digest(located(DEPTH) / "model.safetensors"))
    if "objects" in kind:
        parts.append(f"faces {FACES_VERSION}")
    if "range filter" in kind:
        parts.append(f"filter {FILTER_VERSION}")
    return ".".join(parts)


def digest(file: Path) -> str:
    """Return the first digits of the SHA-256 of a file."""
    return hashlib.sha256(file.read_bytes()).hexdigest()[:8]


def read(file: Path) -> Rows:
    """Return the stored rows of today's episodes and depth network."""
    return {
        (name, kind, made_with): episodes
        for (name, kind, made_with), episodes in read_episodes(file, LABELS).items()
        if made_with.startswith(code_version(kind))
    }


def write(folder: Path, rows: Rows) -> None:
    """Write every episode to ``pixels.csv.xz`` and the table to ``pixels.md``."""
    order = sorted(rows, key=lambda key: (list(CONDITIONS).index(key[0]), SENSORS.index(key[1]), key[2]))
    made = {key: rows[key] for key in order if rows[key]}
    write_episodes(folder / "pixels.csv.xz", LABELS, made)
    text = [
        "# Driving by pixels",
        "",
        "The packaged driver, success [%] with Wilson's 95 % interval on the first test arenas; wheels, goal "
        f"known, depth by `{DEPTH}` or a simulated depth camera. {environment()['date']}. The last columns "
        "count arenas that only the other sensor and only the sensor of the row solved, and McNemar's "
        "p-value.",
        "",
        "| arenas | sensor | count | success | collisions | time-outs | time of successes [s] |"
        " only `camera` : only it | only ideal detector : only it |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
        *(line_of(key, made) for key in made),
        "",
        "Made by `python experiments/table5_robustness/pixels.py --detector "
        "runs/detector-arenas/detector.onnx`. `pixels.csv.xz` has the first digits of the SHA-256 of the "
        "depth network and of the detector.",
    ]
    (folder / "pixels.md").write_text("\n".join(text) + "\n")


def line_of(key: tuple[str, str, str], rows: Rows) -> str:
    """Return a line of the table."""
    name, kind, _ = key
    s = summarize(rows[key])
    cells = [f"{s['success']:.1f} ({s['success_low']:.0f} to {s['success_high']:.0f})"]
    cells += [f"{s['collision']:.1f}", f"{s['timeout']:.1f}", f"{s['seconds']:.1f}"]
    for other in SENSORS[1:3]:
        against = [episodes for (at, sensor, _), episodes in rows.items() if (at, sensor) == (name, other)]
        cells.append(paired(against[0], rows[key]) if against and kind != other else "-")
    return f"| {name} | {kind} | {len(rows[key])} | {' | '.join(cells)} |"


def paired(other: Sequence[Episode], mine: Sequence[Episode]) -> str:
    """Return how many of the common arenas only one of two rows solved, and McNemar's p-value."""
    count = min(len(other), len(mine))
    first, second = ([row.outcome == "success" for row in rows[:count]] for rows in (other, mine))
    only_other, only_mine, p = mcnemar(first, second)
    return f"{only_other} : {only_mine} (p = {p:.2g})"


if __name__ == "__main__":
    main(sys.argv[1:])

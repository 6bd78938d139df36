"""The command line of both tables: what is asked for, and which rows that makes."""

import csv
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from inputs import TRUTH, check_inputs
from methods import LEARNT, PLANNERS, VARIANTS
from rows import Row, course_name

from eldenet.navigation.crossings import GOALS

HERE = Path(__file__).parent
COURSES = ((5, 0), (20, 0), (40, 0), (80, 0), (20, 10))  # standing obstacles, people who walk
SENSORS = ("ranges", "noisy", "camera", "objects")


def arguments(
    methods: Sequence[str] = tuple(name for name in (*LEARNT, *PLANNERS) if name not in VARIANTS),
    courses: Sequence[tuple[int, int]] = COURSES,
) -> Namespace:
    """What both tables' commands take; ``methods`` and ``courses`` are those of the default."""
    parser = ArgumentParser()
    parser.add_argument("--worlds", type=int, default=500, help="test arenas per density")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of every learnt method")
    parser.add_argument("--methods", default=",,".join(methods), help="names, separated by ,,")
    parser.add_argument(
        "--sensors",
        default="ranges",
        help="of ranges, noisy, camera, objects; camera@0.1: in a tenth of the light",
    )
    parser.add_argument("--physics", default="wheels")
    parser.add_argument("--courses", default=",".join(course_name(*course) for course in courses))
    parser.add_argument("--goal", default="known", choices=GOALS, help="where the goal's place is taken from")
    parser.add_argument("--depth", help=f"network of camera and objects: folder or file; or {TRUTH}")
    parser.add_argument("--detector", help=f"of objects: an .onnx file; or {TRUTH}, an ideal one")
    parser.add_argument("--errors", default="packaged", help="range_errors.json of sensor noisy")
    parser.add_argument("--out", help="name of the results; default: results-<worlds>")
    parser.add_argument("--runs", type=Path, default=Path("runs/table5"), help="where trainings go")
    parser.add_argument("--rows", type=Path, default=HERE / "rows", help="where rows are kept")
    return parser.parse_args()


def results_name(given: Namespace) -> str:
    """Of a table's files, without their endings."""
    goal = "" if given.goal == "known" else f"-goal-{given.goal}"
    return str(given.out or f"results-{given.worlds}{goal}")


def refuse_to_drop(path: Path, asked: Iterable[Sequence[str]]) -> None:
    """A part of a table must not replace the whole.

    Args:
        path: of the table's CSV.
        asked: first columns of every row that the command will write.

    Raises:
        ValueError: the file holds rows that were not asked for.
    """
    if not path.is_file():
        return
    asked = {tuple(row) for row in asked}
    width = len(next(iter(asked)))
    with path.open() as file:
        dropped = [row for row in list(csv.reader(file))[1:] if tuple(row[:width]) not in asked]
    if dropped:
        raise ValueError(
            f"{path} holds {len(dropped)} rows that this command does not ask for, such as "
            f"{', '.join(dropped[0][:width])}: ask for them too (they are not made twice), or give --out"
        )


def without_nan(row: Sequence[Any]) -> list[Any]:
    """For a CSV: an empty field where there is no number."""
    return ["" if isinstance(value, float) and value != value else value for value in row]


def all_rows(given: Namespace) -> Iterator[Row]:
    """Every row that the command asks for.

    Raises:
        ValueError: a method, a sensor or a course that there is not, or something that a sensor needs.
    """
    methods, sensors, courses = given.methods.split(",,"), given.sensors.split(","), given.courses.split(",")
    known = {course_name(*course): course for course in COURSES}
    for kind, asked, there in (
        ("methods", methods, [*LEARNT, *PLANNERS]),
        ("sensors", [sensor.partition("@")[0] for sensor in sensors], SENSORS),
        ("courses", courses, known),
    ):
        if not set(asked) <= set(there):
            raise ValueError(f"--{kind}: {sorted(set(asked) - set(there))} is none of {', '.join(there)}")
    check_inputs(given, sensors)
    for physics in given.physics.split(","):
        for sensor in sensors:
            for method in methods:
                seeds = range(1 if method in LEARNT and LEARNT[method].packaged else given.seeds)
                for seed in seeds if method in LEARNT else [None]:
                    for course in courses:
                        yield Row(method, *known[course], sensor, physics, given.worlds, seed, given.goal)

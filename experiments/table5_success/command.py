"""The command line of tables 5 and 6, and the rows that it asks for."""

import csv
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from inputs import TRUTH, check_inputs
from methods import LEARNED, PLANNERS, VARIANTS
from rows import Row, course_name

from eldenet.navigation.episodes import GOALS
from eldenet.system.files import write_rows

HERE = Path(__file__).parent
COURSES = ((5, 0), (20, 0), (40, 0), (80, 0), (20, 10))  # standing obstacles, walking people
SENSORS = ("ranges", "centers", "noisy", "camera", "objects")


def arguments(
    methods: Sequence[str] = tuple(name for name in (*LEARNED, *PLANNERS) if name not in VARIANTS),
    courses: Sequence[tuple[int, int]] = COURSES,
) -> Namespace:
    """Return the options of either table's command, by default for these methods and courses."""
    parser = ArgumentParser(description="Rows that are stored and up to date are read, not made again.")
    parser.add_argument("--worlds", type=int, default=500, help="test arenas per density")
    parser.add_argument("--seeds", type=int, default=3, help="trainings of every learned method")
    parser.add_argument("--methods", default=",,".join(methods), help="names, separated by two commas")
    parser.add_argument(
        "--sensors",
        default="ranges",
        help="ranges, centers, noisy, camera, objects; camera@0.1 is a camera in a tenth of the light",
    )
    parser.add_argument("--physics", default="wheels", help="wheels, kinematic")
    parser.add_argument("--courses", default=",".join(course_name(*course) for course in courses))
    parser.add_argument("--goal", default="known", choices=GOALS, help="source of the goal's position")
    parser.add_argument("--depth", help=f"depth network of camera and objects: folder or file; or {TRUTH}")
    parser.add_argument("--detector", help=f"detector of objects: an .onnx file; or {TRUTH}, an ideal one")
    parser.add_argument("--errors", default="packaged", help="range_errors.json of noisy")
    parser.add_argument("--out", help="name of the table (default: results-<worlds>)")
    parser.add_argument(
        "--stored", action="store_true", help="rows as they are stored, whatever has changed since; SPL anew"
    )
    parser.add_argument("--runs", type=Path, default=Path("runs/table5"), help="folder of trainings")
    parser.add_argument("--rows", type=Path, default=HERE / "rows", help="folder of rows")
    return parser.parse_args()


def results_name(args: Namespace) -> str:
    """Return the name of a table, and of its files without their endings."""
    goal = "" if args.goal == "known" else f"-goal-{args.goal}"
    return str(args.out or f"results-{args.worlds}{goal}")


def tables_of(path: Path) -> list[list[str]]:
    """Return the rows of a CSV of tables, whose first column names the table; none without the file."""
    if not path.is_file():
        return []
    with path.open() as file:
        return list(csv.reader(file))[1:]


def refuse_to_drop(path: Path, name: str, asked: Iterable[Sequence[str]]) -> None:
    """Refuse to replace a table by a part of it.

    Args:
        path: CSV of the tables.
        name: of the table.
        asked: first columns of every row that the command will write.

    Raises:
        ValueError: the table holds rows that the command will not write.
    """
    asked = {tuple(row) for row in asked}
    width = len(next(iter(asked)))
    mine = [row[1:] for row in tables_of(path) if row[0] == name]
    dropped = [row for row in mine if tuple(row[:width]) not in asked]
    if dropped:
        raise ValueError(
            f"{path} holds {len(dropped)} rows of {name} that this command does not ask for, such as "
            f"{', '.join(dropped[0][:width])}: ask for them too (stored rows are read), or give --out"
        )


def write_table(path: Path, name: str, columns: Sequence[str], cells: Sequence[Sequence[Any]]) -> None:
    """Write the rows of a table into a CSV of tables; those of other tables stay."""
    others = [row for row in tables_of(path) if row[0] != name]
    write_rows(path, ["table", *columns], [*others, *([name, *row] for row in cells)])


def without_nan(row: Sequence[Any]) -> list[Any]:
    """Return a CSV row with empty fields in place of NaN."""
    return ["" if isinstance(value, float) and value != value else value for value in row]


def all_rows(args: Namespace) -> Iterator[Row]:
    """Yield every row that the command asks for.

    Raises:
        ValueError: a method, sensor or course is unknown, or an input of a sensor is missing.
    """
    methods, sensors, courses = args.methods.split(",,"), args.sensors.split(","), args.courses.split(",")
    known = {course_name(*course): course for course in COURSES}
    for kind, asked, there in (
        ("methods", methods, [*LEARNED, *PLANNERS]),
        ("sensors", [sensor.partition("@")[0] for sensor in sensors], SENSORS),
        ("courses", courses, known),
    ):
        if not set(asked) <= set(there):
            raise ValueError(
                f"--{kind}: unknown {sorted(set(asked) - set(there))}; choose among {', '.join(there)}"
            )
    if not args.stored:
        check_inputs(args, sensors)
    for physics in args.physics.split(","):
        for sensor in sensors:
            for method in methods:
                seeds = range(1 if method in LEARNED and LEARNED[method].packaged else args.seeds)
                for seed in seeds if method in LEARNED else [None]:
                    for course in courses:
                        yield Row(method, *known[course], sensor, physics, args.worlds, seed, args.goal)

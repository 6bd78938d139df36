"""Compare the depth of rendered rooms with NYU's in a few numbers, and draw a contact sheet of the rooms.

python experiments/rooms_beside_nyu/run.py        (NYU's row needs ELDENET_DATA, see docs/data.md)
"""

from pathlib import Path

import numpy as np

from eldenet.data.nyu import NYULabelled
from eldenet.data.rooms import Rooms
from eldenet.data.statistics import depth_statistics
from eldenet.visualization import color_depth, stack_rows, write_picture

HERE = Path(__file__).parent
COLUMNS = ("p5", "median", "p95", "frame_median", "frame_median_std", "frame_range", "gradient")
TITLES = ("5 % [m]", "median [m]", "95 % [m]", "frame median [m]", "± over frames", "95 % / 5 %", "gradient")


def contact_sheet(rooms: Rooms, across: int = 6, down: int = 3) -> np.ndarray:
    """Return evenly spaced frames, each image above its depth: ``(H, W, 3)`` uint8."""
    rows = []
    indices = iter(np.linspace(0, len(rooms) - 1, across * down).astype(int))
    for _ in range(down):
        frames = [rooms.load_frame(int(next(indices))) for _ in range(across)]
        rows.append(np.concatenate([frame.image for frame in frames], axis=1))
        rows.append(np.concatenate([color_depth(frame.depth, 0.5, 7.0) for frame in frames], axis=1))
    return stack_rows(rows)


def main() -> None:
    rooms = Rooms("test", 512, size=(120, 160))
    sets = {"rooms (test)": rooms}
    try:
        sets["NYU labeled (795 training frames)"] = NYULabelled(split="all", min_depth=0.1)
    except FileNotFoundError as error:
        print(f"NYU is left out: {error}")
    lines = [f"| data | {' | '.join(TITLES)} |", "|---|" + "---:|" * len(TITLES)]
    for name, dataset in sets.items():
        values = depth_statistics(dataset, 256)._asdict()
        lines.append(f"| {name} | " + " | ".join(f"{values[column]:.3f}" for column in COLUMNS) + " |")
    lines += [
        "",
        "256 frames each, evenly spaced. Gradient: mean relative depth difference over 1/40 of the width.",
        "Made by `python experiments/rooms_beside_nyu/run.py`.",
        "",
        "![test rooms, image over depth](rooms.png)",
    ]
    (HERE / "results.md").write_text("\n".join(lines) + "\n")
    write_picture(HERE / "rooms.png", contact_sheet(rooms))
    print("\n".join(lines))


if __name__ == "__main__":
    main()

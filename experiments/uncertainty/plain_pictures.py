"""How unsure are weights of pictures that show nothing, and of the README's example?

python experiments/uncertainty/plain_pictures.py eldenet_indoor eldenet_l_indoor
python experiments/uncertainty/plain_pictures.py l_kept=runs/indoor_lite_kept

Stores in ``plain_pictures.csv`` the share of pixels whose sigma is above 30 % of their depth.
"""

import sys
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402

import eldenet  # noqa: E402
from eldenet.data.io import read_image  # noqa: E402
from eldenet.results.tables import to_markdown  # noqa: E402
from eldenet.system.files import read_table, write_rows  # noqa: E402

HERE = Path(__file__).parent
STORED = HERE / "plain_pictures.csv"
SIZE = (480, 640, 3)
NYU_FOCAL = 518.86  # [px], of a picture of SIZE
EXAMPLE_FOCAL = 440.0  # [px], as the README gives it
UNSURE = 0.3  # sigma / depth


def pictures() -> dict[str, tuple[np.ndarray, float]]:
    """Name -> picture ``(H, W, 3)`` uint8 and its focal length [px]."""
    rng = np.random.default_rng(0)

    def noisy(color: tuple[int, int, int], sigma: float) -> np.ndarray:
        return rng.normal(color, sigma, SIZE).clip(0, 255).astype(np.uint8)

    plain = {
        "white": np.full(SIZE, 255, np.uint8),
        "gray": np.full(SIZE, 128, np.uint8),
        "black": np.zeros(SIZE, np.uint8),
        "dark": noisy((12, 12, 12), 4),
        "wall": noisy((200, 190, 170), 3),
    }
    example = read_image(HERE.parents[1] / "web" / "example.jpg")
    return {**{name: (one, NYU_FOCAL) for name, one in plain.items()}, "example": (example, EXAMPLE_FOCAL)}


def main() -> None:
    """Measure ``NAME=SOURCE ...``, store the shares and print the table of all that is stored."""
    shown = pictures()
    columns = ["weights", *shown]
    stored = {row["weights"]: row for row in read_table(STORED, columns)} if STORED.exists() else {}
    for given in sys.argv[1:]:
        name, _, source = given.rpartition("=")
        found = [eldenet.estimate(picture, source, focal=focal) for picture, focal in shown.values()]
        shares = [f"{(one.sigma > UNSURE * one.depth).mean():.3f}" for one in found]
        stored[name or source] = dict(zip(columns, [name or source, *shares], strict=True))
    rows = [[row[column] for column in columns] for row in stored.values()]
    write_rows(STORED, columns, rows)
    print(to_markdown(columns, rows, []))


if __name__ == "__main__":
    main()

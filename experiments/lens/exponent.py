"""What if meters grew with a power of the focal length, for lenses longer than the canonical one?

python experiments/lens/exponent.py eldenet_indoor
python experiments/lens/exponent.py indoor=runs/indoor

Depth of crops of NYU's ``dev``, and of rendered rooms through longer lenses, with each exponent. Stores
delta1 in ``exponents.csv``; ``experiments/bench/run.py`` takes one as ``--lens-exponent``.
"""

import math
import sys
from collections.abc import Iterator
from pathlib import Path

from eldenet.system.resources import prepare_environment

prepare_environment()

import numpy as np  # noqa: E402
import torch  # noqa: E402

import eldenet  # noqa: E402
from eldenet.geometry import crop_intrinsics  # noqa: E402
from eldenet.results.tables import to_markdown  # noqa: E402
from eldenet.system.files import read_table, write_rows  # noqa: E402
from eldenet.types import Frame  # noqa: E402

sys.path.insert(0, str(Path(__file__).parents[1]))
from places import split_frames  # noqa: E402

STORED = Path(__file__).parent / "exponents.csv"
EXPONENTS = (1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7)
CROPS = (1.0, 1.25, 1.5, 2.0)
ROOMS = [
    "data=rooms",
    "data.size=[192,256]",
    "data.frames.test=120",
    "data.detail=true",
    "data.focal=[0.4,2.0]",
]
LONG = 1.5  # canonical focal lengths
COLUMNS = (
    "weights",
    "exponent",
    *(f"dev_{crop:g}x" for crop in CROPS),
    "rooms_to_1.5x",
    "rooms_from_1.5x",
    "mean",
)


def crops() -> Iterator[tuple[str, Frame]]:
    """The views of real frames, and those of rooms, by column (of rooms: ``"rooms"``)."""
    for frame in split_frames(["data=nyu_labelled", "data.val.split=dev"])[1]:
        height, width = frame.depth.shape
        for crop in CROPS:
            rows, cols = round(height / crop), round(width / crop)
            top, left = (height - rows) // 2, (width - cols) // 2
            part = (slice(top, top + rows), slice(left, left + cols))
            camera = crop_intrinsics(frame.intrinsics, top, left)
            image = np.ascontiguousarray(frame.image[part])
            yield f"dev_{crop:g}x", frame._replace(image=image, depth=frame.depth[part], intrinsics=camera)
    for frame in split_frames(ROOMS, "test")[1]:
        yield "rooms", frame


def delta1_of(network: eldenet.DepthNet) -> list[list[float]]:
    """Rows of ``COLUMNS`` without the name: mean delta1 over the frames, for each exponent."""
    predictor = eldenet.DepthPredictor(network, steady=False)
    canonical = network.canonical_px / network.info["input_size"][1]  # [widths]
    found: dict[str, list[list[float]]] = {}
    for column, frame in crops():
        focal = float(frame.intrinsics[0, 0])
        ratio = focal / frame.image.shape[1] / canonical
        if column == "rooms":
            column = "rooms_from_1.5x" if ratio >= LONG else "rooms_to_1.5x"
            if ratio <= 1:
                continue
        known = (frame.depth > 0) & (frame.depth < 10)
        depth = predictor(frame.image)[known] / frame.depth[known]  # canonical, in true meters
        factors = [min(ratio, ratio**exponent) for exponent in EXPONENTS]
        shares = [np.mean(np.abs(np.log(depth * factor)) < math.log(1.25)) for factor in factors]
        found.setdefault(column, []).append([float(share) for share in shares])
    means = {column: np.mean(shares, axis=0) for column, shares in found.items()}
    means["mean"] = np.mean([means[column] for column in COLUMNS[3:-1]], axis=0)  # of what is longer
    return [[exponent, *(means[column][i] for column in COLUMNS[2:])] for i, exponent in enumerate(EXPONENTS)]


def main() -> None:
    """Measure ``NAME=SOURCE``, store its rows and print them."""
    name, _, source = sys.argv[1].rpartition("=")
    torch.set_num_threads(1)
    rows = [[name or source, *map("{:.4g}".format, row)] for row in delta1_of(eldenet.load(source))]
    stored = [list(row.values()) for row in read_table(STORED, COLUMNS)] if STORED.exists() else []
    write_rows(STORED, COLUMNS, [row for row in stored if row[0] != rows[0][0]] + rows)
    print(to_markdown(list(COLUMNS), rows, []))


if __name__ == "__main__":
    main()

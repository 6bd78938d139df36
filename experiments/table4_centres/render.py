"""Rendered streets as a folder of pictures and depth maps, to train a depth network on.

python experiments/table4_centres/render.py runs/streets 600
python -m eldenet.train data=folder data.root=runs/streets data.encoding=kitti data.max_depth=80 \
    'data.input_size=[96,312]' model=eldenet_s run_dir=runs/streets-depth
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from eldenet.simulation.street_views import render_street

SIZE = (96, 312)


def main(folder: Path, count: int) -> None:
    for name in ("images", "depths"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for index in range(count):
        view = render_street("train", index, SIZE)
        steps = np.clip(np.rint(view.depth * 256), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / "images" / f"{index:05d}.png"), view.image[..., ::-1])
        cv2.imwrite(str(folder / "depths" / f"{index:05d}.png"), steps)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))

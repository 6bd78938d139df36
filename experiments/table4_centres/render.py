"""Render streets or halls into a folder of pictures and depth maps, to train a depth network on.

python experiments/table4_centres/render.py runs/streets 1800 street crossing
python experiments/table4_centres/render.py runs/halls 1800 hall
python -m eldenet.train data=folder data.root=runs/streets data.encoding=kitti data.max_depth=80 \
    'data.input_size=[96,312]' model/head=log loss=l1 loss.terms.l1.space=log output=runs/streets-depth
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from eldenet.simulation.street_views import render_street

SIZES = {"street": (96, 312), "crossing": (96, 312), "hall": (96, 128)}


def main(folder: Path, count: int, kinds: list[str]) -> None:
    """Render ``count`` frames, whose kinds alternate; existing ones are kept."""
    for name in ("images", "depths"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for index in range(count):
        depth = folder / "depths" / f"{index:05d}.png"
        if depth.exists():
            continue
        kind = kinds[index % len(kinds)]
        view = render_street("train", index, SIZES[kind], kind)
        steps = np.clip(np.rint(view.depth * 256), 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / "images" / depth.name), view.image[..., ::-1])
        cv2.imwrite(str(depth), steps)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:] or ["street"])

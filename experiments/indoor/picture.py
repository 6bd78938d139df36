"""Draws the picture of real rooms in the README: photo, sensor's depth, prediction, scale in meters.

``python experiments/indoor/picture.py eldenet_indoor docs/images/real_rooms.jpg`` draws frames of the
HoloLens office (deep-video-mvs, MIT) in ``$ELDENET_DATA/other_cameras``, which the packaged weights have not
seen. Rows lie at 20, 40, 60 and 80 % of all frames ranked by AbsRel, best first; the focal length is given.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

import eldenet
from eldenet.deploy.predictor import DepthPredictor
from eldenet.visualization import color_depth, depth_scale, stack_rows, visible_range

sys.path.insert(0, str(Path(__file__).parents[1]))
from places import camera_frames

SIZE = (320, 213)  # of a panel (width, height) [px]


def main(source: str, output: str) -> None:
    """Rank the frames and draw four of them."""
    predictor = DepthPredictor(eldenet.load(source), steady=False, sharp=True)
    found = []
    for photo, truth, camera, *_ in camera_frames("hololens_office")[1]:
        depth, known = predictor(photo, intrinsics=camera), truth > 0
        found.append((float(np.mean(np.abs(depth - truth)[known] / truth[known])), photo, truth, depth))
    found.sort(key=lambda frame: frame[0])
    rows = []
    for share in (0.2, 0.4, 0.6, 0.8):
        error, photo, truth, depth = found[round(share * (len(found) - 1))]
        near, far = visible_range(np.stack([truth, depth]))  # of both maps
        panels = [photo, color_depth(truth, near, far, truth > 0), color_depth(depth, near, far)]
        panels = [np.asarray(cv2.resize(panel, SIZE, interpolation=cv2.INTER_AREA)) for panel in panels]
        gap = np.full((SIZE[1], 4, 3), 255, np.uint8)
        scale = depth_scale(near, far, SIZE[1])
        rows.append(np.concatenate([panels[0], gap, panels[1], gap, panels[2], gap, scale], axis=1))
        print(f"{share:.0%} of the ranking: AbsRel {error:.3f}")
    picture = stack_rows(rows, ("photo", "depth by the HoloLens", f"depth by {source}"))
    cv2.imwrite(output, picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main(*sys.argv[1:])

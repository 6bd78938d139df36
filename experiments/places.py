"""The places that weights are scored on: frames with depth and camera, from ``$ELDENET_DATA``."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from eldenet.compose import compose
from eldenet.data.base import DepthDataset
from eldenet.data.io import read_depth, read_image
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.geometry import pinhole
from eldenet.system.files import read_table
from eldenet.train import TrainSettings
from eldenet.types import Frame

#: Place below ``other_cameras`` -> intrinsics of its pictures [px].
OTHER_CAMERAS = {
    "hololens_office": (440.5, 440.4, 239.6, 150.4),
    "tum_fr3_cabinet": (401.6, 404.4, 240.1, 185.7),
}


def split_frames(settings: Sequence[str], split: str = "val") -> tuple[EvalProtocol, list[Frame]]:
    """Return the protocol and the frames of a split that settings of ``eldenet.train`` describe."""
    config = compose(TrainSettings, settings)
    protocol = chosen_protocol(config.data, config.protocol)
    frames = open_split(config.data, split, protocol)
    return protocol, [frames.load_frame(index) for index in range(len(frames))]


def rows_of(place: str) -> list[dict[str, str]]:
    """The lines of a place in the list of other cameras' frames."""
    pairs = Path(os.environ["ELDENET_DATA"]) / "other_cameras" / "pairs.csv"
    return [row for row in read_table(pairs, ("rgb", "depth_mm")) if row["rgb"].startswith(place)]


def camera_frames(place: str) -> tuple[EvalProtocol, list[Frame]]:
    """Return the protocol and the frames of a place of another camera."""
    config = compose(TrainSettings, ["data=folder", "data.root=."])
    root = Path(os.environ["ELDENET_DATA"]) / "other_cameras"
    camera = pinhole(*OTHER_CAMERAS[place])
    return chosen_protocol(config.data, config.protocol), [
        Frame(read_image(root / row["rgb"]), read_depth(root / row["depth_mm"], "mm"), camera, row["rgb"])
        for row in rows_of(place)
    ]


def camera_split(place: str, input_size: Sequence[int]) -> tuple[EvalProtocol, DepthDataset]:
    """Return the protocol and the data set of a place of another camera, which shows ``input_size`` [px]."""
    root = Path(os.environ["ELDENET_DATA"]) / "other_cameras"
    with tempfile.NamedTemporaryFile("w", suffix=".csv") as table:
        table.write("\n".join(f"{row['rgb']},{row['depth_mm']}" for row in rows_of(place)))
        table.flush()
        data = ["data=folder", f"data.root={root}", f"data.csv={table.name}", "data.val_fraction=0.5"]
        data += [f"data.intrinsics={list(OTHER_CAMERAS[place])}", f"data.input_size={list(input_size)}"]
        config = compose(TrainSettings, [*data, "data.blocks=2", "model_name=any", "output=any"])
        protocol = chosen_protocol(config.data, config.protocol)
        config.data["val"]["split"] = "all"
        return protocol, open_split(config.data, "val", protocol)

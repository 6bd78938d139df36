"""What KITTI's layouts share: missing partners by name, intrinsics and size by date."""

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Unpack

import numpy as np

from eldenet.data.base import DepthDataset, SampleOptions
from eldenet.data.io import read_depth, read_image
from eldenet.data.kitti_layouts import Place
from eldenet.data.kitti_lidar import CAM_TO_CAM, rectified_intrinsics
from eldenet.system.checks import one_of
from eldenet.types import Frame

KITTI_MIN_DEPTH, KITTI_MAX_DEPTH = 1e-3, 80.0


class KITTIFrames(DepthDataset):
    """Frames of a picture and a source of depth, in places."""

    frame_lists = ("names", "places", "pictures", "sources")

    def __init__(
        self,
        pictures: Mapping[Place, Path | None],
        sources: Mapping[Place, Path | None],
        places: Sequence[Place],
        *,
        without_depth: Sequence[Place] = (),
        frames: int | None = None,
        **options: Unpack[SampleOptions],
    ) -> None:
        options.setdefault("min_depth", KITTI_MIN_DEPTH)
        options.setdefault("max_depth", KITTI_MAX_DEPTH)
        super().__init__([place.name for place in places], **options)
        if without_depth:
            logging.getLogger("eldenet").info(
                "%s: the list says None, no depth was made, for %d frames, such as %s: %d frames remain",
                type(self).__name__,
                len(without_depth),
                without_depth[0].name,
                len(places),
            )
        self.places = list(places)
        self.pictures = [Path(str(pictures.get(place))) for place in places]
        self.sources = [Path(str(sources.get(place))) for place in places]
        self.intrinsics: dict[tuple[str, int], np.ndarray] = {}
        if frames is not None and len(places) != frames:
            raise ValueError(
                f"{len(places)} frames where {frames} are expected ({len(without_depth)} without depth in "
                "the list): is it the right list, is all there? For a list of your own, data.frames=null"
            )
        self._check_partners(pictures, sources)

    def _check_partners(
        self, pictures: Mapping[Place, Path | None], sources: Mapping[Place, Path | None]
    ) -> None:
        lacks = {
            i: "no depth" if pictures.get(place) else "no picture"
            for i, place in enumerate(self.places)
            if not (pictures.get(place) and sources.get(place))
        }
        if lacks and self.on_error == "stop":
            what = ", ".join(f"{self.names[i]} ({reason})" for i, reason in list(lacks.items())[:10])
            more = f" and {len(lacks) - 10} more" if len(lacks) > 10 else ""
            raise FileNotFoundError(
                f"{len(lacks)} of {len(self)} frames are missing a file: {what}{more}. Complete the data "
                "set (data.raw_root says where the pictures are), or leave them out with data.on_error=skip"
            )
        where = "(data.raw_root says where the pictures are)"
        self.leave_out({i: f"{self.names[i]}: {reason} {where}" for i, reason in lacks.items()})

    def size_group(self, index: int) -> str:
        """The date: KITTI's frames are rectified, and cut to size, once per date."""
        return self.places[index].date

    def frame_files(self, index: int) -> Sequence[Path]:
        """Picture and source of depth."""
        return [self.pictures[index], self.sources[index]]

    def frame_settings(self) -> dict[str, object]:
        """The calibration, which is read at the start."""
        return {f"{date} {camera}": matrix.tolist() for (date, camera), matrix in self.intrinsics.items()}

    def load_frame(self, index: int) -> Frame:
        """Read one picture and its sparse depth."""
        image = read_image(self.pictures[index], gray=False)
        depth = self.read_sparse(index, (image.shape[0], image.shape[1]))
        if image.shape[:2] != depth.shape:
            raise ValueError(
                f"{self.pictures[index]} is {image.shape[:2]}, {self.sources[index]} is {depth.shape} "
                "(height, width): they are no pair"
            )
        return Frame(image, depth, self.camera_of(index), self.names[index])

    def camera_of(self, index: int) -> np.ndarray | None:
        """Intrinsics ``(3, 3)`` of a frame as it lies on disk [px], None where unknown."""
        place = self.places[index]
        return self.intrinsics.get((place.date, place.camera))

    def read_sparse(self, index: int, size: tuple[int, int]) -> np.ndarray:
        """Depth ``(H, W)`` [m] of a frame whose picture has ``size`` [px]."""
        return read_depth(self.sources[index], "kitti")

    def calibrate(self, folders: Sequence[Path], calibration: str) -> dict[tuple[str, int], Path]:
        """Read the intrinsics of every date; returns the folder of each date's calibration files."""
        one_of("calibration", calibration, ("required", "optional"))
        found = {}
        for date, camera in sorted({(place.date, place.camera) for place in self.places}):
            beside = [folder / date for folder in folders]
            folder = next((f for f in beside if (f / CAM_TO_CAM).is_file()), None)
            if folder is not None:
                self.intrinsics[date, camera] = rectified_intrinsics(folder, camera)
                found[date, camera] = folder
            elif calibration == "required":
                raise FileNotFoundError(
                    f"{CAM_TO_CAM} of {date} is in none of {', '.join(map(str, beside))}: it comes in "
                    "KITTI's calibration zip of that date; to do without, data.calibration=optional"
                )
        return found

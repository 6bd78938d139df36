"""Your own pictures with depth: folders or patterns of files, or a list of frames."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from eldenet.data.base import SPARSE, FileDataset, SampleOptions, check_pair
from eldenet.data.camera_files import Camera, read_camera
from eldenet.data.frame_lists import stated_scale
from eldenet.data.io import Encoding, depth_encoding, is_turned, read_depth, read_image, read_raw_depth
from eldenet.data.paths import composed, find_root, natural_order
from eldenet.data.recording_layout import TOLERANCE, Layout, RecordedFrame
from eldenet.data.splits import val_blocks, val_scenes
from eldenet.geometry import resample_depth, resize_sparse, same_aspect
from eldenet.system.checks import one_of
from eldenet.system.files import read_text
from eldenet.types import Frame

FOLDER_TREE = """
images/a.jpg, images/b.jpg ...     depths/a.png, depths/b.png ...     (other trees: eldenet check-data FOLDER)
"""
PARTS = {"train": "train", "training": "train", "test": "test"}
PARTS |= dict.fromkeys(("val", "valid", "validation"), "val")


class FolderDataset(FileDataset):
    """Pictures and depth maps in folders, matched by name, time or order, or paired by a list.

    Depth maps of another size than their pictures are resampled to it
    (:func:`~eldenet.geometry.resample_depth`). A picture is turned as its EXIF tag says only where its depth
    map is upright.

    Folders named train, val and test are these parts. Else the split is by scenes where there are several, or
    by blocks of frames that follow each other in the order of their names (2 before 10): neighboring frames
    of a recording look nearly the same, so a frame-by-frame split would test on what was trained. Better
    still, name validation frames of other places in ``val_names``.

    Args:
        root: the data set's folder.
        images: pictures below ``root``: a folder, a pattern of folders (``*/rgb``: one per scene) or of files
            (``*_color.png``), or a list in TUM's format (``rgb.txt``).
        depths: depth maps below ``root``, given in the same ways.
        csv: list of frames below ``root``, which replaces ``images`` and ``depths``: lines ``image,depth``,
            a CSV with a header (image, depth, confidence, fx, fy, cx, cy, scene), TUM's
            ``associations.txt``, or Nerfstudio's ``transforms.json``.
        allow_outside: let the list name files outside ``root`` (``../`` or absolute paths).
        confidence: confidence maps, given as ``depths``, with the same names; None: there are none.
        min_confidence: depth of a lower confidence is unknown (ARKit: 0 low, 1 medium, 2 high).
        pair_by: "name", "time" or "order"; None: by time for lists in TUM's format, else by name.
        tolerance: largest difference of time [s] between a picture and its depth map.
        rotate_depth: degrees by which depth and confidence maps are turned clockwise: 0, 90, 180 or 270.
        encoding: of the depth files: a name in :data:`eldenet.data.io.ENCODINGS`, or
            ``{scale: meters per step, offset: steps, dtype: uint8 | uint16 | int32 | float}``.
        intrinsics: of one camera: ``[fx, fy, cx, cy]`` or ``(3, 3)`` [px], a table of fx, fy, cx, cy, width
            and height, or a file below ``root``; or a folder or pattern of one file per picture. Numbers
            without a size describe the pictures on disk or the depth maps, as the principal point tells;
            pictures must then have one size. None: those of the list, or unknown.
        split: "train", "val", "all", or "test", if a folder is named so.
        val_fraction: share of the blocks or scenes for validation.
        blocks: how many blocks the frames are cut into.
        gap: frames left out of both parts on each side of a validation block.
        split_seed: decides which blocks or scenes are for validation.
        val_names: validation frames, instead of blocks: a list of names, or a text file with one per line.
        ground_truth: "raw", "inpainted" or "sparse": what the depth is, for reports.
        **options: see :class:`~eldenet.data.base.DepthDataset`; ``max_depth`` has no default here.

    Raises:
        FileNotFoundError: a picture has no depth, depth has no picture, or files are missing.
        ValueError: settings are out of range or do not fit together.
    """

    depth_range = (1e-3, None)

    def __init__(
        self,
        root: str | Path,
        *,
        images: str = "images",
        depths: str = "depths",
        csv: str | None = None,
        allow_outside: bool = False,
        confidence: str | None = None,
        min_confidence: int = 1,
        pair_by: str | None = None,
        tolerance: float = TOLERANCE,
        rotate_depth: int = 0,
        encoding: Encoding = "mm",
        intrinsics: Sequence[Any] | Mapping[str, Any] | str | None = None,
        split: str = "all",
        val_fraction: float = 0.1,
        blocks: int = 10,
        gap: int = 0,
        split_seed: int = 0,
        val_names: Sequence[str] | str | Path | None = None,
        ground_truth: str = "raw",
        **options: Unpack[SampleOptions],
    ) -> None:
        one_of("split", split, ("train", "val", "test", "all"))
        one_of("ground_truth", ground_truth, ("raw", "inpainted", "sparse"))
        one_of("rotate_depth", rotate_depth, (0, 90, 180, 270))
        layout = Layout(images, depths, csv, allow_outside, confidence, pair_by, tolerance, intrinsics)
        self.encoding, self.ground_truth = depth_encoding(encoding), ground_truth
        self.min_confidence, self.rotate_depth = min_confidence, rotate_depth
        if not isinstance(intrinsics, str):
            layout.camera(Path())  # a mistake in numbers needs no folder

        folder = find_root(root, None, layout.needed, FOLDER_TREE)
        self.camera = layout.camera(folder)
        self._check_scale(folder, csv)
        self.frames = layout.frames(folder, strict=options.get("on_error") != "skip")
        every = names = sorted(self.frames, key=natural_order)
        parts = named_parts([self.frames[name] for name in names])
        if split == "test" and "test" not in parts:
            raise ValueError(f"split='test': {folder} has no folders train and test; give 'val' or 'all'")
        if split in ("train", "val") and val_names is not None:
            names = _named(names, val_names, wanted=split == "val")
        elif split != "all" and parts:
            part = split if split in parts else next(one for one in parts if one != "train")
            names = [name for name, one in zip(names, parts, strict=True) if one == part]
        elif split != "all":
            scenes = [self.frames[name].scene for name in names]
            val, left_out = val_scenes(scenes, val_fraction, split_seed), list[int]()
            if not val:
                val, left_out = val_blocks(len(names), val_fraction, blocks, gap, split_seed)
            chosen = val if split == "val" else sorted(set(range(len(names))) - set(val) - set(left_out))
            names = [names[i] for i in chosen]
        super().__init__(folder, names, [self._files_of(name) for name in names], **options)
        self.calibrated: tuple[Path, tuple[int, int]] | None = None  # the picture that sets the size
        if self.camera is not None and self.camera.size is None:  # the same for all splits
            self._calibrate(self.camera, every)

    def _check_scale(self, root: Path, csv: str | None) -> None:
        scale = None if csv is None or self.encoding.dtype == "float" else stated_scale(root / csv)
        if scale is not None and not np.isclose(scale, self.encoding.scale):
            raise ValueError(
                f"{root / str(csv)} states {scale:g} m per step, encoding={self.encoding.name} has "
                f"{self.encoding.scale:g}: set data.encoding={{scale: {scale:g}}}"
            )

    def _files_of(self, name: str) -> tuple[str, ...]:
        frame = self.frames[name]
        return frame.files + ((frame.camera,) if isinstance(frame.camera, str) else ())

    def _calibrate(self, camera: Camera, names: Sequence[str]) -> None:
        """Let the first frame that can be read say which size the intrinsics describe."""
        for name in names:
            try:
                size, depth_size = (a.shape[:2] for a in self._read(self.frames[name]))
            except (ValueError, OSError):  # reported when its frame is read
                continue
            matrix = camera.at_size((size[0], size[1]), (depth_size[0], depth_size[1]))
            self.calibrated = (self.root / self.frames[name].files[0], (size[0], size[1]))
            self.camera = camera._replace(matrix=matrix, size=self.calibrated[1])
            return

    def frame_settings(self) -> dict[str, object]:
        """Return encoding and camera."""
        cameras = [self.camera, *(frame.camera for frame in self.frames.values())]
        return {
            "encoding": self.encoding.description,
            "intrinsics": [(c.matrix.tolist(), c.size) for c in cameras if isinstance(c, Camera)],
            "rotate_depth": self.rotate_depth,
            "min_confidence": self.min_confidence,
        }

    def load_frame(self, index: int) -> Frame:
        """Read one picture and its depth, at the size of the picture."""
        name = self.names[index]
        frame = self.frames[name]
        image, depth = self._read(frame)
        size, depth_size = (image.shape[0], image.shape[1]), (depth.shape[0], depth.shape[1])
        if self.calibrated is not None and size != self.calibrated[1]:
            first, other = self.calibrated
            raise ValueError(
                f"{self.root / frame.files[0]} is {size}, {first} is {other} (height, width), but intrinsics "
                "describe one camera: resize the pictures to one size, put each size into its own folder, or "
                "leave intrinsics out (null)"
            )
        if depth_size != size:
            depth = (resize_sparse if self.ground_truth in SPARSE else resample_depth)(depth, size)
        camera = self.camera_of(name)
        return Frame(image, depth, None if camera is None else camera.at_size(size, depth_size), name)

    def camera_of(self, name: str) -> Camera | None:
        """Return the camera of a frame: its own file's, the settings' or the list's; None: unknown."""
        found = self.frames[name].camera
        if isinstance(found, str):
            return read_camera(self.root / found)
        return self.camera or found

    def _read(self, frame: RecordedFrame) -> tuple[np.ndarray, np.ndarray]:
        """Read a picture ``(H, W, 3)`` and its depth ``(h, w)`` [m], of one aspect."""
        image_file, depth_file, *rest = (self.root / file for file in frame.files)
        image, depth = read_image(image_file), read_depth(depth_file, self.encoding)
        for file in rest:
            confidence = read_raw_depth(file)
            check_pair(depth.shape, depth_file, confidence.shape, file)
            depth = np.where(confidence >= self.min_confidence, depth, np.float32(0))
        depth = np.ascontiguousarray(np.rot90(depth, -self.rotate_depth // 90))
        shapes = image.shape[:2], depth.shape
        if not same_aspect(*shapes) and same_aspect(shapes[0][::-1], shapes[1]):
            if is_turned(image_file):
                return read_image(image_file, upright=True), depth
            raise ValueError(
                f"{depth_file} is turned by 90 degrees against {image_file}: set data.rotate_depth=90 "
                "(clockwise) or 270, and look at the contact sheet of eldenet check-data"
            )
        if not same_aspect(*shapes):
            high, wide, *_ = image.shape
            raise ValueError(
                f"{image_file} is {high}x{wide}, {depth_file} is {depth.shape[0]}x{depth.shape[1]} (height x "
                "width): depth of another shape shows another view; align it to the pictures first"
            )
        return image, depth


def named_parts(frames: Sequence[RecordedFrame]) -> list[str]:
    """Return "train", "val" or "test" of each frame, if folders or scenes are named so; else nothing."""
    folders = [f"{frame.scene}/{frame.files[0]}".lower().split("/")[:-1] for frame in frames]
    parts = [next((PARTS[folder] for folder in above if folder in PARTS), "") for above in folders]
    return parts if "train" in parts and "" not in parts and len(set(parts)) > 1 else []


def _named(names: Sequence[str], val_names: Sequence[str] | str | Path, *, wanted: bool) -> list[str]:
    if isinstance(val_names, str | Path):
        text = read_text(Path(val_names).expanduser(), "val_names must be a list of names, or a text file")
        val_names = [line.strip() for line in text.splitlines() if line.strip()]
    wanted_names = set(map(composed, val_names))
    unknown = sorted(wanted_names - set(names))
    if unknown:
        raise ValueError(
            f"{len(unknown)} of val_names are not in the data set: {', '.join(unknown[:10])}: give names "
            f"such as {names[0]!r}"
        )
    return [name for name in names if (name in wanted_names) == wanted]

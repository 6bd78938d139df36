"""The parts of a data set as a protocol shows them: for training, validation and scoring."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from eldenet.configurable import instantiate
from eldenet.data.base import SPARSE, Compose, DepthDataset
from eldenet.data.resize_crop import ResizeCrop
from eldenet.data.splits import split_settings, subset_of
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.geometry import pinhole, resize_intrinsics
from eldenet.types import Frame

logger = logging.getLogger("eldenet")


class Splits(NamedTuple):
    """The three parts of a data set: one resized for training, and two with their own ground truth."""

    train: DepthDataset
    val: DepthDataset
    test: DepthDataset


def chosen_protocol(data: Mapping[str, Any], protocol: Mapping[str, Any] | None) -> EvalProtocol:
    """Return the protocol whose settings are given, else the data set's own."""
    chosen: EvalProtocol = instantiate(protocol or data["protocol"], "protocol")
    return chosen


def open_splits(
    data: Mapping[str, Any],
    protocol: EvalProtocol,
    augmentation: Mapping[str, Any] | None = None,
    *,
    seed: int = 0,
    labeled: bool = True,
) -> Splits:
    """Open all parts of a data set and check that they can be scored: better now than after a training.

    ``data`` are its settings, as ``configs/data`` holds them; with ``labeled``, training frames need a known
    depth.

    Raises:
        ValueError: the protocol does not fit the frames, or no pixel of a part is known.
    """
    train = open_split(data, "train", protocol, augmentation=augmentation, seed=seed)
    val = open_split(data, "val", protocol)
    test = open_split(data, "test", protocol, score=True)
    for frames in (val, test):
        _refuse_unknown(frames, protocol, scored=True)
    if labeled:
        _refuse_unknown(train, protocol, scored=False)
    return Splits(train, val, test)


class OwnShape(NamedTuple):
    """Images keep their frame's shape, as in ``predict`` (:class:`~eldenet.data.base.DepthDataset`)."""

    size: tuple[int, int]  # (height, width) [px] of frames of the training's shape
    stretch: float = 1.0  # of the training: by how much its images are wider than its frames


def open_split(
    data: Mapping[str, Any],
    split: str,
    protocol: EvalProtocol,
    *,
    augmentation: Mapping[str, Any] | None = None,
    score: bool = False,
    seed: int = 0,
    input_size: "Sequence[int] | OwnShape | None" = None,
    frames: int | None = None,
) -> DepthDataset:
    """Open one part of a data set: resized for training, or with its own ground truth for scoring.

    Args:
        data: settings of the data set, as ``configs/data`` holds them.
        split: "train", "val" or "test".
        protocol: whose frame geometry (resize, crop) is applied first.
        augmentation: settings of what follows, for training; None or empty: nothing.
        score: keep the ground truth's own resolution in "train" too, and read frames at their full size.
        seed: of the augmentation.
        input_size: ``(height, width)`` [px] that the network sees, or :class:`OwnShape`; None: what ``data``
            says.
        frames: for rendered scenes, the number of first frames of the split to use instead of its own choice.

    Raises:
        ValueError: there is no such split, or the protocol does not fit its ground truth.
    """
    settings, subset = split_settings(data, split), subset_of(data).get(split)
    stretch = None
    if isinstance(input_size, OwnShape):
        input_size, stretch = input_size
    steps: list[Any] = []
    if protocol.changes_frames:
        whole = protocol.paste and (score or split != "train")
        steps.append(frame_geometry(protocol, keep_depth=whole))
    changes: dict[str, Any] = {}
    if input_size is not None:
        changes["input_size"] = list(input_size)
    if frames is not None:
        changes["frames"] = frames
    if settings.get("resize_on_load") is not None and (score or protocol.changes_frames):
        changes |= {"resize_on_load": None, "cache": "none"}
        if protocol.changes_frames:
            # the protocol speaks of the camera's frame: it must not find a smaller one (or keep whole ones)
            logger.info(
                "%s: resize_on_load and cache are off, because protocol %s resizes or crops the frames first",
                split,
                protocol.name,
            )
    if augmentation:  # augmentation=none is an empty section
        steps.append(instantiate(augmentation, "augmentation"))
    dataset = instantiate(
        settings,
        f"data.{split}",
        **changes,
        transform=Compose(steps) if steps else None,
        resize_depth=split == "train" and not score,
        seed=seed,
    )
    if score or split != "train":  # only the protocol says what is scored
        protocol.check_ground_truth(dataset.ground_truth)
        dataset.min_depth, dataset.max_depth = protocol.min_depth, protocol.max_depth
    dataset.stretch = stretch
    if dataset.on_error == "skip":
        dataset.leave_out_unreadable()
    if subset is not None and frames is None:
        dataset.draw_subset(subset, data.get("subset_seed", 0))
    if dataset.skipped:
        logger.warning(
            "%s: %d of %d frames left out, such as %s",
            split,
            len(dataset.skipped),
            len(dataset.skipped) + len(dataset.names),
            "; ".join(f"{name} ({reason})" for name, reason in list(dataset.skipped.items())[:3]),
        )
    return dataset


def _refuse_unknown(frames: DepthDataset, protocol: EvalProtocol, *, scored: bool) -> None:
    """Raise ValueError if no frame has a pixel that counts; frames are read until one has."""
    for sample in map(frames.__getitem__, range(len(frames))):
        depth, mask = sample["depth"][None], sample["mask"][None]
        # valid_mask raises where the protocol's crop does not fit the frame or its ground truth
        if (protocol.valid_mask(depth, mask) if scored else mask).any():
            return
    raise ValueError(
        f"no pixel of {len(frames)} frames such as {frames.names[0]} has a known depth that counts "
        f"({frames.min_depth:g} to {frames.max_depth:g} m, protocol {protocol.name}): check "
        "data.min_depth, data.max_depth and the unit of the depth files with eldenet check-data"
    )


def frame_geometry(protocol: EvalProtocol, *, keep_depth: bool = False) -> ResizeCrop:
    """Return the transform that boxes, resizes and crops a frame as ``protocol`` says.

    ``keep_depth`` is that of :class:`~eldenet.data.resize_crop.ResizeCrop`.
    """
    return ResizeCrop(
        box=protocol.frame_box,
        resize=protocol.resize,
        crop=protocol.frame_crop,
        anchor=protocol.frame_anchor,
        size=protocol.frame_size,
        sparse=protocol.ground_truth in SPARSE,
        keep_depth=keep_depth,
    )


def whole_frame_size(
    protocol: EvalProtocol, frame_size: tuple[int, int], input_size: Sequence[int] | None
) -> tuple[int, int]:
    """Return the ``(height, width)`` [px] of a whole frame at the scale at which a network sees its part.

    Args:
        protocol: cuts the part out of the frame.
        frame_size: ``(height, width)`` of the whole frame [px].
        input_size: ``(height, width)`` to which the part is resized for the network [px]; None: it is not.

    Example: KITTI's 375 x 1242, of which the lowest 352 x 1216 are seen at 176 x 608: 188 x 621.
    """
    blank = np.zeros((*frame_size, 3), np.uint8), np.zeros(frame_size, np.float32)
    part = frame_geometry(protocol)(Frame(*blank, pinhole(1, 1, 0, 0), "a training frame"))
    scale = part.intrinsics  # focal lengths were 1
    assert scale is not None
    if input_size is not None:
        height, width = input_size
        scale = resize_intrinsics(scale, part.depth.shape, (int(height), int(width)))
    return round(frame_size[0] * scale[1, 1]), round(frame_size[1] * scale[0, 0])

"""What a person should know about a training's frames and scores: lines before and after it."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eldenet.data.base import DepthDataset
from eldenet.data.inspection import identities
from eldenet.data.mix import Mix
from eldenet.evaluation.splits import Splits
from eldenet.losses.base import WeightedSum
from eldenet.losses.distillation import DistilledTerm
from eldenet.model import DepthNet
from eldenet.system.files import displayed
from eldenet.system.resources import Resources
from eldenet.training.trainer import Trainer

LOOKED_AT = 5  # frames of a data set


def before(
    splits: Splits,
    loss: WeightedSum,
    model: DepthNet,
    data: Mapping[str, Any],
    resources: Resources,
    folder: Path,
) -> Iterator[str]:
    """Yield lines: the frames, those trained on and scored, the teacher, no camera, depth out of range."""
    yield (
        f"{data['name']}: {len(splits.train)} training and {len(splits.val)} validation frames; "
        f"{resources.device}, {resources.precision}, {resources.threads} threads, {resources.workers} "
        f"workers; run folder {displayed(folder)}"
    )
    for split, frames in (("validation", splits.val), ("test", splits.test)):
        if count := common_frames(splits.train, frames):
            yield f"note: {count} of {len(frames)} {split} frames are also training frames"
    for term in loss.terms.values():
        if isinstance(term, DistilledTerm):
            yield term.teacher.describe(data["input_size"])
            if model.canonical_px and not getattr(term.teacher.network, "canonical_px", None):
                yield (
                    f"note: teacher {term.teacher.source} has no canonical camera: its meters are only right "
                    "for the lens of its training, and not where augmentation zooms, unless "
                    "augmentation.zoom=depth"
                )
    if model.canonical_px is not None and (frame := without_camera(splits.train)):
        yield (
            f"note: training frames such as {frame} have no intrinsics, so they count as the canonical "
            "camera's: meters will be off by as much as their focal length differs (data=folder takes "
            "data.intrinsics)"
        )
    yield from out_of_range(splits.train)


def after(splits: Splits, trainer: Trainer, record: Mapping[str, Any]) -> Iterator[str]:
    """Yield lines: scored frames that chose the epoch, and a network that has learned nothing."""
    chosen_of_several = trainer.epochs > trainer.evaluate_every
    if chosen_of_several and (shared := common_frames(splits.val, splits.test)):
        yield (
            f"note: the best epoch was chosen on {shared} of the {len(splits.test)} frames that are scored, "
            "so the scores are a little too good"
        )
    if line := collapse(record):
        yield f"{line}. Try a lower optimizer.lr, more trainer.epochs, or trainer.max_grad_norm=1"


def collapse(record: Mapping[str, Any]) -> str:
    """Return a warning if delta1 and AbsRel are worse than the constant predictor's; else ""."""
    found, constant = record["metrics"], record["constant_predictor"]
    if constant is None or not (
        found["delta1"] < constant["delta1"] and found["abs_rel"] > constant["abs_rel"]
    ):
        return ""
    return (
        f"warning: the network is worse than a constant depth map (delta1 {found['delta1']:.3f} and AbsRel "
        f"{found['abs_rel']:.3f}; the map: {constant['delta1']:.3f} and {constant['abs_rel']:.3f}): it has "
        "learned nothing that holds on these frames"
    )


def without_camera(train_set: DepthDataset) -> str:
    """Return the name of a frame in meters without intrinsics; "" if the first of each source has them."""
    parts = parts_in_meters(train_set)
    return next((part.names[0] for part in parts if part.load_frame(0).intrinsics is None), "")


def out_of_range(train_set: DepthDataset) -> Iterator[str]:
    """Yield a warning for each source with most depth outside its range, judged by a few frames."""
    for part in parts_in_meters(train_set):
        some = range(0, len(part.names), -(-len(part.names) // LOOKED_AT))
        depth = np.concatenate([part.load_frame(index).depth.ravel() for index in some])
        depth = depth[depth > 0]
        within = np.mean((depth >= part.min_depth) & (depth <= part.max_depth)) if depth.size else 1.0
        if within < 0.5:
            yield (
                f"warning: of the depth in frames such as {part.names[0]} (median {np.median(depth):.3g} m), "
                f"{1 - within:.0%} is outside {part.min_depth:g} to {part.max_depth:g} m and not used: is "
                "the unit right? Else set data.min_depth and data.max_depth"
            )


def parts_in_meters(train_set: DepthDataset) -> list[DepthDataset]:
    """Return the data set, or the sources of a mix whose depth is in meters."""
    if isinstance(train_set, Mix):
        return [source.dataset for source in train_set.sources.values() if not source.relative]
    return [train_set]


def common_frames(train_set: DepthDataset, scored: DepthDataset) -> int:
    """Return how many frames of ``scored`` are in ``train_set`` too: their scores measure memory, or luck."""
    return len(identities(train_set).keys() & identities(scored).keys())

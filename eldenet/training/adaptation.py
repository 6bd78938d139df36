"""Weights for the user's own camera and place, tuned on depth frames of any sensor.

The frames are cut into blocks of time. Some are held out; a result is only kept if it is better on them.
"""

import copy
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

import eldenet
from eldenet.compose import listed
from eldenet.configurable import instantiate
from eldenet.data.base import SPARSE, DepthDataset
from eldenet.data.loaders import collate
from eldenet.data.splits import evenly_spaced
from eldenet.evaluation.calibration import fit_temperature
from eldenet.evaluation.evaluator import PER_IMAGE_HEADER, evaluate, predict_depth
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.geometry import resize_image, size_of_aspect
from eldenet.model import DepthNet, eval_mode, merge_info, size_of_frames
from eldenet.results.before_after import (
    Change,
    check_scale,
    compare,
    is_improvement,
    panel_size,
    record_change,
    refuse_copies,
    say_changes,
    thumbnail,
)
from eldenet.results.run_log import RunLog
from eldenet.system.files import write_rows
from eldenet.system.resources import Resources
from eldenet.training.trainer import Trainer, TrainingData
from eldenet.visualization import photo_beside_depths, stack_rows, visible_range, write_picture

LEAST_FRAMES, LEAST_HELD_OUT = 30, 8
LEAST_PIXELS = 50  # of known depth, for a frame to count
LEAST_SPREAD = 0.002  # of the depth of a frame, relative; less is no measurement
LEAST_LIKENESS = -0.2  # correlation of depth with a prediction; less is inverse depth
BATCH = 8  # frames, to measure the time of an update
COUNTED = 200  # training frames that are read to count known pixels and to fit the scale
METRICS = ("abs_rel", "rmse", "delta1")  # of the table
TITLES = ("image", "truth", "before", "after")


def tune(s: Mapping[str, Any], folder: Path, resources: Resources) -> bool:
    """Tune, compare with the start on held-out frames, keep the better network; return whether it is new.

    Two candidates are compared with the start: one with another scale alone, and one with all weights
    trained from there. Writes ``model/``, ``run.json``, ``held_out.csv`` and ``before_after.png`` into the
    run folder.

    ``s`` are the settings of ``eldenet adapt``, which ``run.json`` stores.

    Raises:
        ValueError: there are too few frames with depth, or copies of few; their depth is the same everywhere,
            or inverse; its factor is not plausible; or the settings do not fit.
    """
    started = time.monotonic()
    log, trusted = RunLog(folder), listed(s["trusted_modules"])
    protocol = chosen_protocol(s["data"], s["protocol"])
    start = eldenet.load(s["weights"], trusted_modules=trusted)
    size, train_set, plain_set, held_out = make_frames(
        s["data"], protocol, s["augmentation"], start, seed=s["seed"]
    )
    known = refuse_unfit(plain_set, held_out)
    log.say(
        f"{s['weights']} sees {len(train_set)} frames at {size[0]} x {size[1]}; {len(held_out)} frames in "
        "blocks of time of their own are held out"
    )
    if start.canonical_px is not None and plain_set[0]["intrinsics"][0, 0] <= 0:
        log.say("note: without intrinsics the canonical camera is assumed, now and in each later prediction")
    start.to(resources.device)
    before = _score(start, as_predicted(held_out, start), protocol, resources)
    model = copy.deepcopy(start)
    beside = beside_prediction(model, [plain_set[index] for index in known])
    refuse_odd_depth(beside)
    scale = scale_of(beside)
    unit = "data.encoding" if s["source"] is None else "the meters of the poses"
    check_scale(scale, f"{unit}, intrinsics [px] and weights", force=s["force"])
    model.rescale(scale)
    scaled = copy.deepcopy(model)
    scaled.info = merge_info(scaled.info, {"input_size": list(size)})  # at which the scale was measured
    loss = instantiate(s["loss"], "loss")
    left = 60 * s["minutes"] - (time.monotonic() - started)
    epochs = affordable_epochs(model, train_set, left, most=s["trainer"]["epochs"], seed=s["seed"])
    log.say(
        f"depth of the start times {scale:.2f}, then {epochs} epochs of training on {len(train_set)} frames"
    )
    trainer: Trainer = instantiate(
        s["trainer"],
        "trainer",
        optimizer=instantiate(s["optimizer"], "optimizer"),
        scheduler=instantiate(s["scheduler"], "scheduler"),
        seed=s["seed"],
        loggers=(),
        epochs=epochs,
        evaluate_every=epochs,
    )
    trainer.fit(
        model,
        loss,
        TrainingData(train_set, held_out, protocol),
        folder / "training",
        resources,
        info={"input_size": list(size)},
    )
    model = DepthNet.from_pretrained(folder / "training" / "model", trusted_modules=trusted)
    model.to(resources.device)
    models = {"all weights": model, "the scale alone": scaled}
    rows = {name: _score(models[name], held_out, protocol, resources) for name in models}
    changes = {name: _changes(before, rows[name]) for name in models}
    chosen = best_candidate(changes)
    say_changes(log, f"{len(held_out)} frames held out in blocks of time; tuned: {chosen}", changes[chosen])
    write_held_out(folder, before, rows[chosen])
    _draw(folder / "before_after.png", held_out, start, models[chosen])
    tuned = models[chosen]
    if tuned.distribution is not None:  # its sigma was right for the start's errors
        temperature = fit_temperature(tuned, held_out, protocol)
        tuned.info |= {"temperature_from": "held-out frames"}
        log.say(f"sigma of the held-out frames, which were not trained on: times {temperature:.2f}")
    facts = {
        "tuned": chosen,
        "scale": scale,
        "epochs": epochs,
        "training_frames": len(train_set),
        "input_size": list(size),
        "seconds": time.monotonic() - started,
        "config": dict(s),
    }
    return record_change(folder, log, start, tuned, changes[chosen], s["weights"], facts)


def best_candidate(changes: Mapping[str, Mapping[str, Change]]) -> str:
    """Return the name of the candidate with the smallest error; those worth keeping come first."""
    return min(changes, key=lambda name: (not is_improvement(changes[name]), changes[name][METRICS[0]].after))


def make_frames(
    data: Mapping[str, Any],
    protocol: EvalProtocol,
    augmentation: Mapping[str, Any],
    model: DepthNet,
    *,
    seed: int,
) -> tuple[tuple[int, int], DepthDataset, DepthDataset, DepthDataset]:
    """Return the size that the network sees [px], training frames, the same unaugmented, held-out frames."""
    first = open_split(data, "val", protocol, seed=seed).load_frame(0).image.shape
    stretch = float(model.info.get("stretch") or 1.0)
    seen = size_of_frames(model.info)
    aspect = (first[0], first[1] * stretch)
    size = (first[0], first[1]) if seen is None else size_of_aspect((seen[0], seen[1]), aspect)
    if data.get("resize_on_load") is None:  # as training frames of a data set with an input size
        data = {**data, "train": {**data["train"], "resize_on_load": list(size)}}
    if "zoom" in augmentation:  # what a zoom changes, for a network of any lens and of one lens
        of_any_lens = model.config.get("canonical_focal") is not None
        augmentation = {**augmentation, "zoom": "focal" if of_any_lens else "depth"}
    train_set = open_split(data, "train", protocol, augmentation=augmentation, seed=seed, input_size=size)
    plain_set = open_split(data, "train", protocol, seed=seed, input_size=size)
    plain_set.cache = "none"  # each frame is read once
    return size, train_set, plain_set, open_split(data, "val", protocol, seed=seed, input_size=size)


def as_predicted(frames: DepthDataset, model: DepthNet) -> DepthDataset:
    """The same frames as ``predict`` shows them to a network that was not trained on their shape."""
    shown, seen = copy.copy(frames), size_of_frames(model.info)
    if seen is not None:
        shown.input_size, shown.stretch = (seen[0], seen[1]), float(model.info.get("stretch") or 1.0)
    return shown


def refuse_unfit(frames: DepthDataset, held_out: DepthDataset) -> list[int]:
    """Return the numbers of training frames with enough known depth, of ``COUNTED`` evenly chosen ones.

    Raises:
        ValueError: they, or those of the held-out frames, are too few to calibrate a camera, or most of the
            held-out frames are copies of training frames.
    """
    seen, of_held_out = (_with_depth(split) for split in (frames, held_out))
    known = list(seen)
    found = len(known) + len(of_held_out)
    if not known or found < LEAST_FRAMES or len(of_held_out) < LEAST_HELD_OUT:
        raise ValueError(
            f"{len(known)} training frames and {len(of_held_out)} held-out frames have a known depth at "
            f"{LEAST_PIXELS} pixels or more: {LEAST_FRAMES} in all and {LEAST_HELD_OUT} held out are needed, "
            "without those that data.gap leaves out beside held-out blocks. A few known distances do not "
            "calibrate a camera, because the error of the depth differs from image to image. Record a few "
            "hundred frames or a longer drive, or give camera_height= and source= alone"
        )
    refuse_copies(list(of_held_out.values()), list(seen.values()))
    return known


def _with_depth(frames: DepthDataset) -> dict[int, np.ndarray]:
    """Thumbnails of ``COUNTED`` evenly chosen frames, without those that know too little depth."""
    found = {}
    for index in evenly_spaced(len(frames), COUNTED):
        frame = frames.load_frame(index)
        if (frame.depth > 0).sum() >= LEAST_PIXELS:
            found[index] = thumbnail(frame.image)
    return found


class Beside(NamedTuple):
    """Known depth of a frame beside the prediction.

    Attributes:
        scale: the factor that the prediction lacks: the ratio of the medians.
        likeness: correlation of ln depth with ln prediction; 0 where one of them is the same everywhere.
        spread: of the known depth: from its 5th to its 95th percentile, relative to the median.
    """

    scale: float
    likeness: float
    spread: float


def scale_of(frames: Sequence[Beside]) -> float:
    """Return the factor that the predictions lack: the median over the frames."""
    return float(np.exp(np.median(np.log([frame.scale for frame in frames]))))


def refuse_odd_depth(frames: Sequence[Beside]) -> None:
    """Raise ValueError if the known depth is the same everywhere in most frames, or inverse."""
    flat = sum(frame.spread < LEAST_SPREAD for frame in frames)
    if flat > len(frames) / 2:
        raise ValueError(
            f"the depth is the same everywhere in {flat} of {len(frames)} frames: give what a sensor measured"
        )
    likeness = float(np.median([frame.likeness for frame in frames]))
    if likeness < LEAST_LIKENESS:
        raise ValueError(
            f"what is near in the pictures has large numbers in the depth maps (correlation with the "
            f"prediction {likeness:.2f}): is it inverse depth or disparity? Convert it to depth"
        )


@torch.inference_mode()
def beside_prediction(model: DepthNet, samples: Sequence[Mapping[str, Any]]) -> list[Beside]:
    """Return how the known depth of each sample compares with the prediction."""
    device = next(model.parameters()).device
    found = []
    with eval_mode(model):
        for sample in samples:
            predicted = predict_depth(
                model, sample["image"][None].to(device), sample["intrinsics"][None, 0, 0].to(device)
            )
            depth, mask = sample["depth"], sample["mask"]
            guess = torch.nn.functional.interpolate(predicted.cpu(), depth.shape[-2:], mode="bilinear")[0]
            if mask.any():
                known, seen = depth[mask].double().numpy(), guess[mask].double().numpy()
                middle = float(depth[mask].median())
                low, high = np.percentile(known, (5, 95))
                known, seen = np.log(known), np.log(seen)
                both = known.std() * seen.std()
                likeness = ((known - known.mean()) * (seen - seen.mean())).mean() / both if both else 0.0
                scale = middle / float(guess[mask].median())
                found.append(Beside(scale, float(likeness), float(high - low) / middle))
    return found


def affordable_epochs(model: DepthNet, frames: DepthDataset, seconds: float, *, most: int, seed: int) -> int:
    """Return how many epochs fit into ``seconds``, at most ``most``.

    Where not even one fits, ``frames`` is cut to as many frames as do, a batch at least.
    """
    twin = copy.deepcopy(model).train()
    device = next(twin.parameters()).device
    batch = min(BATCH, len(frames))
    for _ in range(2):  # the first one warms up
        started = time.monotonic()
        images: Any = collate([frames[index] for index in range(batch)])["image"]
        twin(images.to(device)).mean().backward()
        if device.type == "cuda":
            torch.cuda.synchronize(device)
        took = (time.monotonic() - started) / batch
    draws = max(batch, int(0.8 * seconds / (1.5 * took)))  # loss, optimizer and scores take time
    if draws < len(frames):
        frames.draw_subset(draws, seed)
    return max(1, min(most, draws // len(frames)))


def write_held_out(folder: Path, before: Sequence[Sequence[Any]], after: Sequence[Sequence[Any]]) -> None:
    """Write ``held_out.csv``: each frame's metrics before and after."""
    header = ["name", *(f"{name}_{when}" for when in ("before", "after") for name in PER_IMAGE_HEADER[1:])]
    write_rows(
        folder / "held_out.csv", header, [[*old, *new[1:]] for old, new in zip(before, after, strict=True)]
    )


def _score(
    model: DepthNet, frames: DepthDataset, protocol: EvalProtocol, resources: Resources
) -> list[tuple[Any, ...]]:
    return evaluate(model, frames, protocol, device=resources.device, workers=resources.workers).rows


def _changes(before: list[tuple[Any, ...]], after: list[tuple[Any, ...]]) -> dict[str, Change]:
    columns = {metric: PER_IMAGE_HEADER.index(metric) for metric in METRICS}
    return {
        metric: compare(metric, [row[c] for row in before], [row[c] for row in after])
        for metric, c in columns.items()
    }


@torch.inference_mode()
def _draw(path: Path, frames: DepthDataset, before: DepthNet, after: DepthNet) -> None:
    """Draw three held-out frames: image, truth, before, after, with a scale in meters."""
    import cv2

    device = next(after.parameters()).device
    rows = []
    for index in evenly_spaced(len(frames), 3):
        frame, sample = frames.load_frame(index), frames[index]
        size = panel_size(frame.image)
        truth = _nearest(sample["depth"][0].numpy(), size)
        if frames.ground_truth in SPARSE:  # single points are hard to see
            truth = cv2.dilate(truth, np.ones((5, 5), np.uint8))
        image, focal = sample["image"][None].to(device), sample["intrinsics"][None, 0, 0].to(device)
        maps = []
        for model in (before, after):
            with eval_mode(model):
                maps.append(_nearest(predict_depth(model, image, focal)[0, 0].cpu().numpy(), size))
        rows.append(
            photo_beside_depths(resize_image(frame.image, size), [truth, *maps], *visible_range(truth))
        )
    write_picture(path, stack_rows(rows, TITLES))


def _nearest(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    import cv2

    return np.asarray(cv2.resize(depth, size[::-1], interpolation=cv2.INTER_NEAREST_EXACT))

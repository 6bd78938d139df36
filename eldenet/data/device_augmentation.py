"""Augment a batch where the network is: what :class:`~eldenet.data.transforms.Augmentation` does on CPUs.

Workers draw what happens to a frame (:meth:`~eldenet.data.transforms.Augmentation.draw`) and resize it; the
batch is moved and recolored at once, on any device.

Convention: as albumentations, except that colors are not rounded to 8 bits in between, and that a frame is
resized first (its movement is the same, at the smaller size).
"""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from eldenet.data.base import Compose, DepthDataset, Size, frame_tensors
from eldenet.data.transforms import IDENTITY, Augmentation, Change
from eldenet.geometry import BORDER_COLOR
from eldenet.types import DepthSample, Frame

#: Seven numbers of a color change: x -> GAIN x + GRAY gray(x) + MEAN mean(gray(x)) + OFFSET; then HUE
#: [turns], SATURATION and VALUE are added.
GAIN, GRAY, MEAN, OFFSET, HUE, SATURATION, VALUE = range(7)
UNCHANGED = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
STAGES = 7  # one gray; brightness and contrast; four of the jitter; hue, saturation and value


def raw_sample(
    dataset: DepthDataset, frame: Frame, generator: np.random.Generator, size: Size | None
) -> DepthSample:
    """Return a frame of ``dataset``, as read, as a sample of ``size`` that :func:`augment` makes whole.

    All of the data set's transforms are done here, but for the :class:`~eldenet.data.transforms.Augmentation`
    at their end, which does what another camera would and only draws the rest.
    """
    transform = dataset.transform
    steps = transform.steps if isinstance(transform, Compose) else [] if transform is None else [transform]
    change: Change | None = None
    for step in steps:
        if isinstance(step, Augmentation) and step is steps[-1]:
            frame = step.as_of_another_camera(frame, generator)
            change = step.draw(frame, generator)
        else:
            frame = step(frame, generator)
    change = change or Change(frame.intrinsics)
    frame_size, frame = frame.depth.shape, frame._replace(intrinsics=change.intrinsics)
    if size is not None:
        frame = dataset.resized(frame, size)
    plan = {
        "matrix": sampling_matrix(change.matrix, frame_size, frame.depth.shape),
        "color": color_stages(change.color),
        "nearer": change.nearer,
        "range": np.array([dataset.min_depth, dataset.max_depth]),
    }
    planned = {name: torch.as_tensor(value, dtype=torch.float32) for name, value in plan.items()}
    return cast(DepthSample, frame_tensors(frame) | {"augmentation": planned})


def color_stages(draws: Sequence[tuple[Any, Mapping[str, Any]]]) -> np.ndarray:
    """Return the color changes ``(STAGES, 7)`` that albumentations' transforms drew, in their order.

    Raises:
        ValueError: another transform was drawn.
    """
    stages: list[tuple[float, ...]] = []
    for transform, drawn in draws:
        name = type(transform).__name__
        if name == "RandomBrightnessContrast":
            stages.append((drawn["alpha"], 0, 0, drawn["beta"] / 255, 0, 0, 0))
        elif name == "ColorJitter":
            brightness, contrast, saturation = drawn["brightness"], drawn["contrast"], drawn["saturation"]
            jitter = (
                (brightness, 0, 0, 0, 0, 0, 0),
                (contrast, 0, 1 - contrast, 0, 0, 0, 0),
                (saturation, 1 - saturation, 0, 0, 0, 0, 0),
                UNCHANGED,  # hue
            )
            stages += [jitter[which] for which in drawn["order"]]
        elif name == "HueSaturationValue":
            shifts = drawn["hue_shift"] / 180, drawn["sat_shift"] / 255, drawn["val_shift"] / 255
            stages.append((1, 0, 0, 0, *shifts))
        else:
            raise ValueError(f"{name} has no counterpart on a GPU")
    return np.array(stages + [UNCHANGED] * (STAGES - len(stages)), dtype=np.float32)


def sampling_matrix(
    matrix: np.ndarray, frame_size: tuple[int, int], sample_size: tuple[int, int]
) -> np.ndarray:
    """Return where each pixel comes from, ``(2, 3)`` in torch's coordinates (-1 to 1 between pixel centers).

    ``matrix (2, 3)`` is how the frame of ``frame_size`` moves [px]; it was resized to ``sample_size`` [px].
    """
    if np.array_equal(matrix, IDENTITY):
        return matrix
    (rows, cols), (height, width) = frame_size, sample_size
    across, down = width / cols, height / rows
    to_sample = np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2], [0, 0, 1]])
    to_torch = np.array([[2 / (width - 1), 0, -1], [0, 2 / (height - 1), -1], [0, 0, 1]]) @ to_sample
    moved = to_torch @ np.vstack([matrix, [0, 0, 1]]) @ np.linalg.inv(to_torch)
    return np.linalg.inv(moved)[:2]


def leave_out_idle(plan: Mapping[str, Tensor]) -> dict[str, Any]:
    """Leave out of a batch's plan what changes none of its frames: a device cannot know without waiting.

    Of ``matrix (B, 2, 3)``, ``color (B, 7, 7)`` and what is always needed, the plan keeps ``color`` as a list
    of stages ``(B, 7)``, and gets ``shifts``: of each stage, whether it shifts hue, saturation or value.
    """
    kept: dict[str, Any] = {name: value for name, value in plan.items() if name not in ("matrix", "color")}
    if not bool((plan["matrix"] == torch.from_numpy(IDENTITY)).all()):
        kept["matrix"] = plan["matrix"]
    changed = plan["color"] != torch.tensor(UNCHANGED)
    stages = [stage for stage in range(STAGES) if bool(changed[:, stage].any())]
    kept["color"] = [plan["color"][:, stage].contiguous() for stage in stages]
    kept["shifts"] = [bool(changed[:, stage, HUE:].any()) for stage in stages]
    return kept


def augment(batch: Mapping[str, Any]) -> dict[str, Any]:
    """Return a batch as the network takes it, from raw frames and their plan, all on one device.

    It has ``image (B, 3, H, W)`` uint8, ``depth (B, 1, H, W)`` [m] with any numbers, perhaps ``labels``, and
    ``augmentation``, from :func:`leave_out_idle`.
    """
    ready = {name: value for name, value in batch.items() if name != "augmentation"}
    plan = batch["augmentation"]
    image, depth = batch["image"].float().div_(255), batch["depth"]
    if "matrix" in plan:
        grid = F.affine_grid(plan["matrix"], list(image.shape), align_corners=True)
        border = [value / 255 for value in BORDER_COLOR]  # what zeros from beyond the border become
        for plane, value in zip(image.unbind(1), border, strict=True):
            plane.sub_(value)
        image = F.grid_sample(image, grid, align_corners=True)
        for plane, value in zip(image.unbind(1), border, strict=True):
            plane.add_(value)
        depth = F.grid_sample(depth, grid, mode="nearest", align_corners=True)
        if "labels" in batch:  # class 255 becomes 0 meanwhile, which is also the value from beyond the border
            labels = F.grid_sample((batch["labels"] + 1).float(), grid, mode="nearest", align_corners=True)
            ready["labels"] = labels.to(torch.uint8) - 1
    for stage, shifts in zip(plan["color"], plan["shifts"], strict=True):
        image = _recolored(image, stage[:, :, None, None, None], shifts=shifts)
    depth = depth / plan["nearer"].view(-1, 1, 1, 1)
    nearest, farthest = plan["range"].view(-1, 2, 1, 1, 1).unbind(1)
    mask = depth.isfinite() & (depth >= nearest) & (depth <= farthest)
    return ready | {"image": image, "depth": torch.where(mask, depth, 0.0), "mask": mask}


def _recolored(image: Tensor, stage: Tensor, *, shifts: bool) -> Tensor:
    """Apply one stage ``(B, 7, 1, 1, 1)`` to ``image (B, 3, H, W)``."""
    from kornia.color import hsv_to_rgb, rgb_to_grayscale, rgb_to_hsv

    gray = rgb_to_grayscale(image)
    mean = gray.mean((1, 2, 3), keepdim=True)
    tint = stage[:, GRAY] * gray + (stage[:, MEAN] * mean + stage[:, OFFSET])
    image = (stage[:, GAIN] * image + tint).clamp(0, 1)
    if not shifts:
        return image
    hue, saturation, value = rgb_to_hsv(image).unbind(1)
    amounts = stage[:, :, 0]
    hue = (hue + 2 * torch.pi * amounts[:, HUE]) % (2 * torch.pi)
    # gray stays gray
    saturation = torch.where(saturation > 0, (saturation + amounts[:, SATURATION]).clamp(0, 1), saturation)
    value = (value + amounts[:, VALUE]).clamp(0, 1)
    shifted = hsv_to_rgb(torch.stack([hue, saturation, value], 1))
    return torch.where((stage[:, HUE:] != 0).any(1), shifted, image)

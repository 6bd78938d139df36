"""A batch that is augmented on its device is the one that workers augment: same draws, same geometry."""

from functools import partial

import cv2
import numpy as np
import pytest
import torch
from support.synthetic import SyntheticDepth
from support.training import TWO_WORKERS, Stopped, digest, fit, make_trainer, stopping_at

from eldenet.data import transforms
from eldenet.data.base import Compose, DepthDataset
from eldenet.data.device_augmentation import raw_sample
from eldenet.data.loaders import collate, to_device, training_loader
from eldenet.data.mix import Mix
from eldenet.data.resize_crop import ResizeCrop
from eldenet.data.transforms import Augmentation
from eldenet.geometry import pinhole
from eldenet.types import Frame

OFF = {"flip": 0, "affine": 0, "brightness_contrast": 0, "color_jitter": 0, "hue_saturation": 0}
GEOMETRY = {**OFF, "flip": 0.5, "affine": 1, "scale": (0.8, 1.3), "rotate": 15, "shift": 0.1}

# workers round gray levels; OpenCV before 5 rounds positions to 1/32 px, too
EXACT = int(cv2.__version__.split(".")[0]) >= 5
MOST_THAT_DIFFER, MOST_GRAY = (1e-9, 0.6) if EXACT else (0.002, 3)  # share of pixels; of 255


class Walls(SyntheticDepth):
    """Slanted walls with colored waves, and a corner of unknown depth."""

    def load_frame(self, index: int) -> Frame:
        height, width = self.size
        y, x = np.indices(self.size) / max(self.size)
        phase = np.random.default_rng(index).uniform(0, 6, 3)
        image = 127 + 110 * np.sin(np.stack([9 * x, 7 * y, 5 * (x + y)], -1) + phase)
        depth = (1 + 5 * x + 3 * y).astype(np.float32)
        depth[: height // 6, : width // 6] = 0
        camera = pinhole(0.9 * width, 0.91 * width, 0.52 * width, 0.47 * height)
        labels = (3 * x).astype(np.uint8)
        labels[:3] = 255
        return Frame(image.astype(np.uint8), depth, camera, self.names[index], labels)


def both(data: DepthDataset) -> tuple[dict, dict]:
    """The batch of all frames of epoch 3, augmented by workers and on the device."""
    keys = [(3, index) for index in range(len(data))]
    here = collate([data[key] for key in keys])
    raw = data.with_samples(raw_sample)
    samples = [raw[key] for key in keys]
    assert samples[0]["image"].dtype == torch.uint8
    there = to_device(collate(samples), torch.device("cpu"), channels_last=True)
    assert {name: getattr(value, "dtype", None) for name, value in there.items()} == {
        name: getattr(value, "dtype", None) for name, value in here.items()
    }
    assert torch.equal(here["intrinsics"], there["intrinsics"])
    return here, there


def share_that_differs(here: dict, there: dict, name: str) -> float:
    return (here[name] != there[name]).float().mean().item()


@pytest.mark.parametrize("zoom", ["depth", "focal"])
def test_frames_of_the_network_s_size_move_alike(zoom):
    here, there = both(Walls(24, transform=Augmentation(**GEOMETRY, zoom=zoom)))
    for name in ("depth", "mask", "labels"):
        assert share_that_differs(here, there, name) < MOST_THAT_DIFFER
    assert (here["image"] - there["image"]).abs().max() < MOST_GRAY / 255


def test_frames_that_are_resized_first_move_alike():
    """But for pixels at edges: nearest is taken in another order."""
    steps = Compose([ResizeCrop(crop=(120, 240)), Augmentation(**GEOMETRY)])
    here, there = both(Walls(24, (144, 256), transform=steps, input_size=(96, 128)))
    known = here["mask"] & there["mask"]
    assert (here["mask"] != there["mask"]).float().mean() < 0.01
    assert (here["labels"] != there["labels"]).float().mean() < 0.02
    assert (here["depth"] / there["depth"] - 1)[known].abs().max() < 0.05
    assert (here["image"] - there["image"]).abs().mean() < 1 / 255
    assert not there["depth"][~there["mask"]].any()


@pytest.mark.parametrize(
    ("what", "mean"),
    [
        ({"brightness_contrast": 1}, 0.5),
        ({"color_jitter": 1}, 1),
        ({"hue_saturation": 1}, 2),
        ({"covered": 1}, 1),
        ({"camera": 1}, 1),
        ({"random_convolution": 1}, 1),
    ],
)
def test_colors_change_alike(what, mean, monkeypatch):
    """Within the 8 bits (hue: two degrees) to which OpenCV rounds each change; ``mean`` is in 255ths."""
    monkeypatch.setattr(transforms, "BRIGHTNESS_CONTRAST", 0.4)  # more than usual, so that a fault would show
    monkeypatch.setattr(transforms, "JITTER", (0.6, 1.4))
    monkeypatch.setattr(transforms, "HUE_SATURATION_VALUE", (30, 60, 40))
    plain = collate([Walls(24)[index] for index in range(24)])
    here, there = both(Walls(24, transform=Augmentation(**{**OFF, **what})))
    difference = (here["image"] - there["image"]).abs() * 255
    assert difference.mean() < mean
    assert difference.max() < 10 * mean
    assert (here["image"] - plain["image"]).abs().mean() * 255 > 5 * mean
    assert torch.equal(here["depth"], there["depth"])


def test_a_mix_and_frames_without_augmentation_are_the_same():
    sources = {"walls": {"data": Walls}, "far": {"data": partial(Walls, min_depth=2.0)}}
    mix = Mix(sources, 12, transform=Augmentation(**GEOMETRY))
    mix.sources["far"].dataset.transform = None
    here, there = both(mix)
    assert share_that_differs(here, there, "depth") < MOST_THAT_DIFFER
    assert (here["image"] - there["image"]).abs().max() < MOST_GRAY / 255
    assert here["name"] == there["name"]


@pytest.mark.slow
def test_workers_and_a_resume_change_nothing(tmp_path, monkeypatch):
    raw_loader = partial(training_loader, device="another")
    monkeypatch.setattr(
        "eldenet.training.trainer.training_loader",
        lambda data, sampler, *, workers, device: raw_loader(data, sampler, workers=workers),
    )
    fit(tmp_path / "whole", transform=Augmentation())
    stopping = make_trainer(stopping_at(6), checkpoint_every=1)
    with pytest.raises(Stopped):
        fit(tmp_path / "part", trainer=stopping, transform=Augmentation(), resources=TWO_WORKERS)
    fit(tmp_path / "part", transform=Augmentation(), ckpt_path=tmp_path / "part")
    assert digest(tmp_path / "part") == digest(tmp_path / "whole")

"""``trainer.aspect_ratios``: batches of many shapes, whose geometry holds, the same ones after a resume."""

from functools import partial

import numpy as np
import pytest
import torch
from support.synthetic import SyntheticDepth
from support.training import Stopped, digest, fit, make_trainer, stopping_at

from eldenet.data.base import DepthDataset
from eldenet.data.device_augmentation import raw_sample
from eldenet.data.loaders import EpochSampler, collate, to_device
from eldenet.data.mix import Mix
from eldenet.data.transforms import Augmentation
from eldenet.geometry import pinhole, size_of_aspect
from eldenet.types import Frame

SIZE = (48, 64)
RATIOS = [4 / 3, 2.0, 0.75]


class Plane(DepthDataset):
    """A plane ``n . (x, y, z) = 1`` in front of a camera."""

    ground_truth = "dense"
    normal = np.array([0.05, 0.12, 0.3])

    def __init__(self, **options) -> None:
        super().__init__(["plane"], min_depth=0.1, max_depth=20.0, **options)

    def load_frame(self, index: int) -> Frame:
        camera = pinhole(210.0, 210.0, 130.0, 90.0)
        depth = self.depth_of(camera, (192, 256)).astype(np.float32)
        return Frame(np.zeros((192, 256, 3), np.uint8), depth, camera, "plane")

    def depth_of(self, camera: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        y, x = np.indices(size)
        rays = np.stack([x, y, np.ones(size)], -1) @ np.linalg.inv(camera).T
        return 1 / (rays @ self.normal)


@pytest.mark.parametrize("ratio", [2.0, 16 / 9, 0.75, 9 / 16])
def test_depth_of_a_part_lies_where_its_camera_says(ratio: float) -> None:
    plane = Plane(input_size=SIZE)
    for epoch in range(4):
        sample = plane[epoch, 0, ratio]
        size = tuple(sample["depth"].shape[-2:])
        assert size == size_of_aspect(SIZE, (1.0, ratio))
        expected = plane.depth_of(sample["intrinsics"].double().numpy(), size)
        np.testing.assert_allclose(sample["depth"][0].numpy(), expected, rtol=0.02)
    places = {float(plane[epoch, 0, ratio]["intrinsics"][0, 2]) for epoch in range(4)}
    assert len(places) == 4 if ratio < 4 / 3 else len(places) == 1  # anywhere in the frame


def test_each_batch_has_one_shape_and_the_order_is_that_of_whole_frames() -> None:
    sampler = EpochSampler(64, 4, seed=3, aspect_ratios=RATIOS)
    batches = list(sampler)
    assert {key[2] for batch in batches for key in batch} == set(RATIOS)
    assert all(len({key[2] for key in batch}) == 1 for batch in batches)
    plain = list(EpochSampler(64, 4, seed=3))
    assert [[key[:2] for key in batch] for batch in batches] == plain
    sampler.start = 5
    assert list(sampler) == batches[5:]


def test_a_mix_and_a_gpu_get_the_same_parts() -> None:
    plane = Plane(input_size=SIZE, transform=Augmentation(affine=0.0))
    mixed = Mix({"plane": {"data": partial(Plane)}}, 8, input_size=SIZE, seed=1)
    assert mixed[0, 3, 2.0]["depth"].shape == (1, *size_of_aspect(SIZE, (1.0, 2.0)))
    keys = [(epoch, 0, 0.75) for epoch in range(6)]
    here = collate([plane[key] for key in keys])
    raw = plane.with_samples(raw_sample)
    there = to_device(collate([raw[key] for key in keys]), torch.device("cpu"), channels_last=True)
    assert torch.equal(here["intrinsics"], there["intrinsics"])
    torch.testing.assert_close(here["depth"], there["depth"], rtol=0.02, atol=0)


def test_a_stopped_training_goes_on_to_the_same_weights(tmp_path) -> None:
    data = partial(SyntheticDepth, 16, input_size=(32, 48), transform=Augmentation(affine=0.0))
    options = {"aspect_ratios": RATIOS, "epochs": 2, "checkpoint_every": 1}
    fit(tmp_path / "whole", data=data(), **options)
    with pytest.raises(Stopped):
        fit(tmp_path / "cut", data=data(), trainer=make_trainer(stopping_at(6), **options))
    last = tmp_path / "cut" / "checkpoints" / "last.pt"
    fit(tmp_path / "cut", data=data(), ckpt_path=last, **options)
    assert digest(tmp_path / "cut") == digest(tmp_path / "whole")


def test_frames_without_a_size_or_cut_by_the_protocol_are_refused(tmp_path) -> None:
    with pytest.raises(ValueError, match=r"trainer\.aspect_ratios cuts .*: give data.input_size"):
        fit(tmp_path, data=SyntheticDepth(16), aspect_ratios=RATIOS)
    with pytest.raises(ValueError, match=r"aspect_ratios=.*: give width / height, 0.2 to 5"):
        make_trainer(aspect_ratios=[16.9])

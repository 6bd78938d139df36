"""Frames become meters; meters become numbers, points and pictures."""

import copy
import pickle
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from support.predicting import photo, read_ply

import eldenet
from eldenet.data.io import read_image
from eldenet.deploy.outputs import to_millimeters, write_ply
from eldenet.deploy.predictor import DepthPredictor
from eldenet.deploy.runtimes.base import Runtime
from eldenet.geometry import resize_image
from eldenet.model import DepthNet
from eldenet.visualization import photo_beside_depth, round_numbers, visible_range


def test_predictor_sees_the_training_size_and_answers_in_the_frames(model: DepthNet) -> None:
    seen = []
    hook = model.register_forward_pre_hook(lambda _, inputs: seen.append(tuple(inputs[0].shape)))
    predictor = DepthPredictor(model, steady=False)
    depth = predictor(photo(50, 90))
    hook.remove()
    # in the frame's own aspect, as many pixels as 32 x 64 if it is wider, fewer if it is narrower; then the
    # last row and column repeated
    assert predictor.size_for(50, 200) == (23, 91)
    assert predictor.size_for(50, 90) == (33, 59)
    assert seen == [(1, 3, 48, 64)]
    assert (depth.shape, depth.dtype) == ((50, 90), np.float32)
    assert model.head.min_depth <= depth.min() <= depth.max() <= model.head.max_depth
    np.testing.assert_array_equal(depth, predictor(photo(50, 90)))


def test_the_network_stays_as_it_was_and_a_folded_copy_runs(model: DepthNet) -> None:
    network = copy.deepcopy(model).train()
    predictor = DepthPredictor(network, steady=False)

    def normalizations(one: torch.nn.Module) -> int:
        return sum(isinstance(part, torch.nn.BatchNorm2d) for part in one.modules())

    assert network.training
    assert normalizations(network) == normalizations(model) > 0 == normalizations(predictor.model)
    np.testing.assert_allclose(predictor(photo()), DepthPredictor(model, steady=False)(photo()), rtol=1e-5)


def test_predictor_is_the_network_with_a_resize_around_it(model: DepthNet) -> None:
    frame = photo()
    small = cv2.resize(frame, (32, 24), interpolation=cv2.INTER_AREA)
    with torch.inference_mode():
        depth = model(torch.from_numpy(small).permute(2, 0, 1)[None].float() / 255)
        large = torch.nn.functional.interpolate(depth, size=(48, 64), mode="bilinear", align_corners=False)
    np.testing.assert_allclose(DepthPredictor(model, (24, 32))(frame), large[0, 0], rtol=1e-6)


def test_predictor_without_a_training_size_limits_the_longer_side() -> None:
    predictor = DepthPredictor(eldenet.load("eldenet_s"), max_side=100)
    assert predictor.size_for(50, 80) == (50, 80)
    assert predictor.size_for(300, 200) == (100, 67)
    assert predictor.size_for(10_000, 1) == (100, 1)


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (photo()[..., 0], r"\(48, 64\) uint8: give the picture, \(H, W, 3\) uint8 RGB"),
        (photo().astype(np.float32), r"float32: give the picture, \(H, W, 3\) uint8 RGB"),
        (photo()[:0], r"give the picture, \(H, W, 3\) uint8 RGB"),
        ("a.jpg", r"frame is str: give the picture, \(H, W, 3\) uint8 RGB"),
        (photo(1, 640), r"frame is 1 x 640 px: give a picture of 8 px or more"),
    ],
)
def test_predictor_refuses_what_is_no_picture(model: DepthNet, frame: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        DepthPredictor(model)(frame)


@pytest.mark.parametrize(
    ("network", "options", "said"),
    [
        ("a.jpg", {}, r"model='a.jpg' is a name, not a network: give eldenet.load"),
        (None, {"input_size": (0, 32)}, "input_size"),
        (None, {"input_size": 128}, r"input_size=128: give \[height, width\] in pixels"),
        (Runtime("fp32", 1, "cpu", {}), {"device": "cuda"}, r"device=cuda is for models.*runtimes\.load"),
    ],
)
def test_predictor_refuses_what_does_not_fit(model: DepthNet, network: Any, options: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        DepthPredictor(network or model, **options)


@pytest.mark.parametrize("device", ["cuda", 0])  # torch's name of the first GPU, which is no "none given"
def test_predictor_refuses_a_gpu_that_torch_does_not_see(model: DepthNet, monkeypatch, device) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="device=cuda, but torch sees no CUDA device: use device=cpu"):
        DepthPredictor(model, device=device)


def test_fp32_on_cuda_is_not_tf32(model: DepthNet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)  # no CUDA device is needed
    monkeypatch.setattr(model, "to", lambda *_, **__: model)
    DepthPredictor(model, device="cuda")
    assert not torch.backends.cudnn.allow_tf32


def test_millimeters_are_rounded_and_0_where_unknown() -> None:
    depth = np.array([[0.0, 1.2344, 1.2346, 65.5351, 65.536, 200.0, np.nan, np.inf, -1.0]], np.float32)
    np.testing.assert_array_equal(to_millimeters(depth), [[0, 1234, 1235, 65535, 0, 0, 0, 0, 0]])


def test_a_point_cloud_leaves_out_unknown_points(tmp_path: Path) -> None:
    points = np.array([[0, 0, 1], [0, 0, 0], [1, np.nan, 2], [3, 4, 5]], np.float64)
    colors = np.arange(12, dtype=np.uint8).reshape(4, 3)
    assert write_ply(tmp_path / "a/b.ply", points, colors) == 2
    vertices = read_ply(tmp_path / "a/b.ply")
    assert vertices["z"].tolist() == [1, 5]
    assert vertices["blue"].tolist() == [2, 11]


def test_the_scale_shows_round_meters_at_a_constant_width() -> None:
    for near, far in ((0, 1), (0.7, 9.9), (1.2, 1.25), (3, 80), (0.5, 120)):
        numbers = round_numbers(near, far)
        assert 3 <= len(numbers) <= 8
        assert near - 1e-6 <= numbers[0] < numbers[-1] <= far + 1e-6
        np.testing.assert_allclose(np.diff(numbers), numbers[1] - numbers[0], rtol=1e-4)
    depth = np.full((48, 65), 2.0, np.float32)
    depth[:, :20] = 0
    assert visible_range(depth) == (2.0, 2.05)
    assert visible_range(np.zeros((3, 3))) == (0.0, 1.0)
    picture = photo_beside_depth(photo(48, 65), depth, 0.5, 120.0)
    titles, picture = np.split(picture, [-240])
    assert [(part < 128).any() for part in np.split(titles, [325, 654], axis=1)] == [True, True, False]
    np.testing.assert_array_equal(picture[::5, : 65 * 5 : 5], photo(48, 65))
    assert not picture[100, 65 * 5 + 4 + 50].any()  # unknown is black
    widths = {photo_beside_depth(photo(), depth[:, :64], 0.0, far).shape for far in (0.07, 1, 9.9, 12, 150)}
    assert len(widths) == 1  # a video's frames have one size
    assert not any(length % 2 for length in widths.pop()[:2])


def test_the_last_rows_of_an_odd_size_are_like_their_neighbors() -> None:
    """A photo of 3:2 is seen at 91 x 136; rounded up, this network's own last rows are off."""
    frame = read_image(Path(__file__).parents[2] / "web" / "example.jpg")
    predictor = DepthPredictor(eldenet.load("eldenet_fast_rooms"), steady=False)
    assert predictor.size_for(*frame.shape[:2]) == (91, 136)
    seen = torch.from_numpy(resize_image(frame, (91, 136))).permute(2, 0, 1)[None] / 255
    with torch.inference_mode():
        rows = predictor.model(seen)[0, 0].median(dim=1).values
    assert rows[-1] > 1.3 * rows[-16]
    rows = np.median(predictor(frame), axis=1)
    assert rows[-1] == pytest.approx(rows[-16], rel=0.05)


class Answers(Runtime):
    """A runtime whose network answers with a given map."""

    def __init__(self, answer: np.ndarray) -> None:
        super().__init__("fp32", 1, "cpu", {"input_size": "[16, 16]"})
        self.answer = answer

    def run_maps(self, images: np.ndarray, focal: np.ndarray | None = None) -> list[np.ndarray]:
        return [self.answer]


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (np.full((1, 1, 16, 16), -2.0, np.float32), "-2 to -2 m, but must be above 0"),
        (np.eye(16, dtype=np.float32)[None, None], "0 to 1 m, but must be above 0"),
        (np.full((1, 1, 16, 16), 3), "int64, which is no depth"),
        (np.ones((1, 3, 16, 16), np.float32), r"\(1, 3, 16, 16\) float32, which is no depth"),
        (np.ones((1, 16, 16), np.float32), "which is no depth"),
        (np.full((1, 1, 16, 16), np.nan, np.float32), "not finite"),
    ],
)
def test_what_is_no_depth_is_refused(answer: np.ndarray, said: str) -> None:
    network = Answers(answer)
    for call in (
        lambda: DepthPredictor(network)(photo(16, 16)),
        lambda: network(np.zeros((1, 3, 16, 16), "f4")),
    ):
        with pytest.raises(ValueError, match=said):
            call()


@pytest.mark.slow
def test_a_predictor_can_be_copied_and_sent_to_another_process(model: DepthNet) -> None:
    predictor = DepthPredictor(model)
    predictor(photo())  # a video has begun
    for other in (pickle.loads(pickle.dumps(predictor)), copy.deepcopy(predictor), copy.copy(predictor)):
        np.testing.assert_array_equal(other(photo()), DepthPredictor(model)(photo()))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        (depth,) = pool.map(predictor, [photo()])
    np.testing.assert_allclose(depth, DepthPredictor(model)(photo()), rtol=1e-6)

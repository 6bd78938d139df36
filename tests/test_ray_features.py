"""Rays: a network that is told its lens, in training, in torch, and in every file."""

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from support.networks import lens_net, picture, small_net
from support.predicting import photo
from support.synthetic import SyntheticDepth
from support.training import ONE_THREAD, PROTOCOL, make_trainer

import eldenet
from eldenet.backbones.pplcnet import PPLCNet
from eldenet.deploy import runtimes
from eldenet.deploy.fold import fold
from eldenet.deploy.metadata import describe
from eldenet.deploy.onnx_export import quantize_onnx, write_onnx
from eldenet.deploy.openvino_export import quantize_openvino, write_openvino
from eldenet.deploy.predictor import DepthPredictor
from eldenet.deploy.runtimes.module import RuntimeNetwork
from eldenet.evaluation.cost import count_macs
from eldenet.evaluation.evaluator import evaluate, predict_depth, predict_spread
from eldenet.heads import LogHead
from eldenet.losses.base import WeightedSum, WeightedTerm
from eldenet.losses.distillation import DistilledTerm, Teacher
from eldenet.losses.pointwise import L1Loss
from eldenet.model import DepthNet
from eldenet.ray_features import RayFeatures
from eldenet.system.resources import seed_everything
from eldenet.training.trainer import TrainingData
from eldenet.types import Frame

SIZE = (32, 64)
FOCAL = torch.tensor([30.0, 90.0, 0.0, torch.nan])


@pytest.fixture(scope="module")
def model() -> DepthNet:
    """It has sigma, and has learnt something of lenses."""
    net = lens_net(*SIZE)
    torch.nn.init.normal_(
        net.network.decoder.predict.weight, std=0.1, generator=torch.Generator().manual_seed(1)
    )
    return net


@pytest.fixture(scope="module")
def plain(model: DepthNet) -> DepthNet:
    """The same network without rays."""
    net = lens_net(*SIZE, rays=None)
    net.load_state_dict(model.state_dict(), strict=False)
    return net


def test_an_unknown_lens_leaves_the_network_as_it_is(model: DepthNet, plain: DepthNet) -> None:
    images = picture(*SIZE, batch=4)
    with torch.inference_mode():
        assert torch.equal(model(images), plain(images))
        told, scaled = model(images, FOCAL), plain(images, FOCAL)
    torch.testing.assert_close(told[2:], plain(images)[2:])
    ratio = told[:2] / scaled[:2]
    assert (ratio.log().abs().mean((1, 2, 3)) > 0.02).all(), "a known lens must change more than the scale"


def test_each_picture_has_its_own_lens(model: DepthNet) -> None:
    images = picture(*SIZE, batch=4)
    with torch.inference_mode():
        together = model(images, FOCAL)
        for index in range(4):
            alone = model(images[index : index + 1], float(FOCAL[index]))
            torch.testing.assert_close(together[index : index + 1], alone)


def test_it_begins_as_the_network_without_rays() -> None:
    net = small_net(rays=RayFeatures, canonical_focal=0.8, canonical_width=SIZE[1])
    images = picture(*SIZE, batch=2)
    with torch.inference_mode():
        torch.testing.assert_close(net(images, 30.0), net(images) * 30 / (0.8 * SIZE[1]))


def test_rays_are_the_angles_of_a_pinhole_camera() -> None:
    part = RayFeatures(PPLCNet(0.25).feature_info, typical_focal=50.0)
    right, down, lens, off = part._rays(torch.zeros(1, 8, 2, 4), SIZE, torch.full((1, 1, 1, 1), 100.0))[0]
    columns, rows = np.meshgrid([-24.0, -8.0, 8.0, 24.0], [-8.0, 8.0])  # middles of cells of 16 px
    np.testing.assert_allclose(right, columns / 100, rtol=1e-6)
    np.testing.assert_allclose(down, rows / 100, rtol=1e-6)
    np.testing.assert_allclose(off, np.hypot(columns, rows) / 100, rtol=1e-6)
    np.testing.assert_allclose(lens, np.log(2), rtol=1e-6)


def test_only_deep_features_see_them() -> None:
    strides = [info.stride for info in PPLCNet(0.25).feature_info]
    seen = RayFeatures(PPLCNet(0.25).feature_info).convs.keys()
    assert [stride for index, stride in enumerate(strides) if str(index) in seen] == [16, 32]


def test_training_hides_some_lenses_and_evaluation_none(model: DepthNet) -> None:
    images, lens = picture(*SIZE, batch=1).expand(200, -1, -1, -1), torch.full((200,), 90.0)
    features = model.network.backbone(images[:1])
    features = [feature.expand(200, -1, -1, -1) for feature in features]
    part: RayFeatures = model.network.rays
    try:
        part.train()
        changed = (part(features, SIZE, lens)[-1] != features[-1]).flatten(1).any(1)
    finally:
        part.eval()
    assert 0.05 < 1 - changed.float().mean() < 0.3
    assert (part(features, SIZE, lens)[-1] != features[-1]).flatten(1).any(1).all()


def test_it_needs_a_canonical_camera() -> None:
    with pytest.raises(ValueError, match="a network with rays needs canonical_focal"):
        small_net(rays=RayFeatures)


def test_saved_folded_and_counted(model: DepthNet, plain: DepthNet, tmp_path: Path) -> None:
    images = picture(*SIZE, batch=4)
    again = eldenet.load(model.save_pretrained(tmp_path))
    with torch.inference_mode():
        assert torch.equal(again(images, FOCAL), model(images, FOCAL))
        torch.testing.assert_close(fold(model)(images, FOCAL), model(images, FOCAL), rtol=1e-4, atol=1e-5)
    assert count_macs(model, SIZE) > count_macs(plain, SIZE)


def test_scores_mirrors_and_teachers_are_told_the_lens(model: DepthNet) -> None:
    images = picture(*SIZE, batch=4)
    with torch.inference_mode():
        depth, spread = model(images, FOCAL, with_spread=True)
        mirrored = 0.5 * (depth + model(images.flip(-1), FOCAL).flip(-1))
    torch.testing.assert_close(predict_depth(model, images, FOCAL), depth)
    torch.testing.assert_close(predict_depth(model, images, FOCAL, flip="mean"), mirrored)
    torch.testing.assert_close(predict_spread(model, images, FOCAL), (depth, spread))
    torch.testing.assert_close(Teacher(model)(images, FOCAL), depth)


class Lenses(SyntheticDepth):
    """Each frame has another lens."""

    def load_frame(self, index: int) -> Frame:
        focal = (25.0, 40.0, 60.0, 120.0)[index]
        return super().load_frame(index)._replace(intrinsics=np.diag([focal, focal, 1.0]))


@pytest.mark.parametrize("camera", ["canonical", "own"])
def test_a_network_has_nothing_to_learn_from_itself_whatever_the_lens(
    model: DepthNet, camera: str, tmp_path: Path
) -> None:
    """A teacher that was told the canonical lens for every picture would see other rays than its student."""
    student = deepcopy(model).requires_grad_(True)
    student.network.rays.unknown = 0.0
    term = DistilledTerm(L1Loss(), Teacher(deepcopy(model)))
    trainer = make_trainer(epochs=1, batch_size=4, loss_camera=camera, freeze=["batchnorm"])
    frames = Lenses(4, size=SIZE)
    data = TrainingData(frames, frames, PROTOCOL)
    trainer.fit(student, WeightedSum({"distilled": term}), data, tmp_path, ONE_THREAD)
    assert trainer.progress.history[0]["train_distilled"] < 1e-5


@pytest.fixture(scope="module")
def written(model: DepthNet, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Writes the file of that kind, once."""
    folder, facts = tmp_path_factory.mktemp("files"), describe(model, "m", SIZE)
    kinds = {"onnx": {}, "old": {"opset": 13}}

    @cache
    def write(kind: str) -> Path:
        if kind == "openvino":
            return write_openvino(write("onnx"), folder / "m.xml", facts)
        return write_onnx(model, folder / f"{kind}.onnx", SIZE, metadata=facts, **kinds[kind])

    return write


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "runtime"),
    [
        ("onnx", "onnxruntime"),
        ("onnx", "openvino"),
        ("old", "onnxruntime"),
        ("old", "openvino"),
        ("openvino", "openvino"),
        (None, "torch"),
        (None, "torch_channels_last"),
        (None, "onnxruntime"),  # by a file of any size
    ],
)
def test_every_file_and_runtime_gives_the_meters_of_torch(
    kind: str | None, runtime: str, model: DepthNet, written: Callable[[str], Path]
) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("openvino")
    network = runtimes.load(model if kind is None else written(kind), runtime, threads=1)
    assert network.sees_rays
    images = picture(*SIZE, batch=4)
    with torch.inference_mode():
        for lens in (FOCAL, None):
            expected = model.predict(images, lens)
            found = network.predict(images.numpy(), None if lens is None else lens.numpy())
            np.testing.assert_allclose(found.depth, expected.depth, rtol=1e-3)
            np.testing.assert_allclose(found.sigma, expected.sigma, rtol=1e-3)
        torch.testing.assert_close(
            RuntimeNetwork(network)(images, FOCAL), model(images, FOCAL), rtol=1e-3, atol=1e-4
        )
        one = network(images[:1].numpy(), 90.0)  # one number, and another number of images
        np.testing.assert_allclose(one, model(images[:1], 90.0), rtol=1e-3)


@pytest.mark.slow
def test_a_file_of_frames_takes_the_frames_focal_length(model: DepthNet, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    camera, frame = (64, 128), photo(64, 128)
    facts = describe(model, "m", SIZE, camera_size=camera)
    path = write_onnx(model, tmp_path / "c.onnx", SIZE, camera_size=camera, batch=1, metadata=facts)
    by_file = DepthPredictor(runtimes.load(path, "onnxruntime", threads=1), steady=False)
    by_torch = DepthPredictor(model, steady=False)
    small = torch.nn.functional.avg_pool2d(torch.from_numpy(frame).permute(2, 0, 1)[None].float() / 255, 2)
    for fov in (50.0, 90.0, None):
        ratio = by_file(frame, fov=fov) / by_torch(frame, fov=fov)  # torch rounds the smaller frame
        assert np.abs(ratio - 1).mean() < 0.005
        with torch.inference_mode():
            expected = model(small, None if fov is None else 32 / np.tan(np.radians(fov / 2)))[0, 0]
        np.testing.assert_allclose(by_torch(frame, fov=fov)[::2, ::2].mean(), expected.mean(), rtol=0.02)


@pytest.mark.parametrize("kind", ["onnx", "openvino"])
def test_int8_keeps_the_lens(
    kind: str, model: DepthNet, written: Callable[[str], Path], tmp_path: Path
) -> None:
    pytest.importorskip("onnxruntime" if kind == "onnx" else "nncf")
    images, graph = picture(*SIZE, batch=16), written("onnx")
    inputs = [each[None].numpy() for each in images]
    if kind == "onnx":
        network = runtimes.load(quantize_onnx(graph, tmp_path / "q.onnx", inputs), "onnxruntime", threads=1)
    else:
        path = quantize_openvino(graph, tmp_path / "q.xml", inputs, describe(model, "m", SIZE))
        network = runtimes.load(path, "openvino", threads=1)
    with torch.inference_mode():
        for lens in (40.0, 70.0, None):
            ratio = network(inputs[0], lens) / model(images[:1], lens).numpy()
            assert 0.93 < np.median(ratio) < 1.07


def test_a_file_that_takes_more_than_a_lens_is_refused(
    written: Callable[[str], Path], tmp_path: Path
) -> None:
    onnx = pytest.importorskip("onnx")
    graph = onnx.load(written("onnx"))
    graph.graph.input.add().CopyFrom(onnx.helper.make_tensor_value_info("time", onnx.TensorProto.FLOAT, [1]))
    foreign = tmp_path / "foreign.onnx"
    del graph.metadata_props[:]
    graph.producer_name = "other"
    onnx.save(graph, foreign)
    with pytest.raises(ValueError, match="takes focal, time beside its images"):
        runtimes.load(foreign, "onnxruntime", threads=1)


class SameWall(SyntheticDepth):
    """The same picture by two lenses, of a wall at 2 m: only the lens tells what it shows."""

    def load_frame(self, index: int) -> Frame:
        frame, fx = super().load_frame(0), (24.0, 72.0)[index % 2]
        height, width = frame.depth.shape
        intrinsics = np.array([[fx, 0, width / 2], [0, fx, height / 2], [0, 0, 1]])
        return frame._replace(depth=np.full_like(frame.depth, 2.0), intrinsics=intrinsics, name=f"{index}")


@pytest.mark.slow
def test_training_learns_what_only_the_lens_tells(tmp_path: Path) -> None:
    scores = {}
    for kind, rays in (("told", RayFeatures), ("not told", None)):
        seed_everything(0)
        model = small_net(rays=rays, head=LogHead(), canonical_focal=0.8, canonical_width=48).train()
        data = TrainingData(SameWall(16), SameWall(2), PROTOCOL)
        loss = WeightedSum({"l1": WeightedTerm(L1Loss())})
        make_trainer(epochs=12, freeze=["batchnorm"]).fit(
            model, loss, data, tmp_path / kind.replace(" ", ""), ONE_THREAD
        )
        scores[kind] = evaluate(model, SameWall(2), PROTOCOL).metrics["abs_rel"]
    assert scores["told"] < 0.5 * scores["not told"]

"""Semantic labels beside the depth, and errors by class: against a straight reading in NumPy."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from support import layouts

from eldenet.backbones.pplcnet import PPLCNet
from eldenet.compose import compose
from eldenet.data.base import resize_frame
from eldenet.data.cityscapes import Cityscapes, CityscapesMTAN
from eldenet.data.cityscapes_labels import CLASS_IDS
from eldenet.data.resize_crop import ResizeCrop
from eldenet.data.transforms import Augmentation
from eldenet.decoders.fast_upconv import FastUpConvDecoder
from eldenet.evaluate import EvaluateSettings
from eldenet.evaluation.constant_baseline import ConstantPredictor
from eldenet.evaluation.evaluator import evaluate
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import open_split
from eldenet.heads import LinearHead
from eldenet.model import DepthNet
from eldenet.types import Frame

# The official table: id -> train id, as the data set's page lists it; the others are not scored.
TRAIN_IDS = {7: 0, 8: 1, 11: 2, 12: 3, 13: 4, 17: 5, 19: 6, 20: 7, 21: 8, 22: 9}
TRAIN_IDS |= {23: 10, 24: 11, 25: 12, 26: 13, 27: 14, 28: 15, 31: 16, 32: 17, 33: 18}
IDS = np.random.default_rng(3).integers(0, 34, layouts.SMALL.meters.shape).astype(np.uint8)
CLASSES = np.vectorize(lambda number: TRAIN_IDS.get(number, 255))(IDS)
PROTOCOL = EvalProtocol("mine", 1.0, 40.0, clamp=False)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    layouts.gt_fine(layouts.cityscapes(tmp_path), IDS)
    return tmp_path


def expected(depth: np.ndarray, guess: np.ndarray, classes: np.ndarray) -> dict[int, tuple[float, ...]]:
    """AbsRel, RMSE, delta 1.25 and pixels of each class, from their formulas."""
    found = {}
    for number in range(19):
        here = (classes == number) & (depth > PROTOCOL.min_depth) & (depth < PROTOCOL.max_depth)
        p, g = guess[here].astype(np.float64), depth[here].astype(np.float64)
        if here.any():
            delta = (np.maximum(p / g, g / p) < 1.25).mean()
            found[number] = ((abs(p - g) / g).mean(), np.sqrt(((p - g) ** 2).mean()), delta, here.sum())
    return found


def test_official_ids_become_the_19_classes(root: Path) -> None:
    data = Cityscapes(root, split="official_val", labels=True)
    assert data.class_names[0] == "road"
    assert data.class_names[18] == "bicycle"
    assert list(CLASS_IDS.values()) == list(TRAIN_IDS)
    sample = data[0]
    assert sample["labels"].dtype == torch.uint8
    np.testing.assert_array_equal(sample["labels"][0], CLASSES)
    assert "labels" not in Cityscapes(root, split="official_val")[0]


def test_errors_by_class_are_those_of_its_pixels(root: Path) -> None:
    data = Cityscapes(root, split="trainval", labels="auto", max_depth=40.0)
    guess = torch.rand(1, 1, *CLASSES.shape, generator=torch.Generator().manual_seed(0)) * 30 + 2
    result = evaluate(ConstantPredictor(guess), data, PROTOCOL, batch_size=2)  # a batch of two, one of one
    depth = np.stack([data[i]["depth"][0].numpy() for i in range(3)])
    by_hand = expected(depth, np.broadcast_to(guess[0, 0], depth.shape), np.stack([CLASSES] * 3))
    assert list(result.classes) == [data.class_names[number] for number in by_hand]
    for number, values in by_hand.items():
        ours = result.classes[data.class_names[number]]
        assert [ours[key] for key in ("abs_rel", "rmse", "delta1", "pixels")] == pytest.approx(
            values, rel=1e-5
        )
    none = Cityscapes(root, split="trainval", max_depth=40.0)
    assert evaluate(ConstantPredictor(guess), none, PROTOCOL).classes == {}
    without = evaluate(ConstantPredictor(guess), none, PROTOCOL).metrics
    assert without == pytest.approx(result.metrics, nan_ok=True)


def test_labels_move_with_the_depth() -> None:
    """Depth that says its own class: whatever the geometry, the two stay together."""
    labels = np.kron(np.arange(48, dtype=np.uint8).reshape(6, 8) % 20, np.ones((8, 8), np.uint8))
    labels[labels == 19] = 255
    depth = (labels % 255 + 1).astype(np.float32)
    image = np.zeros((*labels.shape, 3), np.uint8)
    frame = Frame(image, depth, None, "f", labels)
    whole = Augmentation(flip=1.0, affine=1.0, scale=(1.0, 1.0), rotate=20.0, shift=0.2)
    for step in (whole, ResizeCrop(resize=0.5, crop=(20, 24)), ResizeCrop(box=(4, 40, 8, 60), size=(18, 26))):
        moved = step(frame, np.random.default_rng(0))
        assert moved.labels is not None
        assert moved.labels.dtype == np.uint8
        unknown = moved.depth == 0  # from beyond the border
        np.testing.assert_array_equal(moved.labels % 255 + 1, np.where(unknown, 1, moved.depth))
        assert (moved.labels[unknown] == 255).all()
    assert (whole(frame, np.random.default_rng(0)).depth == 0).any()
    small, kept = resize_frame(frame, (24, 32)), resize_frame(frame, (24, 32), resize_depth=False)
    np.testing.assert_array_equal(small.labels % 255 + 1, small.depth)  # type: ignore[operator]
    assert kept.labels is labels


def test_mtans_label_arrays(tmp_path: Path) -> None:
    root = layouts.cityscapes_mtan(tmp_path, (16, 24))
    values = np.random.default_rng(0).integers(-1, 7, (16, 24, 1)).astype(np.float64)
    (root / "val/label_7").mkdir()
    for number in range(4):
        np.save(root / f"val/label_7/{number}.npy", values)
    data = CityscapesMTAN(root, split="official_val", labels="auto")
    np.testing.assert_array_equal(data[0]["labels"], np.where(values < 0, 255, values)[..., 0][None])
    assert data.class_names[6] == "class 6"
    assert "labels" not in CityscapesMTAN(root, split="trainval", labels="auto")[0]
    np.save(root / "val/label_7/0.npy", values * 100)
    with pytest.raises(ValueError, match=r"label_7/0\.npy is .*expected \(H, W\) of whole numbers 0 to 18"):
        data[0]


def test_missing_and_wrong_labels_are_named(root: Path) -> None:
    data = Cityscapes(root, split="official_val", labels=True)
    file = next((root / "gtFine/val").rglob("*.png"))
    layouts.picture(file, IDS + 40)
    with pytest.raises(ValueError, match=r"munster_000000_000019_gtFine_labelIds\.png"):
        data[0]
    layouts.picture(file, IDS[:-2])
    with pytest.raises(ValueError, match=r"labelIds\.png is .*disparity\.png is .*one size"):
        data[0]
    file.unlink()
    with pytest.raises(FileNotFoundError, match=r"1 of 4 files are missing: .*gtFine_labelIds"):
        Cityscapes(root, split="official_val", labels=True)
    for choice in ("auto", False):  # a depth frame is not lost for its label
        depth_alone = Cityscapes(root, split="official_val", labels=choice)
        assert (len(depth_alone), depth_alone.class_names) == (1, ())
    file.parent.rmdir()
    file.parent.parent.rmdir()
    with pytest.raises(FileNotFoundError, match="labels=true, but there is no gtFine/val"):
        Cityscapes(root, split="official_val", labels=True)
    assert Cityscapes(root, split="official_val", labels="auto").class_names == ()
    with pytest.raises(ValueError, match="labels='yes'"):
        Cityscapes(root, split="official_val", labels="yes")


@pytest.mark.parametrize(("labels", "read"), [("auto", {"test"}), ("false", set())])
def test_labels_are_read_where_they_are_scored(root: Path, labels: str, read: set[str]) -> None:
    words = ["checkpoint=x", "data=cityscapes", f"data.root={root}", f"data.labels={labels}"]
    config = compose(EvaluateSettings, words)
    splits = ("train", "val", "test")
    data = {split: open_split(config.data, split, PROTOCOL, score=True) for split in splits}
    assert {split for split in splits if "labels" in data[split][0]} == read


def test_evaluate_writes_and_shows_them(root: Path, run_command, tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = DepthNet.from_parts(PPLCNet(0.25), FastUpConvDecoder, LinearHead(1.0, 80.0))
    network.save_pretrained(tmp_path / "model")
    finished = run_command(
        "evaluate",
        *("checkpoint=model", "data=cityscapes", f"data.root={root}", "data.input_size=[32,64]"),
        *("protocol=folder", "runtime.workers=0", "output=run"),
    )
    assert finished.returncode == 0, finished.stderr
    for text in ("errors by class", "traffic sign", "bicycle"):
        assert text in finished.stdout
    classes = json.loads((tmp_path / "run/run.json").read_text())["errors_by_class"]
    data = Cityscapes(root, split="official_val", labels=True)
    assert list(classes) == list(data.class_names)
    sample = data[0]
    inside = sample["mask"] & (sample["depth"] > 1.0) & (sample["depth"] < 80.0)
    assert classes["road"]["pixels"] == int((inside & (sample["labels"] == 0)).sum())
    assert classes["road"]["abs_rel"] > 0

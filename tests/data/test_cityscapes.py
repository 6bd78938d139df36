"""Cityscapes: files of the exact official format round-trip to meters; MTAN's errors are in its own unit."""

import copy
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from support import layouts

from eldenet.compose import compose
from eldenet.data.cityscapes import Cityscapes, CityscapesMTAN
from eldenet.evaluate import EvaluateSettings
from eldenet.evaluation.metrics import DepthMetrics
from eldenet.evaluation.protocol import EvalProtocol
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.results.tables import heading, protocol_line

FULL = layouts.content((1024, 2048))
SMALL = layouts.SMALL


def test_a_frame_of_the_official_format_round_trips_to_meters(tmp_path: Path) -> None:
    data = Cityscapes(layouts.cityscapes(tmp_path, FULL), split="official_val")
    assert data.names == ["val/munster/munster_000000_000019"]
    assert data.ground_truth == "raw"
    frame = data.load_frame(0)
    np.testing.assert_array_equal(frame.image, FULL.rgb)
    expected = [[2262.52, 0, 1096.98], [0, 2265.3017905988554, 513.137], [0, 0, 1]]
    np.testing.assert_allclose(frame.intrinsics, expected)
    hole = np.zeros(frame.depth.shape, bool)
    hole[5:9, 7:20] = True
    np.testing.assert_array_equal(frame.depth == 0, hole)
    meters = FULL.meters * 5
    step = meters**2 / (256 * 0.209313 * 2262.52)  # of one disparity number, at this distance
    assert (np.abs(frame.depth - meters) <= 0.51 * step)[~hole].all()
    # the same as a straight reading
    number = layouts.disparity_of(meters).astype(np.float64)
    np.testing.assert_allclose(
        frame.depth[~hole], (0.209313 * 2262.52 / ((number - 1) / 256))[~hole], rtol=1e-6
    )


def test_unknown_and_infinite_disparity_stay_unknown(tmp_path: Path) -> None:
    root = layouts.cityscapes(tmp_path)
    disparity = np.full(SMALL.meters.shape, 257, np.uint16)  # 1 px
    disparity[0, :3] = (0, 1, 2)
    file = root / "disparity/val/munster/munster_000000_000019_disparity.png"
    layouts.picture(file, disparity)
    sample = Cityscapes(root, split="official_val", max_depth=1000.0)[0]
    depth = sample["depth"][0]
    assert depth[0, :2].tolist() == [0, 0]
    assert sample["mask"][0, 0, :3].tolist() == [False, False, False]  # 1/256 px is 121 km
    torch.testing.assert_close(depth[1, 1].item(), 0.209313 * 2262.52, rtol=1e-6, atol=0)
    layouts.picture(file, disparity // 2)
    with pytest.raises(ValueError, match="largest number is 128"):
        Cityscapes(root, split="official_val")[0]


def test_each_frame_has_its_own_camera(tmp_path: Path) -> None:
    root = layouts.cityscapes(tmp_path)
    data = Cityscapes(root, split="trainval")
    camera = copy.deepcopy(layouts.CAMERA)
    camera["extrinsic"]["baseline"] *= 2
    (root / data.files[1][2]).write_text(json.dumps(camera))
    one, other = data.load_frame(0).depth, data.load_frame(1).depth
    np.testing.assert_allclose(other, 2 * one, rtol=1e-6)
    camera["extrinsic"]["baseline"] = 209.313
    (root / data.files[1][2]).write_text(json.dumps(camera))
    with pytest.raises(ValueError, match=r"baseline=209.313 is wider than a car: give it in meters"):
        data.load_frame(1)


def test_smaller_files_keep_depth_and_scale_the_camera(tmp_path: Path) -> None:
    frame = Cityscapes(layouts.cityscapes(tmp_path), split="official_test").load_frame(0)  # 48 x 64
    assert frame.intrinsics is not None
    assert frame.intrinsics[0, 0] == pytest.approx(2262.52 * 64 / 2048)
    assert frame.intrinsics[0, 2] == pytest.approx((1096.98 + 0.5) * 64 / 2048 - 0.5)
    np.testing.assert_allclose(frame.depth[20:], SMALL.meters[20:] * 5, rtol=0.01)


@pytest.mark.parametrize("place", ["{kind}", "{kind}_trainvaltest/{kind}", "{kind}_trainvaltest"])
def test_zips_may_be_unpacked_in_any_way(tmp_path: Path, place: str) -> None:
    root = layouts.cityscapes(tmp_path, place=place)
    assert len(Cityscapes(root, split="trainval")) == 3
    assert Cityscapes(root).names == ["train/aachen/aachen_000000_000019"]
    assert [name.split("/")[1] for name in Cityscapes(root, split="val").names] == ["darmstadt", "ulm"]
    assert Cityscapes(root, split="val", val_cities=["aachen"])[0]["name"].startswith("train/aachen")


@pytest.mark.parametrize("cities", [["munster"], ["aachen", "darmstadt", "ulm"]])
def test_cities_for_validation_must_leave_some(tmp_path: Path, cities: list[str]) -> None:
    with pytest.raises(ValueError, match="give some, but not all, of aachen, darmstadt, ulm"):
        Cityscapes(layouts.cityscapes(tmp_path), val_cities=cities)


@pytest.mark.parametrize("kind", ["leftImg8bit", "disparity", "camera"])
def test_a_missing_part_is_named(tmp_path: Path, kind: str) -> None:
    root = layouts.cityscapes(tmp_path)
    shutil.rmtree(root / kind / "val")
    with pytest.raises(FileNotFoundError, match=f"(?s)none of {kind}/val.*fetch {kind}.*Expected tree"):
        Cityscapes(root, split="official_val")


# --- MTAN's arrays -------------------------------------------------------------------------------------


def test_mtans_values_become_meters(tmp_path: Path) -> None:
    data = CityscapesMTAN(layouts.cityscapes_mtan(tmp_path), split="official_val")
    assert data.names == ["val/0", "val/1", "val/2", "val/3"]
    frame = data.load_frame(0)
    assert frame.image[0, 0].tolist() == [51, 102, 153]
    value = np.load(tmp_path / "val/depth/0.npy")[..., 0].astype(np.float64)
    known = value > 0
    assert 0 < (~known).sum() < 100
    np.testing.assert_array_equal(frame.depth > 0, known)
    np.testing.assert_allclose(
        frame.depth[known], (0.22 * 2262.52 * 256 / (65535 * value - 1))[known], rtol=1e-5
    )
    assert CityscapesMTAN(tmp_path, val_frames=1).names == ["train/0", "train/1", "train/2"]
    assert CityscapesMTAN(tmp_path, val_frames=1, split="val").names == ["train/3"]
    with pytest.raises(ValueError, match="val_frames=4: give at least 1 and fewer than 4"):
        CityscapesMTAN(tmp_path, val_frames=4)


@pytest.mark.parametrize("scale", [1.944383, 1.7])
def test_mtan_errors_are_those_of_its_values(tmp_path: Path, scale: float) -> None:
    """abs err and rel err as papers compute them from v, whatever baseline and focal are taken to be."""
    root = layouts.cityscapes_mtan(tmp_path)
    overrides = ["checkpoint=x", "data=cityscapes_mtan", f"data.root={root}", f"data.inverse_scale={scale}"]
    config = compose(EvaluateSettings, overrides)
    protocol = chosen_protocol(config.data, config.protocol)
    assert protocol.inverse_scale == scale
    sample = open_split(config.data, "test", protocol)[0]
    truth = torch.from_numpy(np.load(root / "val/depth/0.npy"))[..., 0].double()
    guess = torch.full_like(truth, 0.05)
    meters = (scale * 65535 / (65535 * guess - 1)).float()
    metrics = DepthMetrics(protocol)
    metrics.update(meters[None, None], sample["depth"][None], sample["mask"][None])
    result = metrics.compute()
    known = truth > 0
    assert result["pixels"] == int(known.sum())
    error = (guess - truth).abs()[known]
    assert result["mae"] == pytest.approx(error.mean().item(), rel=1e-4)
    assert result["abs_rel"] == pytest.approx((error / truth[known]).mean().item(), rel=2e-3)


def test_inverse_depth_is_scored_in_its_own_unit() -> None:
    protocol = EvalProtocol("mine", 1.0, 100.0, inverse_scale=2.0, clamp=False)
    metrics = DepthMetrics(protocol)
    depth, prediction = torch.zeros(1, 1, 12, 12), torch.full((1, 1, 12, 12), 5.0)
    depth[..., 0, :2] = torch.tensor([2.0, 4.0])
    prediction[..., 0, :2] = torch.tensor([4.0, -1.0])
    metrics.update(prediction, depth, depth > 0)
    result = metrics.compute()  # 0.5 against 1; 2, the largest that there is, against 0.5
    assert result["mae"] == pytest.approx((0.5 + 1.5) / 2)
    assert result["abs_rel"] == pytest.approx((0.5 + 3.0) / 2)
    with pytest.raises(ValueError, match="inverse_scale=0"):
        EvalProtocol("mine", inverse_scale=0.0)


def test_a_table_says_that_it_is_no_meters() -> None:
    rules = EvalProtocol("mine", inverse_scale=2.0).as_dict()
    run = {"protocol": rules, "data": "d", "split": "s", "split_hash": "h", "metrics": {"images": 1}}
    assert heading("mae", run) == "MAE ↓"
    assert "scored as inverse depth, 2 m / depth" in protocol_line(run)
    rules["inverse_scale"] = None
    assert heading("mae", run) == "MAE [m] ↓"

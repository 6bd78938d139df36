"""Several data sets in one training: drawn by weight, the same draws on every machine and after a resume."""

from collections import Counter
from functools import partial

import cv2
import numpy as np
import pytest
import torch
from support.synthetic import SyntheticDepth
from support.training import Stopped, digest, fit, make_trainer, stopping_at

from eldenet.compose import compose
from eldenet.data.folder import FolderDataset
from eldenet.data.inspection import ChannelSums, channel_statistics, check_split, identities
from eldenet.data.mix import Mix
from eldenet.data.splits import check_folders
from eldenet.data.transforms import Augmentation
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.losses.base import LossInputs, WeightedSum, WeightedTerm
from eldenet.losses.pointwise import L1Loss
from eldenet.losses.scale_shift import ScaleShiftInvariantLoss
from eldenet.train import TrainSettings, checked_parts


def mix(frames: int = 40, near: float = 3.0, far: float = 1.0, **options) -> Mix:
    sources = {
        "near": {"data": partial(SyntheticDepth, 5, max_depth=4.0), "weight": near},
        "far": {"data": partial(SyntheticDepth, 7, max_depth=9.0), "weight": far, "relative": True},
    }
    return Mix(sources, frames, **({"seed": 3} | options))


def drawn(frames: Mix, epoch: int) -> list[tuple[str, bool]]:
    samples = [frames[epoch, index] for index in range(len(frames))]
    return [(sample["name"], bool(sample["relative"])) for sample in samples]


def test_draws_follow_the_weights_and_depend_on_the_seed_epoch_and_index_alone() -> None:
    frames = mix(400)
    first = drawn(frames, 0)
    kinds = Counter(relative for _, relative in first)
    assert 260 < kinds[False] < 340  # three quarters
    assert len(set(first)) == 12  # every frame of both sources
    assert drawn(mix(400), 0) == first
    assert drawn(frames, 1) != first
    assert drawn(mix(400, seed=4), 0) != first


def test_a_frame_is_the_same_frame_inside_and_outside_a_mix() -> None:
    plain = SyntheticDepth(7, max_depth=9.0)
    assert len(identities(plain).keys() & identities(mix()).keys()) == 7


def test_each_source_keeps_its_own_range() -> None:
    frames = mix()
    assert (frames.min_depth, frames.max_depth) == (0.1, 9.0)
    for index in range(40):
        sample = frames[0, index]
        limit = 9.0 if sample["relative"] else 4.0
        assert sample["depth"].max() <= limit


def test_a_frame_drawn_twice_in_an_epoch_is_augmented_in_two_ways() -> None:
    frames = mix(60, far=0.0, transform=Augmentation())
    of_one = [frames[0, index]["image"] for index in range(60) if frames[0, index]["name"] == "synthetic/0"]
    assert len(of_one) > 2
    assert not any(torch.equal(of_one[0], other) for other in of_one[1:])


def test_the_hash_covers_frames_weights_and_kinds() -> None:
    hashes = {mix().split_hash, mix(near=2.0).split_hash, mix(41).split_hash, mix(far=0.0).split_hash}
    assert len(hashes) == 4
    assert mix().split_hash == mix(seed=9).split_hash


def test_frames_are_found_by_their_place_in_names() -> None:
    frames = mix()
    assert frames.names == [f"near/synthetic/{i}" for i in range(5)] + [
        f"far/synthetic/{i}" for i in range(7)
    ]
    assert frames.load_frame(4).name == "synthetic/4"
    assert frames.load_frame(5).name == "synthetic/0"


@pytest.mark.parametrize("draws", [4, 40])
def test_a_mix_is_checked_and_measured_frame_by_frame(draws: int) -> None:
    """Neither the first draws alone, nor beyond the last frame where an epoch draws more often."""
    frames = mix(draws)
    assert check_split("train", frames).looked_at == 12
    whole = ChannelSums()
    for index in range(12):
        whole.add(frames.load_frame(index).image)
    assert channel_statistics(frames).mean == pytest.approx(whole.mean)


def test_a_source_that_skips_leaves_out_what_cannot_be_read(tmp_path) -> None:
    """Else the training would end at the first draw of such a frame."""
    for folder, pixel in (("images", np.uint8(200)), ("depths", np.uint16(2000))):
        (tmp_path / folder).mkdir()
        for number in range(4):
            cv2.imwrite(str(tmp_path / folder / f"{number}.png"), np.full((8, 10), pixel))
    (tmp_path / "images/2.png").write_bytes(b"no picture")
    source = partial(FolderDataset, tmp_path, max_depth=9.0, on_error="skip")
    frames = Mix({"mine": {"data": source}}, 40)
    assert frames.names == ["mine/0", "mine/1", "mine/3"]
    assert list(frames.skipped) == ["mine/2"]
    assert {name for name, _ in drawn(frames, 0)} == {"0", "1", "3"}


def test_wrong_settings_are_named() -> None:
    with pytest.raises(ValueError, match=r"sources\.near\.weight=-1"):
        mix(near=-1)
    with pytest.raises(ValueError, match="no source has a weight above 0"):
        mix(near=0, far=0)
    with pytest.raises(ValueError, match="give data, weight and relative"):
        Mix({"one": {"data": partial(SyntheticDepth), "share": 2}}, 5)


def test_a_subset_of_a_mix_is_refused(tmp_path, monkeypatch) -> None:
    """It only shortened the list of names, and training still drew from all frames."""
    monkeypatch.setenv("ELDENET_CACHE", str(tmp_path))
    overrides = ["data=mix", "data.sources.nyu.weight=0", "data.sources.rooms.data.frames=4"]
    with pytest.raises(ValueError, match=r"subset=3: .* set data\.frames"):
        mix().draw_subset(3, seed=0)
    config = compose(
        TrainSettings, [*overrides, "data.sources.rooms.data.size=[16,24]", "+data.subset.train=3"]
    )
    with pytest.raises(ValueError, match=r"subset=3: .* set data\.frames"):
        open_split(config.data, "train", chosen_protocol(config.data, config.protocol))


@pytest.mark.slow
def test_a_stopped_training_on_a_mix_resumes_to_the_same_weights(tmp_path) -> None:
    def terms() -> dict[str, WeightedTerm]:
        return {"ssi": WeightedTerm(ScaleShiftInvariantLoss(scales=1), space="log", applies_to="relative")}

    settings = {"epochs": 2, "checkpoint_every": 1}
    fit(tmp_path / "whole", data=mix(12), terms=terms(), **settings)
    stopping = make_trainer(stopping_at(5), **settings)
    with pytest.raises(Stopped):
        fit(tmp_path / "part", trainer=stopping, data=mix(12), terms=terms())
    again = make_trainer(**settings)
    fit(tmp_path / "part", trainer=again, data=mix(12), terms=terms(), ckpt_path=tmp_path / "part")
    assert digest(tmp_path / "part") == digest(tmp_path / "whole")


def test_metric_and_relative_terms_see_their_own_samples() -> None:
    terms = {kind: WeightedTerm(L1Loss(), applies_to=kind) for kind in ("metric", "relative")}
    loss = WeightedSum(terms)
    prediction, mask = torch.ones(2, 1, 2, 2), torch.ones(2, 1, 2, 2, dtype=torch.bool)
    target = torch.stack([torch.full((1, 2, 2), 3.0), torch.full((1, 2, 2), 6.0)])
    _, values = loss(LossInputs(prediction, target, mask, relative=torch.tensor([False, True])))
    assert values == {"metric": 2.0, "relative": 5.0}
    _, values = loss(LossInputs(prediction, target, mask))
    assert values == {"metric": 3.5, "relative": 0.0}


def test_the_yaml_mixes_rendered_rooms_with_the_labeled_frames(tmp_path, monkeypatch) -> None:
    from support import layouts

    layouts.labeled(tmp_path / "nyu_depth_v2/labeled", layouts.content((480, 640)))
    monkeypatch.setenv("ELDENET_DATA", str(tmp_path))
    monkeypatch.setenv("ELDENET_CACHE", str(tmp_path / "cache"))
    rooms = ["data.sources.rooms.data.frames=8", "data.sources.rooms.data.size=[16,24]"]
    config = compose(TrainSettings, ["data=mix", "data.frames=6", "data.input_size=[24,32]", *rooms])
    frames = open_split(
        config.data, "train", chosen_protocol(config.data, config.protocol), augmentation=config.augmentation
    )
    kinds = {name.split("/")[0] for name in frames.names}
    assert kinds == {"nyu", "rooms"}
    assert {tuple(frames[0, index]["image"].shape) for index in range(6)} == {(3, 24, 32)}


def test_the_log_counts_the_frames_that_a_source_left_out(tmp_path, monkeypatch, caplog) -> None:
    from support import layouts

    folder = tmp_path / "nyu_depth_v2/labeled"
    layouts.labeled(folder, layouts.content((480, 640)))
    monkeypatch.setenv("ELDENET_DATA", str(tmp_path))
    overrides = ["data=mix", "data.frames=500", "data.sources.rooms.weight=0"]
    config = compose(TrainSettings, [*overrides, "data.sources.nyu.data.on_error=skip"])
    whole = open_split(config.data, "train", chosen_protocol(config.data, config.protocol))
    whole.sources["nyu"].dataset.frame_files(0)[0].write_bytes(b"no picture")
    rest = open_split(config.data, "train", chosen_protocol(config.data, config.protocol))
    assert len(rest.names) == len(whole.names) - 1
    assert f"train: 1 of {len(whole.names)} frames left out, such as nyu/" in caplog.text


def test_a_mix_without_its_frames_names_its_own_setting(monkeypatch, tmp_path) -> None:
    monkeypatch.delenv("ELDENET_DATA", raising=False)
    for words, said in (
        ([], r"no folder given .*: set data\.sources\.nyu\.data\.root, or ELDENET_DATA"),
        (
            [f"data.sources.nyu.data.root={tmp_path}/no"],
            r"no is not a folder: set data\.sources\.nyu\.data\.root",
        ),
    ):
        with pytest.raises(FileNotFoundError, match=said):
            check_folders(compose(TrainSettings, ["data=mix", *words]).data)


def test_relative_depth_that_no_term_learns_from_is_refused() -> None:
    words = ["data=mix", "model=eldenet_s", "data.sources.rooms.relative=true"]
    with pytest.raises(ValueError, match=r"data\.sources\.rooms\.relative=true: no term .*=ssim_l1_relative"):
        checked_parts(compose(TrainSettings, words))
    for mended in ("loss=ssim_l1_relative", "data.sources.rooms.weight=0"):
        checked_parts(compose(TrainSettings, [*words, mended]))

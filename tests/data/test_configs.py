"""Every data set by its YAML, in a tiny tree of its layout: it builds, is scored, drawn from, damaged."""

import pickle
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from support import layouts
from torch.utils.data import DataLoader

from eldenet.compose import FOCAL_RANGE, compose, config_folder, plain
from eldenet.data.base import DepthDataset
from eldenet.data.folder import FolderDataset
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.train import TrainSettings

FULL = layouts.content((480, 640))
TREES: dict[str, Callable[[Path], list[str]]] = {
    "cityscapes": lambda root: [f"data.root={layouts.cityscapes(root, layouts.content((1024, 2048)))}"],
    "cityscapes_mtan": lambda root: [f"data.root={layouts.cityscapes_mtan(root)}", "data.val_frames=1"],
    "folder": lambda root: [f"data.root={layouts.folder(root)}"],
    "kitti": lambda root: [f"data.root={layouts.kitti_depth(root)}"],
    "kitti_eigen_improved": lambda root: [
        f"data.root={layouts.kitti_depth(root)}",
        f"data.test_list={layouts.eigen_list(root / 'list.txt', layouts.DRIVES[:1])}",
        "data.frames=1",
    ],
    "kitti_eigen_raw": lambda root: [
        f"data.root={layouts.kitti_raw(root / 'raw')}",
        f"data.test_list={layouts.eigen_list(root / 'list.txt', layouts.DRIVES[:1], 69)}",
        "data.frames=1",
    ],
    "kitti_raw": lambda root: [f"data.root={layouts.kitti_raw(root)}"],
    "kitti_selection": lambda root: [
        f"data.root={layouts.kitti_depth(root)}",
        f"data.selection_root={layouts.kitti_selection(root / 'selection')}",
        "data.frames=2",
    ],
    "nyu_densedepth": lambda root: [f"data.root={layouts.densedepth(root, FULL)}"],
    "nyu_hdf5": lambda root: [f"data.root={layouts.hdf5(root, FULL)}"],
    "nyu_labelled": lambda root: [f"data.root={layouts.labeled(root, FULL)}"],
    "nyu_mat": lambda root: [f"data.root={mat_with_all_splits(root)}"],
    "nyu_sync": lambda root: [
        f"data.root={layouts.sync(root / 'sync', FULL)}",
        f"data.test_root={layouts.sync(root / 'test', FULL, (('bathroom', '00045'),))}",
    ],
}


def mat_with_all_splits(root: Path) -> Path:
    layouts.mat(root, FULL, count=23)
    layouts.mat_split(root, train=(3, 22, 23), test=(1, 4))
    return root


def test_every_data_set_is_tested() -> None:
    # rendered: test_rendered_scenes.py, test_arena_frames.py; several sources: test_mix.py
    elsewhere = {"rooms", "arenas", "streets", "mix", "mix_photographs"}
    names = {path.stem for path in (config_folder() / "data").glob("*.yaml")}
    assert names - set(TREES) <= elsewhere


@pytest.fixture(scope="module", params=sorted(TREES))
def given(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """The overrides for a data set in a tiny tree."""
    return [f"data={request.param}", *TREES[request.param](tmp_path_factory.mktemp("data"))]


def test_data_builds_and_can_be_scored(given: list[str]) -> None:
    config = compose(TrainSettings, given)
    protocol = chosen_protocol(config.data, config.protocol)
    train = open_split(config.data, "train", protocol, augmentation=config.augmentation)
    parts = {split: open_split(config.data, split, protocol) for split in ("val", "test")}
    assert not set(train.names) & set(parts["val"].names)
    assert train[0]["image"].shape == (3, *config.data["input_size"])
    assert train[0]["depth"].shape == (1, *config.data["input_size"])
    for dataset in parts.values():
        assert dataset.ground_truth == protocol.ground_truth
        assert not set(train.names) & set(dataset.names)
        sample = dataset[0]
        assert sample["image"].shape == (3, *config.data["input_size"])
        counts = protocol.valid_mask(sample["depth"][None], sample["mask"][None])
        assert counts.any()
        assert sample["depth"][0][~sample["mask"][0]].sum() == 0


#: Data sets without cameras, and why.
UNKNOWN_CAMERAS = {
    "cityscapes_mtan": "the set lacks them (see CityscapesMTAN)",
    "folder": "the user gives data.intrinsics, see test_folder.py",
}


def test_every_frame_has_a_camera_in_every_split(given: list[str]) -> None:
    """Its focal length is that of a lens from ultra-wide to tele, its center is in the middle."""
    config = compose(TrainSettings, given)
    protocol = chosen_protocol(config.data, config.protocol)
    for split in ("train", "val", "test"):
        augmentation = config.augmentation if split == "train" else None
        sample = open_split(config.data, split, protocol, augmentation=augmentation)[0]
        (fx, _, cx), (_, fy, cy), _ = sample["intrinsics"].tolist()
        if config.data["name"] in UNKNOWN_CAMERAS:
            assert fx == 0
            continue
        height, width = sample["image"].shape[1:]
        assert FOCAL_RANGE[0] <= fx / width <= FOCAL_RANGE[1]
        assert fy / fx == pytest.approx(1, abs=0.03)  # where a resize stretches, by less than that
        assert 0.3 < cx / width < 0.7
        assert 0 < cy / height < 1  # KITTI's crop is of the lower part


@pytest.mark.parametrize(
    ("data", "setting"),
    [("nyu_sync", "test_root"), ("kitti", "raw_root"), ("kitti_selection", "selection_root")],
)
def test_the_error_names_the_setting_of_the_folder_that_is_missing(
    data: str, setting: str, tmp_path: Path, monkeypatch
) -> None:
    """``data.root`` is given and right."""
    monkeypatch.delenv("ELDENET_DATA", raising=False)
    words = [f"data={data}", *TREES[data](tmp_path)]
    for given in ([], [f"data.{setting}={tmp_path}/nowhere"]):
        kept = [word for word in words if not word.startswith(f"data.{setting}=")]
        if not given and len(kept) == len(words):
            continue  # the setting has a default that is there
        config = compose(TrainSettings, [*kept, *given])
        with pytest.raises(FileNotFoundError, match=rf": set data\.{setting} to the data set's folder"):
            open_split(config.data, "test", chosen_protocol(config.data, config.protocol))


def test_a_missing_root_says_what_to_do(given: list[str], tmp_path: Path, monkeypatch) -> None:
    given = [word for word in given if not re.match(r"data\.(root|selection_root|test_root)=", word)]
    monkeypatch.delenv("ELDENET_DATA", raising=False)
    config = compose(TrainSettings, given)
    protocol = chosen_protocol(config.data, config.protocol)
    for root, message in (
        (None, r"set data\.\w*root"),
        (f"{tmp_path}/nowhere", r"is not a folder: set data\.\w*root(.|\n)*Expected tree"),
        (str(tmp_path), r"(has no|none of) (.|\n)*Expected tree|no frames"),
    ):
        for name in {"root", "selection_root"} & config.data["train"].keys():
            config.data["train"][name] = root
        with pytest.raises((FileNotFoundError, ValueError), match=message):
            open_split(config.data, "train", protocol)
    config.data["train"]["split"] = "testing"
    with pytest.raises(ValueError, match="split='testing'"):
        open_split(config.data, "train", protocol)


def test_worker_processes_read_the_same_frames(given: list[str]) -> None:
    """From a copy too; open files of this process are not theirs."""
    config = compose(TrainSettings, given)
    data = open_split(config.data, "train", chosen_protocol(config.data, config.protocol))
    alone = [data[index]["depth"] for index in range(len(data))]
    copy = pickle.loads(pickle.dumps(data))
    assert torch.equal(copy[len(data) - 1]["depth"], alone[-1])
    loaded = [batch["depth"][0] for batch in DataLoader(data, num_workers=2)]
    assert all(map(torch.equal, alone, loaded))


def test_subset_draws_whole_frames(given: list[str]) -> None:
    split = "val" if "data=kitti_selection" in given else "train"
    config = compose(TrainSettings, given)
    protocol = chosen_protocol(config.data, config.protocol)
    whole = open_split(config.data, split, protocol)

    def subset(span: int | list[int], seed: int) -> DepthDataset:
        config.data["subset"][split], config.data["subset_seed"] = span, seed
        return open_split(config.data, split, protocol)

    for seed in range(3):
        drawn = subset(1, seed)
        assert len(drawn) == 1
        assert drawn[0]["name"] == drawn.names[0]
        expected = whole[whole.names.index(drawn.names[0])]
        assert all((drawn[0][key] == expected[key]).all() for key in ("image", "depth"))
    if len(whole) > 1:
        others = subset([1, len(whole)], 2)
        assert sorted([*others.names, *drawn.names]) == sorted(whole.names)
    with pytest.raises(ValueError, match=f"found {len(whole)} frames in this split"):
        subset(len(whole) + 1, 0)


@pytest.mark.parametrize(
    ("experiment", "tree", "overrides"),
    [
        (
            "nyu_paper",
            lambda root: layouts.densedepth(root, FULL),
            ["data.subset={train: [0, 1], val: [1, 2], test: [1, 2]}"],
        ),
        ("kitti_paper", layouts.kitti_depth, ["data.subset={train: 1, val: 1, test: 1}"]),
        (
            "cityscapes_paper",
            lambda root: layouts.cityscapes(root, layouts.content((1024, 2048))),
            [],
        ),
    ],
)
def test_the_papers_set_ups(
    experiment: str, tree: Callable[[Path], Path], overrides: list[str], tmp_path: Path
) -> None:
    if experiment == "kitti_paper":
        layouts.kitti_depth(tmp_path, kind="velodyne_raw")
    config = compose(TrainSettings, [f"+experiment={experiment}", f"data.root={tree(tmp_path)}", *overrides])
    protocol = chosen_protocol(config.data, config.protocol)
    assert protocol.name == experiment
    splits = {split: open_split(config.data, split, protocol) for split in ("train", "val", "test")}
    assert not set(splits["train"].names) & (set(splits["val"].names) | set(splits["test"].names))
    for data in splits.values():
        assert data[0]["image"].shape[1:] == data[0]["depth"].shape[1:] == protocol.size


def test_the_protocol_alone_says_what_is_scored(tmp_path: Path) -> None:
    root = layouts.kitti_depth(tmp_path)
    pixels = []
    for far in (80, 20):
        config = compose(TrainSettings, ["data=kitti", f"data.root={root}", f"data.max_depth={far}"])
        protocol = chosen_protocol(config.data, config.protocol)
        sample = open_split(config.data, "test", protocol)[0]
        pixels.append(int(protocol.valid_mask(sample["depth"][None], sample["mask"][None]).sum()))
        assert open_split(config.data, "train", protocol)[0]["depth"].max() <= far
    assert pixels[0] == pixels[1] > 0


def test_test_frames_of_another_folder(tmp_path: Path) -> None:
    """All of them: of the training's own folder, however it is written, those of validation."""
    root, other = layouts.folder(tmp_path / "mine"), layouts.folder(tmp_path / "other")

    def test_split(*words: str) -> FolderDataset:
        config = compose(TrainSettings, ["data=folder", f"data.root={root}", *words])
        return open_split(config.data, "test", chosen_protocol(config.data, config.protocol))

    every = len(list((other / "images").iterdir()))
    test = test_split(f"data.test_root={other}")
    assert (test.root, len(test)) == (other, every)
    for words in ([], [f"data.test_root={root}/"], [f"data.test_root={other}", "data.test_split=val"]):
        assert 0 < len(test_split(*words)) < every


def test_protocol_with_frame_geometry_meets_whole_frames(tmp_path: Path) -> None:
    """``resize_on_load`` must not shrink the frames that the protocol halves and crops."""
    overrides = ["data=nyu_mat", f"data.root={mat_with_all_splits(tmp_path)}", "protocol=nyu_paper"]
    overrides.append("data.ground_truth=inpainted")
    config = compose(TrainSettings, overrides)
    protocol = chosen_protocol(config.data, config.protocol)
    assert config.data["train"]["resize_on_load"] == config.data["input_size"]
    small = open_split(config.data, "train", protocol)
    whole = open_split(config.data, "val", protocol)[0]
    assert whole["depth"].shape == (1, 228, 304)
    # the focal length [px] tells how much of the frame is seen: halved, cropped, then resized
    expected = 518.8579 / 2 * config.data["input_size"][1] / 304
    torch.testing.assert_close(small[0]["intrinsics"][0, 0].item(), expected, rtol=1e-5, atol=1e-4)


def test_folder_takes_a_range_and_a_kind_of_its_own(tmp_path: Path) -> None:
    layouts.folder(tmp_path)
    words = ["data=folder", f"data.root={tmp_path}", "data.max_depth=5", "data.ground_truth=inpainted"]
    config = compose(TrainSettings, words)
    protocol = chosen_protocol(config.data, config.protocol)
    assert (protocol.max_depth, protocol.ground_truth) == (5.0, "inpainted")
    assert plain(config.model["head"])["max_depth"] == 5
    typo = compose(TrainSettings, ["data=folder", f"data.root={tmp_path}", "+data.train.no_such_option=1"])
    with pytest.raises(ValueError, match="no_such_option"):
        open_split(typo.data, "train", protocol)

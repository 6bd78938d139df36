"""``check_data`` on whole and on damaged data sets: everything wrong is named, nothing stops it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support import layouts

from eldenet.check_data import CheckDataSettings, check_data
from eldenet.compose import compose
from eldenet.data.folder import FolderDataset
from eldenet.data.inspection import check_split
from eldenet.data.splits import evenly_spaced
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.train import TrainSettings
from eldenet.training.notes import common_frames


def run(folder: Path, *overrides: str) -> tuple[bool, dict]:
    good = check_data(compose(CheckDataSettings, [*overrides, f"output={folder}"]))
    return good, json.loads((folder / "check.json").read_text())


def test_a_complete_data_set_has_no_faults(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    root = layouts.folder(tmp_path / "data")
    good, report = run(tmp_path / "out", "data=folder", f"data.root={root}", "data.intrinsics=[60,61,32,24]")
    assert good
    assert report["faults"] == []
    train, val = report["splits"]  # test is val here, and is read once
    assert report["same_frames"] == {"test": "val"}
    assert (train["frames"], val["frames"], train["looked_at"]) == (9, 1, 9)
    assert train["sizes"] == {"48 x 64": 9}
    assert train["intrinsics"] == [60, 61, 32, 24]
    meters = layouts.SMALL.millimeters[layouts.SMALL.millimeters > 0] / 1000
    assert train["valid"] == pytest.approx(meters.size / layouts.SMALL.meters.size)
    assert train["percentiles"]["p50"] == pytest.approx(np.median(meters), rel=0.01)
    assert train["percentiles"]["p95"] == pytest.approx(np.percentile(meters, 95), rel=0.01)
    assert sum(train["histogram"]) == 9 * meters.size
    np.testing.assert_allclose(train["mean"], layouts.SMALL.rgb.mean((0, 1)) / 255, atol=1e-3)
    np.testing.assert_allclose(train["std"], layouts.SMALL.rgb.std((0, 1)) / 255, atol=1e-3)
    sheet = cv2.imread(str(tmp_path / "out/contact_sheet.png"))
    assert sheet.shape[1] == 4 * 256 + 3 * 2
    shown = capsys.readouterr().out
    assert "all is well" not in shown  # the encoding is a guess
    assert "m as kitti" in shown
    assert "no file is wrong; check with the depth above whether data.encoding is right" in shown
    assert train["split_hash"] in shown


def test_everything_wrong_is_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    root = layouts.folder(tmp_path / "data", count=40)
    for i in range(12):
        (root / f"depths/f{i:03d}.png").unlink()
    cut = root / "images/f020.png"
    cut.write_bytes(cut.read_bytes()[:-30])
    layouts.picture(root / "depths/f021.png", layouts.SMALL.eight)
    layouts.picture(root / "depths/f022.png", layouts.SMALL.millimeters * 0)
    good, report = run(tmp_path / "out", "data=folder", f"data.root={root}", "data.val_names=[f039]")
    assert not good
    train = report["splits"][0]
    assert (train["frames"], train["looked_at"], len(train["missing"])) == (27, 27, 12)
    assert sorted(train["unreadable"]) == ["f020", "f021"]
    assert train["without_depth"] == ["f022"]
    shown = capsys.readouterr().out
    for text in (
        "12 frames without all of their files",
        "depths/f009.*",
        "... and 2 more",
        "f020.png is truncated",
    ):
        assert text in shown
    assert "holds uint8, encoding 'mm' needs uint16" in shown
    assert "depths/f010" not in shown


def test_a_split_that_cannot_be_opened_does_not_hide_the_others(tmp_path: Path) -> None:
    root = layouts.sync(tmp_path / "sync")
    good, report = run(
        tmp_path / "out", "data=nyu_sync", f"data.root={root}", f"data.test_root={tmp_path / 'nowhere'}"
    )
    assert not good
    assert [part["frames"] for part in report["splits"]] == [1, 1, 0]
    assert "nowhere is not a folder" in report["faults"][0]


def test_ground_truth_that_the_protocol_does_not_score_is_a_fault(tmp_path: Path) -> None:
    """A training would refuse it; ``protocol=`` is the training's."""
    root = layouts.folder(tmp_path / "data")
    words = ("data=folder", f"data.root={root}", "data.ground_truth=sparse")
    assert run(tmp_path / "out", *words)[0]
    good, report = run(tmp_path / "out", *words, "protocol=nyu_bts")
    assert not good
    (fault,) = report["faults"]  # test is val here
    assert fault.startswith("val: protocol nyu_bts scores raw ground truth, this data set has sparse")
    assert report["splits"][1]["looked_at"] == 1


def test_frames_of_one_name_in_two_folders_are_two(tmp_path: Path) -> None:
    mine, other = layouts.folder(tmp_path / "mine"), layouts.folder(tmp_path / "other")
    words = ("data=folder", f"data.root={mine}")
    good, report = run(tmp_path / "out", *words, f"data.test_root={other}")
    assert good
    assert [part["frames"] for part in report["splits"]] == [9, 1, 10]
    good, report = run(tmp_path / "out", *words, "data.test_split=all")
    assert not good
    assert [line for line in report["faults"] if "are in both" in line] == [
        "train and test: 9 frames are in both:",
        "val and test: 1 frames are in both:",
    ]
    config = compose(TrainSettings, [*words, "data.test_split=all"])
    train, val, test = (
        open_split(config.data, name, chosen_protocol(config.data, config.protocol))
        for name in ("train", "val", "test")
    )
    assert (common_frames(train, val), common_frames(train, test)) == (0, 9)


def test_all_frames_missing_is_a_fault(tmp_path: Path) -> None:
    root = layouts.densedepth(tmp_path)
    for path in (root / "data/nyu2_train").rglob("*.jpg"):
        path.unlink()
    good, report = run(tmp_path / "out", "data=nyu_densedepth", f"data.root={root}")
    assert not good
    assert "all 1 frames were left out" in report["splits"][0]["fault"]
    assert report["splits"][2]["frames"] == 1


def test_rooms_are_checked_too(tmp_path: Path, cache: str) -> None:
    overrides = ["data.size=[32,40]", "data.input_size=[32,40]", f"data.root={cache}", "frames=3"]
    good, report = run(tmp_path, *overrides, "data.frames={train: 16, val: 8, test: 8}", "samples=0")
    assert good
    assert [part["looked_at"] for part in report["splits"]] == [3, 3, 3]
    assert not (tmp_path / "contact_sheet.png").exists()


def test_the_command_ends_with_1(tmp_path: Path, run_command) -> None:
    root = layouts.folder(tmp_path / "data")
    arguments = ["data=folder", f"data.root={root}", "output=out"]
    assert run_command("check_data", *arguments).returncode == 0
    (root / "images/f000.png").unlink()
    finished = run_command("check_data", *arguments)
    assert finished.returncode == 1
    assert "images/f000" in finished.stdout
    assert "Traceback" not in finished.stderr
    finished = run_command("check_data", *arguments, "frames=0")
    assert finished.returncode == 1
    assert "frames=0" in finished.stderr


def test_a_sample_of_frames_is_evenly_spread(tmp_path: Path) -> None:
    assert evenly_spaced(10, None) == list(range(10))
    assert evenly_spaced(10, 3) == [0, 4, 9]
    assert evenly_spaced(3, 10) == [0, 1, 2]
    assert evenly_spaced(5, 1) == [0]
    done: list[int] = []
    data = FolderDataset(layouts.folder(tmp_path), max_depth=5.0)
    found = check_split("train", data, frames=4, advance=done.append)
    assert (found.looked_at, sum(done), len(found.names)) == (4, 4, 10)
    assert 0.3 < found.outside < 0.7  # half of the depths lie beyond 5 m
    assert found.percentiles["p99"] < 5.05


def test_an_implausible_depth_names_the_encodings_that_would_be_plausible(tmp_path, capsys):
    root = layouts.folder(tmp_path / "data")
    for file in (root / "depths").iterdir():
        layouts.picture(file, np.full((48, 64), 1000, np.uint16))
    good, report = run(tmp_path / "out", "data=folder", f"data.root={root}", "data.encoding=tum")
    assert good
    assert report["splits"][0]["median"] == pytest.approx(0.2, rel=0.01)
    shown = capsys.readouterr().out
    assert "read as encoding=tum, which few cameras see; it would be " in shown
    assert "m as mm, 3.9" in shown
    assert "no file is wrong, but the depth is implausible: check data.encoding" in shown

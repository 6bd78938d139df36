"""The labeled frames of NYU Depth V2 from the official file, as the adapters read them."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from support import layouts
from support.layouts import real_folder

from eldenet.data.nyu import NYUDenseDepth, NYULabelled
from eldenet.data.nyu_hdf5 import NYUMat
from eldenet.data.prepare import main

NAME = "nyu_depth_v2_labeled.mat"


def prepare(folder: Path, file: str = NAME) -> tuple[NYULabelled, NYUDenseDepth]:
    main(["nyu_labelled", f"source={folder / file}", f"output={folder / 'out'}"])
    return NYULabelled(folder / "out", split="all"), NYUDenseDepth(folder / "out", split="test")


def compare(folder: Path, file: str, train: NYULabelled, test: NYUDenseDepth) -> None:
    for made, split, depth_step in ((train, "trainval", 9.99547 / 255), (test, "test", 1e-3)):
        official = NYUMat(folder, split=split, file=file)
        assert len(made) == len(official) > 0
        for index in range(len(made)):
            ours, theirs = made.load_frame(index), official.load_frame(index)
            assert ours.name.rpartition("/")[2].startswith(theirs.name)
            known = theirs.depth < 9.99  # the file's largest depth is 9.99547 m
            assert known.mean() > 0.5
            np.testing.assert_allclose(
                ours.depth[known], theirs.depth[known], atol=0.5 * depth_step + 1e-5, rtol=0
            )
            assert np.abs(ours.image.astype(int) - theirs.image).mean() < 3  # JPEG
            np.testing.assert_allclose(ours.intrinsics, theirs.intrinsics)


def test_made_frames_are_read_as_the_official_ones(tmp_path: Path, monkeypatch) -> None:
    layouts.mat(tmp_path, layouts.content((480, 640)))
    monkeypatch.setenv("HOME", str(tmp_path))  # zsh leaves the ~ of output=~/out to the program
    main(["nyu_labelled", f"source=~/{NAME}", "output=~/out"])
    train, test = NYULabelled("~/out", split="all"), NYUDenseDepth("~/out", split="test")
    assert [name.rpartition("/")[2] for name in train.names] == ["0002", "0003"]
    assert len(test) == 2
    compare(tmp_path, NAME, train, test)


def test_real_frames(tmp_path: Path) -> None:
    """Six frames of the official file; the training's 8-bit depth is known to half a step of 4 cm."""
    file = "nyu_depth_v2_labeled_REPACKED_6.mat"
    shutil.copy(real_folder("nyu_depth_v2/labeled", file) / file, tmp_path)
    layouts.mat_split(tmp_path, train=(1, 2, 3, 4), test=(5, 6))
    compare(tmp_path, file, *prepare(tmp_path, file))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nyu", "source=a.mat"], "give nyu_labelled"),
        (["nyu_labelled", "from=a.mat"], "source=<file>"),
        (["nyu_labelled", "source=nowhere/a.mat"], r"a\.mat"),
    ],
)
def test_a_mistake_ends_in_one_line(words: list[str], message: str) -> None:
    with pytest.raises(SystemExit, match=message):
        main(words)


def test_the_usage_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    assert "nyu_labelled source=nyu_depth_v2_labeled.mat" in capsys.readouterr().out

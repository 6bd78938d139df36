"""Digests beside a data set: a bit that no reader can see, a lost file and a new one are named."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support import layouts

from eldenet.config import build_check_data, compose
from eldenet.results.data_check import check


def run(root: Path, *overrides: str) -> tuple[bool, dict]:
    given = ["data=folder", f"data.root={root}", "samples=0", f"run_dir={root.parent / 'out'}", *overrides]
    good = check(build_check_data(compose("check_data", given)))
    return good, json.loads((root.parent / "out/check.json").read_text())


def flip(path: Path, at: int) -> None:
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    root = layouts.folder(tmp_path / "data")
    for png in sorted((root / "depths").glob("*.png")):
        np.save(png.with_suffix(".npy"), layouts.SMALL.meters.astype(np.float32))
        png.unlink()
    return root


def test_changed_missing_and_new_files_are_named(root: Path) -> None:
    given = ("data.encoding=meters", "fingerprint=true")
    good, report = run(root, *given)
    assert good
    assert "digests of 20 files" in report["fingerprint"]
    if shutil.which("sha256sum"):
        subprocess.run(["sha256sum", "--quiet", "-c", "eldenet.sha256"], cwd=root, check=True)
    good, report = run(root, *given)
    assert good
    assert report["fingerprint"].endswith("equal")

    flip(root / "depths/f003.npy", 2000)  # the last digits of a depth: nothing else can see it
    assert run(root, "data.encoding=meters")[0]
    (root / "images/f004.png").rename(root / "images/f011.png")
    (root / "depths/f004.npy").rename(root / "depths/f011.npy")
    good, report = run(root, *given)
    assert not good
    text = "\n".join(report["faults"])
    for part in (
        "1 files are changed",
        "f003.npy",
        "2 files are missing",
        "f004.png",
        "2 files are new",
        "f011.npy",
    ):
        assert part in text


def test_a_data_set_with_faults_gets_no_list(root: Path) -> None:
    (root / "depths/f003.npy").write_bytes(b"")
    good, report = run(root, "data.encoding=meters", "fingerprint=true")
    assert not good
    assert "was not written" in report["fingerprint"]
    assert not (root / "eldenet.sha256").exists()


def test_the_list_may_lie_elsewhere_and_a_damaged_one_is_named(root: Path, tmp_path: Path) -> None:
    path = tmp_path / "lists/mine.sha256"
    given = ("data.encoding=meters", f"fingerprint={path}")
    assert run(root, *given)[0]
    assert not (root / "eldenet.sha256").exists()
    assert run(root, *given)[1]["fingerprint"].endswith("equal")
    path.write_text("abc  images/f000.png\n")
    with pytest.raises(ValueError, match=r"mine\.sha256, line 1"):
        run(root, *given)
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"cannot be written .*fingerprint="):
        run(root, "data.encoding=meters", f"fingerprint={tmp_path}/file/list.sha256")


def test_rendered_frames_have_check_sums_of_their_own() -> None:
    with pytest.raises(ValueError, match=r"fingerprint=true .*give data\.root"):
        build_check_data(compose("check_data", ["data=rooms", "fingerprint=true"]))
